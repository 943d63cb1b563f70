"""Steps of forces, rates and costs along an optimal path, in time or as x and v move: jumps of one integrand.

With the path, the controls and the multipliers found, the cost is ∫ I dt to first order, where

    I(t, z) = ℓ + λ·(∂L/∂x + F, ρ) + dλ/dt·(∂L/∂v, x) + μ·g,        z = (x, v, u, λ, dλ/dt, μ).

As a function of u it is the Hamiltonian of the optimization, up to a constant: an optimal control minimizes it.

Each quadrature point represents a part of the time, from a to b (`jump_detection`).  With z fixed at its values at
the point, I fulfils

    I(b, z) - I(a, z) = ∫ ∂I/∂t dt

where it is smooth in time, however fast controls change.  The difference of both sides is a jump in time, which may
change the cost as much as ∫ I dt.  A finer mesh finds its time.  Steps of I as x and v move along the path, with the
controls and multipliers fixed, are another matter: no derivative tells the solver of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.quadrature import Quadrature
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.functional.pointwise import at_places
from casadi_galerkin.problems.callables import STEPPING, entries_within
from casadi_galerkin.problems.constrained_motion import equations_of_motion
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.solution.jump_detection import JOINT_MARGIN, JumpDetector

HALVINGS = round(-np.log2(EPS) / 2)  # of a part of the interval, which leave half its digits


def integrand(problem: ControlProblem) -> ca.Function:
    """(t, z) -> I, ∂I/∂t, ∂I/∂u and the columns of ∂²I/∂u², without the force of a holonomic constraint."""
    motion = equations_of_motion(problem)
    *point, push = motion.sx_in()
    cost = problem.numeric.running_cost(*point)
    limited = problem.numeric.limits[0](*point)
    costate, rate = (ca.SX.sym(name, problem.dimension) for name in ("costate", "costate_rate"))
    multipliers, (momentum, changes) = ca.SX.sym("multipliers", limited.numel()), motion(*point, 0 * push)
    total = cost + ca.dot(costate, changes) + ca.dot(rate, momentum) + ca.dot(multipliers, limited)
    curvature, slope = ca.hessian(total, point[3])
    found = total, ca.gradient(total, point[0]), slope, ca.densify(curvature).nz[:]
    return ca.Function("integrand", [*point, costate, rate, multipliers], [*map(ca.densify, found)])


def may_step(problem: ControlProblem) -> bool:
    """Whether a callable compares or rounds values, or calls a Function: else none steps."""
    stepping, along = {*STEPPING, ca.OP_CALL}, (problem.lagrangian, *problem.along)
    return any(f.instruction_id(k) in stepping for f in along for k in range(f.n_instructions()))


def moving_phases(problem: ControlProblem) -> np.ndarray:
    """Whether times in each phase, or those at which a callable steps there, move with what is free; (phases,)."""
    free = np.zeros(len(problem.breakpoints) + 1, dtype=bool)
    if problem.duration_bounds is not None:
        free = np.cumsum(np.less(*problem.duration_bounds)) > 0
    if problem.parameter_bounds is None:
        return free
    along = problem.lagrangian, *problem.along  # the parameters are the last argument of each
    return free | any(entries_within(f, f.n_in() - 1, STEPPING) for f in along)


def largest_step(
    function: ca.Function, path: PiecewisePolynomial, rule: Quadrature, z: Sequence[np.ndarray], moving: np.ndarray
) -> tuple[float, float]:
    """Largest step of an `integrand` as x and v move along a path, or in time where it moves with it, and when.

    Parameters
    ----------
    function : (t, z) -> I and others
    path : x
    rule : of quadrature, whose points have the parts
    z : values at the points, (rows, N r) each
    moving : (N,), where times, or steps in time, move with what is optimized
    """
    r, joints, steps = len(rule), path.mesh[1:-1], np.diff(path.mesh)
    times = JumpDetector(path.mesh, rule).times.reshape(len(steps), r, -1)
    near = JOINT_MARGIN * np.minimum(steps[:-1], steps[1:])
    early, late = np.append(times[:, :, 0], joints - near), np.append(times[:, :, -1], joints + near)
    along, in_time, when = _steps(_followed(function), path, early, late, [np.hstack((a, a[:, r::r])) for a in z[2:]])
    moves = np.append(np.repeat(moving, r), moving[:-1])
    sizes, inside = np.where(moves | (in_time <= along / 2), along, 0.0), len(steps) * r
    sizes[inside + path.jumps - 1] = 0.0
    largest = int(np.argmax(sizes))
    return float(sizes[largest]), float(np.append(when[:inside], joints)[largest])


def _steps(
    followed: ca.Function, path: PiecewisePolynomial, early: np.ndarray, late: np.ndarray, fixed: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Steps of I as x and v move between two times, those in time alone at the same place, and when, (K,) each.

    Bisection leads to where I changes most beside its derivatives.  There a step stays, whereas a kink vanishes.  The
    last times are those on both sides of the joints.
    """
    inside = len(early) - (len(path.mesh) - 2)
    at_joints = path(path.mesh[1:-1], 1)

    def at(times: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Times, I and dI/dt with the positions and velocities of some places, (3, K)."""
        state = [path(places, nu) for nu in range(3)]
        state[1][:, inside:], state[2][:, inside:] = at_joints, 0.0  # velocities jump there
        return np.vstack((times, *at_places(followed, times, *state, *fixed)))

    def beside(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        change = other - one
        return np.abs(np.nan_to_num(change[1] - change[0] * (one[2] + other[2]) / 2))

    first, last = at(early, early), at(late, late)
    for _ in range(HALVINGS):
        when = (first[0] + last[0]) / 2
        middle = at(when, when)
        before = beside(first, middle) >= beside(middle, last)
        first, last = np.where(before, first, middle), np.where(before, middle, last)
    return beside(first, last), np.abs(np.nan_to_num(at(last[0], first[0])[1] - first[1])), last[0]


def _followed(function: ca.Function) -> ca.Function:
    """(t, x, v, dv/dt, others of z) -> I, and its derivative along the path with these others fixed."""
    t, x, v, *fixed = function.sx_in()
    acceleration, value = ca.SX.sym("acceleration", x.numel()), function(t, x, v, *fixed)[0]
    rate = ca.jtimes(value, ca.vertcat(t, x, v), ca.vertcat(1, v, acceleration))
    return ca.Function("followed", [t, x, v, acceleration, *fixed], [value, ca.densify(rate)])
