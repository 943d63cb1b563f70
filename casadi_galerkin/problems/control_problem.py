"""What a scene of trajectory optimisation states: a forced Lagrangian system, a cost, bounds; checked before any solve.

minimise    ∫ ℓ(t, x, v, u) dt + τ(t_N, x_N, v_N)
subject to  d/dt ∂L/∂v - ∂L/∂x = F(t, x, v, u),     lo <= g(t, x, v, u) <= hi,
            ends, and bounds on x, u, the duration and the parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.numbers import components, numbers, real_array, time_span, whole
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.problems.callables import Traceable, trace, trace_lagrangian
from casadi_galerkin.problems.problem import shown, varied_values

Limit: TypeAlias = float | Sequence[float]
Bounds: TypeAlias = tuple[tuple[float, ...], tuple[float, ...]]


def bounds(name: str, value: tuple[Limit, Limit] | None, size: int) -> Bounds:
    """Check a pair (lo, hi), each a scalar or `size` numbers; infinite where there is none."""
    if value is None:
        return (-np.inf,) * size, (np.inf,) * size
    pair = np.atleast_1d(real_array(name, value)) if hasattr(value, "__array__") else value
    if not isinstance(pair, (tuple, list, np.ndarray)) or len(pair) != 2:
        raise TypeError(f"{name} must be a pair (lo, hi), got {value!r}")
    sides = []
    for side, given, never in zip(("lo", "hi"), pair, (np.inf, -np.inf), strict=True):
        expected = f"the {side} of {name} must be a number or {size} numbers, {-never} where there is none"
        try:
            array = real_array(name, given)
        except TypeError as error:
            raise TypeError(f"{expected}, got {given!r}") from error
        if array.shape not in ((), (size,)):
            raise ValueError(f"{expected}, got shape {array.shape}")
        if np.any(np.isnan(array) | (array == never)):
            raise ValueError(f"the {side} of {name} must not be NaN, nor {never}, got {given!r}")
        sides.append(np.broadcast_to(array, (size,)))
    low, high = sides
    if np.any(low > high):
        i = int(np.argmax(low > high))
        raise ValueError(f"{name} contradict each other in component {i}: lo {low[i]} is above hi {high[i]}")
    return tuple(low.tolist()), tuple(high.tolist())


@dataclass(frozen=True, repr=False)
class ControlProblem:
    """The cheapest path of a controlled Lagrangian system between two states.

    Parameters
    ----------
    lagrangian : callable (t, x, v) -> scalar, as for `BoundaryProblem`
    t_span : (t_0, t_N); with `duration_bounds` t_N is a guess
    start, end : d positions each; None leaves the component free
    start_velocity, end_velocity : d velocities each; None leaves the component free
    force : callable (t, x, v, u) -> d generalised forces
    running_cost : callable (t, x, v, u) -> scalar, integrated over time
    controls : number of controls, the length of u
    terminal_cost : callable (t, x, v) -> scalar, added to the cost with the values at the end
    control_bounds : (lo, hi), each a scalar or one number per control; held at the quadrature points
    position_bounds : (lo, hi), each a scalar or one number per component; held at joints and control points
    path_constraint : (g, lo, hi) with g(t, x, v, u) -> scalar or vector; held at the quadrature points
    duration_bounds : (lo, hi) with 0 < lo; frees the final time
    parameters : numbers passed as `p`, the last argument of every callable
    parameter_bounds : (lo, hi); frees the parameters within them, `parameters` is then the guess

    Raises
    ------
    TypeError, ValueError
        naming what came and what was expected

    Examples
    --------
    >>> ControlProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0], [0.0], [0.0],
    ...     force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u**2 / 2, controls=1).dimension
    1
    """

    lagrangian: ca.Function
    t_span: tuple[float, float]
    start: tuple[float | None, ...]
    end: tuple[float | None, ...]
    start_velocity: tuple[float | None, ...]
    end_velocity: tuple[float | None, ...]
    force: ca.Function
    running_cost: ca.Function
    controls: int
    terminal_cost: ca.Function | None
    control_bounds: Bounds
    position_bounds: Bounds
    path_constraint: tuple[ca.Function, tuple[float, ...], tuple[float, ...]] | None
    duration_bounds: tuple[float, float] | None
    parameters: tuple[float, ...] | None
    parameter_bounds: Bounds | None

    def __init__(
        self,
        lagrangian: Traceable,
        t_span: Sequence[float],
        start: Sequence[float | None],
        end: Sequence[float | None],
        start_velocity: Sequence[float | None],
        end_velocity: Sequence[float | None],
        force: Traceable,
        running_cost: Traceable,
        controls: int,
        terminal_cost: Traceable | None = None,
        control_bounds: tuple[Limit, Limit] | None = None,
        position_bounds: tuple[Limit, Limit] | None = None,
        path_constraint: tuple[Traceable, Limit, Limit] | None = None,
        duration_bounds: tuple[float, float] | None = None,
        parameters: Sequence[float] | None = None,
        parameter_bounds: tuple[Limit, Limit] | None = None,
    ) -> None:
        d, count = len(components("start", start)), _control_count(controls)
        given = None if parameters is None else numbers("parameters", parameters)
        ends = {"start": start, "end": end, "start_velocity": start_velocity, "end_velocity": end_velocity}
        sizes = {"t": 1, "x": d, "v": d, "u": count} | ({} if given is None else {"p": len(given)})
        at_the_end = {name: size for name, size in sizes.items() if name != "u"}
        values: dict[str, Any] = {
            "lagrangian": trace_lagrangian(lagrangian, d, given),
            "t_span": time_span(t_span),
            **{name: components(name, end, d) for name, end in ends.items()},
            "force": trace("force", force, sizes, d),
            "running_cost": trace("running_cost", running_cost, sizes, "scalar"),
            "controls": count,
            "terminal_cost": None
            if terminal_cost is None
            else trace("terminal_cost", terminal_cost, at_the_end, "scalar"),
            "control_bounds": bounds("control_bounds", control_bounds, count),
            "position_bounds": bounds("position_bounds", position_bounds, d),
            "path_constraint": _path_constraint(path_constraint, sizes),
            "duration_bounds": _duration_bounds(duration_bounds),
            "parameters": given,
            "parameter_bounds": _parameter_bounds(parameter_bounds, given),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        self._check_controls()
        self._check_parameters()
        self._check_ends()
        self._check_guesses()

    def __repr__(self) -> str:
        """State the problem without its callables."""
        free = "" if self.duration_bounds is None else f", duration within {self.duration_bounds}"
        return (
            f"ControlProblem of {self.dimension} component(s) and {self.controls} control(s) on {self.t_span}{free}:\n"
            f"  start {shown(self.start)}, velocity {shown(self.start_velocity)}\n"
            f"  end {shown(self.end)}, velocity {shown(self.end_velocity)}\n"
            f"  parameters {shown(self.parameters)}"
        )

    @property
    def constraint(self) -> None:
        """A control problem has no holonomic constraint."""

    @property
    def dimension(self) -> int:
        """Number d of coordinates."""
        return len(self.start)

    def found(self, t_span: tuple[float, float], parameters: tuple[float, ...] | None) -> ControlProblem:
        """Copy with the times and parameters that an optimisation found, still free if they were; checks nothing."""
        other = object.__new__(type(self))  # copy.copy takes 50 µs
        other.__dict__.update(vars(self), t_span=t_span, parameters=parameters)
        return other

    def varied(self, changes: Mapping[str, Any], t_span: tuple[float, float]) -> ControlProblem:
        """Copy with other ends, velocities or parameters, by name, and other times; see `BoundaryProblem.varied`."""
        other = self.found(t_span, self.parameters)
        other.__dict__.update(varied_values(self, changes))
        other._check_ends()
        other._check_guesses()
        return other

    def _check_controls(self) -> None:
        """Refuse a control that nothing depends on: its value would be arbitrary."""
        users = [self.force, self.running_cost, *(self.path_constraint or ())[:1]]
        used = {i for function in users for i in function.sparsity_jac(3, 0).T.row()}
        unused = set(range(self.controls)) - used
        if unused:
            raise ValueError(f"the control u[{min(unused)}] occurs in no force, cost or constraint")

    def _check_parameters(self) -> None:
        """Refuse a free parameter that nothing depends on, for the same reason."""
        users = [self.lagrangian, self.force, self.running_cost, self.terminal_cost, *(self.path_constraint or ())[:1]]
        used = {i for f in users if f is not None for i in f.sparsity_jac(f.n_in() - 1, 0).T.row()}
        for i, (low, high) in enumerate(zip(*(self.parameter_bounds or ((), ())), strict=True)):
            if low < high and i not in used:
                raise ValueError(f"the free parameter p[{i}] occurs in no lagrangian, force, cost or constraint")

    def _check_ends(self) -> None:
        low, high = self.position_bounds
        for name, direction in (("start", 1), ("end", -1)):
            velocities = getattr(self, f"{name}_velocity")
            for i, (value, velocity) in enumerate(zip(getattr(self, name), velocities, strict=True)):
                if value is None:
                    continue
                if not low[i] <= value <= high[i]:
                    raise ValueError(f"{name}[{i}] = {value} lies outside its position_bounds [{low[i]}, {high[i]}]")
                moving = 0.0 if velocity is None else direction * velocity
                if (value == low[i] and moving < 0) or (value == high[i] and moving > 0):
                    raise ValueError(
                        f"{name}[{i}] = {value} lies on its position_bounds [{low[i]}, {high[i]}], and "
                        f"{name}_velocity[{i}] = {velocity} puts the path outside beside it"
                    )
        if self.duration_bounds is None and self.parameter_bounds is None:
            self._check_constraint("start", self.t_span[0])
            self._check_constraint("end", self.t_span[1])

    def _check_constraint(self, name: str, t: float) -> None:
        """Refuse a fully given state at an end that violates a path constraint on which controls have no say."""
        x, v = getattr(self, name), getattr(self, f"{name}_velocity")
        if self.path_constraint is None or None in (*x, *v):
            return
        g, low, high = self.path_constraint
        given = [] if self.parameters is None else [self.parameters]
        values = np.array(g(t, x, v, np.zeros(self.controls), *given)).ravel()
        for i in set(range(len(low))) - set(g.sparsity_jac(3, 0).row()):
            if not low[i] <= values[i] <= high[i]:
                raise ValueError(
                    f"path constraint {i} is {values[i]} at the {name} whatever the controls, outside its bounds "
                    f"[{low[i]}, {high[i]}]"
                )

    def _check_guesses(self) -> None:
        if self.duration_bounds is not None:
            (low, high), duration = self.duration_bounds, self.t_span[1] - self.t_span[0]
            rounded = 2 * EPS * max(map(abs, self.t_span))  # of t_N = t_0 + T, and of the difference
            if not low - rounded <= duration <= high + rounded:
                raise ValueError(f"duration_bounds ({low}, {high}) must hold the guess, t_span lasts {duration}")
        sides = self.parameter_bounds or ((), ())
        for i, (low, value, high) in enumerate(zip(sides[0], self.parameters or (), sides[1], strict=False)):
            if not low <= value <= high:
                raise ValueError(f"parameters[{i}] = {value} lies outside its bounds [{low}, {high}]")


def _control_count(controls: int) -> int:
    count = whole(controls)
    if count is None:
        raise TypeError(f"controls must be the number of controls, got {controls!r}")
    if count < 1:
        raise ValueError(f"a ControlProblem needs at least one control, got {count}; without, see BoundaryProblem")
    return count


def _duration_bounds(given: tuple[float, float] | None) -> tuple[float, float] | None:
    if given is None:
        return None
    (low,), (high,) = bounds("duration_bounds", given, 1)
    if low <= 0:
        raise ValueError(f"duration_bounds must be positive, got ({low}, {high})")
    return low, high


def _parameter_bounds(given: tuple[Limit, Limit] | None, parameters: tuple[float, ...] | None) -> Bounds | None:
    if given is None:
        return None
    if parameters is None:
        raise ValueError("parameter_bounds need parameters, which are the guess")
    return bounds("parameter_bounds", given, len(parameters))


def _path_constraint(
    given: tuple[Traceable, Limit, Limit] | None, sizes: dict[str, int]
) -> tuple[ca.Function, tuple[float, ...], tuple[float, ...]] | None:
    if given is None:
        return None
    if not isinstance(given, (tuple, list)) or len(given) != 3:
        raise TypeError(f"path_constraint must be (g, lo, hi), got {given!r}")
    traced = trace("path_constraint", given[0], sizes, "any")
    return (traced, *bounds("path_constraint", (given[1], given[2]), traced.numel_out(0)))
