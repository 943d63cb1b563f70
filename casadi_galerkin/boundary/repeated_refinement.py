"""Boundary problems that are solved to a tolerance again and again: on the mesh of an earlier path.

A mesh and a degree that resolve one path mostly resolve the paths for other ends and parameters.  So the mesh of the
first path is kept, and later paths are solved on it.  The error of each is estimated; where it is too large, the
refinement of `solve` continues from there.

An earlier path is more than a guess, because the problem that it solves is known.  Its node values are taken unchanged,
except for the new ends: then the first Newton step is the tangent of the family of paths.  With a path that was bent to
meet the new ends, Newton's method was measured to need up to twice the iterations, or to fail.  Where it does not
converge in one step, the curve of paths to the new ends, times and parameters is followed.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.boundary.boundary_refinement import BoundaryRefinement, first_discretization
from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.transcription import GraphCache
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.functional.pointwise import PointMap, by_rows
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.problem import Problem, map_times, section_times
from casadi_galerkin.solution.errors import ConvergenceError, LimitReached, Limits
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solution.quantity import Quantity
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.solvers.curve import LoadedCurve
from casadi_galerkin.solvers.second_variation import negative_eigenvalues
from casadi_galerkin.solvers.solver import Solver, newton


class RepeatedRefinement:
    """Refinements of one boundary problem and of others that are `varied` from it, on graphs that are kept.

    Parameters
    ----------
    problem : BoundaryProblem
    tol, of, method, intervals, mesh, limits : as for `solve`
    """

    def __init__(
        self,
        problem: BoundaryProblem,
        tol: float,
        method: Galerkin | None,
        intervals: int | None,
        mesh: ArrayLike | None,
        limits: Limits,
        of: Quantity | None = None,
        mapping: PointMap = by_rows,
    ) -> None:
        self.problem, self.tol, self.limits, self.of = problem, tol, limits, of
        self.method, self._coarse = first_discretization(problem, tol, method, intervals, mesh)
        self._graphs = GraphCache(problem, mapping)
        # numbers of negative eigenvalues on a path's own mesh; a path is often known to several that follow it
        self._indices: WeakKeyDictionary[PiecewisePolynomial, int | None] = WeakKeyDictionary()

    def __reduce__(self) -> tuple[object, ...]:
        """Pickled without its Functions, which are built again from the problem."""
        return type(self), (self.problem, self.tol, self.method, None, self._coarse, self.limits, self.of)

    def found(
        self,
        problem: BoundaryProblem,
        guess: Guess | None,
        kept: Trajectory | None,
        solver: Solver | None = None,
        verbose: int = 0,
    ) -> Trajectory:
        """The path of a problem that is `varied` from this one's.

        Parameters
        ----------
        guess, solver, verbose : as for `solve`
        kept : a path whose mesh is tried first, unless the guess brings its own
        """
        known = guess if isinstance(guess, Trajectory) and same_statement(guess.problem, problem) else None
        if known is not None and problem.energy is not None:  # the duration is found, too
            problem = problem.varied({}, (problem.t_span[0], problem.t_span[0] + float(known.t[-1] - known.t[0])))
        graphs = self._graphs.for_problem(problem, verbose)
        refinement = BoundaryRefinement(
            graphs, self.tol, self.method, newton if solver is None else solver, self.limits, self.of
        )
        coarse = map_times(self._coarse, section_times(self.problem), section_times(problem))
        guess = refinement.on_any_mesh(guess, coarse)
        try:
            if known is not None:
                return self._followed(refinement, known)
            if kept is not None:
                mesh = map_times(kept.t, section_times(kept.problem), section_times(problem))
                return refinement.resume(graphs.solve(self.method, mesh, guess, refinement.local_solver))
        except LimitReached:
            raise
        except ConvergenceError:
            pass  # the strategies for a first path may find this one
        return refinement.run(coarse, guess)

    def _followed(self, refinement: BoundaryRefinement, known: Trajectory) -> Trajectory:
        """The path that continues a known one of other given values, on the mesh of that.

        Both are compared by the numbers of negative eigenvalues of their Hessians.  Another number may be that of
        another branch, so that the curve of paths between both values is followed.
        """
        assert isinstance(known.problem, BoundaryProblem)
        graphs, path = refinement.graphs, known.polynomial.at(self.method.element.nodes)
        mesh = map_times(known.t, section_times(known.problem), section_times(graphs.problem))

        def solved(values: np.ndarray) -> CriticalPoint:
            return graphs.solve(self.method, mesh, values, refinement.local_solver)

        def index(problem: BoundaryProblem, path: PiecewisePolynomial) -> int | None:
            if path not in self._indices:
                graph = graphs.transcription(self.method, path.mesh).for_problem(problem)
                self._indices[path] = negative_eigenvalues(graph.stationarity, *graph.on_path(path))
            return self._indices[path]

        lost: ConvergenceError | None = None
        try:
            ends = graphs.problem.given_positions.T
            bent = path.copy()
            bent[:, [0, -1]] = np.where(np.isnan(ends), path[:, [0, -1]], ends)
            point = solved(bent)
            if index(point.problem, point.polynomial) == index(known.problem, known.polynomial):
                return refinement.resume(point)
        except LimitReached:
            raise
        except ConvergenceError as failure:
            lost = failure
        graph = graphs.transcription(self.method, mesh)
        unknowns, before = graph.for_problem(known.problem).on_path(known.polynomial)
        data = graph.data(mesh, graph.plane(known.polynomial))
        begun, sizes = np.append(unknowns, 1.0), graph.stationarity.sizes(unknowns, before)
        for guess in LoadedCurve(graph.stationarity, data, begun, sizes, target=before).unloaded_points(-1.0):
            return refinement.resume(solved(graph.emb(guess, data).values))
        if lost is not None:
            raise lost
        return refinement.resume(point)


def same_statement(one: Problem, other: BoundaryProblem) -> bool:
    """Whether one of two problems may be `varied` from the other: the same components given, the same breakpoints."""
    if not isinstance(one, BoundaryProblem) or one.breakpoints != other.breakpoints:
        return False
    free = [{name: [a is None for a in values] for name, values in each.given.items()} for each in (one, other)]
    return free[0] == free[1]
