"""The check of the mass matrix of a control problem, of the components that do not follow a rate."""

from __future__ import annotations

from casadi_galerkin.functional.threads import fork_waits
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.legendre_transform import legendre_transform
from casadi_galerkin.problems.mass import refuse_singular_mass


def check_mass(problem: ControlProblem) -> None:
    """Refuse a Lagrangian whose mass matrix is singular, see `refuse_singular_mass`."""
    count, given = problem.mechanical, [] if problem.parameters is None else [problem.parameters]
    if count:
        with fork_waits:
            transform = legendre_transform(problem.lagrangian)
            refuse_singular_mass(problem, lambda t, x, v: transform(t, x, v, *given)[1].full()[:count, :count])
