"""An error indicator for jumps of the callables in time inside intervals.

With the path, the controls and the multipliers found, the cost is ∫ I dt to first order, where

    I(t, z) = ℓ + λ·(∂L/∂x + F, ρ) + dλ/dt·(∂L/∂v, x) + μ·g,        z = (x, v, u, λ, dλ/dt, μ).

Each quadrature point represents a share of the time, from a to b (`jump_detection`).  With z fixed at its values at
the point,

    I(b, z) - I(a, z) = ∫ ∂I/∂t dt

holds where I is smooth in time, however fast controls change.  A jump may change the cost as much as ∫ I dt.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_galerkin.functional.mapping import at_places
from casadi_galerkin.problems.callables import with_parameters
from casadi_galerkin.problems.controlled_motion import equations_of_motion
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.jump_detection import JumpDetector


def integrand(path: ControlTrajectory) -> ca.Function:
    """(t, z) -> I, ∂I/∂t and ∂I/∂u, without the force of a holonomic constraint."""
    problem, motion = path.problem, equations_of_motion(path.problem)
    *along, push = motion.sx_in()
    cost = with_parameters(problem.running_cost, path.parameters)(*along)
    limited = with_parameters(problem.path_constraint[0], path.parameters)(*along)
    costate, rate = (ca.SX.sym(name, problem.dimension) for name in ("costate", "costate_rate"))
    multipliers, (momentum, changes) = ca.SX.sym("multipliers", limited.numel()), motion(*along, 0 * push)
    total = cost + ca.dot(costate, changes) + ca.dot(rate, momentum) + ca.dot(multipliers, limited)
    found = [total, *(ca.gradient(total, along[k]) for k in (0, 3))]
    return ca.Function("integrand", [*along, costate, rate, multipliers], [*map(ca.densify, found)])


def jumps_in_time(path: ControlTrajectory) -> np.ndarray:
    """Largest change of the cost by jumps in time inside of each interval; (N,)."""
    rule = path.method.quadrature
    detector, points = JumpDetector(path.t, rule), np.array(rule.points)
    count, at_points = len(detector.times), (len(path.t) - 1) * len(points)
    multipliers = np.empty((0, at_points)) if path.path_multipliers is None else path.path_multipliers.at(points)
    z = *path.polynomial.at_parts(points), path.control.at(points), *path.costate.at_parts(points), multipliers
    given = [np.repeat(a.reshape(len(a), at_points), count // at_points, axis=1) for a in z]
    values, rates, _ = at_places(integrand(path), detector.times, *given)
    return detector.jump_effects(values[0], rates[0])
