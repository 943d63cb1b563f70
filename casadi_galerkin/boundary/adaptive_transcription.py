"""A boundary problem that is solved often and to a tolerance: each solve begins on the mesh of the first path.

A mesh and a degree that resolve one path mostly resolve the paths for other ends and parameters.  So the mesh of the
first path is kept, and later paths are solved on it.  The error of each is estimated; where it is too large, the
refinement of `solve` continues from there.

An earlier path is more than a guess, because the problem that it solves is known.  Its node values are taken unchanged,
except for the new ends: then the first Newton step is the tangent of the family of paths.  With a path that was bent to
meet the new ends, Newton's method was measured to need up to twice the iterations, or to fail.  Where it does not
converge in one step, the curve of paths to the new ends, times and parameters is followed.
"""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.boundary.boundary_refinement import BoundaryRefinement, first_discretization
from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.neighboring_problems import ends_replaced, same_statement
from casadi_galerkin.boundary.transcription import GraphCache, check_given
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.numbers import check_verbose, counted
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.functional.buffers import interrupts_raised
from casadi_galerkin.functional.mapping import by_rows
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.problem import map_times, section_times
from casadi_galerkin.solution.errors import ConvergenceError, LimitReached
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solution.limits import Limits, check_tolerance
from casadi_galerkin.solution.quantity import Quantity
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.solvers.curve import LoadedCurve
from casadi_galerkin.solvers.second_variation import negative_eigenvalues
from casadi_galerkin.solvers.solver import Solver, newton


class AdaptiveTranscription:
    """A boundary problem with a tolerance, built once and solved often.

    Parameters
    ----------
    problem : BoundaryProblem
    tol, of, method, intervals, mesh, limits : as for `solve`

    Attributes
    ----------
    first : Trajectory, the first path that was found, whose mesh and degree later solves begin with; None before

    Raises
    ------
    TypeError, ValueError
        as for `transcribe`

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> swing = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + x[0] ** 4, (0, 1), start=[0.0], end=[1.0])
    >>> transcription = cg.transcribe(swing, tol=1e-9)
    >>> paths = [transcription.solve(end=[end]) for end in (1.0, 1.1, 1.2)]
    >>> all(path.error_estimate <= 1e-9 for path in paths), {len(path.t) for path in paths}
    (True, {7})
    """

    def __init__(
        self,
        problem: BoundaryProblem,
        tol: float,
        method: Galerkin | None,
        intervals: int | None,
        mesh: ArrayLike | None,
        limits: Limits | None,
        of: Quantity | None = None,
    ) -> None:
        self.problem, self.tol, self.limits, self.of = problem, check_tolerance(tol), limits or Limits(), of
        self.method, self._coarse = first_discretization(problem, self.tol, method, intervals, mesh)
        self._graphs = GraphCache(problem, by_rows)
        self.first: Trajectory | None = None
        # numbers of negative eigenvalues on a path's own mesh; a path is often known to several that follow it
        self._indices: WeakKeyDictionary[PiecewisePolynomial, int | None] = WeakKeyDictionary()

    def __reduce__(self) -> tuple[object, ...]:
        """Pickled without its Functions, which are built again from the problem."""
        built_from = self.problem, self.tol, self.method, None, self._coarse, self.limits, self.of
        return type(self), built_from, {"first": self.first}

    @interrupts_raised()
    def solve(
        self,
        start: Sequence[float | None] | None = None,
        end: Sequence[float | None] | None = None,
        *,
        parameters: Sequence[float] | None = None,
        guess: Guess | None = None,
        t_span: Sequence[float] | None = None,
        solver: Solver = newton,
        verbose: int = 0,
        **given: Sequence[float | None] | float,
    ) -> Trajectory:
        """Solve for the path to the tolerance; whatever is left out is taken from the problem.

        Parameters
        ----------
        t_span : times of the ends, to which meshes are stretched
        start, end, parameters, solver, given : as for `Transcription.solve`
        guess : the same; from an earlier path of this problem, with other ends, times or parameters, the path is
            followed to the new ones on its own mesh.  Where it is lost, it is a guess as any other; near a fold its
            `morse_index` tells whether it has changed its branch
        verbose : 1 prints a line for each mesh and a summary, 2 also the solver's lines

        Raises
        ------
        LimitReached, ConjugatePointError, ConvergenceError, ValueError, TypeError
            as for `solve`
        """
        check_given(given)
        check_verbose(verbose)
        changes = {"start": start, "end": end, "parameters": parameters, **given}
        problem = self.problem.varied(changes, t_span)
        path = self.found(problem, guess, self.first, solver, verbose)
        self.first = self.first or path
        if verbose:
            print(path)
        return path

    def found(
        self,
        problem: BoundaryProblem,
        guess: Guess | None,
        kept: Trajectory | None,
        solver: Solver = newton,
        verbose: int = 0,
    ) -> Trajectory:
        """Solve for the path of a problem that is `varied` from this one's.

        Parameters
        ----------
        guess, solver, verbose : as for `solve`
        kept : a path whose mesh is tried first, unless the guess brings its own
        """
        known = guess if isinstance(guess, Trajectory) and same_statement(guess.problem, problem) else None
        if known is not None and problem.energy is not None:  # the duration is found, too
            problem = problem.varied({}, (problem.t_span[0], problem.t_span[0] + float(known.t[-1] - known.t[0])))
        graphs = self._graphs.for_problem(problem, verbose)
        refinement = BoundaryRefinement(graphs, self.tol, self.method, solver, self.limits, self.of)
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
            point = solved(ends_replaced(path, graphs.problem))
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

    def __repr__(self) -> str:
        """Say what was built, and what mesh is kept."""
        size = counted(self.problem.dimension, "component")
        words = f"AdaptiveTranscription of a boundary problem of {size}, tol={self.tol:g}"
        if self.first is None:
            return f"{words}: nothing solved yet"
        return (
            f"{words}: first path of degree {self.first.method.degree} on {counted(len(self.first.t) - 1, 'interval')}"
        )
