"""From a tolerance to a degree and a mesh, for trajectory optimization.

Every mesh is solved twice: with degree m, and with degree m + 2 from a copy of the first path that is perturbed by
√`tol` (`higher_degree`).  `error_estimate` describes how the two give an error, and `better_mesh` a new mesh.
Estimated are the relative errors of cost and duration, and the largest error of x at the joints and between them,
relative to the size of its component.  The error of the control is not estimated, but the path that it leads to between
the quadrature points is; nor is it known whether the optimum is the global one.

Where the solver finds no path, it tries again with every interval halved, and then from the guess with which all began
in place of the coarser path.  Where it finds none of degree m + 2, there is no error estimate, and the next mesh has
every interval halved.  Meshes may alternate, where controls switch often.  So where four in a row did not reduce the
error, every interval is halved.  IPOPT's own tolerance does not follow `tol`: a looser one was hardly faster, and
sometimes failed.

On smooth paths the estimate is near the true error, and some ten times the error where a position meets its bound.
Where controls switch, or reach their bounds or those of a path constraint, both degrees may share a wrong time of this:
of 402 paths with bounded controls or speeds, the estimates of 34 were too small, by up to 4.5 times, and those of 3
costs, by up to 3.5 times; no error was above `tol`.  How often the estimate bounds the error of the cost is counted on
nineteen problems by `examples/benchmark/literature.py`.

Where a path would be accepted, the errors that the solver leaves (`solver_error`) are added.  A finer mesh does not
reduce them: where they count, the next solves are to leave less (`SHARP`), and where they are above the tolerance once
more, with both degrees, the refinement ends.

Two kinds of paths are out of reach at tight tolerances.  One touches a path constraint in one point, to 1e-8 with a
Gauss rule.  The other has a singular arc, where controls differ from mesh to mesh at the same cost: the error of the
cost is then small long before that of the path.  The error raised says so, and a tolerance of the cost alone is mostly
met.

Jumps in time that are not among the breakpoints are detected, and the mesh is refined beside them.
At tight tolerances the error raised names the time to add.  Where a path constraint steps, the estimate is too small.
"""

from __future__ import annotations

import math
import time
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.discrete_calculus import mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import resized_mesh
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.control.better_mesh import better_mesh
from casadi_galerkin.control.error_estimate import HigherDegree
from casadi_galerkin.control.failure_report import UNITS
from casadi_galerkin.control.higher_degree import from_near, perturbed, raised
from casadi_galerkin.control.phases import with_joined_phases, with_parted_phases
from casadi_galerkin.control.starts import distinct_optima, optima_of
from casadi_galerkin.control.transcription import SHORTEST, transcribed_control
from casadi_galerkin.functional.mapping import one_by_one
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.problem import map_times, section_times
from casadi_galerkin.solution.control_trajectory import STEP, ControlTrajectory
from casadi_galerkin.solution.errors import ConvergenceError, LimitReached
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solution.limits import Limits
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solution.refinement import HINT, Estimate, Refinement
from casadi_galerkin.solvers.deadline import until
from casadi_galerkin.solvers.solver import Solver

FIRST_INTERVALS = 8
# Ratio of IPOPT's tolerance to its last barrier where a control switches.  The barrier keeps values off bounds to which
# little pushes them, such as controls on the short intervals beside a switch.  With IPOPT's own ratio of 10, the mass
# of a rocket was accurate to 3e-7 only.
BARRIER_RATIO = 1e4
# Options with which IPOPT leaves less where no control switches, from where it has left more than this share of the
# tolerance.  It else ends where no multiplier times the distance to its bound exceeds 1e-12, with controls 1e-4 off the
# bounds that they leave or meet.  These come second, because where arcs are singular IPOPT may lose its way with them.
OPEN_SHARE = 0.1
SHARP = {"barrier_tol_factor": BARRIER_RATIO, "compl_inf_tol": 1e-16, "acceptable_iter": 6}
OPEN_LEVELS = 3  # levels in a row that are left open after which the refinement ends: a finer mesh may help
STARTS_TIME_SHARE = 0.5  # part of the time limit after which no further start begins
PATIENCE = 4  # every interval is halved after so many levels in a row without a smaller error, as meshes may alternate
LEFT_OPEN = (
    "Multiply the cost by 100: the solver's tolerances are absolute. If that changes nothing, the cost hardly depends "
    "on the path: give a cost_tol in place of tol, add a small cost of the control, or leave out a waypoint at a free "
    "time that asks for nothing"
)


