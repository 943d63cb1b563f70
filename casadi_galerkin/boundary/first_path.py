"""Strategies to find the first path of a refinement, in the order of their cost."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import cache, partial
from typing import TypeAlias, TypeGuard

import numpy as np
from numpy.polynomial.legendre import legfit, legval

from casadi_galerkin.boundary.action_descent import descend
from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.graph_cache import GraphCache
from casadi_galerkin.boundary.homotopy import path_by_homotopy
from casadi_galerkin.boundary.several_paths import Search
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import (
    equidistributed,
    parts_wanted,
    resized_mesh,
    resolving_interpolant,
    truncation_error,
)
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.functional.mapping import by_rows
from casadi_galerkin.problems.orbit_phase import has_phase
from casadi_galerkin.problems.problem import map_times
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import FAR_FROM_GUESS, Guess, relative_distance
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solvers.newton import damped_newton
from casadi_galerkin.solvers.solver import Solver, SolverLike, newton, rescues

ITERATIONS = 40  # most iterations of Newton's method before another way is tried; with more it moves far away
DESCENT_DEGREE, DESCENT_INTERVALS, DESCENT_TOLERANCE = 6, 40, 1e-5
COARSENED = 1e-9  # truncation error for which the mesh of a descent is coarsened; with 1e-6 a close passage was lost
MORE = 4  # factor on the intervals of a coarse mesh that is too coarse for any path; it was always enough
GUESS_INTERVALS = 200  # largest number of intervals of a mesh that resolves a guess
# truncation error of a guess on a first mesh: loose for corners and noise, tight for layers
COARSE_RESOLUTION, FINE_RESOLUTION = 0.1, 1e-6
RANDOM = "random guesses"  # name of the last strategy without a guess

Find: TypeAlias = Callable[[], CriticalPoint]
Strategy: TypeAlias = tuple[str, Find]  # its name in reports, and how to find a first path


def is_newton(solver: SolverLike) -> TypeGuard[Solver]:
    """Whether a solver is `newton`, with whatever options."""
    return isinstance(solver, Solver) and solver.name == newton.name


def warm_newton(solver: SolverLike) -> SolverLike:
    """Newton's method with few iterations, and with the options of `solver` if that is Newton's method, too."""
    return partial(damped_newton, **{"max_iter": ITERATIONS, **(solver.options if is_newton(solver) else {})})


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


def _distance(guess: PiecewisePolynomial, point: CriticalPoint) -> float:
    """Distance of a path from the guess, at the same fractions of their durations, relative to the guess's size."""
    path = point.polynomial
    times = map_times(guess.node_times, guess.mesh[[0, -1]], path.mesh[[0, -1]])
    return relative_distance(path(times), guess.values)


def _near(guess: PiecewisePolynomial, find: Find) -> CriticalPoint:
    """Find a path, and refuse it if it is far from the guess."""
    point = find()
    distance = _distance(guess, point)
    if distance > FAR_FROM_GUESS:
        away = f"the path found is up to {distance:.2g} of the guess's size away from the guess"
        raise ConvergenceError(away, Path(point.polynomial))
    return point


def _nearest(guess: PiecewisePolynomial, first: Find, others: Iterable[Find]) -> CriticalPoint:
    """The path of the first function or, if that is far from the guess, of another one that finds a path near it."""
    point = first()
    if _distance(guess, point) > FAR_FROM_GUESS:
        for find in others:
            with suppress(ConvergenceError):
                return find()
    return point


