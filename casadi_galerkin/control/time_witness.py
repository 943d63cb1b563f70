"""A witness of jumps in time inside of intervals, which two degrees miss alike where they have the same points beside.

With the path, the controls and the multipliers found, the cost is ∫ I dt to first order, where

    I(t, z) = ℓ + λ·(∂L/∂x + F, ρ) + dλ/dt·(∂L/∂v, x) + μ·g,        z = (x, v, u, λ, dλ/dt, μ).

A quadrature point stands for a share of the time, its weight.  Over that share, with z as it is at the point,

    I(b, z) - I(a, z) = ∫ ∂I/∂t dt

holds where I is smooth in time, however fast controls change; what is missing is a jump.  As the rule does not know
when it is, it may move the cost by as much as the jump times that share.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.piecewise_polynomial import times_at
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.problems.callables import with_parameters
from casadi_galerkin.solution.control_path import SAME_TIME
from casadi_galerkin.solution.control_trajectory import ControlTrajectory, equations_of_motion

INNER = gauss(4)  # integrates ∂I/∂t over the share of a point


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
    rule, steps = path.method.quadrature, np.diff(path.t)
    shares = times_at(path.t, np.append(0.0, np.cumsum(rule.weights))).reshape(len(steps), -1)
    margin = SAME_TIME * np.max(np.abs(path.t))  # a jump at a joint is inside of no interval
    shares = np.clip(shares, path.t[:-1, None] + margin, path.t[1:, None] - margin)
    begin, length = shares[:, :-1], np.diff(shares)
    times = begin[..., None] + length[..., None] * np.array([0.0, *INNER.points, 1.0])
    points = np.array(rule.points)
    z = [*path.polynomial.at_parts(points), path.control.at(points), *path.costate.at_parts(points)]
    z += [] if path.path_multipliers is None else [path.path_multipliers.at(points)]
    given = [np.repeat(values.reshape(len(values), -1), times.shape[-1], axis=1) for values in z]
    values, slopes = integrand(path).map(times.size)(times.reshape(1, -1), *given)
    values, slopes = (np.array(found).reshape(times.shape) for found in (values, slopes))
    missing = values[..., -1] - values[..., 0] - length * (slopes[..., 1:-1] @ np.array(INNER.weights))
    return np.asarray(np.sum(np.abs(missing) * length, axis=1))
