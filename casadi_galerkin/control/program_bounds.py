"""Bounds of the nonlinear program on unknowns and equations, whether they can all be met, and what violates them.

A violation is relative to what is compared: the terms of an equation, or the largest value of a bounded kind, in which
rounding `EPS` is never a violation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.numbers import counted
from casadi_galerkin.calculus.roundoff import EPS, largest_of, or_one
from casadi_galerkin.control.control_graph import Report
from casadi_galerkin.control.control_numbering import Chain
from casadi_galerkin.problems.bounds import FEASIBLE, bound_excess
from casadi_galerkin.problems.breakpoint_events import is_limited
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.problem import ENDS

VANISHED = 1e3 * EPS  # terms over those along the guess below which they are rounding
LEAST_SIZE = EPS / FEASIBLE  # size of terms, over that of what they are part of, from which their rounding is feasible


@dataclass(frozen=True)
class ProgramBounds:
    """Lower and upper bounds of the unknowns, (2, unknowns), and of the equations, (2, equations)."""

    unknowns: np.ndarray
    equations: np.ndarray

    def narrowed(self, relaxed: float) -> ProgramBounds:
        """Bounds that become these after a solver relaxes every bound b by this part of max(1, |b|)."""
        return ProgramBounds(_narrowed(self.unknowns, relaxed), _narrowed(self.equations, relaxed))


def _narrowed(sides: np.ndarray, relaxed: float) -> np.ndarray:
    low, high = sides
    moves = relaxed * (low < high) * np.fmax(1.0, np.where(np.isfinite(sides), np.abs(sides), 1.0))
    least, most = low + moves[0], high - moves[1]
    crossed = least > most  # what has no room between its bounds is fixed in the middle
    least[crossed] = most[crossed] = (low[crossed] + high[crossed]) / 2
    return np.stack((least, most))


def bounds_of(problem: ControlProblem, chain: Chain, implied: bool = False) -> ProgramBounds:
    """Bounds of the unknowns and of the equations; for given values both bounds are equal.

    Durations and parameters are bounded at the last joint only, because they are equal at all joints.  Equations of a
    constraint that given ends satisfy anyway are not imposed, unless `implied` is set.
    """
    fields, arriving = chain.fields, chain.fields["nodes"][chain.crossed - 1, -1]
    sides = np.full((2, chain.size), [[-np.inf], [np.inf]])
    for index in (fields["x"], fields["nodes"][:, :-1], arriving):
        _limit(sides, index, problem.position_bounds)
    _limit(sides, fields["controls"], problem.control_bounds)
    for name, bounds in (("durations", problem.duration_bounds), ("parameters", problem.parameter_bounds)):
        if bounds is not None:
            _limit(sides, fields[name][-1], bounds)
    for t, place in problem.waypoints:
        if not is_limited(place):
            joint = chain.breaks[problem.breakpoints.index(t)]
            index = fields["nodes"][joint - 1, -1] if joint in chain.crossed else fields["x"][joint]
            low, high = np.transpose(place)
            _limit(sides, index, (np.maximum(sides[0, index], low), np.minimum(sides[1, index], high)))
    equations = np.zeros((2, chain.equations))
    conditions = [(f"waypoint {i}", crossing.condition) for i, crossing in enumerate(problem.crossings)]
    for name, limited in (("path", problem.path_constraint), ("ends", chain.end_conditions), *conditions):
        if limited is not None:
            _limit(equations, chain.rows[name], limited[1:])
    for index, values in given_at_ends(problem, chain).values():
        sides[:, index] = values
    for rows, satisfied in _constraint_at_ends(problem, chain):
        free = np.where(satisfied & (not implied), np.inf, 0.0)
        _limit(equations, rows, (-free, free))
    return ProgramBounds(sides[:, : chain.unknowns], equations)


def equation_scales(
    problem: ControlProblem, chain: Chain, bounds: ProgramBounds, report: Report, before: np.ndarray
) -> np.ndarray:
    """Sizes of the terms of the equations, to which their residuals are relative; (equations,).

    For the equations of motion of a component it is the largest sum of the sizes of the terms of one of them along the
    path; for a path constraint or an end condition g it is |∇g||z|, or its finite bound if that is larger.  Where these
    terms are only rounding of those along the guess (`before`, by kind), it is the latter.  All are at least a rounding
    of a rounding, for a rate a rounding of its given positions.
    """
    given = np.nan_to_num(np.vstack((problem.given_positions, np.array(problem.position_bounds))), posinf=0, neginf=0)
    least, stated = np.full(len(before), LEAST_SIZE), largest_of(_finite_sizes(bounds.equations), chain.kinds)
    least[chain.rated] = np.minimum(or_one(np.max(np.abs(given), axis=0)[problem.mechanical :]), 1.0)
    sizes = np.where(report.sizes <= VANISHED * before, before, report.sizes)
    return or_one(np.fmax(np.fmax(sizes, stated), LEAST_SIZE * least))[chain.kinds]


def violations(
    chain: Chain, bounds: ProgramBounds, unknowns: np.ndarray, equations: np.ndarray, scales: np.ndarray
) -> np.ndarray:
    """Violation of every equation, relative to its scale, then of every unknown's bounds, relative to its kind's size.

    A value outside its bounds is not compared with itself: where an equation and a bound leave a single value, IPOPT
    moves the bound by rounding, and a value that should be zero is then as large as this shift.
    """
    kinds, stated = chain.unknown_kinds, or_one(_finite_sizes(bounds.unknowns))
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


def _limit(sides: np.ndarray, index: np.ndarray, bounds: ArrayLike) -> None:
    """Set lower and upper bounds, (2, count), of the entries (..., count) of two long vectors."""
    for side, bound in zip(sides, np.asarray(bounds), strict=True):
        side[index] = bound


def _constraint_at_ends(problem: ControlProblem, chain: Chain) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rows of a constraint and of its time derivative at both ends, and whether given values satisfy them already."""
    rows, ends = chain.rows, list[tuple[np.ndarray, np.ndarray]]()
    of_constraint = rows["start_constraint"], rows["constraint"][-1, -1]
    for name, constraint, (satisfied, tangent) in zip(ENDS, of_constraint, problem.constraint_satisfied, strict=True):
        ends += [(constraint, satisfied), (rows[f"{name}_tangent"], tangent)]
    return ends


def check_count(chain: Chain, bounds: ProgramBounds) -> None:
    """Refuse more equations than unknowns, as on a very coarse mesh; equations of the next states are not counted."""
    passed = sum(states for states, *_ in chain.stages[1:]) + chain.mechanical
    equations = int(np.count_nonzero(np.equal(*bounds.equations))) - passed
    unknowns = int(np.count_nonzero(np.less(*bounds.unknowns))) - passed
    if equations > unknowns:
        fixed = np.equal(*bounds.unknowns[:, chain.fields["controls"]]).all()
        tied = int(np.count_nonzero(np.equal(*bounds.equations[:, chain.rows["path"]])))
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
            f"{counted(chain.intervals, 'interval')} of degree {chain.method.degree}: {advice}"
        )


def check_stages(problem: ControlProblem, chain: Chain, bounds: ProgramBounds) -> None:
    """Refuse problems that fatrop cannot divide into stages, or refuses itself when it runs."""
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
