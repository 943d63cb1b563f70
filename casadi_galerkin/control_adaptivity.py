"""How wrong an optimal path is, and on which mesh it would be less so, from the same mesh with degree m + 2.

The relative changes of cost and duration and the largest change of x, at the same fraction of the duration and relative
to the size of its component, make D; with q the ratio of what the two paths leave out (`truncation`), the estimated
error is D / (1 - q).

Two things that both degrees miss alike are added.  A switch from bound to bound is due where the switching function
∂(ℓ + λ·F)/∂u is zero: with the joint next to it elsewhere, no quadrature point may lie between and tell.  And bounds
of positions hold at nodes only: passing one by ε between them moves the path by about √ε.

The new mesh spreads what the finer path has beyond degree m evenly.  Where a higher degree does not help the path has
a kink, and intervals are split as for order 2.  Where a control switches inside an interval its impulse ∫ u dt tells
when, and a joint is moved there; the intervals on both sides shrink with the time by which the switch is not due there.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.adaptivity import TARGET, equidistributed, sizes, truncation
from casadi_galerkin.calculus import DiscreteCalculus, Galerkin
from casadi_galerkin.control_trajectory import ControlTrajectory

SLOWEST = 2 / 3  # q where a jump or a constraint at points keeps the higher degree from gaining much
STUBBORN = 0.25  # an interval whose truncation falls by less with the higher degree is not smooth
KINK_ORDER = 2  # a jump of the acceleration inside a step h moves x by h²
FINEST = 8.0  # parts of one interval at once; a kink needs few levels and leaves few intervals behind
LEAST = 1e-3  # of the target: intervals beside a switch that is not late may grow, as far as a mesh lets them
AT_BOUND = 0.05  # of the bounds' distance: a switch is from one bound to the other within this
NEAR = 2  # intervals within which it happens
ZOOMS = 4  # of 32 parts each, in search of a zero: 1e-6 of the bracket, then linear
ROUNDOFF = 1e-15  # of positions relative to their size


@dataclass(frozen=True)
class Switch:
    """A control goes from bound to bound: the time its impulse tells, the nearest joint, when it is due."""

    when: float
    joint: float
    due: float


def sampled(path: ControlTrajectory, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Times (N, K) at and between the joints, and positions there (d, N, K)."""
    times = path.t[:-1, None] + np.diff(path.t)[:, None] * np.linspace(0, 1, 4 * degree + 1)
    return times, path.path(times)


def change_of_degree(path: ControlTrajectory, higher: ControlTrajectory) -> float:
    """Relative error of cost, duration and positions, D / (1 - q)."""
    degree = path.method.degree
    change = np.abs(sampled(higher, degree)[1] - sampled(path, degree)[1]) / sizes(path.path)[:, None, None]
    cost = abs(higher.cost - path.cost) / (abs(higher.cost) or 1.0)
    duration = abs(np.ptp(higher.t) / np.ptp(path.t) - 1)
    coarse, fine = (float(np.max(truncation(p.path))) for p in (path, higher))
    at_points = path.problem.path_constraint is not None or len(switches(higher)) > 0
    ratio = SLOWEST if at_points else min(fine / max(coarse, fine, 1e-300), SLOWEST)
    return float(max(cost, duration, np.max(change)) / (1 - ratio))


def estimated_error(path: ControlTrajectory, higher: ControlTrajectory) -> float:
    """Relative error of cost, duration and positions from the same mesh with degree m + 2."""
    late = [abs(s.due - s.joint) / np.ptp(higher.t) for s in switches(higher)]
    return float(max(change_of_degree(path, higher), *late, np.sqrt(np.max(excess(path))), 0.0))


def excess(path: ControlTrajectory) -> np.ndarray:
    """By how much positions leave their bounds between the nodes, relative to the components' sizes; (N,)."""
    low, high = (np.array(side)[:, None, None] for side in path.problem.position_bounds)
    times, _ = sampled(path, path.method.degree)
    slopes = path.path(times, 1)
    change = slopes[:, :, :-1] - slopes[:, :, 1:]
    part = np.clip(slopes[:, :, :-1] / np.where(change != 0, change, 1.0), 0.0, 1.0)
    turning = times[:, :-1] + part * np.diff(times)  # where a component turns, or one end of the sample
    positions = np.stack([path.path(when)[i] for i, when in enumerate(turning)])
    beyond = np.maximum(np.maximum(low - positions, positions - high), 0.0) / sizes(path.path)[:, None, None]
    return np.asarray(np.max(np.where(beyond > ROUNDOFF, beyond, 0.0), axis=(0, 2)))


