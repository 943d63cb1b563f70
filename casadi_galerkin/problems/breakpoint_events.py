"""What a control problem states at breakpoints: places and conditions to pass, and jumps of the path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any, TypeAlias, TypeGuard

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.numbers import counted, finite, number
from casadi_galerkin.problems.bounds import Limit, Limited, bounds, keeps_to
from casadi_galerkin.problems.callables import Traceable, trace
from casadi_galerkin.problems.statements import VELOCITIES, Made, Reader, dimension, lengths, limited

Positions: TypeAlias = Sequence[float | tuple[float, float] | None]
Waypoint: TypeAlias = tuple[float, Positions | tuple[Traceable, Limit, Limit]]
Pairs: TypeAlias = tuple[tuple[float, float], ...]


def is_limited(place: Any) -> TypeGuard[Limited]:
    """Whether a waypoint is a function with bounds, not positions."""
    return callable(place) or (isinstance(place, (tuple, list)) and len(place) > 0 and callable(place[0]))


def timed(kind: str, checked: Callable[[Any, Made], Any]) -> Reader:
    """Read pairs of a time and what is stated there; no two may have the same time."""

    def reader(name: str, given: Any, made: Made) -> tuple[tuple[float, Any], ...]:
        found: dict[float, Any] = {}
        for pair in given if isinstance(given, (tuple, list, np.ndarray)) else [given]:
            if not isinstance(pair, (tuple, list)) or len(pair) != 2:
                raise TypeError(f"{name} must be pairs {kind}, got {pair!r}")
            t = finite(f"the time of a {name[:-1]}", pair[0])
            if t in found:
                raise ValueError(f"{name} must have different times, got two at t = {t:g}")
            try:
                found[t] = checked(pair[1], made)
            except (TypeError, ValueError) as error:
                raise type(error)(f"at t = {t:g}: {error}") from error
        return tuple(found.items())

    return reader


def _waypoint(place: Any, made: Made) -> Pairs | Limited:
    """Bounds (lo, hi) of all positions, which must meet those of the problem, or (g, lo, hi)."""
    if is_limited(place):
        return limited("x v")("waypoint", place, made)
    within = made["position_bounds"]
    if not isinstance(place, (tuple, list, np.ndarray)) or len(place) != len(within[0]):
        raise ValueError(
            f"waypoint must be a list of {counted(len(within[0]), 'position')}, each a number, a pair or None, or be "
            f"(g, lo, hi), got {place!r}"
        )
    pairs = [x if number(x) is None else (x, x) for x in place]
    read = [bounds(f"the bounds of x[{i}]", pair, 1) for i, pair in enumerate(pairs)]
    sides = tuple((low, high) for (low,), (high,) in read)
    for i, ((least, most), low, high) in enumerate(zip(sides, *within, strict=True)):
        if not (keeps_to(least, -np.inf, high) and keeps_to(most, low, np.inf)):
            raise ValueError(
                f"waypoint bounds x[{i}] by [{least}, {most}], outside its position_bounds [{low}, {high}]"
            )
    return sides


def positions_and_velocities(
    name: str, law: Any, sizes: dict[str, int], d: int, mechanical: int, first_order: bool = False
) -> ca.Function:
    """A jump as a Function (x, v[, p]) -> x after, v after; v after is zero where x follows a rate.

    Of first order it is a callable of x alone -> x after.
    """
    if not callable(law):
        raise TypeError(f"{name} must be a callable of ({', '.join(sizes)}), got {law!r}")

    @wraps(law)
    def after(*arguments: ca.SX) -> Any:
        sides = law(*arguments)
        if len(arguments) < len(sizes):  # without velocities
            sides = sides, [0.0] * d
        if not isinstance(sides, (tuple, list)) or len(sides) != 2:
            raise TypeError(f"it must return a pair: x and v after the jump, got {sides!r}")
        columns = [ca.vertcat(*side) if isinstance(side, (tuple, list)) else ca.SX(side) for side in sides]
        counts = [column.numel() for column in columns]
        if counts != [d, d]:
            raise ValueError(f"it must return {counted(d, 'position')} and as many velocities, got {counts}")
        return ca.vertcat(*columns)

    traced = trace(name, after, sizes, 2 * d, VELOCITIES if first_order else ())
    symbols = traced.sx_in()
    position, velocity = ca.vertsplit(traced(*symbols), d)
    velocity[mechanical:] = 0.0
    return ca.Function("jump", symbols, [position, velocity], list(sizes), ["x_after", "v_after"])


def _law(law: Any, made: Made) -> ca.Function:
    d = dimension(made)
    mechanical, first_order = d - made["rates"].numel_out(0), made["first_order"]
    return positions_and_velocities("jump", law, lengths("x v", made), d, mechanical, first_order)


waypoints = timed("(t, positions) or (t, (g, lo, hi))", _waypoint)
jumps = timed("(t, law)", _law)
