"""Boundary problems solved stepwise: single shooting, Newton's method on the start of the path.

`shooting_residual` is what the path from one start misses.  Newton's method halves its steps until they pass the
natural monotonicity test, as in the global solve.

Shooting can be no better than the product of the steps' Jacobians: it magnifies the rounding of the start.  Where
the growth comes near 1/eps, no start that a computer holds meets the end, and `shoot` says so.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.discrete_calculus import mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin, check_method
from casadi_galerkin.calculus.mesh_adaptation import higher_degree_method
from casadi_galerkin.calculus.numbers import counted
from casadi_galerkin.calculus.roundoff import EPS, TINY, or_one
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.constrained_motion import tangent_momenta
from casadi_galerkin.problems.legendre_transform import legendre_transform
from casadi_galerkin.problems.problem import check_kind
from casadi_galerkin.solution.errors import ConjugatePointError, ConvergenceError, Limits, check_tolerance
from casadi_galerkin.solution.guess import turned_back
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solution.trajectory import Comparisons, Trajectory, compared
from casadi_galerkin.solvers.newton import SEARCH_ITERATIONS, SMALLEST_DAMPING
from casadi_galerkin.solvers.stationarity import ACCEPTED
from casadi_galerkin.stepping.initial_value import to_tolerance, trajectory
from casadi_galerkin.stepping.shooting_residual import Shooting, Shot

MISS = EPS**0.5  # accepted miss of the end, relative to the size of the path: half of the digits
ZERO_START = 1e3 * EPS  # rounding of a start that tends to zero, relative to what it was before
UNDETERMINED = 64 * EPS  # smallest singular value of the scaled derivative from which the end depends on the start


def shoot(
    problem: BoundaryProblem,
    method: Galerkin | None = None,
    intervals: int | None = None,
    *,
    tol: float | None = None,
    mesh: ArrayLike | None = None,
    guess: Trajectory | None = None,
) -> Trajectory:
    """Solve a boundary problem stepwise, by single shooting.

    The end is met up to the rounding of all joints, which grows on its way to the end as a change of the start does.
    `Trajectory.residual` is the largest residual of a step, or miss of the end, over the floor that follows from that
    rounding; up to 50 is accepted.  `Trajectory.solver` gives the miss itself.  For a growth of 1e7 the miss was 2e-9
    of the path's size; a miss of more than 1.5e-8, half of the digits, is refused.  `solve` has no such loss.

    Of a guess only the start is used, and Newton's method may end at another path of the same ends.

    A given energy frees the duration, which is one more unknown.  It begins as that of the guess, or as that of
    `t_span`, and all steps are stretched with it.

    Parameters
    ----------
    problem : BoundaryProblem, with any ends, forces, constraints or energy
    method : Galerkin, default degree 8
    intervals : number of equal intervals; or
    mesh : (N + 1,) joints from t_span[0] to t_span[1]
    tol : relative tolerance between 0 and 1: the steps are halved until the estimated error is at most that, as `solve`
        does for an InitialProblem
    guess : Trajectory, whose start is the first start; default the straight line between the ends.  A periodic path of
        given energy needs one that moves at its start

    Returns
    -------
    Trajectory, whose joints are those of the mesh

    Raises
    ------
    TypeError, ValueError
        for input that does not fit, before anything is solved
    ConvergenceError
        with the measured growth and the last path, if Newton's method fails or no start meets the end; LimitReached
        where this is so on all meshes for a tolerance;
        ConjugatePointError where the ends do not determine the path

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> fall = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 10 * x[0], (0, 1), start=[0.0], end=[1.0])
    >>> cg.shoot(fall, cg.Galerkin(degree=2), intervals=4).momentum[0, 0].round(9).tolist()
    6.0

    The time in which a stone of that energy is back at the height 1:

    >>> back = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 10 * x[0], (0, 2), [0.0], [1.0], energy=18.0)
    >>> cg.shoot(back, cg.Galerkin(degree=2), intervals=4).t[-1].round(9).tolist()
    1.0
    """
    check_kind(problem, BoundaryProblem)
    check_method(method, optional=True)
    check_start(problem, guess)
    if tol is not None:
        steps = partial(_shot, problem, guess)
        return to_tolerance(steps, problem, check_tolerance(tol), method, intervals, mesh, Limits())
    return _shot(problem, guess, method or Galerkin(8), mesh_of(problem.t_span, intervals, mesh, problem.breakpoints))


def _shot(problem: BoundaryProblem, guess: Trajectory | None, method: Galerkin, mesh: np.ndarray) -> Trajectory:
    """The path by shooting on the joints of a mesh."""
    began = time.perf_counter()
    shooting = Shooting(problem, method, mesh, guess)
    shot, iterations = _newton(shooting, *_guess(problem, guess))
    roll, end_action = shot.roll.unstretched(), problem.numeric.end_action
    added = 0.0 if end_action is None else float(end_action(roll.x[:, 0], roll.x[:, -1]))
    if problem.energy is not None:  # the duration asked for was a guess
        problem = problem.varied({}, (float(roll.mesh[0]), float(roll.mesh[-1])))
    at = roll.mesh[:1], roll.x[:, :1]  # the steps do not depend on the normal part of the first momentum
    first = tangent_momenta(problem, *at, roll.p[:, :1], roll.velocity[:, None])
    roll = replace(roll, p=np.column_stack((first, roll.p[:, 1:])))
    solver = f"single shooting, misses the end by {np.max(np.abs(shot.miss)):.1e}"
    path = trajectory(problem, roll, iterations, solver, began, comparisons)
    wrong = _other_end(problem, path) or turned_back(problem, path.polynomial, shooting.plane)
    if wrong is not None:
        raise ConvergenceError(wrong, Path(path.polynomial), shot.residual, iterations)
    return replace(path, action=path.action + added, residual=shot.residual, missed=_missed(shot)[0])


def check_start(problem: BoundaryProblem, guess: Trajectory | None) -> None:
    """Refuse a guess that shooting cannot start from, and integrals, which no step knows."""
    if problem.integral_conditions is not None:
        raise ValueError("integral_conditions hold along a whole path: take cg.solve, not steps from its start")
    if guess is not None and (not isinstance(guess, Trajectory) or len(guess.x) != problem.dimension):
        raise TypeError(f"guess must be a Trajectory of {counted(problem.dimension, 'component')}, got {guess!r}")


def _other_end(problem: BoundaryProblem, path: Trajectory) -> str | None:
    """Why the path does not end where it must, if so: under a constraint the equations hold up to its normal.

    Such a normal may meet the constraint again, as that of a sphere does at the antipode.
    """
    if problem.constraint is None:
        return None
    last, sizes = path.x[:, -1], path.polynomial.sizes
    wanted = path.x[:, 0] if problem.periodic else np.array(problem.end, dtype=float)  # NaN for None
    missed = np.abs(last - wanted)
    if not np.any(missed > MISS * np.max(sizes)):
        return None
    return (
        f"shooting has met another point of the constraint, x = {last.tolist()} at t = {path.t[-1]:g}, away from the "
        f"end by up to {np.nanmax(missed / sizes):.1e} of a component's size. Give a guess with a better start, or "
        "solve it globally, with `solve`"
    )


def comparisons(path: Trajectory) -> Comparisons:
    """With the path of a higher degree on the same joints that meets the same ends."""
    assert isinstance(path.problem, BoundaryProblem)
    return compared(path, shoot(path.problem, higher_degree_method(path.method.degree), mesh=path.t, guess=path))


def _guess(problem: BoundaryProblem, guess: Trajectory | None) -> tuple[np.ndarray, np.ndarray]:
    """(x_0, p_0) and the velocity at the start of the guess, or of the straight line.

    A free end of the line takes the value of the other.
    """
    duration = problem.t_span[1] - problem.t_span[0]
    if guess is None:
        start, end = problem.given_positions
        x = np.nan_to_num(np.where(np.isnan(start), end, start))
        v, stretch = np.nan_to_num((end - start) / duration), 1.0
        p = legendre_transform(problem.numeric.lagrangian)(problem.t_span[0], x, v)[0].full().ravel()
    else:
        x, p, v = (a[:, 0] for a in (guess.x, guess.momentum, guess.velocity))
        stretch = (guess.t[-1] - guess.t[0]) / duration
    if problem.energy is None:
        return np.concatenate((x, p)), v
    return np.concatenate((x, [stretch], p, [0.0])), stretch * v


def _newton(shooting: Shooting, state: np.ndarray, velocity: np.ndarray) -> tuple[Shot, int]:
    """Newton's method with natural monotonicity line search: the shot that meets the end, and its iterations."""
    start = np.concatenate((state, np.zeros(shooting.unknowns - len(state))))
    shot = shooting.shoot(start, velocity)
    for iteration in range(SEARCH_ITERATIONS):
        trial = None
        if np.any(np.abs(shot.miss) > shot.floor):
            trial = _line_search(shooting, shot, start, _direction(shot, shot.miss, iteration))
        if trial is None:
            return _met(shot, iteration), iteration
        shot, start = trial
    raise _failure(f"no convergence in {SEARCH_ITERATIONS} iterations", shot, SEARCH_ITERATIONS)


