"""Continuous controls where several act alike, such as angles that differ by full turns.

Where many controls have the same effect, an optimizer may stop at another one at each quadrature point.  Path and cost
are right, but the control as a function of time is not.  So from each point to the next, Newton's method looks for the
control near the last one that has the same effect as the one found: the same force, rates, running cost and path
constraints.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import EPS, or_one
from casadi_galerkin.control.control_numbering import Chain
from casadi_galerkin.functional.pointwise import at_places
from casadi_galerkin.problems.control_problem import ControlProblem

# step of a control from one point to the next, over its range before, beyond which another control is looked for
LONG_STEP = 0.1


@lru_cache(8)
def _effect(
    force: ca.Function, rates: ca.Function, running_cost: ca.Function, constraint: ca.Function
) -> ca.Function | None:
    """(u, t, x, v[, p]) -> what a control does at a point, and its derivative by u; None if forces are affine in u."""
    t, x, v, u, *p = force.sx_in()
    moving = ca.vertcat(force(t, x, v, u, *p), rates(t, x, v, u, *p))
    if not ca.jacobian(ca.jacobian(moving, u), u).nnz():
        return None
    effect = ca.vertcat(moving, running_cost(t, x, v, u, *p), constraint(t, x, v, u, *p))
    return ca.Function("effect", [u, t, x, v, *p], [ca.densify(effect), ca.densify(ca.jacobian(effect, u))])


@np.errstate(over="ignore", invalid="ignore")  # Newton's method may be lost
def _same_effect(
    effect: ca.Function, place: list[np.ndarray], wanted: np.ndarray, scale: np.ndarray, near: np.ndarray
) -> np.ndarray | None:
    """The control near another one that does what is wanted, by Newton's method with shortest steps; None if lost."""
    u, longest = near, np.inf
    while True:
        does, slope = (np.array(a) for a in effect(u, *place))
        missing, sizes = wanted - does.ravel(), np.abs(wanted) + np.abs(slope) @ np.abs(u)
        if not np.isfinite(missing + sizes).all():
            return None
        step = np.linalg.lstsq(slope / scale[:, None], missing / scale, rcond=None)[0]
        size = float(np.max(np.abs(step)))
        if not 0 < size < longest / 2:  # steps of Newton's method fall faster until they are rounding
            return u if np.all(np.abs(missing) <= np.sqrt(EPS) * sizes) else None
        u, longest = u + step, size


def continuous_controls(
    problem: ControlProblem, chain: Chain, path: PiecewisePolynomial, values: dict[str, np.ndarray]
) -> np.ndarray:
    """The controls (N, r, n) of one solution, each with the same effect as before, continuous where they can be.

    A control is replaced by one at most half as far from the last one, and only within its bounds.

    Parameters
    ----------
    path : the path found
    values : one array for every field of the `Chain`
    """
    found = values["controls"]
    if problem.hold or not found.size or np.isfinite(problem.control_rate_bounds).any():
        return found
    controls = found.reshape(-1, chain.controls).copy()
    if np.all(np.abs(np.diff(controls, axis=0)) <= LONG_STEP * np.ptp(controls, axis=0)):
        return found
    effect = _effect(problem.force, problem.rates, problem.running_cost, problem.limits[0])
    if effect is None:
        return found
    times, x, v = path.sampled(chain.control_times)
    p = [] if problem.parameters is None else [values["parameters"]]
    wanted, _ = at_places(effect, controls.T, times, x, v, shared=p)
    scale = or_one(np.max(np.abs(wanted), axis=1))
    low, high = (np.array(bound) for bound in problem.control_bounds)

    for k in range(1, len(controls)):
        last, now = controls[k - 1], controls[k]
        near = np.all(np.abs(now - last) <= LONG_STEP * np.ptp(controls[:k], axis=0))
        if near or not np.all((low < now) & (now < high)):
            continue
        u = _same_effect(effect, [times[k], x[:, k], v[:, k], *p], wanted[:, k], scale, last)
        if u is None or np.max(np.abs(u - last)) > np.max(np.abs(now - last)) / 2:
            continue
        if np.all((low < u) & (u < high)):
            controls[k] = u
    return controls.reshape(found.shape)
