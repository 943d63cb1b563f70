"""Motion under holonomic constraints g(t, x) = 0 at one instant: tangent momenta, accelerations and multipliers.

With G = ∂g/∂x, the velocity of a path on the constraint is tangent, G v + ∂g/∂t = 0, and the impulse of the constraint
changes a momentum by Gᵀμ only.  Accelerations and multipliers λ follow from one linear system,

    M a - Gᵀλ = ∂L/∂x + F - ∂p/∂x v - ∂p/∂t,        G a = -d/dt(G v + ∂g/∂t) at a = 0,

with p = ∂L/∂v and M = ∂p/∂v.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.nodes import lobatto_points
from casadi_galerkin.calculus.numbers import counted
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, sampling_parts, times_at
from casadi_galerkin.calculus.roundoff import EPS, TINY, component_sizes, or_one
from casadi_galerkin.problems.callables import depends_on_time, with_parameters
from casadi_galerkin.problems.cancellation import sizes_of_terms
from casadi_galerkin.problems.dependence import POSITIONS, rows_that_depend
from casadi_galerkin.problems.linear_equations import solve_scaled
from casadi_galerkin.problems.problem import Problem

ITERATIONS = 20
# Violation of a constraint between the nodes, over the change of g along the path, from which a path is refused.  One
# chord of an arc has 0.09; jumps through the center of a circle were measured at 0.16 to 0.25.
LARGEST_VIOLATION = 0.1
STILL = 1e-10  # least motion of a component that a violation is compared with, relative to its size
# accepted violation of a constraint by a given position or velocity, relative to the terms of g
CONSTRAINT_TOLERANCE = 1e-12


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
    return ca.Function("solve", [*symbols, rhs], [solve_scaled(matrix, rhs, range(motion.size1_in(1)))])


def motion_of(problem: Problem, force: ca.Function | None = None) -> ca.Function | None:
    """`constrained_motion` of a problem with its parameters put in; None where there is no constraint.

    The force may be left out where only momenta and tangents are asked for, which do not depend on it.
    """
    if problem.constraint is None:
        return None
    functions = problem.lagrangian, problem.constraint, force
    return constrained_motion(*(with_parameters(f, problem.parameters) for f in functions))


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
    v, d = velocity, len(x)
    for _ in range(ITERATIONS):
        _, p, rate, _ = _at(motion, t, x, v)
        step = _solved(motion, t, x, v, np.concatenate((momentum - p, -rate)))[:d]  # which finds μ anew
        v = v + step
        if not np.any(np.abs(step) > 4 * EPS * np.max(np.abs(v))):
            break
    return _at(motion, t, x, v)[1]


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
    x, times = path.values_at_parts(parts).reshape(len(path.values), -1), times_at(path.mesh, parts)
    moves = np.ptp(x, axis=1, keepdims=True) + STILL * component_sizes(x)[:, None]
    measured = _missed(with_parameters(problem.constraint, problem.parameters)).map(len(times))
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
    motion = motion_of(problem, problem.force)
    return np.sum(multipliers(motion, t, x, v) * _at(motion, t, x, v)[3], axis=0)


def check_constraint(problem: Problem, known: Mapping[str, np.ndarray] | None = None) -> None:
    """Refuse too many constraints, and given positions that violate them or where they are redundant.

    Of a position that is given in part, those that depend on given components alone are looked at.  `known` says by
    name which constraints depend on nothing else that is free there, (k,); by default all do.
    """
    if problem.constraint is None:
        return
    function = with_parameters(problem.constraint, problem.parameters)
    d, k = function.size1_in(1), function.size1_out(0)
    if k >= d:
        raise ValueError(
            f"a constraint must leave the path free to move: {counted(k, 'value')} for {counted(d, 'component')}"
        )
    constant = sorted(set(range(k)).difference(problem.constraint.sparsity_jac(1, 0).row()))
    if constant:
        raise ValueError(
            f"the constraint must depend on x, but constraint[{constant[0]}] does not: no path can be held to it"
        )
    first, last = problem.t_span
    for name, when in (("start", first), ("position", first), ("end", last)):
        where: Any = getattr(problem, name, None)
        if where is None:
            continue
        place = np.array(where, dtype=float)  # NaN for None
        free = rows_that_depend(function, POSITIONS, np.isnan(place))
        conditions, unknowns = (int(np.count_nonzero(some)) for some in (free, np.isnan(place)))
        if conditions > unknowns:
            raise ValueError(
                f"{name} = {list(where)} leaves {counted(unknowns, 'component')} free, on which "
                f"{counted(conditions, 'value')} of the constraint depend: give the whole position, or less of it"
            )
        looked_at = ~free if known is None else known[name] & ~free
        _check_place(function, name, when, where, looked_at)


def _check_place(function: ca.Function, name: str, when: float, where: Sequence[Any], looked_at: np.ndarray) -> None:
    """Refuse a given position that violates one of the constraints looked at, or where all are but are redundant."""
    symbols, place = function.sx_in(), [0.0 if value is None else value for value in where]
    values, missed, slopes = (np.array(a) for a in relative_residuals(function(*symbols), symbols)(when, place))
    if not np.all(missed[looked_at] <= 1):
        i = int(np.argmax(np.where(looked_at, missed[:, 0], -1.0)))
        raise ValueError(
            f"the constraint must be zero at the given {name}, x = {list(where)}: constraint[{i}] is "
            f"{values[i, 0]:g}, and only rounding, up to {abs(values[i, 0]) / missed[i, 0]:.0e}, is accepted"
        )
    slope = slopes[:, 1:]
    rows = or_one(np.linalg.norm(slope, axis=1))
    if looked_at.all() and np.linalg.matrix_rank(slope / rows[:, None], tol=1e3 * EPS) < len(looked_at):
        raise ValueError(
            f"the constraints are redundant at the given {name}, x = {list(where)}: their gradients, the rows of "
            f"{slope.tolist()}, are linearly dependent"
        )


def check_points(constraint: ca.Function | None, method: Galerkin) -> None:
    """Refuse control points that lose the order of a constrained path.

    Impulses at Lobatto points are an integral of the constraint's force of order 2m.  At equally spaced or Chebyshev
    points the order of the path was measured to be the next even number from m on, with every rule.
    """
    points, expected = np.array(method.control_points), lobatto_points(method.degree)
    if constraint is not None and not np.allclose(points, expected, rtol=0, atol=1e-12):
        raise ValueError(
            "a constraint is held at the control points; to keep order 2m, they must be the default, "
            f"lobatto_points({method.degree}), got {points.tolist()}"
        )


def relative_residuals(value: ca.SX, symbols: Sequence[ca.SX], further: Sequence[ca.SX] = ()) -> ca.Function:
    """(symbols, further) -> residuals (k,), these over what is accepted as rounding, and derivatives (k, n).

    The derivatives are those by the symbols.  Accepted are `CONSTRAINT_TOLERANCE` of every symbol times the derivative
    by it, and eps of all terms.  The time is among the symbols, so that its rounding counts, too.
    """
    slopes, inputs = ca.densify(ca.jacobian(value, ca.vertcat(*symbols))), [*symbols, *further]
    accepted = CONSTRAINT_TOLERANCE * ca.mtimes(ca.fabs(slopes), ca.fabs(ca.vertcat(*symbols)))
    accepted += EPS * sizes_of_terms(value, inputs) + TINY
    return ca.Function("over_terms", inputs, [value, ca.fabs(value) / accepted, slopes])


def check_tangent(
    problem: Problem,
    name: str,
    t: float,
    x: tuple[float, ...],
    v: tuple[float, ...],
    known: np.ndarray | None = None,
) -> None:
    """Refuse a velocity of this name, given at a position, that leaves the constraint: G v + ∂g/∂t must be zero.

    `known` says which constraints depend on nothing free there, (k,); by default all do.

    The accepted rounding of a velocity is relative to its own size, or to that of the position over the duration if it
    is larger: a velocity so small moves the path by no more than the rounding of its position.
    """
    if problem.constraint is None:
        return
    function = with_parameters(problem.constraint, problem.parameters)
    time, place = function.sx_in()
    velocity, value = ca.SX.sym("v", place.numel()), function(time, place)
    rate = ca.jtimes(value, place, velocity) + ca.jacobian(value, time)
    rates, _, slopes = (np.array(a) for a in relative_residuals(rate, [time, place, velocity])(t, x, v))
    lengths = np.abs(x)
    sizes = np.concatenate(([abs(t)], lengths, np.fmax(np.abs(v), lengths / np.ptp(problem.t_span))))
    excess = np.abs(rates[:, 0]) - CONSTRAINT_TOLERANCE * np.abs(slopes) @ sizes
    if known is not None:
        excess = np.where(known, excess, 0.0)
    if np.any(excess > 0):
        i = int(np.argmax(excess))
        raise ValueError(
            f"{name} must be tangent to the constraint at x = {list(x)}, got {list(v)}: the rate of constraint[{i}] is "
            f"{rates[i, 0]:g}"
        )
