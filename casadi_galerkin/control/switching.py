"""Where controls switch from bound to bound: by their impulses, and by the switching function ∂(ℓ + λ·(F, ρ))/∂u.

A control of convex cost does not jump, but may pass from bound to bound within an interval.  It switches in the middle
between the two `bends`, and no more once both of these are joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from casadi_galerkin.control.bends import Bend
from casadi_galerkin.functional.mapping import at_places
from casadi_galerkin.solution.control_trajectory import ControlTrajectory

NEAR_BOUND = 0.05  # distance from a bound, over that of the bounds, below which a control is at the bound
RESOLVED = 0.1  # distance of joints from two bends, over that of the bends, up to which these are joints
PARTS = 32  # parts of a bracket on each of which the switching function is interpolated linearly


@dataclass(frozen=True)
class Switch:
    """The switch of a control from bound to bound.

    Attributes
    ----------
    when : its time, from the impulse ∫ u dt over the intervals around it
    joint : time of the nearest joint
    due : time of the zero of the switching function, or the middle of a passage; `when` if there is neither nearby
    control, before, after : index of the control, and its bounds on both sides
    """

    when: float
    joint: float
    due: float
    control: int
    before: float
    after: float


def held_sides(u: np.ndarray, low: float, high: float) -> np.ndarray:
    """1 or -1 where values of a control are at the upper or lower bound at two successive points or more, else 0."""
    slack = NEAR_BOUND * (high - low)
    side = np.where(u >= high - slack, 1, np.where(u <= low + slack, -1, 0))
    near = np.concatenate(([0], side, [0]))
    return np.where((side == near[2:]) | (side == near[:-2]), side, 0)


def switches(path: ControlTrajectory, bends: Sequence[Bend] = ()) -> list[Switch]:
    """All switches of all controls, each within the length of one interval, where these are the bends of the path."""
    found, r, steps, times = [], len(path.method.quadrature), np.diff(path.t), path.control.times
    for i, (u, low, high) in enumerate(zip(path.control.values, *path.problem.control_bounds, strict=True)):
        if not 0 < high - low < np.inf:
            continue
        side, passages = held_sides(u, low, high), passages_of(bends, i)
        bound = np.flatnonzero(side)
        for a, b in pairwise(bound.tolist()):
            first, last = a // r, b // r
            if side[a] == side[b] or times[b] - times[a] > np.max(steps[first : last + 1]):
                continue
            near = [p for p in passages if times[a] <= np.mean(p) <= times[b]]
            if near and resolved(path.t, near[0]):
                continue
            due = float(np.mean(near[0])) if near else zero(path, i, times[first * r], times[last * r + r - 1])
            before, after = (high, low) if side[a] > 0 else (low, high)
            found.append(switch(path, i, first, last, before, after, due))
    return found


def passages_of(bends: Sequence[Bend], i: int) -> list[tuple[float, float]]:
    """The times at which a control leaves one bound and meets the other, which are equal where no more is known."""
    own = [bend for bend in bends if bend.control == i]
    pairs = [(bend, bend) for bend in own] + list(pairwise(own))
    return [(a.when, b.when) for a, b in pairs if a.before * b.after == -1]


def resolved(mesh: np.ndarray, passage: tuple[float, float]) -> bool:
    """Whether there are joints at both ends of a passage."""
    distances = np.min(np.abs(mesh - np.reshape(passage, (2, 1))), axis=1)
    return bool(np.max(distances) < RESOLVED * (passage[1] - passage[0]))


def switch(path: ControlTrajectory, i: int, first: int, last: int, before: float, after: float, due: float) -> Switch:
    """The switch of control i within some intervals: a jump at this time would have the same impulse there."""
    r, steps = len(path.method.quadrature), np.diff(path.t)[first : last + 1]
    local = path.control.values[i].reshape(-1, r)[first : last + 1]
    means = local @ np.array(path.method.quadrature.weights)
    when = float(path.t[first] + steps @ (means - after) / (before - after))
    joint = float(path.t[np.argmin(np.abs(path.t - when))])
    return Switch(when, joint, due if np.isfinite(due) else when, i, before, after)


def zero(path: ControlTrajectory, i: int, first: float, last: float) -> float:
    """Time at which the switching function of control i changes its sign; NaN if it does not."""
    times = np.linspace(first, last, PARTS + 1)
    state = path(times), path(times, 1), path.control(times), path.costate(times)
    values = at_places(path.between_points.integrand, times, *state, shared=(0.0, 0.0))[2][i]
    changes = np.flatnonzero(values[1:] * values[:-1] <= 0)
    if len(changes) == 0:
        return np.nan
    k = int(changes[0])
    if path.costate.arrivals is not None and np.any((times[k] < path.t) & (path.t <= times[k + 1])):
        return np.nan  # the costate, and with it the switching function, may change its sign by a jump at the joint
    change = values[k] - values[k + 1]
    return float(times[k] + (times[k + 1] - times[k]) * (values[k] / change if change else 0.0))
