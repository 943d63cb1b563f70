"""A boundary problem on N intervals, built once and solved often: trajectories with index and error; kept graphs."""

from __future__ import annotations

import time
from collections.abc import Sequence
from copy import copy
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.boundary.error_estimate import error_between_ends, roundoff_error
from casadi_galerkin.boundary.failure_report import refuse_undefined
from casadi_galerkin.boundary.graph import BoundaryGraph, CriticalPoint
from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.discrete_calculus import mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import higher_degree_method
from casadi_galerkin.calculus.numbers import check_verbose, counted
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.functional.buffers import interrupts_raised
from casadi_galerkin.functional.numbering import Data
from casadi_galerkin.functional.pointwise import PointMap, by_rows, one_by_one
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.constrained_motion import off_constraint
from casadi_galerkin.problems.legendre_transform import convex, legendre_transform
from casadi_galerkin.problems.tables import off_tables
from casadi_galerkin.solution.error_indicators import kinks_in_place
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import Guess, turned_back
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solution.plotting import COLORS, axes_or_new
from casadi_galerkin.solution.trajectory import Comparisons, Trajectory, compared
from casadi_galerkin.solvers.second_variation import negative_eigenvalues, smallest_second_variation
from casadi_galerkin.solvers.solver import Solver, SolverLike, newton
from casadi_galerkin.solvers.stationarity import Stationarity

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Transcription(BoundaryGraph):
    """A boundary problem on N intervals as one CasADi graph, built once and solved often.

    Ends, parameters and joints are inputs of the graph: nothing is rebuilt when they change.

    Parameters
    ----------
    problem : BoundaryProblem
    method : Galerkin
    mesh : (N + 1,), the joints used unless others are given to `solve`
    mapping : how L is evaluated at the points, see `functional.pointwise`

    Attributes
    ----------
    numbering : Numbering of the unknowns
    functional : Functional, the one graph
    stationarity : Stationarity, the equations that solvers take
    build_seconds : float, spent on building the graph so far

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> fall = cg.BoundaryProblem(lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * x[0], (0, 1), [0], [0], parameters=[10])
    >>> transcription = cg.transcribe(fall, cg.Galerkin(degree=2), intervals=4)
    >>> transcription.solve(parameters=[2.0]).momentum[:, 0].round(9).tolist()
    [1.0]
    >>> transcription.hessian.sparsity_out(0).shape
    (7, 7)
    """

    @property
    def action(self) -> ca.Function:
        """S, with the end action and the work of given momenta, of (unknowns, start, end, mesh[, parameters][, given]).

        Of `start` and `end` the fixed components; `given` are the velocities and momenta that the problem states, the
        plane that fixes a free phase, the values of integrals, and the energy, in this order.  Multipliers times what
        they hold to zero, such as end conditions and constraints, are left out, and so is a given energy times the
        duration.
        """
        return self.functional.function("action")

    @property
    def gradient(self) -> ca.Function:
        """∇S by the unknowns, of the same inputs; with the terms that `action` leaves out, and with forces."""
        return self.functional.function("gradient")

    @property
    def hessian(self) -> ca.Function:
        """∇²S by the unknowns, sparse, of the same inputs."""
        return self.functional.function("hessian")

    @interrupts_raised()
    def solve(
        self,
        start: Sequence[float | None] | None = None,
        end: Sequence[float | None] | None = None,
        *,
        parameters: Sequence[float] | None = None,
        guess: Guess | None = None,
        mesh: ArrayLike | None = None,
        solver: Solver = newton,
        verbose: int = 0,
        **given: Sequence[float | None] | float,
    ) -> Trajectory:
        """Solve for the path; whatever is left out is taken from the problem.

        Parameters
        ----------
        start, end : d numbers, with None exactly where the problem has None
        parameters : as many numbers as the problem has
        guess : None (the straight line between the ends), a callable t -> (d,), a pair (times, values) of arrays
            (K,) and (d, K), joined by lines, an array (d, N + 1) of values at the joints or (d, N m + 1) at all nodes,
            or an earlier Trajectory; a pair and a Trajectory over other times are stretched
        mesh : (N + 1,) joints; where the duration is free it is stretched
        solver : newton, rootfinder, ipopt or minimizer
        verbose : 1 prints a summary, 2 also a line per iteration
        given : start_velocity, end_velocity, start_momentum, end_momentum (d numbers each, None where the problem has
            it), integral_values (k numbers) or energy, where the problem has them

        Raises
        ------
        ConjugatePointError
            if the Hessian is singular at the path found
        ConvergenceError
            if no path was found that can be verified
        ValueError, TypeError
            for input that does not fit
        """
        check_verbose(verbose)
        began = time.perf_counter() - self.build_seconds
        changes = {"start": start, "end": end, "parameters": parameters, **given}
        point = self.critical_point(changes, guess, mesh, solver, verbose)
        path = self.trajectory(point, time.perf_counter() - self.build_seconds - began)
        if verbose:
            print(path)
        return path

    def trajectory(self, point: CriticalPoint, solve_seconds: float) -> Trajectory:
        """Add momenta, action and Morse index to a critical point; arguments and errors as for `solve`."""
        solution, problem, path = point.solution, point.problem, point.polynomial
        refuse_undefined(self.functional, solution, path)
        wrong = (
            turned_back(problem, path, self.plane_in(solution.data))
            or off_constraint(problem, path)
            or off_tables(problem, path)
        )
        if wrong is not None:
            raise ConvergenceError(wrong, Path(path), solution.residual, solution.iterations)
        self.refuse_conjugate(point)
        if self.numbering.free_duration:  # the duration asked for was a guess
            problem = problem.varied({}, (float(path.mesh[0]), float(path.mesh[-1])))
        variations = SecondVariation(self, problem, path, point.integral_multipliers)
        return Trajectory(
            polynomial=path,
            momentum=point.momentum,
            action=solution.action,
            iterations=solution.iterations,
            residual=solution.residual,
            solver=solution.report,
            build_seconds=self.build_seconds,
            solve_seconds=solve_seconds,
            method=self.method,
            problem=problem,
            variations=variations,
            find_comparisons=variations.comparisons,
            integral_multipliers=point.integral_multipliers,
        )

    def nearby(self, path: PiecewisePolynomial) -> Trajectory:
        """The path of the problem near one of another degree on as many intervals; errors as for `solve`."""
        return self.trajectory(self.critical_point(guess=path, mesh=path.mesh), 0.0)

    def plot_hessian(self, axes: Axes | None = None) -> Axes:
        """Draw the sparsity pattern of the Hessian, a chain of blocks; returns the Matplotlib axes."""
        rows, columns = self.hessian.sparsity_out(0).get_triplet()
        axes, size, side = axes_or_new(axes), self.numbering.free, max(self.numbering.free, 1)
        axes.plot(columns, rows, "s", color=COLORS[0], markersize=max(0.4, 230 / side), markeredgewidth=0)
        axes.set(xlim=(-0.5, side - 0.5), ylim=(side - 0.5, -0.5), aspect="equal", xlabel="unknown", ylabel="equation")
        axes.set_title(f"{len(rows)} nonzeros, {100 * len(rows) / side**2:.3g} % of {size} × {size}", fontsize="medium")
        return axes

    def __repr__(self) -> str:
        """Say what was built."""
        return (
            f"Transcription of a boundary problem of {counted(self.problem.dimension, 'component')}, {self.method}, on "
            f"{counted(len(self.mesh) - 1, 'interval')}: {counted(self.numbering.free, 'unknown')}, built in "
            f"{self.build_seconds:.4f} s"
        )