def _line_search(shooting: Shooting, shot: Shot, start: np.ndarray, step: np.ndarray) -> tuple[Shot, np.ndarray] | None:
    """Halve the step until the simplified step from its end is shorter: the shot and the start there; or None."""
    scale = np.maximum(shot.sizes[: len(start)], np.abs(step)) + TINY
    smallest = 1.0 if np.all(np.abs(shot.miss) <= ACCEPTED * shot.floor) else SMALLEST_DAMPING
    velocity, damping = shot.roll.velocity, 1.0
    while damping >= smallest:
        moved = start + damping * step
        is_zero = np.abs(moved) <= ZERO_START * np.abs(start)  # to rounding: relative to itself it would never converge
        moved[is_zero] = 0.0
        at_rest = is_zero[shooting.stepper.dimension :][
            : len(velocity)
        ]  # the momenta, for a prediction that is zero, too
        with suppress(ConvergenceError):  # a step of the trial path has failed
            trial = shooting.shoot(moved, np.where(at_rest, 0.0, velocity))
            shorter = np.max(np.abs(_direction(shot, trial.miss)) / scale)
            if shorter <= (1 - damping / 4) * np.max(np.abs(step) / scale):
                return trial, moved
        damping /= 2
    return None


def _direction(shot: Shot, miss: np.ndarray, iteration: int = 0) -> np.ndarray:
    """Newton step of the start."""
    scaled, rows, columns = _scaled(shot)
    if _singular(scaled):
        _refuse_conjugate(shot, iteration)
        raise _failure("rounding hides how the end depends on the start", shot, iteration)
    return np.linalg.solve(scaled, -miss / rows[:, 0]) / columns


