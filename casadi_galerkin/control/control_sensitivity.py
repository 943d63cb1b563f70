"""Derivatives of an optimum by its data, by the implicit function theorem, and a solve as a Function that has them.

Let A be the bounds on unknowns and equations that act at the optimum: given values and equations among them.  While no
other bound begins to act, and none ceases to, the optimum solves

    ∇f̄(ξ, λ, p) = 0 for free unknowns,        ξ = b for those at bounds,        G(ξ, p) = g in A,        λ = 0 else,

and its derivative by the data, in which p, b and g are linear, comes from the matrix of a Newton step to it.  That of
the cost needs no matrix: it is that of f̄ - λ·g - μ·b at the fixed optimum, with the multipliers μ of the bounds on ξ.

A bound that is met, but hardly acts, has another derivative on either side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.numbers import counted
from casadi_galerkin.calculus.roundoff import EPS, TINY, largest_of, or_one
from casadi_galerkin.control.control_graph import ControlGraph, equation_scales
from casadi_galerkin.control.control_numbering import Numbering, bounds_of
from casadi_galerkin.control.initial_guess import starting_point
from casadi_galerkin.control.optimizer import BOUND_RELAXATION, TOLERANCE, Optimum
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.linear_equations import NO_CUTOFF
from casadi_galerkin.problems.phases import parted
from casadi_galerkin.problems.problem import with_values
from casadi_galerkin.problems.statements import FEASIBLE
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solvers.derivatives import Sensitivity, solved, verified_function
from casadi_galerkin.solvers.linear_solver import all_finite
from casadi_galerkin.solvers.solver import Solver

WEAK = (
    10 * TOLERANCE**0.5
)  # relative gap and force, up to ten times the root of the barrier, of a bound that hardly acts
GIVEN = "start", "end", "start_velocity", "end_velocity", "parameters"
SIDES = "position_bounds", "control_bounds", "duration_bounds", "parameter_bounds"
LIMITS = "path_constraint", "end_conditions"  # (g, lower, upper bounds)
Units: TypeAlias = tuple[np.ndarray, np.ndarray]
MOST_ROUNDING = EPS**0.5  # relative error by rounding from which derivatives are refused: half of the digits


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


@dataclass(frozen=True)
class Data:
    """The data of a program as numbers, in which its parameters p and its bounds are linear.

    Attributes
    ----------
    shapes : of every datum, by name
    values : all of them, one after the other
    given : p, lower and upper bounds of ξ and of the equations
    seeds : derivatives of these by the values
    """

    shapes: dict[str, tuple[int, ...]]
    values: np.ndarray
    given: list[np.ndarray]
    seeds: list[np.ndarray]

    def at(self, values: ca.MX, given: Sequence[np.ndarray] | None = None) -> list[ca.MX]:
        """What is given, or other bounds that depend on the data in the same way, at other values."""
        pairs = zip(self.given if given is None else given, self.seeds, strict=True)
        return [ca.DM(a - seed @ self.values) + ca.mtimes(ca.sparsify(ca.DM(seed)), values) for a, seed in pairs]


def data_of(problem: ControlProblem, numbers: Numbering, p: np.ndarray, names: Sequence[str]) -> Data:
    """Those data of a problem that have these names, and what they change, by differences; `p` as far as it is fixed.

    Bounds are linear in the data, so that their differences are exact but for rounding.
    """
    shapes, found, columns = dict[str, tuple[int, ...]](), list[float](), list[list[np.ndarray]]()
    before = given_by(problem, numbers, p)
    for name in names:
        stated = getattr(problem, name)
        if stated is None or (name == "parameters" and name in numbers.chains[0].free):
            continue
        values = np.array(stated[1:] if name in LIMITS else stated, dtype=float)  # NaN for None
        chosen = np.argwhere(~np.isnan(values))
        if not chosen.size:
            continue
        shapes[name] = (len(chosen),) if name in GIVEN else values.shape
        for index in map(tuple, chosen):
            moved = values.copy()
            moved[index] += 1.0
            found.append(values[index] if np.isfinite(values[index]) else 0.0)  # infinite bounds change nothing
            changed = (stated[0], *moved) if name in LIMITS else tuple(moved.tolist())
            after = given_by(with_values(problem, **{name: changed}), numbers, p)
            with np.errstate(invalid="ignore"):  # of infinite bounds
                columns.append([np.nan_to_num(b - a) for a, b in zip(before, after, strict=True)])
    seeds = [np.column_stack(a) for a in zip(*columns, strict=True)]
    return Data(shapes, np.array(found), before, seeds)


def given_by(problem: ControlProblem, numbers: Numbering, p: np.ndarray, implied: bool = False) -> list[np.ndarray]:
    """The p of a problem, where other numbers of it are fixed, and its bounds; `implied` as for `bounds_of`."""
    parts, p = parted(problem), p.copy()
    for phase, chain in zip(parts.phases, numbers.chains, strict=True):
        if "parameters" not in chain.free and phase.parameters is not None:
            p[chain.fields["parameters"][0] - numbers.unknowns] = phase.parameters
    bounds = bounds_of(parts.phases, parts.joins, numbers, implied)
    return [p, *bounds.unknowns, *bounds.equations]


def optimality_conditions(graph: ControlGraph, units: Units, data: Data) -> ca.Function:
    """(ξ, λ, μ, data) -> the matrix of a Newton step, whether a bound hardly acts, and derivatives by the data.

    The step of (ξ, λ) is minus what is missed, times the inverse of the matrix; derivatives are those of what is
    missed and of f̄ - λ·g - μ·b.  The bounds that act there are kept.

    Parameters
    ----------
    units : those of `acting`, of the unknowns and of the equations
    """
    x, values = graph.unknowns, ca.MX.sym("data", len(data.values))
    multipliers, of_bounds = ca.MX.sym("λ", graph.equations.numel()), ca.MX.sym("μ", x.numel())
    p, low, high, least, most = data.at(values)
    slope, hessian = graph.whole_hessian(x, p, 1, multipliers)
    equations, gradients = graph.jacobian(x, p)
    held, at, weak = acting(x, of_bounds, (low, high), units[0])
    kept, asked, weakly = acting(equations, multipliers, (least, most), units[1])
    off, missing = ca.if_else(held, x - at, 0.0), ca.if_else(kept, equations - asked, 0.0)
    free, across = ca.diag(ca.logic_not(held)), ca.mtimes(ca.diag(kept), gradients)
    upper = ca.horzcat(ca.mtimes(free, hessian) + ca.diag(held), ca.mtimes(free, gradients.T))
    matrix = ca.vertcat(upper, ca.horzcat(across, ca.diag(ca.logic_not(kept))))
    missed = ca.vertcat(off + ca.if_else(held, 0.0, slope), missing + ca.if_else(kept, 0.0, multipliers))
    lagrangian = graph.gradient(x, p)[0] + ca.dot(multipliers, missing) + ca.dot(of_bounds, off)
    # backwards, CasADi 3.8.0 fails at a call that returns a sparse matrix as well
    forward = {"helper_options": {"ad_weight": 0.0}}
    by_data = (ca.densify(ca.jacobian(a, values, forward)) for a in (missed, lagrangian))
    return ca.Function("conditions", [x, multipliers, of_bounds, values], [matrix, ca.fmax(weak, weakly), *by_data])


def _changes(conditions: ca.Function) -> ca.Function:
    """(ξ, λ, μ, data) -> zeros with the first derivatives of ξ and of the cost at an optimum by the data.

    Nothing is evaluated before a derivative is asked for.  Where a bound hardly acts, derivatives are not finite.
    """
    *point, data = inputs = conditions.mx_in()
    matrix, weak, missed, cheaper = conditions(*inputs)
    step = -ca.solve(matrix, missed, "qr", NO_CUTOFF)[: point[0].numel(), :]
    infinite, zero = ca.if_else(weak, np.inf, 0.0), ca.fmin(ca.fabs(ca.sum1(data)), 0.0)  # which depends on the data
    outputs = {"change": ca.repmat(zero, point[0].numel(), 1), "cheaper": zero}
    names, blocks = ["x", "lam_g", "lam_x", "data"], dict[str, ca.MX]()
    for (of, out), by in zip(outputs.items(), (step, cheaper), strict=True):
        blocks |= {f"jac_{of}_{name}": ca.MX(out.numel(), at.numel()) for name, at in zip(names, point, strict=False)}
        blocks[f"jac_{of}_data"] = by + infinite
    unused = {f"out_{of}": ca.MX.sym("unused", *out.shape) for of, out in outputs.items()}
    jacobian = ca.Function(
        "jac_changes",
        [*inputs, *unused.values()],
        list(blocks.values()),
        [*names, *unused],
        list(blocks),
        dict.fromkeys(("enable_forward", "enable_reverse", "enable_jacobian"), False),  # no second derivatives
    )
    alone = dict.fromkeys(("enable_forward", "enable_reverse"), False) | {"is_diff_in": [False, False, False, True]}
    options = {"custom_jacobian": jacobian, "jac_penalty": 0, "never_inline": True, **alone}
    return ca.Function("changes", inputs, list(outputs.values()), names, list(outputs), options)


def units_of(graph: ControlGraph, unknowns: np.ndarray, scales: np.ndarray, cost: float) -> Units:
    """Units of `acting` at an optimum, from scales of the equations and the size of the cost."""
    kinds, cost = graph.numbering.unknown_kinds, cost or 1.0
    sizes = or_one(largest_of(np.abs(unknowns), kinds))[kinds]
    return np.stack((sizes, cost / sizes)), np.stack((or_one(scales), cost / or_one(scales)))


def sensitivity_of(problem: ControlProblem, graph: ControlGraph, at: Optimum, path: ControlTrajectory) -> Sensitivity:
    """Derivatives of an optimum, of which the problem may leave out idle breakpoints of the path's."""
    if path.morse_index:
        directions = counted(path.morse_index, "direction")
        raise ValueError(f"sensitivity takes minima, got a saddle, from which the cost decreases in {directions}")
    numbers = graph.numbering
    report = graph.report(at.unknowns, at.data, at.multipliers)
    data = data_of(problem, numbers, at.data, (*GIVEN, *SIDES, *LIMITS))
    units = units_of(graph, at.unknowns, report.sizes[numbers.kinds], path.cost_size)
    conditions = optimality_conditions(graph, units, data)
    matrix, weak, missed, cost = conditions(at.unknowns, at.multipliers, at.bound_multipliers, data.values)
    if float(weak):
        raise ValueError(
            "sensitivity takes optima whose bounds either act or are not met, got one that is met but hardly acts: the "
            "derivatives on its two sides differ. Move that bound, or the data, a little"
        )
    (solution, rounding), shapes = solved(matrix, -missed.full()), data.shapes
    if not np.all(np.max(np.abs(rounding), axis=0) <= MOST_ROUNDING * (np.max(np.abs(solution), axis=0) + TINY)):
        raise ValueError(
            "sensitivity takes optima that cost and bounds determine to second order, got one whose derivatives are "
            "rounding alone: a control may cost nothing, or a bound state what others state"
        )
    rows = np.concatenate((solution[: numbers.unknowns], data.seeds[0], cost.full()))

    def of(entries: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives of some entries of ξ, the data and the cost, by the name of what they are derivatives by."""
        parts = np.split(rows[entries], np.cumsum([np.prod(shape, dtype=int) for shape in shapes.values()]), axis=-1)
        return {name: a.reshape(*entries.shape, *shapes[name]) for name, a in zip(shapes, parts, strict=False)}

    found, parameters = numbers.whole(), numbers.chains[-1].fields["parameters"][-1]
    entries = found["x"].T, found["controls"].T, found["durations"], parameters, np.array(len(rows) - 1)
    return Sensitivity(path.t, *map(of, entries))


def control_function(transcription: Any, path: ControlTrajectory, solver: Solver) -> ca.Function:
    """A ControlTranscription with an optimum that it found as a Function of its data; see `solution_function`."""
    problem, graph, numbers = transcription.problem, transcription.graph, transcription.numbering
    start = starting_point(graph, problem, transcription.calculus, path)
    unknowns, p = numbers.pack(start.values)
    sizes = equation_scales(numbers, transcription.bounds, graph.report(unknowns, p), start.sizes)
    data = data_of(problem, numbers, p, GIVEN)
    values = {name: ca.MX.sym(name, *shape) for name, shape in data.shapes.items()}
    inputs, known = ca.vertcat(*values.values()), ca.fabs(ca.vertcat(*values.values())) < np.inf
    allowed = ca.mmin(known)
    for name in {"start", "end"} & set(values):
        given = [value is not None for value in getattr(problem, name)]
        least, most = (ca.DM(side[given]) for side in np.array(problem.position_bounds))
        allowed = ca.logic_and(allowed, ca.mmin(ca.logic_and(least <= values[name], values[name] <= most)))
    finite = ca.if_else(known, inputs, ca.DM(data.values))  # the solver refuses NaN
    programmed = transcription.bounds.narrowed(BOUND_RELAXATION[solver.name])
    p_at, *narrow = data.at(finite, [p, *programmed.unknowns, *programmed.equations])
    # ends that are data may violate a constraint
    _, *stated = data.at(finite, given_by(problem, numbers, p, implied=True))
    chain, fields, degree = numbers.chains[0], numbers.whole(), transcription.method.degree
    intervals = len(transcription.mesh) - 1
    nodes = ca.MX.sym("guess", chain.dimension, intervals * degree + 1)
    controls = ca.MX.sym("controls", chain.controls, intervals * len(chain.control_times))
    first, joint = ca.MX(ca.DM(unknowns)), 0
    for part in numbers.chains:
        local = nodes[:, joint * degree : (joint + part.intervals) * degree + 1]
        first[part.fields["x"].ravel().tolist()] = ca.vec(local[:, ::degree])
        first[part.fields["nodes"].ravel().tolist()] = ca.vec(local[:, 1:])
        joint += part.intervals
    first[fields["controls"].ravel().tolist()] = ca.vec(controls)
    program, sides = transcription.program(solver, warm=False, verbose=0), ("lbx", "ubx", "lbg", "ubg")
    found = _undifferentiated(program)(x0=first, p=p_at, **dict(zip(sides, narrow, strict=True)))
    point = [found[name] for name in ("x", "lam_g", "lam_x")]
    violation, slope = _violation(graph, sizes)(*point, p_at, *stated)
    verified = ca.logic_and(allowed, ca.logic_and(violation <= FEASIBLE, slope <= FEASIBLE))
    conditions = optimality_conditions(graph, units_of(graph, unknowns, sizes, path.cost_size), data)
    moved, cheaper = _changes(conditions)(*point, finite)
    everything = ca.vertcat(point[0] + moved, p_at)
    outputs = {
        "x": ca.reshape(everything[fields["x"].ravel().tolist()], chain.dimension, -1),
        "u": ca.reshape(everything[fields["controls"].ravel().tolist()], *controls.shape),
        "duration": ca.sum1(everything[fields["durations"].tolist()]),
        "cost": found["f"] + cheaper,
    }
    guesses = {"guess": nodes, "controls": controls}
    return verified_function(values | guesses, outputs, verified, list(guesses))


def _undifferentiated(program: ca.Function) -> ca.Function:
    """The same Function with derivatives of zero: those of an optimum are `_changes`."""
    names, inputs = (program.name_in(), program.name_out()), program.mx_in()
    without = {"is_diff_in": [False] * len(inputs), "is_diff_out": [False] * program.n_out(), "never_inline": True}
    return ca.Function("found", inputs, program.call(inputs), *names, without)


def _violation(graph: ControlGraph, sizes: np.ndarray) -> ca.Function:
    """(ξ, λ, μ, data, bounds) -> largest relative violations of equations and bounds, and of stationarity."""
    x, data, counts = graph.unknowns, graph.data, (graph.unknowns.numel(), len(sizes))
    given = [ca.MX.sym("given", counts[k]) for k in (1, 0, 0, 0, 1, 1)]
    multipliers, of_bounds, low, high, least, most = given
    equations, bounds = (
        ca.fmax(ca.fmax(a - b, b - c), 0) for a, b, c in ((least, graph.equations, most), (low, x, high))
    )
    slope, _ = graph.whole_hessian(x, data, 1, multipliers)
    terms = 1 + ca.norm_inf(graph.gradient(x, data)[1]) + ca.norm_inf(of_bounds)
    worst = ca.fmax(ca.norm_inf(equations / sizes), ca.norm_inf(bounds / ca.fmax(1, ca.fabs(x))))
    finite = all_finite(x, graph.equations, slope)
    outputs = [ca.if_else(finite, worst, np.inf), ca.norm_inf(slope + of_bounds) / terms]
    return ca.Function("violation", [x, multipliers, of_bounds, data, low, high, least, most], outputs)
