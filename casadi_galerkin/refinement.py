"""From a tolerance to a degree and a mesh.

The degree follows from the tolerance alone, the mesh from the path: solve, read off where the Legendre coefficients
have not decayed, spread the intervals so that they have (`adaptivity`), solve again from the last path.  Once they
have, the path is put into the space of degree m + 2 on the same mesh, and one Newton step there, the whole path at
once, estimates its error in the joints and between them.  Only a path that passes this is returned.

Measured against exact solutions over tolerances 1e-3 ... 1e-12, this estimate is 0.9 to 5 times the true error; the
alternatives were measured too: the Legendre coefficients alone miss the error in the joints, and the strong
Euler-Lagrange residual needs the norm of an inverse to become an error.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.adaptivity import FINEST, equidistributed, interval_maxima, sizes, truncation
from casadi_galerkin.boundary import CriticalPoint, Engine, Guess, Transcription, mesh_of
from casadi_galerkin.calculus import Galerkin, PiecewisePolynomial
from casadi_galerkin.engines import newton, rootfinder
from casadi_galerkin.problems import BoundaryProblem
from casadi_galerkin.trajectory import ConvergenceError, Trajectory

FIRST_INTERVALS = 8
RELAXATION_DEGREE, RELAXATION_INTERVALS, RELAXATION_STEPS, RELAXATION_TOLERANCE = 6, 40, 3, 1e-4
GUESS_LEVELS, GUESS_INTERVALS, GUESS_TOLERANCE = 10, 200, 1e-4
RISE = 3
HIGHER = 2  # degrees added for the error estimate; two, because one adds nothing to a path of the other parity
ROUNDOFF_LEVEL = 1e-9  # an error that refinement no longer lowers is called the roundoff floor below this


@dataclass(frozen=True)
class Limits:
    """What stops a refinement that does not reach its tolerance.

    Parameters
    ----------
    intervals : most intervals of a mesh
    seconds : longest time, checked between levels
    levels : most meshes
    """

    intervals: int = 20_000
    seconds: float = 120.0
    levels: int = 80


def degree_for(tol: float) -> int:
    """Degree for a tolerance: the one that was cheapest over the reference problems."""
    return int(np.clip(np.ceil(2 - np.log10(tol)), 4, 14))


class LimitReached(ConvergenceError):
    """A refinement that follows a path and was stopped before its tolerance; another start would not help."""


class Refinement:
    """One refinement under way: the graphs built so far, the path, and what it has cost."""

    def __init__(
        self, problem: BoundaryProblem, tol: float, method: Galerkin | None, limits: Limits, verbose: int
    ) -> None:
        self.problem, self.tol, self.limits, self.verbose = problem, tol, limits, verbose
        self.method = Galerkin(degree_for(tol)) if method is None else method
        self.higher = Galerkin(self.method.degree + HIGHER)
        self._transcriptions: dict[tuple[int, int], Transcription] = {}
        self.began, self.iterations, self.build_seconds = time.perf_counter(), 0, 0.0

    def transcription(self, method: Galerkin, mesh: np.ndarray) -> Transcription:
        """The graph for this degree and number of intervals, built when first asked for."""
        key = (method.degree, len(mesh))
        if key not in self._transcriptions:
            self._transcriptions[key] = Transcription(self.problem, method, mesh)
            self.build_seconds += self._transcriptions[key].build_seconds
        return self._transcriptions[key]

    def solve(self, method: Galerkin, mesh: np.ndarray, guess: Guess | None, solver: Engine) -> CriticalPoint:
        """One level."""
        point = self.transcription(method, mesh).critical_point(guess=guess, mesh=mesh, solver=solver)
        self.iterations += point.solution.iterations
        return point

    def mesh_for(self, guess: Guess, mesh: np.ndarray) -> np.ndarray:
        """Joints on which the guess itself is resolved: where it turns sharply, so may the path."""
        for _ in range(GUESS_LEVELS):
            drawn = self.transcription(self.method, mesh).drawn(guess, mesh)
            error = truncation(drawn)
            if np.max(error) <= GUESS_TOLERANCE or len(mesh) > GUESS_INTERVALS:
                break
            mesh = equidistributed(mesh, error, self.method.degree + 1, GUESS_TOLERANCE)
        return mesh

    def relaxed(self, mesh: np.ndarray, guess: Guess | None) -> CriticalPoint:
        """Lower the action a few steps at a time, with a new mesh after each few, then solve by Newton's method.

        The mesh has to follow the path as it is drawn towards a singularity: on a fixed one it slips through.
        """
        method, path, inertia = Galerkin(RELAXATION_DEGREE), guess, 1.0
        mesh = np.interp(np.linspace(0, 1, max(RELAXATION_INTERVALS, len(mesh))), np.linspace(0, 1, len(mesh)), mesh)
        for _ in range(self.limits.levels):
            path, inertia, step = self.transcription(method, mesh).relax(path, mesh, inertia, RELAXATION_STEPS)
            error = truncation(path)
            if step < RELAXATION_TOLERANCE and inertia == 0 and np.max(error) < 3 * RELAXATION_TOLERANCE:
                break
            mesh = equidistributed(mesh, error, method.degree + 1, RELAXATION_TOLERANCE, 2.0, len(mesh) - 1)
        path, _, _ = self.transcription(method, mesh).relax(path, mesh, inertia, 10 * RELAXATION_STEPS)
        return self.solve(method, mesh, path, rootfinder)

    def next(self, point: CriticalPoint, error: np.ndarray) -> CriticalPoint:
        """Solve on the equidistributed mesh; where Newton's method does not follow, on one changed less.

        From a relaxed path the degree rises by at most `RISE`; an analytic path's error then falls to the power
        of the ratio of the orders.
        """
        finest, degree = FINEST, len(point.path.nodes) - 1
        method = self.method if degree + RISE >= self.method.degree else Galerkin(degree + RISE)
        order = method.degree + 1
        expected = error ** (order / (degree + 1))
        while True:
            mesh = equidistributed(point.path.mesh, expected, order, self.tol, finest)
            if len(mesh) - 1 > self.limits.intervals:
                raise self.stopped(f"the mesh would need {len(mesh) - 1} intervals", point, np.max(error))
            try:
                return self.solve(method, mesh, point.path, newton)
            except ConvergenceError as failure:
                finest = np.sqrt(finest)
                if finest < 1.2:
                    raise failure

    def error(self, path: PiecewisePolynomial) -> np.ndarray:
        """Estimated error of a path on each interval, relative to the size of its components; (N,)."""
        correction = self.transcription(self.higher, path.mesh).correction(path)
        return np.asarray(np.max(interval_maxima(correction) / sizes(path)[:, None], axis=0))

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
        """Refine from a first path: Newton's on the coarse mesh; or a relaxed one; or whatever `solver` finds."""
        starts: list[Callable[[], CriticalPoint]] = [lambda: self.solve(self.method, mesh, guess, solver)]
        if solver is rootfinder:
            starts[:0] = [
                lambda: self.solve(self.method, mesh, guess, newton),
                lambda: self.relaxed(mesh, guess),
            ]
        if guess is not None:
            mesh = self.mesh_for(guess, mesh)
        failures = []
        for start in starts:
            try:
                return self.refine(start())
            except LimitReached:
                raise
            except ConvergenceError as failure:
                failures.append(failure)
        raise failures[-1]

    def refine(self, point: CriticalPoint) -> Trajectory:
        """Solve on better and better meshes until the estimated error is below the tolerance."""
        before = np.inf
        for level in range(self.limits.levels):
            error = truncation(point.path)
            verified = bool(np.max(error) <= self.tol) and len(point.path.nodes) == self.method.degree + 1
            if verified:
                error = self.error(point.path)
            reached = float(np.max(error))
            self.report(level, point, reached, verified)
            if verified and reached <= self.tol:
                return self.finish(point, reached)
            if verified and before / 2 < reached < ROUNDOFF_LEVEL:
                floor = min(reached, before)
                raise self.stopped(f"{self.tol:g} asked, {floor:.0e} is the roundoff floor here", point, floor)
            if time.perf_counter() - self.began > self.limits.seconds:
                raise self.stopped(f"{self.limits.seconds:g} seconds have passed", point, reached)
            before = reached if verified else before
            point = self.next(point, error)
        raise self.stopped(f"{self.limits.levels} levels were not enough", point, reached)

    def report(self, level: int, point: CriticalPoint, reached: float, verified: bool) -> None:
        """One line a level."""
        if not self.verbose:
            return
        if level == 0:
            print(f"{'Level':>7}{'Degree':>8}{'Intervals':>11}{'Iterations':>12}{'Max error':>12}  Estimated from")
        source = f"degree {self.higher.degree}" if verified else "Legendre coefficients"
        print(
            f"{level:7d}{len(point.path.nodes) - 1:8d}{len(point.path.mesh) - 1:11d}"
            f"{point.solution.iterations:12d}{reached:12.2e}  {source}"
        )

    def finish(self, point: CriticalPoint, reached: float) -> Trajectory:
        """Wrap the path that passed."""
        transcription = self.transcription(self.method, point.path.mesh)
        path = transcription.trajectory(point, 0.0)
        solve_seconds = time.perf_counter() - self.began - self.build_seconds
        return replace(
            path,
            iterations=self.iterations,
            build_seconds=self.build_seconds,
            solve_seconds=solve_seconds,
            error_estimate=reached,
        )


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
    if not isinstance(tol, (int, float)) or isinstance(tol, bool) or not 0 < tol < 1:
        raise ValueError(f"tol must be a number between 0 and 1, got {tol!r}")
    if intervals is None and mesh is None:
        intervals = FIRST_INTERVALS
    joints = mesh_of(problem.t_span, intervals, mesh)
    return Refinement(problem, tol, method, limits, verbose).run(joints, guess, solver)
