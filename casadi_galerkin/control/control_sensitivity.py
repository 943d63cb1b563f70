"""Derivatives of an optimum by its data, by the implicit function theorem.

Let A be the bounds on unknowns and equations that act at the optimum: given values and equations among them.  While no
other bound begins to act, and none ceases to, the optimum solves

    ∇f̄(ξ, λ, p) = 0 for free unknowns,        ξ = b for those at bounds,        G(ξ, p) = g in A,        λ = 0 else,

and its derivative by the data, which are in p, b and g, comes from the matrix of a Newton step to it.  That of the cost
needs no matrix: it is that of f̄ - λ·g - μ·b at the fixed optimum, with the multipliers μ of the bounds on ξ.

A bound that is met, but hardly acts, has another derivative on either side.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.numbers import counted
from casadi_galerkin.calculus.roundoff import EPS, TINY, largest_of, or_one
from casadi_galerkin.control.control_graph import ControlGraph
from casadi_galerkin.control.control_numbering import Numbering
from casadi_galerkin.control.optimizer import TOLERANCE, Optimum
from casadi_galerkin.control.program_bounds import bounds_of
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.linear_equations import NO_CUTOFF
from casadi_galerkin.problems.phases import joined_sections, sections
from casadi_galerkin.problems.problem import with_values
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solvers.linear_solver import factors_of

WEAK = (
    10 * TOLERANCE**0.5
)  # relative gap and force, up to ten times the root of the barrier, of a bound that hardly acts
GIVEN = "start", "end", "start_velocity", "end_velocity", "parameters"
SIDES = "position_bounds", "control_bounds", "duration_bounds", "parameter_bounds"
LIMITS = "path_constraint", "end_conditions"  # (g, lower, upper bounds)
Units: TypeAlias = tuple[np.ndarray, np.ndarray]
ROUNDED = EPS**0.5  # relative error by rounding from which derivatives are refused: half of the digits


@dataclass(frozen=True, repr=False, eq=False)
class ControlSensitivity:
    """Derivatives of an optimal path by the data of its problem.

    Each attribute but `t` has one array for every datum, by name: "start", "end", "start_velocity", "end_velocity"
    and "parameters", with an entry in the last axis for each value that the problem gives; and "position_bounds",
    "control_bounds", "duration_bounds", "parameter_bounds", "path_constraint" and "end_conditions", with the last two
    axes (2, count) of lower and upper bounds.  What the problem does not have, or leaves free, is left out.  By bounds
    that do not act they are zero.

    Attributes
    ----------
    t : (N + 1,), joints
    x : (d, N + 1, ...), of the positions at the joints; where durations are free, at the same fractions of phases
    control : (n, N r, ...), of the controls at the quadrature points
    durations : (phases, ...), of the durations of the phases
    parameters : (count, ...), of free parameters
    cost : (...), of the cost, by the multipliers alone

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> move = cg.ControlProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0], [0.0], [0.0],
    ...     force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u**2 / 2, controls=1)
    >>> by = cg.sensitivity(cg.solve(move, cg.Galerkin(degree=3), intervals=4))  # the cost is 6 (end - start)²
    >>> by.cost["end"].round(6).tolist(), by.x["end"][0, :, 0].round(6).tolist()
    ([12.0], [0.0, 0.15625, 0.5, 0.84375, 1.0])
    """

    t: np.ndarray
    x: Mapping[str, np.ndarray]
    control: Mapping[str, np.ndarray]
    durations: Mapping[str, np.ndarray]
    parameters: Mapping[str, np.ndarray]
    cost: Mapping[str, np.ndarray]

    def __repr__(self) -> str:
        """Say what was differentiated by what, and the derivatives of the cost."""
        lines = [f"ControlSensitivity at {counted(len(self.t), 'joint')}"]
        for name, cost in self.cost.items():
            largest = np.max(np.abs(self.x[name]), initial=0.0)
            lines.append(f"  by {name}: of the cost {cost.tolist()}, of x up to {largest:.3g}")
        return "\n".join(lines)


def acting(values: ca.MX, multipliers: ca.MX, bounds: tuple[ca.MX, ca.MX], units: np.ndarray) -> tuple[ca.MX, ...]:
    """Which bounds act, the values that they ask for, and whether any of them is met but hardly acts.

    A bound acts where its force is larger than the gap to it, relative to `units`, (2, n), of values and of forces.
    """
    low, high = bounds
    wanted, given = ca.if_else(multipliers > 0, high, low), low == high
    gap, force = (ca.fabs(a) / ca.DM(unit) for a, unit in zip((values - wanted, multipliers), units, strict=True))
    acts = ca.logic_or(given, force > gap)
    weak = ca.logic_and(ca.logic_not(given), ca.fmax(gap, force) < WEAK)
    return acts, ca.if_else(acts, wanted, 0.0), ca.mmax(ca.vertcat(0.0, weak))


class OptimalityConditions:
    """The conditions at an optimum with the bounds A that act there, and a Newton step to them.

    Parameters
    ----------
    graph : ControlGraph
    units : those of `acting`, of the unknowns and of the equations

    Attributes
    ----------
    inputs : ξ, λ, μ, data, lower and upper bounds of ξ and of the equations
    matrix, missed : the Newton step of (ξ, λ) is -matrix⁻¹ missed
    lagrangian : f̄ - λ·g - μ·b
    weak : whether a bound is met but hardly acts
    """

    def __init__(self, graph: ControlGraph, units: Units) -> None:
        x, p, count = graph.unknowns, graph.data, graph.equations.numel()
        sizes = {"λ": count, "μ": x.numel(), "low": x.numel(), "high": x.numel(), "least": count, "most": count}
        multipliers, of_bounds, *sides = (ca.MX.sym(name, size) for name, size in sizes.items())
        self.inputs = [x, multipliers, of_bounds, p, *sides]
        slope, hessian = graph.whole_hessian(x, p, 1, multipliers)
        values, gradients = graph.jacobian(x, p)
        held, at, weak = acting(x, of_bounds, (sides[0], sides[1]), units[0])
        kept, asked, weakly = acting(values, multipliers, (sides[2], sides[3]), units[1])
        off, missing = ca.if_else(held, x - at, 0.0), ca.if_else(kept, values - asked, 0.0)
        free, across = ca.diag(ca.logic_not(held)), ca.mtimes(ca.diag(kept), gradients)
        upper = ca.horzcat(ca.mtimes(free, hessian) + ca.diag(held), ca.mtimes(free, gradients.T))
        self.matrix = ca.vertcat(upper, ca.horzcat(across, ca.diag(ca.logic_not(kept))))
        self.missed = ca.vertcat(off + ca.if_else(held, 0.0, slope), missing + ca.if_else(kept, 0.0, multipliers))
        self.lagrangian = graph.gradient(x, p)[0] + ca.dot(multipliers, missing) + ca.dot(of_bounds, off)
        self.weak = ca.fmax(weak, weakly)

    @property
    def step(self) -> ca.Function:
        """Inputs -> the matrix, and whether a bound is met but hardly acts."""
        return ca.Function("step", self.inputs, [self.matrix, self.weak])

    @property
    def value(self) -> ca.Function:
        """Inputs -> what is missed, and f̄ - λ·g - μ·b."""
        return ca.Function("value", self.inputs, [self.missed, self.lagrangian])

    def changes(self, data: list[ca.MX], given: list[ca.MX]) -> ca.Function:
        """(data, ξ, λ, μ) -> zeros with the first derivatives of ξ and of the cost at an optimum by the data.

        Nothing is evaluated before a derivative is asked for.  Where a bound hardly acts, derivatives are not finite.

        Parameters
        ----------
        data, given : symbols, and what is given in terms of them
        """
        z, point = ca.MX.sym("data", sum(a.numel() for a in data)), [ca.MX.sym("at", *a.shape) for a in self.inputs[:3]]
        parts = ca.vertsplit(z, np.cumsum([0, *(a.numel() for a in data)]).tolist())
        given = ca.Function("given", data, given).call(parts)
        (matrix, weak), (missed, lagrangian) = self.step(*point, *given), self.value(*point, *given)
        step = -ca.solve(matrix, ca.densify(ca.jacobian(missed, z)), "qr", NO_CUTOFF)[: point[0].numel(), :]
        infinite, zero = ca.if_else(weak, np.inf, 0.0), ca.fmin(ca.fabs(ca.sum1(z)), 0.0)  # which depends on the data
        outputs = [ca.repmat(zero, point[0].numel(), 1), zero]
        by_data = [step + infinite, ca.densify(ca.jacobian(lagrangian, z)) + infinite]
        blocks = [
            a
            for by, out in zip(by_data, outputs, strict=True)
            for a in (by, *(ca.MX(out.numel(), b.numel()) for b in point))
        ]
        unused = [ca.MX.sym("unused", *out.shape) for out in outputs]
        names = ["data", "x", "lam_g", "lam_x"], ["change", "cheaper"]
        jacobian = ca.Function(
            "jac_changes",
            [z, *point, *unused],
            blocks,
            [*names[0], *(f"out_{name}" for name in names[1])],
            [f"jac_{of}_{by}" for of in names[1] for by in names[0]],
            dict.fromkeys(("enable_forward", "enable_reverse", "enable_jacobian"), False),  # no second derivatives
        )
        alone = dict.fromkeys(("enable_forward", "enable_reverse"), False) | {"is_diff_in": [True, False, False, False]}
        options = {"custom_jacobian": jacobian, "jac_penalty": 0, "never_inline": True, **alone}
        return ca.Function("changes", [z, *point], outputs, *names, options)


def units_of(graph: ControlGraph, unknowns: np.ndarray, scales: np.ndarray, cost: float) -> Units:
    """Units of `acting` at an optimum, from scales of the equations and the size of the cost."""
    kinds, cost = graph.numbering.unknown_kinds, cost or 1.0
    sizes = or_one(largest_of(np.abs(unknowns), kinds))[kinds]
    return np.stack((sizes, cost / sizes)), np.stack((or_one(scales), cost / or_one(scales)))


def sensitivity_of(
    problem: ControlProblem, graph: ControlGraph, at: Optimum, path: ControlTrajectory
) -> ControlSensitivity:
    """Derivatives of an optimum, of which the problem may leave out idle breakpoints of the path's."""
    if path.morse_index:
        directions = counted(path.morse_index, "direction")
        raise ValueError(f"sensitivity takes minima, got a saddle, from which the cost decreases in {directions}")
    numbers = graph.numbering
    report = graph.report(at.unknowns, at.data, at.multipliers)
    conditions = OptimalityConditions(graph, units_of(graph, at.unknowns, report.sizes[numbers.kinds], path.cost_size))
    shapes, seeds = _seeds(problem, numbers, at)
    point = [at.unknowns, at.multipliers, at.bound_multipliers]
    given = [at.data, *at.bounds.unknowns, *at.bounds.equations]
    matrix, weak = conditions.step(*point, *given)
    if float(weak):
        raise ValueError(
            "sensitivity takes optima whose bounds either act or are not met, got one that is met but hardly acts: the "
            "derivatives on its two sides differ. Move that bound, or the data, a little"
        )
    value, count = conditions.value, seeds[0].shape[1]
    still = [ca.DM(len(a), count) for a in point]
    missed, cost = value.forward(count)(*point, *given, *value(*point, *given), *still, *map(ca.DM, seeds))
    rows = np.concatenate((_solved(matrix, -missed.full())[: numbers.unknowns], seeds[0], cost.full()))

    def of(entries: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives of some entries of ξ, the data and the cost, by the name of what they are derivatives by."""
        parts = np.split(rows[entries], np.cumsum([np.prod(shape, dtype=int) for shape in shapes.values()]), axis=-1)
        return {name: a.reshape(*entries.shape, *shapes[name]) for name, a in zip(shapes, parts, strict=False)}

    found, parameters = numbers.whole(), numbers.chains[-1].fields["parameters"][-1]
    entries = found["x"].T, found["controls"].T, found["durations"], parameters, np.array(len(rows) - 1)
    return ControlSensitivity(path.t, *map(of, entries))


def _seeds(
    problem: ControlProblem, numbers: Numbering, at: Optimum
) -> tuple[dict[str, tuple[int, ...]], list[np.ndarray]]:
    """Shapes of all data by name, and how p and the four arrays of bounds change with each; one column for a datum.

    Bounds are linear in the data, so that their differences are exact but for rounding.
    """
    shapes, columns = dict[str, tuple[int, ...]](), list[list[np.ndarray]]()
    before = _sides(problem, numbers)
    for name in (*GIVEN, *SIDES, *LIMITS):
        stated = getattr(problem, name)
        if stated is None or (name == "parameters" and name in numbers.chains[0].free):
            continue
        values = np.array(stated[1:] if name in LIMITS else stated, dtype=float)  # NaN for None
        chosen = np.argwhere(~np.isnan(values))
        if not chosen.size:
            continue
        shapes[name] = (len(chosen),) if name in GIVEN else values.shape
        for index in map(tuple, chosen):
            moved, by = values.copy(), np.zeros(len(at.data))
            moved[index] += 1.0
            if name == "parameters":
                by[[chain.fields[name][0][index] - numbers.unknowns for chain in numbers.chains]] = 1.0
                sides = before
            else:
                changed = (stated[0], *moved) if name in LIMITS else moved
                sides = _sides(with_values(problem, **{name: changed}), numbers)
            with np.errstate(invalid="ignore"):  # of infinite bounds
                columns.append([by, *(np.nan_to_num(b - a) for a, b in zip(before, sides, strict=True))])
    return shapes, [np.column_stack(a) for a in zip(*columns, strict=True)]


def _sides(problem: ControlProblem, numbers: Numbering) -> tuple[np.ndarray, ...]:
    phases = sections(problem)
    bounds = bounds_of(phases, joined_sections(problem, phases), numbers)
    return *bounds.unknowns, *bounds.equations


def _solved(matrix: ca.DM, rhs: np.ndarray) -> np.ndarray:
    """Solutions of linear equations, refined once; refuses a matrix whose rounding changes them.

    The path then is no strict minimum to second order, or states something twice.
    """
    factors = factors_of(matrix.sparsity(), "qr")
    factors.nfact(matrix)
    solution = factors.solve(matrix, ca.DM(rhs))
    solution += factors.solve(matrix, rhs - ca.mtimes(matrix, solution))
    signs = np.random.default_rng(len(rhs)).choice((-1.0, 1.0), rhs.shape)
    rounding = factors.solve(matrix, EPS * signs * ca.mtimes(ca.fabs(matrix), ca.fabs(solution))).full()
    solution = solution.full()
    if not np.all(np.max(np.abs(rounding), axis=0) <= ROUNDED * (np.max(np.abs(solution), axis=0) + TINY)):
        raise ValueError(
            "sensitivity takes optima that cost and bounds determine to second order, got one whose derivatives are "
            "rounding alone: a control may cost nothing, or a bound state what others state"
        )
    return solution
