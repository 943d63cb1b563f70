"""What a scene states, checked before anything is solved; it never calls back into Python during a solve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np

from casadi_galerkin.tracing import (
    Traceable,
    components,
    numbers,
    time_span,
    trace_force,
    trace_lagrangian,
)


class Problem(Protocol):
    """What an answer keeps of the problem that it solves."""

    @property
    def lagrangian(self) -> ca.Function:
        """Function (t, x, v) or, with parameters, (t, x, v, p)."""

    @property
    def parameters(self) -> tuple[float, ...] | None:
        """Values of p."""


@dataclass(frozen=True)
class BoundaryProblem:
    """A path between two configurations that makes the action ∫ L(t, x, dx/dt) dt stationary.

    Parameters
    ----------
    lagrangian : callable (t, x, v) or, with parameters, (t, x, v, p) -> scalar
        t scalar, x and v CasADi vectors of shape (d,), p of shape (len(parameters),); written with CasADi functions
    t_span : (t_0, t_N), in the unit of time of the Lagrangian
    start, end : d numbers each, in the units of x; None leaves the component free, with zero momentum there
        (natural boundary condition)
    parameters : numbers passed to the Lagrangian as p; default none
    periodic : whether x(t_N) = x(t_0) with equal momenta; `start` may fix components of that point, `end` is left out

    Raises
    ------
    TypeError, ValueError
        naming what came and what was expected

    Examples
    --------
    >>> BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), start=[0.0], end=[1.0]).dimension
    1
    """

    lagrangian: ca.Function
    t_span: tuple[float, float]
    start: tuple[float | None, ...]
    end: tuple[float | None, ...]
    parameters: tuple[float, ...] | None
    periodic: bool

    def __init__(
        self,
        lagrangian: Traceable,
        t_span: Sequence[float],
        start: Sequence[float | None],
        end: Sequence[float | None] | None = None,
        parameters: Sequence[float] | None = None,
        periodic: bool = False,
    ) -> None:
        if not isinstance(periodic, (bool, np.bool_)):
            raise TypeError(f"periodic must be True or False, got {periodic!r}")
        checked_start = components("start", start)
        dimension = len(checked_start)
        if periodic and end is not None and any(value is not None for value in end):
            raise ValueError(f"a periodic path ends where it starts: leave out end, got {end!r}")
        if end is None and not periodic:
            raise ValueError(f"end must have {dimension} component(s), got None; None is for a periodic path")
        checked_end = (None,) * dimension if end is None else components("end", end, dimension)
        checked_parameters = None if parameters is None else numbers("parameters", parameters)
        values = {
            "lagrangian": trace_lagrangian(lagrangian, dimension, checked_parameters),
            "t_span": time_span(t_span),
            "start": checked_start,
            "end": checked_end,
            "parameters": checked_parameters,
            "periodic": bool(periodic),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def dimension(self) -> int:
        """Number d of coordinates."""
        return len(self.start)

    def varied(
        self,
        t_span: tuple[float, float],
        start: tuple[float | None, ...],
        end: tuple[float | None, ...],
        parameters: tuple[float, ...] | None,
    ) -> BoundaryProblem:
        """Copy with other values that were checked before; unlike ``dataclasses.replace`` it traces nothing."""
        other = object.__new__(type(self))  # copy.copy takes 50 µs
        other.__dict__.update(vars(self), t_span=t_span, start=start, end=end, parameters=parameters)
        return other


@dataclass(frozen=True)
class InitialProblem:
    """A path from a position and a momentum, or velocity, at the start.

    Parameters
    ----------
    lagrangian : callable (t, x, v) or, with parameters, (t, x, v, p) -> scalar, as for `BoundaryProblem`
    t_span : (t_0, t_N), in the unit of time of the Lagrangian
    position : d numbers, x(t_0)
    momentum : d numbers, p(t_0) = ∂L/∂v; or
    velocity : d numbers, v(t_0)
    parameters : numbers passed to the callables as p; default none
    force : callable of the same arguments -> d generalised forces, that do the virtual work F·δx
        (Lagrange-d'Alembert); default none

    Raises
    ------
    TypeError, ValueError
        naming what came and what was expected

    Examples
    --------
    >>> InitialProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), [1.0], velocity=[0.0]).dimension
    1
    """

    lagrangian: ca.Function
    t_span: tuple[float, float]
    position: tuple[float, ...]
    momentum: tuple[float, ...] | None
    velocity: tuple[float, ...] | None
    parameters: tuple[float, ...] | None
    force: ca.Function | None

    def __init__(
        self,
        lagrangian: Traceable,
        t_span: Sequence[float],
        position: Sequence[float],
        momentum: Sequence[float] | None = None,
        velocity: Sequence[float] | None = None,
        parameters: Sequence[float] | None = None,
        force: Traceable | None = None,
    ) -> None:
        checked_position = numbers("position", position)
        d = len(checked_position)
        if (momentum is None) == (velocity is None):
            raise ValueError(f"give either momentum or velocity, got momentum={momentum!r} and velocity={velocity!r}")
        checked_parameters = None if parameters is None else numbers("parameters", parameters)
        values = {
            "lagrangian": trace_lagrangian(lagrangian, d, checked_parameters),
            "t_span": time_span(t_span),
            "position": checked_position,
            "momentum": None if momentum is None else numbers("momentum", momentum, d),
            "velocity": None if velocity is None else numbers("velocity", velocity, d),
            "parameters": checked_parameters,
            "force": None if force is None else trace_force(force, d, checked_parameters),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def dimension(self) -> int:
        """Number d of coordinates."""
        return len(self.position)
