"""All intervals at once: the transcription of a boundary problem into one graph, solved as often as wanted."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.boundary.failure_report import conjugate, explained, refuse_undefined
from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus, check_breakpoints, mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.lazy import lazy
from casadi_galerkin.calculus.mesh_adaptation import HIGHER, interval_maxima, of_degree
from casadi_galerkin.calculus.numbers import components, numbers
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import EPS, component_sizes
from casadi_galerkin.functional.functional import Functional
from casadi_galerkin.functional.mapping import Mapping, by_rows, one_by_one
from casadi_galerkin.functional.numbering import Data, Numbering
from casadi_galerkin.functional.pointwise import pointwise
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.callables import with_parameters
from casadi_galerkin.problems.legendre_transform import convex, degenerate, legendre_transform, refuse_degenerate
from casadi_galerkin.problems.problem import check_types
from casadi_galerkin.solution.guess import Guess, given_values, meeting_ends
from casadi_galerkin.solution.plotting import plot_pattern
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.solvers.newton import Solution, SolveFailure
from casadi_galerkin.solvers.second_variation import SINGULAR, negative_eigenvalues, smallest_second_variation
from casadi_galerkin.solvers.solver import Solver, SolverLike, newton
from casadi_galerkin.solvers.stationarity import Stationarity, joined

if TYPE_CHECKING:
    from matplotlib.axes import Axes

REGULAR = 1e-9  # `Solution.regularity` above which the second variation need not be looked at
SLOWEST = 0.9  # largest ratio of the two Newton steps of an estimate that their series is summed with
ROUNDED = 0.2  # of eps: what rounding to the nearest double changes in the root mean square
SIGNS = 4  # random signs of the rounding of the equations, from which its effect on the path is estimated
GENERIC = 0.1, 0.4, 0.7  # parts of a line between the ends, bent, at which a Lagrangian is asked for its mass matrix


@dataclass(frozen=True)
class CriticalPoint:
    """What a solver found: its solution, the data it was found for, and the path it stands for."""

    solution: Solution
    data: Data
    polynomial: PiecewisePolynomial


class Transcription:
    """A boundary problem on N intervals as one CasADi graph, built once and solved often.

    Ends, parameters and joints are inputs of the graph: nothing is rebuilt when they change.

    Parameters
    ----------
    problem : BoundaryProblem
    method : Galerkin
    mesh : (N + 1,), the joints used unless others are given to `solve`
    mapping : how L is evaluated at the points, as for `Functional`

    Attributes
    ----------
    numbering : Numbering, which unknown is which value of the path
    functional : Functional, the one graph
    stationarity : Stationarity, what the solvers take
    """

    def __init__(
        self, problem: BoundaryProblem, method: Galerkin, mesh: np.ndarray, mapping: Mapping = by_rows
    ) -> None:
        self.problem, self.method, self.mesh = problem, method, mesh
        fixed_start, fixed_end = (
            tuple(i for i, value in enumerate(end) if value is not None) for end in (problem.start, problem.end)
        )
        numbering = Numbering(method, len(mesh) - 1, problem.dimension, fixed_start, fixed_end, problem.periodic)
        self.functional = Functional(problem.lagrangian, numbering, mapping)
        self.numbering = self.functional.numbering
        self.stationarity = Stationarity(self.functional)

    @property
    def build_seconds(self) -> float:
        """Seconds spent on building the graph so far."""
        return self.functional.build_seconds

    @property
    def action(self) -> ca.Function:
        """S of (unknowns, start, end, mesh[, parameters]); `start` and `end` hold the fixed components only."""
        return self.functional.function("action")

    @property
    def gradient(self) -> ca.Function:
        """∇S by the unknowns, of the same inputs."""
        return self.functional.function("gradient")

    @property
    def hessian(self) -> ca.Function:
        """∇²S by the unknowns, sparse, of the same inputs."""
        return self.functional.function("hessian")

    @property
    def summary(self) -> ca.Function:
        """S, momenta (d, N + 1) at all joints, ∇S and the sizes of the terms it sums, of the same inputs."""
        return self.functional.function("summary")

    @lazy
    def _calculus(self) -> DiscreteCalculus:
        return DiscreteCalculus(self.method, self.mesh)

    def emb(self, unknowns: np.ndarray, data: Data) -> PiecewisePolynomial:
        """The path x̄ that unknowns stand for."""
        values = joined(unknowns, data)[self.numbering.of_nodes]
        return PiecewisePolynomial(data[2], self.method.element.nodes, values.T)

    def solve(
        self,
        start: Sequence[float | None] | None = None,
        end: Sequence[float | None] | None = None,
        parameters: Sequence[float] | None = None,
        guess: Guess | None = None,
        mesh: ArrayLike | None = None,
        solver: Solver = newton,
        verbose: int = 0,
    ) -> Trajectory:
        """Solve for the path; whatever is left out is taken from the problem.

        Parameters
        ----------
        start, end : d numbers, with None exactly where the problem has None
        parameters : as many numbers as the problem has
        guess : nothing (the straight line between the ends), a callable t -> (d,), an array (d, N + 1) of values at
            the joints or (d, N m + 1) at all nodes, or an earlier Trajectory
        mesh : (N + 1,) joints
        solver : newton, rootfinder, ipopt or minimizer
        verbose : 1 prints a summary, 2 also a line per iteration

        Raises
        ------
        ConjugatePointError
            if the Hessian is singular at the path found
        ConvergenceError
            if no path was found that can be verified
        ValueError, TypeError
            for input that does not fit
        """
        began = time.perf_counter() - self.build_seconds
        point = self.critical_point(start, end, parameters, guess, mesh, solver, verbose)
        path = self.trajectory(point, time.perf_counter() - self.build_seconds - began)
        if verbose:
            print(path)
        return path

    def critical_point(
        self,
        start: Sequence[float | None] | None = None,
        end: Sequence[float | None] | None = None,
        parameters: Sequence[float] | None = None,
        guess: Guess | None = None,
        mesh: ArrayLike | None = None,
        solver: SolverLike = newton,
        verbose: int = 0,
    ) -> CriticalPoint:
        """Find the node values of the path without what `trajectory` adds; arguments and errors as for `solve`."""
        if not callable(solver):
            raise TypeError(f"solver must be newton, rootfinder, ipopt or minimizer, got {solver!r}")
        calculus = self._calculus if mesh is None else DiscreteCalculus(self.method, mesh)
        joints = self.mesh if mesh is None else calculus.mesh
        check_breakpoints(joints, self.problem.breakpoints)
        if len(joints) != len(self.mesh):
            raise ValueError(f"this transcription has {len(self.mesh) - 1} intervals, got a mesh of {len(joints) - 1}")
        data = self.data(joints, start, end, parameters)
        first = self.unknowns(self._guess(guess, calculus, data))
        try:
            solution = solver(self.stationarity, first, data, verbose)
        except SolveFailure as failure:
            path = self.emb(failure.unknowns, data)
            raise explained(self.stationarity, failure, path, data) from None
        return CriticalPoint(solution, data, self.emb(solution.unknowns, data))

    def guess_on_mesh(self, guess: Guess | None, mesh: np.ndarray) -> PiecewisePolynomial:
        """Put a guess on a mesh, bent to meet the ends."""
        calculus = DiscreteCalculus(self.method, mesh)
        return calculus.emb(self._guess(guess, calculus, self.data(mesh)).T)

    def corrections(self, path: PiecewisePolynomial) -> list[PiecewisePolynomial]:
        """Two Newton steps from a path on the same mesh, of any degree up to this one's; zero if it is critical here.

        With a higher degree than the path's the first estimates the path's error, in the joints as well as between
        them, and the second how far to trust the first.
        """
        data, calculus = self.data(path.mesh), DiscreteCalculus(self.method, path.mesh)
        unknowns, steps = self.unknowns(path.at(self.method.element.nodes).T), []
        with self.stationarity.linearization() as at:
            for _ in range(2):
                found = at.newton_step(unknowns, data)
                steps.append(found.step if np.isfinite(found.norm) else np.full_like(unknowns, np.nan))
                unknowns = unknowns + steps[-1]
        return [calculus.emb(self.change(step)) for step in steps]

    def error(self, path: PiecewisePolynomial) -> float:
        """Largest error of a path of a lower degree, relative to the size of its components.

        The two Newton steps from it are summed as a geometric series; infinite where one is not finite.
        """
        sizes = component_sizes(path.values)[:, None]
        first, second = (float(np.max(interval_maxima(step) / sizes)) for step in self.corrections(path))
        if not math.isfinite(first + second):
            return math.inf
        return first / (1 - min(SLOWEST, second / first)) if first > 0 else 0.0

    def roundoff(self, point: CriticalPoint) -> float:
        """Estimate what rounding does to a path, relative to the size of its components.

        It is the root mean square, over a few choices of random signs, of the largest |∇²S⁻¹ r|, where every r_i is
        `ROUNDED` times eps and the terms that the i-th equation sums.  The true error was measured at 0.1 to 5 times
        that, or less by luck and symmetry.
        """
        unknowns, data = point.solution.unknowns, point.data
        terms = ROUNDED * EPS * np.array(self.summary(unknowns, *data)[3]).ravel()
        signs = np.random.default_rng(len(unknowns)).choice((-1.0, 1.0), (SIGNS, len(unknowns)))
        with self.stationarity.linearization() as at:
            at.relinearize(unknowns, data)
            moved = np.array(at.solve(*(signs * terms))) / self.stationarity.sizes(unknowns, data)
        floor = float(np.sqrt(np.mean(np.max(np.abs(moved), axis=1) ** 2))) + EPS
        return floor if math.isfinite(floor) else math.inf

    def change(self, step: np.ndarray) -> np.ndarray:
        """Node values (d, N m + 1) of a step of the unknowns."""
        given = np.zeros(self.numbering.size - self.numbering.free)
        return np.asarray(np.concatenate((step, given))[self.numbering.of_nodes].T)

    def data(
        self,
        joints: np.ndarray,
        start: Sequence[float | None] | None = None,
        end: Sequence[float | None] | None = None,
        parameters: Sequence[float] | None = None,
    ) -> Data:
        """Values of all inputs of the graph but the unknowns; the problem's unless others are given."""
        if joints is self.mesh and start is None and end is None and parameters is None:
            return self._stated
        return self._given(joints, start, end, parameters)

    @lazy
    def _stated(self) -> Data:
        """The data of the problem itself."""
        return self._given(self.mesh, None, None, None)

    def _given(
        self,
        joints: np.ndarray,
        start: Sequence[float | None] | None,
        end: Sequence[float | None] | None,
        parameters: Sequence[float] | None,
    ) -> Data:
        data = []
        for name, given in (("start", start), ("end", end)):
            of_problem = values = getattr(self.problem, name)
            if given is not None:
                values = components(name, given, self.problem.dimension)
                if [value is None for value in values] != [value is None for value in of_problem]:
                    raise ValueError(f"{name} must have None where the problem has it, {of_problem}, got {values}")
            data.append(np.array([value for value in values if value is not None]))
        data.append(joints)
        if self.problem.parameters is not None:
            values = self.problem.parameters if parameters is None else parameters
            data.append(np.array(numbers("parameters", values, len(self.problem.parameters))))
        elif parameters is not None:
            raise ValueError(f"the problem has no parameters, got parameters={parameters!r}")
        return tuple(data)

    def unknowns(self, values: np.ndarray) -> np.ndarray:
        """Free values out of node values (N m + 1, d)."""
        return np.asarray(values.ravel()[self.numbering.place])

    def _guess(self, guess: Guess | None, calculus: DiscreteCalculus, data: Data) -> np.ndarray:
        """Node values (N m + 1, d) of a guess, bent to meet the fixed ends."""
        d, parts = self.problem.dimension, calculus.node_parts
        ends = np.append(joined(np.zeros(self.numbering.free), data), np.nan)[self._given_ends]
        values = np.zeros((len(parts), d)) if guess is None else given_values(guess, calculus, d).T
        return meeting_ends(values, parts, ends)

    @lazy
    def _given_ends(self) -> np.ndarray:
        """Entries (2, d) of (u, NaN) that are given at the ends, NaN's where none is."""
        ends = self.numbering.of_nodes[[0, -1]]
        return np.where(ends >= self.numbering.free, ends, self.numbering.size)

    def trajectory(self, point: CriticalPoint, solve_seconds: float) -> Trajectory:
        """Add momenta, action and Morse index to a critical point; arguments and errors as for `solve`."""
        solution, data = point.solution, point.data
        refuse_undefined(self.functional, solution, point.polynomial, data)
        self.refuse_conjugate(point)
        problem = self._solved(data)
        return Trajectory(
            polynomial=point.polynomial,
            momentum=solution.momentum.reshape(self.problem.dimension, -1, order="F"),
            action=solution.action,
            iterations=solution.iterations,
            residual=solution.residual,
            solver=solution.report,
            build_seconds=self.build_seconds,
            solve_seconds=solve_seconds,
            method=self.method,
            problem=problem,
            count_negative=MorseIndex(self, problem, point.polynomial),
            find_error=error_between_ends,
        )

    def refuse_conjugate(self, point: CriticalPoint) -> None:
        """Raise if the second variation vanishes at a critical point."""
        if not point.solution.regularity > REGULAR:
            quotient = smallest_second_variation(self.stationarity, point.solution.unknowns, point.data)
            if quotient < SINGULAR:
                raise conjugate(point.solution, point.polynomial, quotient)

    def _solved(self, data: Data) -> BoundaryProblem:
        """The problem with the ends, joints and parameters that were solved for."""
        if data is self._stated:
            return self.problem
        ends = []
        for given, fixed in zip((self.problem.start, self.problem.end), data[:2], strict=True):
            values = iter(fixed.tolist())
            ends.append(tuple(None if value is None else next(values) for value in given))
        parameters = tuple(data[3].tolist()) if len(data) > 3 else None
        return self.problem.varied((float(data[2][0]), float(data[2][-1])), ends[0], ends[1], parameters)

    def plot_hessian(self, axes: Axes | None = None) -> Axes:
        """Draw the sparsity pattern of the Hessian, a chain of blocks; returns the Matplotlib axes."""
        rows, columns = (np.array(index) for index in self.hessian.sparsity_out(0).get_triplet())
        return plot_pattern(rows, columns, self.numbering.free, axes)

    def __repr__(self) -> str:
        """Say what was built."""
        size = len(self.mesh) - 1
        return (
            f"Transcription of a boundary problem of {self.problem.dimension} component(s), {self.method}, on {size} "
            f"intervals: {self.numbering.free} unknowns, built in {self.build_seconds:.4f} s"
        )


