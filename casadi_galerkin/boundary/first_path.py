"""Strategies to find the first path of a refinement: Newton's method, a growing force or duration, random guesses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import TypeAlias, TypeGuard

import casadi as ca
import numpy as np

from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.several_paths import Search
from casadi_galerkin.boundary.transcription import GraphCache
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import resized_mesh, resolving_interpolant
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.callables import is_given
from casadi_galerkin.problems.problem import map_times, with_values
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import FAR_FROM_GUESS, Guess, relative_distance
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.solvers.newton import damped_newton
from casadi_galerkin.solvers.solver import Solver, SolverLike, newton, rescues

WARM_ITERATIONS = 40  # most iterations of Newton's method before another strategy is tried; with more it moves far away
FINE_MESH_FACTOR = 4  # factor on the intervals of a coarse mesh that is too coarse for any path; it was always enough
GUESS_INTERVALS = 200  # largest number of intervals of a mesh that resolves a guess
# truncation error of a guess on a first mesh: loose for corners and noise, tight for layers
COARSE_RESOLUTION, FINE_RESOLUTION = 0.1, 1e-6
RANDOM = "random guesses"
# first factor by which a fraction grows, and the factor below which the path is lost
FIRST_GROWTH, LEAST_GROWTH = 10.0, 1.1

Find: TypeAlias = Callable[[], CriticalPoint]
Strategy: TypeAlias = tuple[str, Find]  # its name in reports, and how to find a first path
IntermediatePath: TypeAlias = Callable[[GraphCache, PiecewisePolynomial], CriticalPoint]


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


def distance_from_guess(guess: PiecewisePolynomial, path: PiecewisePolynomial) -> float:
    """Distance of a path from a guess, at the same fractions of their durations, relative to the guess's size."""
    times = map_times(guess.node_times, guess.mesh[[0, -1]], path.mesh[[0, -1]])
    return relative_distance(path(times), guess.values)


def first_path_strategies(
    graphs: GraphCache,
    method: Galerkin,
    guess: Guess | None,
    given: PiecewisePolynomial,
    solver: SolverLike,
    intermediate_path: IntermediatePath,
) -> Iterator[Strategy]:
    """Strategies to find a first path from a guess, which is `given` on a first mesh, in the order of their cost.

    Newton's method from the guess; its rescues; a homotopy in the force or the duration, whose paths
    `intermediate_path` finds; Newton's method on a finer mesh, and there the search for `several_paths`.  Where the
    first path is far from the guess, a nearer one is looked for on finer meshes; if there is none, the first is kept.
    The straight line is no guess.
    """
    if not is_newton(solver):
        yield repr(solver), partial(graphs.solve, method, given.mesh, given.values, solver)
        return
    problem, brief = graphs.problem, warm_newton(solver)
    line = graphs.transcription(method, given.mesh).guess_on_mesh(None, given.mesh)
    if relative_distance(given.values, line.values) <= EPS**0.5:
        guess = None

    def solved(begun: Callable[[], PiecewisePolynomial], by: SolverLike = brief) -> CriticalPoint:
        return graphs.solve(method, begun().mesh, begun().values, by)

    @cache
    def resolved() -> PiecewisePolynomial:
        return guess_on_resolving_mesh(graphs, method, guess, given.mesh, FINE_RESOLUTION)

    @cache
    def fine() -> PiecewisePolynomial:
        intervals = max(FINE_MESH_FACTOR * (len(given.mesh) - 1), len(resolved().mesh) - 1)
        mesh = resized_mesh(resolved().mesh, intervals, problem.breakpoints)
        return graphs.transcription(method, mesh).guess_on_mesh(guess, mesh)

    (by_ipopt, ipopt), *others = rescues(graphs.transcription(method, given.mesh).stationarity).items()
    on_given, on_fine = partial(solved, lambda: given), partial(solved, fine)
    resolving = [] if guess is None else [partial(solved, resolved), partial(on_fine, ipopt)]
    yield "Newton's method", partial(_nearest, given, on_given, *resolving)
    for name, rescue in ((by_ipopt, ipopt), *others):
        yield name, partial(on_given, rescue)
    if _grows(problem):
        name = "in a growing time" if problem.force is None else "under a growing force"
        yield f"Newton's method {name}", partial(path_by_homotopy, graphs, fine(), intermediate_path)
    yield "Newton's method on a finer mesh", on_fine
    if not problem.free_phase:
        yield RANDOM, partial(_by_random_guesses, graphs, method, fine().mesh, brief, intermediate_path)


