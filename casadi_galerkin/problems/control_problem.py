"""The statement of a trajectory optimization: a forced Lagrangian system, a cost, and bounds; checked before any solve.

minimize    ∫ ℓ(t, x, v, u) dt + τ(t_N, x_N, v_N)
subject to  d/dt ∂L/∂v - ∂L/∂x = F(t, x, v, u) + (∂c/∂x)ᵀ λ,     c(t, x) = 0,     dz/dt = ρ(t, x, v, u),
            lo <= g(t, x, v, u) <= hi,     lo <= e(x_0, v_0, x_N, v_N) <= hi,
            (x_+, v_+) = j(x_-, v_-) at breakpoints with jumps,
            ends, waypoints, and bounds on x, u, the durations of the phases and the parameters,

where z are the components of x that follow rates, and c is a holonomic constraint.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from operator import attrgetter
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.numbers import components, counted, times_inside, whole_number
from casadi_galerkin.calculus.roundoff import or_one
from casadi_galerkin.problems import statements
from casadi_galerkin.problems.callables import (
    depends_on_free,
    depends_on_time,
    entries_of,
    is_given,
    pattern,
    rows_that_depend,
    too_many,
    values_given,
)
from casadi_galerkin.problems.constrained_motion import constraint_at_ends, impossible_constraint
from casadi_galerkin.problems.legendre_transform import singular_mass
from casadi_galerkin.problems.problem import BOUNDS, END_MOTIONS, ENDS, Problem, section_times, with_values
from casadi_galerkin.problems.statements import Limited, Statement, is_limited, optional, plain, within


def _breakpoints(name: str, value: Any, problem: ControlProblem) -> tuple[float, ...]:
    """Those that are named, and the times of waypoints and jumps."""
    named = {*times_inside(name, value, problem.t_span), *dict(problem.waypoints), *dict(problem.jumps)}
    return times_inside("breakpoints, waypoints and jumps", sorted(named), problem.t_span)


def _start(name: str, value: Any, problem: ControlProblem) -> tuple[float | None, ...]:
    """D numbers; it may be left out where the number of components is given."""
    count = problem.components
    if count is None and value is None:
        raise TypeError("give start, or the number of `components` where all of it is free, got neither")
    return (None,) * (count or 0) if value is None else components(name, value, count)


def _beside_a_constraint(problem: Any) -> Iterator[str]:
    """What has no place beside a holonomic constraint."""
    if problem.constraint is not None and problem.mechanical < problem.dimension:
        yield "a constraint has no place beside rates: write it as a path_constraint (g, 0, 0)"
    if problem.constraint is not None and (problem.jumps or problem.conditions_on_the_way):
        yield "a problem with a constraint takes no jumps, and no functions as waypoints"


def _functions(problem: Any) -> Iterator[tuple[str, ca.Function]]:
    """All that a problem calls along its path, at its ends and on its way, with its name."""
    for name, value in vars(problem).items():
        function = value[0] if isinstance(value, tuple) and value else value
        if isinstance(function, ca.Function):
            yield name, function
    for t, (g, *_) in problem.conditions_on_the_way.items():
        yield f"the waypoint at t = {t:g}", g
    for t, law in problem.jumps:
        yield f"the jump at t = {t:g}", law


def _velocities_of_rates(problem: Any) -> Iterator[str]:
    """The velocity of a component that follows a rate is that rate: nothing else states it, or depends on it."""
    rated = range(problem.mechanical, problem.dimension)
    for name, function in _functions(problem) if rated else ():
        if name in ("running_cost", "path_constraint", "lagrangian"):
            continue
        velocities = [k for k, argument in enumerate(function.name_in()) if argument[0] == "v"]
        for i in sorted({i for k in velocities for i in entries_of(function, k) if i in rated}):
            yield f"{name} must not depend on v[{i}], the rate of x[{i}]: write that rate instead"
    for name in END_MOTIONS[:2]:
        for i in rated:
            if getattr(problem, name)[i] is not None:
                yield f"x[{i}] follows a rate: {name}[{i}] must be None, got {getattr(problem, name)[i]}"


def _unused(problem: Any) -> Iterator[str]:
    """A control or a free parameter that nothing depends on: its value would be arbitrary."""
    for i in sorted(set(range(problem.controls)).difference(*(entries_of(f, "u") for f in problem.along))):
        yield f"the control u[{i}] occurs in no force, rate, cost or constraint"
    for i in np.flatnonzero(np.less(*(problem.parameter_bounds or ((), ())))).tolist():
        if not any(i in entries_of(f, f.n_in() - 1) for _, f in _functions(problem)):
            yield f"the free parameter p[{i}] occurs in no lagrangian, force, cost or constraint"


def determined(problem: Any) -> Iterator[str]:
    """Without controls, conditions are too many, or too few for a path where there is no cost to choose one by.

    This is no rule for one of several phases, which has more by its links.
    """
    if problem.controls or problem.constraint is not None:
        return
    bounded = {"parameter": problem.parameter_bounds, "duration": problem.duration_bounds}
    needed = {"2 for every component with an equation of motion": 2 * problem.mechanical}
    needed["1 for every rate"] = problem.dimension - problem.mechanical
    for name, sides in bounded.items():
        needed[f"1 for every free {name}"] = int(np.count_nonzero(np.less(*sides or (1, 0))))
    given = {name: sum(value is not None for value in getattr(problem, name)) for name in (*ENDS, *END_MOTIONS[:2])}
    passed = [place[1:] if is_limited(place) else np.transpose(place) for _, place in problem.waypoints]
    for name, sides in (("end_conditions", problem.end_conditions[1:]), *(("waypoints", sides) for sides in passed)):
        given[name] = given.get(name, 0) + int(np.count_nonzero(np.equal(*sides)))
    total, count = sum(needed.values()), sum(given.values())
    if count > total or (count < total and not problem.costs):
        reasons = " and ".join(reason for reason, number in needed.items() if number)
        named = ", ".join(f"{number} by {name}" for name, number in given.items() if number) or "none"
        advice = "leave out some" if count > total else "give more of them, or a cost that chooses among the paths"
        wanted = f"without controls {counted(total, 'condition')} determine the path, {reasons}"
        yield f"{wanted}; got {count}, {named}: {advice}"


def _impulses(problem: Any) -> Iterator[str]:
    """A control that nothing limits, so that it would act as an impulse.

    It has no bounds, no cost and no path constraint depends on it, and forces and rates are linear in it.  What it
    drives then changes at once and at no cost.  This is no optimum where that is given at an end, or where nothing else
    depends on it, as in least time; where all paths cost the same, any path is one.  What a path constraint with equal
    bounds determines is not known; and held controls are no impulses.
    """
    users, limits = [problem.running_cost, problem.limits[0]], problem.limits[1:]
    costs = any(entries_of(problem.running_cost, k) for k in ("x", "v"))
    to_gain = costs or problem.terminal_cost is not None or problem.duration_bounds is not None
    by_x, by_v, by_u = (np.any(np.vstack([pattern(user, k) for user in users]), axis=0) for k in ("x", "v", "u"))
    limited = by_u | np.isfinite([*problem.control_bounds, *problem.control_rate_bounds]).any(axis=0)
    if problem.hold or limited.all() or not to_gain or np.equal(*limits).any():
        return
    rated = np.arange(problem.dimension) >= problem.mechanical
    drives = np.vstack([pattern(rule, "u") for rule in (problem.force, problem.rates)])
    limited |= (drives & (rated & by_v)[:, None]).any(axis=0)
    counts = np.where(rated, by_x | np.isfinite(problem.position_bounds).any(axis=0), by_v)
    velocities = np.array([problem.start_velocity, problem.end_velocity], dtype=float)
    given = np.isfinite(np.where(rated, problem.given_positions, velocities)).any(axis=0)
    symbols = problem.force.sx_in()
    moves = ca.jacobian(ca.vertcat(problem.force(*symbols), problem.rates(*symbols)), symbols[3])
    for i in np.flatnonzero(~limited).tolist():
        impulsive = np.any(drives[:, i] & given) or not np.any(drives[:, i] & counts)
        if impulsive and not ca.depends_on(moves[:, i], symbols[3][i]):
            yield (
                f"nothing limits the control u[{i}], so that it would act as an impulse: neither running_cost nor "
                "path_constraint depends on it, and it has no bounds. Give control_bounds, or a running_cost that "
                f"depends on it, such as 1e-3 * u[{i}] ** 2"
            )


def _given_outside(problem: Any) -> Iterator[str]:
    """A given value, or a guess of a free one, lies outside its bounds by more than rounding."""
    times = section_times(problem)
    stated = [(name, getattr(problem, name), "position_bounds") for name in ENDS]
    stated += [(name, getattr(problem, name), "velocity_bounds") for name in END_MOTIONS[:2]]
    stated += [("start", problem.start, "start_bounds"), ("parameters", problem.parameters, "parameter_bounds")]
    stated += [("t_span", times[:1], "initial_time_bounds"), ("the duration", np.diff(times), "duration_bounds")]
    for name, values, kind in stated:
        phase, size = ("", 0.0) if name != "the duration" else (" of the phase from {} to {}", np.abs(times).max())
        sides = getattr(problem, kind)
        for i, (value, low, high) in enumerate(zip(values, *sides, strict=True) if sides is not None else ()):
            if value is not None and not statements.keeps_to(value, low, high, size):
                place = phase.format(*times[i : i + 2]) if phase else f"[{i}]"
                place = "" if phase and len(times) == 2 else place
                yield f"{name}{place} = {value} lies outside its {kind} [{low}, {high}]"
    (low, high), (least, most) = np.array(problem.start_bounds), np.array(problem.position_bounds)
    for i in np.flatnonzero((low > most) | (high < least)).tolist():
        yield f"start_bounds[{i}] = ({low[i]}, {high[i]}) lie outside the position_bounds of x[{i}]"


def _functions_of_given_ends(problem: Any) -> Iterator[str]:
    """A given state at an end violates a path constraint without controls, or given ends an end condition."""
    u, ends = np.full(problem.controls, np.nan), problem.given_at_ends
    for name, (t, x, v, p) in ends.items():
        where = f"at the {name} whatever the controls"
        yield from _outside(problem.path_constraint, (t, x, v, u, p), "path constraint", where)
    (_, x0, v0, p), (_, x1, v1, _) = ends.values()
    yield from _outside(problem.end_conditions, (x0, v0, x1, v1, p), "end condition", "with the ends given")


def _outside(limited: Limited, given: Sequence[Any], name: str, where: str) -> Iterator[str]:
    """Values of a function outside their bounds where they depend on nothing free, which is NaN."""
    g, low, high = limited
    if not low:  # its sparsity is not looked up in every repeated solve
        return
    values, sizes = values_given(g, given), np.abs([low, high])
    accepted = statements.FEASIBLE * or_one(np.max(np.where(np.isfinite(sizes), sizes, 0.0), axis=0))
    for i in np.flatnonzero(np.isfinite(values)).tolist():  # a ratio may be 0/0 at an end
        if not low[i] - accepted[i] <= values[i] <= high[i] + accepted[i]:
            yield f"{name} {i} is {values[i]} {where}, outside its bounds [{low[i]}, {high[i]}]"


def _conditions_on_free_ends(problem: Any) -> Iterator[str]:
    """More end conditions with equal bounds than the free values of (x_0, v_0, x_N, v_N, p), NaN, can meet."""
    g, low, high = problem.end_conditions
    if not low:
        return
    (_, x0, v0, p), (_, x1, v1, _) = problem.given_at_ends.values()
    uses, free = np.hstack([pattern(g, k) for k in range(g.n_in())]), np.isnan(np.concatenate((x0, v0, x1, v1, p)))
    equal = np.equal(low, high) & (uses & free).any(axis=1)
    yield from too_many("end_conditions with equal bounds", uses[equal], free)


ALWAYS = _beside_a_constraint, _velocities_of_rates, _unused, _impulses, impossible_constraint, _conditions_on_free_ends
OF_VALUES = _given_outside, constraint_at_ends, _functions_of_given_ends


@lru_cache(8)  # so that what is derived from the Function is found again
def _with_velocities(g: ca.Function, rates: ca.Function, bounded: tuple[int, ...]) -> ca.Function:
    """Path constraints, and some velocities; those of the last components are their rates."""
    symbols = g.sx_in()
    rated, v = rates(*symbols), symbols[2]
    velocities = ca.vertcat(v[: v.numel() - rated.numel(), 0], rated)
    return ca.Function("limits", symbols, [ca.vertcat(g(*symbols), velocities[list(bounded)])], g.name_in(), ["value"])


@dataclass(frozen=True, repr=False)
class ControlProblem(Problem):
    """The cheapest path of a controlled Lagrangian system between two states.

    Parameters
    ----------
    lagrangian : callable (t, x, v) -> scalar, as for `BoundaryProblem`; left out where all components follow rates: the
        other callables then leave out the velocities, as rates(t, x, u) and end_conditions(x0, x1)
    t_span : (t_0, t_N); with `duration_bounds` t_N is a guess
    start, end : d positions each, or a number where d = 1; None leaves the component free, as None as a whole does all
    start_velocity, end_velocity : d velocities each; None leaves the component free
    force : callable (t, x, v, u) -> one generalized force for every component but the last k, see `rates`
    running_cost : callable (t, x, v, u) -> scalar, integrated over time
    controls : number of controls, the length of u; without any, callables do not take u
    terminal_cost, initial_cost : callables (t, x, v) -> scalar, added to the cost with the values at the end and start
    start_bounds : (lo, hi), each a scalar or one number per component: of what `start` leaves free
    initial_time_bounds : (lo, hi), frees the time of the start, which t_span guesses; all other times move with it
    control_bounds : (lo, hi), each a scalar or one number per control; held at the quadrature points
    position_bounds : (lo, hi), each a scalar or one number per component; held at the joints and the
        control points between them
    velocity_bounds : (lo, hi), each a scalar or one number per component; held at the quadrature points and, for
        components with an equation of motion, at both ends and beside jumps.  The velocity of a component that follows
        a rate is that rate.  In `path_multipliers` they stand behind the path constraints
    control_rate_bounds : (lo, hi), each a scalar or one number per control: of what a control changes by from each of
        its values to the next, over the time between them.  Its values are those at the quadrature points, or with
        `hold` one for each interval, at its middle.  A control may still jump where phases part
    path_constraint : (g, lo, hi) with g(t, x, v, u) -> scalar or vector; held at the quadrature points;
        what it asks of x and v alone also holds at the end, and at a start that has a cost, unless `end_conditions`
        speak of that.  Where positions keep to a curve, state that as a `constraint`: the velocity at a free end keeps
        to it then, too
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
        these times itself: it leaves out such a breakpoint where nothing else happens
    waypoints : (t, positions) each: a breakpoint at t, where the path has these d positions; each is a number, a pair
        (lo, hi) that it lies within, or None.  Or (t, (g, lo, hi)) with g(x, v) -> scalar or vector within bounds there
    jumps : (t, law) each: a breakpoint at t, where law(x, v) -> (x, v) says how the path goes on, as where a stage is
        dropped or a ball bounces; a waypoint at that time is passed before the jump.  What it returns for the velocity
        of a component that follows a rate is ignored.  A constant of a phase is a component of rate zero that jumps
    hold : True for controls that are constant on every interval, as hardware holds them
    components : d, where `start` is left out

    Raises
    ------
    TypeError, ValueError
        naming what came and what was expected

    Examples
    --------
    >>> ControlProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), start=0.0, end=1.0, start_velocity=0.0, end_velocity=0.0,
    ...     force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u**2 / 2, controls=1).dimension
    1
    >>> ControlProblem(rates=lambda t, x, u: u - x, t_span=(0, 1), start=1.0, controls=1,
    ...     running_cost=lambda t, x, u: x**2 + u**2).mechanical  # of first order
    0
    >>> ball = ControlProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 2), [1.0], [1.0], [0.0], [0.0],
    ...     force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u**2 / 2, controls=1,
    ...     waypoints=[(1.0, [0.0])], jumps=[(1.0, lambda x, v: (x, -0.8 * v))])  # a wall
    >>> ball.breakpoints
    (1.0,)
    """

    lagrangian: statements.Lagrangian = Statement(statements.lagrangian, None)
    t_span: statements.Span = Statement(statements.read_span, None)
    start: statements.Components = Statement(_start, None)
    end: statements.Components = Statement(statements.vector, None)
    start_velocity: statements.Components = Statement(statements.vector, None)
    end_velocity: statements.Components = Statement(statements.vector, None)
    force: statements.Lagrangian = statements.function("t x v u", "mechanical", zeros=True)
    running_cost: statements.Lagrangian = statements.function("t x v u", "scalar", zeros=True)
    controls: Statement[int, int] = Statement(plain(partial(whole_number, least=0)), 0)
    terminal_cost: statements.FunctionOrNone = statements.function("t x v", "scalar")
    control_bounds: statements.Within = within(attrgetter("controls"))
    position_bounds: statements.Within = within(attrgetter("dimension"))
    path_constraint: statements.LimitedValues = statements.limited("t x v u")
    duration_bounds: statements.WithinOrNone = within(lambda problem: len(problem.breakpoints) + 1, fixed=True)
    parameters: statements.NumbersOrNone = Statement(statements.read_parameters, None)
    parameter_bounds: statements.WithinOrNone = within(lambda problem: len(problem.parameters or ()), fixed=True)
    rates: statements.Lagrangian = statements.function("t x v u", "any", zeros=True)
    end_conditions: statements.LimitedValues = statements.limited("x0 v0 x1 v1")
    breakpoints: statements.Times = Statement(_breakpoints, ())
    waypoints: statements.Waypoints = Statement(statements.read_waypoints, ())
    jumps: statements.Jumps = Statement(statements.read_jumps, ())
    hold: Statement[bool, bool] = Statement(statements.read_switch, False)
    constraint: statements.FunctionOrNone = statements.function("t x", "any")
    velocity_bounds: statements.Within = within(attrgetter("dimension"))
    control_rate_bounds: statements.Within = within(attrgetter("controls"))
    initial_cost: statements.FunctionOrNone = statements.function("t x v", "scalar")
    start_bounds: statements.Within = within(attrgetter("dimension"))
    initial_time_bounds: statements.WithinOrNone = within(lambda _: 1, fixed=True)
    components: Statement[int | None, int | None] = Statement(optional(plain(whole_number)), None)
    rules, rules_of_values, rules_of_masses = ALWAYS, OF_VALUES, (singular_mass,)

    @property
    def first_order(self) -> bool:
        """Whether no Lagrangian is stated, also while the problem is read."""
        return not is_given(vars(self).get("_given", vars(self))["lagrangian"])

    @property
    def constraints(self) -> int:
        """Number of holonomic constraints."""
        return 0 if self.constraint is None else self.constraint.numel_out(0)

    @property
    def given_at_ends(self) -> dict[str, tuple[np.ndarray, ...]]:
        """As of any problem; times and parameters may be free."""
        ends, moved = super().given_at_ends, self.initial_time_bounds is not None
        for name, (t, x, v, p) in ends.items():
            moved |= name == "end" and self.duration_bounds is not None
            free = self.parameter_bounds is not None and np.less(*self.parameter_bounds)
            ends[name] = np.where(moved, np.nan, t), x, v, np.where(free, np.nan, p)
        return ends

    @property
    def constraint_satisfied(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Which holonomic constraints, and which of their rates, what is given satisfies at the start and at the end.

        What is given of a position does, and then a given velocity, where the constraint depends on nothing free; and
        rest does wherever the constraint does not depend on time.
        """
        if self.constraint is None:
            return [(np.zeros(0, dtype=bool),) * 2] * 2
        at_rest, ends = ~rows_that_depend(self.constraint, "t", [True]), []
        for t, x, v, p in self.given_at_ends.values():
            satisfied = ~depends_on_free(self.constraint, (t, x, p))
            ends.append((satisfied, (satisfied & ~np.isnan(v).any()) | (at_rest & bool(np.all(v == 0)))))
        return ends

    @property
    def costs(self) -> bool:
        """Whether a cost is stated."""
        return is_given((self.running_cost, self.initial_cost, self.terminal_cost))

    @property
    def limits(self) -> Limited:
        """The path constraints, and behind them the bounded velocities; that of a rated component is its rate."""
        pairs = enumerate(zip(*self.velocity_bounds, strict=True))
        bounded = tuple(i for i, pair in pairs if any(map(math.isfinite, pair)))
        if not bounded:
            return self.path_constraint
        low, high = np.array(self.velocity_bounds)
        g, *sides = self.path_constraint
        lows, highs = ((*side, *values[list(bounded)]) for side, values in zip(sides, (low, high), strict=True))
        return _with_velocities(g, self.rates, bounded), lows, highs

    @property
    def mechanical(self) -> int:
        """Number of components that have an equation of motion; the others follow rates."""
        d, rated = self.dimension, self.rates.numel_out(0)
        if rated > d:
            raise ValueError(f"rates must be those of at most all {counted(d, 'component')}, got {rated} values")
        return d - rated

    @cached_property
    def limits_of_ends(self) -> list[list[int]]:
        """Indices of the path constraints that limit what is free of the start, where that has a cost, and of the end.

        Path constraints hold at the quadrature points, inside of the intervals.  The velocity at a free end is an
        unknown of its own: where it is rewarded, it would exceed its limit on any mesh.  So what no control changes at
        once is limited there, too, but for equations that are as many as the controls, constraints of the time, and of
        the velocity of a component that follows a rate, which is no argument of an end condition.  Nothing is added of
        what end conditions speak of: the same twice has no multipliers, and it may be where g has no derivative.
        """
        (g, low, high), spoken = self.path_constraint, self.end_conditions[0]
        equal, rows = np.equal(low, high), list[list[int]]()
        excluded = equal & (np.count_nonzero(equal) >= self.controls) | rows_that_depend(g, "t", [True])
        excluded |= rows_that_depend(g, "u", np.ones(self.controls, dtype=bool))
        rated = np.arange(self.dimension) >= self.mechanical
        for k, (_, x, v, _) in enumerate(self.given_at_ends.values()):
            stated_x, stated_v = (pattern(spoken, i).any(axis=0) for i in (2 * k, 2 * k + 1))
            stated = rows_that_depend(g, "x", stated_x) | rows_that_depend(g, "v", stated_v | rated)
            free = rows_that_depend(g, "x", np.isnan(x)) | rows_that_depend(g, "v", np.isnan(v))
            costs = k == 1 or self.initial_cost is not None
            rows.append(np.flatnonzero(free & ~excluded & ~stated).tolist() if costs else [])
        return rows

    @property
    def conditions_at_ends(self) -> Limited:
        """The end conditions, and behind them the path constraints that limit what is free of the ends."""
        (conditions, low, high), (first, last) = self.end_conditions, self.limits_of_ends
        if not first and not last:
            return self.end_conditions
        inputs, (g, *sides) = conditions.sx_in(), self.path_constraint
        x0, v0, x1, v1, *p = inputs
        still = ca.SX.zeros(self.controls)
        added = [g(0.0, x, v, still, *p)[rows] for x, v, rows in ((x0, v0, first), (x1, v1, last)) if rows]
        lows, highs = ([side[i] for i in (*first, *last)] for side in sides)
        stated = ca.densify(ca.vertcat(conditions(*inputs), *added))
        return ca.Function("end_conditions", inputs, [stated]), (*low, *lows), (*high, *highs)

    @property
    def conditions_on_the_way(self) -> dict[float, Limited]:
        """Waypoints that are functions of positions and velocities, by their times."""
        return {t: place for t, place in self.waypoints if is_limited(place)}

    @property
    def along(self) -> list[ca.Function]:
        """The force, rates, running cost and limits, Functions of (t, x, v, u)."""
        return [self.force, self.rates, self.running_cost, self.limits[0]]

    @property
    def autonomous(self) -> bool:
        """Whether nothing along the path depends on time, so that the Hamiltonian is constant between breakpoints."""
        return not depends_on_time(*self.along, self.lagrangian, self.constraint)

    def found(
        self, t_span: tuple[float, float], parameters: tuple[float, ...] | None, breakpoints: tuple[float, ...]
    ) -> ControlProblem:
        """Copy with the times and parameters of a solution, without checks; what was free stays free."""
        moved = dict(zip(section_times(self), [t_span[0], *breakpoints, t_span[1]], strict=True))
        timed = {name: tuple((moved[t], what) for t, what in getattr(self, name)) for name in ("waypoints", "jumps")}
        return with_values(self, t_span=t_span, parameters=parameters, breakpoints=breakpoints, **timed)

    def _another(self, name: str, value: Any) -> Any:
        """Another value of a statement; bounds of velocities are rows, which stay the same."""
        if name not in BOUNDS:
            return super()._another(name, value)
        other = vars(ControlProblem)[name].read(name, value, self)
        now, before = (np.isfinite(sides).any(axis=0).tolist() for sides in (other, getattr(self, name)))
        if name == "velocity_bounds" and now != before:
            raise ValueError(f"{name} must bound the same components as the problem does, {before}, got {now}")
        return other
