"""Trajectory optimization: a control problem on N intervals as one nonlinear program, solved and verified.

The unknowns are those of the `Chain`: the states at the joints, and the other values of the path and the controls
between them.  The equations are the discrete Lagrange-d'Alembert equations, and p = ∂L/∂v(t, x, v) at the two ends
(discrete Legendre transform).  See `control_graph` for the derivatives.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus, remeshed
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.numbers import check_verbose, counted
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.control.continuous_controls import continuous_controls
from casadi_galerkin.control.control_answer import answer
from casadi_galerkin.control.control_graph import ControlGraph, equation_scales, meshes_of, violations
from casadi_galerkin.control.control_numbering import Numbering, ProgramBounds, bounds_of
from casadi_galerkin.control.failed_optimization import explained, refuse_not_finite
from casadi_galerkin.control.initial_guess import starting_point
from casadi_galerkin.control.optimizer import (
    BOUND_RELAXATION,
    Optimum,
    newton,
    newton_step,
    optimize,
    with_fatrop,
    with_ipopt,
    with_sqp,
)
from casadi_galerkin.control.second_order import SecondOrder
from casadi_galerkin.control.starts import LONGER_DURATION, distinct_optima, first_found
from casadi_galerkin.control.two_comparisons import compared, from_near
from casadi_galerkin.functional.buffers import Evaluator, fork_waits, interrupts_raised
from casadi_galerkin.functional.pointwise import PointMap, by_rows, one_by_one
from casadi_galerkin.problems.constrained_motion import check_points
from casadi_galerkin.problems.control_problem import ControlProblem, determined
from casadi_galerkin.problems.phases import Phases, parted
from casadi_galerkin.problems.statements import FEASIBLE, Limit, check
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solution.optimal_path import OptimalPath
from casadi_galerkin.solvers.deadline import seconds_left
from casadi_galerkin.solvers.solver import Solver, fatrop, ipopt, sqp

SHORTEST_STEP = 1e-10  # interval over the duration; at 1e-9 to 1e-12 IPOPT was seen to fail, and at 1e-13 to be wrong
SOLVER_NAMES = {ipopt.name: "IPOPT", fatrop.name: "fatrop", sqp.name: "SQP"}


class ControlTranscription:
    """A control problem, or several phases, on N intervals as a nonlinear program, built once and solved often.

    Ends, velocities, parameters, bounds and joints are parameters of the program: nothing is rebuilt when they change.

    Parameters
    ----------
    problem : ControlProblem or Phases
    method : Galerkin
    mesh : (N + 1,), the joints used unless others are given to `solve`; with a free duration they scale with it
    mapping : how L, cost and forces are evaluated at the points, see `functional.pointwise`

    Attributes
    ----------
    phases, joins : what the problem is parted into, and what joins these
    numbering : Numbering of unknowns and equations
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
        self, problem: ControlProblem | Phases, method: Galerkin, mesh: np.ndarray, mapping: PointMap = by_rows
    ) -> None:
        began = time.perf_counter()
        self.problem, self.method, self.mesh = problem, method, mesh
        self.calculus, self.breaks = DiscreteCalculus(method, mesh), np.searchsorted(mesh, problem.breakpoints)
        _check_steps(mesh)
        if isinstance(problem, ControlProblem):
            check(problem, (determined,))
        with fork_waits:
            self.phases = parted(problem).phases
            for phase in self.phases:
                check_points(phase.constraint, method)
            self.graph = ControlGraph(problem, method, mesh, mapping)
        self.numbering, self.joins = self.graph.numbering, self.graph.joins
        self.bounds = bounds_of(self.phases, self.joins, self.numbering)
        _check_count(self.numbering, self.bounds)
        self._solvers: dict[str, Evaluator] = {}
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
        parameters: Sequence[float] | None = None,
        guess: Guess | None = None,
        mesh: ArrayLike | None = None,
        solver: Solver = ipopt,
        verbose: int = 0,
        **given: Sequence[float | None] | tuple[Limit, Limit] | None,
    ) -> ControlTrajectory:
        """Solve for the optimal path; whatever is left out is taken from the problem.

        Where IPOPT ends at a saddle and the guess was no earlier answer, it goes on once from beside the saddle; the
        saddle is returned, and said, where no lower cost is found.

        Parameters
        ----------
        start, end : d numbers each, with None exactly where the problem has None
        parameters : as many numbers as the problem has; where they are free, the guess
        guess : None (the straight line between the ends, and controls of zero, or in the middle of bounds unless zero
            is inside of these; where all components follow rates, as near to zero as bounds allow), anything
            `Transcription.solve` takes for the path, a tuple of that and a guess of the controls, or an earlier
            ControlTrajectory, whose controls, duration and parameters are then used too; where it has the same method
            and intervals, the solver starts warm, from its multipliers; of one to a tolerance that has left out
            breakpoints, only with a tolerance.  A guess of the controls is a callable t -> (n,), or an array (n, N r)
            of values at the quadrature points, of held controls (n, N).  Where no path is found from a guess, the
            straight line is tried
        mesh : (N + 1,) joints; where the duration is free their span is its guess, and where nothing is found from
            that, four times this, or what its bounds allow
        solver : ipopt, fatrop or sqp, with or without options; sqp for warm starts, in place of which others are
            ipopt's
        verbose : 1 prints a summary, 2 also the solver's own output
        given : start_velocity and end_velocity, as start and end; control_bounds, position_bounds and velocity_bounds,
            (lo, hi) each, as a problem states them; those of velocities bound the same components

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
        span = None if mesh is None else (float(calculus.mesh[0]), float(calculus.mesh[-1]))
        problem = self.problem.varied({"start": start, "end": end, "parameters": parameters, **given}, span)
        known, other = isinstance(guess, OptimalPath), solver if solver.name == ipopt.name else ipopt
        begins: list[tuple[str, Solver, Any, float]] = [("from the guess", solver, guess, 1.0)]
        if other is not solver:  # others stall more easily
            begins.append(("from the same start", other, guess, 1.0))
        if guess is not None and not known:
            begins.append(("from the straight line", other, None, 1.0))
        longest = [side for phase in self.phases for side in (phase.duration_bounds or ((), ()))[1]]
        if longest and np.isfinite(longest).all() and not known:  # without bounds the cost may fall for ever
            begins.append((f"from {LONGER_DURATION:g} times the duration", other, guess, LONGER_DURATION))
        with fork_waits:  # it builds its Functions when they are first needed
            attempt = partial(self._solved, problem, calculus, verbose, began)
            path = first_found((how, partial(attempt, *begin)) for how, *begin in begins)
        if verbose:
            print(path)
        return path

    def _remeshed(self, mesh: ArrayLike) -> DiscreteCalculus:
        """The calculus of other joints, with the breakpoints at the same indices."""
        calculus = remeshed(self.calculus, mesh, self.problem.breakpoints)
        breaks = np.searchsorted(calculus.mesh, self.problem.breakpoints)
        if not np.array_equal(breaks, self.breaks):
            raise ValueError(
                f"the breakpoints {self.problem.breakpoints} must keep their places among the joints: "
                f"t[i] with i in {self.breaks.tolist()}, got {breaks.tolist()}"
            )
        _check_steps(calculus.mesh)
        return calculus

    def _solved(
        self,
        problem: ControlProblem | Phases,
        calculus: DiscreteCalculus,
        verbose: int,
        began: float,
        solver: Solver,
        guess: Any,
        longer: float,
    ) -> Any:
        """The verified solution of one solver from a guess, or of Newton's method where that finds one.

        The inertia that IPOPT itself finds in its last step leaves no doubt about most minima, which then cost nothing.
        """
        numbers, phases = self.numbering, parted(problem).phases
        bounds = self.bounds if problem is self.problem else bounds_of(phases, self.joins, numbers)
        start, remark = starting_point(self.graph, problem, calculus, guess, longer), ""
        unknowns, data = numbers.pack(start.values)
        if solver.name == sqp.name and not start.duals:
            solver, remark = ipopt, ", as sqp begins from an answer of the same layout"

        def optimum_from(at: np.ndarray, *duals: np.ndarray) -> Optimum:
            program = self._kept_program(solver, bool(duals), verbose)
            return optimize(program, at, data, bounds, BOUND_RELAXATION[solver.name], *duals)

        def verified(optimum: Optimum, name: str = SOLVER_NAMES[solver.name]) -> Any:
            values, meshes = numbers.unpack(optimum.unknowns, data), meshes_of(phases, calculus.mesh)
            timed = zip(numbers.chains, self._timed(values, meshes), strict=True)
            paths = [chain.path(*given) for chain, given in timed]
            if optimum.success:
                for phase, chain, path, found in zip(phases, numbers.chains, paths, values, strict=True):
                    found["controls"] = continuous_controls(phase, chain, path, found)
                    optimum.unknowns[chain.fields["controls"]] = found["controls"]
            report = self.graph.report(optimum.unknowns, data, optimum.multipliers)
            scales = equation_scales(numbers, optimum.bounds, report, start.sizes)
            relative = violations(numbers, optimum.bounds, optimum.unknowns, report.equations, scales)
            violation = float(np.max(relative))
            if not (optimum.success and np.isfinite(report.cost) and violation <= FEASIBLE):
                refuse_not_finite(phases, self.graph, unknowns, data)
                raise explained(phases, name, numbers, optimum, report.cost, relative, paths)
            return answer(
                SecondOrder(problem, self.method, calculus.mesh, optimum, report.cost, report.sizes, self.graph),
                report,
                values,
                paths,
                iterations=optimum.iterations,
                residual=violation / EPS,
                violation=violation,
                solver=f"{name} ({optimum.status}){remark}",
                build_seconds=self.build_seconds,
                solve_seconds=time.perf_counter() - began - self.build_seconds,
                method=self.method,
                find_comparisons=partial(comparisons, solver),
            )

        step = self._newton
        root = None if step is None else newton(step, numbers.unknown_kinds, unknowns, data, bounds)
        if root is not None:
            with suppress(ConvergenceError):  # as where it violates a bound, and another root does not
                return verified(root, "Newton")
        optimum = optimum_from(unknowns, *start.duals)
        path = verified(optimum)
        if isinstance(guess, OptimalPath) or not (optimum.doubtful and path.morse_index):
            return path
        return _below(path, optimum_from, verified)

    def _timed(
        self, values: list[dict[str, np.ndarray]], meshes: list[np.ndarray]
    ) -> Iterator[tuple[dict[str, np.ndarray], np.ndarray]]:
        """The values of every phase with its joints; exactly those of the mesh where all times are given."""
        begin = values[0]["begin"].item() if "begin" in self.numbering.chains[0].free else meshes[0][0]
        free = any({"begin", "duration"} & set(chain.free) for chain in self.numbering.chains)
        for found, mesh in zip(values, meshes, strict=True):
            end = begin + found["duration"].item()
            yield found, np.append(begin + found["duration"] * found["left"], end) if free else mesh
            begin = end

    def program(self, solver: Solver, warm: bool, verbose: int) -> ca.Function:
        """Build the solver for this program."""
        if solver.name == fatrop.name:
            return with_fatrop(self.graph, self.bounds, verbose, solver.options)
        if solver.name == sqp.name:
            return with_sqp(self.graph, verbose, solver.options)
        return with_ipopt(self.graph, warm, verbose, solver.options)

    @cached_property
    def _newton(self) -> Evaluator | None:
        """A step of Newton's method where nothing costs and nothing is to be chosen; or None."""
        costs = self.joins.cost is not None or any(phase.costs for phase in self.phases)
        program = None if costs else newton_step(self.graph, self.bounds)
        return None if program is None else Evaluator(program)

    def _kept_program(self, solver: Solver, warm: bool, verbose: int) -> Evaluator:
        """The solver for this program, built when it is first needed; with limited time, for this solve only."""
        key, kept = f"{warm} {verbose > 1} {solver!r}", math.isinf(seconds_left())
        if kept and key in self._solvers:
            return self._solvers[key]
        began = time.perf_counter()
        program = Evaluator(self.program(solver, warm, verbose))
        self.build_seconds += time.perf_counter() - began
        if kept:
            self._solvers[key] = program
        return program

    def __repr__(self) -> str:
        """Say what was built."""
        what = "a control problem"
        if isinstance(self.problem, Phases):
            what = f"{counted(len(self.phases), 'phase')}, the first"
        size, controls = counted(self.phases[0].dimension, "component"), counted(self.phases[0].controls, "control")
        return (
            f"ControlTranscription of {what} of {size} and {controls}, {self.method}, on "
            f"{counted(len(self.mesh) - 1, 'interval')}: {counted(self.numbering.unknowns, 'unknown')}, built in "
            f"{self.build_seconds:.4f} s"
        )


