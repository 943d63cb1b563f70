"""Strategies to find the first path of a refinement: Newton's method, descent, random guesses, a growing force."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import TypeAlias, TypeGuard

import casadi as ca
import numpy as np
from numpy.polynomial.legendre import legfit, legval

from casadi_galerkin.boundary.action_descent import descend
from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.several_paths import Search
from casadi_galerkin.boundary.transcription import GraphCache
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import (
    resized_mesh,
    resolving_interpolant,
)
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.functional.mapping import by_rows
from casadi_galerkin.problems.problem import map_times, with_values
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import FAR_FROM_GUESS, Guess, relative_distance
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solvers.newton import damped_newton
from casadi_galerkin.solvers.solver import Solver, SolverLike, newton, rescues

WARM_ITERATIONS = 40  # most iterations of Newton's method before another strategy is tried; with more it moves far away
DESCENT_DEGREE, DESCENT_INTERVALS, DESCENT_TOLERANCE = 6, 40, 1e-5
FINE_MESH_FACTOR = 4  # factor on the intervals of a coarse mesh that is too coarse for any path; it was always enough
GUESS_INTERVALS = 200  # largest number of intervals of a mesh that resolves a guess
# truncation error of a guess on a first mesh: loose for corners and noise, tight for layers
COARSE_RESOLUTION, FINE_RESOLUTION = 0.1, 1e-6
# names of strategies: those that begin at the guess and lead nearby, and others
LOCAL_STRATEGIES = "Newton's method", "Newton's method from the guess smoothed", "Newton's method on a finer mesh"
DESCENT, RANDOM = "descent of the action", "random guesses"

Find: TypeAlias = Callable[[], CriticalPoint]
Strategy: TypeAlias = tuple[str, Find]  # its name in reports, and how to find a first path


def is_newton(solver: SolverLike) -> TypeGuard[Solver]:
    """Whether a solver is `newton`, with whatever options."""
    return isinstance(solver, Solver) and solver.name == newton.name


def warm_newton(solver: SolverLike) -> SolverLike:
    """Newton's method with few iterations, and with the options of `solver` if that is Newton's method, too."""
    return partial(damped_newton, **{"max_iter": WARM_ITERATIONS, **(solver.options if is_newton(solver) else {})})


def guess_on_resolving_mesh(
    graphs: GraphCache, method: Galerkin, guess: Guess | None, mesh: np.ndarray, tol: float
) -> PiecewisePolynomial:
    """A guess on a mesh that resolves it to a tolerance, because the path may turn sharply where the guess does."""
    interpolated = partial(graphs.transcription(method, mesh).guess_on_mesh, guess)
    if not callable(guess):
        return interpolated(mesh)  # an array has no values between its nodes
    return resolving_interpolant(interpolated, mesh, tol, GUESS_INTERVALS, graphs.problem.breakpoints)


def _smoothed(guess: PiecewisePolynomial) -> PiecewisePolynomial:
    """The least-squares cubic polynomial of a guess, without its corners and noise."""
    times, (first, last) = guess.node_times, guess.mesh[[0, -1]]
    parts = (2 * times - first - last) / (last - first)
    return PiecewisePolynomial(guess.mesh, guess.nodes, legval(parts, legfit(parts, guess.values.T, 3)))


def distance_from_guess(guess: PiecewisePolynomial, path: PiecewisePolynomial) -> float:
    """Distance of a path from a guess, at the same fractions of their durations, relative to the guess's size."""
    times = map_times(guess.node_times, guess.mesh[[0, -1]], path.mesh[[0, -1]])
    return relative_distance(path(times), guess.values)


def _differs(one: PiecewisePolynomial, other: PiecewisePolynomial) -> bool:
    """Whether two paths have other joints, or other values by more than rounding."""
    return len(one.mesh) != len(other.mesh) or relative_distance(one.values, other.values) > EPS**0.5


def _near(guess: PiecewisePolynomial, far: list[Strategy], name: str, find: Find) -> CriticalPoint:
    """Find a path; one that is far from the guess is put by, for where no nearer one is found."""
    point = find()
    distance = distance_from_guess(guess, point.polynomial)
    if distance > FAR_FROM_GUESS:
        far.append((name, lambda: point))
        away = f"the path found is up to {distance:.2g} of the guess's size away from the guess"
        raise ConvergenceError(away, Path(point.polynomial))
    return point


def first_path_strategies(
    graphs: GraphCache,
    method: Galerkin,
    guess: Guess | None,
    given: PiecewisePolynomial,
    solver: SolverLike,
    intermediate_path: Callable[[GraphCache, PiecewisePolynomial], CriticalPoint],
) -> Iterator[Strategy]:
    """Strategies to find a first path from a guess, which is `given` on a first mesh, in the order of their cost.

    Where a path is found that is far from a guess, a nearer one is looked for by Newton's method from the guess
    smoothed and on a mesh that resolves it, and by a descent of the action; if there is none, the first one is taken.
    The straight line is no guess.
    """
    if not is_newton(solver):
        yield repr(solver), partial(graphs.solve, method, given.mesh, given.values, solver)
        return
    if guess is not None and not _differs(
        given, graphs.transcription(method, given.mesh).guess_on_mesh(None, given.mesh)
    ):
        guess = None
    far = list[Strategy]()
    for name, find in _strategies(graphs, method, guess, given, warm_newton(solver), intermediate_path):
        if name in LOCAL_STRATEGIES or not far:
            yield name, find if guess is None else partial(_near, given, far, name, find)
        elif name == DESCENT:  # which follows the guess, even if far
            yield name, find
    yield from far[:1]


