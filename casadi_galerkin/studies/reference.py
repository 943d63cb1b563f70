"""Errors of a path against a reference: one that is given, or a solve several digits finer.

The error of such a reference itself is estimated by its difference from a second solve, of another degree on another
mesh.  Both are refined until this difference is far below the errors that are to be measured, or no longer falls.  If
their equal intervals resolve less than the tolerances of paths, as at a kink, both are solved to sharper tolerances.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin._solve import solve
from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import resolving_interpolant, truncation_error
from casadi_galerkin.calculus.numbers import APART, counted, number
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, times_at
from casadi_galerkin.control.phases import with_joined_phases
from casadi_galerkin.functional.mapping import at_places
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.callables import with_parameters
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.initial_problem import InitialProblem
from casadi_galerkin.problems.problem import Problem, map_times, mesh_for, section_times
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import Guess, check_finite_values, sampled
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solution.trajectory import Trajectory

SAMPLES = 2000  # times at which errors are taken, and at least 4 on every interval
FINER_DEGREE, LEAST_DEGREE = 4, 8  # degrees that a reference has more than the methods, and its least one
RESOLVED = 1e-11  # truncation error of an interpolated callable from which its velocities are not used
FINER, LEAST_ERROR, DOUBLINGS = 1e-2, 1e-14, 4  # a reference's error over the least error measured, and its floor
SHARPER, LEAST_TOLERANCE = 0.1, 1e-7  # a reference's tolerance over the least error estimated, and its floor

AnyProblem: TypeAlias = BoundaryProblem | InitialProblem | ControlProblem
Reference: TypeAlias = Trajectory | Callable[[float], ArrayLike]
Measure: TypeAlias = Callable[[Any], float]  # of a path, a Trajectory unless the reference is a callable


def _check(problem: AnyProblem, given: Reference) -> None:
    """Refuse a reference that is no path of the problem."""
    d, span = problem.dimension, problem.t_span
    free = any(getattr(problem, name, None) is not None for name in ("duration_bounds", "energy"))
    if not isinstance(given, Trajectory):
        if not callable(given):
            raise TypeError(f"the reference must be a Trajectory or a callable t -> ({d},), got {given!r}")
        if free:
            raise TypeError(f"where the duration is free, the reference must be a Trajectory, got {given!r}")
        return
    if len(given.x) != d:
        raise ValueError(f"the reference must be a path of {counted(d, 'component')}, got {len(given.x)}")
    wanted, got = (len(parameters or ()) for parameters in (problem.parameters, given.parameters))
    if wanted != got:
        raise ValueError(f"the reference must have {counted(wanted, 'parameter')}, got {got}")
    if not free and not np.allclose(given.t[[0, -1]], span, rtol=0, atol=APART * (span[1] - span[0])):
        raise ValueError(f"the reference must run from {span[0]} to {span[1]}, got {given.t[0]} to {given.t[-1]}")


class ReferenceSolution:
    """What errors are measured against: path, action and energy of a reference, and their sizes.

    Paths are compared at the same fractions of the durations between breakpoints, because a control problem may leave
    these durations free, and its path may jump at breakpoints.  A quantity that the user names is measured, too.

    Attributes
    ----------
    name : what it is, in words
    own : its own estimated errors by their names in a `Row`; of a given reference its `error_estimate`, if it has one
    """

    def __init__(self, problem: AnyProblem, given: Reference, measure: Measure | None, name: str = "given") -> None:
        _check(problem, given)
        estimate = getattr(given, "error_estimate", None)
        self.name, self.own = name, {} if estimate is None else {"error": estimate, "path_error": estimate}
        self._path: Path
        self._at: Callable[[np.ndarray], np.ndarray]
        if isinstance(given, Trajectory):
            self._path, self._at, stated = given, given, given.problem
        else:
            self._at = partial(sampled, "the reference", given, dimension=problem.dimension)
            self._path, stated = Path(_interpolated(problem, self._at)), problem
        self._marks, parameters = _marks(stated), stated.parameters
        calculus = DiscreteCalculus(Galerkin(LEAST_DEGREE), self._path.t)
        self._lagrangian = with_parameters(problem.lagrangian, parameters)
        values, kinetic = self._terms(self._path, calculus.quadrature_times)
        self._sizes = self._path.sizes[:, None]
        self._energy_size = float(np.max(np.abs(values) + np.abs(kinetic))) or 1.0  # zero at rest
        self._functional_size = float(calculus.weights @ np.abs(values)) or 1.0
        if isinstance(problem, ControlProblem):  # a callable has no controls, so no cost
            self._functional = given.cost if isinstance(given, ControlTrajectory) else np.nan
            self._functional_size = abs(self._functional) or 1.0
        elif isinstance(given, Trajectory):
            self._functional = given.action
        else:
            self._functional = float(calculus.weights @ values)
            if isinstance(problem, BoundaryProblem) and problem.end_action is not None:
                end_action = with_parameters(problem.end_action, parameters)
                self._functional += float(end_action(self._path.x[:, 0], self._path.x[:, -1]))
        freed = getattr(problem, "parameter_bounds", None) is not None  # a callable tells no parameters
        if not isinstance(given, Trajectory) and (freed or np.max(truncation_error(self._path.polynomial)) > RESOLVED):
            self._functional = self._energy_size = np.nan
        self._measure = measure
        if measure is not None:
            self._quantity = quantity(measure, self._path)

    @property
    def error(self) -> float:
        """Its own estimated relative error, 0 where none is known."""
        return self.own.get("error", 0.0)

    def _matching(self, path: Trajectory, times: np.ndarray) -> np.ndarray:
        """Times of the reference at the same parts of the durations between breakpoints."""
        return map_times(times, _marks(path.problem), self._marks)

    def _duration_error(self, path: Trajectory) -> float:
        """Largest difference of the times since the start at the end, and at the breakpoints, over the duration."""
        own = np.array(_marks(path.problem))
        matching = self._matching(path, own)
        return float(np.max(np.abs((own - own[0]) - (matching - matching[0]))) / np.ptp(matching))

    def _terms(self, path: Path, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """L and p·v along a path, (K,) each."""
        t, x, v = symbols = self._lagrangian.sx_in()
        value = self._lagrangian(*symbols)
        terms = ca.Function("terms", [t, x, v], [value, ca.densify(ca.jtimes(value, v, v))])
        first, second = at_places(terms, times, path(times), path(times, 1))
        return first[0], second[0]

    def _energy(self, path: Path, times: np.ndarray) -> np.ndarray:
        """Energy along a path, (K,)."""
        lagrangian, kinetic = self._terms(path, times)
        return kinetic - lagrangian

    def errors(self, path: Trajectory) -> dict[str, Any]:
        """Errors of a path by their names in a `Row`, all relative."""
        joints, times = self._matching(path, path.t), _between(path)
        joint_error = float(np.max(np.abs(path.x - self._at(joints)) / self._sizes))
        between = self._at(self._matching(path, times))
        between_error = float(np.max(np.abs(path(times) - between) / self._sizes))
        path_error = max(between_error, joint_error, self._duration_error(path))
        energy_error = float(np.max(np.abs(path.energy - self._energy(self._path, joints))))
        functional = path.cost if isinstance(path, ControlTrajectory) else path.action
        return {
            "error": path_error if self._measure is None else self._missed(self._measure, path),
            "path_error": path_error,
            "joint_error": joint_error,
            "functional_error": abs(functional - self._functional) / self._functional_size,
            "energy_error": energy_error / self._energy_size,
        }

    def own_errors(self, other: Trajectory) -> dict[str, Any]:
        """Its own errors, estimated by the differences of another path of like accuracy.

        Energies are compared between the joints, too: a row may have a joint there, at which its energy is compared
        with that along the polynomial of the reference.
        """
        errors, times = self.errors(other), _between(other)
        missed = self._energy(self._path, self._matching(other, times)) - self._energy(other, times)
        between = float(np.max(np.abs(missed))) / self._energy_size
        return errors | {"energy_error": max(errors["energy_error"], between)}

    def _missed(self, measure: Measure, path: Trajectory) -> float:
        """Error of the quantity that the user names, relative to its value where that is not zero."""
        return abs(quantity(measure, path) - self._quantity) / (abs(self._quantity) or 1.0)


def _between(path: Trajectory) -> np.ndarray:
    """Times between the joints of a path at which errors are taken."""
    return times_at(path.t, np.linspace(0.0, 1.0, max(4, SAMPLES // len(path.t)) + 1)[1:-1])


def _marks(problem: Problem) -> list[float]:
    """Times of the ends, and of the breakpoints that mean the same on every path; idle free ones may be anywhere."""
    return section_times(with_joined_phases(problem) if isinstance(problem, ControlProblem) else problem)


def _interpolated(problem: AnyProblem, at: Callable[[np.ndarray], np.ndarray]) -> PiecewisePolynomial:
    """The polynomial through values of a callable, on joints that resolve it if any do."""
    method = Galerkin(LEAST_DEGREE)

    def on(mesh: np.ndarray) -> PiecewisePolynomial:
        calculus = DiscreteCalculus(method, mesh)
        values = at(calculus.node_times)
        check_finite_values("the reference", values, calculus.node_times)
        return calculus.emb(values)

    mesh = mesh_for(problem, SAMPLES // 30 + 2 * len(problem.breakpoints), None)
    return resolving_interpolant(on, mesh, RESOLVED, SAMPLES, problem.breakpoints)


def quantity(measure: Measure, path: Path) -> float:
    """A quantity of a path; a TypeError refuses what is no number, a ValueError infinity, NaN and exceptions."""
    try:
        value = measure(path)
    except Exception as error:
        raise ValueError(f"measure raised {error!r}") from error
    checked = number(value)
    if checked is None or not math.isfinite(checked):
        raise (TypeError if checked is None else ValueError)(f"measure must return a finite number, got {value!r}")
    return checked


def finer(
    problem: AnyProblem, paths: Sequence[Trajectory], guess: Guess | None, measure: Measure | None
) -> ReferenceSolution:
    """A path several digits finer than the given ones, and its own error from a second one of another degree."""
    degree = max(LEAST_DEGREE, FINER_DEGREE + max(path.method.degree for path in paths))
    most = max((len(path.t) - 1) * path.method.degree for path in paths)
    intervals = max(4, 1 + len(problem.breakpoints), most // degree)

    def measured(other: Trajectory, fine: Trajectory) -> ReferenceSolution:
        name = f"{fine.method} on {counted(len(fine.t) - 1, 'interval')}"
        truth = ReferenceSolution(problem, fine, measure, name)
        truth.own = truth.own_errors(other)
        return truth

    best: ReferenceSolution | None = None
    for _ in range(DOUBLINGS):
        try:
            other = solve(problem, Galerkin(degree), 5 * intervals // 4, guess=guess)
            fine = solve(problem, Galerkin(degree + 1), 2 * intervals, guess=guess)
        except ConvergenceError:
            if best is None:
                raise
            break
        truth = measured(other, fine)
        if best is not None and truth.error >= best.error:
            break
        best = truth
        if truth.error <= max(LEAST_ERROR, FINER * min(truth.errors(path)["error"] for path in paths)):
            break
        intervals *= 2
    assert best is not None
    known = [path.error_estimate for path in paths if path.error_estimate is not None]
    tol = max(LEAST_TOLERANCE, SHARPER * min(known, default=math.inf))
    if tol < best.error:
        with suppress(ConvergenceError):
            truth = measured(solve(problem, tol=tol, guess=guess), solve(problem, tol=SHARPER * tol, guess=guess))
            best = min(best, truth, key=lambda truth: truth.error)
    return best
