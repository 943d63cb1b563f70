"""A trajectory optimization as one CasADi Function of its data, to simulate with or to embed in a larger graph."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.control.control_graph import ControlGraph
from casadi_galerkin.control.control_numbering import Numbering
from casadi_galerkin.control.control_sensitivity import OptimalityConditions, units_of
from casadi_galerkin.control.control_transcription import transcribed_control
from casadi_galerkin.control.optimizer import BOUND_RELAXATION
from casadi_galerkin.control.program_bounds import bounds_of, equation_scales, given_at_ends
from casadi_galerkin.problems.bounds import FEASIBLE
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solvers.linear_solver import all_finite
from casadi_galerkin.solvers.solver import Solver
from casadi_galerkin.solvers.verified_function import verified_function


def control_function(
    problem: ControlProblem,
    method: Galerkin,
    intervals: int | None,
    mesh: ArrayLike | None,
    guess: Guess | None,
    solver: Solver,
) -> ca.Function:
    """Turn an optimization into a Function; see `solution_function` for the arguments."""
    transcription = transcribed_control(problem, method, intervals, mesh)
    path = transcription.solve(guess=guess, solver=solver)
    numbers, bounds, phases = transcription.numbering, transcription.bounds, transcription.phases
    start = transcription.starting_point(problem, transcription.calculus, path)
    known = numbers.pack(start.values)
    sizes = equation_scales(phases, numbers, bounds, transcription.graph.report(*known), start.sizes)
    first, data = (ca.MX(ca.DM(part)) for part in known)
    # ends that are data may violate a constraint
    checked_by = bounds_of(phases, transcription.joins, numbers, implied=True)
    programmed = bounds.narrowed(BOUND_RELAXATION[solver.name])
    stated, narrow = ([ca.MX(ca.DM(side)) for side in (*b.unknowns, *b.equations)] for b in (checked_by, programmed))
    inputs, allowed = {}, ca.MX(1)
    for name, (entries, *others) in _given(phases, numbers).items():
        inputs[name] = ca.MX.sym(name, len(entries))
        number = ca.fabs(inputs[name]) < np.inf
        allowed = ca.logic_and(allowed, ca.mmin(number))
        if name in ("start", "end"):
            given = [value is not None for value in getattr(problem, name)]
            least, most = (ca.DM(side[given]) for side in np.array(problem.position_bounds))
            allowed = ca.logic_and(allowed, ca.mmin(ca.logic_and(least <= inputs[name], inputs[name] <= most)))
        value = ca.if_else(number, inputs[name], ca.DM(np.concatenate(known)[entries]))  # the solver refuses NaN
        if name == "parameters":
            for of_phase in (entries, *others):
                data[(of_phase - numbers.unknowns).tolist()] = value
        else:
            for side in (*stated[:2], *narrow[:2]):
                side[entries.tolist()] = value
    symbols = list(inputs.values())
    f, degree, intervals = numbers.whole(), method.degree, len(transcription.mesh) - 1
    chain = numbers.chains[0]
    inputs["guess"] = ca.MX.sym("guess", chain.dimension, intervals * degree + 1)
    inputs["controls"] = ca.MX.sym("controls", chain.controls, intervals * len(chain.control_times))
    joint = 0
    for part in numbers.chains:
        nodes = inputs["guess"][:, joint * degree : (joint + part.intervals) * degree + 1]
        first[part.fields["x"].ravel().tolist()] = ca.vec(nodes[:, ::degree])
        first[part.fields["nodes"].ravel().tolist()] = ca.vec(nodes[:, 1:])
        joint += part.intervals
    first[f["controls"].ravel().tolist()] = ca.vec(inputs["controls"])
    program, sides = transcription.program(solver, warm=False, verbose=0), ("lbx", "ubx", "lbg", "ubg")
    found = _undifferentiated(program)(x0=first, p=data, **dict(zip(sides, narrow, strict=True)))
    multipliers = found["lam_g"], found["lam_x"]
    violation, slope = _violation(transcription.graph, sizes)(found["x"], data, *multipliers, *stated)
    verified = ca.logic_and(allowed, ca.logic_and(violation <= FEASIBLE, slope <= FEASIBLE))
    units = units_of(transcription.graph, known[0], sizes, path.cost_size)
    point = [found[name] for name in ("x", "lam_g", "lam_x")]
    changes = OptimalityConditions(transcription.graph, units).changes(symbols, [data, *narrow])
    moved, cheaper = changes(ca.vertcat(*symbols), *point)
    everything = ca.vertcat(point[0] + moved, data)
    outputs = {
        "x": ca.reshape(everything[f["x"].ravel().tolist()], chain.dimension, -1),
        "u": ca.reshape(everything[f["controls"].ravel().tolist()], *inputs["controls"].shape),
        "duration": ca.sum1(everything[f["durations"].tolist()]),
        "cost": found["f"] + cheaper,
    }
    return verified_function(inputs, outputs, verified, ["guess", "controls"])


def _undifferentiated(program: ca.Function) -> ca.Function:
    """The same Function with derivatives of zero: those of an optimum are `OptimalityConditions.changes`."""
    names, inputs = (program.name_in(), program.name_out()), program.mx_in()
    without = {"is_diff_in": [False] * len(inputs), "is_diff_out": [False] * program.n_out(), "never_inline": True}
    return ca.Function("found", inputs, program.call(inputs), *names, without)


def _given(phases: Sequence[ControlProblem], numbers: Numbering) -> dict[str, list[np.ndarray]]:
    """Entries of ξ that the problem gives, by name, in each phase that has them; names without entries are left out."""
    ends = [given_at_ends(*each) for each in zip(phases, numbers.chains, strict=True)]
    entries = {name: [ends[0 if name.startswith("start") else -1][name][0]] for name in ends[0]}
    if "parameters" not in numbers.chains[0].free:
        entries["parameters"] = [chain.fields["parameters"][0] for chain in numbers.chains]
    return {name: index for name, index in entries.items() if index[0].size}


def _violation(graph: ControlGraph, sizes: np.ndarray) -> ca.Function:
    """(ξ, data, λ, μ, bounds) -> largest relative violations of equations and bounds, and of stationarity."""
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
    return ca.Function("violation", [x, data, *given], outputs)