class SecondVariation:
    """Second variation and error estimate of a path; pickled without the graph, which is built again when needed.

    Parameters
    ----------
    transcription : Transcription that found the path
    problem : BoundaryProblem, with the ends and parameters of the path
    path : PiecewisePolynomial
    multipliers : of integral conditions
    """

    def __init__(
        self, transcription: Transcription, problem: BoundaryProblem, path: PiecewisePolynomial, multipliers: np.ndarray
    ) -> None:
        self._transcription: Transcription | None = transcription
        self._problem, self._method, self._path = problem, transcription.method, path
        self._motion = problem.with_multipliers(multipliers.tolist())

    def _graph(self) -> Transcription:
        """The graph of the path's own degree."""
        built = self._transcription or transcribed(self._problem, self._method, None, self._path.mesh, one_by_one)
        return built.for_problem(self._problem)

    def _at_path(self, graph: BoundaryGraph) -> tuple[Stationarity, np.ndarray, Data]:
        """The conditions of a graph, and its unknowns and data at the path."""
        return graph.stationarity, *graph.on_path(self._path)

    @cached_property
    def _kinked(self) -> bool:
        """Whether L has a kink in x on the path, whose part of the second variation is in no Hessian."""
        return bool(np.any(kinks_in_place(self._motion, self._path)))

    def difference(self) -> float:
        """Relative difference to a path of a higher degree: see `error_between_ends`."""
        return error_between_ends(self._graph(), self._path)

    def comparisons(self, path: Trajectory) -> Comparisons:
        """With the path of a higher degree on the same mesh, by Newton's method from this one."""
        return compared(path, self._graph().higher.nearby(path.polynomial))

    def rounding(self) -> float:
        """Relative roundoff error of the path: see `roundoff_error`."""
        graph = self._graph()
        return roundoff_error(graph, *graph.on_path(self._path))

    def smallest(self) -> float | None:
        """Smallest second variation over the sizes of its terms, see `smallest_curvature`; None at a kink of L in x."""
        return None if self._kinked else smallest_second_variation(*self._at_path(self._graph()))

    def negative(self) -> int | None:
        """Number of negative eigenvalues; None where it is not finite, or is different in a higher degree.

        At a kink of L in x it is None as well.  If variations too short for the mesh lower the action, the number grows
        with the degrees of freedom, and a higher degree counts more.

        The second variation is integrated by twice as many Gauss points as the degree.  Among the variations of one
        degree it then has no more negative eigenvalues than among all.  Integrated by as many points as the degree, it
        was measured to have up to four too many in a layer, and the same number in both degrees.
        """
        if self._kinked:
            return None
        path, graph = self._path, self._graph()
        degrees = self._method.degree, higher_degree_method(self._method.degree).degree
        methods = (Galerkin(degree, quadrature=gauss(2 * degree)) for degree in degrees)
        index, of_higher = (negative_eigenvalues(*self._at_path(graph.for_method(method))) for method in methods)
        if index is None or index != of_higher:
            return None
        transform = legendre_transform(self._motion.numeric.lagrangian)
        ends = np.array([0.0, 1.0])  # of every interval
        return index if convex(transform, *path.sampled(ends)) else None

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_transcription": None}


