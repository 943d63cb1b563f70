"""Numbers that a user gives, read in one way and checked before anything is solved."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import ArrayLike


def real_array(name: str, values: ArrayLike) -> np.ndarray:
    """Array of floats from whatever NumPy reads as real numbers; TypeError otherwise."""
    try:
        array = np.asarray(values)
    except Exception as error:  # ragged lists, and symbols of other libraries that refuse in their own way
        raise TypeError(f"{name} must be real numbers, got {values!r}") from error
    if array.dtype.kind not in "iuf":
        raise TypeError(f"{name} must be real numbers, got {values!r}")
    return np.array(array, dtype=float)


def numbers(name: str, values: Sequence[float], length: int | None = None) -> tuple[float, ...]:
    """Check a sequence of finite numbers."""
    checked = components(name, values, length)
    if None in checked:
        raise ValueError(f"{name} must be all numbers, got {values!r}")
    return tuple(value for value in checked if value is not None)


def components(name: str, values: Sequence[float | None], length: int | None = None) -> tuple[float | None, ...]:
    """Check a sequence of finite numbers in which None stands for a free component."""
    full = getattr(values, "full", None)
    if callable(full):  # a casadi DM, whose vectors are matrices of one column or row
        array = np.asarray(full())
        values = cast("Sequence[float]", array.ravel() if 1 in array.shape else array)
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
