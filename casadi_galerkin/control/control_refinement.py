"""Trajectory optimization to a tolerance: solve, estimate the error, and solve again on a better mesh.

Every path is compared with others of degree m + 2, on its mesh and, if that does not refuse it, on an interlaced one:
see `two_comparisons`, which also proposes the next mesh.  Estimated are the relative errors of cost and duration, and
the largest error of x at the joints and between them, relative to the size of its component.  The error of the control
is not estimated, nor is it known whether the optimum is the global one.

Where the solver finds no path, it tries again with every interval halved and the guess with which all began.  Where one
of the others is not found, there is no error estimate, and the next mesh has every interval halved.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.discrete_calculus import NEAREST, mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import halved
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.control.control_transcription import SHORTEST_STEP, ControlTranscription, check_solver
from casadi_galerkin.control.optimizer import ACCEPTABLE
from casadi_galerkin.control.starts import distinct_optima, optima_of
from casadi_galerkin.control.two_comparisons import (
    BESIDE_FIXED,
    MOST_PARTS,
    TwoComparisons,
    compared,
    from_near,
)
from casadi_galerkin.functional.pointwise import one_by_one
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.phases import Phases
from casadi_galerkin.problems.problem import map_times, section_times, with_values
from casadi_galerkin.solution.control_trajectory import STEP, ControlTrajectory
from casadi_galerkin.solution.errors import ConvergenceError, LimitReached, Limits
from casadi_galerkin.solution.guess import FAR_FROM_GUESS, Guess
from casadi_galerkin.solution.optimal_path import OptimalPath
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solution.quantity import Quantity
from casadi_galerkin.solution.refinement import HINT, Estimate, Refinement
from casadi_galerkin.solvers.deadline import until
from casadi_galerkin.solvers.solver import Solver, ipopt

FIRST_INTERVALS = 8
SOLVER_FRACTION = 1e-2  # part of the tolerance of a quantity to which IPOPT solves: 19 of 19 costs kept their errors
HARDLY_DETERMINED = (
    "The cost hardly depends on the path: ask tol of=lambda path: path.cost, add a small cost of the control, or leave "
    "out a waypoint at a free time that asks for nothing"
)
UNCONFIRMED = (
    "Solve on a fixed mesh of low degree, as with cg.Galerkin(degree=3) and intervals=30, and see the errors that "
    "estimate_error() finds there; or give a guess nearer to the path, or higher limits"
)
ABSOLUTE = "The solver's tolerances are absolute: measure in units in which costs and controls are about one"


def control_method_for(tol: float) -> Galerkin:
    """The default method for a tolerance; with its degree, smooth problems need 8 to 20 intervals."""
    return Galerkin(int(np.clip(np.ceil(1 - np.log10(tol)), 4, 10)))


def without_idle_breakpoints(problem: Any) -> Any:
    """The problem without the breakpoints that have a free time, and neither a waypoint nor a jump.

    Nothing determines their times, and a refinement has joints beside all switches.  The bounds of the duration of two
    joined phases are the sums of their bounds.
    """
    if isinstance(problem, Phases) or problem.duration_bounds is None:
        return problem
    earliest, latest = (np.cumsum(side)[:-1] for side in problem.duration_bounds)
    with_event = [t for t, _ in (*problem.waypoints, *problem.jumps)]
    kept = np.flatnonzero((earliest == latest) | np.isin(problem.breakpoints, with_event))
    low, high = (tuple(np.add.reduceat(side, [0, *kept + 1]).tolist()) for side in problem.duration_bounds)
    return with_values(problem, breakpoints=tuple(problem.breakpoints[k] for k in kept), duration_bounds=(low, high))


def fits_any_mesh(guess: Guess | None) -> bool:
    """Whether a guess is None, a function of time, or values with their times; arrays fit one mesh only."""
    parts = guess if isinstance(guess, tuple) else (guess,)
    return all(part is None or callable(part) or isinstance(part, tuple) for part in parts)


class ControlRefinement(Refinement[Any, Any]):
    """One refinement of a trajectory optimization to a tolerance, of all errors or of a quantity; see `solve`."""

    roundoff_level = 1e-9  # error that the solvers leave
    persistence = 15
    iterations = 0  # of the solver in all solves so far
    build_seconds = 0.0
    found: ControlTrajectory | None = None  # the last path
    known: TwoComparisons | None = None  # the last error estimate, or None where there was none
    cost_known = math.inf  # smallest error so far of the cost of the path that is being refined
    guess: Guess | None = None  # with which the refinement began
    solver_error_prevails = False  # whether the remaining solver error was the largest error of the last level

    def __init__(
        self,
        problem: Any,
        tol: float,
        method: Galerkin,
        limits: Limits,
        solver: Solver,
        verbose: int,
        of: Quantity | None = None,
    ) -> None:
        self.problem = without_idle_breakpoints(problem)
        super().__init__(tol, method, self.problem.breakpoints, limits, verbose, of)
        if of is not None:  # it may be known long before the path
            self.first_tol = FAR_FROM_GUESS
        self.solver = solver

    def solved(self, level: ControlTrajectory) -> tuple[int, int, float]:
        """Degree and intervals of one level, and the violation that the solver has left."""
        return level.method.degree, len(level.t) - 1, level.residual

    def trajectory(self, level: ControlTrajectory, estimate: Estimate[TwoComparisons | None]) -> ControlTrajectory:
        """The optimum of a level whose error is known."""
        assert estimate.detail is not None
        cost, error = estimate.detail.errors
        level.__dict__["_comparisons"] = estimate.detail  # the class is frozen
        return level.amended(error_estimate=error, cost_error=cost)

    def answer(self, level: ControlTrajectory, error: float | None) -> ControlTrajectory:
        """The optimum on the mesh of a level, or the one that was asked for a quantity, with its error."""
        if isinstance(self.asked, OptimalPath):
            return self.asked
        return level if level.error_estimate is not None else replace(level, error_estimate=error)

    def scaled(self, mesh: np.ndarray, path: ControlTrajectory) -> np.ndarray:
        """Joints within the phases of a path, mapped to the phases of the problem."""
        return map_times(mesh, section_times(path.problem), section_times(self.problem))

    def solve(self, method: Galerkin, mesh: np.ndarray, guess: Any) -> ControlTrajectory:
        """Solve with one method on one mesh within the phases of the problem."""
        transcription = ControlTranscription(self.problem, method, mesh, one_by_one)
        known = isinstance(guess, OptimalPath)
        solver = from_near(self.solver, guess) if known else self.solver
        enough = min(SOLVER_FRACTION * self.goal, np.sqrt(EPS))  # slopes of √EPS change a cost by its rounding
        early = known and self.of is not None and enough > ACCEPTABLE and not self.solver_error_prevails
        if early and solver.name == ipopt.name:
            # each bound adds the barrier to the cost
            barrier = enough * (guess.cost_size or 1.0) / transcription.numbering.unknowns
            accept = {"acceptable_tol": enough, "acceptable_iter": 1, "acceptable_compl_inf_tol": barrier}
            solver = replace(solver, options={**accept, **solver.options})
        try:
            with until(self.deadline):
                path = transcription.solve(guess=guess, solver=solver, verbose=self.verbose if self.verbose > 1 else 0)
        except ConvergenceError as failure:
            self.iterations += failure.iterations
            raise
        except ValueError as error:
            if self.found is None:
                raise
            words = f"from the path on the last mesh, {error}"  # which is where a callable overflows
            raise ConvergenceError(words, Path(self.found.phases[0].polynomial)) from error
        finally:
            self.build_seconds += transcription.build_seconds
        self.iterations, self.found = self.iterations + path.iterations, path
        return path

    def solve_finer(self, mesh: np.ndarray, guess: Guess | None) -> ControlTrajectory:
        """The path on a mesh or, where none is found, from the first guess on one twice as fine."""
        try:
            return self.solve(self.method, mesh, guess)
        except ConvergenceError:
            finer = halved(mesh)
            if self.out_of_time() or len(finer) - 1 > self.limits.intervals or not fits_any_mesh(self.guess):
                raise
        return self.solve(self.method, finer, self.guess)  # a path on a coarse mesh may be far from any on a finer one

    def estimate(self, level: ControlTrajectory) -> Estimate[TwoComparisons | None]:
        """The error estimated from paths of higher degree, as far as it is needed: one that is too large is enough."""
        self.check_time()
        self.known, estimate = None, Estimate[TwoComparisons | None](np.inf, False, "no answer of higher degree", None)
        try:
            for detail in compared(level, lambda method, mesh: self.solve(method, self.scaled(mesh, level), level)):
                cost, error = detail.errors
                source = f"degree {detail.better.method.degree}"
                estimate = Estimate(error if self.of is None else detail.change, True, source, detail)
                self.known = detail
                if self.error(level, estimate)[0] > self.goal:
                    break
        except ConvergenceError:
            self.check_time()
            return replace(estimate, trusted=False)
        self.cost_known = min(self.cost_known, cost)
        return estimate

    def better_mesh(self, level: ControlTrajectory, estimate: Estimate[TwoComparisons | None]) -> np.ndarray:
        """The mesh that the comparisons ask for or, where there are none, one twice as fine.

        It is within the phases of the problem.
        """
        detail = estimate.detail
        if detail is None:
            return self.scaled(halved(level.t), level)
        self.check_meshes_help(detail)
        least = 1 / MOST_PARTS if level is self.best[0] else 1.0  # after a level that came no nearer none are merged
        return self.scaled(detail.mesh(self.tol, self.goal, least), detail.better)

    def check_meshes_help(self, detail: TwoComparisons) -> None:
        """Stop where no mesh reduces the error: that of a step, or the remaining solver error on two meshes."""
        least = max(self.tol, detail.change)
        if detail.step_in_place ** (1 if self.of is None else 2) > least:
            hint = f"At t = {detail.step_time:.6g} {STEP}"
            raise self.stopped("no mesh takes away the error of a step", *self.best, hint)
        what, left, hint = "x", detail.path.solver_error, HARDLY_DETERMINED
        if self.of is not None:
            what, left, least, hint = "the cost", detail.of_cost(detail.path.unseen_change), self.goal, ABSOLUTE
        before, self.solver_error_prevails = self.solver_error_prevails, left > least
        if before and self.solver_error_prevails:
            raise self.stopped(f"the remaining solver error of {what} is {left:.0e} of its size", *self.best, hint)

    def solve_on(self, mesh: np.ndarray, level: ControlTrajectory) -> ControlTrajectory:
        """Solve from the better path or, where a path is not confirmed by another one, from where all began."""
        begun = self.guess if fits_any_mesh(self.guess) else level
        try:
            return self.solve_finer(mesh, begun if self.known is None else self.known.better)
        except ConvergenceError as failure:
            raise self.stopped(str(failure), *self.best) from failure

    def shortest(self, mesh: np.ndarray) -> np.ndarray:
        """Lengths of intervals that can still be halved, and divided for a comparison."""
        rounded = NEAREST * np.max(np.abs(mesh)) / BESIDE_FIXED
        return np.full(len(mesh) - 1, max(2 * SHORTEST_STEP * np.ptp(mesh), rounded))

    def stopped(self, reason: str, level: ControlTrajectory, error: float, hint: str = HINT) -> LimitReached:
        """Report the error reached; where the cost alone is within `tol`, as with a singular arc, report that."""
        if self.cost_known <= self.tol and self.of is None:
            words = f"the cost is known to {self.cost_known:.0e}, which is all that of=lambda path: path.cost asks for"
            reason += f" (only the path changes: {words})"
        return super().stopped(reason, level, error, UNCONFIRMED if np.isinf(error) and hint is HINT else hint)

    def run(self, mesh: np.ndarray, guess: Guess | None, starts: int) -> Any:
        """Refine the path of one start or, of several starts, the best on the first mesh that can be refined.

        Raises
        ------
        LimitReached
            with the best path attached, or the last iterate if there is none
        ConvergenceError
            where the solver finds no path on the first mesh, nor on one twice as fine
        """
        if isinstance(guess, ControlTrajectory):
            guess = replace(guess, problem=without_idle_breakpoints(guess.problem))
        self.guess = guess
        try:
            with until((self.began + self.deadline) / 2):  # as long as what follows
                optima, summary = optima_of(starts, self.problem, guess, partial(self.solve_finer, mesh))
        except ConvergenceError as failure:
            if self.out_of_time():
                raise self.late(failure) from None
            raise
        levels, end = distinct_optima(optima), self.deadline
        for left, level in zip(range(len(levels), 0, -1), levels, strict=True):
            now = time.perf_counter()
            self.deadline = now + (end - now) / left  # the cheapest on a coarse mesh may be none on a finer one
            try:
                best = self.refined(level)
                break
            except ConvergenceError:
                if left == 1:
                    raise
        return best.amended(
            solver=best.solver + summary,
            iterations=self.iterations,
            build_seconds=self.build_seconds,
            solve_seconds=time.perf_counter() - self.began - self.build_seconds,
        )

    def refined(self, level: ControlTrajectory) -> ControlTrajectory:
        """Refine a path and return it with its errors."""
        self.known, self.cost_known, self.solver_error_prevails = None, math.inf, False
        path, error = self.refine(level)
        assert self.known is not None, "a path is accepted by its error estimate"
        if self.of is None:
            path = self.trajectory(path, Estimate(error, True, "", self.known))
        return self.answer(path, error)


@dataclass(frozen=True)
class RepeatedOptimization:
    """Optimizations of one problem and of others that are `varied` from it, to a tolerance; see `solve` for the fields.

    What does not fit is refused when it is made.
    """

    problem: ControlProblem | Phases
    tol: float
    method: Galerkin | None
    intervals: Any
    mesh: ArrayLike | None
    limits: Limits
    of: Quantity | None = None
    starts: int = 1

    def __post_init__(self) -> None:
        if self.problem.hold:
            raise ValueError(
                "with hold every interval has one value of the controls, so the mesh is part of the problem and "
                "not to be refined: give a method and intervals in place of a tolerance"
            )
        self.first_mesh(self.problem, None)

    def first_mesh(self, problem: ControlProblem | Phases, guess: Guess | None) -> np.ndarray:
        """Joints with which a refinement begins: given ones, or those of a guess whose error is known, if more."""
        intervals = self.intervals
        if intervals is None and self.mesh is None:
            intervals = FIRST_INTERVALS + len(problem.breakpoints)
            if (
                isinstance(guess, ControlTrajectory)
                and (guess.error_estimate, guess.cost_error) != (None, None)
                and intervals < len(guess.t) - 1 <= self.limits.intervals
            ):
                own, other = (section_times(without_idle_breakpoints(stated)) for stated in (guess.problem, problem))
                if len(own) == len(other):
                    return map_times(guess.t, own, other)
        return mesh_of(problem.t_span, intervals, self.mesh, problem.breakpoints)

    def found(self, problem: Any, guess: Any, kept: Any, solver: Solver | None = None, verbose: int = 0) -> Any:
        """The optimum of a problem from a guess or, without one, from an answer that is kept."""
        begun = kept if guess is None else guess
        known_first = self.tol if self.of is None else np.sqrt(self.tol)  # the cost to the square of what the path is
        method = self.method or control_method_for(known_first)
        solver = check_solver(ipopt if solver is None else solver)
        refinement = ControlRefinement(problem, self.tol, method, self.limits, solver, verbose, self.of)
        return refinement.run(self.first_mesh(problem, begun), begun, self.starts)
