"""Bounds of the nonlinear program on unknowns and equations, whether they can all be met, and what violates them.

A violation is relative to what is compared: the terms of an equation, or the largest value of a bounded kind, in which
rounding `EPS` is never a violation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.numbers import counted
from casadi_galerkin.calculus.roundoff import EPS, largest_of, or_one
from casadi_galerkin.control.control_graph import Report
from casadi_galerkin.control.control_numbering import Chain, Numbering
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.phases import Joins
from casadi_galerkin.problems.problem import ENDS
from casadi_galerkin.problems.statements import FEASIBLE, bound_excess

VANISHED = 1e3 * EPS  # terms over those along the guess below which they are rounding
LEAST_SIZE = EPS / FEASIBLE  # size of terms, over that of what they are part of, from which their rounding is feasible


@dataclass(frozen=True)
class ProgramBounds:
    """Lower and upper bounds of the unknowns, (2, unknowns), and of the equations, (2, equations)."""

    unknowns: np.ndarray
    equations: np.ndarray

    def narrowed(self, relaxed: float) -> ProgramBounds:
        """Bounds that become these after a solver relaxes every bound b by this part of max(1, |b|)."""
        narrow = list[np.ndarray]()
        for sides in (self.unknowns, self.equations):
            low, high = sides
            moves = relaxed * (low < high) * np.fmax(1.0, np.where(np.isfinite(sides), np.abs(sides), 1.0))
            moved = sides + moves * [[1], [-1]]
            crossed = moved[0] > moved[1]  # what has no room between its bounds is fixed in the middle
            moved[:, crossed] = (low[crossed] + high[crossed]) / 2
            narrow.append(moved)
        return ProgramBounds(*narrow)


def bounds_of(
    phases: Sequence[ControlProblem], joins: Joins, numbering: Numbering, implied: bool = False
) -> ProgramBounds:
    """Bounds of the unknowns and of the equations; for given values both bounds are equal.

    Free constants are bounded at the last joint only, because they are equal at all joints.  Equations of a constraint
    that are satisfied anyway, by given ends or by the phase before, are not imposed, unless `implied` is set.
    """
    sides, equations = np.full((2, numbering.size), [[-np.inf], [np.inf]]), np.zeros((2, numbering.equations))
    for k, (problem, chain) in enumerate(zip(phases, numbering.chains, strict=True)):
        _bound_phase(sides, equations, problem, chain)
        if "begin" in chain.free:
            given = (-np.inf, np.inf) if k else (problem.t_span[0],) * 2
            _limit(sides, chain.fields["begin"][-1], problem.initial_time_bounds or given)
        of_constraint = chain.rows["start_constraint"], chain.rows["constraint"][-1, -1]
        goes_on = k > 0 and phases[k - 1].constraint is not None, False
        for name, rows, on, satisfied in zip(ENDS, of_constraint, goes_on, problem.constraint_satisfied, strict=True):
            for index, anyway in zip((rows, chain.rows[f"{name}_tangent"]), satisfied, strict=True):
                free = np.where((anyway | on) & (not implied), np.inf, 0.0)
                _limit(equations, index, (-free, free))
    _limit(equations, slice(numbering.equations - len(joins.conditions[1]), None), joins.conditions[1:])
    return ProgramBounds(sides[:, : numbering.unknowns], equations)


def _bound_phase(sides: np.ndarray, equations: np.ndarray, problem: ControlProblem, chain: Chain) -> None:
    """Set the bounds of one phase in those of the program."""
    fields, joints = chain.fields, dict(zip(problem.breakpoints, chain.breaks.tolist(), strict=True))
    for index in (fields["x"], fields["nodes"][:, :-1]):
        _limit(sides, index, problem.position_bounds)
    _limit(sides, fields["controls"], problem.control_bounds)
    for name, given in (("duration", problem.duration_bounds), ("parameters", problem.parameter_bounds)):
        if given is not None:
            _limit(sides, fields[name][-1], given)
    for name in ("start_velocity", "end_velocity"):
        _limit(sides, fields[name], np.array(problem.velocity_bounds)[:, : chain.mechanical])
    if chain.changes:
        for name in ("changes", "joint_changes"):
            _limit(equations, chain.rows[name], problem.control_rate_bounds)
    places = [(fields["x"][joints.get(t, -1)], np.transpose(place)) for t, place in problem.waypoints]
    for index, bounds in [(fields["x"][0], np.array(problem.start_bounds)), *places]:
        low, high = bounds
        _limit(sides, index, (np.maximum(sides[0, index], low), np.minimum(sides[1, index], high)))
    for name, limited in (("path", problem.limits), ("ends", chain.end_conditions)):
        _limit(equations, chain.rows[name], limited[1:])
    for index, values in given_at_ends(problem, chain).values():
        sides[:, index] = values


def equation_scales(
    phases: Sequence[ControlProblem],
    numbering: Numbering,
    bounds: ProgramBounds,
    report: Report,
    before: np.ndarray,
) -> np.ndarray:
    """Sizes of the terms of the equations, to which their residuals are relative; (equations,).

    For the equations of motion of a component it is the largest sum of the sizes of the terms of one of them along the
    path; for a path constraint or an end condition g it is |∇g||z|, or its finite bound if that is larger.  Where these
    terms are only rounding of those along the guess (`before`, by kind), it is the latter.  All are at least a rounding
    of a rounding, for a rate a rounding of its given positions.
    """
    least, stated = np.full(len(before), LEAST_SIZE), largest_of(_finite_sizes(bounds.equations), numbering.kinds)
    for problem, chain in zip(phases, numbering.chains, strict=True):
        given = np.vstack((problem.given_positions, np.array(problem.position_bounds)))
        largest = np.max(np.abs(np.nan_to_num(given, posinf=0, neginf=0)), axis=0)[problem.mechanical :]
        least[chain.rated] = np.fmax(least[chain.rated], np.minimum(or_one(largest), 1.0))
    sizes = np.where(report.sizes <= VANISHED * before, before, report.sizes)
    return or_one(np.fmax(np.fmax(sizes, stated), LEAST_SIZE * least))[numbering.kinds]


def violations(
    numbering: Numbering, bounds: ProgramBounds, unknowns: np.ndarray, equations: np.ndarray, scales: np.ndarray
) -> np.ndarray:
    """Violation of every equation, relative to its scale, then of every unknown's bounds, relative to its kind's size.

    A value outside its bounds is not compared with itself: where an equation and a bound leave a single value, IPOPT
    moves the bound by rounding, and a value that should be zero is then as large as this shift.
    """
    kinds, stated = numbering.unknown_kinds, or_one(_finite_sizes(bounds.unknowns))
    sizes = np.maximum(largest_of(np.abs(unknowns), kinds), LEAST_SIZE * largest_of(stated, kinds))[kinds]
    return np.concatenate((_excess(equations, *bounds.equations) / scales, _excess(unknowns, *bounds.unknowns) / sizes))


def _finite_sizes(sides: np.ndarray) -> np.ndarray:
    """Larger sizes of the finite ones of lower and upper bounds (2, n); zero where there is none."""
    return np.max(np.where(np.isfinite(sides), np.abs(sides), 0.0), axis=0)


def _excess(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Distances of values from their bounds; infinite where the values are not finite."""
    return np.where(np.isfinite(values), bound_excess(values, low, high), np.inf)


