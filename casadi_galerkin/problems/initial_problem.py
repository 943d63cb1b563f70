"""A path from a position and a momentum, or velocity, at the start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from reprlib import repr as shown
from typing import ClassVar

import casadi as ca

from casadi_galerkin.calculus.numbers import counted, numbers, time_span
from casadi_galerkin.problems.callables import Traceable, arguments, trace_if, trace_lagrangian
from casadi_galerkin.problems.constrained_motion import check_constraint, check_tangent


@dataclass(frozen=True, repr=False)
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
    force : callable of the same arguments -> d generalized forces, that do the virtual work F·δx
        (Lagrange-d'Alembert); default none
    constraint : callable (t, x) -> k < d values that are zero all along the path (holonomic); default none.  `position`
        fulfils it, and `velocity` is tangent to it; of `momentum` the tangent part counts

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
    constraint: ca.Function | None
    breakpoints: ClassVar[tuple[float, ...]] = ()  # which other problems have

    def __init__(
        self,
        lagrangian: Traceable,
        t_span: Sequence[float],
        position: Sequence[float],
        *further: object,
        momentum: Sequence[float] | None = None,
        velocity: Sequence[float] | None = None,
        parameters: Sequence[float] | None = None,
        force: Traceable | None = None,
        constraint: Traceable | None = None,
    ) -> None:
        if further:
            raise TypeError(
                "InitialProblem takes lagrangian, t_span and position in this order, and all else by name, such as "
                f"velocity=[1.0] or momentum=[1.0], got {further[0]!r} as a fourth argument"
            )
        checked_position = numbers("position", position)
        d = len(checked_position)
        if (momentum is None) == (velocity is None):
            raise ValueError(f"give either momentum or velocity, got momentum={momentum!r} and velocity={velocity!r}")
        checked_parameters = None if parameters is None else numbers("parameters", parameters)
        along = arguments(checked_parameters, t=1, x=d, v=d)
        values = {
            "lagrangian": trace_lagrangian(lagrangian, along),
            "t_span": time_span(t_span),
            "position": checked_position,
            "momentum": None if momentum is None else numbers("momentum", momentum, d),
            "velocity": None if velocity is None else numbers("velocity", velocity, d),
            "parameters": checked_parameters,
            "force": trace_if("force", force, along, d),
            "constraint": trace_if("constraint", constraint, arguments(checked_parameters, t=1, x=d), "any"),
        }
        self.__dict__.update(values)  # the class is frozen
        check_constraint(self)
        if self.velocity is not None:
            check_tangent(self, "velocity", self.t_span[0], self.position, self.velocity)

    def __repr__(self) -> str:
        """State the problem without its Lagrangian."""
        start = f"velocity {shown(self.velocity)}" if self.momentum is None else f"momentum {shown(self.momentum)}"
        return (
            f"InitialProblem of {counted(self.dimension, 'component')} on {self.t_span}: "
            f"position {shown(self.position)}, {start}, {'no force' if self.force is None else 'with a force'}, "
            f"{'' if self.constraint is None else 'with a constraint, '}parameters {shown(self.parameters)}"
        )

    @property
    def dimension(self) -> int:
        """Number d of coordinates."""
        return len(self.position)
