"""What every problem has in common: how it is made of its statements, and varied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import fields
from reprlib import repr as shown
from typing import Any, ClassVar, TypeVar

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.galerkin import check_method
from casadi_galerkin.calculus.numbers import components, counted, finite, numbers, time_span, times_inside
from casadi_galerkin.problems.callables import is_given, with_parameters
from casadi_galerkin.problems.statements import Rule, Statement, check

ENDS = ("start", "end")
END_MOTIONS = ("start_velocity", "end_velocity", "start_momentum", "end_momentum")
UNSAID = "lagrangian", "t_span", "components"  # by the summary of a problem
BOUNDS = "control_bounds", "position_bounds", "velocity_bounds"
VARIED = (*ENDS, "parameters", *END_MOTIONS, "integral_values", "energy")  # what can be varied, where a problem has it


class Stated:
    """What is made of statements: all of them are read, and then looked at by rules.

    Attributes
    ----------
    rules : what is looked at when it is made
    """

    rules: ClassVar[Sequence[Rule]] = ()

    def __post_init__(self) -> None:
        given = vars(self).copy()
        vars(self).clear()
        vars(self)["_given"] = given  # until all of it is read; the classes are frozen
        for name in sorted(given, key=lambda name: callable(given[name])):  # numbers first: they tell what these take
            getattr(self, name)
        del vars(self)["_given"]
        check(self, self.rules)


class Problem(Stated):
    """What all problems state; answers keep the problem that they solve.

    Attributes
    ----------
    lagrangian : Function (t, x, v) or, with parameters, (t, x, v, p)
    force : Function of the same arguments -> (d,), or None
    constraint : Function (t, x) or, with parameters, (t, x, p) -> (k,), or None
    parameters : values of p, or None
    t_span : times of the ends
    breakpoints : times of joints that every mesh has
    rules_of_values, rules_of_masses : what is looked at also where other values, or other parameters, are given
    """

    lagrangian: Statement[Any, ca.Function]
    force: Statement[Any, ca.Function]
    constraint: Statement[Any, ca.Function]
    parameters: Statement[Any, tuple[float, ...] | None]
    t_span: Statement[Any, tuple[float, float]]
    start: Statement[Any, tuple[Any, ...]]
    breakpoints: Statement[Any, tuple[float, ...]]
    rules_of_values: ClassVar[Sequence[Rule]]
    rules_of_masses: ClassVar[Sequence[Rule]] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        check(self, (*self.rules_of_values, *self.rules_of_masses))

    def __repr__(self) -> str:
        """State the problem; its callables by their names alone."""
        stated = {field.name: getattr(self, field.name) for field in fields(self) if field.name not in UNSAID}  # type: ignore
        said = []
        for name, value in stated.items():
            if is_given(value) and value is not False and "bounds" not in name:
                numbers = value[1:] if isinstance(value, tuple) and callable(value[0]) else value
                said.append(name if callable(value) or value is True else f"{name} {shown(numbers)}")
        return f"{type(self).__name__} of {counted(self.dimension, 'component')} on {self.t_span}: {', '.join(said)}"

    @property
    def dimension(self) -> int:
        """Number d of coordinates."""
        return len(self.start)

    @property
    def first_order(self) -> bool:
        """Whether no Lagrangian is stated."""
        return False

    @property
    def mechanical(self) -> int:
        """Number of components that have an equation of motion."""
        return self.dimension

    @property
    def given(self) -> dict[str, tuple[float | None, ...]]:
        """All values that can be varied, by name; None where a component is free."""
        values = {name: getattr(self, name, None) for name in VARIED}
        given = {name: value for name, value in values.items() if is_given(value)}
        return {name: value if isinstance(value, tuple) else (value,) for name, value in given.items()}

    @property
    def given_positions(self) -> np.ndarray:
        """Positions given at start and end, NaN where none is; (2, d)."""
        return np.array([getattr(self, name) for name in ENDS], dtype=float)

    @property
    def given_at_ends(self) -> dict[str, tuple[np.ndarray, ...]]:
        """Time, position, velocity and parameters at the start, and at the end if there is one; NaN where free."""
        ends = {}
        for t, name in zip(self.t_span, ENDS, strict=True):
            if name in vars(self):
                v = vars(self).get(f"{name}_velocity", vars(self).get("velocity")) or (None,) * self.dimension
                values = t, getattr(self, name), v, self.parameters or ()
                ends[name] = tuple(np.array(value, dtype=float) for value in values)
        return ends

    @property
    def numeric(self: Made) -> Made:
        """The problem with the values of its parameters put into its callables, which no longer take any."""
        if self.parameters is None:
            return self

        def put(value: Any) -> Any:
            if isinstance(value, tuple) and value and isinstance(value[0], ca.Function):  # with its bounds
                return put(value[0]), *value[1:]
            return with_parameters(value, self.parameters) if isinstance(value, ca.Function) else value

        return with_values(self, **{name: put(value) for name, value in vars(self).items()} | {"parameters": None})

    def with_multipliers(self: Made, _: Sequence[float] | None = None) -> Made:
        """The problem with multipliers in place of integral conditions, which most problems do not have."""
        return self

    def varied(self: Made, changes: Mapping[str, Any], t_span: Sequence[float] | None = None) -> Made:
        """Copy with other given values.

        Parameters
        ----------
        changes : new values by name, such as start, end or parameters: with None exactly where the problem has None;
            None as a whole changes nothing
        t_span : (t_0, t_N) with the breakpoints inside; default the same
        """
        span = self.t_span if t_span is None else time_span(t_span)
        if span == self.t_span and all(value is None for value in changes.values()):
            return self
        if span != self.t_span:
            times_inside("breakpoints", self.breakpoints, span)
        values = {name: self._another(name, value) for name, value in changes.items() if value is not None}
        if "integral_values" in values:
            values["integral_conditions"] = vars(self)["integral_conditions"][0], values.pop("integral_values")
        other = with_values(self, t_span=span, **values)
        check(other, (*other.rules_of_values, *(other.rules_of_masses if other.parameters != self.parameters else ())))
        return other

    def _another(self, name: str, value: Any) -> Any:
        """Another value of a statement, with None where it has None."""
        if name not in VARIED:
            known = ", ".join(name for name in (*VARIED, *BOUNDS) if hasattr(self, name))
            other = "; other times are given by mesh" * (name == "t_span")
            raise ValueError(f"what can be varied is {known}, got {name}={value!r}{other}")
        before = getattr(self, name, None)
        if before is None:
            raise ValueError(f"the problem has no {name}, got {name}={value!r}")
        if isinstance(before, float):
            return finite(name, value)
        if name in ("parameters", "integral_values"):
            return numbers(name, value, len(before))
        given = components(name, value, len(before))
        if [a is None for a in given] != [a is None for a in before]:
            raise ValueError(f"{name} must have None where the problem has it, {before}, got {given}")
        return given


Copied = TypeVar("Copied", bound=Stated)
Made = TypeVar("Made", bound=Problem)


def section_times(problem: Any) -> list[float]:
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


def with_values(problem: Copied, **values: Any) -> Copied:
    """Copy with other values of some fields, already checked; unlike ``dataclasses.replace`` it traces nothing anew."""
    other = copy(problem)
    vars(other).update(values)
    return other


def check_types(problem: object, method: object, *kinds: type) -> None:
    """Refuse anything but a problem of these kinds and a Galerkin method."""
    check_kind(problem, *kinds)
    check_method(method)
