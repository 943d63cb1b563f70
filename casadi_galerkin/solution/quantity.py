"""Quantities of a path, whose errors are differences to the paths that it is compared with.

A quantity is a callable: a path -> a number, or an array whose shape does not depend on the mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import copy
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
    """A quantity of a path; a TypeError refuses what is no number or array, a ValueError what is not finite."""
    try:
        value = of(path)
    except Exception as error:
        kind = TypeError if isinstance(error, TypeError) else ValueError
        raise kind(f"of raised {error!r}") from error
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
    changes = np.abs(quantity(of, _moved(path, rounding)) - value)
    for other in others:
        its = quantity(of, other)
        if its.shape != value.shape:
            raise ValueError(
                f"of must return an array whose shape does not depend on the path, got {value.shape} and {its.shape}"
            )
        changes = np.maximum(changes, np.abs(its - value))
    if not changes.any() and np.array_equal(quantity(of, _moved(path, 0.1)), value):
        raise ValueError(f"of depends on no unknown of the path: it is {value} on every path")
    return value, changes


def size_of(value: np.ndarray) -> float:
    """The size of a quantity, to which its error is relative: that of its largest entry, one where that is zero."""
    return float(np.max(np.abs(value))) or 1.0


def _moved(path: Any, part: float) -> Any:
    """The path with all numbers changed by some part of their sizes, but given ends and durations; no solution."""
    problem, random = path.problem, np.random.default_rng(0)
    free = [getattr(problem, name, None) is not None for name in ("energy", "duration_bounds")]
    stretch = 1.0 + part * any(free)

    def moved(value: np.ndarray) -> np.ndarray:
        size = np.max(np.abs(value), axis=-1, initial=0.0, keepdims=True)
        return np.asarray(value + part * random.choice((-1.0, 1.0), np.shape(value)) * np.where(size > 0, size, 1.0))

    own = path.polynomial
    values, mesh = moved(own.values), own.mesh[0] + stretch * (own.mesh - own.mesh[0])
    for k, name in enumerate(("start", "end")):
        given = [value is not None for value in getattr(problem, name, None) or [None] * len(values)]
        values[given, -k] = own.values[given, -k]
    changes: dict[str, Any] = {"polynomial": PiecewisePolynomial(mesh, own.nodes, values)}
    for name, value in ((entry.name, getattr(path, entry.name)) for entry in fields(path)):
        if isinstance(value, (float, np.ndarray)):
            changes[name] = moved(np.array(value))
        elif name in ("control", "costate", "path_multipliers") and value is not None:
            changes[name] = copy(value)
            changes[name].__dict__.update(mesh=mesh, values=moved(value.values))
    if getattr(problem, "parameter_bounds", None) is not None:
        changes["problem"] = copy(problem)
        changes["problem"].__dict__["parameters"] = tuple(moved(np.array(problem.parameters)).tolist())
    return replace(path, **changes)
