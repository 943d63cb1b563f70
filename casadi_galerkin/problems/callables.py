"""Callables of the user, such as L(t, x, v), traced once into CasADi Functions of one point, checked, and looked into.

What is looked for is what values depend on, the instructions, and the sizes of terms.  Objects that hold these
Functions can be pickled.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from typing import Any, Literal, TypeAlias, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.numbers import counted, number

Traceable: TypeAlias = Callable[..., Any]  # a casadi Function is one
Rows: TypeAlias = Literal["scalar", "any"]

TRUTH_VALUES = frozenset({ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR})
Value = TypeVar("Value", ca.SX, ca.MX)

STEPPING = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_SIGN, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FMOD)
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
    signature = _signature(function)
    if optional and callable(function):
        few = {key: size for key, size in taken.items() if key not in optional}
        named = signature is not None and not signature.parameters.keys().isdisjoint(optional)
        taken = taken if (function.n_in() > len(few) if isinstance(function, ca.Function) else named) else few
    shapes = ", ".join(f"{key} ({size},)" if size > 1 else key for key, size in taken.items())
    if isinstance(function, ca.Function):
        taken = sizes if function.n_in() == len(sizes) else taken  # as of a problem whose fields are replaced
        _check_function(name, function, taken, shapes)
    elif callable(function):
        _check_signature(name, signature, list(taken))
    else:
        raise TypeError(f"{name} must be a callable of ({', '.join(taken)}), got {function!r}")
    symbols = {key: ca.SX.sym(key, size) for key, size in sizes.items()}
    value = ca.densify(_column(name, function, {key: symbols[key][:] for key in taken}, rows, shapes))
    options = {"allow_free": True}
    traced = ca.Function(name.replace(" ", "_"), [*symbols.values()], [value], list(sizes), ["value"], options)
    if isinstance(function, ca.Function) and str(function).partition(":")[2] == str(traced).partition(":")[2]:
        traced = function  # of these inputs, all dense, and of this output
    _refuse_free(name, traced, shapes)
    _check_values(name, traced)
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


def _check_values(name: str, traced: ca.Function) -> None:
    """Refuse values without derivatives: of Callbacks, of constants that are not numbers, and comparisons."""
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


def _column(name: str, function: Traceable, arguments: Mapping[str, ca.SX], rows: int | Rows, shapes: str) -> ca.SX:
    """The value of a callable of symbols, which it may change, as one column."""
    value = _called(name, function, arguments, shapes)
    if isinstance(value, (list, tuple, np.ndarray)) and rows != "scalar":
        try:
            value = ca.vertcat(*value)
        except (NotImplementedError, TypeError) as error:
            raise TypeError(f"{name} must return one CasADi expression per component, got {value!r}") from error
    if not isinstance(value, (ca.SX, ca.DM)) and number(value) is None:
        raise TypeError(f"{name} must return a CasADi expression, got {type(value).__name__}: {value!r}")
    value = value if isinstance(value, ca.SX) else ca.SX(value)
    length = value.numel() if rows == "any" else 1 if rows == "scalar" else rows
    if value.shape != (length, 1):
        expected = {"any": "a column vector", "scalar": "a scalar"}.get(str(rows), f"a vector of length {rows}")
        raise ValueError(f"{name} must return {expected}, got shape {value.shape}")
    return value


def _signature(function: Any) -> inspect.Signature | None:
    """The arguments of a callable, as far as they are known."""
    try:
        return inspect.signature(function)
    except (TypeError, ValueError):
        return None


def _check_signature(name: str, signature: inspect.Signature | None, expected: list[str]) -> None:
    """Refuse a callable of other arguments, or of these in another order, as far as its signature is known."""
    taken = expected if signature is None else list(signature.parameters)
    swapped = taken != expected and sorted(taken) == sorted(expected)
    if not swapped:
        with suppress(TypeError):
            _ = signature and signature.bind(*expected)
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


def is_given(value: object) -> bool:
    """Whether anything is given: not None, nor a Function `of_zeros` that stands for it, nor a tuple of these alone."""
    if isinstance(value, tuple):
        return any(map(is_given, value))
    zeros = isinstance(value, ca.Function) and value.n_out() == 1 and not value.nnz_out(0)
    return value is not None and not zeros


@lru_cache(64)
def with_multipliers(function: ca.Function, parameters: int, count: int, integrands: ca.Function | None) -> ca.Function:
    """A callable with `count` multipliers μ after its parameters; with μ·g of integrands g(t, x, v[, p]) added."""
    symbols, mu = function.sx_in(), ca.SX.sym("mu", count)
    added = 0 if integrands is None else ca.dot(mu, integrands(*symbols))
    inputs = [*symbols[:-1], ca.vertcat(symbols[-1], mu)] if parameters else [*symbols, mu]
    names = function.name_in() if parameters else [*function.name_in(), "p"]
    return ca.Function(function.name(), inputs, [function(*symbols) + added], names, ["value"])


@lru_cache(64)  # so that what is derived from the Function, and kept by it, is found again
def with_parameters(function: ca.Function, parameters: tuple[float, ...] | None) -> ca.Function:
    """Insert the parameters p, the last argument of a callable; without parameters or Function nothing changes."""
    if parameters is None or function is None:
        return function
    *symbols, _ = function.sx_in()
    values, names = function.call([*symbols, ca.SX(ca.DM(parameters))]), function.name_in()[:-1]
    return ca.Function(function.name(), symbols, values, names, function.name_out())


def _number(function: ca.Function, argument: int | str) -> int:
    return function.index_in(argument) if isinstance(argument, str) else argument


def entries_of(function: ca.Function, argument: int | str) -> set[int]:
    """Which entries of an argument, given by number or name, the values of a Function depend on."""
    number = _number(function, argument)
    return {i for k in range(function.n_out()) for i in function.sparsity_jac(number, k).get_col()}


def pattern(function: ca.Function, argument: int | str) -> np.ndarray:
    """Which values of a Function depend on which entries of an argument; (values, entries)."""
    sparsity = function.sparsity_jac(_number(function, argument), 0)
    depend = np.zeros(sparsity.shape, dtype=bool)
    depend[sparsity.get_triplet()] = True
    return depend


def rows_that_depend(function: ca.Function | None, argument: int | str, chosen: ArrayLike) -> np.ndarray:
    """Which values of a Function depend on the chosen entries of an argument, (values,); that of None has no values."""
    if function is None:
        return np.zeros(0, dtype=bool)
    return np.any(pattern(function, argument)[:, np.asarray(chosen, dtype=bool)], axis=1)


def depends_on_free(function: ca.Function, given: Sequence[np.ndarray]) -> np.ndarray:
    """Which values of a Function depend on anything that is free, NaN in what is given for its arguments; (values,)."""
    arrays = enumerate(given[: function.n_in()])
    return np.any([rows_that_depend(function, k, np.isnan(np.ravel(values))) for k, values in arrays], axis=0)


def values_given(function: ca.Function, given: Sequence[np.ndarray]) -> np.ndarray:
    """Values of a Function, NaN where one depends on anything free."""
    values = np.array(function(*map(np.nan_to_num, given[: function.n_in()]))).ravel()
    return np.where(depends_on_free(function, given), np.nan, values)


def too_many(name: str, uses: np.ndarray, free: np.ndarray) -> Iterator[str]:
    """Say that values (k,), which use entries (k, n), are more than the free ones (n,) of these can meet."""
    rank, values = ca.sprank(ca.sparsify(ca.DM((uses & free).astype(float)))), int(np.count_nonzero(free))
    if rank < len(uses):
        yield (
            f"{name} are {len(uses)}, but only {rank} can be met by the {counted(values, 'value')} free at the ends: "
            "leave out some, or free more with None"
        )


def entries_within(function: ca.Function, argument: int | str, operations: Collection[int]) -> set[int]:
    """Which entries of an argument some operations in a traced Function are applied to, or to what depends on them."""
    held, found = dict[int, set[int]](), set[int]()
    number = _number(function, argument)
    for k in range(function.n_instructions()):
        operation, inputs = function.instruction_id(k), function.instruction_input(k)
        if operation == ca.OP_INPUT:
            entries = {inputs[1]} if inputs[0] == number else set()
        else:
            entries = set().union(*(held.get(i, set()) for i in inputs))
        if operation in operations:
            found |= entries
        if operation != ca.OP_OUTPUT:
            held[function.instruction_output(k)[0]] = entries
    return found


def calls_functions(f: ca.Function) -> bool:
    """Whether an SX Function calls others, whose instructions are not its own."""
    return any(f.instruction_id(k) == ca.OP_CALL for k in range(f.n_instructions()))


def replayed(
    f: ca.Function,
    kind: type[Value],
    given: Sequence[Sequence[Value]],
    each: Callable[[Value], Value] = lambda value: value,
) -> list[list[Value]]:
    """Apply the instructions of an SX Function that calls no other; returns the entries of its outputs.

    Parameters
    ----------
    f : Function with dense outputs
    kind : of the values: SX or MX
    given : entries of the inputs
    each : what becomes of the result of an instruction
    """
    results: list[list[Value]] = [[kind()] * f.numel_out(i) for i in range(f.n_out())]
    work = [kind()] * f.sz_w()
    for k in range(f.n_instructions()):
        operation, source, target = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            results[target[0]][target[1]] = work[source[0]]
            continue
        if operation == ca.OP_CONST:
            value = kind(f.instruction_constant(k))
        elif operation == ca.OP_INPUT:
            value = given[source[0]][source[1]]
        elif len(source) == 1:
            value = kind.unary(operation, work[source[0]])
        else:
            value = kind.binary(operation, work[source[0]], work[source[1]])
        work[target[0]] = each(value)
    return results


def sizes_of_terms(value: ca.SX, symbols: Sequence[ca.SX]) -> ca.SX:
    """Sums of |∂value/∂w| |w| over the symbols, constants and intermediate results w that an expression is made of.

    The rounding of each entry of the expression is some eps of its sum: each w is rounded once.  Terms that are not
    finite, as of sqrt(p) at p = 0, are left out.  What a Function that the expression calls makes of its arguments is
    not seen, and the sums are then the sizes of the values.
    """
    f, errors = ca.Function("expression", symbols, [ca.densify(value)]), list[ca.SX]()
    if calls_functions(f):
        return ca.fabs(ca.densify(value))

    def with_error(result: ca.SX) -> ca.SX:
        errors.append(ca.SX.sym("error"))
        return result * (1 + errors[-1])

    (entries,) = replayed(f, ca.SX, [symbol.nonzeros() for symbol in symbols], with_error)
    rounded = ca.vertcat(*entries)
    relative = ca.vertcat(*errors)
    sizes = ca.fabs(ca.substitute(ca.jacobian(rounded, relative), relative, ca.DM.zeros(len(errors))))
    return ca.densify(ca.sum2(ca.if_else(sizes < np.inf, sizes, 0.0)))
