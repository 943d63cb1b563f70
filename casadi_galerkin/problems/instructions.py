"""The instructions of an SX Function, applied to other values than numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import casadi as ca

Value = TypeVar("Value", ca.SX, ca.MX)


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
