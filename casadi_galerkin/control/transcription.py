"""Trajectory optimisation: a control problem on N intervals as one nonlinear program, solved by IPOPT and verified.

Unknowns are the node values of the path, the controls at the quadrature points and whatever the problem leaves free:
velocities at the ends, the duration, parameters.  Equations are the discrete Lagrange-d'Alembert equations of all
nodes; those of the first and the last hold the momenta there, p = ∂L/∂v(t, x, v) of the velocities at the ends
(discrete Legendre transform).  See `control_graph` for the derivatives.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus, mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.control.constraint_violation import limits_of, name_equation, name_unknown, violations
from casadi_galerkin.control.graph import ControlGraph, Report
from casadi_galerkin.control.initial_guess import check_finite, first_values, near_answer
from casadi_galerkin.control.numbering import ControlNumbering
from casadi_galerkin.control.optimizer import Optimum, interior_point, optimize
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.problem import check_types
from casadi_galerkin.solution.control_path import ControlPath
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solvers.solver import Solver, ipopt

FEASIBLE = 1e-8  # accepted violation relative to the terms compared; IPOPT's optima were measured below 1e-10
INVALID = "Invalid Number Detected"
HINTS = {
    "Diverging Iterates": "The cost may have no lower bound: bound the controls, the positions or the duration",
    "Infeasible Problem Detected": "There may be no path within these ends and bounds; else try a guess nearer to it",
    INVALID: "A callable or one of its derivatives is not finite there",
    "Restoration Failed": "There may be no path within these ends and bounds; else try a guess nearer to it",
}
OTHER_HINT = "Try a guess nearer to the path, or more intervals; the cost may have no lower bound"
ENDS = ("start", "end", "start_velocity", "end_velocity")


class ControlTranscription:
    """A control problem on N intervals as a nonlinear program, built once and solved often.

    Ends, velocities, parameters and joints are parameters of the program: nothing is rebuilt when they change.

    Parameters
    ----------
    problem : ControlProblem
    method : Galerkin
    mesh : (N + 1,), the joints used unless others are given to `solve`; with a free duration they scale with it

    Attributes
    ----------
    numbering : ControlNumbering, which unknown is what
    graph : ControlGraph, the Functions
    limits : bounds of unknowns and equations
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

    def __init__(self, problem: ControlProblem, method: Galerkin, mesh: np.ndarray) -> None:
        began = time.perf_counter()
        self.problem, self.method, self.mesh = problem, method, mesh
        constraint = problem.path_constraint
        self.numbering = ControlNumbering(
            method,
            len(mesh) - 1,
            problem.dimension,
            problem.controls,
            len(problem.parameters or ()),
            0 if constraint is None else len(constraint[1]),
            {name: tuple(value is not None for value in getattr(problem, name)) for name in ENDS},
            problem.duration_bounds is not None,
            problem.parameter_bounds is not None,
        )
        self._calculus = DiscreteCalculus(method, mesh)
        first = self.numbering.pack(first_values(problem, self.numbering, self._calculus, None))
        self.graph = ControlGraph(problem, self.numbering, *first)
        self.limits = limits_of(problem, self.numbering)
        self._check_count()
        self._solvers: dict[str, ca.Function] = {}
        self.build_seconds = time.perf_counter() - began

    def _check_count(self) -> None:
        """Refuse more equations than unknowns, as a very coarse mesh has."""
        limits = self.limits
        equations = np.count_nonzero(limits.equations_lower == limits.equations_upper)
        unknowns = np.count_nonzero(limits.lower < limits.upper)
        if equations > unknowns:
            raise ValueError(
                f"{equations} equations for {unknowns} unknowns on {len(self.mesh) - 1} interval(s) of degree "
                f"{self.method.degree}: take more intervals, a higher degree or more controls, or free a component"
            )

    def solve(
        self,
        start: Sequence[float | None] | None = None,
        end: Sequence[float | None] | None = None,
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
        guess : nothing (the straight line between the ends, controls of zero), anything `Transcription.solve` takes
            for the path, a tuple of that and a guess of the controls, or an earlier ControlTrajectory, whose controls,
            duration and parameters are then used too; where it has the same method and intervals, the solver starts
            warm, from its multipliers.  A guess of the controls is a callable t -> (n,), or an array (n, N r) of values
            at the quadrature points
        mesh : (N + 1,) joints; where the duration is free their span is its guess
        solver : ipopt, with or without options
        verbose : 1 prints a summary, 2 also IPOPT's own output

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
        calculus = self._calculus if mesh is None else DiscreteCalculus(self.method, mesh)
        if len(calculus.mesh) != len(self.mesh):
            count = len(calculus.mesh) - 1
            raise ValueError(f"this transcription has {len(self.mesh) - 1} intervals, got a mesh of {count}")
        ends = {"start": start, "end": end, "start_velocity": start_velocity, "end_velocity": end_velocity}
        changes = {name: value for name, value in {**ends, "parameters": parameters}.items() if value is not None}
        problem = self.problem.varied(changes, (float(calculus.mesh[0]), float(calculus.mesh[-1])))
        values = first_values(problem, self.numbering, calculus, guess)
        unknowns, data = self.numbering.pack(values)
        near = near_answer(guess, self.numbering, calculus)
        duals = () if near is None else (near.duals[1], near.duals[0] * self.graph.sizes)
        optimum = optimize(self._interior_point(solver, bool(duals), verbose), unknowns, data, self.limits, *duals)
        report = self.graph.report(optimum.unknowns, data, optimum.multipliers / self.graph.sizes)
        if optimum.status == INVALID or not np.isfinite(report.cost + report.action):
            check_finite(problem, self.numbering, values)
            self._check_derivatives(unknowns, data, calculus.mesh)
        relative = violations(self.numbering, self.limits, optimum.unknowns, report, report.terms)
        if np.max(relative) > FEASIBLE:  # perhaps a component has vanished, and its terms with it
            terms = self.graph.report(unknowns, data).terms
            relative = violations(self.numbering, self.limits, optimum.unknowns, report, terms)
        values = self.numbering.unpack(optimum.unknowns, data)
        joints = self._joints(values, calculus.mesh)
        if not (optimum.success and np.isfinite(report.cost) and np.max(relative) <= FEASIBLE):
            raise self._error(optimum, report.cost, relative, values, joints)
        path = self._trajectory(optimum, report, problem, values, joints, float(np.max(relative)), began)
        if verbose:
            print(path)
        return path

    def _interior_point(self, solver: Solver, warm: bool, verbose: int) -> ca.Function:
        """IPOPT for this program, built when it is first needed."""
        key = f"{warm} {verbose > 1} {solver!r}"
        if key not in self._solvers:
            began = time.perf_counter()
            self._solvers[key] = interior_point(self.graph, warm, verbose, solver.options)
            self.build_seconds += time.perf_counter() - began
        return self._solvers[key]

    def _check_derivatives(self, unknowns: np.ndarray, data: np.ndarray, mesh: np.ndarray) -> None:
        """Name a first derivative that is not finite at the guess."""
        gradient = np.array(self.graph.gradient(unknowns, data)[1]).ravel()
        matrix = self.graph.jacobian(unknowns, data)[1]
        entries = np.isfinite(np.array(matrix.nonzeros()))
        if not np.all(np.isfinite(gradient)):
            name, place = name_unknown(self.numbering, int(np.argmax(~np.isfinite(gradient))))
            what = f"the derivative of the cost by {name}"
        elif not np.all(entries):
            name, place = name_equation(self.numbering, matrix.sparsity().row()[int(np.argmax(~entries))])
            what = f"a derivative of {name}"
        else:
            return
        when = np.interp(place, np.arange(len(mesh)), mesh)
        raise ValueError(f"{what} is not finite at the guess at t = {when:.6g}. Give a guess that avoids it")

    def _joints(self, values: dict[str, np.ndarray], mesh: np.ndarray) -> np.ndarray:
        """The time scale with the duration found; exactly the mesh where the duration is given."""
        if not self.numbering.free_duration:
            return mesh
        return np.asarray(values["begin"] + values["duration"] * values["fractions"])

    def _error(
        self, optimum: Optimum, cost: float, relative: np.ndarray, values: dict[str, np.ndarray], joints: np.ndarray
    ) -> ConvergenceError:
        """Say how the solver ended, what is violated worst and when, and what to try."""
        worst = int(np.argmax(relative))
        rows = len(self.limits.equations_lower)
        name, place = (
            name_equation(self.numbering, worst) if worst < rows else name_unknown(self.numbering, worst - rows)
        )
        when = np.interp(place, np.arange(len(joints)), joints)
        what = name if worst < rows else f"the bound of {name}"
        if relative[worst] <= FEASIBLE:
            state = f"all constraints hold, with a cost of {cost:.6g}"
        else:
            state = f"the worst violated constraint is {what} at t = {when:.6g}, by {relative[worst]:.1e} of its terms"
        hint = HINTS.get(optimum.status, OTHER_HINT)
        message = f"IPOPT stopped with '{optimum.status}' after {optimum.iterations} iterations; {state}. {hint}"
        path = Path(PiecewisePolynomial(joints, self.method.element.nodes, values["path"].T))
        return ConvergenceError(message, path, float(relative[worst] / EPS), optimum.iterations)

    def _trajectory(
        self,
        optimum: Optimum,
        report: Report,
        problem: ControlProblem,
        values: dict[str, np.ndarray],
        joints: np.ndarray,
        violation: float,
        began: float,
    ) -> ControlTrajectory:
        parameters = None if problem.parameters is None else tuple(values["parameters"].tolist())
        return ControlTrajectory(
            polynomial=PiecewisePolynomial(joints, self.method.element.nodes, values["path"].T),
            momentum=report.momentum,
            action=report.action,
            iterations=optimum.iterations,
            residual=violation / EPS,
            solver=f"IPOPT ({optimum.status})",
            build_seconds=self.build_seconds,
            solve_seconds=time.perf_counter() - began - self.build_seconds,
            method=self.method,
            problem=problem.found((float(joints[0]), float(joints[-1])), parameters),
            cost=report.cost,
            control=ControlPath(joints, self.method.element.points, values["controls"].T),
            duals=(optimum.multipliers / self.graph.sizes, optimum.bound_multipliers),
            hamiltonian=report.hamiltonian,
            violation=violation,
            start_velocity=values["start_velocity"],
            end_velocity=values["end_velocity"],
        )

    def __repr__(self) -> str:
        """Say what was built."""
        return (
            f"ControlTranscription of a control problem of {self.problem.dimension} component(s) and "
            f"{self.problem.controls} control(s), {self.method}, on {len(self.mesh) - 1} intervals: "
            f"{self.numbering.unknowns} unknowns, built in {self.build_seconds:.4f} s"
        )


def check_solver(solver: object) -> None:
    """Refuse a solver that does not optimise."""
    if not isinstance(solver, Solver) or solver.name != ipopt.name:
        raise ValueError(f"a ControlProblem is solved by ipopt, got the solver {solver!r}")


def transcribed_control(
    problem: ControlProblem, method: Galerkin, intervals: int | None, mesh: ArrayLike | None
) -> ControlTranscription:
    """Check what is given, and build the nonlinear program; arguments as for `transcribe`."""
    check_types(problem, method, ControlProblem)
    return ControlTranscription(problem, method, mesh_of(problem.t_span, intervals, mesh))
