"""What every problem has in common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import casadi as ca

from casadi_galerkin.calculus.galerkin import Galerkin


class Problem(Protocol):
    """What an answer keeps of the problem that it solves."""

    @property
    def lagrangian(self) -> ca.Function:
        """Function (t, x, v) or, with parameters, (t, x, v, p)."""

    @property
    def force(self) -> ca.Function | None:
        """Function of the same arguments -> (d,), or None."""

    @property
    def constraint(self) -> ca.Function | None:
        """Function (t, x) or, with parameters, (t, x, p) -> (k,), or None."""

    @property
    def parameters(self) -> tuple[float, ...] | None:
        """Values of p."""


def check_types(problem: object, method: object, *kinds: type) -> None:
    """Refuse what is no problem of these kinds, or no method."""
    if not isinstance(problem, kinds):
        expected = " or ".join(kind.__name__ for kind in kinds)
        raise TypeError(f"problem must be a {expected}, got {type(problem).__name__}")
    if not isinstance(method, Galerkin):
        raise TypeError(f"method must be a Galerkin, such as Galerkin(degree=4), got {method!r}")


MOST_SHOWN = 6  # numbers of a repr


def shown(values: Sequence[object] | None) -> str:
    """Numbers in a repr: all of a few, the first of many."""
    if values is None or len(values) <= MOST_SHOWN:
        return repr(values)
    return f"({', '.join(map(repr, values[:MOST_SHOWN]))}, ... {len(values)} in all)"
