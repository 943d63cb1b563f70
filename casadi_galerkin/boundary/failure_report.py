"""Reports of a boundary problem that was not solved: the failure, its time, the last iterate, and what to try."""

from __future__ import annotations

import math

import numpy as np

from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import TINY
from casadi_galerkin.functional.buffers import Evaluator
from casadi_galerkin.functional.embedding import embedding
from casadi_galerkin.functional.functional import Functional
from casadi_galerkin.functional.numbering import Data, joints_of
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.solution.errors import ConjugatePointError, ConvergenceError
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solvers.newton import Solution, SolveFailure
from casadi_galerkin.solvers.stationarity import Stationarity, joined

NO_CHANGE = 0.01  # part of the largest change of a variation that counts as none
ISOLATE = "Move an end, change the time span, or fix a component that a symmetry leaves free"


def not_finite(functional: Functional, unknowns: np.ndarray, data: Data) -> tuple[str, RuntimeError | None]:
    """The message when the Lagrangian or a derivative is first not finite, or how a free duration has changed.

    Where a Function that the Lagrangian calls has failed, also its error.
    """
    pointwise, numbering, parameters = (
        functional.pointwise,
        functional.numbering,
        functional.parameters_at(unknowns, data),
    )
    joints, points = joints_of(numbering, unknowns, data), numbering.method.element.points
    if not np.all(joints[:-1] < joints[1:]):
        change = "shrunk" if unknowns[-1] < 0 else "grown"
        return f"the duration, which is free, has {change} by a factor of e^{abs(unknowns[-1]):.0f}", None
    steps = np.tile(np.diff(joints), len(points))
    times = np.tile(joints[:-1], len(points)) + np.repeat(points, len(joints) - 1) * steps
    x, slope = (np.array(a) for a in embedding(numbering)(joined(unknowns, data)))
    derivatives = Evaluator(pointwise.derivatives)
    for k in np.argsort(times, kind="stable"):
        results = derivatives(times[k], steps[k], x[:, k], slope[:, k], *parameters)
        finite = [bool(np.all(np.isfinite(result))) for result in results]
        if not all(finite):
            what = "the Lagrangian" if not all(finite[:3]) else "a derivative of the equations of motion"
            fails = "is not finite" if derivatives.failure is None else "calls a casadi Function that fails"
            with np.errstate(over="ignore"):
                v = slope[:, k] / steps[k]
            return f"{what} {fails} at t = {times[k]:.6g}, where x = {x[:, k]} and v = {v}", derivatives.failure
    if functional.terms:
        return "a derivative of a constraint, of a condition on the ends or of the end action is not finite", None
    return "the Lagrangian overflows", None


def refuse_undefined(functional: Functional, solution: Solution, path: PiecewisePolynomial) -> None:
    """Raise if the action is not finite on a path that solves the equations."""
    if math.isfinite(solution.action):
        return
    place, cause = not_finite(functional, solution.unknowns, solution.data)
    raise ConvergenceError(
        f"no path was found: the equations have a solution, but on it {place}. "
        "Try a guess that stays where the Lagrangian is defined",
        Path(path),
        solution.residual,
        solution.iterations,
    ) from cause