def control_method_for(tol: float) -> Galerkin:
    """The default method for a tolerance; with its degree, smooth problems need 8 to 20 intervals."""
    return Galerkin(int(np.clip(np.ceil(1 - np.log10(tol)), 4, 10)))


def halved(mesh: np.ndarray) -> np.ndarray:
    """The mesh with every interval halved."""
    return resized_mesh(mesh, 2 * (len(mesh) - 1))


def fits_any_mesh(guess: Guess | None) -> bool:
    """Whether a guess is None, a function of time, or values with their times; arrays fit one mesh only."""
    parts = guess if isinstance(guess, tuple) else (guess,)
    return all(part is None or callable(part) or isinstance(part, tuple) for part in parts)


class ControlRefinement(Refinement[ControlTrajectory, HigherDegree | None]):
    """One refinement of a trajectory optimization to a tolerance: of all errors, or `of_cost` alone; see `solve`."""

    roundoff_level = 1e-9  # error that the solvers leave
    persistence = 15
    iterations = 0  # of the solver in all solves so far
    build_seconds = 0.0
    known: HigherDegree | None = None  # the last error estimate
    cost_known = math.inf  # smallest error so far of the cost of the path that is being refined
    guess: Guess | None = None  # with which the refinement began
    left_open = False  # whether the solver has left an error that counts, and has to leave less
    open_levels = 0  # levels in a row on which it has left the path open all the same

    def __init__(
        self,
        problem: ControlProblem,
        tol: float,
        of_cost: bool,
        method: Galerkin,
        limits: Limits,
        solver: Solver,
        verbose: int,
    ) -> None:
        super().__init__(tol, limits, verbose)
        self.stated, self.problem = problem, with_joined_phases(problem)
        self.of_cost, self.method, self.solver = of_cost, method, solver

    def solved(self, level: ControlTrajectory) -> tuple[PiecewisePolynomial, float]:
        """The path of one level, and the violation that the solver has left."""
        return level.polynomial, level.residual

    def path(self, level: ControlTrajectory, error: float) -> ControlTrajectory:
        """The optimum on the mesh of a level, with its error."""
        path = with_parted_phases(level, self.stated)
        return replace(path, cost_error=error) if self.of_cost else replace(path, error_estimate=error)

    def scaled(self, mesh: np.ndarray, path: ControlTrajectory) -> np.ndarray:
        """Joints within the phases of a path, mapped to the phases of the problem."""
        return map_times(mesh, section_times(path.problem), section_times(self.problem))

    def solve(self, method: Galerkin, mesh: np.ndarray, guess: Guess | None) -> ControlTrajectory:
        """Solve with one method on one mesh within the phases of the problem."""
        transcription = transcribed_control(self.problem, method, None, mesh, one_by_one)
        solver = self.warm_solver if isinstance(guess, ControlTrajectory) else self.solver
        try:
            with until(self.deadline):
                path = transcription.solve(guess=guess, solver=solver, verbose=self.verbose if self.verbose > 1 else 0)
        except ConvergenceError as failure:
            self.iterations += failure.iterations
            raise
        except ValueError as error:
            if self.known is None:
                raise
            words = f"from the path on the last mesh, {error}"  # which is where a callable overflows
            raise ConvergenceError(words, Path(self.known.path.polynomial)) from error
        finally:
            self.build_seconds += transcription.build_seconds
        self.iterations += path.iterations
        return path

    @property
    def warm_solver(self) -> Solver:
        """The solver from an earlier path, with other options where it has none of its own."""
        if self.known is not None and self.known.switches:
            return from_near(self.solver, barrier_tol_factor=BARRIER_RATIO)
        return from_near(self.solver, **(SHARP if self.left_open else {}))

    def solve_finer(self, mesh: np.ndarray, guess: Guess | None) -> ControlTrajectory:
        """The path on a mesh or, where none is found, on one twice as fine."""
        try:
            return self.solve(self.method, mesh, guess)
        except ConvergenceError:
            finer = halved(mesh)
            if self.out_of_time() or len(finer) - 1 > self.limits.intervals or not fits_any_mesh(guess):
                raise
        return self.solve(self.method, finer, guess)

    def estimate(self, level: ControlTrajectory) -> Estimate[HigherDegree | None]:
        """The error estimated from a path of higher degree on the same mesh, where there is one."""
        method = raised(self.method)
        self.check_time()
        try:
            higher = self.solve(method, self.scaled(level.t, level), perturbed(level, math.sqrt(self.tol)))
        except ConvergenceError:
            self.check_time()
            return Estimate(np.inf, False, f"no answer of degree {method.degree}", None)
        before = [] if self.known is None else [*self.known.touches_of_higher, *self.known.touches]
        detail = HigherDegree(level, higher, before)
        cost, path = detail.errors if detail.cost_error <= self.tol else (detail.cost_error, detail.error)
        self.known, self.cost_known = detail, min(self.cost_known, cost)
        return Estimate(cost if self.of_cost else path, True, f"degree {method.degree}", detail)

    def check_solver(self, detail: HigherDegree) -> None:
        """Ask the solver to leave less where what it leaves counts, and stop where it does not, for a path thrice."""
        cost, path = map(min, detail.remaining_error(detail.path), detail.remaining_error(detail.higher))
        if self.left_open and cost > self.tol:
            raise self.stopped(f"the solver may have left {cost:.0e} of the cost", *self.best, UNITS)
        path_open = self.left_open and not self.of_cost and path > max(self.tol, detail.error)
        self.open_levels = self.open_levels + 1 if path_open else 0
        if self.open_levels == OPEN_LEVELS:
            raise self.stopped(f"the solver leaves the path open by {path:.0e} of its size", *self.best, LEFT_OPEN)
        most = cost if self.of_cost else max(cost, detail.path.solver_error)
        self.left_open = self.left_open or most > OPEN_SHARE * self.tol

    def improve(self, level: ControlTrajectory, estimate: Estimate[HigherDegree | None]) -> ControlTrajectory:
        """Solve on the better mesh from the path of higher degree or, where there is none, on a mesh twice as fine."""
        detail = estimate.detail
        if detail is not None:
            self.check_solver(detail)
            if detail.unseen_step ** (2 if self.of_cost else 1) > max(self.tol, detail.change):
                raise self.stopped("no mesh takes away the error of a step", *self.best)
        known = level if detail is None else detail.higher
        if detail is None or (self.fruitless > 0 and self.fruitless % PATIENCE == 0):
            mesh = halved(known.t)
        else:
            mesh = better_mesh(detail, self.path_tol(detail), self.tol)
        if len(mesh) - 1 > self.limits.intervals:
            raise self.stopped(f"the mesh would need {len(mesh) - 1} intervals", *self.best)
        joints = self.scaled(mesh, known)
        if np.min(np.diff(joints)) < 2 * SHORTEST * np.ptp(joints):
            reason = f"the mesh would need an interval near {SHORTEST:g} of the duration"
            raise self.stopped(reason, *self.best)
        try:
            return self.solve_finer(joints, known)
        except ConvergenceError as failure:
            again = fits_any_mesh(self.guess) and 2 * (len(mesh) - 1) <= self.limits.intervals
            if again and not self.out_of_time():  # a path on a coarse mesh may be far from any on a finer one
                with suppress(ConvergenceError):
                    return self.solve(self.method, halved(joints), self.guess)
            raise self.stopped(str(failure), *self.best) from failure

    def path_tol(self, detail: HigherDegree) -> float:
        """Error of the path to aim at: larger where only the cost counts, whose error is of the order of its square."""
        if not self.of_cost:
            return self.tol
        return max(self.tol, detail.change * float(np.sqrt(self.tol / detail.cost_error)))

    def stopped(self, reason: str, level: ControlTrajectory, error: float, hint: str = HINT) -> LimitReached:
        """Report the error reached; where the cost alone is within `tol`, as with a singular arc, report that."""
        known = self.known
        if known is not None and known.unseen_step > self.tol:
            hint = f"At t = {known.path.between_points.unseen_steps.times[np.argmax(known.unseen_steps)]:.6g} {STEP}"
        elif known is not None and known.jump_error > self.tol:
            i, t = int(np.argmax(known.jump_effects)), known.path.t
            when = f"t = {np.mean(t[i : i + 2]):.6g}"
            hint = f"A callable is not smooth in time near {when}, or changes there too fast for this mesh"
            hint += ": name that time in the breakpoints"
        elif level.unseen_change > self.tol * level.cost_size:
            hint = UNITS
        if self.cost_known <= self.tol:
            words = f"the cost is known to {self.cost_known:.0e}, which is all that cost_tol asks for"
            reason += f" (only the path changes: {words})"
        return super().stopped(reason, level, error, hint)

    def run(self, mesh: np.ndarray, guess: Guess | None, starts: int) -> ControlTrajectory:
        """Refine the path of one start or, of several starts, those that may be the best, and return the best.

        An optimum is left out if it costs more on the first mesh than the best refined one, by more than refinement
        changed the costs of others.  While others wait, each refinement takes at most half of the time left, because
        the cheapest path on a coarse mesh may not exist on a finer one.

        Raises
        ------
        LimitReached
            with the best path attached, or the last iterate if there is none
        ConvergenceError
            where the solver finds no path on the first mesh, nor on one twice as fine
        """
        if isinstance(guess, ControlTrajectory):
            guess = replace(guess, problem=with_joined_phases(guess.problem))
        self.guess = guess
        try:
            with until(self.began + STARTS_TIME_SHARE * self.limits.seconds):
                optima, summary = optima_of(starts, self.problem, guess, partial(self.solve_finer, mesh))
        except ConvergenceError as failure:
            if self.out_of_time():
                raise self.late(failure) from None
            raise
        found, failures, change = list[ControlTrajectory](), list[ConvergenceError](), 0.0
        end, levels = self.deadline, distinct_optima(optima)
        for level in levels:
            if found and level.cost - change > min(path.cost for path in found):
                break
            now = time.perf_counter()
            self.deadline = end if level is levels[-1] else now + (end - now) / 2
            try:
                found.append(self.refined(level))
                change = max(change, abs(found[-1].cost - level.cost))
            except ConvergenceError as failure:
                failures.append(failure)
        if not found:
            raise failures[0]
        best = min(found, key=lambda path: path.cost)
        return replace(
            best,
            solver=best.solver + summary,
            iterations=self.iterations,
            build_seconds=self.build_seconds,
            solve_seconds=time.perf_counter() - self.began - self.build_seconds,
        )

    def refined(self, level: ControlTrajectory) -> ControlTrajectory:
        """Refine a path and return it with its errors."""
        self.known, self.cost_known, self.left_open, self.open_levels = None, math.inf, False, 0
        path, _ = self.refine(level)
        assert self.known is not None, "a path is accepted by its error estimate"
        path = with_parted_phases(path, self.stated)
        cost, error = self.known.errors
        return replace(path, error_estimate=error, cost_error=cost)


def first_control_discretization(
    problem: ControlProblem,
    tol: float,
    method: Galerkin | None,
    intervals: int | None,
    mesh: ArrayLike | None,
    guess: Guess | None,
    limits: Limits,
) -> tuple[Galerkin, np.ndarray]:
    """Method and joints with which a refinement begins; refuses what does not fit, see `solve` for the arguments.

    Without intervals and mesh the joints are those of a guess whose error is known, if they are more.
    """
    method = control_method_for(tol) if method is None else method
    if problem.hold:
        raise ValueError(
            "with hold every interval has one value of the controls, so the mesh is part of the problem and "
            "not to be refined: give a method and intervals in place of a tolerance"
        )
    if intervals is None and mesh is None:
        intervals = FIRST_INTERVALS + len(problem.breakpoints)
        if (
            isinstance(guess, ControlTrajectory)
            and (guess.error_estimate, guess.cost_error) != (None, None)
            and intervals < len(guess.t) - 1 <= limits.intervals
        ):
            own, other = (section_times(with_joined_phases(stated)) for stated in (guess.problem, problem))
            if len(own) == len(other):
                return method, map_times(guess.t, own, other)
    return method, mesh_of(problem.t_span, intervals, mesh, problem.breakpoints)
