"""Holonomic constraints g(t, x) = 0: ends that fulfil them, and motion under them at one instant.

With G = ∂g/∂x, the velocity of a path on the constraint is tangent, G v + ∂g/∂t = 0, and the impulse of the constraint
changes a momentum by Gᵀμ only.  Accelerations and multipliers λ follow from one linear system,

    M a - Gᵀλ = ∂L/∂x + F - ∂p/∂x v - ∂p/∂t,        G a = -d/dt(G v + ∂g/∂t) at a = 0,

with p = ∂L/∂v and M = ∂p/∂v.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.nodes import lobatto_points
from casadi_galerkin.calculus.numbers import APART, counted
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, sampling_parts, times_at
from casadi_galerkin.calculus.roundoff import EPS, TINY, component_sizes, or_one
from casadi_galerkin.problems.callables import (
    depends_on_free,
    depends_on_time,
    rows_that_depend,
    sizes_of_terms,
    with_parameters,
)
from casadi_galerkin.problems.linear_equations import scaled_solve
from casadi_galerkin.problems.problem import Problem

# Violation of a constraint between the nodes, over the change of g along the path, from which a path is refused.  One
# chord of an arc has 0.09; jumps through the center of a circle were measured at 0.16 to 0.25.
LARGEST_VIOLATION = 0.1


def impossible_constraint(problem: Any) -> Iterator[str]:
    """A constraint leaves nothing free, or does not depend on the path."""
    if problem.constraint is None:
        return
    d, k = problem.dimension, problem.constraint.size1_out(0)
    if k >= d:
        yield f"a constraint must leave the path free to move: {counted(k, 'value')} for {counted(d, 'component')}"
    constant = np.flatnonzero(~rows_that_depend(problem.constraint, "x", np.ones(d, dtype=bool)))
    if len(constant):
        yield f"the constraint must depend on x, but constraint[{constant[0]}] does not: no path can be held to it"


def relative_residuals(
    value: ca.SX, symbols: Sequence[ca.SX], further: Sequence[ca.SX] = (), least: Any = 0.0
) -> ca.Function:
    """(symbols, further) -> residuals (k,), these over what is accepted as rounding, and derivatives (k, n).

    The derivatives are those by the symbols.  Accepted are `APART` of every symbol, or of its `least`
    size, times the derivative by it, and eps of all terms.  The time is among the symbols: its rounding counts, too.
    """
    slopes, inputs = ca.densify(ca.jacobian(value, ca.vertcat(*symbols))), [*symbols, *further]
    sizes = ca.fmax(ca.fabs(ca.vertcat(*symbols)), least)
    accepted = APART * ca.mtimes(ca.fabs(slopes), sizes) + EPS * sizes_of_terms(value, inputs) + TINY
    return ca.Function("over_terms", inputs, [value, ca.fabs(value) / accepted, slopes])


def constraint_at_ends(problem: Any) -> Iterator[str]:
    """What is given at an end violates a constraint, leaves less free than that asks for, or makes it redundant.

    Looked at are constraints that depend on nothing free.  A velocity that is given at a given position must be
    tangent, G v + ∂g/∂t = 0, up to rounding of the largest velocity, or of the largest length over the duration.
    """
    if problem.constraint is None:
        return
    function = with_parameters(problem.constraint, problem.parameters)
    ends, d = problem.given_at_ends, problem.dimension
    for k, (name, (t, x, v, p)) in enumerate(ends.items()):
        (time, place), velocity, free = function.sx_in(), ca.SX.sym("v", d), np.isnan(x)
        stated, known = f"x = {list(getattr(problem, name))}", ~depends_on_free(problem.constraint, (t, x, p))
        unknowns, conditions = (int(np.sum(a)) for a in (free, rows_that_depend(function, "x", free)))
        if conditions > unknowns:
            yield (
                f"{name} = {stated[4:]} leaves {counted(unknowns, 'component')} free, on which "
                f"{counted(conditions, 'value')} of the constraint depend: give the whole position, or less of it"
            )
        held, at = function(time, place), (problem.t_span[k], np.nan_to_num(x))
        values, missed, slopes = (np.array(a) for a in relative_residuals(held, [time, place])(*at))
        for i in np.flatnonzero(known & ~(missed[:, 0] <= 1)).tolist():
            yield (
                f"the constraint must be zero at the given {name}, {stated}: constraint[{i}] is {values[i, 0]:g}, and "
                f"only rounding, up to {abs(values[i, 0]) / missed[i, 0]:.0e}, is accepted"
            )
        slope = slopes[:, 1:]
        rows = or_one(np.linalg.norm(slope, axis=1))
        if known.all() and np.linalg.matrix_rank(slope / rows[:, None], tol=1e3 * EPS) < len(known):
            yield (
                f"the constraints are redundant at the given {name}, {stated}: their gradients, the rows of "
                f"{slope.tolist()}, are linearly dependent"
            )
        if np.isnan((*x, *v)).any():
            continue
        rate, length = ca.jtimes(held, place, velocity) + ca.jacobian(held, time), np.abs(x).max()
        least = [0.0, *[length] * d, *[max(np.abs(v).max(), length / np.ptp(problem.t_span))] * d]
        rates, missed, _ = (np.array(a) for a in relative_residuals(rate, [time, place, velocity], (), least)(*at, v))
        of = f"{name}_velocity" if len(ends) > 1 else "velocity"
        for i in np.flatnonzero(known & (missed[:, 0] > 1)).tolist():
            yield (
                f"{of} must be tangent to the constraint at {stated}, got {v.tolist()}: the rate of constraint[{i}] is "
                f"{rates[i, 0]:g}"
            )


@lru_cache(8)
def constrained_motion(lagrangian: ca.Function, constraint: ca.Function, force: ca.Function | None) -> ca.Function:
    """(t, x, v) -> the linear system's sparse matrix and right-hand side, p (d,), G v + ∂g/∂t (k,), ∂g/∂t (k,).

    Parameters
    ----------
    lagrangian, force : Functions of (t, x, v)
    constraint : Function of (t, x)
    """
    t, x, v = symbols = lagrangian.sx_in()
    mass, momentum = ca.hessian(lagrangian(t, x, v), v)
    held = constraint(t, x)
    slope = ca.jacobian(held, x)
    pull = ca.jacobian(held, t)
    rate = ca.mtimes(slope, v) + pull

    def time_derivative(value: ca.SX) -> ca.SX:
        """Time derivative of a value along a motion without acceleration."""
        return ca.jacobian(value, t) + ca.mtimes(ca.jacobian(value, x), v)

    pushed = ca.gradient(lagrangian(t, x, v), x) - time_derivative(momentum)
    pushed = pushed if force is None else pushed + force(t, x, v)
    matrix = ca.blockcat([[mass, -slope.T], [slope, ca.SX(slope.shape[0], slope.shape[0])]])
    vectors = [ca.vertcat(pushed, -time_derivative(rate)), momentum, rate, pull]
    return ca.Function("constrained_motion", symbols, [matrix, *map(ca.densify, vectors)])


@lru_cache(8)
def _solver(motion: ca.Function) -> ca.Function:
    """(t, x, v, right-hand side) -> accelerations and multipliers; sparse, so that the cost is linear in the bodies."""
    symbols = motion.mx_in()
    matrix, rhs, *_ = motion.call(symbols)
    rhs = ca.MX.sym("rhs", rhs.numel())
    return ca.Function("solve", [*symbols, rhs], [scaled_solve(matrix, range(motion.size1_in(1)))(rhs)])


def motion_of(problem: Problem, force: ca.Function | None = None) -> ca.Function | None:
    """`constrained_motion` of a problem with its parameters put in; None where there is no constraint.

    The force (t, x, v) may be left out where only momenta and tangents are asked for, which do not depend on it.
    """
    if problem.constraint is None:
        return None
    numeric = problem.numeric
    return constrained_motion(numeric.lagrangian, numeric.constraint, force)


def _at(motion: ca.Function, t: np.ndarray, x: np.ndarray, v: np.ndarray) -> list[np.ndarray]:
    """All vectors of a motion at K instants, (..., K) each."""
    return [np.array(a) for a in motion.map(len(t))(t[None, :], x, v)[1:]]


def _solved(motion: ca.Function, t: np.ndarray, x: np.ndarray, v: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Solutions (d + k, K) of the linear systems at K instants."""
    return np.array(_solver(motion).map(len(t))(t[None, :], x, v, rhs))


