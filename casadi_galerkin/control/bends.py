"""Controls that leave or meet a bound inside intervals: when, and an error indicator.

An optimal control minimizes the integrand I of the cost (see `solution.hamiltonian`) within its bounds.  Where I is
convex in u, Newton's method leads from `control(t)` to this minimizer.  If it is at a bound on a part of an interval
only, it bends there, and the quadrature sees this at its points alone.  Where a bend is nearer to a joint than the
first point, or in the middle of an interval, both degrees make the same error.  So the errors are estimated by how much
the integrals of all forces, and of I, along the minimizers differ from their quadratures.  With a joint at the bend
there is no error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadi_galerkin.calculus.nodes import lagrange_values
from casadi_galerkin.calculus.piecewise_polynomial import around
from casadi_galerkin.calculus.roundoff import or_one
from casadi_galerkin.functional.mapping import at_places
from casadi_galerkin.problems.bounds import AT_BOUND
from casadi_galerkin.solution.control_trajectory import ControlTrajectory

PARTS = np.union1d(around(np.array([0.0, 1.0])), np.linspace(0.0, 1.0, 33))  # where an interval is sampled
WIDTHS = np.convolve(np.diff(PARTS), [0.5, 0.5])  # weights of the trapezoidal rule there
STEPS, CONVERGED = 40, 1e-9  # most steps to a minimizer, and the relative step that ends them
ROUNDED = 1e-14  # relative change of I that may be rounding
FLAT = 1e-8  # curvature of I over those of the single controls, up to which it is not convex
# change of a control over the distance of its bounds, or over the largest control, from which it is not an error of the
# solver only: one that is off throughout is not
LEAST_MOTION = 1e-7
INTERPOLATED = 4  # values within the bounds from which the time is interpolated at which a control meets one


@np.errstate(invalid="ignore", divide="ignore")  # at an end, values may be infinite
def minimizers(path: ControlTrajectory) -> tuple[np.ndarray, np.ndarray]:
    """Controls that minimize I, the `integrand`, within their bounds, at `PARTS` of every interval.

    Each step is one of Newton's method for the controls that are not pushed against a bound, no longer than the bounds
    are apart, and halved where I does not fall.  Controls on which I depends linearly are left as they are: where they
    switch is known from `switching`.

    Returns
    -------
    the minimizers, and whether I is convex in the single control there; (n, N K) each
    """
    between = path.between_points
    times, x, v, u, *others = between.along(PARTS)
    low, high = (np.array(side)[:, None] for side in path.problem.control_bounds)
    best, share = np.clip(u, low, high), np.ones(len(times))
    found = at_places(between.integrand, times, x, v, best, *others)
    curved = np.einsum("iik->ik", found[3].reshape(len(u), len(u), -1)) > 0
    for _ in range(STEPS):
        _, _, slope, columns = found
        curvature = columns.reshape(len(u), len(u), -1)
        own = np.einsum("iik->ik", curvature)
        finite = np.isfinite(columns).all(axis=0) & np.isfinite(slope).all(axis=0)
        free = finite & (own > 0) & ((best > low) | (slope < 0)) & ((best < high) | (slope > 0))
        scale = np.where(free, 1 / np.sqrt(own), 0.0)
        scaled = np.where(free[:, None] & free, scale[:, None] * curvature * scale, 0.0)
        values, vectors = np.linalg.eigh(scaled.transpose(2, 0, 1))
        inverse = np.where(values > FLAT, 1 / values, 0.0)
        forces = np.where(free, -scale * slope, 0.0)
        steps = scale * np.einsum("kij,kj,klj,lk->ik", vectors, inverse, vectors, forces)
        longest = np.max(np.abs(steps) / (high - low), axis=0, initial=1.0)
        tried = np.clip(best + share / longest * steps, low, high)
        there = at_places(between.integrand, times, x, v, tried, *others)
        falls = there[0][0] <= found[0][0] + ROUNDED * np.abs(found[0][0])
        moved = np.abs(tried - best) > CONVERGED * np.abs(tried)
        found = [np.where(falls, new, old) for new, old in zip(there, found, strict=True)]
        best, share = np.where(falls, tried, best), np.where(falls, 1.0, share / 2)
        if not moved.any():
            break
    return np.where(curved, best, u), curved


def sides(u: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """1 where a minimizer (..., K) is at the upper bound, -1 where at the lower, else 0."""
    slack = AT_BOUND * np.max(np.abs(u), axis=-1, keepdims=True)
    return (u >= high - slack).astype(int) - (u <= low + slack)


@dataclass(frozen=True)
class Bend:
    """A time at which a control leaves or meets a bound.

    Attributes
    ----------
    when : its time
    control : the number of the control
    before, after : 1 where the control is at its upper bound, -1 at its lower, 0 between the two
    """

    when: float
    control: int
    before: int
    after: int


def bends(path: ControlTrajectory) -> list[Bend]:
    """The bends of all controls, those of one control after the other, in order."""
    bounds, found = np.array(path.problem.control_bounds), list[Bend]()
    if path.problem.hold or not np.isfinite(bounds).any():
        return found
    (best, curved), times = minimizers(path), path.polynomial.sampled(PARTS)[0]
    widths = np.ptp(bounds, axis=0)
    moving = np.ptp(best, axis=1) > LEAST_MOTION * np.where(np.isfinite(widths), widths, np.max(np.abs(best)))
    for i in np.flatnonzero(curved.all(axis=1) & moving).tolist():
        side = sides(best[i], *bounds[:, i])
        for k in np.flatnonzero(np.diff(side)).tolist():
            when = _bend(times, best[i], side, k, bounds[:, i])
            found.append(Bend(when, i, int(side[k]), int(side[k + 1])))
    return found


@np.errstate(invalid="ignore", divide="ignore")  # where a control is constant beside its bound
def _bend(times: np.ndarray, u: np.ndarray, side: np.ndarray, k: int, bounds: np.ndarray) -> float:
    """The time between two samples at which a control is at its bound, as a function of values within the bounds."""
    first, step = (k + 1, 1) if side[k] else (k, -1)
    within = first + step * np.arange(INTERPOLATED)
    within = within[within // len(PARTS) == first // len(PARTS)]  # on one interval
    within = within[np.logical_and.accumulate(side[within] == 0)]
    bound = bounds[int(np.max(side[k : k + 2]) > 0)]
    when = lagrange_values(u[within], np.array([bound]))[0] @ times[within] if len(within) > 1 else np.nan
    return float(np.clip(when, *times[k : k + 2]) if np.isfinite(when) else np.mean(times[k : k + 2]))


def bend_errors(path: ControlTrajectory) -> tuple[np.ndarray, np.ndarray]:
    """What the quadrature misses of the impulses (d, N), and of the cost (N,), on each interval where a control bends.

    Of a component that follows a rate the impulse is its change.
    """
    bounds, steps = np.array(path.problem.control_bounds), np.diff(path.t)
    if path.problem.hold or not np.isfinite(bounds).any():
        return np.zeros((len(path.x), len(steps))), np.zeros(len(steps))
    points = np.array(path.method.quadrature.points)
    samples = path.control.at(points), minimizers(path)[0]
    at_points, best = (u.reshape(len(u), len(steps), -1) for u in samples)
    parts, u = np.append(points, PARTS), np.dstack((at_points, best)).reshape(len(best), -1)
    between = path.between_points
    times, x, v, _, *others = between.along(parts)
    total = at_places(between.integrand, times, x, v, u, *others)[0].reshape(1, len(steps), -1)
    seen, values = np.split(np.vstack((between.motion(parts, u)[1], total)), [len(points)], axis=2)
    missed = values - seen @ lagrange_values(points, PARTS).T
    errors = np.where(np.isfinite(missed), missed, 0.0) @ WIDTHS * steps
    side = sides(best.reshape(len(best), -1), *bounds[:, :, None]).reshape(best.shape)
    errors[:, ~np.any(np.ptp(side, axis=2), axis=0)] = 0.0
    return errors[:-1], np.abs(errors[-1])


def carried(path: ControlTrajectory, impulses: np.ndarray) -> np.ndarray:
    """Largest change of the path, relative to its sizes, until every joint by impulses (d, N) on the intervals; (N,).

    It is that of a free motion, by p over v as mass.
    """
    d, pushed = path.problem.mechanical, np.cumsum(impulses, axis=1)
    speeds, momenta = (np.max(np.abs(values[:d]), axis=1) for values in (path(path.t, 1), path.between_points.momenta))
    moved, during = pushed.copy(), (pushed - impulses / 2)[:d] * np.diff(path.t)
    moved[:d] = np.cumsum(during, axis=1) * (speeds / or_one(momenta))[:, None]
    return np.max(np.abs(moved) / path.sizes[:, None], axis=0)
