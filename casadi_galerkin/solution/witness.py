"""Three witnesses of a path that are not among the equations it solves, nor among the points of its error estimate.

The balance of energy.  Along a true path the energy E = p·v - L changes by what L depends on time,

    E(t_{i+1}) - E(t_i) = -∫ ∂L/∂t dt        on every interval,

with p at the joints from the discrete Legendre transform.  A discrete path keeps it to the order of its error.  It does
not where L has a kink that no joint meets, or where the mesh is too coarse to be believed.

The Lagrangian between points.  Along a path that its mesh resolves, L is nearly a polynomial on every interval: the
one through its values at m + 1 points tells those at others.  Over a pole it is not.  There the path is alike on every
scale and misses the same part of L's own size on any mesh, though energies on both sides may agree, and the action may
converge.  So this part is accepted or not, whatever the tolerance.

Jumps of the force.  Along the path f(t) = F(t, x̄, dx̄/dt) is smooth where F is.  A jump may change the momentum by what
it does to ∫ f dt (`shares_of_time`).
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.nodes import differentiation_matrix, lagrange_values
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, times_at
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.calculus.roundoff import EPS, TINY, component_sizes
from casadi_galerkin.functional.buffers import Evaluator
from casadi_galerkin.functional.mapping import one_by_one
from casadi_galerkin.functional.pointwise import pointwise
from casadi_galerkin.problems.callables import with_parameters
from casadi_galerkin.problems.constrained_motion import work_of_constraint
from casadi_galerkin.problems.problem import Problem
from casadi_galerkin.solution.shares_of_time import SharesOfTime

BALANCE = 0.3  # part of the tolerance by which the energy may be missed; smooth paths were measured below 0.25
RESOLVED = 0.05  # part of L's size by which it may be missed between points; poles miss more at all degrees to 14
JUMPS = 0.1  # part of the tolerance by which jumps of a force may change a momentum
BLURRED = 10.0  # floors up to which rounding may move a value: what is missed by less tells nothing


def missed_balance(kept: np.ndarray, scale: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """By how much every interval misses the balance of energy, over its scale; (N,), infinite where it is undefined.

    Any two joints are compared, relative to the larger of their scales: near a singularity energies are large, and
    what goes wrong there shows between its two sides.  The worst difference is shared out among all intervals by
    what changes there.

    Parameters
    ----------
    kept : (N + 1,), E + ∫ ∂L/∂t dt, the same at all joints of a true path
    scale : (N + 1,), what `kept` is measured by: |p·v| + |E| + |v|ᵀ|∂²L/∂v²||v|, no less than its mean over time
    floor : (N + 1,), what rounding may have done to `kept`, which is no miss
    """
    if not np.all(np.isfinite(kept)):
        return np.where(np.isfinite(kept[1:] + kept[:-1]), 0.0, np.inf)
    order = np.argsort(scale)
    least, most = (kept - floor)[order], (kept + floor)[order]
    gaps = np.maximum(np.maximum.accumulate(least) - most, least - np.minimum.accumulate(most))
    change = np.abs(np.diff(kept))
    return max(float(np.max(gaps / scale[order])), 0.0) * change / max(float(np.max(change)), TINY)


def witnesses(problem: Problem, path: PiecewisePolynomial, momentum: np.ndarray) -> dict[str, np.ndarray]:
    """What each witness says against a path, in parts of what is accepted of it; arguments as for `doubts`."""
    balance, unresolved, jumps = doubts(problem, path, momentum)
    return {"balance of energy": balance / BALANCE, "Lagrangian between points": unresolved, "force": jumps / JUMPS}


def doubts(problem: Problem, path: PiecewisePolynomial, momentum: np.ndarray) -> tuple[np.ndarray, ...]:
    """How far the balance of energy, and L between points, are missed, and jumps of the force; (N,) each.

    They are relative to the sizes of their terms, the first two beyond what rounding of the path does to them.  The
    balance is drawn up between breakpoints: at a step of L in time the energy jumps.  Of L nothing is said where it is
    resolved.

    Parameters
    ----------
    problem : Problem
    path : PiecewisePolynomial of degree m
    momentum : (d, N + 1), at the joints
    """
    joints = [0, *np.searchsorted(path.mesh, problem.breakpoints), len(path.mesh) - 1]
    parts = [_between_breakpoints(problem, path.between(i, j), momentum[:, i : j + 1]) for i, j in pairwise(joints)]
    balance, unresolved = (np.concatenate(values) for values in zip(*parts, strict=True))
    return balance, unresolved, _jumps_of_force(problem, path, momentum)


@lru_cache(8)
def _force_along(force: ca.Function) -> ca.Function:
    """(t, x, v, a) -> F, and its derivative with time at an acceleration a; (d,) each."""
    t, x, v = force.sx_in()
    a, value = ca.SX.sym("a", x.numel()), force(t, x, v)
    rate = ca.jacobian(value, t) + ca.mtimes(ca.jacobian(value, x), v) + ca.mtimes(ca.jacobian(value, v), a)
    return ca.Function("along", [t, x, v, a], [ca.densify(value), ca.densify(rate)])


def _jumps_of_force(problem: Problem, path: PiecewisePolynomial, momentum: np.ndarray) -> np.ndarray:
    """By how much jumps of the force on every interval may change a momentum, over that and all impulses; (N,)."""
    if problem.force is None:
        return np.zeros(len(path.mesh) - 1)
    shares, slopes = SharesOfTime(path.mesh, gauss(path.degree)), differentiation_matrix(path.nodes)
    local, steps = path.local, np.diff(path.mesh)
    bends = lagrange_values(path.nodes, shares.parts) @ slopes @ slopes
    accelerations = (local - local[:, :, :1]) @ bends.T / steps[:, None] ** 2
    along = _force_along(with_parameters(problem.force, problem.parameters))
    given = [values.reshape(len(values), -1) for values in (*path.at_parts(shares.parts), accelerations)]
    forces, rates = (np.array(a) for a in along.map(len(shares.times))(shares.times[None, :], *given))
    sizes = np.where(np.isfinite(forces), np.abs(forces), 0.0)
    means = sizes.reshape(len(local), len(steps), -1).mean(axis=2)
    whole = np.max(np.abs(momentum), axis=1) + means @ steps
    return np.asarray(np.max(shares.by_jumps(forces, rates) / np.maximum(whole, TINY)[:, None], axis=0))


@lru_cache(64)
def _rules(degree: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parts of an interval, its ends before the points of Gauss's rules with m + 1 and m; weights of the first rule.

    And the matrix from values at the first rule's points to those of their polynomial at all parts.
    """
    finer = gauss(degree + 1)
    parts = np.array([0.0, 1.0, *finer.points, *gauss(degree).points])
    return parts, np.array(finer.weights), lagrange_values(np.array(finer.points), parts)


