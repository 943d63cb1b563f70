"""Three error indicators that depend neither on the equations of a path nor on the points of its error estimate.

The balance of energy.  Along a true path the energy E = p·v - L changes only by the work of a force F, as L depends on
time, and as a constraint g with multipliers λ moves,

    E(t_{i+1}) - E(t_i) = ∫ (F·v - ∂L/∂t - λ·∂g/∂t) dt        on every interval,

with p at the joints from the discrete Legendre transform.  A discrete path satisfies it up to the order of its error.
It does not where L has a kink inside an interval, or where the mesh is far too coarse.  In short intervals, whose
energies are rounded, the work tells where the kink is: it depends on the quadrature.  Where L jumps in time, or is
singular at an end, energies differ on any mesh.  So an interval counts by no more than all that acts within it may move
the path (`_most_change`), and where the energy changes by more, it is balanced before and after the interval.  Where L
steps in x, as at an edge, the impulse is in no equation, and energies on both sides must agree.

The Lagrangian between points.  Along a path that its mesh resolves, L is nearly a polynomial on every interval, and the
polynomial through its values at m + 1 points predicts the others.  At a pole it does not.  There the path is
self-similar, and the misfit is the same part of L on any mesh, although the energies on both sides may agree, and the
action may converge.  So the accepted misfit does not depend on the tolerance.

Jumps of the force.  Along the path f(t) = F(t, x̄, dx̄/dt) is smooth where F is.  A jump may change the momentum by as
much as it changes ∫ f dt (`jump_detection`).
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.discrete_calculus import NEAREST
from casadi_galerkin.calculus.nodes import differentiation_matrix, lagrange_values
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.calculus.roundoff import EPS, TINY, or_one
from casadi_galerkin.functional.pointwise import at_places, pointwise
from casadi_galerkin.problems.callables import depends_on_time
from casadi_galerkin.problems.constrained_motion import tangent_momenta, work_of_constraint
from casadi_galerkin.problems.legendre_transform import scaled_masses
from casadi_galerkin.problems.problem import Problem
from casadi_galerkin.solution.jump_detection import JumpDetector

# the indicators by name, with the fraction of the tolerance that each may have: energy imbalances of smooth paths were
# measured below 0.25
FRACTIONS = {"balance of energy": 0.3, "Lagrangian between points": 1.0, "force": 0.1}
# accepted misfit of L between points, over its size; at a pole it is larger, at all degrees to 14
LAGRANGIAN_MISFIT = 0.05
STEP_RATIO = 2.0  # change along an interval, over what derivatives explain, above which L or ∂L/∂x steps there
# how far places reach beyond a joint, over the distance of the nearest quadrature point from it
REACH_BEYOND_JOINTS = 1e-3
ROUNDING_FACTOR = 10.0  # factor on roundoff floors: an imbalance below it may be rounding alone


def energy_imbalance(
    conserved: np.ndarray, scale: np.ndarray, floor: np.ndarray, misfit: np.ndarray | float = 0.0
) -> np.ndarray:
    """Relative violation of the balance of energy, distributed to the intervals; (N,), infinite where it is undefined.

    All pairs of joints are compared, relative to the larger of their scales: near a singularity energies are large, and
    an error there shows in the energies on its two sides.  The largest difference is distributed to the intervals in
    proportion to the changes on them or, where these are within roundoff, to a misfit of the work.

    Parameters
    ----------
    conserved : (N + 1,), E - ∫ (F·v - ∂L/∂t - λ·∂g/∂t) dt, the same at all joints of a true path
    scale : (N + 1,), sizes of the terms of `conserved`: |p·v| + |E| + |v|ᵀ|∂²L/∂v²||v|, at least their mean over time
    floor : (N + 1,), roundoff of `conserved`, which is not counted
    misfit : (N,), how far the work on an interval depends on the points of its quadrature
    """
    if not np.all(np.isfinite(conserved)):
        return np.where(np.isfinite(conserved[1:] + conserved[:-1]), 0.0, np.inf)
    order = np.argsort(scale)
    least, most = (conserved - floor)[order], (conserved + floor)[order]
    gaps = np.maximum(np.maximum.accumulate(least) - most, least - np.minimum.accumulate(most))
    change = np.maximum(np.abs(np.diff(conserved)) - floor[1:] - floor[:-1], misfit + TINY)
    return max(float(np.max(gaps / scale[order])), 0.0) * change / np.max(change)


def error_indicators(problem: Problem, path: PiecewisePolynomial, momentum: np.ndarray) -> tuple[np.ndarray, ...]:
    """Energy imbalance, misfit of L between points, and effect of jumps of the force, on each interval; (N,) each.

    They are relative to the sizes of their terms, and roundoff is subtracted.  The balance is that
    between breakpoints, because the energy jumps where L jumps in time.  A misfit of L below `LAGRANGIAN_MISFIT` is set
    to zero.

    Parameters
    ----------
    problem : Problem
    path : PiecewisePolynomial of degree m
    momentum : (d, N + 1), at the joints
    """
    joints = [0, *np.searchsorted(path.mesh, problem.breakpoints), len(path.mesh) - 1]
    parts = [_between_breakpoints(problem, path.between(i, j), momentum[:, i : j + 1]) for i, j in pairwise(joints)]
    balance, unresolved, inertias = zip(*parts, strict=True)
    moving = np.max(inertias, axis=0) @ path.sizes / np.ptp(path.mesh)
    return np.concatenate(balance), np.concatenate(unresolved), _jumps_of_force(problem, path, momentum, moving)


def _at_places(problem: Problem, function: ca.Function, *given: np.ndarray) -> list[np.ndarray]:
    """Values of a Function at K places, (K, ...) each; its last input is that of the parameters, if there are some."""
    shared = [] if problem.parameters is None else [problem.parameters]
    return [values.T for values in at_places(function, *given, shared=shared)]


@lru_cache(8)
def _force_along(force: ca.Function) -> ca.Function:
    """(t, x, v, a, w[, p]) -> F, dF/dt at an acceleration a, and |∂F/∂x||x| + |∂F/∂v| w; (d,) each."""
    t, x, v, *p = force.sx_in()
    a, w, value = ca.SX.sym("a", x.numel()), ca.SX.sym("w", x.numel()), force(t, x, v, *p)
    rate = ca.jtimes(value, ca.vertcat(t, x, v), ca.vertcat(1, v, a))
    changes = ca.mtimes(ca.fabs(ca.jacobian(value, ca.vertcat(x, v))), ca.vertcat(ca.fabs(x), w))
    return ca.Function("along", [t, x, v, a, w, *p], [ca.densify(output) for output in (value, rate, changes)])


def _jumps_of_force(
    problem: Problem, path: PiecewisePolynomial, momentum: np.ndarray, moving: np.ndarray
) -> np.ndarray:
    """Changes of a momentum by jumps of the force on every interval, relative to momentum and impulses; (N,).

    Also relative to `moving`, (d,), momenta that move the path by its sizes: those of a path at rest are only roundoff.
    """
    if problem.force is None:
        return np.zeros(len(path.mesh) - 1)
    detector, steps = JumpDetector(path.mesh, gauss(path.degree)), np.diff(path.mesh)
    rounding_effect = _rounding(tuple(path.nodes.tolist())) * np.max(np.abs(path.local), axis=2) / steps
    given = *(path(detector.times, nu) for nu in range(3)), np.repeat(rounding_effect, len(detector.parts), axis=1)
    along = _at_places(problem, _force_along(problem.force), detector.times, *given)
    forces, rates, rounded = (a.T for a in along)
    sizes = np.where(np.isfinite(forces), np.abs(forces), 0.0)
    means = sizes.reshape(len(sizes), len(steps), -1).mean(axis=2)
    whole = np.max(np.abs(momentum), axis=1) + means @ steps + moving + TINY
    effects = detector.jump_effects(forces, rates, ROUNDING_FACTOR * EPS * rounded)
    return np.max(effects / whole[:, None], axis=0)


@lru_cache(64)
def _rules(degree: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parts of an interval, its ends before the points of Gauss's rules with m + 1 and m; weights of the first rule.

    Also the matrix from values at the first rule's points to those of their polynomial at all parts.
    """
    finer = gauss(degree + 1)
    parts = np.array([0.0, 1.0, *finer.points, *gauss(degree).points])
    return parts, np.array(finer.weights), lagrange_values(np.array(finer.points), parts)


