"""Trajectory optimization: a control problem on N intervals as one nonlinear program, solved and verified.

The unknowns are those of the `Chain`: the states at the joints, and the other values of the path and the controls
between them.  The equations are the discrete Lagrange-d'Alembert equations, and p = ∂L/∂v(t, x, v) at the two ends
(discrete Legendre transform).  See `control_graph` for the derivatives.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus, mesh_of, remeshed
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.numbers import check_verbose, counted
from casadi_galerkin.calculus.roundoff import EPS, or_one
from casadi_galerkin.control.continuous_controls import continuous_controls
from casadi_galerkin.control.control_graph import ControlGraph
from casadi_galerkin.control.control_numbering import Chain
from casadi_galerkin.control.failed_optimization import INVALID, explained, refuse_not_finite, undefined
from casadi_galerkin.control.initial_guess import first_values, near_answer
from casadi_galerkin.control.optimizer import BOUND_RELAXATION, TOLERANCE, optimize, with_fatrop, with_ipopt
from casadi_galerkin.control.program_bounds import bounds_of, check_count, check_stages, equation_scales, violations
from casadi_galerkin.control.second_order import SecondOrder
from casadi_galerkin.control.starts import LONGER_DURATION, first_found
from casadi_galerkin.control.two_comparisons import compared, from_near
from casadi_galerkin.functional.buffers import Evaluator, ObjectPool, fork_waits, interrupts_raised
from casadi_galerkin.functional.mapping import PointMap, by_rows, one_by_one
from casadi_galerkin.problems.bounds import FEASIBLE
from casadi_galerkin.problems.constrained_motion import check_points, off_constraint, tangent_at_joints
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.solution.control_path import ControlPath
from casadi_galerkin.solution.control_trajectory import Comparisons, ControlTrajectory
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solvers.deadline import seconds_left
from casadi_galerkin.solvers.solver import Solver, fatrop, ipopt

LARGEST_TERMS_RATIO = 10.0  # largest ratio of terms along a guess to those on the straight line; only noise has more
LEAST_TERMS = 1e-5  # part of the largest terms on the straight line below which those of a component do not count
SHORTEST_STEP = 1e-10  # interval over the duration; at 1e-9 to 1e-12 IPOPT was seen to fail, and at 1e-13 to be wrong
SOLVER_NAMES = {ipopt.name: "IPOPT", fatrop.name: "fatrop"}


@dataclass(frozen=True)
class StartingPoint:
    """The starting point of a solve.

    Attributes
    ----------
    values : one array for every field of the `Chain` but impulses, which begin at zero
    duals : multipliers of the bounds and of the equations for a warm start, or an empty tuple
    sizes : sizes of the terms of every kind of equation
    """

    values: dict[str, np.ndarray]
    duals: tuple[np.ndarray, ...]
    sizes: np.ndarray


class ControlTranscription:
    """A control problem on N intervals as a nonlinear program, built once and solved often.

    Ends, velocities, parameters and joints are parameters of the program: nothing is rebuilt when they change.

    Parameters
    ----------
    problem : ControlProblem
    method : Galerkin
    mesh : (N + 1,), the joints used unless others are given to `solve`; with a free duration they scale with it
    mapping : how L, cost and forces are evaluated at the points, see `functional.mapping`

    Attributes
    ----------
    chain : Chain, the numbering of unknowns and equations
    graph : ControlGraph, the Functions
    bounds : ProgramBounds
    calculus : DiscreteCalculus of the joints
    build_seconds : float

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> move = cg.ControlProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0], [0.0], [0.0],
    ...     force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u**2 / 2, controls=1)
    >>> transcription = cg.transcribe(move, cg.Galerkin(degree=3), intervals=4)
    >>> [round(transcription.solve(guess=guess).cost, 6) for guess in (None, lambda t: [t**2])]
    [6.0, 6.0]
    """

    def __init__(
        self, problem: ControlProblem, method: Galerkin, mesh: np.ndarray, mapping: PointMap = by_rows
    ) -> None:
        began = time.perf_counter()
        self.problem, self.method, self.mesh = problem, method, mesh
        check_points(problem.constraint, method)
        _check_steps(mesh)
        self.chain = Chain(problem, method, mesh)
        self.calculus = DiscreteCalculus(method, mesh)
        with fork_waits:
            self.graph = ControlGraph(problem, self.chain, mapping)
        self.bounds = bounds_of(problem, self.chain)
        check_count(self.chain, self.bounds)
        self._solvers: dict[str, ObjectPool[Evaluator]] = {}
        self.build_seconds = time.perf_counter() - began

    def __reduce__(self) -> tuple[object, ...]:
        """Pickled without its Functions, which are built again from the problem."""
        return type(self), (self.problem, self.method, self.mesh)

    @interrupts_raised()
    def solve(
        self,
        start: Sequence[float | None] | None = None,
        end: Sequence[float | None] | None = None,
        *,
        start_velocity: Sequence[float | None] | None = None,
        end_velocity: Sequence[float | None] | None = None,
        parameters: Sequence[float] | None = None,
        guess: Guess | None = None,
        mesh: ArrayLike | None = None,
        solver: Solver = ipopt,
        verbose: int = 0,
    ) -> ControlTrajectory:
        """Solve for the optimal path; whatever is left out is taken from the problem.

        Parameters
        ----------
        start, end, start_velocity, end_velocity : d numbers each, with None exactly where the problem has None
        parameters : as many numbers as the problem has; where they are free, the guess
        guess : None (the straight line between the ends, and controls of zero, or in the middle of bounds unless zero
            is inside of these; where all components follow rates, as near to zero as bounds allow), anything
            `Transcription.solve` takes for the path, a tuple of that and a guess of the controls, or an earlier
            ControlTrajectory, whose controls, duration and parameters are then used too; where it has the same method
            and intervals, the solver starts warm, from its multipliers.  A guess of the controls is a callable
            t -> (n,), or an array (n, N r) of values at the quadrature points, of held controls (n, N).  Where no path
            is found from a guess, the straight line is tried
        mesh : (N + 1,) joints; where the duration is free their span is its guess, and where nothing is found from
            that, four times this, or what its bounds allow
        solver : ipopt or fatrop, with or without options
        verbose : 1 prints a summary, 2 also the solver's own output

        Raises
        ------
        ConvergenceError
            with the solver's own words and the constraint that is violated worst
        ValueError, TypeError
            for input that does not fit, and for callables that are not finite at the guess

        Examples
        --------
        >>> import casadi_galerkin as cg
        >>> cart = cg.ControlProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0], [0.0], [0.0],
        ...     force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u**2 / 2, controls=1)
        >>> transcription = cg.transcribe(cart, cg.Galerkin(degree=3), intervals=4)
        >>> near = transcription.solve()
        >>> far = transcription.solve(end=[2.0], guess=near)
        >>> round(near.cost, 6), round(far.cost, 6), far.problem.end
        (6.0, 24.0, (2.0,))
        """
        began = time.perf_counter() - self.build_seconds
        check_solver(solver)
        check_verbose(verbose)
        calculus = self.calculus if mesh is None else self._remeshed(mesh)
        ends = {"start": start, "end": end, "start_velocity": start_velocity, "end_velocity": end_velocity}
        span = None if mesh is None else (float(calculus.mesh[0]), float(calculus.mesh[-1]))
        problem = self.problem.varied({**ends, "parameters": parameters}, span)

        def attempt(by: Solver, at: Guess | None, longer: float = 1.0) -> ControlTrajectory:
            begun = self.starting_point(problem, calculus, at, longer)
            return self._solved(by, problem, calculus.mesh, begun, verbose, began)

        attempts, other = [("from the guess", partial(attempt, solver, guess))], solver
        if solver.name == fatrop.name:  # which stalls more easily
            other = ipopt
            attempts.append(("from the same start", partial(attempt, other, guess)))
        if guess is not None and not isinstance(guess, ControlTrajectory):
            attempts.append(("from the straight line", partial(attempt, other, None)))
        bounds = problem.duration_bounds  # without them the cost may fall for ever
        if bounds is not None and np.isfinite(bounds[1]).all() and not isinstance(guess, ControlTrajectory):
            attempts.append(
                (f"from {LONGER_DURATION:g} times the duration", partial(attempt, other, guess, LONGER_DURATION))
            )
        with fork_waits:  # it builds its Functions when they are first needed
            path = first_found(attempts)
        if verbose:
            print(path)
        return path

    def _remeshed(self, mesh: ArrayLike) -> DiscreteCalculus:
        """The calculus of other joints, with the breakpoints at the same indices."""
        calculus = remeshed(self.calculus, mesh, self.problem.breakpoints)
        breaks = np.searchsorted(calculus.mesh, self.problem.breakpoints)
        if not np.array_equal(breaks, self.chain.breaks):
            raise ValueError(
                f"the breakpoints {self.problem.breakpoints} must keep their places among the joints: "
                f"t[i] with i in {self.chain.breaks.tolist()}, got {breaks.tolist()}"
            )
        _check_steps(calculus.mesh)
        return calculus

    def _solved(
        self,
        solver: Solver,
        problem: ControlProblem,
        mesh: np.ndarray,
        start: StartingPoint,
        verbose: int,
        began: float,
    ) -> ControlTrajectory:
        """The verified solution of one solver from a starting point."""
        chain = self.chain
        bounds = self.bounds if problem is self.problem else bounds_of(problem, chain)
        unknowns, data = chain.pack(start.values)
        program = self._kept_program(solver, bool(start.duals), verbose)
        optimum = optimize(program, unknowns, data, bounds, BOUND_RELAXATION[solver.name], *start.duals)
        if optimum.status == INVALID:
            refuse_not_finite(problem, self.graph, unknowns, data, mesh)
        values = chain.unpack(optimum.unknowns, data)
        path = chain.path(values, self._joints(values, mesh))
        if optimum.success:
            values["controls"] = continuous_controls(problem, chain, path, values)
            optimum.unknowns[chain.fields["controls"]] = values["controls"]
        report = self.graph.report(optimum.unknowns, data, optimum.multipliers)
        scales = equation_scales(problem, chain, bounds, report, start.sizes)
        relative = violations(chain, bounds, optimum.unknowns, report.equations, scales)
        violation = float(np.max(relative))
        if not (optimum.success and np.isfinite(report.cost) and violation <= FEASIBLE):
            raise explained(problem, SOLVER_NAMES[solver.name], chain, optimum, report.cost, relative, path)
        multipliers = optimum.multipliers / chain.units(values["sizes"])
        joints, mechanical = path.mesh, chain.mechanical
        parameters = None if problem.parameters is None else tuple(values["parameters"].tolist())
        breakpoints = tuple(joints[chain.breaks].tolist())
        found = problem.found((float(joints[0]), float(joints[-1])), parameters, breakpoints)
        control = self._over_time(joints, chain.control_times, values["controls"], problem.control_bounds)
        off = off_constraint(found, path)
        if off is not None:
            raise ConvergenceError(f"no path was found: {off}", Path(path), violation / EPS, optimum.iterations)
        reason = undefined(problem, path, control, parameters)
        if reason is not None:
            raise ConvergenceError(f"no path was found: {reason}", Path(path), math.inf, optimum.iterations)
        others = np.zeros((chain.dimension - mechanical, len(joints)))
        momentum = np.vstack(((values["momentum"] * values["sizes"]).T, others))
        rates = path.at_parts(np.array([0.0, 1.0]))[1][mechanical:, [0, -1], [0, 1]].T if len(others) else others.T
        second_order = SecondOrder(problem, self.method, mesh, optimum, report.cost, self.graph)
        return ControlTrajectory(
            polynomial=path,
            momentum=tangent_at_joints(found, path, momentum),
            action=report.action,
            iterations=optimum.iterations,
            residual=violation / EPS,
            solver=f"{SOLVER_NAMES[solver.name]} ({optimum.status})",
            build_seconds=self.build_seconds,
            solve_seconds=time.perf_counter() - began - self.build_seconds,
            method=self.method,
            problem=found,
            find_index=second_order.negative,
            find_sensitivity=second_order.sensitivity,
            find_remaining_error=second_order.remaining_error,
            find_comparisons=partial(comparisons, solver),
            cost=report.cost,
            cost_size=report.cost_size,
            control=control,
            costate=chain.costate(multipliers, optimum.bound_multipliers, report.arriving, joints),
            path_multipliers=self._path_multipliers(multipliers, joints),
            duals=(multipliers, optimum.bound_multipliers),
            hamiltonian=report.hamiltonian,
            violation=violation,
            start_velocity=np.append(values["start_velocity"], rates[0]),
            end_velocity=np.append(values["end_velocity"], rates[1]),
            arrival_velocity=values["velocity"],
        )

    def starting_point(
        self,
        problem: ControlProblem,
        calculus: DiscreteCalculus,
        guess: Guess | None,
        longer: float = 1.0,
    ) -> StartingPoint:
        """The starting point of a solve from a guess, with free durations that are `longer` by this factor.

        The equations of motion are scaled by the sizes of their terms along the guess, so that the absolute tolerance
        of the solver does not depend on units.  These sizes are limited to ten times those on the straight line
        between the ends, because the terms of a noisy guess are far too large.  Where a component hardly changes on the
        line, as between ends that differ by rounding, its terms there are far too small and set no limit.  The momenta
        of the guess are minus the residuals of the equations of the joints with momenta of zero.
        """
        chain, near = self.chain, near_answer(guess, self.chain, calculus)
        values = first_values(problem, chain, calculus, guess, near, longer)
        unrelated = guess is not None and near is None  # no earlier answer: it may be noisy
        report = self.graph.report(*chain.pack(values))
        if not np.isfinite(report.cost + report.action + np.sum(report.equations)):
            refuse_not_finite(problem, self.graph, *chain.pack(values), calculus.mesh)
        largest = report.sizes.copy()
        if unrelated:
            straight = first_values(problem, chain, calculus, None, None)
            line = self.graph.report(*chain.pack(straight)).sizes
            line[chain.motions] = _significant(line[chain.motions], LEAST_TERMS)
            largest = np.where(
                (line > TOLERANCE) & np.isfinite(line), np.fmin(LARGEST_TERMS_RATIO * line, largest), largest
            )
        values["sizes"] = or_one(_significant(largest[chain.motions], TOLERANCE))
        largest[chain.motions] /= values["sizes"]
        momentum = -report.equations[chain.departures] if near is None else near.momentum[: chain.mechanical].T
        values["momentum"] = np.where(np.isfinite(momentum), momentum, 0.0) / values["sizes"]
        duals = () if near is None else (near.duals[1], near.duals[0] * chain.units(values["sizes"]))
        return StartingPoint(values, duals, largest)

    def program(self, solver: Solver, warm: bool, verbose: int) -> ca.Function:
        """Build the solver for this program."""
        if solver.name == fatrop.name:
            check_stages(self.problem, self.chain, self.bounds)
            return with_fatrop(self.graph, verbose, solver.options)
        return with_ipopt(self.graph, warm, verbose, solver.options)

    def _kept_program(self, solver: Solver, warm: bool, verbose: int) -> ObjectPool[Evaluator]:
        """The solver for this program, built when it is first needed; with limited time, for this solve only."""
        key, kept = f"{warm} {verbose > 1} {solver!r}", math.isinf(seconds_left())
        if kept and key in self._solvers:
            return self._solvers[key]
        began = time.perf_counter()
        program = self.program(solver, warm, verbose)
        self.build_seconds += time.perf_counter() - began
        pool = ObjectPool(lambda: Evaluator(program))
        if kept:
            self._solvers[key] = pool
        return pool

    def _joints(self, values: dict[str, np.ndarray], mesh: np.ndarray) -> np.ndarray:
        """The joints with the durations found; exactly the mesh where the duration is given."""
        if self.problem.duration_bounds is None:
            return mesh
        marks = np.append(values["begin"], values["begin"] + np.cumsum(values["durations"]))
        phases = self.chain.phases
        return np.append(marks[phases] + values["durations"][phases] * values["left"], marks[-1])

    def _path_multipliers(self, multipliers: np.ndarray, joints: np.ndarray) -> ControlPath | None:
        """Multipliers of the path constraints as functions of time: those of the points over their steps of time."""
        if not self.chain.path_constraints:
            return None
        times = np.multiply.outer(np.diff(joints), self.method.element.weights)
        values = multipliers[self.chain.rows["path"]] / times[:, :, None]
        return self._over_time(joints, self.method.element.points, values)

    def _over_time(self, joints: np.ndarray, points: np.ndarray, values: np.ndarray, *bounds: ArrayLike) -> ControlPath:
        """Values (N, points, n) as functions of time, within bounds where some are given."""
        rule = self.method.element.points
        return ControlPath(joints, points, np.concatenate(values).T, rule, *bounds)

    def __repr__(self) -> str:
        """Say what was built."""
        size, controls = counted(self.problem.dimension, "component"), counted(self.problem.controls, "control")
        return (
            f"ControlTranscription of a control problem of {size} and {controls}, {self.method}, on "
            f"{counted(len(self.mesh) - 1, 'interval')}: {counted(self.chain.unknowns, 'unknown')}, built in "
            f"{self.build_seconds:.4f} s"
        )


def _significant(sizes: np.ndarray, part: float) -> np.ndarray:
    """The sizes of terms of all components; zero for those not finite, or at most this part of the largest."""
    finite = np.where(np.isfinite(sizes), sizes, 0.0)
    return np.where(finite > part * np.max(finite, initial=0.0), finite, 0.0)


def _check_steps(mesh: np.ndarray) -> None:
    """Refuse intervals so short that rounding of their terms, |x|/h, hides the residuals of others."""
    steps = np.diff(mesh)
    i = int(np.argmin(steps))
    if steps[i] < SHORTEST_STEP * (mesh[-1] - mesh[0]):
        raise ValueError(
            f"the interval from t = {mesh[i]} to {mesh[i + 1]} is shorter than {SHORTEST_STEP:g} of the duration: "
            "leave out one of these joints"
        )


def check_solver(solver: object) -> None:
    """Refuse a solver that does not optimize."""
    if not isinstance(solver, Solver) or solver.name not in SOLVER_NAMES:
        raise ValueError(f"a ControlProblem is solved by cg.ipopt or cg.fatrop, got the solver {solver!r}")


def transcribed_control(
    problem: ControlProblem,
    method: Galerkin,
    intervals: int | None,
    mesh: ArrayLike | None,
    mapping: PointMap = by_rows,
) -> ControlTranscription:
    """Check what is given, and build the program; arguments as for `transcribe`, and how terms are evaluated."""
    return ControlTranscription(problem, method, mesh_of(problem.t_span, intervals, mesh, problem.breakpoints), mapping)


def comparisons(solver: Solver, path: ControlTrajectory) -> Comparisons:
    """A path compared with two of higher degree; errors as for `solve`, where one of these is not found."""

    def solved(method: Galerkin, mesh: np.ndarray) -> ControlTrajectory:
        transcription = transcribed_control(path.problem, method, None, mesh, one_by_one)
        return transcription.solve(guess=path, solver=from_near(solver, path))

    return compared(path, solved).known