def _strategies(
    graphs: GraphCache,
    method: Galerkin,
    guess: Guess | None,
    given: PiecewisePolynomial,
    brief: SolverLike,
    intermediate_path: Callable[[GraphCache, PiecewisePolynomial], CriticalPoint],
) -> Iterator[Strategy]:
    """All strategies, whatever they find.

    Newton's method on the first mesh, from the guess smoothed, and on a finer mesh; its rescues on the first mesh; a
    homotopy in the force, if there is one, whose paths `intermediate_path` finds; a descent of the action with moving
    joints; and finally the search for `several_paths` on a finer mesh.
    """

    def solved(begun: PiecewisePolynomial, by: SolverLike) -> CriticalPoint:
        return graphs.solve(method, begun.mesh, begun.values, by)

    problem, finer = graphs.problem, given
    yield LOCAL_STRATEGIES[0], partial(solved, given, brief)
    if guess is not None:
        smoothed, finer = _smoothed(given), guess_on_resolving_mesh(graphs, method, guess, given.mesh, FINE_RESOLUTION)
        for name, start in zip(LOCAL_STRATEGIES[1:], (smoothed, finer), strict=True):
            if _differs(start, given):
                yield name, partial(solved, start, brief)
    stationarity = graphs.transcription(method, given.mesh).stationarity
    for name, rescue in rescues(stationarity).items():
        yield name, partial(solved, given, rescue)
    fine = resized_mesh(
        finer.mesh, max(FINE_MESH_FACTOR * (len(given.mesh) - 1), len(finer.mesh) - 1), problem.breakpoints
    )
    if problem.force is not None:
        start = graphs.transcription(method, fine).guess_on_mesh(guess, fine)
        yield "Newton's method under a growing force", partial(path_by_homotopy, graphs, start, intermediate_path)
    if stationarity.variational and not stationarity.functional.numbering.multipliers:
        joints = resized_mesh(fine, max(DESCENT_INTERVALS, len(fine) - 1), problem.breakpoints)
        yield DESCENT, partial(_by_descent, graphs, method, joints, guess, brief)
    if not problem.free_phase:
        yield RANDOM, partial(_by_random_guesses, graphs, method, fine, brief)


def _by_descent(
    graphs: GraphCache, method: Galerkin, mesh: np.ndarray, guess: Guess | None, solver: SolverLike
) -> CriticalPoint:
    """Lower the action from a guess, and continue with Newton's method."""
    transcribed = partial(graphs.transcription, Galerkin(DESCENT_DEGREE), mapping=by_rows)
    path = descend(transcribed, transcribed(mesh).guess_on_mesh(guess, mesh), DESCENT_TOLERANCE)
    mesh = resized_mesh(path.mesh, len(path.mesh) - 1, graphs.problem.breakpoints)  # descending moves the joints
    return graphs.solve(method, mesh, path, solver)


def _by_random_guesses(graphs: GraphCache, method: Galerkin, mesh: np.ndarray, solver: SolverLike) -> CriticalPoint:
    """Take away the loads of random smooth guesses, as the search for several paths does until it has found one."""
    search = Search(graphs.transcription(method, mesh), mesh)
    found = search.run(1)[0]
    graphs.iterations += search.iterations + found.iterations
    return graphs.solve(method, found.t, found, solver)


FORCE_GROWTH, LEAST_FORCE_GROWTH = (
    10.0,
    1.02,
)  # first factor by which a fraction grows, and the factor below which the path is lost
LEAST_FORCE = 1e-8  # smallest fraction that is tried
HOMOTOPY_STEPS = 100  # largest number of fractions that are tried


def path_by_homotopy(
    graphs: GraphCache,
    guess: PiecewisePolynomial,
    intermediate_path: Callable[[GraphCache, PiecewisePolynomial], CriticalPoint],
) -> CriticalPoint:
    """Find the path of a problem by a homotopy in its force.

    Parameters
    ----------
    graphs : GraphCache of the problem
    guess : guess of the path of the problem
    intermediate_path : (graphs, guess) -> the path from this guess, on a mesh that resolves it
    """
    fraction, growth, known = 1 / FORCE_GROWTH, FORCE_GROWTH, 0.0
    for _ in range(HOMOTOPY_STEPS):
        part = graphs if fraction == 1.0 else with_scaled_force(graphs, fraction)
        try:
            point = intermediate_path(part, guess)
        except ConvergenceError as failure:
            lost = failure
            growth = math.sqrt(growth) if known else growth
            if growth < LEAST_FORCE_GROWTH or fraction <= LEAST_FORCE:
                break
            fraction = known * growth if known else fraction / FORCE_GROWTH
        else:
            if fraction == 1.0:
                return point
            guess, known, growth = point.polynomial, fraction, min(growth**1.5, FORCE_GROWTH)
            fraction = min(1.0, known * growth)
        finally:
            if part is not graphs:
                graphs.iterations += part.iterations
    words = f"the path under a growing fraction was lost at a fraction of {fraction:.2g}: {lost}"
    raise ConvergenceError(words, lost.path, lost.residual, lost.iterations)


def with_scaled_force(graphs: GraphCache, fraction: float) -> GraphCache:
    """The problem under a fraction of its force."""
    problem = graphs.problem
    assert problem.force is not None
    inputs = problem.force.sx_in()
    return GraphCache(with_values(problem, force=ca.Function("force", inputs, [fraction * problem.force(*inputs)])))
