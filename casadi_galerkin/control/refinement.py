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

from casadi_galerkin.calculus.discrete_calculus import mesh_of, with_breakpoints
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.quadrature import gauss, lobatto
from casadi_galerkin.control.error_estimate import better_mesh, estimated_error
from casadi_galerkin.control.transcription import transcribed_control
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.problem import check_types
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solution.limits import Limits, check_tolerance
from casadi_galerkin.solution.refinement import Estimate, Refinement
from casadi_galerkin.solvers.solver import Solver

FIRST_INTERVALS = 8
DOUBLINGS = 2  # of the first mesh, while IPOPT finds nothing on it
HIGHER = 2  # degrees added for the error estimate; two, because of parity


def degree_for(tol: float) -> int:
    """Degree for a tolerance: smooth scenes then need 8 to 20 intervals."""
    return int(np.clip(np.ceil(1 - np.log10(tol)), 4, 10))


def raised(method: Galerkin) -> Galerkin:
    """The method with `HIGHER` degrees and points more, of the same kind."""
    rule = lobatto if method.quadrature.points[0] == 0 else gauss
    return Galerkin(method.degree + HIGHER, quadrature=rule(len(method.quadrature) + HIGHER))


class ControlRefinement(Refinement[ControlTrajectory, ControlTrajectory]):
    """One refinement of a trajectory optimisation under way; arguments as for `solve`."""

    roundoff_level, stalls = 1e-8, 1  # what IPOPT leaves

    def __init__(
        self,
        problem: ControlProblem,
        tol: float,
        method: Galerkin | None,
        limits: Limits,
        solver: Solver,
        verbose: int,
    ) -> None:
        super().__init__(tol, limits, verbose)
        self.problem, self.solver = problem, solver
        self.method = Galerkin(degree_for(tol)) if method is None else method
        self._iterations, self.build_seconds = 0, 0.0

    @property
    def iterations(self) -> int:
        """Iterations of IPOPT in all solves."""
        return self._iterations

    def solved(self, level: ControlTrajectory) -> tuple[int, float]:
        """Iterations of IPOPT on one level, and the violation it left."""
        return level.iterations, level.residual

    def path(self, level: ControlTrajectory, error: float) -> ControlTrajectory:
        """The optimum of a level, which solves its own mesh."""
        return replace(level, error_estimate=error)

    def solve(self, method: Galerkin, mesh: np.ndarray, guess: Guess | None) -> ControlTrajectory:
        """Solve with one degree on one mesh; joints are scaled to the phases of the problem, whatever was found."""
        problem = self.problem
        found = guess.problem.breakpoints if isinstance(guess, ControlTrajectory) else problem.breakpoints
        begin, end = problem.t_span
        joints = np.interp(
            with_breakpoints(mesh, found), [mesh[0], *found, mesh[-1]], [begin, *problem.breakpoints, end]
        )
        transcription = transcribed_control(self.problem, method, None, joints)
        path = transcription.solve(guess=guess, solver=self.solver, verbose=max(self.verbose - 1, 0))
        self._iterations += path.iterations
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

    def estimate(self, level: ControlTrajectory) -> Estimate[ControlTrajectory]:
        """The error from the same mesh with a higher degree."""
        try:
            higher = self.solve(raised(self.method), level.t, level)
        except ConvergenceError as failure:
            raise self.stopped(str(failure), level, np.inf) from failure
        return Estimate(estimated_error(level, higher), True, f"degree {raised(self.method).degree}", higher)

    def improve(self, level: ControlTrajectory, estimate: Estimate[ControlTrajectory]) -> ControlTrajectory:
        """Solve on the better mesh, from the path of higher degree."""
        mesh = better_mesh(level, estimate.detail, self.tol)
        self.check_intervals(len(mesh) - 1, level, estimate.error)
        try:
            return self.solve(self.method, mesh, estimate.detail)
        except ConvergenceError as failure:
            raise self.stopped(str(failure), level, estimate.error) from failure

    def run(self, mesh: np.ndarray, guess: Guess | None) -> ControlTrajectory:
        """Refine the first path, and say what all levels have cost."""
        path, error = self.refine(self.first(mesh, guess))
        return replace(
            path,
            iterations=self.iterations,
            build_seconds=self.build_seconds,
            solve_seconds=time.perf_counter() - self.began - self.build_seconds,
            error_estimate=error,
        )


def first_control_mesh(
    problem: ControlProblem, tol: float, method: Galerkin | None, intervals: int | None, mesh: ArrayLike | None
) -> np.ndarray:
    """Joints where a refinement begins; refuses what does not fit, see `solve` for the arguments."""
    check_tolerance(tol)
    check_types(problem, Galerkin(degree_for(tol)) if method is None else method, ControlProblem)
    if problem.hold:
        raise ValueError(
            "with hold every interval has one value of the controls, so the mesh is part of the problem and "
            f"not to be refined: give a method and intervals, got tol={tol:g}"
        )
    count = FIRST_INTERVALS + len(problem.breakpoints) if intervals is None and mesh is None else intervals
    return mesh_of(problem.t_span, count, mesh, problem.breakpoints)


def solve_control_to_tolerance(
    problem: ControlProblem,
    tol: float,
    method: Galerkin | None,
    intervals: int | None,
    mesh: ArrayLike | None,
    guess: Guess | None,
    limits: Limits,
    solver: Solver,
    verbose: int,
) -> ControlTrajectory:
    """Solve a control problem to a tolerance; see `solve` for the arguments.

    Raises
    ------
    LimitReached
        with the best path attached
    ConvergenceError
        where IPOPT finds no path on the first mesh, nor on the same mesh twice and four times as fine
    """
    joints = first_control_mesh(problem, tol, method, intervals, mesh)
    return ControlRefinement(problem, tol, method, limits, solver, verbose).run(joints, guess)
