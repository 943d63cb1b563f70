"""What a control problem bounds: positions, controls, durations, parameters and values of functions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.numbers import counted, real_array
from casadi_galerkin.calculus.roundoff import EPS

Limit: TypeAlias = float | Sequence[float]
Bounds: TypeAlias = tuple[tuple[float, ...], tuple[float, ...]]
Limited: TypeAlias = tuple[ca.Function, tuple[float, ...], tuple[float, ...]]  # g, lo, hi

FEASIBLE = 1e-8  # accepted violation relative to the terms compared; IPOPT's optima were measured below 1e-10
AT_BOUND = 1e-6  # distance from a bound, over the size of a value, up to which the value is at the bound
BOUND_ROUNDING = 4 * EPS  # relative excess of a given value over its bound that counts as rounding


def bounds(name: str, value: Any, size: int) -> Bounds:
    """Check a pair (lo, hi), each a scalar or `size` numbers; infinite where there is none."""
    if value is None:
        return (-np.inf,) * size, (np.inf,) * size
    pair = np.atleast_1d(real_array(name, value)) if hasattr(value, "__array__") else value
    if not isinstance(pair, (tuple, list, np.ndarray)) or len(pair) != 2:
        raise TypeError(f"{name} must be a pair (lo, hi), got {value!r}")
    sides = []
    for side, given, none in zip(("lo", "hi"), pair, (-np.inf, np.inf), strict=True):
        array = real_array(f"the {side} of {name}, {none} where there is none,", given)
        if array.size and np.all(array == none):  # as where another number of components is stated
            array = np.array(none)
        if array.shape not in ((), (size,)) or (np.isnan(array) | (array == -none)).any():
            expected = f"a number or {counted(size, 'number')}, {none} where there is none"
            raise ValueError(f"the {side} of {name} must be {expected}, got {given!r}")
        sides.append(np.full(size, array))
    low, high = sides
    if (low > high).any():
        i = int(np.argmax(low > high))
        where = f" in component {i}" if size > 1 else ""
        raise ValueError(f"{name} must have lo <= hi, got {low[i]} and {high[i]}{where}")
    return tuple(low.tolist()), tuple(high.tolist())


def bound_excess(values: np.ndarray, low: ArrayLike, high: ArrayLike) -> np.ndarray:
    """By how much values (n, ...) leave their bounds (n,); zero within."""
    least, most = (np.reshape(side, (-1, *[1] * (values.ndim - 1))) for side in (low, high))
    return np.maximum(np.maximum(least - values, values - most), 0.0)


def keeps_to(value: float, low: float, high: float, size: float = 0.0) -> bool:
    """Whether a value keeps to its bounds, up to rounding of the largest of these, of `size` or of the value."""
    if low <= value <= high:
        return True
    rounded = BOUND_ROUNDING * max(abs(a) for a in (value, low, high, size) if np.isfinite(a))
    return low - rounded <= value <= high + rounded
