"""What the values of a traced callable depend on."""

from __future__ import annotations

from collections.abc import Collection

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

TIME, POSITIONS, VELOCITIES, CONTROLS = range(4)  # the arguments t, x, v, u of a callable
STEPPING = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_SIGN, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FMOD)


def entries_of(function: ca.Function, argument: int) -> set[int]:
    """Which entries of an argument the values of a Function depend on."""
    return {i for k in range(function.n_out()) for i in function.sparsity_jac(argument, k).get_col()}


def pattern(function: ca.Function, argument: int) -> np.ndarray:
    """Which values of a Function depend on which entries of an argument; (values, entries)."""
    return np.array(ca.DM(function.sparsity_jac(argument, 0), 1.0), dtype=bool)


def rows_that_depend(function: ca.Function | None, argument: int, chosen: ArrayLike) -> np.ndarray:
    """Which values of a Function depend on the chosen entries of an argument, (values,); that of None has no values."""
    if function is None:
        return np.zeros(0, dtype=bool)
    depend = np.zeros(function.numel_out(0), dtype=bool)
    rows, entries = (np.array(index, dtype=int) for index in function.sparsity_jac(argument, 0).get_triplet())
    depend[rows[np.asarray(chosen)[entries]]] = True
    return depend


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
