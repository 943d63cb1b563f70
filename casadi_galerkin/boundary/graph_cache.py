"""The graphs of one refinement, one for each degree and number of intervals, and the solves on them."""

from __future__ import annotations

from copy import copy

import numpy as np

from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.transcription import Transcription
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.functional.mapping import PointMap, one_by_one
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solvers.solver import SolverLike


class GraphCache:
    """Graphs that are built at their first use and kept; also counts the iterations of all solves.

    `mapping` is how L is evaluated at the points, as for `Functional`, unless `transcription` is called with another;
    `verbose` applies to all solves.
    """

    def __init__(self, problem: BoundaryProblem, mapping: PointMap = one_by_one, verbose: int = 0) -> None:
        self.problem, self.iterations, self._mapping, self.verbose = problem, 0, mapping, verbose
        self._transcriptions: dict[tuple[Galerkin, int], Transcription] = {}

    def for_problem(self, problem: BoundaryProblem, verbose: int = 0) -> GraphCache:
        """The same graphs for a problem that is `varied` from this one's; new graphs are kept for both."""
        other = copy(self)
        other.problem, other.iterations, other.verbose = problem, 0, verbose
        return other

    def transcription(self, method: Galerkin, mesh: np.ndarray, mapping: PointMap | None = None) -> Transcription:
        """The graph for this degree and number of intervals."""
        key = (method, len(mesh))
        if key not in self._transcriptions:
            self._transcriptions[key] = Transcription(self.problem, method, mesh, mapping or self._mapping)
        return self._transcriptions[key].for_problem(self.problem)

    def solve(
        self,
        method: Galerkin,
        mesh: np.ndarray,
        guess: Guess | None,
        solver: SolverLike,
        problem: BoundaryProblem | None = None,
    ) -> CriticalPoint:
        """Solve one level, of the problem or of one that is `varied` from it."""
        graph = self.transcription(method, mesh).for_problem(problem or self.problem)
        try:
            point = graph.critical_point(guess=guess, mesh=mesh, solver=solver, verbose=self.verbose)
        except ConvergenceError as failure:
            self.iterations += failure.iterations
            raise
        self.iterations += point.solution.iterations
        return point

    @property
    def build_seconds(self) -> float:
        """Seconds spent on building all graphs."""
        return sum(built.build_seconds for built in self._transcriptions.values())