def open_direction(problem: BoundaryProblem, path: PiecewisePolynomial, change: np.ndarray, otherwise: str) -> str:
    """What leaves a path open, and what to state so that it is the only one near; or `otherwise`, if nothing is known.

    Parameters
    ----------
    change : (d, N m + 1), values at the nodes of the variation of smallest second variation
    """
    if problem.periodic and problem.autonomous and problem.energy is None:
        return (
            "A periodic path may begin anywhere on its orbit: give its energy instead of its period, or one component "
            "of its start, and compare the momenta at both ends"
        )
    size = path.sizes[:, None]
    moved, motion = change / size, path(path.node_times, 1) / size
    largest = np.max(np.abs(moved), axis=1)
    held = np.isfinite(problem.given_positions).any(axis=0)
    free = np.flatnonzero((largest > NO_CHANGE * np.max(largest)) & ~held).tolist()
    if free and np.max(np.ptp(moved, axis=1)) < NO_CHANGE * np.max(largest):
        names = " and ".join(f"x[{i}]" for i in free)
        together, one = ("together by", "one of them") if len(free) > 1 else ("by", "it")
        return f"Nothing holds {names}: moved {together} any amount, the path is as good; give {one} at one end"
    along = np.sum(moved * motion) ** 2 / max(np.sum(moved**2) * np.sum(motion**2), TINY)
    rests = np.max(np.abs(motion[:, [0, -1]])) < NO_CHANGE * np.max(np.abs(motion))
    if problem.autonomous and rests and along > 1 - NO_CHANGE:
        return (
            "The path rests near both ends for so long that nothing tells when it passes from one to the other. Where "
            "it is symmetric, solve one half of it: from its middle, whose position is then known, in half of the time"
        )
    return otherwise


def conjugate(
    problem: BoundaryProblem, solution: Solution, path: PiecewisePolynomial, quotient: float, change: np.ndarray
) -> ConjugatePointError:
    """Report that the second variation vanishes at a path that was found, for the variation `change`."""
    return ConjugatePointError(
        f"the second variation of the action vanishes (relative size {quotient:.0e}): the ends are conjugate points, "
        f"or a family of paths joins them. {open_direction(problem, path, change, ISOLATE)}",
        Path(path),
        solution.residual,
        solution.iterations,
    )


def explained(
    problem: BoundaryProblem,
    stationarity: Stationarity,
    failure: SolveFailure,
    path: PiecewisePolynomial,
    data: Data,
    change: np.ndarray | None,
) -> ConvergenceError:
    """Report the failure of a solver, and what caused it in CasADi; `path` is its last iterate.

    `change`, (d, N m + 1), is a variation that costs next to nothing there; None where there is none.
    """
    unknowns, numbering = failure.unknowns, stationarity.functional.numbering
    g, floor = stationarity.gradient_and_floor(unknowns, data)
    with np.errstate(invalid="ignore"):  # where both are infinite, or a free duration is
        residual, times = np.abs(g) / floor, path.node_times
    worst = int(np.argmax(np.where(np.isfinite(residual), residual, np.inf)))
    when = times[np.argmax((numbering.of_nodes == worst).any(axis=1))]
    place = f"the largest residual is at t = {when:.6g}"
    if worst >= numbering.positions:
        place = "the largest residual is that of a constraint, of a condition on ends or integrals or of the energy"
    cause, derivatives = None, Evaluator(stationarity.functional.function("derivatives"))
    if not all(np.isfinite(a).all() for a in derivatives(unknowns, *data)):
        place, cause = not_finite(stationarity.functional, unknowns, data)
    where = f"after {failure.iterations} iterations; {place}"
    kind: type[ConvergenceError] = ConvergenceError
    words = (
        f"no path was found: {failure} ({where}). Try a guess nearer to the path, more intervals, a shorter time span, "
        "or cg.continuation from an easier problem; there may be no path between these ends"
    )
    opened = ISOLATE if failure.singular else ""
    if change is not None:
        opened = open_direction(problem, path, change, opened)
    if opened and not failure.singular:
        words += f". {opened}"
    if failure.singular:
        kind = ConjugatePointError
        words = f"{failure}: {where}. The ends may be conjugate points, or a symmetry leaves a component free. {opened}"
    if numbering.multipliers:
        words += "; the constraints and the conditions on the ends may contradict one another, or say one thing twice"
    if problem.integral_values is not None:
        missed = g[numbering.everywhere][: numbering.integrals]
        found = np.array(problem.integral_values) + missed
        words += (
            f"; there may be no path with the integrals {list(problem.integral_values)}: here they are {found.tolist()}"
        )
    if numbering.free_duration:
        words += "; there may be no path of this energy"
    error = kind(words, Path(path), float(residual[worst]), failure.iterations)
    error.__cause__ = cause
    return error