def tangent_momenta(
    problem: Problem, t: np.ndarray, x: np.ndarray, momentum: np.ndarray, velocity: np.ndarray
) -> np.ndarray:
    """The momenta p + Gᵀμ whose velocities are tangent to the constraint, by Newton's method; (d, K).

    Without a constraint, momenta are returned as they are.

    Parameters
    ----------
    problem : Problem
    t : (K,)
    x, momentum : (d, K)
    velocity : (d, K), the first iterate
    """
    motion = motion_of(problem)
    if motion is None:
        return momentum
    v, d, longest = velocity, len(x), np.inf
    while True:
        _, p, rate, _ = _at(motion, t, x, v)
        step = _solved(motion, t, x, v, np.concatenate((momentum - p, -rate)))[:d]  # which finds μ anew
        size = float(np.max(np.abs(step)))
        if not 0 < size < longest:  # steps fall until they are rounding
            return p
        v, longest = v + step, size


def tangent_at_joints(problem: Problem, path: PiecewisePolynomial, momentum: np.ndarray) -> np.ndarray:
    """`tangent_momenta` at the joints of a path, (d, N + 1)."""
    if problem.constraint is None:
        return momentum
    return tangent_momenta(problem, path.mesh, path(path.mesh), momentum, path(path.mesh, 1))


