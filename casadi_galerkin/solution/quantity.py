"""What is asked of a path, such as a launch velocity, and its error: the difference to paths of higher degree.

A quantity is a callable: a path -> a number, or an array whose shape does not depend on the mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np

from casadi_galerkin.calculus.numbers import real_array
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial

Quantity = Callable[[Any], Any]  # of a path
Solved = TypeVar("Solved")


def check_quantity(of: object) -> None:
    """Refuse what cannot be asked of a path."""
    if not callable(of):
        raise TypeError(f"of must be a callable path -> number or array, got {of!r}")


def check_asked(of: Quantity | None, tol: float | None) -> None:
    """Refuse a quantity without its tolerance."""
    if of is not None:
        check_quantity(of)
        if tol is None:
            raise ValueError("of is what a tolerance is asked of: give tol with it")


def quantity(of: Quantity, path: object) -> np.ndarray:
    """A quantity of a path; refuses what is no number or array, and what is not finite."""
    try:
        value = of(path)
    except Exception as error:
        raise ValueError(f"of raised {error!r}") from error
    checked = real_array("what of returns", value)
    if not checked.size or not np.isfinite(checked).all():
        raise ValueError(f"of must return finite numbers, got {value!r}")
    return checked


def largest_difference(
    of: Quantity, path: Solved, others: Iterable[Solved], rounding: float
) -> tuple[np.ndarray, np.ndarray]:
    """A quantity of a path, and its largest difference to that of others or of the path rounded to relative `rounding`.

    Arrays of equal shapes.
    """
    value = quantity(of, path)
    changes = rounding * np.abs(value)
    for other in (_rounded(path, rounding), *others):
        its = quantity(of, other)
        if its.shape != value.shape:
            raise ValueError(
                f"of must return an array whose shape does not depend on the path, got {value.shape} and {its.shape}"
            )
        changes = np.maximum(changes, np.abs(its - value))
    return value, changes


def size_of(value: np.ndarray) -> float:
    """The size of a quantity, to which its error is relative: that of its largest entry, one where that is zero."""
    return float(np.max(np.abs(value))) or 1.0


def _rounded(path: Any, rounding: float) -> Any:
    """The path with all numbers changed by some part of their sizes; no solution."""
    random, own = np.random.default_rng(0), path.polynomial

    def moved(value: np.ndarray) -> np.ndarray:
        size = np.max(np.nan_to_num(np.abs(value)), axis=-1, initial=0.0, keepdims=True)
        return np.asarray(value + rounding * random.choice((-1.0, 1.0), np.shape(value)) * size)

    numbers = {entry.name: getattr(path, entry.name) for entry in fields(path)}
    changes: dict[str, Any] = {
        name: moved(np.array(value)) for name, value in numbers.items() if isinstance(value, (float, np.ndarray))
    }
    changes["polynomial"] = PiecewisePolynomial(own.mesh, own.nodes, moved(own.values), own.arrivals)
    return replace(path, **changes)
