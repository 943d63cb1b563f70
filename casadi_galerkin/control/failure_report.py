"""Reports of a failed optimization: what is not finite at the guess, or how the solver ended; what to try.

Of a solver's last point they name what is violated worst, and when.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, sampling_parts
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.control.chain import Chain, located
from casadi_galerkin.control.embedding import ChainEmbedding
from casadi_galerkin.control.graph import ControlGraph
from casadi_galerkin.control.optimizer import Optimum
from casadi_galerkin.functional.buffers import interrupts_raised
from casadi_galerkin.functional.mapping import at_places
from casadi_galerkin.problems.bounds import FEASIBLE
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.dependence import CONTROLS, POSITIONS, VELOCITIES, entries_within
from casadi_galerkin.solution.control_path import ControlPath
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.path import Path

INVALID = "Invalid Number Detected"
OUT_OF_ITERATIONS = "Maximum Iterations Exceeded"
UNITS = "The solver's tolerances are absolute: take units in which cost, lengths, times and masses are near one"
NO_PATH = (
    "There may be no path within these ends and bounds; else try a guess nearer to it, several `starts`, or units in "
    "which lengths, times and masses are near one"
)
HINTS = {
    "Diverging Iterates": "The cost may have no lower bound: bound the controls, the positions or the duration",
    "Infeasible Problem Detected": NO_PATH,
    INVALID: "A callable or one of its derivatives is not finite there",
    "Maximum WallTime Exceeded": "Allow more seconds, or give a guess nearer to the path",
    "Solve Succeeded": f"{UNITS}, and bound a free duration",
    "Restoration Failed": NO_PATH,
}
OTHER_HINT = "Try a guess of path and controls, such as the answer on fewer intervals, or more intervals"
UNBOUNDED = "; the cost may have no lower bound"
KINK_HINTS = {  # by operations on controls in the running cost
    (ca.OP_FMAX, ca.OP_FMIN, ca.OP_LT, ca.OP_LE): (
        "The running cost holds fmax, fmin or a comparison of a control, and its derivative may jump there: replace "
        "fmax(a, b) by a further control e, and add e - a >= 0 and e - b >= 0 as path_constraint"
    ),
    (ca.OP_SQRT,): (
        "The running cost holds a root or norm of controls, whose derivative jumps where that is zero: a small number "
        "under the root keeps it smooth, as in sqrt(sumsqr(u) + 1e-4) for u near one; then a smaller one, with "
        "that answer as guess"
    ),
}

BENT = ca.OP_FABS, ca.OP_FMAX, ca.OP_FMIN, ca.OP_LT, ca.OP_LE  # operations on positions and velocities


def explained(
    problem: ControlProblem,
    solver: str,
    chain: Chain,
    optimum: Optimum,
    cost: float,
    relative: np.ndarray,
    path: PiecewisePolynomial,
) -> ConvergenceError:
    """Report how a solver ended; `relative` are the `violations` there, `path` is its last iterate."""
    worst, rows = int(np.argmax(relative)), chain.equations
    equation = worst < rows
    name, place = located(chain.equation_stages, worst) if equation else located(chain.unknown_stages, worst - rows)
    when = np.interp(place, np.arange(len(path.mesh)), path.mesh)
    what = name if equation else f"the bound of {name}"
    hint = HINTS.get(optimum.status, OTHER_HINT)
    if relative[worst] <= FEASIBLE:
        state = f"all constraints hold, with a cost of {cost:.6g}"
        hint = OTHER_HINT if hint is NO_PATH else hint
    else:
        state = f"the worst violated constraint is {what} at t = {when:.6g}, by {relative[worst]:.1e} of its terms"
    if hint is OTHER_HINT:
        hint = kink_hint(problem) or (hint + UNBOUNDED if cost < 0 else hint)
    if optimum.status == OUT_OF_ITERATIONS:
        state += (
            f". Its max_iter allows {optimum.iterations} iterations: take "
            f"solver=cg.ipopt.with_options(max_iter={2 * optimum.iterations}) for more"
        )
    stopped = f"{solver} stopped with '{optimum.status}' after {optimum.iterations} iterations"
    return ConvergenceError(f"{stopped}; {state}. {hint}", Path(path), float(relative[worst] / EPS), optimum.iterations)


def kink_hint(problem: ControlProblem) -> str | None:
    """What to do about a cost whose derivative may jump, if it may."""
    for kind, words in KINK_HINTS.items():
        if entries_within(problem.running_cost, CONTROLS, kind):
            return words
    for name, cost in (("running cost", problem.running_cost), ("terminal cost", problem.terminal_cost)):
        if cost is not None and any(entries_within(cost, argument, BENT) for argument in (POSITIONS, VELOCITIES)):
            return (
                f"The {name} holds fabs, fmax, fmin or a comparison of positions or velocities, and its derivative may "
                "jump there: smooth it, as sqrt(z**2 + 1e-6) does fabs(z)"
            )
    return None


def refuse_values(problem: ControlProblem, embedding: ChainEmbedding, values: dict[str, np.ndarray]) -> None:
    """Name the first callable that is not finite at the guess."""
    chain, points = embedding.chain, embedding.points
    seen = (embedding.matrix @ np.concatenate(chain.pack(values))).full().ravel()
    at = {name: seen[points.row(name)].T for name in points.rows}
    times, end = at["begin"] + at["duration"] * at["share"], values["begin"] + np.sum(values["durations"])
    state = [times, at["x"], at["slope"] / (at["duration"] * at["part"])]
    p = [] if problem.parameters is None else [values["parameters"]]
    inputs, rest = [*state, at["controls"], *p], np.zeros(chain.dimension - chain.mechanical)
    first, last = (
        [values["x"][i], np.append(values[f"{name}_velocity"], rest)] for i, name in ((0, "start"), (-1, "end"))
    )
    before = zip(problem.crossings, values["nodes"][chain.crossed - 1, -1], values["velocity"], strict=True)
    for name, function, arguments, when in (
        ("running_cost", problem.running_cost, inputs, times),
        ("force", problem.force, inputs, times),
        ("rates", problem.rates, inputs, times),
        ("path_constraint", problem.path_constraint[0], inputs, times),
        ("constraint", problem.constraint, [times, at["x"], *p], times),
        ("lagrangian", problem.lagrangian, [*state, *p], times),
        ("terminal_cost", problem.terminal_cost, [end, *last, *p], end),
        *(
            (name, function, [x, np.append(v, rest), *p], np.array(crossing.time))
            for crossing, x, v in before
            for name, function in crossing.functions
        ),
        ("end_conditions", problem.end_conditions[0], [*first, *last, *p], end),
    ):
        try:
            with interrupts_raised():
                found = ca.DM(0, 1) if function is None else ca.vertcat(*function.call(arguments))
        except RuntimeError as error:
            reason = f"{name} calls a casadi Function that fails at the guess. Give a guess that avoids it"
            raise ValueError(reason) from error
        wrong = ~np.isfinite(np.array(found)).all(axis=0)
        if np.any(wrong):
            k = int(np.argmax(wrong))
            raise ValueError(
                f"{name} is not finite at the guess: {np.array(found)[:, k]} at t = {when.ravel()[k]:.6g}. "
                "Give a guess that avoids it"
            )


def undefined(
    problem: ControlProblem, path: PiecewisePolynomial, control: ControlPath, parameters: tuple[float, ...] | None
) -> str | None:
    """Say where a callable is not finite along a path, between its nodes, with the path and its controls in bounds."""
    parts = sampling_parts(path.degree)[1:-1]
    t, x, v = path.sampled(parts)
    x, u = (
        np.clip(values, *(np.reshape(side, (-1, 1)) for side in bounds))
        for values, bounds in ((x, problem.position_bounds), (control.at(parts), problem.control_bounds))
    )
    p = () if parameters is None else (parameters,)
    named = {
        "running_cost": problem.running_cost,
        "force": problem.force,
        "rates": problem.rates,
        "path_constraint": problem.path_constraint[0],
        "lagrangian": problem.lagrangian,
    }
    (total,) = at_places(_summed(*named.values()), t, x, v, u, shared=p)
    if np.isfinite(total).all():
        return None
    k = int(np.argmin(np.isfinite(total[0])))
    at = [t[k], x[:, k], v[:, k], u[:, k]]
    for name, function in named.items():
        value = np.array(function(*at[: 3 if name == "lagrangian" else 4], *p)).ravel()
        if not np.isfinite(value).all():
            return (
                f"{name} is {value[~np.isfinite(value)][0]} between the points of the path at t = {t[k]:.6g}, where "
                f"x = {x[:, k].tolist()}. Keep the path away from there with position_bounds or a path_constraint, or "
                "take more intervals"
            )
    return None  # values that are finite, and so large that their sum is not


@lru_cache(8)
def _summed(*functions: ca.Function) -> ca.Function:
    """(t, x, v, u[, p]) -> the sum of all values, finite where all of them are; the last Function takes no controls."""
    t, x, v, _, *p = symbols = functions[0].sx_in()
    *along, lagrangian = functions
    values = [f(*symbols) for f in along] + [lagrangian(t, x, v, *p)]
    return ca.Function("summed", symbols, [ca.sum1(ca.vertcat(*values))])


def refuse_derivatives(graph: ControlGraph, unknowns: np.ndarray, data: np.ndarray, mesh: np.ndarray) -> None:
    """Name a first derivative that is not finite at the guess."""
    chain, gradient = graph.chain, np.array(graph.gradient(unknowns, data)[1]).ravel()
    matrix = graph.jacobian(unknowns, data)[1]
    entries = np.isfinite(np.array(matrix.nonzeros()))
    if not np.all(np.isfinite(gradient)):
        name, place = located(chain.unknown_stages, int(np.argmax(~np.isfinite(gradient))))
        what = f"the derivative of the cost by {name}"
    elif not np.all(entries):
        name, place = located(chain.equation_stages, matrix.sparsity().row()[int(np.argmax(~entries))])
        what = f"a derivative of {name}"
    else:
        return
    when = np.interp(place, np.arange(len(mesh)), mesh)
    hint = "Give a guess that avoids it, or add a small number under a root, as in sqrt(sumsqr(u) + 1e-4) for a norm"
    raise ValueError(f"{what} is not finite at the guess at t = {when:.6g}. {hint}")
