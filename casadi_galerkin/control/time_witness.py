"""A witness of jumps in time inside of intervals, which two degrees miss alike where they have the same points beside.

With the path, the controls and the multipliers found, the cost is ∫ I dt to first order, where

    I(t, z) = ℓ + λ·(∂L/∂x + F, ρ) + dλ/dt·(∂L/∂v, x) + μ·g,        z = (x, v, u, λ, dλ/dt, μ).

Over the share of time that a quadrature point stands for (`shares_of_time`), with z as it is at the point,

    I(b, z) - I(a, z) = ∫ ∂I/∂t dt

holds where I is smooth in time, however fast controls change.  A jump may move the cost by what it does to ∫ I dt.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_galerkin.problems.callables import with_parameters
from casadi_galerkin.solution.control_trajectory import ControlTrajectory, equations_of_motion
from casadi_galerkin.solution.shares_of_time import SharesOfTime


def integrand(path: ControlTrajectory) -> ca.Function:
    """I and ∂I/∂t as a Function of t and z, without the force of a holonomic constraint."""
    problem, motion = path.problem, equations_of_motion(path.problem, path.parameters)
    *along, push = motion.sx_in()
    costate, rate = (ca.SX.sym(name, problem.dimension) for name in ("costate", "costate_rate"))
    symbols, (momentum, changes) = [*along, costate, rate], motion(*along, 0 * push)
    cost = with_parameters(problem.running_cost, path.parameters)(*along)
    total = cost + ca.dot(costate, changes) + ca.dot(rate, momentum)
    if problem.path_constraint is not None:
        constraint = with_parameters(problem.path_constraint[0], path.parameters)(*along)
        symbols.append(ca.SX.sym("multipliers", constraint.numel()))
        total += ca.dot(symbols[-1], constraint)
    return ca.Function("integrand", symbols, [ca.densify(total), ca.densify(ca.gradient(total, along[0]))])


def jumps_in_time(path: ControlTrajectory) -> np.ndarray:
    """By how much jumps in time inside of every interval may move the cost; (N,)."""
    rule = path.method.quadrature
    shares, points = SharesOfTime(path.t, rule), np.array(rule.points)
    z = [*path.polynomial.at_parts(points), path.control.at(points), *path.costate.at_parts(points)]
    z += [] if path.path_multipliers is None else [path.path_multipliers.at(points)]
    count = len(shares.times)
    given = [np.repeat(a.reshape(len(a), -1), count // a[0].size, axis=1) for a in z]
    found = integrand(path).map(count)(shares.times[None, :], *given)
    return shares.by_jumps(*(np.array(a).ravel() for a in found))
