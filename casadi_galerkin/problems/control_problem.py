"""The statement of a trajectory optimization: a forced Lagrangian system, a cost, and bounds; checked before any solve.

minimize    ∫ ℓ(t, x, v, u) dt + τ(t_N, x_N, v_N)
subject to  d/dt ∂L/∂v - ∂L/∂x = F(t, x, v, u) + (∂c/∂x)ᵀ λ,     c(t, x) = 0,     dz/dt = ρ(t, x, v, u),
            lo <= g(t, x, v, u) <= hi,     lo <= e(x_0, v_0, x_N, v_N) <= hi,
            (x_+, v_+) = j(x_-, v_-) at breakpoints with jumps,
            ends, waypoints, and bounds on x, u, the durations of the phases and the parameters,

where z are the components of x that follow rates, and c is a holonomic constraint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from reprlib import repr as shown
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.numbers import components, counted, flag, numbers, time_span, times_inside, whole_number
from casadi_galerkin.calculus.roundoff import EPS, or_one
from casadi_galerkin.problems.bounds import (
    FEASIBLE,
    Bounds,
    Limit,
    Limited,
    bounds_with_room,
    duration_bounds_of,
    limited_values,
    parameter_bounds_of,
    within_rounding,
)
from casadi_galerkin.problems.callables import (
    Traceable,
    arguments,
    depends_on_time,
    is_of_nothing,
    of_nothing,
    trace,
    trace_if,
    trace_lagrangian,
)
from casadi_galerkin.problems.constrained_motion import check_constraint, check_tangent
from casadi_galerkin.problems.crossings import Crossing, Pairs, Waypoint, is_limited, jumps_of, waypoints_of
from casadi_galerkin.problems.dependence import (
    CONTROLS,
    POSITIONS,
    VELOCITIES,
    check_absolute_values,
    check_controls,
    check_parameters,
    check_rates,
    pattern,
    rows_that_depend,
)
from casadi_galerkin.problems.problem import ENDS, section_times, with_changes, with_values


@dataclass(frozen=True, repr=False)
class ControlProblem:
    """The cheapest path of a controlled Lagrangian system between two states.

    Parameters
    ----------
    lagrangian : callable (t, x, v) -> scalar, as for `BoundaryProblem`; None where all components follow rates
    t_span : (t_0, t_N); with `duration_bounds` t_N is a guess
    start, end : d positions each; None leaves the component free
    start_velocity, end_velocity : d velocities each; None leaves the component free
    force : callable (t, x, v, u) -> one generalized force for every component but the last k, see `rates`
    running_cost : callable (t, x, v, u) -> scalar, integrated over time
    controls : number of controls, the length of u
    terminal_cost : callable (t, x, v) -> scalar, added to the cost with the values at the end
    control_bounds : (lo, hi), each a scalar or one number per control; held at the quadrature points
    position_bounds : (lo, hi), each a scalar or one number per component; held at the joints and the
        control points between them.  An end beyond them by rounding is put on them
    path_constraint : (g, lo, hi) with g(t, x, v, u) -> scalar or vector; held at the quadrature points;
        what it asks of x and v alone also holds at the end of the path, unless `end_conditions` speak of that
    duration_bounds : (lo, hi) with 0 < lo, each a scalar or one number per phase; frees the duration of every phase
    constraint : callable (t, x) -> k values that are zero all along the path (holonomic), as for `BoundaryProblem`; for
        problems without rates, jumps and waypoints that are functions
    parameters : numbers passed as `p`, the last argument of every callable
    parameter_bounds : (lo, hi); frees the parameters within them, `parameters` is then the guess
    rates : callable (t, x, v, u) -> k values: the last k components of x follow dx/dt = rates instead of an equation of
        motion, as a mass, a battery, an integral or an actuator does.  Their velocities given at the ends are None, and
        nothing but the running cost and path constraints may depend on these velocities
    end_conditions : (g, lo, hi) with g(x0, v0, x1, v1) -> scalar or vector of positions and velocities at both ends
    breakpoints : increasing times inside of `t_span` that are joints of every mesh, as where a callable is not smooth
        in time.  Where one jumps, take gauss: a function of time has one value there, and a rule with points at the
        ends of intervals (lobatto, radau) sees one side of the jump.  With `duration_bounds` they part phases, each
        with a free duration of its own, as between the switching times of a bang-bang control.  A tolerance finds
        these times itself: where nothing else happens at such a breakpoint, it comes to the nearest switch
    waypoints : (t, positions) each: a breakpoint at t, where the path has these d positions; each is a number, a pair
        (lo, hi) that it lies within, or None.  Or (t, (g, lo, hi)) with g(x, v) -> scalar or vector within bounds there
    jumps : (t, law) each: a breakpoint at t, where law(x, v) -> (x, v) says how the path goes on, as where a stage is
        dropped or a ball bounces; a waypoint at that time is passed before the jump.  What it returns for the velocity
        of a component that follows a rate is ignored.  A constant of a phase is a component of rate zero that jumps
    hold : True for controls that are constant on every interval, as hardware holds them

    Raises
    ------
    TypeError, ValueError
        naming what came and what was expected

    Examples
    --------
    >>> ControlProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0], [0.0], [0.0],
    ...     force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u**2 / 2, controls=1).dimension
    1
    >>> ball = ControlProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 2), [1.0], [1.0], [0.0], [0.0],
    ...     force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u**2 / 2, controls=1,
    ...     waypoints=[(1.0, [0.0])], jumps=[(1.0, lambda x, v: (x, -0.8 * v))])  # a wall
    >>> ball.breakpoints
    (1.0,)
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
    path_constraint: Limited
    duration_bounds: Bounds | None
    parameters: tuple[float, ...] | None
    parameter_bounds: Bounds | None
    rates: ca.Function
    end_conditions: Limited
    breakpoints: tuple[float, ...]
    waypoints: tuple[tuple[float, Pairs | Limited], ...]
    jumps: tuple[tuple[float, ca.Function], ...]
    hold: bool
    constraint: ca.Function | None

    def __init__(
        self,
        lagrangian: Traceable | None,
        t_span: Sequence[float],
        start: Sequence[float | None],
        end: Sequence[float | None],
        start_velocity: Sequence[float | None],
        end_velocity: Sequence[float | None],
        force: Traceable | None,
        running_cost: Traceable,
        controls: int,
        terminal_cost: Traceable | None = None,
        control_bounds: tuple[Limit, Limit] | None = None,
        position_bounds: tuple[Limit, Limit] | None = None,
        path_constraint: tuple[Traceable, Limit, Limit] | None = None,
        duration_bounds: tuple[Limit, Limit] | None = None,
        parameters: Sequence[float] | None = None,
        parameter_bounds: tuple[Limit, Limit] | None = None,
        rates: Traceable | None = None,
        end_conditions: tuple[Traceable, Limit, Limit] | None = None,
        breakpoints: Sequence[float] = (),
        waypoints: Sequence[Waypoint] = (),
        jumps: Sequence[tuple[float, Traceable]] = (),
        hold: bool = False,
        constraint: Traceable | None = None,
    ) -> None:
        d, count = len(components("start", start)), whole_number("controls", controls)
        given = None if parameters is None else numbers("parameters", parameters)
        ends = {"start": start, "end": end, "start_velocity": start_velocity, "end_velocity": end_velocity}
        sizes, moving = arguments(given, t=1, x=d, v=d, u=count), arguments(given, t=1, x=d, v=d)
        here, both = arguments(given, x=d, v=d), arguments(given, x0=d, v0=d, x1=d, v1=d)
        if is_of_nothing(force):
            lagrangian = force = None
        no_rates = of_nothing("rates", sizes)
        traced_rates = no_rates if rates is None or is_of_nothing(rates) else trace("rates", rates, sizes, "any")
        mechanical = d - traced_rates.numel_out(0)
        if mechanical < 0:
            size = counted(d, "component")
            raise ValueError(f"rates must be those of at most all {size}, got {d - mechanical} values")
        _check_mechanics(mechanical, lagrangian, force)
        within = bounds_with_room("position_bounds", position_bounds, d)
        passed, laws = waypoints_of(waypoints, here, within), jumps_of(jumps, here, mechanical)
        span = time_span(t_span)
        named = {*times_inside("breakpoints", breakpoints, span), *dict(passed), *dict(laws)}
        inner = times_inside("breakpoints, waypoints and jumps", sorted(named), span)
        values: dict[str, Any] = {
            "lagrangian": trace_lagrangian((lambda *_: 0.0) if lagrangian is None else lagrangian, moving, mechanical),
            "t_span": span,
            **{name: components(name, end, d) for name, end in ends.items()},
            "force": of_nothing("force", sizes) if force is None else trace("force", force, sizes, mechanical),
            "running_cost": trace("running_cost", running_cost, sizes, "scalar"),
            "controls": count,
            "terminal_cost": trace_if("terminal_cost", terminal_cost, moving, "scalar"),
            "control_bounds": bounds_with_room("control_bounds", control_bounds, count),
            "position_bounds": within,
            "path_constraint": limited_values("path_constraint", path_constraint, sizes),
            "duration_bounds": duration_bounds_of(duration_bounds, len(inner) + 1),
            "parameters": given,
            "parameter_bounds": parameter_bounds_of(parameter_bounds, given),
            "rates": traced_rates,
            "end_conditions": limited_values("end_conditions", end_conditions, both),
            "breakpoints": inner,
            "waypoints": passed,
            "jumps": laws,
            "hold": flag("hold", hold),
            "constraint": trace_if("constraint", constraint, arguments(given, t=1, x=d), "any"),
        }
        self.__dict__.update(values)  # the class is frozen
        self._check_dependence()
        self._check_given()

    def __repr__(self) -> str:
        """State the problem without its callables."""
        free = (
            "" if self.duration_bounds is None else ", durations of phases from {} to {}".format(*self.duration_bounds)
        )
        others = self.dimension - self.mechanical
        rates = f", {others} of which follow rates," if others else ""
        controls = counted(self.controls, "held control" if self.hold else "control")
        return (
            f"ControlProblem of {counted(self.dimension, 'component')}{rates} and {controls} on "
            f"{self.t_span}{free}:\n"
            f"  start {shown(self.start)}, velocity {shown(self.start_velocity)}\n"
            f"  end {shown(self.end)}, velocity {shown(self.end_velocity)}\n"
            f"  parameters {shown(self.parameters)}"
        )

    @property
    def dimension(self) -> int:
        """Number d of coordinates."""
        return len(self.start)

    @property
    def given_positions(self) -> np.ndarray:
        """Positions given at start and end, NaN where none is; (2, d)."""
        return np.array([self.start, self.end], dtype=float)

    @property
    def constraints(self) -> int:
        """Number of holonomic constraints."""
        return 0 if self.constraint is None else self.constraint.numel_out(0)

    @property
    def moving_constraints(self) -> np.ndarray:
        """Which holonomic constraints depend on time; (constraints,)."""
        return rows_that_depend(self.constraint, 0, [True])

    def determined_constraints(self, end: int) -> np.ndarray:
        """Which holonomic constraints depend at the start, 0, or the end, 1, on no free time and no free parameter."""
        open_ones = np.zeros(self.constraints, dtype=bool)
        if self.parameter_bounds is not None:
            open_ones |= rows_that_depend(self.constraint, 2, np.less(*self.parameter_bounds))
        if end == 1 and self.duration_bounds is not None:
            open_ones |= self.moving_constraints
        return ~open_ones

    @property
    def mechanical(self) -> int:
        """Number of components that have an equation of motion; the others follow rates."""
        return self.force.numel_out(0)

    @property
    def crossings(self) -> tuple[Crossing, ...]:
        """Breakpoints at which the velocity is an unknown: those of jumps, and of waypoints that are functions."""
        conditions, laws = {t: place for t, place in self.waypoints if is_limited(place)}, dict(self.jumps)
        return tuple(Crossing(t, conditions.get(t), laws.get(t)) for t in sorted({*conditions, *laws}))

    @property
    def _along(self) -> list[ca.Function]:
        """The force, rates, running cost and path constraint, Functions of (t, x, v, u)."""
        return [self.force, self.rates, self.running_cost, self.path_constraint[0]]

    @property
    def autonomous(self) -> bool:
        """Whether nothing along the path depends on time, so that the Hamiltonian is constant between breakpoints."""
        return not depends_on_time(*self._along, self.lagrangian, self.constraint)

    def found(
        self, t_span: tuple[float, float], parameters: tuple[float, ...] | None, breakpoints: tuple[float, ...]
    ) -> ControlProblem:
        """Copy with the times and parameters of a solution, without checks; what was free stays free."""
        moved = dict(zip(self.breakpoints, breakpoints, strict=True))
        timed = {name: tuple((moved[t], what) for t, what in getattr(self, name)) for name in ("waypoints", "jumps")}
        return with_values(self, t_span=t_span, parameters=parameters, breakpoints=breakpoints, **timed)

    def varied(self, changes: Mapping[str, Any], t_span: Sequence[float] | None = None) -> ControlProblem:
        """Copy with other ends, velocities or parameters, by name, and other times; see `BoundaryProblem.varied`."""
        other = with_changes(self, changes, t_span)
        if other is not self:
            other._check_given()
        return other

    def _check_dependence(self) -> None:
        """Refuse callables that exclude one another, or depend on arguments that they must not depend on."""
        if self.constraints and self.mechanical < self.dimension:
            raise ValueError("a constraint has no place beside rates: write it as a path_constraint (g, 0, 0)")
        if self.constraints and self.crossings:
            raise ValueError("a problem with a constraint takes no jumps, and no functions as waypoints")
        of_velocities = [
            ("force", self.force, [2]),
            ("rates", self.rates, [2]),
            ("terminal_cost", self.terminal_cost, [2]),
            ("end_conditions", self.end_conditions[0], [1, 3]),
            *((f"the {name} at t = {c.time:g}", f, [1]) for c in self.crossings for name, f in c.functions),
        ]
        with_rates = range(self.mechanical, self.dimension)
        check_rates(of_velocities, with_rates)
        for name in ("start_velocity", "end_velocity"):
            for i in with_rates:
                if getattr(self, name)[i] is not None:
                    raise ValueError(f"x[{i}] follows a rate: {name}[{i}] must be None, got {getattr(self, name)[i]}")
        check_controls(self._along, self.controls)
        self._check_limits()
        check_absolute_values(self.running_cost, self.control_bounds)
        functions = [function for _, function, _ in of_velocities]
        check_parameters([*self._along, *functions, self.lagrangian, self.constraint], self.parameter_bounds)

    def _check_limits(self) -> None:
        """Refuse a control that nothing limits, so that it would act as an impulse.

        Such a control has no bounds, no cost and no path constraint depends on it, and forces and rates are linear in
        it.  What it drives then changes at once and at no cost.  This is no optimum where that is given at an end, or
        where nothing else depends on it, as in least time; where all paths cost the same, any path is one.  What a path
        constraint with equal bounds determines is not known; and held controls are no impulses.
        """
        users, d, rated = [self.running_cost, self.path_constraint[0]], self.dimension, slice(self.mechanical, None)
        costs = pattern(self.running_cost, POSITIONS).any() or pattern(self.running_cost, VELOCITIES).any()
        nothing_to_gain = not costs and self.terminal_cost is None and self.duration_bounds is None
        if self.hold or nothing_to_gain or np.equal(*self.path_constraint[1:]).any():
            return
        drives = np.vstack([pattern(rule, CONTROLS) for rule in (self.force, self.rates)])
        by_x, by_v, by_u = (
            np.any(np.vstack([pattern(user, k) for user in users]), axis=0) for k in (POSITIONS, VELOCITIES, CONTROLS)
        )
        limited = by_u | np.isfinite(self.control_bounds).any(axis=0)
        limited |= np.any(drives[rated] & by_v[rated, None], axis=0)
        bounded = np.isfinite(self.position_bounds).any(axis=0)
        motions = np.append(by_v[: self.mechanical], (by_x | bounded)[rated])
        velocities = np.array([self.start_velocity, self.end_velocity], dtype=float)
        ends = np.where(np.arange(d) < self.mechanical, velocities, self.given_positions)
        given = np.isfinite(ends).any(axis=0)
        *_, u = symbols = self.force.sx_in()[:4]
        p = self.force.sx_in()[4:]
        slopes = ca.jacobian(ca.vertcat(*(rule(*symbols, *p) for rule in (self.force, self.rates))), u)
        for i in np.flatnonzero(~limited):
            impulsive = np.any(drives[:, i] & given) or not np.any(drives[:, i] & motions)
            if impulsive and not ca.depends_on(slopes[:, int(i)], u[int(i)]):
                raise ValueError(
                    f"nothing limits the control u[{i}], so that it would act as an impulse: neither running_cost nor "
                    f"path_constraint depends on it, and it has no bounds. Give control_bounds, or a running_cost that "
                    f"depends on it, such as 1e-3 * u[{i}] ** 2"
                )

    def _check_given(self) -> None:
        """Refuse given values that contradict others; move ends that leave their bounds by rounding to the bounds."""
        ends = self.given_positions
        met = within_rounding(ends, *self.position_bounds, ends[::-1])
        for name, values in zip(("start", "end"), met, strict=True):
            self.__dict__[name] = tuple(None if np.isnan(x) else x for x in values.tolist())
        self._check_ends()
        self._check_guesses()

    def _check_ends(self) -> None:
        low, high = self.position_bounds
        ends = self.given_positions
        velocities = np.array([self.start_velocity, self.end_velocity], dtype=float) * [[1], [-1]]
        beside = within_rounding(ends + np.ptp(self.t_span) * velocities, low, high, ends[::-1])
        for name, values, inside in zip(("start", "end"), ends.tolist(), beside.tolist(), strict=True):
            for i, (value, other) in enumerate(zip(values, inside, strict=True)):
                if value < low[i] or value > high[i]:
                    raise ValueError(f"{name}[{i}] = {value} lies outside its position_bounds [{low[i]}, {high[i]}]")
                if (value == low[i] and other < low[i]) or (value == high[i] and other > high[i]):
                    velocity = getattr(self, f"{name}_velocity")[i]
                    raise ValueError(
                        f"{name}[{i}] = {value} lies on its position_bounds [{low[i]}, {high[i]}], and "
                        f"{name}_velocity[{i}] = {velocity} puts the path outside beside it"
                    )
        check_constraint(self, {name: self.determined_constraints(k) for k, name in enumerate(ENDS)})
        for k, name in enumerate(ENDS):
            self._check_end_state(k, name)
        ends_given = self.start, self.start_velocity, self.end, self.end_velocity
        self._check_values("end condition {} is {} with the ends given", self.end_conditions, ends_given)
        if self.end_conditions[1]:
            self._check_free_ends(np.array(ends_given, dtype=float).ravel())

    def _check_free_ends(self, ends: np.ndarray) -> None:
        """Refuse end conditions that no values of the free ends, NaN of (x_0, v_0, x_N, v_N), can meet together.

        Equations are counted.  What is linear in a single free value is compared with the other limits of this value.
        """
        (g, low, high), d, free = self.end_conditions, self.dimension, np.isnan(ends)
        uses = np.hstack([pattern(g, k) for k in range(g.n_in())])
        open_ones = np.append(free, np.full(uses.shape[1] - len(ends), self.parameter_bounds is not None))
        uses &= open_ones
        equal = np.equal(low, high) & uses.any(axis=1)
        count, rank = int(np.count_nonzero(equal)), ca.sprank(ca.sparsify(ca.DM(uses[equal].astype(float))))
        if rank < count:
            raise ValueError(
                f"end_conditions with equal bounds are {count}, but only {rank} can be met by the "
                f"{counted(int(np.count_nonzero(open_ones)), 'value')} free at the ends: leave out some, or free more "
                "with None"
            )
        symbols, p = ca.SX.sym("ends", len(ends)), [] if self.parameters is None else [self.parameters]
        values = g(*ca.vertsplit(symbols, d), *p)
        slopes = ca.jacobian(values, symbols)
        offsets, steps = map(np.array, ca.Function("at", [symbols], [values, slopes])(np.nan_to_num(ends)))
        limits = np.full((2, 4, d), [[[-np.inf]], [[np.inf]]])
        limits[:, ::2] = np.array(self.position_bounds)[:, None]
        least, most = limits.reshape(2, -1)
        for i in np.flatnonzero(uses.sum(axis=1) == 1).tolist():
            k = int(np.argmax(uses[i]))
            if k >= len(ends) or ca.depends_on(slopes[i, k], symbols[k]):
                continue
            sides = sorted((side - offsets[i, 0]) / steps[i, k] for side in (low[i], high[i]))
            least[k], most[k] = max(least[k], sides[0]), min(most[k], sides[1])
            if least[k] - most[k] > FEASIBLE * max(abs(least[k]), abs(most[k])):
                raise ValueError(
                    f"end condition {i} contradicts the position_bounds or another end condition: together they ask "
                    f"for {('x0', 'v0', 'x1', 'v1')[k // d]}[{k % d}] >= {least[k]:g} and <= {most[k]:g}"
                )

    def _check_end_state(self, end: int, name: str) -> None:
        """Refuse a given state at an end that violates a path constraint without controls, or is not tangent."""
        t, x, v = self.t_span[end], getattr(self, name), getattr(self, f"{name}_velocity")
        if None not in (*x, *v):
            check_tangent(self, f"{name}_velocity", t, x, v, self.determined_constraints(end))
        when = np.nan if end and self.duration_bounds is not None else t
        words = f"path constraint {{}} is {{}} at the {name} whatever the controls"
        self._check_values(words, self.path_constraint, (when, x, v, (np.nan,) * self.controls))

    def _check_values(self, words: str, limited: Limited, given: Sequence[Any]) -> None:
        """Refuse values of a function outside their bounds where they depend on nothing free, which is NaN or None."""
        g, low, high = limited
        if not low:  # its sparsity is not looked up in every repeated solve
            return
        arrays = [np.array(values, dtype=float).ravel() for values in given]
        if self.parameters is not None:
            free = self.parameter_bounds is not None and np.less(*self.parameter_bounds)
            arrays.append(np.where(free, np.nan, self.parameters))
        free_rows = np.any([rows_that_depend(g, k, np.isnan(values)) for k, values in enumerate(arrays)], axis=0)
        values = np.array(g(*map(np.nan_to_num, arrays))).ravel()
        sizes = np.abs([low, high])
        accepted = FEASIBLE * or_one(np.max(np.where(np.isfinite(sizes), sizes, 0.0), axis=0))
        for i in np.flatnonzero(~free_rows & np.isfinite(values)):  # a ratio may be 0/0 at an end
            if not low[i] - accepted[i] <= values[i] <= high[i] + accepted[i]:
                raise ValueError(f"{words.format(i, values[i])}, outside its bounds [{low[i]}, {high[i]}]")

    def _check_guesses(self) -> None:
        if self.duration_bounds is not None:
            times = section_times(self)
            rounded = 2 * EPS * max(map(abs, self.t_span))  # of t_N = t_0 + T, and of the difference
            for k, (low, high) in enumerate(zip(*self.duration_bounds, strict=True)):
                lasts = times[k + 1] - times[k]
                if not low - rounded <= lasts <= high + rounded:
                    what = "t_span" if len(times) == 2 else f"the phase from {times[k]} to {times[k + 1]}"
                    raise ValueError(f"duration_bounds ({low}, {high}) must hold the guess, {what} lasts {lasts}")
        sides = self.parameter_bounds or ((), ())
        for i, (low, value, high) in enumerate(zip(sides[0], self.parameters or (), sides[1], strict=False)):
            if not low <= value <= high:
                raise ValueError(f"parameters[{i}] = {value} lies outside its bounds [{low}, {high}]")


def _check_mechanics(mechanical: int, lagrangian: object, force: object) -> None:
    """Refuse a Lagrangian or a force without a component to move, and components without both."""
    for name, given in (("lagrangian", lagrangian), ("force", force)):
        if given is None and mechanical:
            raise ValueError(f"{name} is None, but {counted(mechanical, 'component')} without rates must move")
        if given is not None and not mechanical:
            raise ValueError(f"all components follow rates: {name} must be None, got {given!r}")
