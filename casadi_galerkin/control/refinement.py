"""From a tolerance to a degree and a mesh, for trajectory optimization.

Every mesh is solved twice, with degree m and, from that path moved by √`tol` of its size, with degree m + 2
(`error_estimate` says how these make an error and a new mesh).  Were it not moved, the solver would be content with
the path itself wherever that hardly counts in the cost, and the two would not differ.  Moved by so much it comes back
to an optimum that is one, and stays away where many paths cost the same.  Estimated are the relative errors of cost and
duration, and the largest error of x at the joints and between them, relative to the size of its component.  Neither
the control is judged, nor whether the optimum is the global one.

Where the solver finds no answer every interval is halved, and the same is tried there; where it finds none of degree
m + 2, the level is not judged, and the next one has the intervals halved.  So has the one after many levels that came
no nearer, which may otherwise go round in circles where controls switch often.  IPOPT's own tolerance does not follow
`tol`: a looser one was hardly faster, and sometimes failed.

On smooth paths the estimate is near the true error.  With bang-bang controls it is only a bound, because it holds for
the switching times, and where a position touches its bound it is many times the error.  How often it bounds the error
of the cost, `examples/benchmark/literature.py` counts on nineteen problems of the literature.

Where a path would be accepted, what the solver itself leaves of cost and path (`solver_error`) is added to their
errors.  No mesh makes it less: where it is above the tolerance with both degrees, the refinement ends at once.

Out of reach is a path to 1e-8 with a path constraint touched in one point and a Gauss rule.  So is a path with a
singular arc, where controls differ from mesh to mesh and cost the same: the cost is then known long before the path.
The error raised says so, and a tolerance of the cost alone is mostly met.

Jumps in time that no breakpoint names are seen (`jumps_in_time`), and the mesh is refined beside them; at tight
tolerances the error raised tells the time to name.  Where a path constraint steps, the estimate is too small.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.discrete_calculus import mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import resized_mesh
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.quadrature import gauss, lobatto
from casadi_galerkin.control.constraint_violation import UNITS
from casadi_galerkin.control.error_estimate import HigherDegree
from casadi_galerkin.control.phases import with_joined_phases, with_parted_phases
from casadi_galerkin.control.several_starts import distinct_optima, optima_of
from casadi_galerkin.control.transcription import SHORTEST, transcribed_control
from casadi_galerkin.functional.mapping import one_by_one
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.problem import check_types, map_times, section_times
from casadi_galerkin.solution.control_path import ControlPath
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.errors import ConvergenceError, LimitReached
from casadi_galerkin.solution.guess import Guess, waves
from casadi_galerkin.solution.limits import Limits
from casadi_galerkin.solution.refinement import HINT, Estimate, Refinement
from casadi_galerkin.solvers.deadline import until
from casadi_galerkin.solvers.solver import Solver

FIRST_INTERVALS = 8
WARM_START_BARRIER = 1e-4  # first one from an earlier level: with 1e-2 a robot arm left its path, and found none
# IPOPT's tolerance over its last barrier where a control switches, times tol², and the largest.  A barrier leaves
# controls between their bounds on the short intervals beside a switch: with IPOPT's own ratio of 10 a mass that burns
# was known to 3e-7.
BARRIER_RATIO, LARGEST_BARRIER_RATIO = 3e-11, 1e4
STARTS_TIME_SHARE = 0.5  # of the time: no further start begins after it
PATIENCE = 10  # levels in a row that came no nearer, after which the mesh is halved: two may lead to one another
HIGHER = 2  # degrees added for the error estimate; two, because of parity


def control_method_for(tol: float) -> Galerkin:
    """The default method for a tolerance: with its degree smooth scenes need 8 to 20 intervals."""
    return Galerkin(int(np.clip(np.ceil(1 - np.log10(tol)), 4, 10)))


def higher_degree_method(method: Galerkin) -> Galerkin:
    """The method with `HIGHER` degrees and points more, of the same kind."""
    rule = lobatto if method.quadrature.points[0] == 0 else gauss
    return Galerkin(method.degree + HIGHER, quadrature=rule(len(method.quadrature) + HIGHER))


def halved(mesh: np.ndarray) -> np.ndarray:
    """The mesh with every interval halved."""
    return resized_mesh(mesh, 2 * (len(mesh) - 1))


def fits_any_mesh(guess: Guess | None) -> bool:
    """Whether a guess is none, a function of time, or values with their times; arrays are values on one mesh."""
    parts = guess if isinstance(guess, tuple) else (guess,)
    return all(part is None or callable(part) or isinstance(part, tuple) for part in parts)


def perturbed(path: ControlTrajectory, by: float) -> ControlTrajectory:
    """A path moved by a random smooth one of this part of its size, and with free durations longer by this part."""
    before, problem, ends = path.polynomial, path.problem, path.t[[0, -1]]
    longer = ends + np.array([0.0, 0.0 if problem.duration_bounds is None else by]) * np.ptp(ends)
    mesh, times = (map_times(own, ends, longer) for own in (path.t, np.array(section_times(problem))))
    sizes = by * np.max(np.abs(before.values), axis=1)
    parts = (before.times(before.nodes[:-1]) - ends[0]) / np.ptp(ends)
    values = before.values + waves(np.random.default_rng(0), sizes)(parts)
    first, *breakpoints, last = times.tolist()
    return replace(
        path,
        polynomial=PiecewisePolynomial(mesh, before.nodes, values, before.arrivals),
        control=ControlPath(mesh, path.control.points, path.control.values, path.control.rule),
        problem=problem.found((first, last), path.parameters, tuple(breakpoints)),
    )


class ControlRefinement(Refinement[ControlTrajectory, HigherDegree | None]):
    """One refinement of a trajectory optimization under way, to a tolerance of all or `of_cost` alone; see `solve`."""

    roundoff_level = 1e-8  # what the solvers leave
    persistence = PATIENCE + 5  # problems of the literature were solved after up to 4 such levels
    iterations = 0  # of the solver in all solves so far

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
        self.of_cost, self.solver = of_cost, solver
        self.warm_solver = solver.with_options(**{"mu_init": WARM_START_BARRIER, **solver.options})
        sharp = float(np.clip(BARRIER_RATIO / tol**2, 10, LARGEST_BARRIER_RATIO))
        self.beside_switches = self.warm_solver.with_options(**{"barrier_tol_factor": sharp, **solver.options})
        self.method = method
        self.build_seconds = 0.0
        self.known: HigherDegree | None = None
        self.cost_known = np.inf  # smallest error of the cost of the path under way
        self.jump: float | None = None  # time near which callables jump by more than is tolerated

    def solved(self, level: ControlTrajectory) -> tuple[PiecewisePolynomial, int, float]:
        """The path of one level, iterations of the solver on it, and the violation it left."""
        return level.polynomial, level.iterations, level.residual

    def path(self, level: ControlTrajectory, error: float) -> ControlTrajectory:
        """The optimum of a level, which solves its own mesh."""
        path = with_parted_phases(level, self.stated)
        return replace(path, cost_error=error) if self.of_cost else replace(path, error_estimate=error)

    def scaled(self, mesh: np.ndarray, path: ControlTrajectory) -> np.ndarray:
        """Joints in the times of a path, scaled to the phases of the problem."""
        return map_times(mesh, section_times(path.problem), section_times(self.problem))

    def solve(self, method: Galerkin, mesh: np.ndarray, guess: Guess | None) -> ControlTrajectory:
        """Solve with one degree on one mesh, in the times of the problem."""
        transcription = transcribed_control(self.problem, method, None, mesh, one_by_one)
        switched = self.known is not None and len(self.known.found) > 0
        warm_solver = self.beside_switches if switched else self.warm_solver
        solver = warm_solver if isinstance(guess, ControlTrajectory) else self.solver
        try:
            with until(self.deadline):
                path = transcription.solve(guess=guess, solver=solver, verbose=self.verbose if self.verbose > 1 else 0)
        except ConvergenceError as failure:
            self.iterations += failure.iterations
            raise
        finally:
            self.build_seconds += transcription.build_seconds
        self.iterations += path.iterations
        return path

    def solve_finer(self, mesh: np.ndarray, guess: Guess | None) -> ControlTrajectory:
        """The path on a mesh; where there is none, on one twice as fine."""
        try:
            return self.solve(self.method, mesh, guess)
        except ConvergenceError:
            finer = halved(mesh)
            if self.out_of_time() or len(finer) - 1 > self.limits.intervals or not fits_any_mesh(guess):
                raise
        return self.solve(self.method, finer, guess)

    def estimate(self, level: ControlTrajectory) -> Estimate[HigherDegree | None]:
        """The error from the same mesh with a higher degree, where that is solved."""
        method = higher_degree_method(self.method)
        self.check_time()
        try:
            higher = self.solve(method, self.scaled(level.t, level), perturbed(level, math.sqrt(self.tol)))
        except ConvergenceError:
            self.check_time()
            return Estimate(np.inf, False, f"no answer of degree {method.degree}", None)
        detail = HigherDegree(level, higher)
        i = int(np.argmax(detail.jumps))
        self.jump = float(np.mean(level.t[i : i + 2])) if np.sum(detail.jumps) > self.tol else None
        cost, path = detail.errors if detail.cost_error <= self.tol else (detail.cost_error, detail.error)
        self.known, self.cost_known = detail, min(self.cost_known, cost)
        return Estimate(cost if self.of_cost else path, True, f"degree {method.degree}", detail)

    def check_solver(self, detail: HigherDegree) -> None:
        """Stop where the solver leaves too much of the cost with both degrees, or of a path that else is accepted."""
        judged = 1 if self.of_cost or detail.error > self.tol else 2
        if max(detail.remaining_error(detail.path)[:judged]) <= self.tol:
            return
        left, open_by = map(min, detail.remaining_error(detail.path), detail.remaining_error(detail.higher))
        if left > self.tol:
            raise self.stopped(f"the solver may have left {left:.0e} of the cost", *self.best, UNITS)
        if judged == 2 and open_by > self.tol:
            raise self.stopped(f"the solver leaves the path open by {open_by:.0e} of its size", *self.best)

    def improve(self, level: ControlTrajectory, estimate: Estimate[HigherDegree | None]) -> ControlTrajectory:
        """Solve on the better mesh, from the path of higher degree; without that, on a mesh twice as fine."""
        detail = estimate.detail
        if detail is not None:
            self.check_solver(detail)
        known = level if detail is None else detail.higher
        if detail is None or self.fruitless == PATIENCE:
            mesh = halved(known.t)
        else:
            mesh = detail.better_mesh(self.path_tol(detail), self.tol)
        if len(mesh) - 1 > self.limits.intervals:
            raise self.stopped(f"the mesh would need {len(mesh) - 1} intervals", *self.best)
        joints = self.scaled(mesh, known)
        if np.min(np.diff(joints)) < 2 * SHORTEST * np.ptp(joints):
            reason = f"the mesh would need an interval near {SHORTEST:g} of the duration"
            raise self.stopped(reason, *self.best)
        try:
            return self.solve_finer(joints, known)
        except ConvergenceError as failure:
            raise self.stopped(str(failure), *self.best) from failure

    def path_tol(self, detail: HigherDegree) -> float:
        """Error of the path to aim at: where the cost alone counts, whose error falls with the square, a larger one."""
        if not self.of_cost:
            return self.tol
        return max(self.tol, detail.change * float(np.sqrt(self.tol / detail.cost_error)))

    def stopped(self, reason: str, level: ControlTrajectory, error: float, hint: str = HINT) -> LimitReached:
        """Say how far it got; where only the path is not known, as along a singular arc, what is."""
        if self.jump is not None:
            hint = f"A callable is not smooth in time near t = {self.jump:.6g}, or changes there too fast for this mesh"
            hint += ": name that time in the breakpoints"
        elif level.unseen_change > self.tol * abs(level.cost):
            hint = UNITS
        if self.cost_known <= self.tol:
            known = f"the cost is known to {self.cost_known:.0e}, which is all that cost_tol asks for"
            reason += f" (only the path changes: {known})"
        return super().stopped(reason, level, error, hint)

    def run(self, mesh: np.ndarray, guess: Guess | None, starts: int) -> ControlTrajectory:
        """Refine the first path; of several starts those that may be the best, and return the best.

        An optimum that costs more on the first mesh than the best that is refined, by more than refining has changed
        others, is left out.  None takes more than half of the time while others wait: the cheapest of a coarse mesh
        may be none of a finer one.

        Raises
        ------
        LimitReached
            with the best path attached
        ConvergenceError
            where the solver finds no path on the first mesh, nor on one twice as fine
        """
        if isinstance(guess, ControlTrajectory):
            guess = replace(guess, problem=with_joined_phases(guess.problem))
        with until(self.began + STARTS_TIME_SHARE * self.limits.seconds):
            optima, summary = optima_of(starts, self.problem, guess, partial(self.solve_finer, mesh))
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
        """Refine a path, and say how wrong it is."""
        self.known, self.cost_known, self.jump = None, np.inf, None
        path, _ = self.refine(level)
        assert self.known is not None, "a path is accepted for what is known of it"
        path = with_parted_phases(path, self.stated)
        cost, error = self.known.errors
        return replace(path, error_estimate=error, cost_error=cost)


def first_control_mesh(
    problem: ControlProblem, method: Galerkin, intervals: int | None, mesh: ArrayLike | None
) -> np.ndarray:
    """Joints where a refinement begins; refuses what does not fit, see `solve` for the arguments."""
    check_types(problem, method, ControlProblem)
    if problem.hold:
        raise ValueError(
            "with hold every interval has one value of the controls, so the mesh is part of the problem and "
            "not to be refined: give a method and intervals in place of a tolerance"
        )
    count = FIRST_INTERVALS + len(problem.breakpoints) if intervals is None and mesh is None else intervals
    return mesh_of(problem.t_span, count, mesh, problem.breakpoints)