class MorseIndex:
    """Counts the negative eigenvalues of a path's Hessian; pickled without the graph, which is then built again.

    Parameters
    ----------
    transcription : Transcription that found the path
    problem : BoundaryProblem, with the ends and parameters that it was found for
    path : PiecewisePolynomial
    """

    def __init__(self, transcription: Transcription, problem: BoundaryProblem, path: PiecewisePolynomial) -> None:
        self._transcription: Transcription | None = transcription
        self._problem, self._method, self._path = problem, transcription.method, path

    def __call__(self) -> int | None:
        """Number of negative eigenvalues, or None where there is no finite one."""
        problem, mesh = self._problem, self._path.mesh
        graph = self._transcription or transcribed(problem, self._method, None, mesh, one_by_one)
        data = graph.data(mesh, problem.start, problem.end, problem.parameters)
        index = negative_eigenvalues(graph.stationarity, graph.unknowns(self._path.values.T), data)
        if not index:
            return index
        transform = legendre_transform(with_parameters(problem.lagrangian, problem.parameters))
        return index if convex(transform, mesh, self._path(mesh), self._path(mesh, 1)) else None

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_transcription": None}


def error_between_ends(path: Trajectory) -> float:
    """Estimate the relative error of a path between two ends: see `Trajectory.estimate_error`."""
    problem = path.problem
    assert isinstance(problem, BoundaryProblem)
    higher = Transcription(problem, of_degree(path.method.degree + HIGHER), path.t, one_by_one)
    return path.doubted(higher.error(path.polynomial))


