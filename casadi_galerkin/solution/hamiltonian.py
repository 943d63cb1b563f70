"""The integrand of the cost with its multipliers, and its jumps along a path.

With the path, the controls and the multipliers found, the cost is ∫ I dt to first order, where

    I(t, z) = ℓ + λ·(∂L/∂x + F, ρ) + dλ/dt·(∂L/∂v, x) + μ·g,        z = (x, v, u, λ, dλ/dt, μ).

As a function of u it is the Hamiltonian of the optimization, up to a constant: an optimal control minimizes it.

Each quadrature point represents a share of the time, from a to b (`jump_detection`).  With z fixed at its values at
the point, I fulfils

    I(b, z) - I(a, z) = ∫ ∂I/∂t dt

where it is smooth in time, however fast controls change.  The difference of both sides is a jump in time, which may
change the cost as much as ∫ I dt.  A finer mesh finds its time.  It does not find that of a jump as x and v move along
the path, with the controls and multipliers fixed, because no derivative tells the solver of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.quadrature import Quadrature
from casadi_galerkin.functional.mapping import at_places
from casadi_galerkin.problems.callables import with_parameters
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.controlled_motion import equations_of_motion
from casadi_galerkin.solution.jump_detection import MARGIN, JumpDetector


def integrand(problem: ControlProblem, parameters: tuple[float, ...] | None) -> ca.Function:
    """(t, z) -> I, ∂I/∂t, ∂I/∂u and the columns of ∂²I/∂u², without the force of a holonomic constraint."""
    motion = equations_of_motion(problem)
    *point, push = motion.sx_in()
    cost = with_parameters(problem.running_cost, parameters)(*point)
    limited = with_parameters(problem.path_constraint[0], parameters)(*point)
    costate, rate = (ca.SX.sym(name, problem.dimension) for name in ("costate", "costate_rate"))
    multipliers, (momentum, changes) = ca.SX.sym("multipliers", limited.numel()), motion(*point, 0 * push)
    total = cost + ca.dot(costate, changes) + ca.dot(rate, momentum) + ca.dot(multipliers, limited)
    curvature, slope = ca.hessian(total, point[3])
    found = total, ca.gradient(total, point[0]), slope, ca.densify(curvature).nz[:]
    return ca.Function("integrand", [*point, costate, rate, multipliers], [*map(ca.densify, found)])


@dataclass(frozen=True)
class Jumps:
    """Jumps of the integrand I inside of the intervals, (N,) each.

    Attributes
    ----------
    effects : largest change of the cost by jumps in time
    unseen : largest jump of I that the solver does not see, as x and v move
    """

    effects: np.ndarray
    unseen: np.ndarray


def jumps_along(
    function: ca.Function, path: PiecewisePolynomial, rule: Quadrature, z: Sequence[np.ndarray], moving: np.ndarray
) -> Jumps:
    """The jumps of an `integrand` along a path.

    Parameters
    ----------
    function : (t, z) -> I, ∂I/∂t and others
    path : x
    rule : of quadrature, whose points have the shares
    z : values at the points, (rows, N r) each
    moving : (N,), where times, or jumps in time, move with what is optimized: the solver does not see these either
    """
    detector, followed = JumpDetector(path.mesh, rule), _followed(function)
    x, v, *fixed = (np.repeat(a, len(detector.parts) // len(rule), axis=1) for a in z)
    values, rates, *_ = at_places(function, detector.times, x, v, *fixed)
    state = [path(detector.times, nu) for nu in range(3)]
    along = at_places(followed, detector.times, *state, *fixed)
    in_time, everywhere = (np.abs(detector.jumps(f[0], df[0])) for f, df in ((values, rates), along))
    unseen = np.max(_unseen(in_time, everywhere, moving[:, None]), axis=1)
    joints, steps = path.mesh[1:-1], np.diff(path.mesh)
    near = MARGIN * np.minimum(steps[:-1], steps[1:])
    held = path(joints), path(joints, 1), 0 * path(joints), *(a[:, len(rule) :: len(rule)] for a in z[2:])
    sides = [(when, path(when)) for when in (joints - near, joints + near)]
    early, late = (at_places(followed, when, *held)[0][0] for when, _ in sides)
    before, after = (at_places(followed, when, place, *held[1:]) for when, place in sides)
    step = np.abs(after[0] - before[0] - near * (after[1] + before[1]))[0]
    unseen[1:] = np.maximum(unseen[1:], _unseen(np.abs(late - early), step, moving[:-1]))
    return Jumps(detector.jump_effects(values[0], rates[0]), unseen)


def _unseen(in_time: np.ndarray, along: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Jumps along a path that are not those in time, or all where these move."""
    return np.where(moving | (in_time <= along / 2), along, 0.0)


def _followed(function: ca.Function) -> ca.Function:
    """(t, x, v, dv/dt, others of z) -> I, and its derivative along the path with these others fixed."""
    t, x, v, *fixed = function.sx_in()
    acceleration, value = ca.SX.sym("acceleration", x.numel()), function(t, x, v, *fixed)[0]
    rate = ca.jtimes(value, ca.vertcat(t, x, v), ca.vertcat(1, v, acceleration))
    return ca.Function("followed", [t, x, v, acceleration, *fixed], [value, ca.densify(rate)])
