"""Rules for ends under a holonomic constraint g(t, x) = 0: they fulfil it, and given velocities are tangent to it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.numbers import counted
from casadi_galerkin.calculus.roundoff import EPS, TINY, or_one
from casadi_galerkin.problems.expressions import POSITIONS, rows_that_depend, sizes_of_terms
from casadi_galerkin.problems.problem import ENDS

CONSTRAINT_TOLERANCE = 1e-12  # accepted violation by a given position or velocity, relative to the terms of g


def impossible_constraint(problem: Any) -> Iterator[str]:
    """A constraint leaves nothing free, or does not depend on the path."""
    if problem.constraint is None:
        return
    d, k = problem.dimension, problem.constraint.size1_out(0)
    if k >= d:
        yield f"a constraint must leave the path free to move: {counted(k, 'value')} for {counted(d, 'component')}"
    constant = np.flatnonzero(~rows_that_depend(problem.constraint, POSITIONS, np.ones(d, dtype=bool)))
    if len(constant):
        yield f"the constraint must depend on x, but constraint[{constant[0]}] does not: no path can be held to it"


def places(problem: Any) -> list[tuple[str, float, tuple[float | None, ...], np.ndarray]]:
    """Name, time and position of every end of a problem under a constraint, and which constraints are known there.

    Those are known that depend on no time or parameter that is free.
    """
    if problem.constraint is None:
        return []
    names = [name for name in ENDS if hasattr(problem, name)]
    known = getattr(problem, "determined_constraints", lambda _: np.ones(problem.constraint.numel_out(0), dtype=bool))
    return [(name, problem.t_span[k], getattr(problem, name), known(k)) for k, name in enumerate(names)]


def constraint_at_ends(problem: Any) -> Iterator[str]:
    """Given positions violate a constraint, or leave it less free than it asks for, or make it redundant.

    Of a position that is given in part, constraints of given components alone are looked at.
    """
    for name, when, where, known in places(problem):
        function = problem.numeric.constraint
        missing = np.array([value is None for value in where])
        free = rows_that_depend(function, POSITIONS, missing)
        conditions, unknowns = (int(np.count_nonzero(some)) for some in (free, missing))
        if conditions > unknowns:
            yield (
                f"{name} = {list(where)} leaves {counted(unknowns, 'component')} free, on which "
                f"{counted(conditions, 'value')} of the constraint depend: give the whole position, or less of it"
            )
        symbols, looked_at = function.sx_in(), known & ~free
        at = when, [0.0 if value is None else value for value in where]
        values, missed, slopes = (np.array(a) for a in relative_residuals(function(*symbols), symbols)(*at))
        if not np.all(missed[looked_at] <= 1):
            i = int(np.argmax(np.where(looked_at, missed[:, 0], -1.0)))
            yield (
                f"the constraint must be zero at the given {name}, x = {list(where)}: constraint[{i}] is "
                f"{values[i, 0]:g}, and only rounding, up to {abs(values[i, 0]) / missed[i, 0]:.0e}, is accepted"
            )
        slope = slopes[:, 1:]
        rows = or_one(np.linalg.norm(slope, axis=1))
        if looked_at.all() and np.linalg.matrix_rank(slope / rows[:, None], tol=1e3 * EPS) < len(looked_at):
            yield (
                f"the constraints are redundant at the given {name}, x = {list(where)}: their gradients, the rows of "
                f"{slope.tolist()}, are linearly dependent"
            )


def leaving_velocity(problem: Any) -> Iterator[str]:
    """A velocity that is given at a given position leaves a constraint: G v + ∂g/∂t must be zero.

    Up to rounding of the largest velocity, or of the largest length over the duration where that is larger.
    """
    for name, when, x, known in places(problem):
        of = f"{name}_velocity" if hasattr(problem, "end") else "velocity"
        v = getattr(problem, of)
        if v is None or None in (*x, *v):
            continue
        function = problem.numeric.constraint
        (time, place), velocity = function.sx_in(), ca.SX.sym("v", len(v))
        rate = ca.jtimes(function(time, place), place, velocity) + ca.jacobian(function(time, place), time)
        rates, _, slopes = (np.array(a) for a in relative_residuals(rate, [time, place, velocity])(when, x, v))
        length, d = np.abs(np.array(x, dtype=float)).max(), len(v)
        sizes = [abs(when), *[length] * d, *[max(np.abs(v).max(), length / np.ptp(problem.t_span))] * d]
        missed = np.abs(rates[:, 0]) > CONSTRAINT_TOLERANCE * np.abs(slopes) @ sizes
        for i in np.flatnonzero(known & missed).tolist():
            yield (
                f"{of} must be tangent to the constraint at x = {list(x)}, got {list(v)}: the rate of constraint[{i}] "
                f"is {rates[i, 0]:g}"
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
