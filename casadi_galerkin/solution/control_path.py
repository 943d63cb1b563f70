"""Controls as functions of time: polynomials between quadrature points, cut at their bounds.

They are one function of time, in numbers and as a CasADi expression: what is called, drawn, replayed and flown, and
what estimates of errors measure.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from operator import mul

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.nodes import barycentric_weights, lagrange_values
from casadi_galerkin.calculus.numbers import counted, read_only, spanned
from casadi_galerkin.calculus.piecewise_polynomial import times_at, times_within
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.calculus.roundoff import EPS, TINY

PARTS = 32  # of an interval, to see where a polynomial is cut
SAME_TIME = 4 * EPS  # rounding of the joint t_i + h q with q = 1, relative to the largest time


def finer_rule(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights that see the kinks of a cut polynomial through some points, and of smooth forces more."""
    rule = gauss(count + 2)
    points = (np.arange(PARTS)[:, None] + rule.points) / PARTS
    return points.ravel(), np.tile(rule.weights, PARTS) / PARTS


class ControlPath:
    """Controls, or multipliers of path constraints: on each interval the polynomial through values at the points.

    Where it exceeds a bound it is cut there.  A multiple of Π (s - q)² over the points q, which is zero at these, gives
    back what the cut takes from the mean: so the impulse of a switch inside the interval is kept, and a flight with
    these controls arrives where the path does, to second order.

    They may jump at joints.  At a joint the value is that of the interval after it; where the rule has a point at 1 and
    none at 0 (Radau), it is that of the interval before.  So times at the quadrature points give the values there.  A
    rule with both points (Lobatto) has two values at a joint, of which the later one is taken.

    Parameters
    ----------
    mesh : (N + 1,), the joints
    points : (k,), points of the values in the reference interval: the quadrature points, or one for held controls
    values : (n, N k), controls at these points in the order of time
    rule : (r,), quadrature points of the reference interval
    bounds : (lo, hi), n numbers each, or (n, N); multipliers have none

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> move = cg.ControlProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0], [0.0], [0.0],
    ...     force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u**2 / 2, controls=1)
    >>> control = cg.solve(move, cg.Galerkin(degree=3), intervals=4).control
    >>> control
    ControlPath of 1 component at 3 points in each of 4 intervals of [0, 1]
    >>> control([0.25, 1.0]).round(6).tolist()
    [[3.0, -6.0]]
    """

    def __init__(
        self,
        mesh: np.ndarray,
        points: np.ndarray,
        values: np.ndarray,
        rule: np.ndarray,
        bounds: ArrayLike = (-np.inf, np.inf),
    ) -> None:
        shape = len(mesh) - 1, len(values)
        sides = np.stack([np.broadcast_to(np.transpose(side), shape).T for side in np.asarray(bounds)])
        arrays = mesh, points, values, rule, sides
        self.mesh, self.points, self.values, self.rule, self.bounds = map(read_only, arrays)

    def __call__(self, t: ArrayLike) -> np.ndarray:
        """Controls at times t within the mesh; shape (n,) + t.shape."""
        times = times_within(self.mesh, t)
        flat = times.ravel()
        steps = np.diff(self.mesh)
        i = np.searchsorted(self._changes, flat, side="right")
        basis = lagrange_values(self.points, np.clip((flat - self.mesh[i]) / steps[i], 0.0, 1.0))
        s = (flat - self.mesh[i]) / steps[i]
        values = np.einsum("nkj,kj->nk", self._local[:, i], basis) + self._bumps[:, i] * self._bump(s)
        return np.clip(values, *self.bounds[:, :, i]).reshape((len(self.values), *times.shape))

    def __repr__(self) -> str:
        """State the numbers of components, points and intervals."""
        size, points = counted(len(self.values), "component"), counted(len(self.points), "point")
        intervals = counted(len(self.mesh) - 1, "interval")
        return f"ControlPath of {size} at {points} in each of {intervals} of {spanned(self.mesh)}"

    @property
    def times(self) -> np.ndarray:
        """Times of the values, (N k,)."""
        return times_at(self.mesh, self.points)

    def at(self, s: np.ndarray) -> np.ndarray:
        """Controls at fractions s (K,) of every interval, by its own polynomial, joints included; (n, N K)."""
        values = self._local @ lagrange_values(self.points, s).T + self._bumps[:, :, None] * self._bump(s)
        return np.clip(values, *self.bounds[..., None]).reshape(len(self.values), (len(self.mesh) - 1) * len(s))

    def _bump(self, s: np.ndarray) -> np.ndarray:
        """A polynomial of fractions s that is zero at the points, and positive elsewhere."""
        return np.prod((s[:, None] - self.points) ** 2, axis=1)

    @cached_property
    def _bumps(self) -> np.ndarray:
        """Bumps added to the polynomials before they are cut, so that their means stay; (n, N).

        The mean of c bumps, cut where they lead to a bound, is linear in c between the places where a sample meets one.
        """
        points, weights = finer_rule(len(self.points))
        u, bump = self._local @ lagrange_values(self.points, points).T, self._bump(points) + TINY
        room, bumps = (self.bounds[..., None] - u) / bump, np.zeros(u.shape[:2])
        share = weights * bump
        for k, i in np.argwhere(np.any((room[0] > 0) | (room[1] < 0), axis=2)):
            low, high = room[:, k, i]
            places, slopes = np.append(low, high), np.append(share, -share)
            met = np.argsort(places)[np.isneginf(low).sum() : 2 * len(low) - np.isposinf(high).sum()]
            places, slopes = places[met], np.cumsum(slopes[met]) + share @ np.isneginf(low)
            mean = np.clip(places[0], low, high) @ share + np.append(0.0, np.cumsum(slopes[:-1] * np.diff(places)))
            bumps[k, i] = np.interp(0.0, mean, places)
        return bumps

    @property
    def _local(self) -> np.ndarray:
        """Values at the points of every interval, (n, N, k)."""
        return self.values.reshape(len(self.values), len(self.mesh) - 1, len(self.points))

    @property
    def _changes(self) -> np.ndarray:
        """Times from which the next interval's polynomial holds, (N - 1,)."""
        before = self.rule[-1] == 1 and self.rule[0] > 0
        return self.mesh[1:-1] + (SAME_TIME * np.max(np.abs(self.mesh)) if before else 0.0)

    def expression(self, t: ca.SX) -> ca.SX:
        """The same as a casadi.SX of a scalar t, (n,), in Lagrange form with values that switch at joints."""
        changes = self._changes.tolist()

        def switched(values: np.ndarray) -> ca.SX:
            return ca.SX(values[0]) if np.all(values == values[0]) else ca.pw_const(t, changes, values.tolist())

        s = (t - switched(self.mesh[:-1])) / switched(np.diff(self.mesh))
        gaps = [s - point for point in self.points.tolist()]
        before, after = (list(accumulate(some, initial=ca.SX(1), func=mul)) for some in (gaps[:-1], gaps[:0:-1]))
        basis = barycentric_weights(self.points) * ca.vertcat(*map(mul, before, reversed(after)))
        u = ca.vertcat(*(ca.dot(ca.vertcat(*map(switched, rows.T)), basis) for rows in self._local)) / ca.sum1(basis)
        u += ca.vertcat(*map(switched, self._bumps)) * ca.sumsqr(before[-1] * gaps[-1])
        low, high = (ca.vertcat(*map(switched, side)) for side in self.bounds)
        return ca.fmin(ca.fmax(u, low), high)


def side_by_side(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Arrays (rows, columns, ...) one after the other; rows that some have not are NaN."""
    rows = max(map(len, arrays))
    return np.concatenate([np.concatenate((a, np.full((rows - len(a), *a.shape[1:]), np.nan))) for a in arrays], axis=1)


def joined_controls(parts: Sequence[ControlPath]) -> ControlPath:
    """Controls, or multipliers, of several phases as one function of time; what some have not is NaN."""
    points, rule = max((part.points for part in parts), key=len), parts[0].rule
    mesh = np.append(np.concatenate([part.mesh[:-1] for part in parts]), parts[-1].mesh[-1])
    values = [part.values if len(part.points) == len(points) else part.at(points) for part in parts]  # held ones
    bounds = np.stack([side_by_side([part.bounds[k] for part in parts]) for k in (0, 1)])
    return ControlPath(mesh, points, side_by_side(values), rule, bounds)
