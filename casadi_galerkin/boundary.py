"""All intervals at once: the transcription of a boundary problem into one graph, solved as often as wanted."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.action_graph import ActionGraph
from casadi_galerkin.calculus import DiscreteCalculus, Galerkin
from casadi_galerkin.diagnosis import conjugate, explained, refuse_undefined
from casadi_galerkin.engines import rootfinder
from casadi_galerkin.functional import Evaluation
from casadi_galerkin.guesses import Guess, check_types, given_values, mesh_of
from casadi_galerkin.layout import Data
from casadi_galerkin.legendre import convex, legendre_transform
from casadi_galerkin.newton import Solution, SolveFailure
from casadi_galerkin.plotting import plot_pattern
from casadi_galerkin.polynomial import PiecewisePolynomial
from casadi_galerkin.problems import BoundaryProblem
from casadi_galerkin.system import SINGULAR, System, joined, negative_eigenvalues, second_variation
from casadi_galerkin.tracing import components, numbers, with_parameters
from casadi_galerkin.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

REGULAR = 1e-9  # `Solution.regularity` above which the second variation need not be looked at
NOWHERE = np.zeros(1)  # what moves an end that is free
Engine = Callable[[System, np.ndarray, Data, int], Solution]


@dataclass(frozen=True)
class CriticalPoint:
    """What an engine found: its solution, the data it was found for, and the path it stands for."""

    solution: Solution
    data: Data
    path: PiecewisePolynomial


class Transcription(ActionGraph):
    """A boundary problem on N intervals as one CasADi graph, built once and solved often.

    Ends, parameters and joints are inputs of the graph: nothing is rebuilt when they change.

    Parameters
    ----------
    problem : BoundaryProblem
    method : Galerkin
    mesh : (N + 1,), the joints used unless others are given to `solve`
    evaluation : of gradient and Hessian at the points, as for `Functional`

    Attributes
    ----------
    action, gradient, hessian, summary : Functions of (unknowns, start, end, mesh[, parameters])
        S, ∇S and the sparse ∇²S by the unknowns; S with the momenta; `start` and `end` hold the fixed components only
    system : the same for the engines, with what else they need; built when first used
    build_seconds : float
    """

    @cached_property
    def _calculus(self) -> DiscreteCalculus:
        return DiscreteCalculus(self.method, self.mesh)

    def values(self, unknowns: np.ndarray, data: Data) -> np.ndarray:
        """Node values (N m + 1, d) in the order of time."""
        return np.asarray(joined(unknowns, data)[self.layout.numbering])

    def emb(self, unknowns: np.ndarray, data: Data) -> PiecewisePolynomial:
        """The path x̄ that unknowns stand for."""
        return PiecewisePolynomial(data[2], self.method.element.nodes, self.values(unknowns, data).T)

    def solve(
        self,
        start: Sequence[float | None] | None = None,
        end: Sequence[float | None] | None = None,
        parameters: Sequence[float] | None = None,
        guess: Guess | None = None,
        mesh: ArrayLike | None = None,
        solver: Engine = rootfinder,
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
        solver : rootfinder, ipopt or minimizer
        verbose : 1 prints a summary, 2 also a line an iteration

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
        solver: Engine = rootfinder,
        verbose: int = 0,
    ) -> CriticalPoint:
        """Find the node values of the path without what `trajectory` adds; arguments and errors as for `solve`."""
        if not callable(solver):
            raise TypeError(f"solver must be rootfinder, ipopt or minimizer, got {solver!r}")
        calculus = self._calculus if mesh is None else DiscreteCalculus(self.method, mesh)
        joints = self.mesh if mesh is None else calculus.mesh
        if len(joints) != len(self.mesh):
            raise ValueError(f"this transcription has {len(self.mesh) - 1} intervals, got a mesh of {len(joints) - 1}")
        data = self.data(joints, start, end, parameters)
        first = self.unknowns(self._guess(guess, calculus, data))
        with self.system.algebra.lock:
            try:
                solution = solver(self.system, first, data, verbose)
            except SolveFailure as failure:
                raise explained(self, failure, self.emb(failure.unknowns, data), data) from None
        return CriticalPoint(solution, data, self.emb(solution.unknowns, data))

    def drawn(self, guess: Guess | None, mesh: np.ndarray) -> PiecewisePolynomial:
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
        with self.system.algebra.lock:
            for _ in range(2):
                (gradient,) = self.system.evaluate("derivatives", unknowns, data)
                steps.extend(self.system.solve(gradient))
                unknowns = unknowns + steps[-1]
        return [calculus.emb(self.change(step)) for step in steps]

    def change(self, step: np.ndarray) -> np.ndarray:
        """Node values (d, N m + 1) of a step of the unknowns."""
        given = np.zeros(self.layout.size - self.layout.free)
        return np.asarray(np.concatenate((step, given))[self.layout.numbering].T)

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

    @cached_property
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
        return np.asarray(values.ravel()[self.layout.place])

    @cached_property
    def _bent(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where what is given at the ends stands in (start, end, 0) and in the flat node values; what moves the ends.

        The last is an index (2, d) into the first: a free component takes over what the other end is moved by, and
        one that is free at both stays, by the 0.
        """
        numbering = self.layout.numbering
        ends = numbering[[0, -1]] - self.layout.free
        rows, columns = np.nonzero(ends >= 0)
        nodes = np.ravel_multi_index((rows * (len(numbering) - 1), columns), numbering.shape)
        moved_by = np.full(ends.shape, len(rows))
        moved_by[rows, columns] = np.arange(len(rows))
        moved_by = np.where(ends >= 0, moved_by, moved_by[::-1])
        return np.append(ends[rows, columns], self.layout.size - self.layout.free), nodes, moved_by

    def _guess(self, guess: Guess | None, calculus: DiscreteCalculus, data: Data) -> np.ndarray:
        """Node values (N m + 1, d) of a guess, bent to meet the fixed ends by adding a straight line."""
        given, nodes, moved_by = self._bent
        moves = np.concatenate((*data[:2], NOWHERE))[given]
        values = None if guess is None else given_values(guess, calculus, self.problem.dimension).T
        if values is not None:
            moves[:-1] -= values.ravel()[nodes]
            if not np.count_nonzero(moves):
                return values
        first, last = moves[moved_by]
        line = first + np.multiply.outer(calculus.node_parts, last - first)
        return np.asarray(line if values is None else values + line)

    def trajectory(self, point: CriticalPoint, solve_seconds: float) -> Trajectory:
        """Add momenta, action and Morse index to a critical point; arguments and errors as for `solve`."""
        solution, data = point.solution, point.data
        refuse_undefined(self, solution, point.path, data)
        if not solution.regularity > REGULAR:
            with self.system.algebra.lock:
                quotient = second_variation(self.system, solution.unknowns, data)
            if quotient < SINGULAR:
                raise conjugate(solution, point.path, quotient)
        problem = self._solved(data)
        return Trajectory(
            t=point.path.mesh.copy(),
            x=point.path.values[:, :: self.method.degree].copy(),
            momentum=solution.momentum.reshape(self.problem.dimension, -1, order="F"),
            path=point.path,
            action=solution.action,
            iterations=solution.iterations,
            residual=solution.residual,
            solver=solution.report,
            build_seconds=self.build_seconds,
            solve_seconds=solve_seconds,
            method=self.method,
            problem=problem,
            count_negative=MorseIndex(self, problem, point.path),
        )

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
        return plot_pattern(rows, columns, self.layout.free, axes)


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
        graph = self._transcription or transcribed(problem, self._method, None, mesh, "single")
        data = graph.data(mesh, problem.start, problem.end, problem.parameters)
        index = negative_eigenvalues(graph.system, graph.unknowns(self._path.values.T), data)
        if not index:
            return index
        transform = legendre_transform(with_parameters(problem.lagrangian, problem.parameters))
        return index if convex(transform, mesh, self._path(mesh), self._path(mesh, 1)) else None

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_transcription": None}