@lru_cache(8)
def _missed(constraint: ca.Function) -> ca.Function:
    """(t, x, moves) -> |g| and |∂g/∂x| moves, (k,) each."""
    t, x = constraint.sx_in()
    held, moves = constraint(t, x), ca.SX.sym("moves", x.numel())
    changes = ca.mtimes(ca.fabs(ca.jacobian(held, x)), moves)
    return ca.Function("missed", [t, x, moves], [ca.densify(ca.fabs(held)), ca.densify(changes)])


def off_constraint(problem: Problem, path: PiecewisePolynomial) -> str | None:
    """Say where a path leaves its constraint between the nodes by more than `LARGEST_VIOLATION`; None if it does not.

    As when a mass on a rod jumps from one side to the other.  The violation is compared with the largest change of g by
    a motion as large as that of the path.
    """
    if problem.constraint is None:
        return None
    parts = sampling_parts(path.degree)
    x, times = path.at_parts(parts)[0].reshape(len(path.values), -1), times_at(path.mesh, parts)
    moves = np.ptp(x, axis=1, keepdims=True) + np.sqrt(EPS) * component_sizes(x)[:, None]
    measured = _missed(problem.numeric.constraint).map(len(times))
    missed, largest = (np.array(a) for a in measured(times[None, :], x, np.broadcast_to(moves, x.shape)))
    part = np.max(missed / np.maximum(np.max(largest, axis=1, keepdims=True), TINY), axis=0)
    k = int(np.argmax(part))
    if part[k] <= LARGEST_VIOLATION:
        return None
    return (
        f"the path leaves its constraint between the nodes, near t = {times[k]:.6g}, by {part[k]:.0%} of what its "
        "motion changes there. Take more intervals, or give a guess that keeps to it"
    )


def tangents(motion: ca.Function, t: float, x: np.ndarray) -> np.ndarray:
    """Orthonormal basis of the tangents to the constraint at a position, (d, d - k)."""
    slope = np.array(motion(t, x, np.zeros(len(x)))[0])[len(x) :, : len(x)]
    return np.linalg.svd(slope)[2][len(slope) :].T


def multipliers(motion: ca.Function, t: np.ndarray, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Multipliers λ of the constraint forces Gᵀλ; (k, K)."""
    if not len(t):
        return np.empty((motion.size1_out(0) - len(x), 0))
    return _solved(motion, t, x, v, _at(motion, t, x, v)[0])[len(x) :]


def work_of_constraint(problem: Problem, t: np.ndarray, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """λ·∂g/∂t, the power that a constraint takes from the path, which is zero unless it depends on time; (K,)."""
    if not depends_on_time(problem.constraint):
        return 0 * t
    motion = motion_of(problem, problem.numeric.force)
    return np.sum(multipliers(motion, t, x, v) * _at(motion, t, x, v)[3], axis=0)


def check_points(constraint: ca.Function | None, method: Galerkin) -> None:
    """Refuse control points that lose the order of a constrained path.

    Impulses at Lobatto points are an integral of the constraint's force of order 2m.  At equally spaced or Chebyshev
    points the order of the path was measured to be the next even number from m on, with every rule.
    """
    if constraint is not None and method.control_points != tuple(lobatto_points(method.degree).tolist()):
        raise ValueError(
            "a constraint is held at the control points; to keep order 2m, they must be the default, "
            f"lobatto_points({method.degree}), got {list(method.control_points)}"
        )


def equations_of_motion(problem: Any) -> ca.Function:
    """(t, x, v, u, multipliers of the constraint) -> what the equations of motion are of, and its time derivative.

    For a mechanical component these are ∂L/∂v, and ∂L/∂x + F with the constraint's force; for one that follows a rate,
    x and that rate; (d,) each.
    """
    numeric = problem.numeric
    lagrangian, force, rates, constraint = numeric.lagrangian, numeric.force, numeric.rates, numeric.constraint
    parts, u = [0, problem.mechanical, problem.dimension], ca.SX.sym("u", problem.controls)
    t, x, v = lagrangian.sx_in()
    work, momentum = (ca.vertsplit(ca.gradient(lagrangian(t, x, v), by), parts)[0] for by in (x, v))
    held = ca.SX(0, 1) if constraint is None else constraint(t, x)
    push = ca.SX.sym("push", held.numel())
    changes = ca.vertcat(work + force(t, x, v, u), rates(t, x, v, u)) + ca.jtimes(held, x, push, True)
    outputs = map(ca.densify, (ca.vertcat(momentum, ca.vertsplit(x, parts)[1]), changes))
    return ca.Function("motion", [t, x, v, u, push], [*outputs])
