"""Times at which a position touches a bound, where the next mesh is to have a joint.

A bound acts at the nodes.  On a path that touches its bound only once, its impulse should act when the position is
extreme.  Let it act at the time a, on the mean of the nodes beside the touch, and let the position then be extreme at
the time e.  Paths with other nodes have other times a and e, and the touch is at the time where e(a) = a.  Two paths
give that time by the secant rule: to act at e in place of a alone may not converge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casadi_galerkin.control.chain import Chain
from casadi_galerkin.solution.control_trajectory import ControlTrajectory

LEAST_SHARE = 1e-6  # impulse of a node over the largest one up to which no bound acts there
AT_BOUND = 1e-6  # distance from a bound, over the size of the position, up to which a node is at the bound
LEAST_EFFECT = 1e-9  # cost, over its size, of moving the bound by the size of the position, up to which none acts
MOST_NODES = 3  # on more nodes than these a path does not touch a bound, but moves along it
PARABOLA = 0.25  # distance from the bound an interval beside a touch, over that of a parabola, which is seen at least
DIFFERENT = 0.3  # difference of two times a over e - a from which they give a secant
FARTHEST = 3.0  # distance from a to the time of the touch over e - a up to which the secant is trusted


@dataclass(frozen=True)
class Touch:
    """A touch of a bound; times are fractions of the duration.

    Attributes
    ----------
    component : number of the position
    acts, extreme : the times a and e
    error : √ of the excess over the bound between a and e, over the size of the position.  This is about the error of
        the path.  The excess itself is soon hidden by rounding
    """

    component: int
    acts: float
    extreme: float
    error: float


def bound_impulses(path: ControlTrajectory) -> np.ndarray:
    """Multipliers of the bounds of positions at the nodes of every interval, (d, N, m + 1).

    They are costs over lengths.  Those of the two values at a joint, which are equal, are one each.
    """
    fields = Chain(path.problem, path.method, path.t).fields
    joints, others = (path.duals[1][fields[name]] for name in ("x", "nodes"))
    return np.concatenate((joints[:-1, None], others), axis=1).transpose(2, 0, 1)


def touches(path: ControlTrajectory) -> list[Touch]:
    """All touches of bounds by positions that have momenta."""
    if path.polynomial.arrivals is not None or not np.isfinite(path.problem.position_bounds).any():
        return []
    local, m, found = np.abs(bound_impulses(path)), path.method.degree, list[Touch | None]()
    impulses = np.zeros(path.polynomial.values.shape)  # at all nodes but the ends
    impulses[:, 1:-1] = local[:, :, :-1].reshape(len(local), -1)[:, 1:]
    impulses[:, m:-1:m] += local[:, :-1, -1]
    low, high = (np.array(side)[:, None] for side in path.problem.position_bounds)
    distances = np.minimum(path.polynomial.values - low, high - path.polynomial.values) / path.sizes[:, None]
    impulses[distances > AT_BOUND] = 0.0
    for i in range(path.problem.mechanical):
        least = max(LEAST_SHARE * np.max(impulses[i]), LEAST_EFFECT * path.cost_size / path.sizes[i])
        acting = np.flatnonzero(impulses[i] > least)
        groups = np.split(acting, 1 + np.flatnonzero(np.diff(acting) > 1))
        found += [_touch(path, i, nodes, impulses[i][nodes]) for nodes in groups if 0 < len(nodes) <= MOST_NODES]
    return [touch for touch in found if touch is not None]


def _touch(path: ControlTrajectory, i: int, nodes: np.ndarray, impulses: np.ndarray) -> Touch | None:
    """The touch of a bound by component i where impulses act on some neighboring nodes, if it only touches it there."""
    m, (begin, end) = path.method.degree, path.t[[0, -1]].tolist()
    a = float(np.average(path.polynomial.node_times[nodes], weights=impulses))
    slope, curvature = float(path(a, 1)[i]), float(path(a, 2)[i])
    e = a - slope / curvature if curvature else np.nan
    step = float(np.max(np.diff(path.t)[(nodes[0] - 1) // m : nodes[-1] // m + 1]))
    if not (abs(e - a) < step and begin < e < end):
        return None
    beside = np.clip(e + step * np.array([-1.0, 1.0]), begin, end)
    if not np.all((path(beside)[i] - path(e)[i]) / curvature > PARABOLA * (beside - e) ** 2 / 2):
        return None
    error = abs(slope) / float(np.sqrt(2 * abs(curvature) * path.sizes[i]))
    return Touch(i, (a - begin) / (end - begin), (e - begin) / (end - begin), error)


def touch_time(touch: Touch, others: Sequence[Touch]) -> float:
    """The time of a touch by the secant rule from that of another path, or between a and e; a fraction."""
    a, late = touch.acts, touch.extreme - touch.acts
    alike = (other for other in others if other.component == touch.component)
    for other in sorted(alike, key=lambda other: abs(other.extreme - touch.extreme)):
        change = other.extreme - other.acts - late
        if abs(other.acts - a) > DIFFERENT * abs(late) and change:
            step = -late * (other.acts - a) / change
            if abs(step) <= FARTHEST * abs(late):
                return a + step
    return a + late / 2
