"""The check, before any solve, that the mass matrix ∂²L/∂v² is regular, so that momenta determine velocities."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from casadi_galerkin.calculus.roundoff import component_sizes
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.legendre_transform import degenerate, refuse_degenerate

GENERIC = 0.1, 0.4, 0.7  # fractions of a bent line between the ends, at which the mass matrix is evaluated


def refuse_singular_mass(
    problem: BoundaryProblem | ControlProblem, mass_at: Callable[[float, np.ndarray, np.ndarray], np.ndarray]
) -> None:
    """Refuse a Lagrangian whose mass matrix is singular at all of some generic points between the ends.

    `mass_at` takes t, x and v, and returns the mass matrix there.  Under a constraint it may be singular, because
    components that the constraint determines need no mass.
    """
    if problem.constraint is not None:
        return
    first, last = problem.t_span
    start, end = (np.array([x or 0.0 for x in end]) for end in (problem.start, problem.end))
    rise, size, span = end - start, component_sizes(np.array([start, end]).T), last - first
    bend = size * np.cos(1.0 + np.arange(len(start)))
    for share in GENERIC:
        t, x, v = first + share * span, start + share * (rise + bend), (rise + (1 - share) * bend) / span
        mass = mass_at(t, x, v)
        if not (np.isfinite(mass).all() and degenerate(mass)):
            return
    refuse_degenerate(mass, f"wherever it was tried, such as at t = {t:.6g}, x = {x}, v = {v}")
