"""How a problem is read: a table with a reader for each of its statements, and rules for all of them together.

A reader takes the name and the value of a statement, and what was read before it; it returns what the problem keeps, or
raises an error that names what came and what was expected.  A rule looks at the problem that results, and yields what
is wrong with it, in words.  A new statement is an entry of a table, and a rule where it may contradict others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

import casadi as ca

from casadi_galerkin.calculus.numbers import components, finite, flag, numbers, time_span, times_inside
from casadi_galerkin.problems.bounds import Bounds, bounds
from casadi_galerkin.problems.callables import Rows, arguments, left_out, of_zeros, trace

VELOCITIES = "v", "v0", "v1"

Made: TypeAlias = dict[str, Any]  # what was read, by name
Reader: TypeAlias = Callable[[str, Any, Made], Any]
Rule: TypeAlias = Callable[[Any], Iterable[str]]


def check(problem: object, rules: Iterable[Rule]) -> None:
    """Raise a ValueError with the first words of the rules."""
    for rule in rules:
        for words in rule(problem):
            raise ValueError(words)


def dimension(made: Made) -> int:
    """Number d of coordinates, which the start tells."""
    return len(made["start"])


def optional(reader: Reader) -> Reader:
    """Read what may be left out, which is None."""
    return lambda name, value, made: None if value is None else reader(name, value, made)


def vector(name: str, value: Any, made: Made) -> tuple[float | None, ...]:
    """D numbers, or None where nothing is given; the first one tells d."""
    return components(name, value, dimension(made) if made else None)


def vector_or_nothing(name: str, value: Any, made: Made) -> tuple[float | None, ...]:
    """The same; None as a whole is None d times."""
    return (None,) * dimension(made) if value is None else vector(name, value, made)


def whole_vector(name: str, value: Any, made: Made) -> tuple[float, ...]:
    """D numbers, none of them left out; the first one tells d."""
    return numbers(name, value, dimension(made) if made else None)


def plain(checked: Callable[[str, Any], Any]) -> Reader:
    """Read by a check of the name and the value alone."""
    return lambda name, value, _: checked(name, value)


parameters, number, switch = optional(plain(numbers)), plain(finite), plain(flag)
span = plain(lambda _, value: time_span(value))


def times(name: str, value: Any, made: Made) -> tuple[float, ...]:
    """Increasing times inside of the time span."""
    return times_inside(name, value, made["t_span"])


def lengths(names: str, made: Made) -> dict[str, int]:
    """Lengths of the arguments of a callable, by name; the parameters come last."""
    d, others = dimension(made), {"t": 1, "u": made.get("controls", 0)}
    return arguments(made["parameters"], **{name: others.get(name, d) for name in names.split()})


def traced(name: str, value: Any, names: str, rows: Any, made: Made) -> ca.Function:
    """A callable of these arguments; it may leave out velocities where there is no Lagrangian."""
    return trace(name, value, lengths(names, made), rows, VELOCITIES if made.get("first_order") else ())


def function(names: str, rows: Rows | str) -> Reader:
    """A callable of these arguments with values of these `rows`: "scalar", "any", or as many as "x" has."""

    def reader(name: str, value: Any, made: Made) -> Any:
        expected = dimension(made) if rows == "x" else rows
        return None if value is None else traced(name, value, names, expected, made)

    return reader


def lagrangian(_: str, value: Any, made: Made) -> ca.Function:
    """L(t, x, v[, p]), which depends on every v[i] of a component with an equation of motion, and on no others.

    It need not depend on those that integrands of given integrals depend on.
    """
    function, d = trace("lagrangian", value, lengths("t x v", made), "scalar"), dimension(made)
    count, conditions = d - (made["rates"].numel_out(0) if "rates" in made else 0), made.get("integral_conditions")
    used = set(function.sparsity_jac(2, 0).get_col())
    given = set(conditions[0].sparsity_jac(2, 0).get_col()) if conditions else set()
    ignored = ", ".join(f"v[{i}]" for i in range(count) if i not in used | given)
    if ignored:
        rated = "" if count == d else ", nor is its rate among the rates, which are those of the last components"
        reason = f"without a velocity there is no equation of motion for it{rated}"
        raise ValueError(f"the lagrangian ignores {ignored}: {reason}")
    for i in sorted(i for i in used if i >= count):
        raise ValueError(f"the lagrangian depends on v[{i}], but x[{i}] follows a rate and has no momentum")
    return function


def integrals(name: str, value: Any, made: Made) -> tuple[ca.Function, tuple[float, ...]] | None:
    """(g, values), a callable of t, x, v and the values of its integrals."""
    if value is None:
        return None
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise TypeError(f"{name} must be (g, values), a callable g and the values of its integrals, got {value!r}")
    g = traced(name, value[0], "t x v", "any", made)
    return g, numbers(f"the values of {name}", value[1], g.numel_out(0))


def limited(names: str) -> Reader:
    """(g, lo, hi), a callable of these arguments and the bounds of its values; without values where it is None."""

    def reader(name: str, value: Any, made: Made) -> Any:
        if value is not None and (not isinstance(value, (tuple, list)) or len(value) != 3):
            raise TypeError(f"{name} must be (g, lo, hi), a callable g and the bounds of its values, got {value!r}")
        if value is None or left_out(value[0]):
            return of_zeros(name, lengths(names, made), 0), (), ()
        g = traced(name, value[0], names, "any", made)
        return (g, *bounds(name, (value[1], value[2]), g.numel_out(0)))

    return reader


def within(of: str) -> Reader:
    """(lo, hi) of as many values as "controls" or "x" have, that are not all fixed."""

    def reader(name: str, value: Any, made: Made) -> Bounds:
        size = dimension(made) if of == "x" else made["controls"]
        low, high = bounds(name, value, size)
        if size > 1 and low == high:  # as by a pair for each of two components in place of (lo, hi)
            raise ValueError(
                f"{name} must be (lo, hi), each a number or {size} numbers, not a pair for each component: "
                f"{value!r} leaves nothing free"
            )
        return low, high

    return reader
