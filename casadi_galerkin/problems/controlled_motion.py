"""The equations of motion of a control problem, with the force of its constraint."""

from __future__ import annotations

import casadi as ca

from casadi_galerkin.problems.callables import with_parameters
from casadi_galerkin.problems.control_problem import ControlProblem


def equations_of_motion(problem: ControlProblem) -> ca.Function:
    """(t, x, v, u, multipliers of the constraint) -> what the equations of motion are of, and its time derivative.

    For a mechanical component these are ∂L/∂v, and ∂L/∂x + F with the constraint's force; for one that follows a rate,
    x and that rate; (d,) each.
    """
    functions = problem.lagrangian, problem.force, problem.rates, problem.constraint
    lagrangian, force, rates, constraint = (with_parameters(f, problem.parameters) for f in functions)
    parts, u = [0, problem.mechanical, problem.dimension], ca.SX.sym("u", problem.controls)
    t, x, v = lagrangian.sx_in()
    work, momentum = (ca.vertsplit(ca.gradient(lagrangian(t, x, v), by), parts)[0] for by in (x, v))
    held = ca.SX(0, 1) if constraint is None else constraint(t, x)
    push = ca.SX.sym("push", held.numel())
    changes = ca.vertcat(work + force(t, x, v, u), rates(t, x, v, u)) + ca.jtimes(held, x, push, True)
    outputs = map(ca.densify, (ca.vertcat(momentum, ca.vertsplit(x, parts)[1]), changes))
    return ca.Function("motion", [t, x, v, u, push], [*outputs])
