"""Errors of a path against a reference: a path or a callable that is given, or else a solve near rounding.

The reference is solved for to a tolerance below which there is little left to gain; its own error is estimated.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin._solve import solve
from casadi_galerkin.calculus.numbers import APART, counted
from casadi_galerkin.control.idle_breakpoints import with_joined_phases
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.initial_problem import InitialProblem
from casadi_galerkin.problems.problem import Problem, map_times, section_times
from casadi_galerkin.solution.errors import LimitReached
from casadi_galerkin.solution.guess import check_finite_values, sampled
from casadi_galerkin.solution.path import DRAWN_TIMES
from casadi_galerkin.solution.quantity import Quantity, quantity, size_of
from casadi_galerkin.solution.trajectory import Trajectory

TIGHT, TIGHT_OPTIMUM = 1e-12, 1e-8  # tolerances of references, the latter of optimizations

AnyProblem: TypeAlias = BoundaryProblem | InitialProblem | ControlProblem
Reference: TypeAlias = Trajectory | Callable[[float], ArrayLike]


def check_reference(problem: AnyProblem, given: Reference, of: Quantity | None) -> None:
    """Refuse a reference that is no path of the problem, or has not the quantity whose errors count."""
    d, span = problem.dimension, problem.t_span
    free = any(getattr(problem, name, None) is not None for name in ("duration_bounds", "energy"))
    if isinstance(given, Trajectory):
        if len(given.x) != d:
            raise ValueError(f"the reference must be a path of {counted(d, 'component')}, got {len(given.x)}")
        wanted, got = (len(parameters or ()) for parameters in (problem.parameters, given.parameters))
        if wanted != got:
            raise ValueError(f"the reference must have {counted(wanted, 'parameter')}, got {got}")
        if not free and not np.allclose(given.t[[0, -1]], span, rtol=0, atol=APART * (span[1] - span[0])):
            raise ValueError(f"the reference must run from {span[0]} to {span[1]}, got {given.t[0]} to {given.t[-1]}")
    elif not callable(given):
        raise TypeError(f"the reference must be a Trajectory or a callable t -> ({d},), got {given!r}")
    elif free:
        raise TypeError(f"where the duration is free, the reference must be a Trajectory, got {given!r}")
    else:
        times = np.linspace(*span, DRAWN_TIMES)
        check_finite_values("the reference", sampled("the reference", given, times, d), times)
    if of is not None:
        quantity(of, given)


class ReferenceSolution:
    """What errors are measured against: a path, and a quantity of it that the user names.

    Paths are compared at the same fractions of the durations between breakpoints, because a control problem may leave
    these durations free, and its path may jump at breakpoints.

    Parameters
    ----------
    path : Trajectory
    of : the quantity, or None
    given : a callable that tells the path in place of the Trajectory, or None
    """

    def __init__(self, path: Trajectory, of: Quantity | None, given: Reference | None = None) -> None:
        self._path, self._of = path, of
        self._at = path if given is None else partial(sampled, "the reference", given, dimension=len(path.x))
        self._quantity = np.zeros(()) if of is None else quantity(of, given or path)

    def errors(self, path: Trajectory) -> dict[str, Any]:
        """Errors of a path by their names in a `Row`, all relative."""
        marks, joints = _marks(path.problem), self._matching(path, path.t)
        times = np.setdiff1d(path.fine_times, path.t)  # velocities may jump at the joints
        sizes, own = self._path.sizes[:, None], _marks(self._path.problem)
        joint_error = np.max(np.abs(path.x - self._at(joints)) / sizes)
        between_error = np.max(np.abs(path(times) - self._at(self._matching(path, times))) / sizes)
        lasted, lasting = (np.subtract(times, times[0]) for times in (marks, self._matching(path, np.array(marks))))
        error = float(max(joint_error, between_error, np.max(np.abs(lasted - lasting)) / (own[-1] - own[0])))
        errors = {"error": error, "path_error": error, "joint_error": float(joint_error)}
        if self._of is not None:
            missed = np.abs(quantity(self._of, path) - self._quantity)
            errors["error"] = float(np.max(missed)) / size_of(self._quantity)
        return errors

    def _matching(self, path: Trajectory, times: np.ndarray) -> np.ndarray:
        """Times of the reference at the same parts of the durations between breakpoints."""
        return map_times(times, _marks(path.problem), _marks(self._path.problem))


def _marks(problem: Problem) -> list[float]:
    """Times of the ends, and of the breakpoints that mean the same on every path; idle free ones may be anywhere."""
    return section_times(with_joined_phases(problem) if isinstance(problem, ControlProblem) else problem)


def finest(problem: AnyProblem, best: Trajectory) -> Trajectory:
    """A path several digits finer than the best one that is known, with its estimated error."""
    tol = TIGHT_OPTIMUM if isinstance(problem, ControlProblem) else TIGHT
    try:
        return solve(problem, tol=tol, guess=None if isinstance(problem, InitialProblem) else best)
    except LimitReached as error:
        if not isinstance(error.path, Trajectory):
            raise
        return error.path
