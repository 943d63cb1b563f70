"""A boundary problem solved to a tolerance: solve, estimate the error, and solve again on a better mesh.

The degree follows from the tolerance alone, the mesh from the path.  Solve, estimate the truncation error from the
decay of the Legendre coefficients on every interval, equidistribute it (`mesh_adaptation`), and solve again from the
last path, until the truncation error is below the tolerance.  Then estimate the error of the path: Newton steps of the
whole path, in the space of a higher degree on the same mesh, give its error at the joints and between them.  This was
measured at 0.9 to 1.1 times the true error on the reference problems, and at 0.4 to 15 times near collisions.  The
Legendre coefficients alone do not show the error at the joints, and the strong Euler-Lagrange residual would have to be
multiplied by the norm of an inverse.  Only a path whose estimated error is below the tolerance is returned.  Where L is
infinite but integrable at a breakpoint or a natural end, as |t|^p with p from -0.5 to -0.8, two degrees have
most of their errors of quadrature in common, and estimates were measured 2 to 6 times too small.

A mesh may be too coarse for the variations of a path even if it resolves the path.  So the responses of the path to
the same forces must agree in both degrees (`agreement`), or every interval is halved.

Where the Hessian is nearly singular, the error is a multiple of the truncation error and has the shape of the variation
of smallest curvature, which does not show where the truncation error is large.  A new mesh therefore equidistributes
the truncation error, scaled to the size of the estimated error.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.boundary.error_estimate import (
    REQUIRED_AGREEMENT,
    agreement,
    discretization_error,
    roundoff_error,
)
from casadi_galerkin.boundary.failure_report import open_direction, refuse_undefined
from casadi_galerkin.boundary.first_path import (
    COARSE_RESOLUTION,
    RANDOM,
    Strategy,
    distance_from_guess,
    first_path_strategies,
    guess_on_resolving_mesh,
    is_newton,
    warm_newton,
)
from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.transcription import GraphCache, Transcription
from casadi_galerkin.calculus.discrete_calculus import NEAREST, mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import (
    FEWEST,
    equidistributed,
    method_for,
    parts_wanted,
    truncation_error,
)
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import EPS, TINY
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.solution.error_indicators import FRACTIONS, LAGRANGIAN_MISFIT, error_indicators
from casadi_galerkin.solution.errors import ConjugatePointError, ConvergenceError, LimitReached, Limits
from casadi_galerkin.solution.guess import FAR_FROM_GUESS, Guess, joined_by_lines
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solution.quantity import Quantity
from casadi_galerkin.solution.refinement import Estimate, Refinement
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.solvers.deadline import until
from casadi_galerkin.solvers.newton import NEWTON
from casadi_galerkin.solvers.solver import SolverLike
from casadi_galerkin.solvers.stationarity import ACCEPTED

FIRST_NODES = 64  # nodes of the first mesh at any degree: fewer may miss features of the path, more cost time
FLOOR_FACTOR = 10.0  # times the roundoff floor: a smaller error no longer falls with the mesh
SHORTEST_INTERVAL = 1e-13  # interval over the duration at which a refinement stops: doubles have three digits more
# interval, over the distance to the nearer end, at which a refinement stops as well: times are rounded
TIME_ROUNDING = 1e5 * EPS
HOMOTOPY_ACCURACY = 1e-3, 500  # tolerance and largest number of intervals for the intermediate paths of a homotopy
Parts = Callable[[float], np.ndarray]  # tolerance of x -> numbers of parts into which intervals are to be split
MESHES_WITHOUT_HALVING = 8  # meshes in a row that do not halve an error; intervals that move to a layer need up to 6


class BoundaryRefinement(Refinement[CriticalPoint, Parts]):
    """One refinement of the problem of a `GraphCache`; the other arguments are those of `solve`."""

    roundoff_level = 0.0

    def __init__(
        self,
        graphs: GraphCache,
        tol: float,
        method: Galerkin,
        solver: SolverLike,
        limits: Limits,
        of: Quantity | None = None,
    ) -> None:
        super().__init__(tol, method, graphs.problem.breakpoints, limits, graphs.verbose, of)
        self.graphs = graphs
        self.built = graphs.build_seconds  # until now, for earlier refinements
        self.solver, self.warm_solver = solver, warm_newton(solver)

    def refine(self, level: CriticalPoint) -> tuple[CriticalPoint, float]:
        """Refine as the base class does, with the records of earlier first paths deleted."""
        # by source the smallest error so far, and on how many meshes in a row it was not halved
        self.smallest_errors: dict[str, tuple[float, int]] = {}
        return super().refine(level)

    @property
    def iterations(self) -> int:
        """Iterations of the solver in all levels."""
        return self.graphs.iterations

    def solved(self, level: CriticalPoint) -> tuple[int, int, float]:
        """Degree and intervals of one level, and the residual that the solver has left."""
        return level.polynomial.degree, len(level.polynomial.mesh) - 1, level.solution.residual

    def answer(self, level: CriticalPoint, error: float | None) -> Path:
        """The critical path on the mesh of a level, with its error; a Path where nothing more can be said of it."""
        try:
            return self.finish(level, error)
        except ConvergenceError:  # as where it is not isolated
            return Path(level.polynomial)

    def estimate(self, level: CriticalPoint) -> Estimate[Parts]:
        """Estimate the error of a path, and the numbers of parts into which the next mesh splits its intervals.

        The estimate is the first of these that is above the tolerance: the truncation error; an error indicator that
        does not depend on the equations; the difference to a path of higher degree, together with roundoff; and the
        disagreement of the responses to forces.  Above the tolerance, only the difference to a higher degree is
        trusted as an error.  Below it, the largest indicator counts as well: beside jumps that nobody named the
        difference was measured up to 40 times smaller than the error.
        """
        path = level.polynomial
        truncation = truncation_error(path)
        largest = float(np.max(truncation))
        if largest > max(self.tol, FLOOR_FACTOR * EPS):
            return Estimate(largest, False, "Legendre coefficients", self.parts(truncation))
        self.check_time()
        graph, floor = self.graph(path), self.floor(level)
        self.roundoff_level = FLOOR_FACTOR * max(floor, EPS * np.max(np.abs(path.mesh)) / np.ptp(path.mesh))
        shown = zip(FRACTIONS, error_indicators(level.motion, path, level.momentum), strict=True)
        scaled = {name: indicator / FRACTIONS[name] for name, indicator in shown}
        source, indicator = max(scaled.items(), key=lambda item: float(np.max(item[1])))
        if np.max(indicator) > self.tol:
            parts = partial(parts_wanted, indicator, 1)  # at a kink it falls in proportion to the step
            return Estimate(float(np.max(indicator)), False, source, parts)
        self.check_time()
        error = max(math.hypot(discretization_error(graph, path), floor), float(np.max(indicator)))
        if error <= self.first_tol:
            agreed = agreement(graph, path)
            if agreed < REQUIRED_AGREEMENT:
                graph.check_second_variation(level)
                words = "responses to forces, which differ with the degree: the ends are nearly conjugate"
                return Estimate(1 - agreed, False, words, lambda _: np.full(len(truncation), 2.0))
        relative = np.maximum(truncation, TINY) / max(float(np.max(truncation)), TINY)
        magnified = ": the ends are nearly conjugate" if error > 1 else ""
        return Estimate(error, True, f"degree {graph.higher.method.degree}{magnified}", self.parts(error * relative))

    def floor(self, level: CriticalPoint) -> float:
        """The roundoff error of the path, or zero where it is far below the tolerance; refuses a tolerance below it.

        It is, where the path is so regular that an error of eps in its values stays far below the tolerance.
        The rounding of a condition, or of a given energy, is not bounded by the regularity: either may be a small
        difference of large terms.
        """
        graph = self.graph(level.polynomial)
        regular = self.tol * level.solution.regularity > FLOOR_FACTOR * EPS
        if regular and graph.numbering.free == graph.numbering.positions:
            return 0.0
        floor = roundoff_error(graph, level.solution.unknowns, level.solution.data)
        if floor > self.tol:
            graph.refuse_conjugate(level)
            cause = "doubles hold no more digits, the ends are nearly conjugate, or the action's terms cancel"
            needed = "asked" if self.of is None else "of x needed"
            reason = f"{self.tol:g} {needed}, {floor:.0e} is the roundoff floor here: {cause}"
            hint = "Try a looser tolerance, or a method of higher degree, with fewer intervals and less roundoff"
            change = graph.smallest_curvature(level.solution.unknowns, level.solution.data)[1]
            hint = ". ".join(filter(None, (hint, open_direction(self.graphs.problem, level.polynomial, change, ""))))
            raise self.stopped(reason, level, floor, hint)
        return floor

    def parts(self, error: np.ndarray) -> Parts:
        """Numbers of parts into which intervals with these errors are to be split."""
        return partial(parts_wanted, error, self.method.degree + 1)

    def trajectory(self, level: CriticalPoint, estimate: Estimate[Parts]) -> Trajectory:
        """The path of a level whose error is known."""
        return replace(self.graph(level.polynomial).trajectory(level, 0.0), error_estimate=estimate.error)

    def graph(self, path: PiecewisePolynomial) -> Transcription:
        """The graph on the mesh of a path."""
        return self.graphs.transcription(self.method, path.mesh)

    def better_mesh(self, level: CriticalPoint, estimate: Estimate[Parts]) -> np.ndarray:
        """The equidistributed mesh.

        Where the last mesh did not halve the error, the path is less smooth than the order of the method requires, and
        the new mesh has more intervals than the last.  Only errors from the same source are compared.  An error that
        stays on `MESHES_WITHOUT_HALVING` meshes does not fall on any.
        """
        mesh, parts = level.polynomial.mesh, estimate.detail(self.tol)
        smallest, stayed = self.smallest_errors.get(estimate.source, (math.inf, 0))
        stayed = 0 if estimate.error < smallest / 2 else stayed + 1
        self.smallest_errors[estimate.source] = min(smallest, estimate.error), stayed
        if stayed == MESHES_WITHOUT_HALVING:
            words = f"an error of {estimate.error:.1e}, measured by the {estimate.source},"
            words += " stays on any mesh"
            if np.ptp(parts) > 0:
                when = float(mesh[np.argmax(parts / np.diff(mesh))])
                words += f" near t = {when:.9g}. {self.not_smooth(when, np.ptp(mesh))}"
            raise self.stopped(words, level, estimate.error)
        fewest = len(mesh) if stayed else FEWEST
        return equidistributed(mesh, parts, fewest=fewest, breakpoints=self.breakpoints)

    def solve_on(self, mesh: np.ndarray, level: CriticalPoint) -> CriticalPoint:
        """Solve from the last path; refuses a path along which L is not finite on two meshes in a row."""
        point = self.graphs.solve(self.method, mesh, level.polynomial, self.warm_solver)
        if not math.isfinite(level.solution.action):
            refuse_undefined(self.graph(point.polynomial).functional, point.solution, point.polynomial)
        return point

    def shortest(self, mesh: np.ndarray) -> np.ndarray:
        """Lengths below which the precision of a double does not resolve intervals, or their times."""
        inside = np.minimum(mesh[:-1] - mesh[0], mesh[-1] - mesh[1:])
        steps = np.maximum(SHORTEST_INTERVAL * (mesh[-1] - mesh[0]), TIME_ROUNDING * inside)
        return np.maximum(steps, NEAREST * np.max(np.abs(mesh)))

    @property
    def local_solver(self) -> SolverLike:
        """The solver from a nearby path: Newton's method with few iterations, unless another solver was given."""
        return self.warm_solver if is_newton(self.solver) else self.solver

    def resume(self, level: CriticalPoint) -> Trajectory:
        """Refine a path that was solved on the mesh of another path."""
        with until(self.deadline):
            return self.finish(*self.refine(level))

    def run(self, mesh: np.ndarray, guess: Guess | None) -> Trajectory:
        """Find a first path by one of several strategies, and refine it; an array as guess is one on this mesh.

        Where the straight line leads through a pole, as of a collision, the search for other paths follows at once.
        A path that is far from a guess is reported as such.
        """
        guess = self.on_any_mesh(guess, mesh)
        given = guess_on_resolving_mesh(self.graphs, self.method, guess, mesh, COARSE_RESOLUTION)
        strategies = first_path_strategies(self.graphs, self.method, guess, given, self.solver, self.intermediate_path)
        try:
            path = self.by_the_first(strategies, None if guess is None else given)
        except LimitReached as limit:
            if guess is not None or self.out_of_time() or not self.at_pole(self.best[0]):
                raise
            try:  # with what is left of the strategies
                path = self.by_the_first(((name, find) for name, find in strategies if name == RANDOM), None)
            except ConvergenceError:
                raise limit from None
        distance = 0.0 if guess is None else distance_from_guess(given, path.polynomial)
        if distance <= FAR_FROM_GUESS:
            return path
        return path.amended(solver=f"{path.solver}; up to {distance:.2g} of the guess's size away from the guess")

    def at_pole(self, level: CriticalPoint) -> bool:
        """Whether a path leads through a pole of L, which other paths avoid; at a step of L the misfit is small."""
        _, misfit, _ = error_indicators(level.motion, level.polynomial, level.momentum)
        return bool(np.max(misfit) > LAGRANGIAN_MISFIT)

    def by_the_first(self, strategies: Iterable[Strategy], guess: PiecewisePolynomial | None) -> Trajectory:
        """Refine the path of the first strategy that leads to one.

        A path that was found, but not to the tolerance, ends the search: another mesh may only hide what is wrong with
        it.  But a singular one that nobody guessed is passed over.
        """
        failures, singular = list[ConvergenceError](), list[ConvergenceError]()
        for name, find in strategies:
            if failures and (self.out_of_time() or (singular and name == RANDOM)):
                break
            began, before, first = time.perf_counter(), self.iterations, None
            try:
                with until(self.deadline):
                    first = find()
                    path = self.finish(*self.refine(first))
            except ConvergenceError as failure:
                if isinstance(failure, LimitReached) or (first is not None and failure.residual <= ACCEPTED):
                    if not self.another_is_meant(failure, guess):
                        raise
                    singular.append(failure)
                failures.append(failure)
                if self.verbose:
                    spent = f"{self.iterations - before} iterations, {time.perf_counter() - began:.3f} s"
                    print(f"{name}: no path, {spent}")
            else:
                report = first.solution.report
                if report == path.solver and not (failures and report == NEWTON):
                    return path
                return path.amended(solver=f"{path.solver}; first path by {name if report == NEWTON else report}")
        if self.out_of_time():
            raise self.late(failures[-1])
        raise (singular or failures)[-1]

    def another_is_meant(self, failure: ConvergenceError, guess: PiecewisePolynomial | None) -> bool:
        """Whether a path that was found is singular, and not the one that was guessed."""
        if not isinstance(failure, ConjugatePointError) or failure.path is None:
            return False
        return guess is None or distance_from_guess(guess, failure.path.polynomial) > FAR_FROM_GUESS

    def intermediate_path(self, graphs: GraphCache, guess: PiecewisePolynomial) -> CriticalPoint:
        """Find a path of a homotopy to a loose tolerance, on a mesh that resolves it."""
        tol, most = HOMOTOPY_ACCURACY
        limits = replace(self.limits, intervals=min(self.limits.intervals, most))
        part = BoundaryRefinement(graphs, max(self.tol, tol), self.method, self.solver, limits)
        part.deadline = self.deadline
        return part.refine(graphs.solve(self.method, guess.mesh, guess, self.warm_solver))[0]

    def on_any_mesh(self, guess: Guess | None, mesh: np.ndarray) -> Guess | None:
        """A guess that fits any mesh: arrays of values at the joints or nodes of this mesh become a path."""
        if isinstance(guess, tuple) and len(guess) == 2:
            return joined_by_lines(*guess, self.graphs.problem.dimension)
        if guess is None or callable(guess):
            return guess
        return self.graphs.transcription(self.method, mesh).guess_on_mesh(guess, mesh)

    def finish(self, point: CriticalPoint, error: float | None) -> Trajectory:
        """The accepted path as a Trajectory, with the iterations and seconds of the whole refinement."""
        path = self.graph(point.polynomial).trajectory(point, 0.0) if self.asked is None else self.asked
        build_seconds = self.graphs.build_seconds
        return path.amended(
            iterations=self.iterations,
            build_seconds=build_seconds,
            solve_seconds=time.perf_counter() - self.began - (build_seconds - self.built),
            error_estimate=error,
        )


def first_discretization(
    problem: BoundaryProblem, tol: float, method: Galerkin | None, intervals: int | None, mesh: ArrayLike | None
) -> tuple[Galerkin, np.ndarray]:
    """Method and joints with which a refinement begins; refuses what does not fit, see `solve` for the arguments."""
    method = method_for(tol) if method is None else method
    if intervals is None and mesh is None:
        intervals = max(FEWEST, math.ceil(FIRST_NODES / method.degree), 1 + len(problem.breakpoints))
    return method, mesh_of(problem.t_span, intervals, mesh, problem.breakpoints)
