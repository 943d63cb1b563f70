"""From a tolerance to a degree and a mesh.

The degree follows from the tolerance alone, the mesh from the path: solve, read off where the Legendre coefficients
have not decayed, spread the intervals so that they have (`adaptivity`), solve again from the last path.  Once they
have, the path is put into the space of degree m + 2 on the same mesh, and Newton steps there, the whole path at
once, estimate its error in the joints and between them: measured 0.9 to 1.1 times the true error on the
reference problems, 0.4 to 15 times near collisions.  Legendre coefficients alone miss the error in the joints, the
strong Euler-Lagrange residual needs the norm of an inverse to become one.  Only a path that passes is returned.

Where the Hessian is nearly singular, this error is a multiple of what the path leaves out, and has the shape of the
softest variation, not that of its cause.  A new mesh therefore spreads what is left out, scaled to the error.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.adaptivity import (
    FEWER,
    FEWEST,
    FINEST,
    degree_for,
    equidistributed,
    interval_maxima,
    of_degree,
    sizes,
    truncation,
)
from casadi_galerkin.boundary import CriticalPoint, Engine, Transcription
from casadi_galerkin.calculus import DiscreteCalculus, Galerkin
from casadi_galerkin.engines import rootfinder
from casadi_galerkin.functional import Evaluation
from casadi_galerkin.guesses import Guess, check_types, mesh_of
from casadi_galerkin.newton import newton
from casadi_galerkin.polynomial import PiecewisePolynomial
from casadi_galerkin.problems import BoundaryProblem
from casadi_galerkin.relaxation import relaxed
from casadi_galerkin.trajectory import ConvergenceError, Trajectory

FIRST_NODES = 64  # of the first mesh, whatever the degree: what it does not see may be missed, what it does costs time
PATIENCE = 2  # meshes on which a first path may be lost before another is looked for; a false one was seen to creep
ITERATIONS = 40  # of Newton's method from an earlier path; where it took more it was measured to wander
RELAXATION_DEGREE, RELAXATION_INTERVALS, RELAXATION_TOLERANCE = 6, 40, 1e-5
LEAPS = 0.02, 0.1  # of a relaxation: short ones stay on their side of a singularity, long ones arrive
GUESS_LEVELS, GUESS_INTERVALS, GUESS_TOLERANCE = 10, 200, 1e-4
RISE = 3  # degrees that a level may gain on the one before
HIGHER = 2  # degrees added for the error estimate; two, because one adds nothing to a path of the other parity
SLOWEST = 0.9  # largest ratio of the two Newton steps of an estimate that their series is summed with
SMALLEST_SPLIT = 1.2  # where Newton's method does not follow even a mesh this little finer, it has lost the path
STALLED, ROUNDOFF_LEVEL = 2, 1e-9  # levels that did not lower an error below this: it is at the roundoff floor


@dataclass(frozen=True)
class Limits:
    """What stops a refinement that does not reach its tolerance; ``math.inf`` stops nothing.

    Parameters
    ----------
    intervals : most intervals of a mesh
    seconds : longest time, checked between levels
    levels : most meshes
    """

    intervals: float = 20_000
    seconds: float = 120.0
    levels: float = 80

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, bool) or not isinstance(value, (int, float, np.number)) or not value > 0:
                raise ValueError(f"the limit of {name} must be a positive number, got {value!r}")
        for name in ("intervals", "levels"):
            value = getattr(self, name)
            if value != math.inf and value != int(value):
                raise ValueError(f"the limit of {name} must be a whole number or inf, got {value!r}")

    @property
    def every_level(self) -> range:
        """Numbers of the levels."""
        return range(sys.maxsize if self.levels == math.inf else int(self.levels))


class LimitReached(ConvergenceError):
    """A refinement that follows a path and was stopped before its tolerance; another start would not help."""


following = partial(newton, limit=ITERATIONS)


class Refinement:
    """One refinement under way: the graphs built so far, the path, and what it has cost."""

    def __init__(
        self, problem: BoundaryProblem, tol: float, method: Galerkin | None, limits: Limits, verbose: int
    ) -> None:
        self.problem, self.tol, self.limits, self.verbose = problem, tol, limits, verbose
        self.method, self.fixed = method or of_degree(degree_for(tol)), method is not None
        self._transcriptions: dict[tuple[int, int], Transcription] = {}
        self.began, self.iterations, self.patience = time.perf_counter(), 0, math.inf

    def transcription(self, method: Galerkin, mesh: np.ndarray, evaluation: Evaluation = "single") -> Transcription:
        """The graph for this degree and number of intervals, built when first asked for."""
        key = (method.degree, len(mesh))
        if key not in self._transcriptions:
            self._transcriptions[key] = Transcription(self.problem, method, mesh, evaluation)
        return self._transcriptions[key]

    def solve(self, method: Galerkin, mesh: np.ndarray, guess: Guess | None, solver: Engine) -> CriticalPoint:
        """One level."""
        try:
            point = self.transcription(method, mesh).critical_point(guess=guess, mesh=mesh, solver=solver)
        except ConvergenceError as failure:
            self.iterations += failure.iterations
            raise
        self.iterations += point.solution.iterations
        return point

    def mesh_for(self, guess: Guess, mesh: np.ndarray) -> np.ndarray:
        """Joints on which the guess itself is resolved: where it turns sharply, so may the path."""
        path = self.transcription(self.method, mesh).drawn(guess, mesh)
        given = guess.path if isinstance(guess, Trajectory) else guess
        for _ in range(GUESS_LEVELS):
            error = truncation(path)
            if not callable(given) or np.max(error) <= GUESS_TOLERANCE or len(mesh) > GUESS_INTERVALS:
                break  # there is nothing between the values of an array
            mesh = equidistributed(mesh, error, self.method.degree + 1, GUESS_TOLERANCE)
            calculus = DiscreteCalculus(self.method, mesh)
            values = [np.asarray(given(t), dtype=float).ravel() for t in calculus.node_times.tolist()]
            path = calculus.emb(np.transpose(values))
        return mesh

    def starts(self, mesh: np.ndarray, guess: Guess | None, solver: Engine) -> Iterator[Callable[[], CriticalPoint]]:
        """Ways to a first path: Newton's method on the coarse mesh, relaxation, then whatever `solver` tries."""
        if solver is rootfinder:
            self.patience = PATIENCE
            yield lambda: self.solve(self.method, mesh, guess, newton)
            self.patience = math.inf
            count = max(RELAXATION_INTERVALS + 1, len(mesh))
            joints = np.interp(np.linspace(0, 1, count), np.linspace(0, 1, len(mesh)), mesh)
            for leap in LEAPS:
                yield partial(self.relaxed, joints, guess, leap)
        yield lambda: self.solve(self.method, mesh, guess, solver)

    def relaxed(self, mesh: np.ndarray, guess: Guess | None, leap: float) -> CriticalPoint:
        """Relax a guess until Newton's method takes over."""
        transcribed = partial(self.transcription, of_degree(RELAXATION_DEGREE), evaluation="vectorised")
        path = transcribed(mesh).drawn(guess, mesh)
        path = relaxed(transcribed, path, RELAXATION_TOLERANCE, leap, self.limits.every_level, self.late)
        return self.solve(of_degree(RELAXATION_DEGREE), path.mesh, path, following)

    def late(self) -> bool:
        """Whether the time is up."""
        return time.perf_counter() - self.began > self.limits.seconds

    def next(self, point: CriticalPoint, error: np.ndarray) -> CriticalPoint:
        """Solve on the equidistributed mesh; where Newton's method does not follow, on one changed less.

        The degree rises by at most `RISE`; an analytic path's error then falls to the power of the orders' ratio.
        """
        finest, degree = FINEST, len(point.path.nodes) - 1
        method = self.method
        if degree + RISE < method.degree or (degree > method.degree and not self.fixed):
            method = of_degree(min(degree + RISE, max(degree, method.degree)))
        order = method.degree + 1
        expected = error ** (order / (degree + 1))
        fewer = FEWER if method.degree == degree else 1.0  # where the graph is built anew, it may as well be small
        while True:
            mesh = equidistributed(point.path.mesh, expected, order, self.tol, finest, fewer=fewer)
            if len(mesh) - 1 > self.limits.intervals:
                raise self.stopped(f"the mesh would need {len(mesh) - 1} intervals", point, float(np.max(error)))
            try:
                return self.solve(method, mesh, point.path, following)
            except ConvergenceError:
                finest, self.patience = np.sqrt(finest), self.patience - 1
                if finest < SMALLEST_SPLIT or self.patience < 0:
                    raise

    def error(self, path: PiecewisePolynomial) -> float:
        """Largest error on a path, relative to the size of its components: two Newton steps as a geometric series."""
        higher = of_degree(len(path.nodes) - 1 + HIGHER)
        steps = self.transcription(higher, path.mesh).corrections(path)
        first, second = (float(np.max(interval_maxima(step) / sizes(path)[:, None])) for step in steps)
        return first / (1 - min(SLOWEST, second / first)) if first > 0 else 0.0

    def stopped(self, reason: str, point: CriticalPoint, reached: float) -> LimitReached:
        """Say how far it got; the best path is attached."""
        return LimitReached(
            f"tolerance {self.tol:g} was not reached: {reason}. The best path has {len(point.path.mesh) - 1} intervals "
            f"and an estimated error of {reached:.1e}; it is attached to this error as `path`. "
            "Try a looser tolerance, a guess nearer to the path, or higher limits",
            point.path,
            point.solution.residual,
            self.iterations,
        )

    def run(self, mesh: np.ndarray, guess: Guess | None, solver: Engine) -> Trajectory:
        """Refine the first path found that can be followed."""
        if guess is not None:
            mesh = self.mesh_for(guess, mesh)
        failures = []
        for start in self.starts(mesh, guess, solver):
            try:
                return self.finish(*self.refine(start()))
            except LimitReached:
                raise
            except ConvergenceError as failure:
                failures.append(failure)
        raise failures[-1]

    def refine(self, point: CriticalPoint) -> tuple[CriticalPoint, float]:
        """Solve on better and better meshes until the estimated error is below the tolerance; returns both."""
        best, smallest, stalled = point, np.inf, 0
        for level in self.limits.every_level:
            error = truncation(point.path)
            suits = not self.fixed or len(point.path.nodes) == self.method.degree + 1
            verified = suits and bool(np.max(error) <= self.tol)
            reached = self.error(point.path) if verified else float(np.max(error))
            self.report(level, point, reached, verified)
            if verified and reached <= self.tol:
                return point, reached
            stalled += verified and smallest / 2 < reached < ROUNDOFF_LEVEL
            if stalled == STALLED:
                floor = min(reached, smallest)
                raise self.stopped(f"{self.tol:g} asked, {floor:.0e} is the roundoff floor here", best, floor)
            if self.late():
                raise self.stopped(f"{self.limits.seconds:g} seconds have passed", point, reached)
            if verified:
                best, smallest = (point, reached) if reached < smallest else (best, smallest)
                error = error * (reached / np.max(error))
            point = self.next(point, error)
        raise self.stopped(f"{self.limits.levels:g} levels were not enough", point, reached)

    def report(self, level: int, point: CriticalPoint, reached: float, verified: bool) -> None:
        """One line a level."""
        if self.verbose and level == 0:
            print(f"{'Level':>7}{'Degree':>8}{'Intervals':>11}{'Iterations':>12}{'Max error':>12}  Estimated from")
        degree, intervals, iterations = len(point.path.nodes) - 1, len(point.path.mesh) - 1, point.solution.iterations
        source = f"degree {degree + HIGHER}" if verified else "Legendre coefficients"
        if self.verbose:
            print(f"{level:7d}{degree:8d}{intervals:11d}{iterations:12d}{reached:12.2e}  {source}")

    def finish(self, point: CriticalPoint, reached: float) -> Trajectory:
        """Wrap the path that passed."""
        method = self.method if self.fixed else of_degree(len(point.path.nodes) - 1)
        path = self.transcription(method, point.path.mesh).trajectory(point, 0.0)
        build_seconds = sum(built.build_seconds for built in self._transcriptions.values())
        return replace(
            path,
            iterations=self.iterations,
            build_seconds=build_seconds,
            solve_seconds=time.perf_counter() - self.began - build_seconds,
            error_estimate=reached,
        )