@np.errstate(invalid="ignore")  # of an infinite L
def _between_breakpoints(
    problem: Problem, path: PiecewisePolynomial, momentum: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same without breakpoints."""
    terms, steps = pointwise(problem.lagrangian, problem.force), np.diff(path.mesh)
    parts, weights, between = _rules(path.degree)
    x, v = (values.reshape(len(values), -1) for values in path.at_parts(parts))
    h = np.repeat(steps, len(parts))
    through = slice(2, 2 + len(weights))
    joints = np.append(np.arange(0, len(h), len(parts)), len(h) - len(parts) + 1)  # all starts, and the last end
    inside = np.nextafter(path.mesh[[0, -1]], path.mesh[[-1, 0]])  # after a step at the start, before one at the end
    times = np.clip(times_at(path.mesh, parts), *inside)
    given = [times, h, x.ravel(order="F"), (v * h).ravel(order="F")]
    given += [] if problem.parameters is None else [np.array(problem.parameters)]

    def evaluate(function: ca.Function) -> list[np.ndarray]:
        """Its values at all parts of all intervals, (N (2m + 3), ...)."""
        found = Evaluator(one_by_one(function, len(h), () if problem.parameters is None else (4,)))(*given)
        return [value.reshape(len(h), -1) for value in found]

    def integral(values: np.ndarray) -> np.ndarray:
        """∫ over every interval, (N,)."""
        return np.asarray(values.reshape(len(steps), -1)[:, through] @ weights)

    lagrangian, work, slope, *blocks = evaluate(terms.derivatives)
    of_steps, velocity = h[joints], v[:, joints]
    mass, kinetic = terms.mass([of_steps * block[joints].T for block in blocks]), np.sum(momentum * velocity, axis=0)
    energy = kinetic - lagrangian[joints, 0] / of_steps + _correction(mass, momentum - slope[joints].T)
    supplied = steps * integral(work_of_constraint(problem, times, x, v))
    speed, sizes, duration = np.abs(velocity), component_sizes(path.values), float(np.sum(steps))
    pushed = np.einsum("tij,jt->it", np.abs(mass), speed)
    local = np.abs(kinetic) + np.abs(energy) + np.sum(speed * pushed, axis=0)  # p·v may be a small difference of terms
    least = EPS * np.max(np.einsum("i,tij,j->t", sizes, np.abs(mass), sizes)) / duration**2  # where a path is at rest
    mean = max(float(steps @ (local[1:] + local[:-1])) / 2 / duration, float(least), TINY)
    scale = np.maximum(local, mean)
    sum_of_slopes = np.abs(differentiation_matrix(path.nodes)[0]).sum()  # what rounding of values does to x'
    before = np.maximum(np.arange(len(joints)) - 1, 0)  # a momentum is that of the interval before its joint
    places = np.max(np.abs(path.local), axis=2)[:, before]  # the nearer to zero, the less are positions rounded
    blurred = sum_of_slopes * np.sum(places * pushed, axis=0) / steps[before]
    pulled = np.sum(np.abs(x[:, joints] * work[joints].T), axis=0) / of_steps
    floor = BLURRED * EPS * (blurred + pulled + scale)
    if terms.supplied is not None:
        falls, by_both = evaluate(terms.supplied)
        supplied += integral(falls)
        slopes = np.abs(v * h) + sum_of_slopes * np.repeat(np.max(np.abs(path.local), axis=2), len(parts), axis=1)
        rounded = np.abs(by_both) * np.concatenate((np.abs(x), slopes)).T  # the terms of a force may cancel
        floor += BLURRED * EPS * np.append(0.0, np.cumsum(integral(np.sum(rounded, axis=1))))
    missed = missed_balance(energy + np.append(0.0, np.cumsum(supplied)), scale, floor)
    values = lagrangian.reshape(len(steps), -1) / steps[:, None]
    size = np.maximum(np.max(np.abs(values), axis=1), np.maximum(scale[1:], scale[:-1]))
    difference = np.max(np.abs(values - values[:, through] @ between.T), axis=1) - np.maximum(floor[1:], floor[:-1])
    unresolved = np.where(np.isfinite(size), difference / size, np.inf)
    return missed, np.where(unresolved > RESOLVED, unresolved, 0.0)


def _correction(mass: np.ndarray, missing: np.ndarray) -> np.ndarray:
    """δᵀ(∂²L/∂v²)⁻¹δ/2, which the energy of a momentum p has beyond p·v - L up to terms of third order; (K,).

    Parameters
    ----------
    mass : (K, d, d), ∂²L/∂v²
    missing : (d, K), δ = p - ∂L/∂v at the path's own slope v
    """
    values, vectors = np.linalg.eigh(mass)
    regular = np.abs(values) > EPS * np.max(np.abs(values), axis=1, keepdims=True) + TINY
    inverse = np.divide(1.0, values, out=np.zeros_like(values), where=regular)
    roots = np.einsum("it,tij->tj", missing, vectors) * np.sqrt(np.abs(inverse))  # squares of momenta may overflow
    return np.asarray(np.sum(np.sign(values) * roots**2, axis=1) / 2)
