"""Reports of a failed optimization: what is not finite at the guess, or how the solver ended; what to try.

Of a solver's last point they name what is violated worst, and when.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, sampling_parts
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.control.control_graph import ControlGraph
from casadi_galerkin.control.control_numbering import Numbering, Stages, located
from casadi_galerkin.control.optimizer import Optimum
from casadi_galerkin.functional.buffers import Evaluator
from casadi_galerkin.functional.pointwise import at_places
from casadi_galerkin.problems.callables import entries_within
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.statements import FEASIBLE
from casadi_galerkin.solution.control_path import ControlPath
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.path import Path

INVALID = "Invalid Number Detected"
OUT_OF_ITERATIONS = "Maximum Iterations Exceeded"
UNITS = "The solver's tolerances are absolute: take units in which cost, lengths, times and masses are near one"
NONE_WITHIN_BOUNDS = (
    "There may be no path within these ends and bounds; else try a guess nearer to it, several `starts`, or units in "
    "which lengths, times and masses are near one"
)
HINTS = {
    "Diverging Iterates": "The cost may have no lower bound: bound the controls, the positions or the duration",
    "Infeasible Problem Detected": NONE_WITHIN_BOUNDS,
    INVALID: "A callable or one of its derivatives is not finite there",
    "Maximum WallTime Exceeded": "Allow more seconds, or give a guess nearer to the path",
    "Solve Succeeded": f"{UNITS}, and bound a free duration",
    "Restoration Failed": NONE_WITHIN_BOUNDS,
}
OTHER_HINT = "Try a guess of path and controls, such as the answer on fewer intervals, or more intervals"
UNDEFINED_SOMEWHERE = frozenset(
    getattr(ca, f"OP_{name}")
    for name in "DIV INV SQRT LOG LOG1P EXP POW CONSTPOW TAN ASIN ACOS ATANH ACOSH FMOD CALL".split()  # noqa: SIM905
)
AVOID = "Give a guess that avoids it, or add a small number under a root, as in sqrt(sumsqr(u) + 1e-4) for a norm"
UNBOUNDED = "; the cost may have no lower bound"
BENT = ca.OP_FABS, ca.OP_FMAX, ca.OP_FMIN, ca.OP_LT, ca.OP_LE
KINKS = {"u": (ca.OP_SQRT, *BENT), "x": BENT, "v": BENT}  # operations whose derivatives may jump
SMOOTH = (
    "holds fabs, fmax, fmin, a comparison, or a root or norm of controls, and its derivative may jump there: write "
    "sqrt(z**2 + 1e-6) for fabs(z), put a small number under a root, as in sqrt(sumsqr(u) + 1e-4), and for fmax(a, b) "
    "a further control e, with e - a >= 0 and e - b >= 0 as path_constraint"
)


def explained(
    phases: Sequence[ControlProblem],
    solver: str,
    numbering: Numbering,
    optimum: Optimum,
    cost: float,
    relative: np.ndarray,
    paths: Sequence[PiecewisePolynomial],
) -> ConvergenceError:
    """Report how a solver ended; `relative` are the `violations` there, `paths` are its last iterates."""
    worst, rows = int(np.argmax(relative)), numbering.equations
    equation = worst < rows
    stages = numbering.equation_stages if equation else numbering.unknown_stages
    meshes = [path.mesh for path in paths]
    name, when, k = _at_time(numbering, stages, worst if equation else worst - rows, meshes)
    path, problem = paths[k], phases[k]
    what = name if equation else f"the bound of {name}"
    hint = HINTS.get(optimum.status, OTHER_HINT)
    if relative[worst] <= FEASIBLE:
        state = f"all constraints hold, with a cost of {cost:.6g}"
        hint = OTHER_HINT if hint is NONE_WITHIN_BOUNDS else hint
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


def _at_time(numbering: Numbering, stages: Stages, number: int, meshes: Sequence[np.ndarray]) -> tuple[str, float, int]:
    """What messages call an entry, its time, and its phase."""
    name, place = located(stages, number)
    cuts, times = np.cumsum([len(mesh) for mesh in meshes]), np.concatenate(meshes)
    k = int(np.searchsorted(cuts, place, side="right"))
    when = float(np.interp(place, np.arange(len(times)), times))
    return name + ("" if numbering.alike else f" of phase {k}"), when, k


def kink_hint(problem: ControlProblem) -> str | None:
    """What to do about a cost whose derivative may jump, if it may."""
    if any(entries_within(problem.running_cost, argument, kinks) for argument, kinks in KINKS.items()):
        return f"The running cost {SMOOTH}"
    cost = problem.terminal_cost
    if cost is not None and any(entries_within(cost, argument, BENT) for argument in ("x", "v")):
        return f"The terminal cost {SMOOTH}"
    return None


def refuse_not_finite(
    phases: Sequence[ControlProblem], graph: ControlGraph, unknowns: np.ndarray, data: np.ndarray
) -> None:
    """Name what is not finite at the guess: a callable along the path, or else an equation or a first derivative."""
    numbering = graph.numbering
    values, points = numbering.unpack(unknowns, data), [place for place in graph.places if place.integrated]
    inputs = (graph.matrix @ np.concatenate((unknowns, data))).full().ravel()
    for problem, place, given in zip(phases, points, values, strict=True):
        at = place.named(inputs)
        times, v = (at["begin"] + at["duration"] * at["fraction"]).ravel(), at["slope"] / (at["duration"] * at["part"])
        p = [] if problem.parameters is None else [given["parameters"]]
        found = _undefined_at(problem, times, at["x"], v, at["controls"], p)
        if found is not None:
            name, k, _, failure = found
            what = "is not finite" if failure is None else "calls a casadi Function that fails"
            words = f"{name} {what} at the guess, at t = {times[k]:.6g}. Give a guess that avoids it"
            raise ValueError(words) from failure
    meshes = [np.append(of["begin"] + of["duration"] * of["left"], of["begin"] + of["duration"]) for of in values]
    equations, matrix = graph.jacobian(unknowns, data)
    rows = np.array(matrix.sparsity().row())[~np.isfinite(np.array(matrix.nonzeros()))]
    for what, stages, wrong in (
        ("{}", numbering.equation_stages, np.flatnonzero(~np.isfinite(np.array(equations)))),
        (
            "the derivative of the cost by {}",
            numbering.unknown_stages,
            np.flatnonzero(~np.isfinite(np.array(graph.gradient(unknowns, data)[1]))),
        ),
        ("a derivative of {}", numbering.equation_stages, rows),
    ):
        if wrong.size:
            name, when, _ = _at_time(numbering, stages, int(wrong[0]), meshes)
            raise ValueError(f"{what.format(name)} is not finite at the guess, at t = {when:.6g}. {AVOID}")


def undefined(
    problem: ControlProblem, path: PiecewisePolynomial, control: ControlPath, parameters: tuple[float, ...] | None
) -> str | None:
    """Say where a callable is not finite along a path, between its nodes, with the path in its bounds."""
    if not _may_be_undefined(*_along(problem).values()):
        return None
    parts = sampling_parts(path.degree)[1:-1]
    t, x, v = path.sampled(parts)
    x = np.clip(x, *(np.reshape(side, (-1, 1)) for side in problem.position_bounds))
    found = _undefined_at(problem, t, x, v, control.at(parts), () if parameters is None else (parameters,))
    if found is None:
        return None
    name, k, value, _ = found
    return (
        f"{name} is {value} between the points of the path at t = {t[k]:.6g}, where x = {x[:, k].tolist()}. Keep the "
        "path away from there with position_bounds or a path_constraint, or take more intervals"
    )


def _undefined_at(
    problem: ControlProblem, t: np.ndarray, x: np.ndarray, v: np.ndarray, u: np.ndarray, p: Sequence[ArrayLike]
) -> tuple[str, int, float, RuntimeError | None] | None:
    """The first callable that is not finite at places (rows, K), the place, the value, and why it has failed if so."""
    named = _along(problem)
    (total,) = at_places(_summed(*named.values()), t, x, v, u, shared=p)
    if np.isfinite(total).all():
        return None
    k = int(np.argmin(np.isfinite(total[0])))
    for name, function in named.items():
        evaluate, place = Evaluator(function), [t[k : k + 1], x[:, k], v[:, k], u[:, k]]
        (value,) = evaluate(*place[: 3 if name == "lagrangian" else 4], *p)
        if not np.isfinite(value).all():
            return name, k, value[~np.isfinite(value)][0], evaluate.failure
    return None  # values that are finite, and so large that their sum is not


def _along(problem: ControlProblem) -> dict[str, ca.Function]:
    """The callables along the path, by name; the last takes no controls."""
    named = {name: getattr(problem, name) for name in ("running_cost", "force", "rates")}
    return {**named, "path_constraint": problem.limits[0], "lagrangian": problem.lagrangian}


@lru_cache(8)
def _may_be_undefined(*functions: ca.Function) -> bool:
    """Whether a Function holds an operation that is not finite for all numbers, but a division by a constant."""
    for f in functions:
        constants = set[int]()  # places that hold one
        for k in range(f.n_instructions()):
            what, places = f.instruction_id(k), f.instruction_output(k)
            if what in UNDEFINED_SOMEWHERE and not (what == ca.OP_DIV and f.instruction_input(k)[1] in constants):
                return True
            constants = constants.union(places) if what == ca.OP_CONST else constants.difference(places)
    return False


@lru_cache(8)
def _summed(*functions: ca.Function) -> ca.Function:
    """(t, x, v, u[, p]) -> the sum of all values, finite where all of them are; the last Function takes no controls."""
    t, x, v, _, *p = symbols = functions[0].sx_in()
    *along, lagrangian = functions
    values = [f(*symbols) for f in along] + [lagrangian(t, x, v, *p)]
    return ca.Function("summed", symbols, [ca.sum1(ca.vertcat(*values))])