def _scaled(shot: Shot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The derivative by the start with rows and columns scaled to equal units, and their scales (n, 1) and (n,)."""
    scale = or_one(shot.sizes[: len(shot.miss)])
    rows = np.max(shot.terms * (scale / np.max(scale)), axis=1, keepdims=True)  # which would overflow with the growth
    rows[rows == 0] = 1.0
    with np.errstate(over="ignore", invalid="ignore"):
        columns = np.max(shot.terms / rows, axis=0)
        return shot.by_start / rows / or_one(columns), rows, columns


def _singular(scaled: np.ndarray) -> bool:
    return not np.all(np.isfinite(scaled)) or bool(np.linalg.svd(scaled, compute_uv=False)[-1] <= UNDETERMINED)


def _refuse_conjugate(shot: Shot, iteration: int) -> None:
    """Raise a ConjugatePointError for a singular derivative, unless only rounding may have made it so."""
    if np.max(np.abs(shot.growth)) < 1 / MISS:
        reason = "the end does not depend on the start: the ends are conjugate points, or a family of paths joins them"
        reason += ", or the guess rests at its start: give one that moves" if shot.roll.stepper.free_duration else ""
        raise ConjugatePointError(reason, Path(shot.path), shot.residual, iteration)


def _missed(shot: Shot) -> tuple[float, float]:
    """By what the end is missed, and by what the rounding of the start moves it, relative to the path's size."""
    sizes = or_one(np.abs(shot.by_ends) @ shot.sizes)
    return float(np.max(np.abs(shot.miss) / sizes)), float(np.max(shot.floor / sizes))


def _met(shot: Shot, iteration: int) -> Shot:
    """Return the last shot of Newton's method if it meets the end up to roundoff, in half of the digits; or raise."""
    missed, _ = _missed(shot)
    if missed > MISS or shot.residual > ACCEPTED:
        raise _failure(f"the end is missed by {missed:.1e} of the path's size", shot, iteration)
    if np.all(np.abs(shot.miss) <= shot.floor) and _singular(_scaled(shot)[0]):
        _refuse_conjugate(shot, iteration)
    values = shot.path.values
    if shot.roll.stepper.free_duration and np.all(np.ptp(values, axis=1) <= MISS * np.max(np.abs(values), axis=1)):
        raise _failure("the path has shrunk to a point, and its duration to zero", shot, iteration)
    return shot


def _failure(reason: str, shot: Shot, iteration: int) -> ConvergenceError:
    """The error of a last shot, with what the rounding of the start does, and what to do."""
    growth, moved = float(np.max(np.abs(shot.growth))), _missed(shot)[1]
    words = (
        f"shooting failed: {reason} (iteration {iteration}). A change of the start grows up to {growth:.1e} times "
        f"along the path, and its rounding alone moves the end by {moved:.1e} of its size. Give a guess with a better "
        "start, or solve it globally, with `solve`"
    )
    return ConvergenceError(words, Path(shot.path), shot.residual, iteration)
