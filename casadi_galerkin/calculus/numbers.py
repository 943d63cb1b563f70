"""Numbers that a user gives, read in one way and checked before anything is solved; and numbers in words."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.roundoff import ZERO

OneOrMore: TypeAlias = float | Sequence[float | None]  # of all components, or of the only one

APART = 1e-12  # least relative difference of two given numbers, as of times; what is less is taken for their rounding


def number(value: Any) -> float | None:
    """A number as a float, infinite if it is beyond its range; None if the value is not a number.

    Not a number is whatever has no ``__float__``, a boolean, and a symbol, which float() turns into NaN.
    """
    kind = getattr(getattr(value, "dtype", None), "kind", "f")
    if isinstance(value, bool) or kind not in "iuf" or not hasattr(value, "__float__"):
        return None
    try:
        result = float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf
    except Exception:  # objects with units and symbols of other libraries refuse in their own way
        return None
    return None if math.isnan(result) and not isinstance(value, (float, np.generic, np.ndarray)) else result


def whole(value: Any) -> int | None:
    """A whole number as an int; None if the value is not one, as 4.0 and True are not."""
    try:
        return None if isinstance(value, (bool, np.bool_)) else operator.index(value)
    except TypeError:
        return None


def whole_number(name: str, value: object, least: int = 1) -> int:
    """Check a whole number."""
    checked = whole(value)
    if checked is None:
        raise TypeError(f"{name} must be a whole number, got {value!r}")
    if checked < least:
        raise ValueError(f"{name} must be at least {least}, got {checked}")
    return checked


def finite(name: str, value: object) -> float:
    """Check a finite number."""
    checked = number(value)
    if checked is None or not math.isfinite(checked):
        raise ValueError(f"{name} must be a finite number, got {value!r}")
    return checked


def check_verbose(value: object) -> None:
    """Refuse a `verbose` other than 0, 1 and 2."""
    if not (isinstance(value, (int, np.integer)) and 0 <= value <= 2):
        raise ValueError(f"verbose must be 0, 1 or 2, got {value!r}")


def flag(name: str, value: object) -> bool:
    """Check a boolean."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def checked_index(name: str, value: object, count: int) -> int:
    """Check an index into `count` things, counted from 0."""
    checked = whole(value)
    if checked is None or not 0 <= checked < count:
        raise ValueError(f"{name} must be a whole number from 0 to {count - 1}, got {value!r}")
    return checked


def read_only(values: ArrayLike) -> np.ndarray:
    """A view of an array, through which it cannot be changed."""
    view = np.asarray(values).view()
    view.flags.writeable = False
    return view


def real_array(name: str, values: Any, free: bool = False) -> np.ndarray:
    """Array of floats from whatever holds real numbers, read by position.

    Parameters
    ----------
    name : what the user calls it, for messages
    values : number, sequence, array, pandas Series, or casadi DM; a DM of one column, with `free` also of one row, is
        a vector
    free : whether `values` is a sequence in which None stands for a free component; the array may then be of objects

    Raises
    ------
    TypeError, ValueError
        naming what came, where it stands and what was expected
    """
    convert = getattr(values, "to_numpy", None) or getattr(values, "full", None)  # of a Series, which has labels; of DM
    expected = "a sequence of numbers" if free else "real numbers"
    try:
        given = convert() if callable(convert) else values
        if isinstance(given, Mapping):  # NumPy would take the keys of some
            raise TypeError
        types = set(map(type, given)) if isinstance(given, (list, tuple)) else {type(given)}
        kind = None if hasattr(given, "__array__") else object  # of a list NumPy would take True for a number
        array: np.ndarray = np.asarray(given, dtype=kind)
        hides = any(hasattr(part, "mask") for part in types)  # asking `np.ma` itself would import it for all
        masked: Any = np.argwhere(np.ma.getmaskarray(np.ma.array(given, dtype=object))) if hides else ()
    except Exception as error:  # symbols of other libraries refuse in their own way
        raise TypeError(f"{name} must be {expected}, got {values!r}") from error
    if len(masked):
        raise ValueError(f"{name} must have no masked values, got one{_place(masked[0])}")
    if free and array.ndim == 0:
        raise TypeError(f"{name} must be {expected}, got {values!r}")
    if array.dtype.kind in "iuf" or types == {float}:
        result = np.array(array, dtype=float)
    else:
        result = np.empty(array.shape, dtype=object)
        for index, value in np.ndenumerate(array):
            result[index] = number(value)
            if result[index] is None and not (free and value is None):
                words = f"{name}{list(index)} must be a number" if free else f"{name} must be {expected}"
                raise TypeError(f"{words}, got {value!r}" + ("" if free else _place(index)))
        result = result if None in result else result.astype(float)
    vector = array.ndim == 2 and (array.shape[1] == 1 or (free and array.shape[0] == 1))
    return result.ravel() if vector and hasattr(values, "full") else result