def check_tolerance(tol: float) -> None:
    """Refuse a relative tolerance that is none."""
    if isinstance(tol, bool) or not isinstance(tol, (int, float)) or not 0 < tol < 1:
        raise ValueError(f"tol must be a number between 0 and 1, got {tol!r}")


def first_mesh(
    problem: BoundaryProblem, tol: float, method: Galerkin | None, intervals: int | None, mesh: ArrayLike | None
) -> np.ndarray:
    """Joints where a refinement begins; refuses what does not fit, see `solve` for the arguments."""
    check_tolerance(tol)
    first = of_degree(degree_for(tol)) if method is None else method
    check_types(problem, first, BoundaryProblem)
    if intervals is None and mesh is None:
        intervals = max(FEWEST, math.ceil(FIRST_NODES / first.degree))
    return mesh_of(problem.t_span, intervals, mesh)


def solve_to_tolerance(
    problem: BoundaryProblem,
    tol: float,
    method: Galerkin | None,
    intervals: int | None,
    mesh: ArrayLike | None,
    guess: Guess | None,
    solver: Engine,
    limits: Limits,
    verbose: int,
) -> Trajectory:
    """Solve a boundary problem to a tolerance; see `solve` for the arguments."""
    joints = first_mesh(problem, tol, method, intervals, mesh)
    return Refinement(problem, tol, method, limits, verbose).run(joints, guess, solver)
