"""What a scene states, checked before anything is solved; it never calls back into Python during a solve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.numbers import components, numbers, time_span, times_inside
from casadi_galerkin.problems.callables import Traceable, trace_lagrangian
from casadi_galerkin.problems.problem import shown


@dataclass(frozen=True, repr=False)
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
    breakpoints : increasing times inside of `t_span` where L is not smooth, such as the knots of tabulated data.  Every
        mesh has them as joints, so that the order holds between them.  Where L jumps in time, take a rule without
        points at the ends of an interval, such as Gauss: a function of time has one value there

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
    breakpoints: tuple[float, ...]

    def __init__(
        self,
        lagrangian: Traceable,
        t_span: Sequence[float],
        start: Sequence[float | None],
        end: Sequence[float | None] | None = None,
        parameters: Sequence[float] | None = None,
        periodic: bool = False,
        breakpoints: Sequence[float] = (),
    ) -> None:
        if not isinstance(periodic, (bool, np.bool_)):
            raise TypeError(f"periodic must be True or False, got {periodic!r}")
        checked_start = components("start", start)
        dimension = len(checked_start)
        checked_end = (None,) * dimension if end is None else components("end", end, dimension)
        if periodic and any(value is not None for value in checked_end):
            raise ValueError(f"a periodic path ends where it starts: leave out end, got {end!r}")
        if end is None and not periodic:
            raise ValueError(f"end must have {dimension} component(s), got None; None is for a periodic path")
        checked_parameters = None if parameters is None else numbers("parameters", parameters)
        values = {
            "lagrangian": trace_lagrangian(lagrangian, dimension, checked_parameters),
            "t_span": time_span(t_span),
            "breakpoints": times_inside("breakpoints", breakpoints, time_span(t_span)),
            "start": checked_start,
            "end": checked_end,
            "parameters": checked_parameters,
            "periodic": bool(periodic),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        """State the problem without its Lagrangian."""
        ends = "periodic, " if self.periodic else f"end {shown(self.end)}, "
        return (
            f"BoundaryProblem of {self.dimension} component(s) on {self.t_span}: start {shown(self.start)}, {ends}"
            f"parameters {shown(self.parameters)}"
        )

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
