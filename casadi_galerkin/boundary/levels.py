"""The graphs of one refinement, one for each degree and number of intervals, and the solves on them."""

from __future__ import annotations

import math

import numpy as np

from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.mass import check_mass
from casadi_galerkin.boundary.transcription import Transcription
from casadi_galerkin.calculus.discrete_calculus import with_breakpoints
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.functional.mapping import Mapping, one_by_one
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solvers.solver import SolverLike


class Levels:
    """Graphs that are built when they are first asked for, and kept.

    Parameters
    ----------
    problem : BoundaryProblem
    deadline : of ``time.perf_counter()``, at which solves stop

    Attributes
    ----------
    iterations : of all solves so far
    """

    def __init__(self, problem: BoundaryProblem, deadline: float = math.inf) -> None:
        check_mass(problem)
        self.problem, self.deadline, self.iterations = problem, deadline, 0
        self._transcriptions: dict[tuple[int, int], Transcription] = {}

    def transcription(self, method: Galerkin, mesh: np.ndarray, mapping: Mapping = one_by_one) -> Transcription:
        """The graph for this degree and number of intervals."""
        key = (method.degree, len(mesh))
        if key not in self._transcriptions:
            self._transcriptions[key] = Transcription(self.problem, method, mesh, mapping, self.deadline)
        return self._transcriptions[key]

    def solve(self, method: Galerkin, mesh: np.ndarray, guess: Guess | None, solver: SolverLike) -> CriticalPoint:
        """Solve one level; breakpoints of the problem become joints."""
        mesh = with_breakpoints(mesh, self.problem.breakpoints)
        try:
            point = self.transcription(method, mesh).critical_point(guess=guess, mesh=mesh, solver=solver)
        except ConvergenceError as failure:
            self.iterations += failure.iterations
            raise
        self.iterations += point.solution.iterations
        return point

    @property
    def build_seconds(self) -> float:
        """Seconds spent on building all graphs."""
        return sum(built.build_seconds for built in self._transcriptions.values())
