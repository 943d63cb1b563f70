"""The user's callables and numbers, checked.

Callables are traced once into CasADi Functions of one point; what holds these can be pickled and compared by what it
computes.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypeAlias

import casadi as ca

Traceable: TypeAlias = Callable[..., Any]  # a casadi Function is one
Rows: TypeAlias = Literal["scalar", "any"]


def trace(name: str, function: Traceable, sizes: Mapping[str, int], rows: int | Rows) -> ca.Function:
    """Turn a callable of CasADi vectors into a Function with `rows` outputs.

    Parameters
    ----------
    name : what the user calls it, for messages
    function : callable, or a Function that was traced before
    sizes : length of every argument, in order
    rows : expected length of the result, which may be a list; "any" for a vector of any length, or "scalar"

    Raises
    ------
    TypeError, ValueError
        naming what came and what was expected
    """
    if isinstance(function, ca.Function):
        got, length = [function.numel_in(i) for i in range(function.n_in())], function.numel_out(0)
        if got != list(sizes.values()) or rows not in ("any", "scalar" if length == 1 else length, length):
            raise ValueError(f"{name} is a Function of inputs of lengths {got}, expected {list(sizes.values())}")
        return function
    if not callable(function):
        raise TypeError(f"{name} must be a callable of ({', '.join(sizes)}), got {function!r}")
    symbols = [ca.SX.sym(key, size) for key, size in sizes.items()]
    shapes = ", ".join(f"{key} ({size},)" if size > 1 else key for key, size in sizes.items())
    value = _called(name, function, dict(zip(sizes, symbols, strict=True)), shapes)
    if isinstance(value, (list, tuple)) and rows != "scalar":
        value = _column(name, value)
    if not isinstance(value, (ca.SX, ca.DM, int, float)) or isinstance(value, bool):
        raise TypeError(f"{name} must return a CasADi expression, got {type(value).__name__}: {value!r}")
    value = ca.SX(value)
    length = value.numel() if rows == "any" else 1 if rows == "scalar" else rows
    if value.shape != (length, 1):
        expected = {"any": "a column vector", "scalar": "a scalar"}.get(str(rows), f"a vector of length {rows}")
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


def _called(name: str, function: Traceable, arguments: Mapping[str, ca.SX], shapes: str) -> Any:
    try:
        return function(*arguments.values())
    except Exception as error:
        if not _takes(function, len(arguments)):
            raise TypeError(f"{name} is called as {name}({', '.join(arguments)}): {error}") from error
        kind = TypeError if isinstance(error, TypeError) else ValueError
        raise kind(
            f"{name} failed when called with CasADi symbols {shapes}: {error}. "
            "Write it with CasADi's functions, such as casadi.cos, not with math or NumPy ones"
        ) from error


def _takes(function: Traceable, count: int) -> bool:
    """Whether a callable can be called with so many arguments, as far as it tells."""
    try:
        inspect.signature(function).bind(*range(count))
    except TypeError:
        return False
    except ValueError:  # it does not tell
        return True
    return True


def _column(name: str, values: Sequence[Any]) -> Any:
    try:
        return ca.vertcat(*values)
    except NotImplementedError as error:
        raise TypeError(f"{name} must return one CasADi expression a component, got {values!r}") from error


def _is_constant(function: ca.Function, instruction: int) -> bool:
    return bool(function.instruction_id(instruction) == ca.OP_CONST)


def _sizes(dimension: int, parameters: tuple[float, ...] | None) -> dict[str, int]:
    """Lengths of t, x, v and, if there are some, parameters p."""
    return {"t": 1, "x": dimension, "v": dimension} | ({} if parameters is None else {"p": len(parameters)})


def trace_lagrangian(lagrangian: Traceable, dimension: int, parameters: tuple[float, ...] | None) -> ca.Function:
    """Trace L(t, x, v[, p]) and check that it is regular at least by structure: every v[i] must occur."""
    function = trace("lagrangian", lagrangian, _sizes(dimension, parameters), "scalar")
    used = function.sparsity_jac(2, 0)
    ignored = [i for i in range(dimension) if not used.has_nz(0, i)]
    if ignored:
        names = ", ".join(f"v[{i}]" for i in ignored)
        raise ValueError(f"the lagrangian ignores {names}: without a velocity there is no equation of motion for it")
    return function


def trace_force(force: Traceable, dimension: int, parameters: tuple[float, ...] | None) -> ca.Function:
    """Trace F(t, x, v[, p]) -> (d,)."""
    return trace("force", force, _sizes(dimension, parameters), dimension)


def with_parameters(function: ca.Function, parameters: tuple[float, ...] | None) -> ca.Function:
    """Put the parameters p, which a callable takes last, into a Function; without parameters it is the same."""
    if parameters is None:
        return function
    symbols = [ca.SX.sym(function.name_in(i), function.size1_in(i)) for i in range(function.n_in() - 1)]
    return ca.Function(function.name(), symbols, [function(*symbols, ca.DM(parameters))])
