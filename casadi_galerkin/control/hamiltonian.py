"""The integrand of the cost with its multipliers, along a path.

With the path, the controls and the multipliers found, the cost is ∫ I dt to first order, where

    I(t, z) = ℓ + λ·(∂L/∂x + F, ρ) + dλ/dt·(∂L/∂v, x) + μ·g,        z = (x, v, u, λ, dλ/dt, μ).

As a function of u it is the Hamiltonian of the optimization, up to a constant: an optimal control minimizes it.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_galerkin.problems.callables import with_parameters
from casadi_galerkin.problems.controlled_motion import equations_of_motion
from casadi_galerkin.solution.control_trajectory import ControlTrajectory


def integrand(path: ControlTrajectory) -> ca.Function:
    """(t, z) -> I, ∂I/∂t, ∂I/∂u and the columns of ∂²I/∂u², without the force of a holonomic constraint."""
    problem, motion = path.problem, equations_of_motion(path.problem)
    *point, push = motion.sx_in()
    cost = with_parameters(problem.running_cost, path.parameters)(*point)
    limited = with_parameters(problem.path_constraint[0], path.parameters)(*point)
    costate, rate = (ca.SX.sym(name, problem.dimension) for name in ("costate", "costate_rate"))
    multipliers, (momentum, changes) = ca.SX.sym("multipliers", limited.numel()), motion(*point, 0 * push)
    total = cost + ca.dot(costate, changes) + ca.dot(rate, momentum) + ca.dot(multipliers, limited)
    curvature, slope = ca.hessian(total, point[3])
    found = total, ca.gradient(total, point[0]), slope, ca.densify(curvature).nz[:]
    return ca.Function("integrand", [*point, costate, rate, multipliers], [*map(ca.densify, found)])


def along(path: ControlTrajectory, parts: np.ndarray) -> list[np.ndarray]:
    """The times and z at fractions (K,) of every interval; (N K,) and (rows, N K) each."""
    costate = [a.reshape(len(a), -1) for a in path.costate.at_parts(parts)]
    times, x, v = path.polynomial.sampled(parts)
    multipliers = np.empty((0, len(times))) if path.path_multipliers is None else path.path_multipliers.at(parts)
    return [times, x, v, path.control.at(parts), *costate, multipliers]