def beyond_degree(path: ControlTrajectory, degree: int) -> np.ndarray:
    """What a path has on each interval that a lower degree has not, relative to the components' sizes; (N,)."""
    calculus = DiscreteCalculus(Galerkin(degree), path.t)
    times, positions = sampled(path, degree)
    change = positions - calculus.emb(path.path(calculus.node_times))(times)
    return np.asarray(np.max(np.abs(change) / sizes(path.path)[:, None, None], axis=(0, 2)))


def switching_function(path: ControlTrajectory, times: np.ndarray) -> np.ndarray:
    """∂(ℓ + λ·F)/∂u along the path, (n, K)."""
    problem, d = path.problem, path.problem.dimension
    symbols = [ca.SX.sym("t"), ca.SX.sym("x", d), ca.SX.sym("v", d), ca.SX.sym("u", problem.controls)]
    costate, given = ca.SX.sym("costate", d), [] if path.parameters is None else [ca.SX(ca.DM(path.parameters))]
    arguments = [*symbols, *given]
    total = problem.running_cost(*arguments) + ca.dot(costate, problem.force(*arguments))
    slope = ca.Function("slope", [*symbols, costate], [ca.densify(ca.gradient(total, symbols[3]))]).map(len(times))
    along = (path.path(times), path.path(times, 1), path.control(times), path.costate(times))
    return np.array(slope(times[None, :], *along))


def switches(path: ControlTrajectory) -> list[Switch]:
    """All switches of all controls."""
    found, r = [], len(path.method.quadrature)
    for i, (u, low, high) in enumerate(zip(path.control.values, *path.problem.control_bounds, strict=True)):
        if not 0 < high - low < np.inf:
            continue
        slack = AT_BOUND * (high - low)
        side = np.where(u >= high - slack, 1, np.where(u <= low + slack, -1, 0))
        bound = np.flatnonzero(side)
        for k in np.flatnonzero(side[bound[1:]] != side[bound[:-1]]):
            first, last = bound[k] // r, bound[k + 1] // r
            if last - first <= NEAR:
                ends = (high, low) if side[bound[k]] > 0 else (low, high)
                found.append(switch(path, i, max(first - 1, 0), min(last + 1, len(path.t) - 2), *ends))
    return found


def switch(path: ControlTrajectory, i: int, first: int, last: int, before: float, after: float) -> Switch:
    """The switch of control i within some intervals: its impulse there is that of a jump at the time sought."""
    r, steps = len(path.method.quadrature), np.diff(path.t)[first : last + 1]
    local = path.control.values[i].reshape(-1, r)[first : last + 1]
    means = local @ np.array(path.method.quadrature.weights)
    when = float(path.t[first] + steps @ (means - after) / (before - after))
    due = zero(path, i, path.control.times[first * r], path.control.times[last * r + r - 1])
    return Switch(when, float(path.t[np.argmin(np.abs(path.t - when))]), due if np.isfinite(due) else when)


def zero(path: ControlTrajectory, i: int, first: float, last: float) -> float:
    """Where the switching function of control i changes its sign; NaN if it does not."""
    for _ in range(ZOOMS):
        times = np.linspace(first, last, 33)
        values = switching_function(path, times)[i]
        changes = np.flatnonzero(values[1:] * values[:-1] <= 0)
        if len(changes) == 0:
            return np.nan
        first, last = times[changes[0]], times[changes[0] + 1]
        before, after = values[changes[0]], values[changes[0] + 1]
    return float(first + (last - first) * before / (before - after)) if before != after else float(first)


def better_mesh(path: ControlTrajectory, higher: ControlTrajectory, tol: float) -> np.ndarray:
    """Joints, in the time of the higher path, on which the error should be below the tolerance."""
    order, target, found = path.method.degree + 1, TARGET * tol, switches(higher)
    error = beyond_degree(higher, path.method.degree)
    error *= change_of_degree(path, higher) / max(np.max(error), 1e-300)
    kinked = (truncation(higher.path) > STUBBORN * truncation(path.path)) & (error > target)
    error[kinked] = target * (error[kinked] / target) ** (order / KINK_ORDER)
    outside = np.sqrt(excess(path))  # of the order of the distance to the nearest node, so of order 1
    error = np.maximum(error, target * (outside / target) ** order)
    for s in found:
        i = int(np.argmin(np.abs(higher.t - s.joint)))
        error[max(i - 1, 0) : i + 1] = target * max(abs(s.due - s.joint) / np.ptp(higher.t) / target, LEAST) ** order
    mesh = equidistributed(higher.t, error, order, tol, FINEST)
    for s in found:
        best = s.due if s.when == s.joint else s.when
        mesh[1 + np.argmin(np.abs(mesh[1:-1] - best))] = best
    return mesh
