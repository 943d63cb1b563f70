"""Times at which a bound is touched, where the next mesh is to have a joint.

A bound is touched where no control can keep a path along it at once: that of a position, or of a velocity whose force
follows a control late.  It acts at nodes or quadrature points.  On a path that touches it only once, its impulse should
act when the bounded value is extreme.  Let it act at the time a, on the mean of the nodes beside the touch, and let the
value then be extreme at the time e.  Paths with other nodes have other times a and e, and the touch is at the time
where e(a) = a.  Two paths give that time by the secant rule: to act at e in place of a alone may not converge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.control.chain import Chain
from casadi_galerkin.problems.bounds import AT_BOUND
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.dependence import CONTROLS, VELOCITIES, rows_that_depend
from casadi_galerkin.problems.legendre_transform import coupled_by_mass
from casadi_galerkin.solution.control_trajectory import ControlTrajectory

LEAST_SHARE = 1e-6  # impulse at a node over the largest one up to which no bound acts there
LEAST_PART = 1e-3  # the same among neighbors, which the solver keeps a little off the bound
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
    """A bounded value along a part of a path in which the path does not jump.

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


def between_jumps(path: ControlTrajectory) -> list[slice]:
    """The intervals between a jump of a path and the next."""
    ends = [0, *np.searchsorted(path.t, [when for when, _ in path.problem.jumps]).tolist(), len(path.t) - 1]
    return [slice(*pair) for pair in pairwise(ends)]


def continuous(path: ControlTrajectory, part: slice, nodes: np.ndarray, local: np.ndarray) -> PiecewisePolynomial:
    """The path that has some values (N,) at the nodes of every interval, on intervals without a jump between them."""
    values = np.append(local[part, :-1], local[part.stop - 1, -1])
    return PiecewisePolynomial(path.t[part.start : part.stop + 1], nodes, values[None])


def driven_positions(problem: ControlProblem) -> np.ndarray:
    """Which components have a rate that depends on a control, (d,)."""
    rated = rows_that_depend(problem.rates, CONTROLS, np.ones(problem.controls, dtype=bool))
    return np.append(np.zeros(problem.mechanical, dtype=bool), rated)


def driven_velocities(problem: ControlProblem) -> np.ndarray:
    """Which velocities are rates, or have a time derivative that may depend on a control, (d,)."""
    forced = rows_that_depend(problem.force, CONTROLS, np.ones(problem.controls, dtype=bool))
    rates = np.arange(problem.dimension) >= problem.mechanical
    forced = np.append(forced, np.zeros(np.count_nonzero(rates), dtype=bool))
    return rates | coupled_by_mass(problem.lagrangian, forced)


def bounds_touched(problem: ControlProblem) -> np.ndarray:
    """Which path constraints depend on no control, and on no velocity that a control changes at once, (k,)."""
    constraint, every = problem.path_constraint[0], np.ones(problem.controls, dtype=bool)
    if not constraint.numel_out(0):
        return np.zeros(0, dtype=bool)
    others = (VELOCITIES, driven_velocities(problem)), (CONTROLS, every)
    return ~np.any([rows_that_depend(constraint, *chosen) for chosen in others], axis=0)


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
    """The positions no control changes at once, with the impulses of their bounds at all nodes but ends and jumps."""
    impulses, x, m = position_impulses(path), path.polynomial, path.method.degree
    low, high = (np.array(side)[:, None, None] for side in path.problem.position_bounds)
    impulses[np.minimum(x.local - low, high - x.local) / path.sizes[:, None, None] > AT_BOUND] = 0.0
    found = list[Bounded]()
    for i, part in product(np.flatnonzero(~driven_positions(path.problem)).tolist(), between_jumps(path)):
        values, local = continuous(path, part, x.nodes, x.local[i]), impulses[i, part]
        acting = local[:, :-1].ravel()
        acting[m::m] += local[:-1, -1]
        found.append(Bounded(i, values, path.sizes[i], values.node_times[1:-1], acting[1:]))
    return found


def bounded_constraints(path: ControlTrajectory) -> list[Bounded]:
    """The path constraints that may be touched, with their impulses at the quadrature points."""
    chosen = bounds_touched(path.problem)
    if path.path_multipliers is None or not np.any(chosen):
        return []
    nodes = Galerkin(2 * path.method.degree).element.nodes
    local, impulses = path.path_constraints(nodes), constraint_impulses(path)
    sizes = np.min(path.between_points.constraint_changes, axis=1)
    times = path.path_multipliers.times.reshape(len(path.t) - 1, -1)
    known = np.flatnonzero(chosen & np.isfinite(local).all(axis=(1, 2))).tolist()
    return [
        Bounded(
            len(path.x) + k,
            continuous(path, part, nodes, local[k]),
            sizes[k],
            times[part].ravel(),
            impulses[k, part].ravel(),
        )
        for k, part in product(known, between_jumps(path))
    ]


def touches(path: ControlTrajectory) -> list[Touch]:
    """All touches of bounds of positions, and of path constraints."""
    of_bounds = bounded_positions(path) if np.isfinite(path.problem.position_bounds).any() else []
    found = list[Touch | None]()
    for bounded in of_bounds + bounded_constraints(path):
        impulses = bounded.impulses
        acting = np.flatnonzero(impulses > LEAST_SHARE * np.max(impulses))
        groups = np.split(acting, 1 + np.flatnonzero(np.diff(acting) > 1))
        main = [group[impulses[group] > LEAST_PART * np.max(impulses[group])] for group in groups if len(group)]
        found += [_touch(bounded, group, path.t) for group in main if len(group) <= MOST_NODES]
    return [touch for touch in found if touch is not None]


def _touch(bounded: Bounded, group: np.ndarray, joints: np.ndarray) -> Touch | None:
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
    error, duration = abs(slope) / float(np.sqrt(2 * abs(curvature) * bounded.size)), float(np.ptp(joints))
    acts, extreme = (a - joints[0]) / duration, (e - joints[0]) / duration
    return Touch(bounded.number, acts, extreme, error, duration * abs(slope) / bounded.size)


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