def _grows(problem: BoundaryProblem) -> bool:
    """Whether there is a force that may grow, or the motion may be given less time."""
    fixed = problem.constraint, problem.integral_conditions, problem.energy
    free = problem.periodic or problem.breakpoints or any(map(is_given, fixed))
    return problem.force is not None or not free


def _nearest(given: PiecewisePolynomial, find: Find, *others: Find) -> CriticalPoint:
    """The first path near a guess that one of some functions finds; if there is none, the first that one finds.

    The last function is asked only where a path is known, but far away.
    """
    far: CriticalPoint | None = None
    for tried in (find, *others):
        if others and tried is others[-1] and far is None:
            break
        try:
            point = tried()
        except ConvergenceError as failure:
            lost = failure
        else:
            if not others or distance_from_guess(given, point.polynomial) <= FAR_FROM_GUESS:
                return point
            far = far or point
    if far is None:
        raise lost
    return far


def _by_random_guesses(
    graphs: GraphCache, method: Galerkin, mesh: np.ndarray, solver: SolverLike, intermediate_path: IntermediatePath
) -> CriticalPoint:
    """Take away the loads of random smooth guesses, as the search for several paths does until it has found one."""

    def refined(point: CriticalPoint) -> Trajectory:
        resolved = intermediate_path(graphs, point.polynomial)
        return graphs.transcription(method, resolved.polynomial.mesh).trajectory(resolved, 0.0)

    search = Search(graphs.transcription(method, mesh), mesh, refined)
    found = search.run(1)[0]
    graphs.iterations += search.iterations
    return graphs.solve(method, found.t, found, solver)


def path_by_homotopy(
    graphs: GraphCache,
    guess: PiecewisePolynomial,
    intermediate_path: IntermediatePath,
) -> CriticalPoint:
    """Find the path of a problem under a growing fraction of its force or, where there is none, of its duration.

    Under a small force, and in a short time, paths are nearly straight lines.

    Parameters
    ----------
    graphs : GraphCache of the problem
    guess : guess of the path of the problem
    intermediate_path : (graphs, guess) -> the path from this guess, on a mesh that resolves it
    """
    fraction, growth, known = 1 / FIRST_GROWTH, FIRST_GROWTH, 0.0
    while True:
        part = graphs if fraction == 1.0 else _with_fraction(graphs, fraction)
        times = map_times(guess.mesh, guess.mesh[[0, -1]], part.problem.t_span)
        try:
            point = intermediate_path(part, PiecewisePolynomial(times, guess.nodes, guess.values))
        except ConvergenceError as failure:
            growth = math.sqrt(growth) if known else growth
            if growth < LEAST_GROWTH or fraction <= EPS**0.5:
                words = f"the path under a growing fraction was lost at a fraction of {fraction:.2g}: {failure}"
                raise ConvergenceError(words, failure.path, failure.residual, failure.iterations) from None
            fraction = known * growth if known else fraction / FIRST_GROWTH
        else:
            if fraction == 1.0:
                return point
            guess, known, growth = point.polynomial, fraction, min(growth**1.5, FIRST_GROWTH)
            fraction = min(1.0, known * growth)
        finally:
            if part is not graphs:
                graphs.iterations += part.iterations


def _with_fraction(graphs: GraphCache, fraction: float) -> GraphCache:
    """The problem under a fraction of its force or, where there is none, in a fraction of its time."""
    problem, (first, last) = graphs.problem, graphs.problem.t_span
    if problem.force is None:
        return graphs.for_problem(problem.varied({}, (first, first + fraction * (last - first))))
    inputs = problem.force.sx_in()
    return GraphCache(with_values(problem, force=ca.Function("force", inputs, [fraction * problem.force(*inputs)])))
