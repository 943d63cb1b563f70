"""From a tolerance to a degree and a mesh, for trajectory optimisation.

Every mesh is solved twice, with degree m and, warm-started from that, with degree m + 2 (`control_adaptivity` says how
these make an error and a new mesh).  Estimated are the relative errors of cost and duration, and the largest error of
x at the joints and between them, relative to the size of its component; neither is the control judged, nor whether
the optimum is the global one.

Measured over tolerances 1e-3 ... 1e-8, the estimate is 0.95 to 1.2 times the true error on smooth paths down to 1e-12,
and 1.5 to 2.5 times with a path constraint touched in one point.  With bang-bang controls it is only a bound, ten times
the error and more, because it holds for the switching times; where a position touches its bound, 6 to 30 times.
Out of reach was 1e-8 with a path constraint touched in one point and a Gauss rule, and on some meshes with bang-bang
controls, where IPOPT fails on the tiny intervals beside a switch; the error raised says so.
The dynamics defect was measured too: of order m, it is 0.3 to 100 times the error of x.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus import Galerkin
from casadi_galerkin.control import transcribe_control
from casadi_galerkin.control_adaptivity import better_mesh, estimated_error
from casadi_galerkin.control_problem import ControlProblem
from casadi_galerkin.control_trajectory import ControlTrajectory
from casadi_galerkin.guesses import Guess, mesh_of
from casadi_galerkin.quadrature import gauss, lobatto
from casadi_galerkin.refinement import LimitReached, Limits, check_tolerance
from casadi_galerkin.trajectory import ConvergenceError

FIRST_INTERVALS = 8
DOUBLINGS = 2  # of the first mesh, while IPOPT finds nothing on it
HIGHER = 2  # degrees added for the error estimate; two, because of parity
ROUNDOFF_LEVEL = 1e-8  # an estimate that refinement no longer lowers is what IPOPT leaves, below this


class ControlLimitReached(LimitReached):
    """A trajectory optimisation that was stopped before its tolerance.

    Attributes
    ----------
    trajectory : ControlTrajectory, the best so far, which solves its own mesh; a guess for another try
    """

    trajectory: ControlTrajectory


def degree_for(tol: float) -> int:
    """Degree for a tolerance: smooth scenes then need 8 to 20 intervals."""
    return int(np.clip(np.ceil(1 - np.log10(tol)), 4, 10))


def raised(method: Galerkin) -> Galerkin:
    """The method with `HIGHER` degrees and points more, of the same kind."""
    rule = lobatto if method.quadrature.points[0] == 0 else gauss
    return Galerkin(method.degree + HIGHER, quadrature=rule(len(method.quadrature) + HIGHER))


class ControlRefinement:
    """One refinement under way, and what it has cost."""

    def __init__(
        self, problem: ControlProblem, tol: float, method: Galerkin | None, limits: Limits, verbose: int
    ) -> None:
        self.problem, self.tol, self.limits, self.verbose = problem, tol, limits, verbose
        self.method = Galerkin(degree_for(tol)) if method is None else method
        self.began, self.iterations, self.build_seconds = time.perf_counter(), 0, 0.0

    def solve(self, method: Galerkin, mesh: np.ndarray, guess: Guess | None) -> ControlTrajectory:
        """One degree on one mesh; joints are scaled to the span of the problem, whatever duration was found."""
        begin, end = self.problem.t_span
        joints = np.interp(mesh, mesh[[0, -1]], (begin, end))
        path = transcribe_control(self.problem, method, mesh=joints).solve(guess, max(self.verbose - 1, 0))
        self.iterations += path.iterations
        self.build_seconds += path.build_seconds
        return path

    def first(self, mesh: np.ndarray, guess: Guess | None) -> ControlTrajectory:
        """The path on the first mesh; on one twice as fine where IPOPT finds none."""
        for _ in range(DOUBLINGS):
            try:
                return self.solve(self.method, mesh, guess)
            except ConvergenceError:
                mesh = np.interp(np.arange(2 * len(mesh) - 1) / 2, np.arange(len(mesh)), mesh)
        return self.solve(self.method, mesh, guess)

    def run(self, mesh: np.ndarray, guess: Guess | None) -> ControlTrajectory:
        """Solve on better and better meshes until the estimated error is below the tolerance."""
        path, before = self.first(mesh, guess), np.inf
        for level in self.limits.every_level:
            higher, reached = path, np.inf
            try:
                higher = self.solve(raised(self.method), path.t, path)
                reached = estimated_error(path, higher)
                self.report(level, path, reached)
                if reached <= self.tol:
                    return self.finish(path, reached)
                mesh = better_mesh(path, higher, self.tol)
                self.check(len(mesh) - 1, path, before, reached)
                before, path = reached, self.solve(self.method, mesh, higher)
            except LimitReached:
                raise
            except ConvergenceError as failure:
                raise self.stopped(str(failure), path, reached) from failure
        raise self.stopped(f"{self.limits.levels:g} levels were not enough", path, before)

    def check(self, intervals: int, path: ControlTrajectory, before: float, reached: float) -> None:
        """Stop where another level is not allowed or would not help."""
        if before / 2 < reached < ROUNDOFF_LEVEL:
            raise self.stopped(f"{min(reached, before):.0e} is the roundoff floor here", path, reached)
        if intervals > self.limits.intervals:
            raise self.stopped(f"the mesh would need {intervals} intervals", path, reached)
        if time.perf_counter() - self.began > self.limits.seconds:
            raise self.stopped(f"{self.limits.seconds:g} seconds have passed", path, reached)

    def stopped(self, reason: str, path: ControlTrajectory, reached: float) -> ControlLimitReached:
        """Say how far it got; the best path is attached."""
        error = ControlLimitReached(
            f"tolerance {self.tol:g} was not reached: {reason}. The last path has {len(path.t) - 1} intervals and an "
            f"estimated error of {reached:.1e}; it is attached to this error as `trajectory`. "
            "Try a looser tolerance, a guess nearer to the path, or higher limits",
            path.path,
            path.residual,
            self.iterations,
        )
        error.trajectory = replace(path, error_estimate=reached)
        return error

    def report(self, level: int, path: ControlTrajectory, reached: float) -> None:
        """One line a level."""
        if not self.verbose:
            return
        if level == 0:
            print(f"{'Level':>7}{'Degree':>8}{'Intervals':>11}{'Iterations':>12}{'Cost':>17}{'Max error':>12}")
        print(
            f"{level:7d}{self.method.degree:8d}{len(path.t) - 1:11d}{path.iterations:12d}"
            f"{path.cost:17.10g}{reached:12.2e}"
        )

    def finish(self, path: ControlTrajectory, reached: float) -> ControlTrajectory:
        """The path that passed, with what all levels have cost."""
        return replace(
            path,
            iterations=self.iterations,
            build_seconds=self.build_seconds,
            solve_seconds=time.perf_counter() - self.began - self.build_seconds,
            error_estimate=reached,
        )


def solve_control_to_tolerance(
    problem: ControlProblem,
    tol: float,
    method: Galerkin | None,
    intervals: int | None,
    mesh: ArrayLike | None,
    guess: Guess | None,
    limits: Limits,
    verbose: int,
) -> ControlTrajectory:
    """Solve a control problem to a tolerance; see `solve` for the arguments.

    Raises
    ------
    ControlLimitReached
        with the best path attached as `trajectory`
    ConvergenceError
        where IPOPT finds no path on the first mesh, nor on the same mesh twice and four times as fine
    """
    check_tolerance(tol)
    if intervals is None and mesh is None:
        intervals = FIRST_INTERVALS
    return ControlRefinement(problem, tol, method, limits, verbose).run(mesh_of(problem.t_span, intervals, mesh), guess)