def transcribe(
    problem: BoundaryProblem,
    method: Galerkin,
    intervals: int | None = None,
    *,
    mesh: ArrayLike | None = None,
    jit: bool = False,
) -> Transcription:
    """Build the graph of a boundary problem once, to solve it often.

    Parameters
    ----------
    problem : BoundaryProblem
    method : Galerkin
    intervals : number of equal intervals; or
    mesh : (N + 1,) joints from t_span[0] to t_span[1]
    jit : compile the Newton iteration in C, which is then 2 to 9 times faster, less where sin and exp dominate: 0.5 to
        1.5 s for a short Lagrangian, 2.5 ms an instruction of its derivatives for a long one; of periodic paths, fewer
        than 4 intervals or more than 10 sparsely coupled components only the points.  Needs gcc or cc
    """
    return transcribed(problem, method, intervals, mesh, "compiled" if jit else "vectorised")


def transcribed(
    problem: BoundaryProblem,
    method: Galerkin,
    intervals: int | None,
    mesh: ArrayLike | None,
    evaluation: Evaluation,
) -> Transcription:
    """`transcribe`, with the way that the Lagrangian is evaluated at the points, as for `Functional`."""
    check_types(problem, method, BoundaryProblem)
    return Transcription(problem, method, mesh_of(problem.t_span, intervals, mesh), evaluation)