def _below(saddle: Any, optimum_from: Callable[..., Optimum], verified: Callable[..., Any]) -> Any:
    """The optimum that is found from beside a saddle or, where none costs less, the saddle."""
    lower = optimum_from(saddle.variations.downwards())
    iterations = saddle.iterations + lower.iterations
    with suppress(ConvergenceError):
        least = verified(lower)
        if least.cost < saddle.cost and len(distinct_optima([least, saddle])) > 1:
            report = f"{least.solver}, beside a saddle of cost {saddle.cost:.6g}"
            return replace(least, solver=report, iterations=iterations)
    return replace(saddle, iterations=iterations)


def _check_count(numbering: Numbering, bounds: ProgramBounds) -> None:
    """Refuse more equations than unknowns, as on a very coarse mesh; equations of the next states are not counted."""
    chains = numbering.chains
    passed = sum(sum(states for states, *_ in chain.stages[1:]) + chain.mechanical for chain in chains)
    equations = int(np.count_nonzero(np.equal(*bounds.equations))) - passed
    unknowns = int(np.count_nonzero(np.less(*bounds.unknowns))) - passed
    if equations > unknowns:
        fixed = all(np.equal(*bounds.unknowns[:, chain.fields["controls"]]).all() for chain in chains)
        tied = sum(int(np.count_nonzero(np.equal(*bounds.equations[:, chain.rows["path"]]))) for chain in chains)
        advice = "take more intervals, a higher degree or more controls, or free a component"
        if tied:
            advice = (
                f"{tied} of them are path_constraint with equal bounds, at every quadrature point: leave out the "
                "controls that they determine, or state what positions alone have to meet as `constraint`"
            )
        if fixed:
            advice = (
                "control_bounds whose sides are equal leave no control free, and the start alone determines the path: "
                "give control_bounds with room, or free the end with None"
            )
        raise ValueError(
            f"{counted(equations, 'equation')} for {counted(unknowns, 'unknown')} on "
            f"{counted(sum(c.intervals for c in chains), 'interval')} of degree {chains[0].method.degree}: {advice}"
        )


def _check_steps(mesh: np.ndarray) -> None:
    """Refuse intervals so short that rounding of their terms, |x|/h, hides the residuals of others."""
    steps = np.diff(mesh)
    i = int(np.argmin(steps))
    if steps[i] < SHORTEST_STEP * (mesh[-1] - mesh[0]):
        raise ValueError(
            f"the interval from t = {mesh[i]} to {mesh[i + 1]} is shorter than {SHORTEST_STEP:g} of the duration: "
            "leave out one of these joints"
        )


def check_solver(solver: object) -> Solver:
    """Refuse a solver that does not optimize."""
    if not isinstance(solver, Solver) or solver.name not in SOLVER_NAMES:
        raise ValueError(f"a ControlProblem is solved by cg.ipopt, cg.fatrop or cg.sqp, got the solver {solver!r}")
    return solver


def comparisons(solver: Solver, path: Any) -> Any:
    """A path compared with two of higher degree; errors as for `solve`, where one of these is not found."""

    def solved(method: Galerkin, mesh: np.ndarray) -> Any:
        return ControlTranscription(path.problem, method, mesh, one_by_one).solve(
            guess=path, solver=from_near(solver, path)
        )

    *_, both = compared(path, solved)
    return both
