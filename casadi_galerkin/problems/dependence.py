"""Checks of what the callables of a control problem depend on: nothing arbitrary, ambiguous, or fatal to a solver."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.problems.bounds import Bounds

TIME, POSITIONS, VELOCITIES, CONTROLS = range(4)  # the arguments t, x, v, u of a callable
STEPPING = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_SIGN, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FMOD)
Used = tuple[str, ca.Function | None, Sequence[int]]  # name, Function, and which of its arguments are velocities


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


def check_rates(users: Iterable[Used], own: range) -> None:
    """Refuse what depends on the velocity of a component that follows a rate, which is that rate."""
    for name, function, velocities in users:
        used = {i for k in velocities if function is not None for i in entries_of(function, k) if i in own}
        if used:
            i = min(used)
            raise ValueError(f"{name} must not depend on v[{i}], the rate of x[{i}]: write that rate instead")


def check_controls(users: Iterable[ca.Function], count: int) -> None:
    """Refuse a control that nothing depends on: its value would be arbitrary."""
    unused = set(range(count)).difference(*(entries_of(function, CONTROLS) for function in users))
    if unused:
        raise ValueError(f"the control u[{min(unused)}] occurs in no force, cost or constraint")


def check_absolute_values(running_cost: ca.Function, bounds: Bounds) -> None:
    """Refuse |u| in the cost where u may change its sign, since a solver that takes derivatives stalls there."""
    low, high = bounds
    for i in sorted(entries_within(running_cost, CONTROLS, (ca.OP_FABS,))):
        if low[i] < 0 < high[i]:
            raise ValueError(
                f"running_cost holds the absolute value of u[{i}], whose derivative jumps at zero: replace u[{i}] "
                "by a - b with two controls a, b >= 0 (control_bounds), and its absolute value by a + b; for that of "
                "another expression e, add e - a + b = 0 as a path_constraint"
            )


def check_parameters(users: Iterable[ca.Function | None], bounds: Bounds | None) -> None:
    """Refuse a free parameter that nothing depends on, for the same reason as a control."""
    if bounds is None:
        return
    given = [function for function in users if function is not None]
    used = set().union(*(entries_of(function, function.n_in() - 1) for function in given))
    for i, (low, high) in enumerate(zip(*bounds, strict=True)):
        if low < high and i not in used:
            raise ValueError(f"the free parameter p[{i}] occurs in no lagrangian, force, cost or constraint")


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
