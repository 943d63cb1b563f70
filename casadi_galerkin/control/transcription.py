"""Trajectory optimisation: a control problem on N intervals as one nonlinear program, solved by IPOPT and verified.

Unknowns are the node values of the path, the controls at the quadrature points and whatever the problem leaves free:
velocities at the ends, the duration, parameters.  Equations are the discrete Lagrange-d'Alembert equations of all
nodes; those of the first and the last hold the momenta there, p = ∂L/∂v(t, x, v) of the velocities at the ends
(discrete Legendre transform).  See `control_graph` for the derivatives.
"""

from __future__ import annotations

import time

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus, mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.control.constraint_violation import limits_of, name_equation, name_unknown, violations
from casadi_galerkin.control.graph import ControlGraph, Report
from casadi_galerkin.control.initial_guess import check_finite, first_values
from casadi_galerkin.control.numbering import ControlNumbering
from casadi_galerkin.control.optimizer import Optimum, Program, interior_point, optimize
from casadi_galerkin.functional.embedding import boundary_terms
from casadi_galerkin.functional.numbering import Numbering
from casadi_galerkin.problems.callables import with_parameters
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
    """A control problem on N intervals as a nonlinear program, built once, solved from as many guesses as wanted.

    Parameters
    ----------
    problem : ControlProblem
    method : Galerkin
    mesh : (N + 1,), the joints; with a free duration they scale with it

    Attributes
    ----------
    numbering : ControlNumbering, which unknown is what
    graph : ControlGraph, the Functions
    program, limits : what IPOPT is given
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
        first = self.numbering.pack(first_values(problem, self.numbering, mesh, None))
        graph = self.graph = ControlGraph(problem, self.numbering, np.concatenate(first))
        functions = (graph.gradient, graph.jacobian, graph.hessian)
        self.program = Program(graph.unknowns, graph.data, graph.cost, graph.equations, *functions)
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

    def solve(self, guess: Guess | None = None, solver: Solver = ipopt, verbose: int = 0) -> ControlTrajectory:
        """Solve for the optimal path.

        Parameters
        ----------
        guess : nothing (the straight line between the ends, controls of zero), anything `Transcription.solve` takes
            for the path, or an earlier ControlTrajectory, whose controls, duration and parameters are then used too
        solver : ipopt, with or without options
        verbose : 1 prints a summary, 2 also IPOPT's own output

        Raises
        ------
        ConvergenceError
            with the solver's own words and the constraint that is violated worst
        ValueError, TypeError
            for input that does not fit, and for callables that are not finite at the guess
        """
        began = time.perf_counter() - self.build_seconds
        check_solver(solver)
        unknowns, data, terms = self._start(guess)
        optimum = optimize(self._interior_point(solver, verbose), unknowns, data, self.limits)
        if optimum.status == INVALID:
            self._check_derivatives(unknowns, data)
        report = self.graph.report(optimum.unknowns, data, optimum.multipliers)
        relative = violations(self.numbering, self.limits, optimum.unknowns, report.equations, report.terms, terms)
        if not (optimum.success and np.isfinite(report.cost) and np.max(relative) <= FEASIBLE):
            raise self._error(optimum, report.cost, relative, data)
        path = self._trajectory(optimum, report, relative, data, began)
        if verbose:
            print(path)
        return path

    def _interior_point(self, solver: Solver, verbose: int) -> ca.Function:
        """IPOPT for this program, built when it is first needed."""
        key = f"{verbose > 1} {solver!r}"
        if key not in self._solvers:
            began = time.perf_counter()
            self._solvers[key] = interior_point(self.program, verbose, solver.options)
            self.build_seconds += time.perf_counter() - began
        return self._solvers[key]

    def _start(self, guess: Guess | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Unknowns, data and sizes of terms at the guess; refuses one where anything that is needed is not finite."""
        values = first_values(self.problem, self.numbering, self.mesh, guess)
        unknowns, data = self.numbering.pack(values)
        report = self.graph.report(unknowns, data)
        if not all(np.all(np.isfinite(a)) for a in (report.cost, report.equations, self._action(report.z, values))):
            check_finite(self.problem, self.numbering, values, report.z)
        return unknowns, data, report.terms

    def _check_derivatives(self, unknowns: np.ndarray, data: np.ndarray) -> None:
        """Name a first derivative that is not finite at the guess."""
        gradient = np.array(self.graph.gradient(unknowns, data)[1]).ravel()
        matrix = self.graph.jacobian(unknowns, data)[1]
        entries = np.isfinite(np.array(matrix.nonzeros()))
        if not np.all(np.isfinite(gradient)):
            what, place = name_unknown(self.numbering, int(np.argmax(~np.isfinite(gradient))))
            raise self._not_finite(f"the derivative of the cost by {what}", place)
        if not np.all(entries):
            what, place = name_equation(self.numbering, matrix.sparsity().row()[int(np.argmax(~entries))])
            raise self._not_finite(f"a derivative of {what}", place)

    def _not_finite(self, what: str, place: float) -> ValueError:
        when = np.interp(place, np.arange(len(self.mesh)), self.mesh)
        return ValueError(f"{what} is not finite at the guess at t = {when:.6g}. Give a guess that avoids it")

    def _joints(self, values: dict[str, np.ndarray]) -> np.ndarray:
        """The time scale with the duration found; exactly the mesh where the duration is given."""
        if not self.numbering.free_duration:
            return self.mesh
        return np.asarray(values["begin"] + values["duration"] * values["fractions"])

    def _error(self, optimum: Optimum, cost: float, relative: np.ndarray, data: np.ndarray) -> ConvergenceError:
        """Say how the solver ended, what is violated worst and when, and what to try."""
        values = self.numbering.unpack(optimum.unknowns, data)
        joints, worst = self._joints(values), int(np.argmax(relative))
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
        path = Path(DiscreteCalculus(self.method, joints).emb(values["path"].T))
        return ConvergenceError(message, path, float(relative[worst] / EPS), optimum.iterations)

    def _trajectory(
        self, optimum: Optimum, report: Report, relative: np.ndarray, data: np.ndarray, began: float
    ) -> ControlTrajectory:
        values, numbering = self.numbering.unpack(optimum.unknowns, data), self.numbering
        d = numbering.dimension
        calculus = DiscreteCalculus(self.method, self._joints(values))
        costate = optimum.multipliers[: numbering.nodes * d]
        parameters = None if self.problem.parameters is None else tuple(values["parameters"].tolist())
        return ControlTrajectory(
            polynomial=calculus.emb(values["path"].T),
            momentum=self._momenta(report.rows[:d], report.rows[d : 2 * d]),
            action=self._action(report.z, values),
            iterations=optimum.iterations,
            residual=float(np.max(relative) / EPS),
            solver=f"IPOPT ({optimum.status})",
            build_seconds=self.build_seconds,
            solve_seconds=time.perf_counter() - began - self.build_seconds,
            method=self.method,
            problem=self.problem.found((float(calculus.mesh[0]), float(calculus.mesh[-1])), parameters),
            cost=report.cost,
            control=ControlPath(calculus.mesh, self.method.element.points, values["controls"].T),
            costate=calculus.emb((costate.reshape(-1, d) / self.graph.sizes).T),
            hamiltonian=report.slopes.reshape(numbering.intervals, -1).sum(axis=1) / values["duration"],
            violation=float(np.max(relative)),
            start_velocity=values["start_velocity"],
            end_velocity=values["end_velocity"],
        )

    def _momenta(self, *derivatives: np.ndarray) -> np.ndarray:
        """Momenta at the joints (d, N + 1) by the discrete Legendre transform, from ∂L̂/∂x + h F and ∂L̂/∂x' (d, N r)."""
        d, intervals = self.numbering.dimension, self.numbering.intervals
        by_point = [a.reshape(d, intervals, -1).transpose(0, 2, 1).reshape(d, -1) for a in derivatives]
        return np.array(boundary_terms(Numbering(self.method, intervals, d))(*by_point)[0])

    def _action(self, z: np.ndarray, values: dict[str, np.ndarray]) -> float:
        """Discrete action of the Lagrangian alone, from what is known at the points (rows, N r)."""
        d, count = self.numbering.dimension, self.numbering.points
        times, steps = values["begin"] + values["duration"] * z[-2], values["duration"] * z[-1]
        parameters = tuple(values["parameters"].tolist()) if self.problem.parameters is not None else None
        along = with_parameters(self.problem.lagrangian, parameters).map(count)
        lagrangian = along(times[None, :], z[:d], z[d : 2 * d] / steps)
        weights = np.tile(self.method.element.weights, self.numbering.intervals)
        return float(weights * steps @ np.array(lagrangian).ravel())

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
