"""How a problem is read: each of its fields is a `Statement`, which says what may be given, and what is kept of it.

A reader takes the name of a statement, what is given, and the problem that is made, which reads its other statements
when they are asked for; it returns what the problem keeps, or raises an error that names what came and what was
expected.  A rule looks at the problem that results, and yields what is wrong with it, in words.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial, wraps
from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypeGuard, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.numbers import (
    OneOrMore,
    components,
    counted,
    finite,
    flag,
    number,
    numbers,
    real_array,
    time_span,
    times_inside,
)
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.problems.callables import Traceable, entries_of, is_given, of_zeros, trace

NAMES_OF_VELOCITIES = "v", "v0", "v1"
FEASIBLE = 1e-8  # accepted violation relative to the terms compared; IPOPT's optima were measured below 1e-10
AT_BOUND = 1e-6  # distance from a bound, over the size of a value, up to which the value is at the bound
BOUND_ROUNDING = 4 * EPS  # relative excess of a given value over its bound that counts as rounding

Given = TypeVar("Given", contravariant=True)
Kept = TypeVar("Kept", covariant=True)
Reader: TypeAlias = Callable[[str, Any, Any], Any]
Rule: TypeAlias = Callable[[Any], Iterable[str]]
Limit: TypeAlias = float | Sequence[float]
Bounds: TypeAlias = tuple[tuple[float, ...], tuple[float, ...]]
Limited: TypeAlias = tuple[ca.Function, tuple[float, ...], tuple[float, ...]]  # g, lo, hi
Positions: TypeAlias = Sequence[float | tuple[float, float] | None]
Waypoint: TypeAlias = tuple[float, Positions | tuple[Traceable, Limit, Limit]]
Pairs: TypeAlias = tuple[tuple[float, float], ...]


class Statement(Generic[Given, Kept]):
    """A field of a problem.

    Parameters
    ----------
    read : Reader
    default : what is given where it is left out, one value; without any it must be given
    """

    def __init__(self, read: Reader, *default: Any) -> None:
        self.read, self.default, self.__doc__ = read, default, ""  # what it is, its class says under Parameters

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, problem: Any, owner: type | None = None) -> Kept:
        """Read what is given, once; a problem that is made holds what is kept in its place."""
        if problem is not None:
            given = vars(problem)["_given"][self.name]
            return vars(problem).setdefault(self.name, self.read(self.name, given, problem))
        if not self.default:
            raise AttributeError(self.name)
        return self.default[0]

    if TYPE_CHECKING:

        def __set__(self, problem: Any, value: Given) -> None: ...


Components: TypeAlias = Statement[OneOrMore | None, tuple[float | None, ...]]
Numbers: TypeAlias = Statement[OneOrMore, tuple[float, ...]]
NumbersOrNone: TypeAlias = Statement[OneOrMore | None, tuple[float, ...] | None]
Span: TypeAlias = Statement[Sequence[float], tuple[float, float]]
Times: TypeAlias = Statement[Sequence[float], tuple[float, ...]]
Lagrangian: TypeAlias = Statement[Traceable | None, ca.Function]
FunctionOrNone: TypeAlias = Statement[Traceable | None, ca.Function | None]
Integrals: TypeAlias = Statement[tuple[Traceable, OneOrMore] | None, tuple[ca.Function, tuple[float, ...]] | None]
Within: TypeAlias = Statement[tuple[Limit, Limit] | None, Bounds]
WithinOrNone: TypeAlias = Statement[tuple[Limit, Limit] | None, Bounds | None]
Waypoints: TypeAlias = Statement[Sequence[Waypoint], tuple[tuple[float, Pairs | Limited], ...]]
Jumps: TypeAlias = Statement[Sequence[tuple[float, Traceable]], tuple[tuple[float, ca.Function], ...]]
LimitedOrNone: TypeAlias = Statement[tuple[Traceable, Limit, Limit] | None, Limited | None]
LimitedValues: TypeAlias = Statement[tuple[Traceable, Limit, Limit] | None, Limited]


def check(problem: object, rules: Iterable[Rule]) -> None:
    """Raise a ValueError with the first words of the rules."""
    for rule in rules:
        for words in rule(problem):
            raise ValueError(words)


def optional(reader: Reader) -> Reader:
    """Read what may be left out, which is None."""
    return lambda name, value, problem: None if value is None else reader(name, value, problem)


def plain(checked: Callable[[str, Any], Any]) -> Reader:
    """Read by a check of the name and the value alone."""
    return lambda name, value, _: checked(name, value)


read_switch, read_span, read_parameters = plain(flag), plain(lambda _, span: time_span(span)), optional(plain(numbers))


def vector(name: str, value: Any, problem: Any) -> tuple[float | None, ...]:
    """D numbers, or None where nothing is given; None as a whole is None d times."""
    d = problem.dimension
    return (None,) * d if value is None else components(name, value, d)


def whole_vector(name: str, value: Any, problem: Any) -> tuple[float, ...]:
    """D numbers, none of them left out."""
    return numbers(name, value, problem.dimension)


def times(name: str, value: Any, problem: Any) -> tuple[float, ...]:
    """Increasing times inside of the time span."""
    return times_inside(name, value, problem.t_span)


def lengths(names: str, problem: Any, after: Any = None) -> dict[str, int]:
    """Lengths of the arguments of a callable, by name; those after a jump are of another problem, and p comes last."""
    known, p = {"t": 1, "u": getattr(problem, "controls", 0)}, problem.parameters
    known |= {} if after is None else dict.fromkeys(("x_after", "v_after"), after.dimension)
    d, last = problem.dimension, {} if p is None else {"p": len(p)}
    return {name: known.get(name, d) for name in names.split()} | last


def traced(name: str, value: Any, sizes: Mapping[str, int], rows: Any, problem: Any) -> ca.Function:
    """A callable of these arguments; it may leave out velocities where there is no Lagrangian."""
    if rows == 0:
        raise ValueError(f"all components follow rates: leave out {name}, got {value!r}")
    return trace(name, value, sizes, rows, NAMES_OF_VELOCITIES if problem.first_order else ())


def function(names: str, rows: str, zeros: bool = False) -> FunctionOrNone:
    """A callable of these arguments; None where it is left out, or so many zeros.

    Its values are a "scalar", a vector of "any" length, or as many as this attribute of the problem tells.
    """

    def reader(name: str, value: Any, problem: Any) -> Any:
        if not is_given(value):
            count = getattr(problem, rows, {"scalar": 1}.get(rows, 0))
            return of_zeros(name, lengths(names, problem), count) if zeros else None
        return traced(name, value, lengths(names, problem), getattr(problem, rows, rows), problem)

    return Statement(reader, None)


def lagrangian(name: str, value: Any, problem: Any) -> ca.Function:
    """L(t, x, v[, p]), which depends on every v[i] of a component with an equation of motion, and on no others.

    It need not depend on those that integrands of given integrals depend on.  Without any such it is left out.
    """
    count, d, conditions = problem.mechanical, problem.dimension, getattr(problem, "integral_conditions", None)
    if problem.first_order and count:
        first = ", ".join(f"x[{i}]" for i in range(count))
        raise ValueError(
            f"nothing moves {first}: give a lagrangian, or rates of all {counted(d, 'component')}, got {d - count}"
        )
    if problem.first_order:
        return of_zeros(name, lengths("t x v", problem), 1)
    L = traced(name, value, lengths("t x v", problem), count and "scalar", problem)
    used = entries_of(L, "v")
    given = entries_of(conditions[0], "v") if conditions else set()
    ignored = ", ".join(f"v[{i}]" for i in range(count) if i not in used | given)
    if ignored:
        rated = ", nor is its rate among the rates, which are those of the last components"
        reason = f"without a velocity there is no equation of motion for it{rated * (count < d)}"
        raise ValueError(f"the lagrangian ignores {ignored}: {reason}")
    for i in sorted(i for i in used if i >= count):
        raise ValueError(f"the lagrangian depends on v[{i}], but x[{i}] follows a rate and has no momentum")
    return L


def integrals(name: str, value: Any, problem: Any) -> tuple[ca.Function, tuple[float, ...]]:
    """(g, values), a callable of t, x, v and the values of its integrals."""
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise TypeError(f"{name} must be (g, values), a callable g and the values of its integrals, got {value!r}")
    g = trace(name, value[0], lengths("t x v", problem), "any")
    return g, numbers(f"the values of {name}", value[1], g.numel_out(0))


def read_limited(name: str, value: Any, sizes: Mapping[str, int], traced: Callable[..., ca.Function]) -> Limited:
    """(g, lo, hi), a callable that is `traced` as one of arguments of these sizes, and the bounds of its values."""
    if not isinstance(value, (tuple, list)) or len(value) != 3:
        raise TypeError(f"{name} must be (g, lo, hi), a callable g and the bounds of its values, got {value!r}")
    g = traced(name, value[0], sizes, "any")
    return g, *bounds(name, value[1:], g.numel_out(0))


def limited(names: str) -> LimitedValues:
    """(g, lo, hi), a callable of these arguments and the bounds of its values; without values where it is None."""

    def reader(name: str, value: Any, problem: Any) -> Limited:
        sizes = lengths(names, problem)
        if not is_given(value):
            return of_zeros(name, sizes, 0), (), ()
        return read_limited(name, value, sizes, partial(traced, problem=problem))

    return Statement(reader, None)


def within(count: Callable[[Any], int], fixed: bool = False) -> Any:
    """(lo, hi) of so many values, not all of them fixed; None where they are `fixed` unless it is given."""

    def reader(name: str, value: Any, problem: Any) -> Bounds | None:
        size = count(problem)
        if fixed and value is None:
            return None
        if not size and fixed:
            raise ValueError(f"{name} need parameters, which are the guess")
        low, high = bounds(name, value, size)
        if size > 1 and low == high and not fixed:  # as by a pair for each of two components in place of (lo, hi)
            raise ValueError(
                f"{name} must be (lo, hi), each a number or {size} numbers, not a pair for each component: "
                f"{value!r} leaves nothing free"
            )
        if name == "duration_bounds" and min(low) <= 0:
            raise ValueError(f"{name} must be positive, got {value}")
        return low, high

    return Statement(reader, None)


def bounds(name: str, value: Any, size: int) -> Bounds:
    """Check a pair (lo, hi), each a scalar or `size` numbers; infinite where there is none."""
    if value is None:
        return (-np.inf,) * size, (np.inf,) * size
    pair = np.atleast_1d(real_array(name, value)) if hasattr(value, "__array__") else value
    if not isinstance(pair, (tuple, list, np.ndarray)) or len(pair) != 2:
        raise TypeError(f"{name} must be a pair (lo, hi), got {value!r}")
    sides = []
    for side, given, none in zip(("lo", "hi"), pair, (-np.inf, np.inf), strict=True):
        array = real_array(f"the {side} of {name}, {none} where there is none,", given)
        if array.size and np.all(array == none):  # as where another number of components is stated
            array = np.array(none)
        if array.shape not in ((), (size,)) or (np.isnan(array) | (array == -none)).any():
            expected = f"a number or {counted(size, 'number')}, {none} where there is none"
            raise ValueError(f"the {side} of {name} must be {expected}, got {given!r}")
        sides.append(np.full(size, array))
    low, high = sides
    if (low > high).any():
        i = int(np.argmax(low > high))
        where = f" in component {i}" if size > 1 else ""
        raise ValueError(f"{name} must have lo <= hi, got {low[i]} and {high[i]}{where}")
    return tuple(low.tolist()), tuple(high.tolist())


def bound_excess(values: np.ndarray, low: ArrayLike, high: ArrayLike) -> np.ndarray:
    """By how much values (n, ...) leave their bounds (n,); zero within."""
    least, most = (np.reshape(side, (-1, *[1] * (values.ndim - 1))) for side in (low, high))
    return np.maximum(np.maximum(least - values, values - most), 0.0)


def keeps_to(value: float, low: float, high: float, size: float = 0.0) -> bool:
    """Whether a value keeps to its bounds, up to rounding of the largest of these, of `size` or of the value."""
    if low <= value <= high:
        return True
    rounded = BOUND_ROUNDING * max(abs(a) for a in (value, low, high, size) if np.isfinite(a))
    return low - rounded <= value <= high + rounded


def is_limited(place: Any) -> TypeGuard[Limited]:
    """Whether a waypoint is a function with bounds, not positions."""
    return callable(place) or (isinstance(place, (tuple, list)) and len(place) > 0 and callable(place[0]))


def timed(kind: str, checked: Callable[[Any, Any], Any]) -> Reader:
    """Read pairs of a time and what is stated there; no two may have the same time."""

    def reader(name: str, given: Any, problem: Any) -> tuple[tuple[float, Any], ...]:
        found: dict[float, Any] = {}
        for pair in given if isinstance(given, (tuple, list, np.ndarray)) else [given]:
            if not isinstance(pair, (tuple, list)) or len(pair) != 2:
                raise TypeError(f"{name} must be pairs {kind}, got {pair!r}")
            t = finite(f"the time of a {name[:-1]}", pair[0])
            if t in found:
                raise ValueError(f"{name} must have different times, got two at t = {t:g}")
            try:
                found[t] = checked(pair[1], problem)
            except (TypeError, ValueError) as error:
                raise type(error)(f"at t = {t:g}: {error}") from error
        return tuple(found.items())

    return reader


def _waypoint(place: Any, problem: Any) -> Pairs | Limited:
    """Bounds (lo, hi) of all positions, which must meet those of the problem, or (g, lo, hi)."""
    if is_limited(place):
        return limited("x v").read("waypoint", place, problem)
    d = problem.dimension
    if not isinstance(place, (tuple, list, np.ndarray)) or len(place) != d:
        raise ValueError(
            f"waypoint must be a list of {counted(d, 'position')}, each a number, a pair or None, or be "
            f"(g, lo, hi), got {place!r}"
        )
    pairs = [x if number(x) is None else (x, x) for x in place]
    read = [bounds(f"the bounds of x[{i}]", pair, 1) for i, pair in enumerate(pairs)]
    sides = tuple((low, high) for (low,), (high,) in read)
    for i, ((least, most), low, high) in enumerate(zip(sides, *problem.position_bounds, strict=True)):
        if not (keeps_to(least, -np.inf, high) and keeps_to(most, low, np.inf)):
            raise ValueError(
                f"waypoint bounds x[{i}] by [{least}, {most}], outside its position_bounds [{low}, {high}]"
            )
    return sides


def jump(name: str, law: Any, before: Any, after: Any) -> ca.Function:
    """A law of x and v before, with p, as a Function -> x after, v after; v after is zero where x follows a rate.

    Where both problems are of first order it is a callable of x alone -> x after.
    """
    arguments, d = lengths("x v", before), after.dimension
    if not callable(law):
        raise TypeError(f"{name} must be a callable of ({', '.join(arguments)}), got {law!r}")

    @wraps(law)
    def both(*given: ca.SX) -> Any:
        sides = law(*given)
        if len(given) < len(arguments):  # without velocities
            sides = sides, [0.0] * d
        if not isinstance(sides, (tuple, list)) or len(sides) != 2:
            raise TypeError(f"it must return a pair: x and v after the jump, got {sides!r}")
        columns = [ca.vertcat(*side) if isinstance(side, (tuple, list)) else ca.SX(side) for side in sides]
        counts = [column.numel() for column in columns]
        if counts != [d, d]:
            raise ValueError(f"it must return {counted(d, 'position')} and as many velocities, got {counts}")
        return ca.vertcat(*columns)

    traced = trace(name, both, arguments, 2 * d, () if before.mechanical or after.mechanical else NAMES_OF_VELOCITIES)
    symbols = traced.sx_in()
    position, velocity = ca.vertsplit(traced(*symbols), d)
    velocity[after.mechanical :] = 0.0
    return ca.Function("jump", symbols, [position, velocity], list(arguments), ["x_after", "v_after"])


read_waypoints = timed("(t, positions) or (t, (g, lo, hi))", _waypoint)
read_jumps = timed("(t, law)", lambda law, problem: jump("jump", law, problem, problem))