@lru_cache(64)
def _rounding(nodes: tuple[float, ...]) -> float:
    """Largest change of the derivative of a polynomial on [0, 1] over the rounding errors of its node values."""
    return float(np.abs(differentiation_matrix(np.array(nodes))[0]).sum())


class _Sampled:
    """A path between two breakpoints, with L̂ and its derivatives at the same K places on each of its N intervals.

    Attributes
    ----------
    steps, h : steps (N,), and the same repeated for all places (N K,)
    x, v, times : positions and velocities (d, N K), and times (N K,)
    joints : numbers of the joints among the places, (N + 1,)
    pointwise : Pointwise, L̂ and its derivatives at one point
    between : (K, points), matrix from values at the quadrature points to those of their polynomial at the places
    """

    def __init__(self, problem: Problem, path: PiecewisePolynomial) -> None:
        self.problem, self.path, self.steps = problem, path, path.mesh[1:] - path.mesh[:-1]
        parts, self._weights, self.between = _rules(path.degree)
        times, self.x, self.v = path.sampled(parts)
        self.h = np.repeat(self.steps, len(parts))
        self.joints = np.append(np.arange(0, len(self.h), len(parts)), len(self.h) - len(parts) + 1)  # the last end
        first, last = path.mesh[[0, -1]]  # a step of L at either end, which L may round, is outside all times
        within = NEAREST * max(abs(first), abs(last))
        self.times = np.clip(times, first + within, last - within)
        self.pointwise = pointwise(problem.lagrangian, problem.force)

    @cached_property
    def derivatives(self) -> list[np.ndarray]:
        """Outputs of `pointwise.derivatives`: L̂, its derivatives by x and x', and blocks of its Hessian, (N K, ...)."""
        return self.evaluate(self.pointwise.derivatives)

    @cached_property
    def masses(self) -> np.ndarray:
        """∂²L/∂v² at the joints, (N + 1, d, d)."""
        return self.h[self.joints, None, None] * self.pointwise.matrices(self.derivatives[-1][self.joints])

    def evaluate(self, function: ca.Function) -> list[np.ndarray]:
        """Values of a Function of the arguments of L̂ at all places, (N K, ...) each."""
        return _at_places(self.problem, function, self.times, self.h, self.x, self.v * self.h)

    def in_place(self, function: ca.Function, varied: int) -> list[np.ndarray]:
        """Values of a Function of the arguments of L̂ where only x or only x' varies on an interval; (5 N K, ...) each.

        It varies a little beyond the joints between two intervals.  Time, and x' or x, are those of both
        joints and of the first, a middle and the last quadrature point: what moves may be crossed at any of them.

        Parameters
        ----------
        varied : 0 for x, 1 for x'
        """
        numbers, both = np.arange(len(self.h)).reshape(len(self.steps), -1), (self.x, self.v * self.h)
        beyond, last = both[varied].reshape(len(self.x), *numbers.shape).copy(), 1 + len(self._weights)
        for joint, inside, inner in ((0, 2, slice(1, None)), (1, last, slice(-1))):  # a joint may be where L steps
            beyond[:, inner, joint] += REACH_BEYOND_JOINTS * (beyond[:, inner, joint] - beyond[:, inner, inside])
        fixed = np.repeat(numbers[:, [0, 2, 2 + len(self._weights) // 2, last, 1]].T, numbers.shape[1])
        place = [values[:, fixed] for values in both]
        place[varied] = np.tile(beyond.reshape(len(self.x), -1), 5)
        return _at_places(self.problem, function, self.times[fixed], self.h[fixed], *place)

    def unexplained(self, varied: int, values: np.ndarray, derivatives: np.ndarray, terms: np.ndarray) -> np.ndarray:
        """Whether any of k values `in_place` changes along an interval by more than its derivatives tell; (N,).

        Parameters
        ----------
        varied : 0 where x has varied, 1 where x' has
        values : (5 N K, k)
        derivatives : by what has varied, (5 N K, k, d)
        terms : sizes of the terms that are summed up to the values, (5 N K, k)
        """
        count = len(self.steps)
        moved = np.ptp((self.x, self.v * self.h)[varied].reshape(len(self.x), count, -1), axis=2).T
        values = values.reshape(5, count, -1, values.shape[1])
        steepest = np.max(np.abs(derivatives).reshape(*values.shape, -1), axis=2)
        rounded = ROUNDING_FACTOR * EPS * np.max(np.abs(terms).reshape(values.shape), axis=2)
        explained = STEP_RATIO * np.einsum("jnkd,nd->jnk", steepest, moved) + rounded
        return np.any(np.ptp(values, axis=2) > explained, axis=(0, 2))

    def by_interval(self, values: np.ndarray) -> np.ndarray:
        """Values at all places, those of an interval in a row; (N, K)."""
        return values.reshape(len(self.steps), -1)

    def at_points(self, values: np.ndarray) -> np.ndarray:
        """Values at the quadrature points only; (N, points)."""
        return self.by_interval(values)[:, 2 : 2 + len(self._weights)]

    def misfit(self, values: np.ndarray) -> np.ndarray:
        """Distance of values at all places from the polynomial through those at the quadrature points; (N, K)."""
        return np.abs(self.by_interval(values) - self.at_points(values) @ self.between.T)

    def integral(self, values: np.ndarray) -> np.ndarray:
        """Integral over every interval, scaled to length 1; (N,)."""
        return self.at_points(values) @ self._weights


@np.errstate(invalid="ignore")  # L may be infinite
def _between_breakpoints(
    problem: Problem, path: PiecewisePolynomial, momentum: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energy imbalance and misfit of L, see `error_indicators`, of a path without breakpoints, and largest masses."""
    sampled = _Sampled(problem, path)
    if depends_on_time(problem.constraint):  # where it moves in another way from a breakpoint on, it pushes there
        place = sampled.times[sampled.joints], sampled.x[:, sampled.joints]
        momentum = tangent_momenta(problem, *place, momentum, sampled.v[:, sampled.joints])
    conserved, scale, floor, misfit = _energies(sampled, momentum)
    masses = np.max(np.where(np.isfinite(sampled.masses), np.abs(sampled.masses), 0.0), axis=0)
    gained, size, rounded = np.abs(np.diff(conserved)), np.minimum(scale[1:], scale[:-1]), floor[1:] + floor[:-1]
    unresolved, most = _unresolved(sampled, scale, floor), _most_change(sampled)
    jumps = (gained > most * size + rounded) | (unresolved > most)
    if np.any(jumps):
        # where L steps in x, CasADi's derivative is zero, and its impulse in no equation; a force is not in L
        values, slopes, _ = sampled.in_place(pointwise(problem.lagrangian, None).first, varied=0)
        jumps &= ~sampled.unexplained(0, values, slopes[:, None, :], values)
    balance = np.where(jumps, most, 0.0)
    for part in np.split(np.arange(len(scale)), np.flatnonzero(jumps) + 1):
        if len(part) > 1:
            balance[part[:-1]] = energy_imbalance(conserved[part], scale[part], floor[part], misfit[part[:-1]])
    return balance, np.minimum(unresolved, most), masses


def _most_change(at: _Sampled) -> np.ndarray:
    """How far all that acts within an interval may move the path, relative to its sizes; (N,).

    A step of L in time, or a kink, wherever it is in the interval, moves the path by no more than the interval's
    displacement, or by what its whole impulse moves in the duration.  At a pole the impulse grows as the interval
    shrinks.  Under a constraint, whose forces are not in L, nothing bounds the change.
    """
    if at.problem.constraint is not None:
        return np.full(len(at.steps), np.inf)
    inertia = np.abs(at.masses) @ at.path.sizes / np.sum(at.steps)  # momenta that move the path by its sizes
    moved, pushed = (
        np.max(np.abs(values).reshape(len(at.steps), -1, len(at.x))[:, 2:], axis=1)  # an end may be a singular time
        for values in ((at.v * at.h).T, at.derivatives[1])
    )
    change = np.max(moved / at.path.sizes + pushed / (np.fmin(inertia[1:], inertia[:-1]) + TINY), axis=1)
    return np.where(np.isfinite(change), change, np.inf)


@np.errstate(invalid="ignore")  # L may be infinite
def kinks_in_place(problem: Problem, path: PiecewisePolynomial) -> np.ndarray:
    """Whether ∂L/∂x, with a force added, steps in x or v on an interval, as that of |x| and dry friction do; (N,).

    The path may then be right.  But its second variation, and its derivatives by ends and parameters, contain the
    impulse of a step of the force by a change of the path, which is in no Hessian.
    """
    at, d, found = _Sampled(problem, path), len(path.values), np.zeros(len(path.mesh) - 1, dtype=bool)
    for varied in (0, 1):
        lagrangian, slopes, momenta, *blocks = at.in_place(at.pointwise.derivatives, varied)
        entries = dict(zip(at.pointwise.blocks, blocks, strict=True)).get((0, varied))
        changes = np.zeros((len(slopes), d, d)) if entries is None else at.pointwise.matrices(entries)
        energies = np.abs(lagrangian) + np.abs(momenta) @ np.max(np.abs(at.v * at.h), axis=1, keepdims=True)
        terms = np.abs(slopes) + energies / or_one(path.sizes)  # these may cancel, as where x is an angle
        found |= at.unexplained(varied, slopes, changes, terms)
    return found


def _energies(at: _Sampled, momentum: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The arguments of `energy_imbalance`, at all joints."""
    h, v, (lagrangian, work, slope, *_) = at.h[at.joints], at.v[:, at.joints], at.derivatives
    kinetic, speed, sizes, masses = np.sum(momentum * v, axis=0), np.abs(v), at.path.sizes, np.abs(at.masses)
    missing, rounded = momentum - slope[at.joints].T, EPS * np.max(np.abs(momentum), axis=1, keepdims=True)
    missing[np.abs(missing) <= ROUNDING_FACTOR * rounded] = 0.0  # over a mass that vanishes it would not be small
    energy = kinetic - lagrangian[at.joints, 0] / h + _correction(at.masses, missing)

    pushed, duration = np.einsum("tij,jt->it", masses, speed), float(np.sum(at.steps))
    local = np.abs(kinetic) + np.abs(energy) + np.sum(speed * pushed, axis=0)  # the terms of p·v may cancel
    at_rest = EPS * np.max(masses @ sizes @ sizes) / duration**2
    mean = float(at.steps @ (local[1:] + local[:-1])) / 2 / duration
    scale = np.maximum(local, max(mean, float(at_rest), TINY))

    places = np.max(np.abs(at.path.local), axis=2)  # largest value on an interval, which determines its roundoff
    rounding = _rounding(tuple(at.path.nodes.tolist()))
    before = np.maximum(np.arange(len(at.joints)) - 1, 0)  # a momentum belongs to the interval before its joint
    rounding_effect = rounding * np.sum(places[:, before] * pushed, axis=0) / at.steps[before]
    pulled = np.sum(np.abs(at.x[:, at.joints] * work[at.joints].T), axis=0) / h
    floor = ROUNDING_FACTOR * EPS * (rounding_effect + pulled + scale)

    by_constraint = work_of_constraint(at.problem, at.times, at.x, at.v)
    supplied, power = at.steps * at.integral(by_constraint), np.sum(work * at.v.T, axis=1)
    if at.pointwise.supplied is not None:
        falls, by_both = at.evaluate(at.pointwise.supplied)
        supplied += at.integral(falls)
        power += falls[:, 0]
        shifted = np.abs(at.times[at.joints] - at.path.mesh)  # of the first and of the last joint
        floor += 2 * shifted * np.abs(falls[at.joints, 0] / h)
        slopes = np.abs(at.v * at.h) + rounding * np.repeat(places, len(at.h) // len(at.steps), axis=1)
        rounded = np.abs(by_both) * np.concatenate((np.abs(at.x), slopes)).T  # the terms of a force may cancel
        floor += ROUNDING_FACTOR * EPS * np.append(0.0, np.cumsum(at.integral(np.sum(rounded, axis=1))))
    misfit = np.nan_to_num(np.max(at.misfit(power), axis=1), posinf=0.0)
    return energy + np.append(0.0, np.cumsum(supplied)), scale, floor, misfit


def _unresolved(at: _Sampled, scale: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Misfit of L between points relative to L or to the energies around it; (N,), zero where it is small."""
    lagrangian = at.derivatives[0][:, 0] / at.h
    misfit = at.misfit(lagrangian)
    size = np.maximum(np.max(np.abs(at.by_interval(lagrangian)), axis=1), np.maximum(scale[1:], scale[:-1]))
    above_floor = np.max(misfit, axis=1) - np.maximum(floor[1:], floor[:-1])
    relative = np.where(np.isfinite(size), above_floor / size, np.inf)
    return np.where(relative > LAGRANGIAN_MISFIT, relative, 0.0)


def _correction(mass: np.ndarray, missing: np.ndarray) -> np.ndarray:
    """δᵀ(∂²L/∂v²)⁻¹δ/2, the energy of a momentum p minus (p·v - L) up to terms of third order; (K,).

    Parameters
    ----------
    mass : (K, d, d), ∂²L/∂v²
    missing : (d, K), δ = p - ∂L/∂v at the velocity v of the path
    """
    scaled, scales = scaled_masses(mass)
    values, vectors = np.linalg.eigh(scaled)
    regular = np.abs(values) > EPS * np.max(np.abs(values), axis=1, keepdims=True) + TINY
    inverse = np.divide(1.0, values, out=np.zeros_like(values), where=regular)
    measured = missing.T / np.sqrt(np.diagonal(scales, axis1=1, axis2=2))  # squares of momenta may overflow
    roots = np.einsum("ti,tij->tj", measured, vectors) * np.sqrt(np.abs(inverse))
    return np.sum(np.sign(values) * roots**2, axis=1) / 2