def first_path_strategies(
    graphs: GraphCache,
    method: Galerkin,
    mesh: np.ndarray,
    guess: Guess | None,
    solver: SolverLike,
    intermediate_path: Callable[[GraphCache, PiecewisePolynomial], CriticalPoint],
) -> Iterator[Strategy]:
    """Strategies to find a first path, in the order in which they are tried.

    First Newton's method on the coarse mesh; with a guess also from the smoothed guess, and on a mesh that resolves the
    guess.  Then its rescues on the coarse mesh; a homotopy in the force, if there is one, whose paths
    `intermediate_path` finds; a descent of the action with moving joints; and finally, without a guess, the search for
    `several_paths` on a finer mesh, otherwise `solver` itself.  With a guess, a path near it is preferred to one that
    is far from it.
    """
    problem = graphs.problem
    given = guess_on_resolving_mesh(graphs, method, guess, mesh, COARSE_RESOLUTION)

    @cache
    def finer() -> PiecewisePolynomial:
        return guess_on_resolving_mesh(graphs, method, guess, mesh, FINE_RESOLUTION)

    def solved(begun: PiecewisePolynomial, by: SolverLike) -> CriticalPoint:
        return graphs.solve(method, begun.mesh, begun.values, by)

    if not is_newton(solver):
        yield repr(solver), partial(solved, given, solver)
        return
    brief, ways = warm_newton(solver), dict[str, Find]()
    first = partial(solved, given, brief)
    if guess is not None:
        ways["Newton's method from the guess smoothed"] = lambda: solved(_smoothed(given), brief)
        ways["Newton's method on a finer mesh"] = lambda: solved(finer(), brief)
        first = partial(_nearest, given, first, [partial(_near, given, find) for find in ways.values()])
    yield "Newton's method", first
    stationarity = graphs.transcription(method, given.mesh).stationarity
    ways |= {name: partial(solved, given, rescue) for name, rescue in rescues(stationarity).items()}
    for name, find in ways.items():
        yield name, find if guess is None else partial(_near, given, find)
    fine = finer().mesh
    fine = resized_mesh(fine, max(MORE * (len(given.mesh) - 1), len(fine) - 1), problem.breakpoints)
    if problem.force is not None:
        start = graphs.transcription(method, fine).guess_on_mesh(guess, fine)
        yield "Newton's method under a growing force", partial(path_by_homotopy, graphs, start, intermediate_path)
    if stationarity.variational and not stationarity.functional.numbering.multipliers:
        joints = resized_mesh(fine, max(DESCENT_INTERVALS, len(fine) - 1), problem.breakpoints)
        yield "descent of the action", partial(_by_descent, graphs, method, joints, guess, brief)
    if guess is None and not has_phase(problem):
        yield RANDOM, partial(_by_random_guesses, graphs, method, fine, brief)
    else:
        yield "Newton's method with its rescues", partial(solved, given, solver)


def _by_descent(
    graphs: GraphCache, method: Galerkin, mesh: np.ndarray, guess: Guess | None, solver: SolverLike
) -> CriticalPoint:
    """Lower the action from a guess, and continue with Newton's method, last on a mesh that is not far too fine."""
    transcribed = partial(graphs.transcription, Galerkin(DESCENT_DEGREE), mapping=by_rows)
    path = descend(transcribed, transcribed(mesh).guess_on_mesh(guess, mesh), DESCENT_TOLERANCE)
    mesh = resized_mesh(path.mesh, len(path.mesh) - 1, graphs.problem.breakpoints)  # descending moves the joints
    point = graphs.solve(method, mesh, path, solver)
    while True:
        found = point.polynomial
        parts = parts_wanted(truncation_error(found), method.degree + 1, COARSENED)
        mesh = equidistributed(found.mesh, parts, breakpoints=graphs.problem.breakpoints)
        if len(mesh) >= len(found.mesh):
            return point
        try:
            point = _near(found, partial(graphs.solve, method, mesh, found, solver))
        except ConvergenceError:
            return point


def _by_random_guesses(graphs: GraphCache, method: Galerkin, mesh: np.ndarray, solver: SolverLike) -> CriticalPoint:
    """Take away the loads of random smooth guesses, as the search for several paths does until it has found one."""
    search = Search(graphs.transcription(method, mesh), mesh)
    found = search.run(1)[0]
    graphs.iterations += search.iterations + found.iterations
    return graphs.solve(method, found.t, found, solver)
