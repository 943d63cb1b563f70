"""The check, before any solve, that the mass matrix ∂²L/∂v² is regular, so that momenta determine velocities."""

from __future__ import annotations

import numpy as np

from casadi_galerkin.calculus.roundoff import component_sizes
from casadi_galerkin.functional.buffers import Evaluator
from casadi_galerkin.functional.pointwise import pointwise
from casadi_galerkin.functional.threads import fork_waits
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.legendre_transform import degenerate, refuse_degenerate

GENERIC = 0.1, 0.4, 0.7  # fractions of a bent line between the ends, at which the mass matrix is evaluated


def check_mass(problem: BoundaryProblem) -> None:
    """Refuse a Lagrangian whose mass matrix is singular at all of some generic points between the ends.

    Under a constraint it may be singular, because components that the constraint determines need no mass.
    """
    if problem.constraint is not None:
        return
    (first, last), given = problem.t_span, [] if problem.parameters is None else [problem.parameters]
    start, end = (np.array([x or 0.0 for x in end]) for end in (problem.start, problem.end))
    rise, size, span = end - start, component_sizes(np.array([start, end]).T), last - first
    bend = size * np.cos(1.0 + np.arange(len(start)))
    with fork_waits:
        derived = pointwise(problem.lagrangian, problem.force)
        evaluator = Evaluator(derived.derivatives)
    for share in GENERIC:
        t, x, slope = first + share * span, start + share * (rise + bend), rise + (1 - share) * bend
        blocks = evaluator(t, span, x, slope, *given)[3:]
        mass = derived.mass([block[:, None] for block in blocks])[0] * span
        if not (np.isfinite(mass).all() and degenerate(mass)):
            return
    refuse_degenerate(mass, f"wherever it was tried, such as at t = {t:.6g}, x = {x}, v = {slope / span}")