def _place(index: Sequence[int] | np.ndarray) -> str:
    """Where an entry stands, such as " at [0, 1]"."""
    return f" at {[int(i) for i in index]}" if len(index) else ""


def components(name: str, values: OneOrMore, length: int | None = None) -> tuple[float | None, ...]:
    """Check a sequence of finite numbers in which None stands for a free component; one component may be a number."""
    only = None if hasattr(values, "__len__") else number(values)
    array = real_array(name, values if only is None else [only], free=True)
    if array.ndim != 1:
        raise ValueError(f"{name} must be one-dimensional, got an array of shape {array.shape}")
    if len(array) == 0 or (length is not None and len(array) != length):
        expected = counted(length, "component") if length else "components"
        raise ValueError(f"{name} must have {expected}, got {len(array)}: {values!r}")
    checked = tuple(array.tolist())
    for i, value in enumerate(checked):
        if value is not None and not math.isfinite(value):
            raise ValueError(f"{name}[{i}] must be finite, got {value}")
    return checked


def numbers(name: str, values: OneOrMore, length: int | None = None) -> tuple[float, ...]:
    """Check a sequence of finite numbers."""
    checked = components(name, values, length)
    if None in checked:
        raise ValueError(f"{name} must be all numbers, got {values!r}")
    return tuple(value for value in checked if value is not None)


def time_span(value: Sequence[float]) -> tuple[float, float]:
    """Check (t_0, t_N) with t_0 < t_N."""
    if np.size(given := real_array("t_span", value, free=True)) > 2:
        raise ValueError(f"t_span must be two times, (t_0, t_N), got {given.size} numbers; joints are given by mesh")
    start, end = numbers("t_span", value, 2)
    if not ZERO < end - start < 1 / ZERO:
        raise ValueError(f"t_span must increase, got ({start}, {end}), by {ZERO:g} to {1 / ZERO:g} units of time")
    return start, end


def times_inside(name: str, values: Sequence[float], span: tuple[float, float]) -> tuple[float, ...]:
    """Check times that increase by more than roundoff inside of a time span; there may be none."""
    times = numbers(name, values) if real_array(name, values, free=True).size else ()
    for early, late in zip((span[0], *times), (*times, span[1]), strict=True) if times else ():
        if late - early <= APART * max(abs(early), abs(late)):
            raise ValueError(f"{name} must increase inside of {span} by more than roundoff, got {times}")
    return times


def told_apart(early: float, late: float) -> tuple[str, str]:
    """Two times in words, with six digits, or as many as it takes to tell them apart."""
    digits = 6 + max(0, int(math.log10(max(abs(early), abs(late)) / (late - early))))
    return f"{early:.{digits}g}", f"{late:.{digits}g}"


def spanned(mesh: np.ndarray) -> str:
    """The time from the first joint to the last in words, such as "[0, 1]"."""
    return "[{}, {}]".format(*told_apart(float(mesh[0]), float(mesh[-1])))


def counted(count: int, what: str) -> str:
    """A number of things in words, such as "1 interval" and "2 intervals"."""
    return f"{count} {what}{'s' * (count != 1)}"
