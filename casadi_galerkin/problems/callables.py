"""Callables of the user, such as L(t, x, v), traced once into CasADi Functions of one point, and checked.

Objects that hold these Functions can be pickled.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from functools import lru_cache
from typing import Any, Literal, TypeAlias, TypeGuard

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.numbers import number

Traceable: TypeAlias = Callable[..., Any]  # a casadi Function is one
Rows: TypeAlias = Literal["scalar", "any"]

TRUTH_VALUES = frozenset({ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR})
ADVICE = (
    "Write it with CasADi's functions of SX, such as casadi.cos, casadi.if_else and casadi.dot(v, v), not with math or "
    "NumPy ones, nor with MX symbols"
)


def trace(
    name: str, function: Traceable, sizes: Mapping[str, int], rows: int | Rows, optional: Collection[str] = ()
) -> ca.Function:
    """Turn a callable of CasADi vectors into a Function with `rows` outputs.

    Parameters
    ----------
    name : its name in messages
    function : callable; a casadi Function is checked like any other, and returned unchanged if it has this layout
    sizes : length of every argument, in order; the callable does not take those of length zero, as without controls
    rows : expected length of the result, which may be a list; "any" for a vector of any length, or "scalar"
    optional : arguments that are left out where the callable names none of them

    Raises
    ------
    TypeError, ValueError
        naming what came and what was expected
    """
    taken: Mapping[str, int] = {key: size for key, size in sizes.items() if size}
    if optional and callable(function):
        few = {key: size for key, size in taken.items() if key not in optional}
        named = not set(_names(function)).isdisjoint(optional)
        taken = taken if (function.n_in() > len(few) if isinstance(function, ca.Function) else named) else few
    shapes = ", ".join(f"{key} ({size},)" if size > 1 else key for key, size in taken.items())
    if isinstance(function, ca.Function):
        taken = sizes if function.n_in() == len(sizes) else taken  # as of a problem whose fields are replaced
        _check_function(name, function, taken, shapes)
    elif not callable(function):
        raise TypeError(f"{name} must be a callable of ({', '.join(taken)}), got {function!r}")
    traced = function if _is_traced(function, sizes, rows) else _traced(name, function, sizes, taken, rows, shapes)
    kinds = [traced.instruction_id(k) for k in range(traced.n_instructions())]
    if ca.OP_CALL in kinds:
        try:
            traced.jacobian()
        except RuntimeError as error:
            raise TypeError(f"{name} calls a casadi Function that has no derivatives, as a Callback alone") from error
    constants = (k for k, kind in enumerate(kinds) if kind == ca.OP_CONST)
    if any(math.isnan(traced.instruction_constant(k)) for k in constants):  # such as float() of a symbol in math.cos(x)
        raise TypeError(
            f"{name} holds a constant that is not a number, as math.cos(x) gives for a CasADi symbol x. {ADVICE}"
        )
    for value in ca.vertsplit(traced(*traced.sx_in())):
        if any(value.is_op(comparison) for comparison in TRUTH_VALUES.intersection(kinds)):
            raise TypeError(
                f"{name} must return numbers, got a comparison, which has no derivative: write x - 1 for x == 1, and "
                "x with the bounds of its values for x <= 1"
            )
    return traced


def _is_traced(function: Traceable, sizes: Mapping[str, int], rows: int | Rows) -> TypeGuard[ca.Function]:
    """Whether a Function needs no tracing: an SX Function from columns to one column, without structural zeros."""
    if not (isinstance(function, ca.Function) and function.is_a("SXFunction")):
        return False
    inputs, output = [function.sparsity_in(i) for i in range(function.n_in())], function.sparsity_out(0)
    shapes = [(size, 1) for size in sizes.values()]
    length = output.size1() if rows == "any" else 1 if rows == "scalar" else rows
    dense = all(sparsity.is_dense() for sparsity in (*inputs, output))
    return dense and [sparsity.shape for sparsity in inputs] == shapes and output.shape == (length, 1)


def _traced(
    name: str, function: Traceable, sizes: Mapping[str, int], taken: Iterable[str], rows: int | Rows, shapes: str
) -> ca.Function:
    """A callable of the arguments that it has `taken` as a Function of all, from columns to one column."""
    _check_signature(name, function, list(taken))
    symbols = {key: ca.SX.sym(key, size) for key, size in sizes.items()}
    copies = {key: symbols[key][:] for key in taken}  # which it may change
    value = _called(name, function, copies, shapes)
    if isinstance(value, (list, tuple, np.ndarray)) and rows != "scalar":
        try:
            value = ca.vertcat(*value)
        except (NotImplementedError, TypeError) as error:
            raise TypeError(f"{name} must return one CasADi expression per component, got {value!r}") from error
    if not isinstance(value, (ca.SX, ca.DM)) and number(value) is None:
        raise TypeError(f"{name} must return a CasADi expression, got {type(value).__name__}: {value!r}")
    value = ca.SX(value) if not isinstance(value, ca.SX) else value
    length = value.numel() if rows == "any" else 1 if rows == "scalar" else rows
    if value.shape != (length, 1):
        expected = {"any": "a column vector", "scalar": "a scalar"}.get(str(rows), f"a vector of length {rows}")
        raise ValueError(f"{name} must return {expected}, got shape {value.shape}")
    value = ca.densify(value)
    names, options = [list(sizes), ["value"]], {"allow_free": True}
    traced = ca.Function(name.replace(" ", "_"), [*symbols.values()], [value], *names, options)
    _refuse_free(name, traced, shapes)
    return traced


def _check_function(name: str, function: ca.Function, sizes: Mapping[str, int], shapes: str) -> None:
    """Refuse a Function with other inputs, with several outputs, or with free symbols."""
    got, expected = [function.numel_in(i) for i in range(function.n_in())], list(sizes.values())
    if got != expected:
        raise ValueError(
            f"{name} is a Function of inputs of lengths {got}, expected {expected} for {shapes}{_about_p(sizes)}"
        )
    if function.n_out() != 1:
        raise ValueError(f"{name} must be a Function of one output, got {function.n_out()}: {function.name_out()}")
    _refuse_free(name, function, shapes)


def _refuse_free(name: str, function: ca.Function, shapes: str) -> None:
    if function.has_free():
        raise ValueError(f"{name} depends on {', '.join(function.get_free())} besides its arguments {shapes}")


def _names(function: Any) -> list[str]:
    """Names of the arguments of a callable, as far as its signature is known."""
    try:
        return list(inspect.signature(function).parameters)
    except (TypeError, ValueError):
        return []


def _check_signature(name: str, function: Traceable, expected: list[str]) -> None:
    """Refuse a callable of other arguments, or of these in another order, as far as its signature is known."""
    try:
        signature = inspect.signature(function)
    except ValueError:  # it has none
        return
    taken = list(signature.parameters)
    swapped = taken != expected and sorted(taken) == sorted(expected)
    if not swapped:
        with suppress(TypeError):
            signature.bind(*expected)
            return
    hint = _about_p(expected) if len(taken) > len(expected) or "p" in expected else ""
    if "u" in taken and "u" not in expected:
        hint = (
            ". Controls u are given to callables of a ControlProblem with `controls`, which is their number, but never "
            "to its lagrangian, its constraint or what it states of the ends"
        )
    order = ", in this order" if swapped else ""
    raise TypeError(f"{name} is called as {name}({', '.join(expected)}){order}, got one of ({', '.join(taken)}){hint}")


def _called(name: str, function: Traceable, arguments: Mapping[str, ca.SX], shapes: str) -> Any:
    try:
        return function(*arguments.values())
    except Exception as error:
        kind = TypeError if isinstance(error, TypeError) else ValueError
        failed = f"{name} failed when called with CasADi symbols {shapes}"
        if isinstance(error, IndexError) or "out of bounds" in str(error).lower():
            counts = ", ".join(f"{key} has {symbol.numel()}" for key, symbol in arguments.items())
            raise ValueError(f"{failed}: an index is out of range of so many components, {counts}") from error
        reason = " ".join(str(error).split()).rstrip(".")  # CasADi breaks and indents its lines
        own = isinstance(error, (NameError, ArithmeticError, LookupError))  # a mistake that is not about symbols
        raise kind(f"{failed}: {reason}" if own else f"{failed}: {reason}. {ADVICE}") from error


def _about_p(arguments: Iterable[str]) -> str:
    """A sentence on why the callable is called with or without parameters p."""
    if "p" in arguments:
        return ". It is called with p because parameters are given"
    return ". If it takes p, give parameters" if "v" in arguments else ""


def depends_on_time(*functions: ca.Function | None) -> bool:
    """Whether the value of one of these Functions depends on its first argument, the time; that of None does not."""
    return any(f is not None and f.sparsity_jac(0, 0).nnz() for f in functions)


def of_zeros(name: str, sizes: Mapping[str, int], rows: int) -> ca.Function:
    """A Function whose values are structurally zero, for a callable that is left out."""
    symbols = [ca.SX.sym(key, size) for key, size in sizes.items()]
    return ca.Function(name, symbols, [ca.SX(rows, 1)], list(sizes), ["value"])


def left_out(function: object) -> bool:
    """Whether it is None, or the Function `of_zeros` that stands for it where a field of a problem is replaced."""
    return function is None or (isinstance(function, ca.Function) and function.n_out() == 1 and not function.nnz_out(0))


@lru_cache(64)
def with_multipliers(function: ca.Function, parameters: int, count: int, integrands: ca.Function | None) -> ca.Function:
    """A callable with `count` multipliers μ after its parameters; with μ·g of integrands g(t, x, v[, p]) added."""
    symbols, mu = function.sx_in(), ca.SX.sym("mu", count)
    added = 0 if integrands is None else ca.dot(mu, integrands(*symbols))
    inputs = [*symbols[:-1], ca.vertcat(symbols[-1], mu)] if parameters else [*symbols, mu]
    return ca.Function(function.name(), inputs, [function(*symbols) + added])


@lru_cache(64)  # so that what is derived from the Function, and kept by it, is found again
def with_parameters(function: ca.Function, parameters: tuple[float, ...] | None) -> ca.Function:
    """Insert the parameters p, the last argument of a callable; without parameters or Function nothing changes."""
    if parameters is None or function is None:
        return function
    symbols = function.sx_in()[:-1]
    return ca.Function(function.name(), symbols, [function(*symbols, ca.DM(parameters))])
