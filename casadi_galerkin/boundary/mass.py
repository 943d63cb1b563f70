"""The check of the mass matrix of a boundary problem, by the derivatives that its solve needs anyway."""

from __future__ import annotations

import numpy as np

from casadi_galerkin.functional.buffers import Evaluator
from casadi_galerkin.functional.pointwise import pointwise
from casadi_galerkin.functional.threads import fork_waits
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.mass import refuse_singular_mass


def check_mass(problem: BoundaryProblem) -> None:
    """Refuse a Lagrangian whose mass matrix is singular, see `refuse_singular_mass`."""
    given, span = [] if problem.parameters is None else [problem.parameters], float(np.ptp(problem.t_span))
    with fork_waits:
        derived = pointwise(problem.lagrangian, problem.force)
        evaluator = Evaluator(derived.derivatives)

    def mass_at(t: float, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        blocks = evaluator(t, span, x, span * v, *given)[3:]
        mass: np.ndarray = derived.mass([block[:, None] for block in blocks])[0] * span
        return mass

    refuse_singular_mass(problem, mass_at)