def given_at_ends(problem: ControlProblem, chain: Chain) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Entries of ξ that the problem gives at the ends, and their values, by name."""
    f, given = chain.fields, dict[str, tuple[np.ndarray, np.ndarray]]()
    places = {"start": f["x"][0], "end": f["x"][-1], **{name: f[name] for name in ("start_velocity", "end_velocity")}}
    for name, index in places.items():
        values = np.array(getattr(problem, name)[: len(index)], dtype=float)  # NaN for None
        stated = np.isfinite(values)
        given[name] = index[stated], values[stated]
    return given


def _limit(sides: np.ndarray, index: np.ndarray | slice, bounds: ArrayLike) -> None:
    """Set lower and upper bounds, (2, count), of the entries (..., count) of two long vectors."""
    for side, bound in zip(sides, np.asarray(bounds), strict=True):
        side[index] = bound


def check_count(numbering: Numbering, bounds: ProgramBounds) -> None:
    """Refuse more equations than unknowns, as on a very coarse mesh; equations of the next states are not counted."""
    chains = numbering.chains
    passed = sum(sum(states for states, *_ in chain.stages[1:]) + chain.mechanical for chain in chains)
    equations = int(np.count_nonzero(np.equal(*bounds.equations))) - passed
    unknowns = int(np.count_nonzero(np.less(*bounds.unknowns))) - passed
    if equations > unknowns:
        fixed = all(np.equal(*bounds.unknowns[:, chain.fields["controls"]]).all() for chain in chains)
        tied = sum(int(np.count_nonzero(np.equal(*bounds.equations[:, chain.rows["path"]]))) for chain in chains)
        advice = "take more intervals, a higher degree or more controls, or free a component"
        if tied:
            advice = (
                f"{tied} of them are path_constraint with equal bounds, at every quadrature point: leave out the "
                "controls that they determine, or state what positions alone have to meet as `constraint`"
            )
        if fixed:
            advice = (
                "control_bounds whose sides are equal leave no control free, and the start alone determines the path: "
                "give control_bounds with room, or free the end with None"
            )
        raise ValueError(
            f"{counted(equations, 'equation')} for {counted(unknowns, 'unknown')} on "
            f"{counted(sum(c.intervals for c in chains), 'interval')} of degree {chains[0].method.degree}: {advice}"
        )


def check_stages(phases: Sequence[ControlProblem], numbering: Numbering, bounds: ProgramBounds) -> None:
    """Refuse problems that fatrop cannot divide into stages, or refuses itself when it runs."""
    if len(phases) > 1:
        raise ValueError("fatrop takes no phases, such as jumps and breakpoints with free times make: take cg.ipopt")
    (problem,), (chain,) = phases, numbering.chains
    if chain.changes:
        raise ValueError("fatrop takes no control_rate_bounds, which join intervals: take cg.ipopt")
    if any(problem.end_conditions[0].sparsity_jac(k, 0).nnz() for k in (0, 1)):
        raise ValueError(
            "fatrop takes end_conditions on the end alone, stage by stage: give what is known of the start as "
            "start and start_velocity, or take cg.ipopt"
        )
    states, others, counts = (np.array(column) for column in zip(*chain.stages, strict=True))
    row = unknown = 0
    for i, following in enumerate(np.append(states[1:], 0)):
        begin, row = row + following, row + following + counts[i]
        first, unknown = unknown, unknown + states[i] + others[i]
        equations = np.count_nonzero(np.equal(*bounds.equations[:, begin:row]))
        equations += np.count_nonzero(np.equal(*bounds.unknowns[:, first:unknown]))
        if equations > unknown - first:
            where = f"interval {i}" if i < chain.intervals else "the end"
            raise ValueError(
                f"fatrop takes no more equations than unknowns in a stage, got {equations} for {unknown - first} "
                f"at {where}: state nothing twice, or take cg.ipopt"
            )
