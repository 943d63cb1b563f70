"""The graph of a boundary problem on N intervals: guesses become its unknowns, solvers find its critical points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.boundary.failure_report import conjugate, explained
from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus, remeshed
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import higher_degree_method
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import EPS, component_sizes
from casadi_galerkin.functional.boundary_terms import functional_of, given_values
from casadi_galerkin.functional.buffers import fork_waits
from casadi_galerkin.functional.numbering import Data, joints_of
from casadi_galerkin.functional.pointwise import PointMap
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.constrained_motion import tangent_at_joints
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import Guess, guess_values, meeting_ends, phase_plane
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solvers.newton import Solution, SolveFailure
from casadi_galerkin.solvers.second_variation import SINGULAR, smallest_curvature
from casadi_galerkin.solvers.solver import SolverLike, newton
from casadi_galerkin.solvers.stationarity import Stationarity, joined

Graph = TypeVar("Graph", bound="BoundaryGraph")


@dataclass(frozen=True)
class CriticalPoint:
    """A critical point: the solution of a solver, the problem that it solves, and its path."""

    solution: Solution
    problem: BoundaryProblem
    polynomial: PiecewisePolynomial

    integral_multipliers: np.ndarray

    @property
    def motion(self) -> BoundaryProblem:
        """The problem of this path without integral conditions: with their multipliers, of which L + μ·g is made."""
        return self.problem.with_multipliers(self.integral_multipliers.tolist())

    @cached_property
    def momentum(self) -> np.ndarray:
        """Momenta at the joints, (d, N + 1); with velocities that are tangent to a constraint."""
        momentum = self.solution.momentum.reshape(self.problem.dimension, -1, order="F")
        return tangent_at_joints(self.motion, self.polynomial, momentum)


class BoundaryGraph:
    """A boundary problem on N intervals as one CasADi graph; arguments and attributes as of `Transcription`."""

    def __init__(self, problem: BoundaryProblem, method: Galerkin, mesh: np.ndarray, mapping: PointMap) -> None:
        self.problem, self.method, self.mesh = problem, method, mesh
        with fork_waits:
            self.functional = functional_of(problem, method, len(mesh) - 1, mapping)
            self.stationarity = Stationarity(self.functional)
        self.numbering = self.functional.numbering
        self._mapping, self._others = mapping, dict[Galerkin, Any]()  # graphs of this class

    def for_problem(self: Graph, problem: BoundaryProblem) -> Graph:
        """The same graph for a problem that is `varied` from this one's; nothing is built."""
        if problem is self.problem:
            return self
        other = object.__new__(type(self))
        other.__dict__ |= self.__dict__ | {"problem": problem}
        return other

    def __reduce__(self) -> tuple[object, ...]:
        """Pickled without its Functions, which are built again from the problem."""
        return type(self), (self.problem, self.method, self.mesh, self._mapping)

    def for_method(self: Graph, method: Galerkin) -> Graph:
        """The graph of another method on the same mesh; built once for all problems varied from one."""
        if method not in self._others:
            self._others[method] = type(self)(self.problem, method, self.mesh, self._mapping)
        built: Graph = self._others[method]
        return built.for_problem(self.problem)

    @property
    def higher(self: Graph) -> Graph:
        """The graph of the higher degree for the error estimate."""
        return self.for_method(higher_degree_method(self.method.degree))

    @property
    def build_seconds(self) -> float:
        """Seconds spent on building the graph so far, and those of other methods."""
        return self.functional.build_seconds + sum(built.build_seconds for built in tuple(self._others.values()))

    @cached_property
    def _calculus(self) -> DiscreteCalculus:
        return DiscreteCalculus(self.method, self.mesh)

    def emb(self, unknowns: np.ndarray, data: Data) -> PiecewisePolynomial:
        """The path x̄ of unknowns ξ."""
        values = joined(unknowns, data)[self.numbering.of_nodes]
        return PiecewisePolynomial(joints_of(self.numbering, unknowns, data), self.method.element.nodes, values.T)

    def critical_point(
        self,
        changes: Mapping[str, object] | None = None,
        guess: Guess | None = None,
        mesh: ArrayLike | None = None,
        solver: SolverLike = newton,
        verbose: int = 0,
    ) -> CriticalPoint:
        """Find the node values of the path, without the checks and quantities that `trajectory` adds.

        Parameters are those of `BoundaryProblem.varied` and of `solve`.
        """
        if not callable(solver):
            raise TypeError(f"solver must be cg.newton, cg.rootfinder, cg.ipopt or cg.minimizer, got {solver!r}")
        calculus = self._calculus if mesh is None else remeshed(self._calculus, mesh, self.problem.breakpoints)
        joints = calculus.mesh  # of this graph, so that `for_problem` copies what was built
        problem = self.problem.varied(changes or {}, joints[[0, -1]].tolist())
        graph = self.for_problem(problem)
        begun = graph.guess_on_mesh(guess, joints)
        data = graph.data(joints, graph.plane(begun))
        try:
            with fork_waits:  # it builds its Functions when they are first needed
                solution = solver(self.stationarity, self.unknowns(begun.values.T, data), data, verbose)
        except SolveFailure as failure:
            path = self.emb(failure.unknowns, data)
            change = None
            if failure.singular or not self.numbering.free_duration:
                quotient, least_curved_change = graph.smallest_curvature(failure.unknowns, data)
                change = least_curved_change if quotient < EPS**0.5 and np.isfinite(least_curved_change).all() else None
            error = explained(problem, self.stationarity, failure, path, data, change)
            raise error from error.__cause__
        if not isinstance(solution, Solution):
            raise TypeError(f"solver must return a Solution, {solver!r} has returned {solution!r}; take cg.newton")
        return graph.point(solution)

    def point(self, solution: Solution) -> CriticalPoint:
        """The critical point of a solution of this problem."""
        path = self.emb(solution.unknowns, solution.data)
        return CriticalPoint(solution, self.problem, path, self.integral_multipliers(solution.unknowns))

    def integral_multipliers(self, unknowns: np.ndarray) -> np.ndarray:
        """The multipliers of given integrals among the unknowns ξ, (k,)."""
        return unknowns[self.numbering.everywhere][: self.numbering.integrals]

    def on_path(self, path: PiecewisePolynomial) -> tuple[np.ndarray, Data]:
        """Unknowns and data of a path of any degree on any mesh of as many intervals."""
        data = self.data(path.mesh, self.plane(path))
        return self.unknowns(path.at(self.method.element.nodes).T, data), data

    def refuse_conjugate(self, point: CriticalPoint) -> None:
        """Raise if the second variation, computed only if the regularity is small, vanishes at a critical point."""
        if not point.solution.regularity > EPS**0.5:
            self.check_second_variation(point)

    def check_second_variation(self, point: CriticalPoint) -> None:
        """Raise if the second variation vanishes at a critical point."""
        quotient, change = self.smallest_curvature(point.solution.unknowns, point.solution.data)
        if quotient < SINGULAR:
            raise conjugate(self.problem, point.solution, point.polynomial, quotient, change)

    def smallest_curvature(self, unknowns: np.ndarray, data: Data) -> tuple[float, np.ndarray]:
        """Smallest second variation over the sizes of its terms, and its variation at the nodes, (d, N m + 1)."""
        with self.stationarity.linearization() as at, np.errstate(all="ignore"):
            direction, quotient = smallest_curvature(at, unknowns, data)
            if quotient == 0:  # to the last digit: other rounding shows the direction
                at.matrix[:] *= 1 + EPS * np.random.default_rng(len(unknowns)).choice((-1.0, 1.0), len(at.matrix))
                (direction,) = at.solve(self.stationarity.sizes(unknowns, data))
        return quotient, self.change(direction)

    def guess_on_mesh(self, guess: Guess | None, mesh: np.ndarray) -> PiecewisePolynomial:
        """The path of a guess on a mesh, bent to meet the given ends, and integrals that do not change along it."""
        same = np.array_equal(mesh, self.mesh)
        calculus = self._calculus if same else DiscreteCalculus(self.method, mesh)
        values = guess_values(guess, calculus, self.problem.dimension).T
        values = meeting_ends(values, calculus.node_parts, self.problem.given_positions)
        if self.numbering.integrals and self.problem.constraint is None and len(mesh) == len(self.mesh):
            values = self._meeting_integrals(values, calculus.node_parts, mesh)
        return PiecewisePolynomial(mesh, self.method.element.nodes, values.T)

    def _meeting_integrals(self, values: np.ndarray, parts: np.ndarray, mesh: np.ndarray) -> np.ndarray:
        """Node values (N m + 1, d) bent by arches to the given integrals, where these do not change to first order.

        As a straight line has the least length.  Of all components and both sides, the arch of least action is taken.
        """
        numbering, data, sizes = self.numbering, self.data(mesh), component_sizes(values.T)
        numbers, given = np.arange(1, numbering.integrals + 1), np.array(self.problem.integral_values)
        arches = np.sin(np.pi * np.multiply.outer(numbers, parts))
        path, bent, accepted = np.zeros(numbering.free), list[tuple[float, np.ndarray]](), EPS**0.5 * np.abs(given)

        def missed(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """By how much the integrals are missed, (k,), and their derivatives by the node values, (k, N m + 1, d)."""
            path[: numbering.positions] = values.ravel()[numbering.place]
            residual, rows = at.integrals(path, data)
            slopes = np.zeros((len(rows), values.size))
            slopes[:, numbering.place] = rows
            return residual, slopes.reshape(len(rows), *values.shape)

        with self.stationarity.linearization() as at, np.errstate(all="ignore"):
            (along, flat), (_, curved) = missed(values), missed(values + np.multiply.outer(arches[0], sizes))
            if not np.any(np.abs(flat).max(axis=(1, 2)) <= EPS**0.5 * np.abs(curved).max(axis=(1, 2))):
                return values
            shapes = np.einsum("jn,id->jind", arches, np.diag(sizes))  # of every component
            starts = np.eye(len(sizes)) if np.any(np.abs(along) > accepted) else ()
            for start in (*starts, *(-start for start in starts)):
                heights = np.multiply.outer(1 / numbers, start)
                for _ in range(int(-np.log2(EPS))):  # as many halvings as a double has digits
                    here = values + np.tensordot(heights, shapes, 2)
                    residual, slopes = missed(here)
                    if np.all(np.abs(residual) <= accepted):
                        bent.append((at.evaluate("action", path, data)[0].item(), here))
                        break
                    by_heights = np.tensordot(slopes, shapes, ([1, 2], [2, 3])).reshape(len(residual), -1)
                    if not np.isfinite(by_heights).all():
                        break
                    heights = heights - np.linalg.lstsq(by_heights, residual, rcond=None)[0].reshape(heights.shape)
        if not bent:
            raise ConvergenceError(
                f"no path was found: small changes of the guess do not change its integrals, {(along + given).tolist()}"
                f", and no arch bends it to {given.tolist()}. There may be no path of these; else give a guess",
                Path(PiecewisePolynomial(mesh, self.method.element.nodes, values.T)),
            )
        return min(bent, key=lambda found: found[0])[1]

    def change(self, step: np.ndarray) -> np.ndarray:
        """Node values (d, N m + 1) of a step of the unknowns."""
        given = np.zeros(self.numbering.size - self.numbering.free)
        return np.concatenate((step, given))[self.numbering.of_nodes].T

    def data(self, joints: np.ndarray, plane: np.ndarray | None = None) -> Data:
        """Values of all inputs of the graph except the unknowns.

        Parameters
        ----------
        joints : (N + 1,)
        plane : normal and point, (2d,), that fix the phase where it is free
        """
        problem = self.problem
        ends = [np.array([value for value in end if value is not None]) for end in (problem.start, problem.end)]
        parameters = [] if problem.parameters is None else [np.array(problem.parameters)]
        given = given_values(problem, plane)
        return (*ends, joints, *parameters, *([given] if len(given) else []))

    def plane(self, path: PiecewisePolynomial) -> np.ndarray | None:
        """The plane that fixes the phase of a path, if one is needed."""
        return phase_plane(path) if self.problem.free_phase else None

    def plane_in(self, data: Data) -> np.ndarray | None:
        """The plane among the data, if one is needed; it stands first among the given values."""
        return data[-1][: 2 * self.problem.dimension] if self.problem.free_phase else None

    def unknowns(self, values: np.ndarray, data: Data) -> np.ndarray:
        """Unknowns ξ from node values (N m + 1, d); for those of a critical point they are nearly its unknowns.

        Multipliers are taken from least squares.
        """
        numbering = self.numbering
        unknowns = np.zeros(numbering.free)
        unknowns[: numbering.positions] = values.ravel()[numbering.place]
        if numbering.multipliers:
            multipliers = np.arange(numbering.positions, numbering.positions + numbering.multipliers)
            with self.stationarity.linearization() as at:
                found = at.least_squares(unknowns, data, multipliers, component_sizes(values.T))
            if np.all(np.isfinite(found)):
                unknowns[multipliers] = found
        return unknowns
