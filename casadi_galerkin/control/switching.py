"""Where controls switch from bound to bound: by their impulses, and by the switching function ∂(ℓ + λ·(F, ρ))/∂u."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from casadi_galerkin.control.hamiltonian import integrand
from casadi_galerkin.functional.mapping import at_places
from casadi_galerkin.solution.control_trajectory import ControlTrajectory

AT_BOUND = 0.05  # distance from a bound, over that of the bounds, below which a control is at the bound
PARTS = 32  # parts of a bracket on each of which the switching function is interpolated linearly


@dataclass(frozen=True)
class Switch:
    """The switch of a control from bound to bound.

    Attributes
    ----------
    when : its time, from the impulse ∫ u dt over the intervals around it
    joint : time of the nearest joint
    due : time of the zero of the switching function; `when` if there is none nearby
    """

    when: float
    joint: float
    due: float


def sides(u: np.ndarray, low: float, high: float) -> np.ndarray:
    """1 or -1 where values of a control are at the upper or lower bound at two successive points or more, else 0."""
    slack = AT_BOUND * (high - low)
    side = np.where(u >= high - slack, 1, np.where(u <= low + slack, -1, 0))
    near = np.concatenate(([0], side, [0]))
    return np.where((side == near[2:]) | (side == near[:-2]), side, 0)


def switches(path: ControlTrajectory) -> list[Switch]:
    """All switches of all controls, each within the length of one interval."""
    found, r, steps, times = [], len(path.method.quadrature), np.diff(path.t), path.control.times
    for i, (u, low, high) in enumerate(zip(path.control.values, *path.problem.control_bounds, strict=True)):
        if not 0 < high - low < np.inf:
            continue
        side = sides(u, low, high)
        bound = np.flatnonzero(side)
        for a, b in pairwise(bound.tolist()):
            first, last = a // r, b // r
            if side[a] != side[b] and times[b] - times[a] <= np.max(steps[first : last + 1]):
                found.append(switch(path, i, first, last, *((high, low) if side[a] > 0 else (low, high))))
    return found


def switch(path: ControlTrajectory, i: int, first: int, last: int, before: float, after: float) -> Switch:
    """The switch of control i within some intervals: a jump at this time would have the same impulse there."""
    r, steps = len(path.method.quadrature), np.diff(path.t)[first : last + 1]
    local = path.control.values[i].reshape(-1, r)[first : last + 1]
    means = local @ np.array(path.method.quadrature.weights)
    when = float(path.t[first] + steps @ (means - after) / (before - after))
    due = zero(path, i, path.control.times[first * r], path.control.times[last * r + r - 1])
    return Switch(when, float(path.t[np.argmin(np.abs(path.t - when))]), due if np.isfinite(due) else when)


def zero(path: ControlTrajectory, i: int, first: float, last: float) -> float:
    """Time at which the switching function of control i changes its sign; NaN if it does not."""
    times = np.linspace(first, last, PARTS + 1)
    state = path(times), path(times, 1), path.control(times), path.costate(times)
    values = at_places(integrand(path), times, *state, shared=(0.0, 0.0))[2][i]
    changes = np.flatnonzero(values[1:] * values[:-1] <= 0)
    if len(changes) == 0:
        return np.nan
    k = int(changes[0])
    if path.costate.arrivals is not None and np.any((times[k] < path.t) & (path.t <= times[k + 1])):
        return np.nan  # the costate, and with it the switching function, may change its sign by a jump at the joint
    change = values[k] - values[k + 1]
    return float(times[k] + (times[k + 1] - times[k]) * (values[k] / change if change else 0.0))
