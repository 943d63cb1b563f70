"""What every problem has in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any, Protocol, TypeVar

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.galerkin import check_method
from casadi_galerkin.calculus.numbers import components, finite, numbers, time_span, times_inside

ENDS = ("start", "end")
END_MOTIONS = ("start_velocity", "end_velocity", "start_momentum", "end_momentum")
VARIED = (*ENDS, "parameters", *END_MOTIONS, "energy")  # what can be varied, where a problem has it


class Problem(Protocol):
    """What an answer keeps of the problem that it solves."""

    @property
    def lagrangian(self) -> ca.Function:
        """Function (t, x, v) or, with parameters, (t, x, v, p)."""

    @property
    def force(self) -> ca.Function | None:
        """Function of the same arguments -> (d,), or None."""

    @property
    def constraint(self) -> ca.Function | None:
        """Function (t, x) or, with parameters, (t, x, p) -> (k,), or None."""

    @property
    def parameters(self) -> tuple[float, ...] | None:
        """Values of p."""

    @property
    def t_span(self) -> tuple[float, float]:
        """Times of the ends."""

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times of joints that every mesh has."""


Stated = TypeVar("Stated", bound=Problem)


def section_times(problem: Problem) -> list[float]:
    """Times of both ends, with those of the breakpoints between them."""
    return [problem.t_span[0], *problem.breakpoints, problem.t_span[1]]


def map_times(times: np.ndarray, own: Sequence[float] | np.ndarray, other: Sequence[float] | np.ndarray) -> np.ndarray:
    """Map times piecewise linearly from `own` marks to `other` ones; by their ends alone if their numbers differ."""
    if len(own) != len(other):
        own, other = [own[0], own[-1]], [other[0], other[-1]]
    return times if np.array_equal(own, other) else np.interp(times, own, other)


def check_kind(problem: object, *kinds: type) -> None:
    """Refuse anything but a problem of these kinds."""
    if not isinstance(problem, kinds):
        expected = " or ".join(kind.__name__ for kind in kinds)
        raise TypeError(f"problem must be a {expected}, got {type(problem).__name__}")


def with_values(problem: Stated, **values: Any) -> Stated:
    """Copy with other values of some fields, already checked; unlike ``dataclasses.replace`` it traces nothing anew."""
    other = copy(problem)
    vars(other).update(values)
    return other


def check_types(problem: object, method: object, *kinds: type) -> None:
    """Refuse anything but a problem of these kinds and a Galerkin method."""
    check_kind(problem, *kinds)
    check_method(method)


def with_changes(problem: Stated, changes: Mapping[str, Any], t_span: Sequence[float] | None) -> Stated:
    """Copy with another time span around the breakpoints, and other values by name.

    They have None exactly where the problem has None; a value that is None as a whole changes nothing.  Where nothing
    is given, it is the problem itself.
    """
    span = problem.t_span if t_span is None else time_span(t_span)
    if span == problem.t_span and all(value is None for value in changes.values()):
        return problem
    values: dict[str, Any] = {"t_span": span}
    if span != problem.t_span:
        times_inside("breakpoints", problem.breakpoints, span)
    for name, value in changes.items():
        if name not in VARIED:
            raise ValueError(f"what can be varied is {', '.join(VARIED)}, got {name}={value!r}")
        if value is None:
            continue
        before = getattr(problem, name, None)
        if before is None:
            raise ValueError(f"the problem has no {name}, got {name}={value!r}")
        if isinstance(before, float):
            values[name] = finite(name, value)
        elif name == "parameters":
            values[name] = numbers(name, value, len(before))
        else:
            values[name] = components(name, value, len(before))
            if [a is None for a in values[name]] != [a is None for a in before]:
                raise ValueError(f"{name} must have None where the problem has it, {before}, got {values[name]}")
    return with_values(problem, **values)