def check_mass(problem: BoundaryProblem) -> None:
    """Refuse a Lagrangian whose mass matrix is singular at all of some generic points between the ends."""
    derived, (first, last) = pointwise(problem.lagrangian), problem.t_span
    start, end = (np.array([x or 0.0 for x in end]) for end in (problem.start, problem.end))
    rise, size, span = end - start, component_sizes(np.array([start, end]).T), last - first
    bend = size * np.cos(1.0 + np.arange(len(start)))
    given = [] if problem.parameters is None else [problem.parameters]
    for share in GENERIC:
        t, x, slope = first + share * span, start + share * (rise + bend), rise + (1 - share) * bend
        blocks = derived.derivatives(t, span, x, slope, *given)[3:]
        mass = derived.mass([np.array(block) for block in blocks])[0] * span
        if not (np.isfinite(mass).all() and degenerate(mass)):
            return
    refuse_degenerate(mass, f"wherever it was tried, such as at t = {t:.6g}, x = {x}, v = {slope / span}")


def transcribed(
    problem: BoundaryProblem,
    method: Galerkin,
    intervals: int | None,
    mesh: ArrayLike | None,
    mapping: Mapping = by_rows,
) -> Transcription:
    """Check what is given, and build the graph; arguments as for `transcribe`, and how L is evaluated at the points."""
    check_types(problem, method, BoundaryProblem)
    check_mass(problem)
    return Transcription(problem, method, mesh_of(problem.t_span, intervals, mesh, problem.breakpoints), mapping)
