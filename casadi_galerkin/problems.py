"""What a scene states, checked before anything is solved.

The user's callables are traced once into CasADi Functions of one point; a problem holds these, so it can be
pickled, compared by what it computes, and never calls back into Python during a solve.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import casadi as ca
import numpy as np

Traceable: TypeAlias = Callable[..., Any]  # a casadi Function is one


class Problem(Protocol):
    """What an answer keeps of the problem that it solves."""

    @property
    def lagrangian(self) -> ca.Function:
        """Function (t, x, v) or, with parameters, (t, x, v, p)."""

    @property
    def parameters(self) -> tuple[float, ...] | None:
        """Values of p."""


def trace(name: str, function: Traceable, sizes: Mapping[str, int], rows: int | None) -> ca.Function:
    """Turn a callable of CasADi vectors into a Function with `rows` outputs.

    Parameters
    ----------
    name : what the user calls it, for messages
    function : callable, or a Function that was traced before
    sizes : length of every argument, in order
    rows : expected length of the result; 1 for a scalar, None for a vector of any length

    Raises
    ------
    TypeError, ValueError
        naming what came and what was expected
    """
    if isinstance(function, ca.Function):
        got = [function.numel_in(i) for i in range(function.n_in())]
        if got != list(sizes.values()) or rows not in (None, function.numel_out(0)):
            raise ValueError(f"{name} is a Function of inputs of lengths {got}, expected {list(sizes.values())}")
        return function
    if not callable(function):
        raise TypeError(f"{name} must be a callable of ({', '.join(sizes)}), got {function!r}")
    symbols = [ca.SX.sym(key, size) for key, size in sizes.items()]
    shapes = ", ".join(f"{key} ({size},)" if size > 1 else key for key, size in sizes.items())
    try:
        value = function(*symbols)
    except Exception as error:
        kind = TypeError if isinstance(error, TypeError) else ValueError
        raise kind(
            f"{name} failed when called with CasADi symbols {shapes}: {error}. "
            "Write it with CasADi's functions, such as casadi.cos, not with math or NumPy ones"
        ) from error
    if isinstance(value, (list, tuple)) and rows != 1:
        value = _column(name, value)
    if not isinstance(value, (ca.SX, ca.DM, int, float)) or isinstance(value, bool):
        raise TypeError(f"{name} must return a CasADi expression, got {type(value).__name__}: {value!r}")
    value = ca.SX(value)
    if value.shape != (value.numel() if rows is None else rows, 1):
        expected = "a scalar" if rows == 1 else "a column vector" if rows is None else f"a vector of length {rows}"
        raise ValueError(f"{name} must return {expected}, got shape {value.shape}")
    traced = ca.Function(name, symbols, [ca.densify(value)], list(sizes), ["value"], {"allow_free": True})
    if traced.has_free():
        raise ValueError(f"{name} depends on {', '.join(traced.get_free())} besides its arguments {shapes}")
    constants = (traced.instruction_constant(k) for k in range(traced.n_instructions()) if _is_constant(traced, k))
    if any(math.isnan(constant) for constant in constants):  # float() of a symbol, as in math.cos(x), is NaN
        raise TypeError(
            f"{name} holds a constant that is not a number, as math.cos(x) gives for a CasADi symbol x. "
            "Write it with CasADi's functions, such as casadi.cos, not with math or NumPy ones"
        )
    return traced


def _column(name: str, values: Sequence[Any]) -> Any:
    try:
        return ca.vertcat(*values)
    except NotImplementedError as error:
        raise TypeError(f"{name} must return one CasADi expression a component, got {values!r}") from error


def _is_constant(function: ca.Function, instruction: int) -> bool:
    return bool(function.instruction_id(instruction) == ca.OP_CONST)


def trace_lagrangian(lagrangian: Traceable, dimension: int, parameters: tuple[float, ...] | None) -> ca.Function:
    """Trace L(t, x, v[, p]) and check that it is regular at least by structure: every v[i] must occur."""
    sizes = {"t": 1, "x": dimension, "v": dimension} | ({} if parameters is None else {"p": len(parameters)})
    function = trace("lagrangian", lagrangian, sizes, 1)
    used = function.sparsity_jac(2, 0)
    ignored = [i for i in range(dimension) if not used.has_nz(0, i)]
    if ignored:
        names = ", ".join(f"v[{i}]" for i in ignored)
        raise ValueError(f"the lagrangian ignores {names}: without a velocity there is no equation of motion for it")
    return function


def numbers(name: str, values: Sequence[float], length: int | None = None) -> tuple[float, ...]:
    """Check a sequence of finite numbers."""
    checked = components(name, values, length)
    if None in checked:
        raise ValueError(f"{name} must be all numbers, got {values!r}")
    return tuple(value for value in checked if value is not None)


def components(name: str, values: Sequence[float | None], length: int | None = None) -> tuple[float | None, ...]:
    """Check a sequence of finite numbers in which None stands for a free component."""
    if isinstance(values, ca.DM) and values.is_vector():
        values = values.full().ravel()
    if isinstance(values, (str, bytes)) or not hasattr(values, "__len__") or not hasattr(values, "__getitem__"):
        raise TypeError(f"{name} must be a sequence of numbers, one for each component, got {values!r}")
    if isinstance(values, np.ndarray) and values.ndim != 1:
        raise ValueError(f"{name} must be one-dimensional, got an array of shape {values.shape}")
    if len(values) == 0 or (length is not None and len(values) != length):
        raise ValueError(f"{name} must have {length or 'at least one'} component(s), got {len(values)}: {values!r}")
    checked = []
    for i in range(len(values)):
        value = values[i]
        if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating, type(None))):
            raise TypeError(f"{name}[{i}] must be a number or None, got {value!r}")
        number = None if value is None else float(value)
        if number is not None and not np.isfinite(number):
            raise ValueError(f"{name}[{i}] must be finite, got {number}")
        checked.append(number)
    return tuple(checked)


def time_span(value: Sequence[float]) -> tuple[float, float]:
    """Check (t_0, t_N) with t_0 < t_N."""
    start, end = numbers("t_span", value, 2)
    if end <= start:
        raise ValueError(f"t_span must increase, got ({start}, {end})")
    return start, end


@dataclass(frozen=True)
class BoundaryProblem:
    """A path between two configurations that makes the action ∫ L(t, x, dx/dt) dt stationary.

    Parameters
    ----------
    lagrangian : callable (t, x, v) or, with parameters, (t, x, v, p) -> scalar
        t scalar, x and v CasADi vectors of shape (d,), p of shape (len(parameters),); written with CasADi functions
    t_span : (t_0, t_N), in the unit of time of the Lagrangian
    start, end : d numbers each, in the units of x; None leaves the component free, with zero momentum there
        (natural boundary condition)
    parameters : numbers passed to the Lagrangian as p; default none
    periodic : whether x(t_N) = x(t_0) with equal momenta; `start` may fix components of that point, `end` is left out

    Raises
    ------
    TypeError, ValueError
        naming what came and what was expected

    Examples
    --------
    >>> BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), start=[0.0], end=[1.0]).dimension
    1
    """

    lagrangian: ca.Function
    t_span: tuple[float, float]
    start: tuple[float | None, ...]
    end: tuple[float | None, ...]
    parameters: tuple[float, ...] | None
    periodic: bool

    def __init__(
        self,
        lagrangian: Traceable,
        t_span: Sequence[float],
        start: Sequence[float | None],
        end: Sequence[float | None] | None = None,
        parameters: Sequence[float] | None = None,
        periodic: bool = False,
    ) -> None:
        if not isinstance(periodic, (bool, np.bool_)):
            raise TypeError(f"periodic must be True or False, got {periodic!r}")
        checked_start = components("start", start)
        dimension = len(checked_start)
        if periodic and end is not None and any(value is not None for value in end):
            raise ValueError(f"a periodic path ends where it starts: leave out end, got {end!r}")
        if end is None and not periodic:
            raise ValueError(f"end must have {dimension} component(s), got None; None is for a periodic path")
        checked_end = (None,) * dimension if end is None else components("end", end, dimension)
        checked_parameters = None if parameters is None else numbers("parameters", parameters)
        values = {
            "lagrangian": trace_lagrangian(lagrangian, dimension, checked_parameters),
            "t_span": time_span(t_span),
            "start": checked_start,
            "end": checked_end,
            "parameters": checked_parameters,
            "periodic": bool(periodic),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def dimension(self) -> int:
        """Number d of coordinates."""
        return len(self.start)

    def varied(
        self,
        t_span: tuple[float, float],
        start: tuple[float | None, ...],
        end: tuple[float | None, ...],
        parameters: tuple[float, ...] | None,
    ) -> BoundaryProblem:
        """Copy with other values that were checked before; unlike ``dataclasses.replace`` it traces nothing."""
        other = object.__new__(type(self))  # copy.copy takes 50 µs
        other.__dict__.update(vars(self), t_span=t_span, start=start, end=end, parameters=parameters)
        return other


@dataclass(frozen=True)
class InitialProblem:
    """A path from a position and a momentum, or velocity, at the start.

    Parameters
    ----------
    lagrangian : callable (t, x, v) or, with parameters, (t, x, v, p) -> scalar, as for `BoundaryProblem`
    t_span : (t_0, t_N), in the unit of time of the Lagrangian
    position : d numbers, x(t_0)
    momentum : d numbers, p(t_0) = ∂L/∂v; or
    velocity : d numbers, v(t_0)
    parameters : numbers passed to the callables as p; default none
    force : callable of the same arguments -> d generalised forces, that do the virtual work F·δx
        (Lagrange-d'Alembert); default none

    Raises
    ------
    TypeError, ValueError
        naming what came and what was expected

    Examples
    --------
    >>> InitialProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), [1.0], velocity=[0.0]).dimension
    1
    """

    lagrangian: ca.Function
    t_span: tuple[float, float]
    position: tuple[float, ...]
    momentum: tuple[float, ...] | None
    velocity: tuple[float, ...] | None
    parameters: tuple[float, ...] | None
    force: ca.Function | None

    def __init__(
        self,
        lagrangian: Traceable,
        t_span: Sequence[float],
        position: Sequence[float],
        momentum: Sequence[float] | None = None,
        velocity: Sequence[float] | None = None,
        parameters: Sequence[float] | None = None,
        force: Traceable | None = None,
    ) -> None:
        checked_position = numbers("position", position)
        d = len(checked_position)
        if (momentum is None) == (velocity is None):
            raise ValueError(f"give either momentum or velocity, got momentum={momentum!r} and velocity={velocity!r}")
        checked_parameters = None if parameters is None else numbers("parameters", parameters)
        values = {
            "lagrangian": trace_lagrangian(lagrangian, d, checked_parameters),
            "t_span": time_span(t_span),
            "position": checked_position,
            "momentum": None if momentum is None else numbers("momentum", momentum, d),
            "velocity": None if velocity is None else numbers("velocity", velocity, d),
            "parameters": checked_parameters,
            "force": None if force is None else _trace_force(force, d, checked_parameters),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def dimension(self) -> int:
        """Number d of coordinates."""
        return len(self.position)


def _trace_force(force: Traceable, dimension: int, parameters: tuple[float, ...] | None) -> ca.Function:
    """Trace F(t, x, v[, p]) -> (d,); with d = 1 a list of one force will do as well."""
    sizes = {"t": 1, "x": dimension, "v": dimension} | ({} if parameters is None else {"p": len(parameters)})
    if not callable(force) or isinstance(force, ca.Function):
        return trace("force", force, sizes, dimension)

    def column(*arguments: ca.SX) -> Any:
        value = force(*arguments)
        return ca.vertcat(*value) if isinstance(value, (list, tuple)) else value

    return trace("force", column, sizes, dimension)
