"""Times at which a bound is touched, where the next mesh is to have a joint.

A bound acts at nodes or quadrature points.  On a path that touches it only once, its impulse should act when the
bounded value is extreme.  Let it act at the time a, on the mean of the nodes beside the touch, and let the value then
be extreme at the time e.  Paths with other nodes have other times a and e, and the touch is at the time where e(a) = a.
Two paths give that time by the secant rule: to act at e in place of a alone may not converge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, sampling_parts
from casadi_galerkin.control.chain import Chain
from casadi_galerkin.problems.dependence import CONTROLS, VELOCITIES, rows_that_depend
from casadi_galerkin.solution.control_trajectory import FINER, ControlTrajectory

AT_BOUND = 1e-6  # distance from a bound, over the size of a value, up to which it is at the bound
LEAST_SHARE = 1e-6  # impulse at a node over the largest one up to which no bound acts there
LEAST_PART = 1e-3  # the same among neighbors, which the solver keeps a little off the bound
LEAST_EFFECT = 1e-9  # cost, over its size, of moving the bound by the size of the value, up to which none acts
MOST_NODES = 4  # on more nodes than these a path does not touch a bound, but moves along it
PARABOLA = 0.25  # distance from the bound an interval beside a touch, over that of a parabola, which is seen at least
DIFFERENT = 0.3  # difference of two times a over e - a from which they give a secant
FARTHEST = 3.0  # distance from a to the time of the touch over e - a up to which the secant is trusted


@dataclass(frozen=True)
class Touch:
    """A touch of a bound; times are fractions of the duration.

    Attributes
    ----------
    number : of the position or, after all positions, of the path constraint
    acts, extreme : the times a and e
    error : √ of the excess over the bound between a and e, over the size of the value.  This is about the error of the
        path.  The excess itself is soon hidden by rounding
    reach : change of the value by the slope between a and e in the whole duration, over its size
    """

    number: int
    acts: float
    extreme: float
    error: float
    reach: float


@dataclass(frozen=True)
class Bounded:
    """A bounded value along a path.

    Attributes
    ----------
    number : as of a `Touch`
    values : of one component
    size : of the value
    times, impulses : (K,), when the bound acts, in costs per change of the bound
    """

    number: int
    values: PiecewisePolynomial
    size: float
    times: np.ndarray
    impulses: np.ndarray


def of_positions(constraint: ca.Function) -> np.ndarray:
    """Which path constraints depend on time and positions only, (k,)."""
    others = [(kind, np.ones(constraint.size1_in(kind), dtype=bool)) for kind in (VELOCITIES, CONTROLS)]
    return ~np.any([rows_that_depend(constraint, *every) for every in others], axis=0)


def position_impulses(path: ControlTrajectory) -> np.ndarray:
    """Multipliers of the bounds of positions at the nodes of every interval, (d, N, m + 1).

    They are costs over lengths.  Those of the two values at a joint, which are equal, are one each.
    """
    fields = Chain(path.problem, path.method, path.t).fields
    joints, others = (path.duals[1][fields[name]] for name in ("x", "nodes"))
    return np.abs(np.concatenate((joints[:-1, None], others), axis=1)).transpose(2, 0, 1)


def constraint_impulses(path: ControlTrajectory) -> np.ndarray:
    """Impulses of the path constraints at the quadrature points of every interval, (k, N, r)."""
    assert path.path_multipliers is not None, "there are path constraints"
    forces = np.abs(path.path_multipliers.values).reshape(-1, len(path.t) - 1, path.control.rule.size)
    return forces * np.array(path.method.quadrature.weights) * np.diff(path.t)[:, None]


def bounded_positions(path: ControlTrajectory) -> list[Bounded]:
    """The positions that have momenta, with the impulses of their bounds at all nodes but the ends."""
    local, m, x = position_impulses(path), path.method.degree, path.polynomial
    impulses = local[:, :, :-1].reshape(len(local), -1)
    impulses[:, m::m] += local[:, :-1, -1]
    low, high = (np.array(side)[:, None] for side in path.problem.position_bounds)
    distances = np.minimum(x.values - low, high - x.values)[:, :-1] / path.sizes[:, None]
    impulses[distances > AT_BOUND] = 0.0
    return [
        Bounded(i, PiecewisePolynomial(x.mesh, x.nodes, x.values[[i]]), path.sizes[i], x.node_times[1:-1], acting[1:])
        for i, acting in enumerate(impulses[: path.problem.mechanical])
    ]


def bounded_constraints(path: ControlTrajectory) -> list[Bounded]:
    """The path constraints of positions, with their impulses at the quadrature points."""
    function = path.problem.path_constraint[0]
    if path.path_multipliers is None or not np.any(of_positions(function)):
        return []
    nodes = Galerkin(2 * path.method.degree).element.nodes
    local = path.path_constraints(nodes)
    ends = local[:, -1:, -1]
    values = np.concatenate((local[:, :, :-1].reshape(len(local), -1), ends), axis=1)
    sizes = np.min(path._changes_at_largest(*path._excess(sampling_parts(FINER * path.method.degree))), axis=1)
    impulses = constraint_impulses(path).reshape(len(local), -1)
    return [
        Bounded(
            len(path.x) + int(k),
            PiecewisePolynomial(path.t, nodes, values[[k]]),
            sizes[k],
            path.path_multipliers.times,
            impulses[k],
        )
        for k in np.flatnonzero(of_positions(function) & np.isfinite(values).all(axis=1))
    ]


def touches(path: ControlTrajectory) -> list[Touch]:
    """All touches of bounds of positions, and of path constraints on positions."""
    if path.polynomial.arrivals is not None:
        return []
    of_bounds = bounded_positions(path) if np.isfinite(path.problem.position_bounds).any() else []
    found = list[Touch | None]()
    for bounded in of_bounds + bounded_constraints(path):
        impulses = bounded.impulses
        least = max(LEAST_SHARE * np.max(impulses), LEAST_EFFECT * path.cost_size / bounded.size)
        acting = np.flatnonzero(impulses > least)
        groups = np.split(acting, 1 + np.flatnonzero(np.diff(acting) > 1))
        main = [group[impulses[group] > LEAST_PART * np.max(impulses[group])] for group in groups if len(group)]
        found += [_touch(bounded, group) for group in main if len(group) <= MOST_NODES]
    return [touch for touch in found if touch is not None]


def _touch(bounded: Bounded, group: np.ndarray) -> Touch | None:
    """The touch of a bound where it acts at some neighboring times, if it is only touched there."""
    path, times = bounded.values, bounded.times[group]
    mesh, begin, end = path.mesh, float(path.mesh[0]), float(path.mesh[-1])
    a = float(np.average(times, weights=bounded.impulses[group]))
    slope, curvature = path(a, 1).item(), path(a, 2).item()
    e = a - slope / curvature if curvature else np.nan
    first, last = np.searchsorted(mesh, times[0]) - 1, np.searchsorted(mesh, times[-1], side="right")
    step = float(np.max(np.diff(mesh)[max(first, 0) : last]))
    if not (abs(e - a) < step and begin < e < end):
        return None
    beside = np.clip(e + step * np.array([-1.0, 1.0]), begin, end)
    if not np.all((path(beside)[0] - path(e)[0]) / curvature > PARABOLA * (beside - e) ** 2 / 2):
        return None
    error, reach = abs(slope) / float(np.sqrt(2 * abs(curvature) * bounded.size)), abs(slope) / bounded.size
    return Touch(bounded.number, (a - begin) / (end - begin), (e - begin) / (end - begin), error, reach * (end - begin))


def alike(touch: Touch, others: Sequence[Touch]) -> list[Touch]:
    """Touches of the same bound by other paths that act at so different times that two give a secant, nearest first."""
    same = [other for other in others if other.number == touch.number]
    far = [other for other in same if abs(other.acts - touch.acts) > DIFFERENT * abs(touch.extreme - touch.acts)]
    return sorted(far, key=lambda other: abs(other.extreme - touch.extreme))


def touch_time(touch: Touch, others: Sequence[Touch]) -> float:
    """The time of a touch by the secant rule from that of another path, or between a and e; a fraction."""
    a, late = touch.acts, touch.extreme - touch.acts
    for other in alike(touch, others):
        change = other.extreme - other.acts - late
        step = -late * (other.acts - a) / change if change else np.inf
        if abs(step) <= FARTHEST * abs(late):
            return a + step
    return a + late / 2


def touch_error(touch: Touch, others: Sequence[Touch]) -> float:
    """Error of the path because a bound that is touched acts at a wrong time.

    Where the touch is weak, it hardly changes the path: then e hardly depends on a, and the slope at the touch would
    change by no more than that between a and e times this dependence.
    """
    for other in alike(touch, others)[:1]:
        dependence = abs((other.extreme - touch.extreme) / (other.acts - touch.acts))
        return min(touch.error, dependence * touch.reach)
    return touch.error