def transcribed(
    problem: BoundaryProblem,
    method: Galerkin,
    intervals: int | None,
    mesh: ArrayLike | None,
    mapping: PointMap = by_rows,
) -> Transcription:
    """Check what is given, and build the graph; arguments as for `transcribe`, and how L is evaluated at the points."""
    return Transcription(problem, method, mesh_of(problem.t_span, intervals, mesh, problem.breakpoints), mapping)


class GraphCache:
    """Graphs that are built at their first use and kept; also counts the iterations of all solves.

    `mapping` is how L is evaluated at the points, as for `Functional`; `verbose` applies to all solves.
    """

    def __init__(self, problem: BoundaryProblem, mapping: PointMap = one_by_one, verbose: int = 0) -> None:
        self.problem, self.iterations, self._mapping, self.verbose = problem, 0, mapping, verbose
        self._transcriptions: dict[tuple[Galerkin, int], Transcription] = {}

    def for_problem(self, problem: BoundaryProblem, verbose: int = 0) -> GraphCache:
        """The same graphs for a problem that is `varied` from this one's; new graphs are kept for both."""
        other = copy(self)
        other.problem, other.iterations, other.verbose = problem, 0, verbose
        return other

    def transcription(self, method: Galerkin, mesh: np.ndarray) -> Transcription:
        """The graph for this degree and number of intervals."""
        key = (method, len(mesh))
        if key not in self._transcriptions:
            self._transcriptions[key] = Transcription(self.problem, method, mesh, self._mapping)
        return self._transcriptions[key].for_problem(self.problem)

    def solve(self, method: Galerkin, mesh: np.ndarray, guess: Guess | None, solver: SolverLike) -> CriticalPoint:
        """Solve one level."""
        graph = self.transcription(method, mesh)
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
