"""All intervals at once: the transcription of a boundary problem into one graph, solved as often as wanted."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping as Named
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.boundary.failure_report import conjugate, explained, refuse_undefined
from casadi_galerkin.boundary.mass import check_mass
from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus, check_breakpoints, mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.lazy import lazy
from casadi_galerkin.calculus.mesh_adaptation import interval_maxima, of_higher_degree
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import EPS, component_sizes
from casadi_galerkin.functional.mapping import Mapping, by_rows, one_by_one
from casadi_galerkin.functional.numbering import Data, joints_of
from casadi_galerkin.functional.statement import functional_of, given_values, has_phase, phase_plane
from casadi_galerkin.problems.boundary_problem import RATES, BoundaryProblem
from casadi_galerkin.problems.callables import with_parameters
from casadi_galerkin.problems.constrained_motion import motion_of, tangent_momenta
from casadi_galerkin.problems.legendre_transform import convex, legendre_transform
from casadi_galerkin.problems.problem import check_types
from casadi_galerkin.solution.guess import Guess, guess_values, meeting_ends
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


@dataclass(frozen=True)
class CriticalPoint:
    """What a solver found: its solution, the problem and data it was found for, and the path it stands for."""

    solution: Solution
    problem: BoundaryProblem
    data: Data
    polynomial: PiecewisePolynomial

    @lazy
    def momentum(self) -> np.ndarray:
        """Momenta at the joints, (d, N + 1); with velocities that are tangent to a constraint."""
        path, problem = self.polynomial, self.problem
        momentum = self.solution.momentum.reshape(len(path.values), -1, order="F")
        motion = motion_of(problem)
        if motion is None:
            return momentum
        return tangent_momenta(motion, path.mesh, path(path.mesh), momentum, path(path.mesh, 1))


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
    phase : bool, whether a plane has to fix the phase of a path

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

    def __init__(
        self, problem: BoundaryProblem, method: Galerkin, mesh: np.ndarray, mapping: Mapping = by_rows
    ) -> None:
        self.problem, self.method, self.mesh, self.phase = problem, method, mesh, has_phase(problem)
        self.functional = functional_of(problem, method, len(mesh) - 1, mapping)
        self.numbering = self.functional.numbering
        self.stationarity = Stationarity(self.functional)

    def of(self, problem: BoundaryProblem) -> Transcription:
        """The same graph for a problem that is `varied` from this one's; nothing is built."""
        other = object.__new__(type(self))
        other.__dict__.update(vars(self), problem=problem)
        other.__dict__.pop("_stated", None)
        return other

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
        return PiecewisePolynomial(joints_of(self.numbering, unknowns, data), self.method.element.nodes, values.T)

    def solve(
        self,
        start: Sequence[float | None] | None = None,
        end: Sequence[float | None] | None = None,
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
        guess : nothing (the straight line between the ends), a callable t -> (d,), which is called once for all times
            where it takes an array (K,) to (d, K), a pair (times, values) of arrays (K,) and (d, K), joined by lines,
            an array (d, N + 1) of values at the joints or (d, N m + 1) at all nodes, or an earlier Trajectory; a pair
            and a Trajectory over other times are stretched
        mesh : (N + 1,) joints; where the duration is free it is stretched
        solver : newton, rootfinder, ipopt or minimizer
        verbose : 1 prints a summary, 2 also a line per iteration
        given : start_velocity, end_velocity, start_momentum, end_momentum (d numbers each, None where the problem has
            it) or energy, where the problem has them

        Raises
        ------
        ConjugatePointError
            if the Hessian is singular at the path found
        ConvergenceError
            if no path was found that can be verified
        ValueError, TypeError
            for input that does not fit
        """
        check_given(given)
        began = time.perf_counter() - self.build_seconds
        changes = {"start": start, "end": end, "parameters": parameters, **given}
        point = self.critical_point(changes, guess, mesh, solver, verbose)
        path = self.trajectory(point, time.perf_counter() - self.build_seconds - began)
        if verbose:
            print(path)
        return path

    def critical_point(
        self,
        changes: Named[str, object] | None = None,
        guess: Guess | None = None,
        mesh: ArrayLike | None = None,
        solver: SolverLike = newton,
        verbose: int = 0,
    ) -> CriticalPoint:
        """Find the node values of the path, without what `trajectory` adds.

        Parameters are those of `varied` and of `solve`.
        """
        if not callable(solver):
            raise TypeError(f"solver must be newton, rootfinder, ipopt or minimizer, got {solver!r}")
        calculus = self._calculus if mesh is None else DiscreteCalculus(self.method, mesh)
        joints = self.mesh if mesh is None else calculus.mesh
        check_breakpoints(joints, self.problem.breakpoints)
        if len(joints) != len(self.mesh):
            raise ValueError(f"this transcription has {len(self.mesh) - 1} intervals, got a mesh of {len(joints) - 1}")
        problem = self.varied(changes or {}, joints)
        data = self.data(joints, problem)
        values = self._guess(guess, calculus, data)
        if self.phase:
            data = self.data(joints, problem, self.plane(calculus.emb(values.T)))
        try:
            solution = solver(self.stationarity, self.unknowns(values, data), data, verbose)
        except SolveFailure as failure:
            path = self.emb(failure.unknowns, data)
            raise explained(self.stationarity, failure, path, data) from None
        path = self.emb(solution.unknowns, data)
        if self.numbering.stretched:  # the duration asked for was a guess
            problem = problem.varied({}, (float(path.mesh[0]), float(path.mesh[-1])))
        return CriticalPoint(solution, problem, data, path)

    def guess_on_mesh(self, guess: Guess | None, mesh: np.ndarray) -> PiecewisePolynomial:
        """Put a guess on a mesh, bent to meet the ends."""
        calculus = DiscreteCalculus(self.method, mesh)
        return calculus.emb(self._guess(guess, calculus, self.data(mesh)).T)

    def corrections(self, path: PiecewisePolynomial) -> list[PiecewisePolynomial]:
        """Two Newton steps from a path on the same mesh, of any degree up to this one's; zero if it is critical here.

        With a higher degree than the path's the first estimates the path's error, in the joints as well as between
        them, and the second how far to trust the first.  Where the duration is free, a step of it counts by how far the
        path moves in that time.
        """
        calculus, values, steps = DiscreteCalculus(self.method, path.mesh), path.at(self.method.element.nodes).T, []
        data = self.data(path.mesh, None, self.plane(path))
        unknowns = self.unknowns(values, data)
        with self.stationarity.linearization() as at:
            for _ in range(2):
                found = at.newton_step(unknowns, data)
                steps.append(found.step if np.isfinite(found.norm) else np.full_like(unknowns, np.nan))
                unknowns = unknowns + steps[-1]
        changes = [self.change(step) for step in steps]
        if self.numbering.stretched:
            times = calculus.node_times
            by_stretch = path(times, 1) * (times - times[0])
            changes = [change - step[-1] * by_stretch for change, step in zip(changes, steps, strict=True)]
        return [calculus.emb(change) for change in changes]

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

    def varied(self, changes: Named[str, object], joints: np.ndarray) -> BoundaryProblem:
        """The problem with other given values, those that are None left out, on other joints; see its own `varied`."""
        changes = {name: value for name, value in changes.items() if value is not None}
        if not changes and joints is self.mesh:
            return self.problem
        return self.problem.varied(changes, (float(joints[0]), float(joints[-1])))

    def data(self, joints: np.ndarray, problem: BoundaryProblem | None = None, plane: np.ndarray | None = None) -> Data:
        """Values of all inputs of the graph but the unknowns, of the problem itself or of one that is `varied` from it.

        Parameters
        ----------
        joints : (N + 1,)
        problem : BoundaryProblem
        plane : normal and point, (2d,), that fix the phase where it is free
        """
        stated = problem or self.problem
        if joints is self.mesh and stated is self.problem and plane is None:
            return self._stated
        return self._given(stated, joints, plane)

    @lazy
    def _stated(self) -> Data:
        """The data of the problem itself."""
        return self._given(self.problem, self.mesh, None)

    def _given(self, stated: BoundaryProblem, joints: np.ndarray, plane: np.ndarray | None) -> Data:
        ends = [np.array([value for value in end if value is not None]) for end in (stated.start, stated.end)]
        parameters = [] if stated.parameters is None else [np.array(stated.parameters)]
        given = given_values(stated, plane)
        return (*ends, joints, *parameters, *([given] if len(given) else []))

    def plane(self, path: PiecewisePolynomial) -> np.ndarray | None:
        """The plane that fixes the phase of a path, if one is needed."""
        return phase_plane(path) if self.phase else None

    def unknowns(self, values: np.ndarray, data: Data) -> np.ndarray:
        """Unknowns ξ out of node values (N m + 1, d); multipliers are those that the Newton step from there finds."""
        numbering = self.numbering
        positions = np.asarray(values.ravel()[numbering.place])
        if numbering.free == numbering.positions:
            return positions
        unknowns = np.append(positions, np.zeros(numbering.free - numbering.positions))
        if numbering.multipliers:
            multipliers = slice(numbering.positions, numbering.positions + numbering.multipliers)
            with self.stationarity.linearization() as at:
                step = at.newton_step(unknowns, data).step
            if np.all(np.isfinite(step)):
                unknowns[multipliers] = step[multipliers]
        return unknowns

    def _guess(self, guess: Guess | None, calculus: DiscreteCalculus, data: Data) -> np.ndarray:
        """Node values (N m + 1, d) of a guess, bent to meet the fixed ends."""
        d, parts = self.problem.dimension, calculus.node_parts
        ends = np.append(joined(np.zeros(self.numbering.free), data), np.nan)[self._given_ends]
        values = np.zeros((len(parts), d)) if guess is None else guess_values(guess, calculus, d).T
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
        return Trajectory(
            polynomial=point.polynomial,
            momentum=point.momentum,
            action=solution.action - self._work(point),
            iterations=solution.iterations,
            residual=solution.residual,
            solver=solution.report,
            build_seconds=self.build_seconds,
            solve_seconds=solve_seconds,
            method=self.method,
            problem=point.problem,
            second_variation=SecondVariation(self, point.problem, point.polynomial),
            find_error=error_between_ends,
        )

    def _work(self, point: CriticalPoint) -> float:
        """p_0·x_0 - p_N·x_N of given momenta, which the graph adds to the action."""
        if not self.functional.terms:
            return 0.0
        ends = point.polynomial.values[:, [0, -1]].T
        given = point.problem.start_momentum, point.problem.end_momentum
        sums = [
            sum(p * x for p, x in zip(*pair, strict=True) if p is not None) for pair in zip(given, ends, strict=True)
        ]
        return float(sums[0] - sums[1])

    def refuse_conjugate(self, point: CriticalPoint) -> None:
        """Raise if the second variation vanishes at a critical point."""
        if not point.solution.regularity > REGULAR:
            quotient = smallest_second_variation(self.stationarity, point.solution.unknowns, point.data)
            if quotient < SINGULAR:
                raise conjugate(point.solution, point.polynomial, quotient)

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


def check_given(given: Named[str, object]) -> None:
    """Refuse what no boundary problem states."""
    unknown = sorted(set(given) - {*RATES, "energy"})
    if unknown:
        raise TypeError(f"solve takes {', '.join(RATES)} or energy beside its own arguments, got {unknown[0]}")


class SecondVariation:
    """What tells how the action varies about a path; pickled without the graph, which is then built again.

    Parameters
    ----------
    transcription : Transcription that found the path
    problem : BoundaryProblem, with the ends and parameters that it was found for
    path : PiecewisePolynomial
    """

    def __init__(self, transcription: Transcription, problem: BoundaryProblem, path: PiecewisePolynomial) -> None:
        self._transcription: Transcription | None = transcription
        self._problem, self._method, self._path = problem, transcription.method, path

    def _at_path(self) -> tuple[Stationarity, np.ndarray, Data]:
        """The graph's conditions, unknowns and data at the path."""
        problem, mesh = self._problem, self._path.mesh
        graph = self._transcription or transcribed(problem, self._method, None, mesh, one_by_one)
        data = graph.data(mesh, problem, graph.plane(self._path))
        return graph.stationarity, graph.unknowns(self._path.values.T, data), data

    def smallest(self) -> float:
        """Smallest second variation relative to the sizes of its terms; see `softest`."""
        return smallest_second_variation(*self._at_path())

    def negative(self) -> int | None:
        """Number of negative eigenvalues, or None where there is no finite one."""
        problem, mesh = self._problem, self._path.mesh
        index = negative_eigenvalues(*self._at_path())
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
    higher = Transcription(problem, of_higher_degree(path.method.degree), path.t, one_by_one)
    return path.doubted(higher.error(path.polynomial))


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
