"""What a traced callable is made of: what its values depend on, its instructions, and the sizes of its terms."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from typing import TypeVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.numbers import counted

Value = TypeVar("Value", ca.SX, ca.MX)

TIME, POSITIONS, VELOCITIES, CONTROLS = range(4)  # the arguments t, x, v, u of a callable
STEPPING = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_SIGN, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FMOD)


def entries_of(function: ca.Function, argument: int) -> set[int]:
    """Which entries of an argument the values of a Function depend on."""
    return {i for k in range(function.n_out()) for i in function.sparsity_jac(argument, k).get_col()}


def pattern(function: ca.Function, argument: int) -> np.ndarray:
    """Which values of a Function depend on which entries of an argument; (values, entries)."""
    sparsity = function.sparsity_jac(argument, 0)
    depend = np.zeros(sparsity.shape, dtype=bool)
    depend[sparsity.get_triplet()] = True
    return depend


def rows_that_depend(function: ca.Function | None, argument: int, chosen: ArrayLike) -> np.ndarray:
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


def entries_within(function: ca.Function, argument: int, operations: Collection[int]) -> set[int]:
    """Which entries of an argument some operations in a traced Function are applied to, or to what depends on them."""
    held: dict[int, set[int]] = {}
    found: set[int] = set()
    for k in range(function.n_instructions()):
        operation, inputs = function.instruction_id(k), function.instruction_input(k)
        if operation == ca.OP_INPUT:
            entries = {inputs[1]} if inputs[0] == argument else set()
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
