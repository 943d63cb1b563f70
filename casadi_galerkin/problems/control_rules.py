"""Rules for what a control problem states: nothing arbitrary, contradictory, or fatal to a solver."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.numbers import counted
from casadi_galerkin.calculus.roundoff import or_one
from casadi_galerkin.problems.bounds import FEASIBLE, Limited, keeps_to
from casadi_galerkin.problems.constrained_motion import constraint_at_ends, impossible_constraint
from casadi_galerkin.problems.expressions import (
    CONTROLS,
    POSITIONS,
    VELOCITIES,
    entries_of,
    pattern,
    too_many,
    values_given,
)
from casadi_galerkin.problems.problem import END_MOTIONS, ENDS, section_times
from casadi_galerkin.problems.statements import is_limited


def _beside_a_constraint(problem: Any) -> Iterator[str]:
    """What has no place beside a holonomic constraint."""
    if problem.constraint is not None and problem.mechanical < problem.dimension:
        yield "a constraint has no place beside rates: write it as a path_constraint (g, 0, 0)"
    if problem.constraint is not None and (problem.jumps or problem.conditions_on_the_way):
        yield "a problem with a constraint takes no jumps, and no functions as waypoints"


def _of_velocities(problem: Any) -> list[tuple[str, ca.Function, tuple[int, ...]]]:
    """What must not depend on velocities that are rates: by name, and which arguments are velocities."""
    stated = [
        ("force", problem.force, (2,)),
        ("rates", problem.rates, (2,)),
        ("terminal_cost", problem.terminal_cost, (2,)),
        ("initial_cost", problem.initial_cost, (2,)),
        ("end_conditions", problem.end_conditions[0], (1, 3)),
        *((f"the waypoint at t = {t:g}", g, (1,)) for t, (g, *_) in problem.conditions_on_the_way.items()),
        *((f"the jump at t = {t:g}", law, (1,)) for t, law in problem.jumps),
    ]
    return [(name, function, velocities) for name, function, velocities in stated if function is not None]


def _velocities_of_rates(problem: Any) -> Iterator[str]:
    """The velocity of a component that follows a rate is that rate: nothing else states it, or depends on it."""
    rated = range(problem.mechanical, problem.dimension)
    for name, function, velocities in _of_velocities(problem):
        for i in sorted({i for k in velocities for i in entries_of(function, k) if i in rated}):
            yield f"{name} must not depend on v[{i}], the rate of x[{i}]: write that rate instead"
    for name in ("start_velocity", "end_velocity"):
        for i in rated:
            if getattr(problem, name)[i] is not None:
                yield f"x[{i}] follows a rate: {name}[{i}] must be None, got {getattr(problem, name)[i]}"


def _unused(problem: Any) -> Iterator[str]:
    """A control or a free parameter that nothing depends on: its value would be arbitrary."""
    along = problem.along
    for i in sorted(set(range(problem.controls)).difference(*(entries_of(f, CONTROLS) for f in along))):
        yield f"the control u[{i}] occurs in no force, rate, cost or constraint"
    others = [function for _, function, _ in _of_velocities(problem)]
    users = [f for f in (*along, *others, problem.lagrangian, problem.constraint) if f is not None]
    for i in np.flatnonzero(np.less(*(problem.parameter_bounds or ((), ())))).tolist():
        if not any(i in entries_of(f, f.n_in() - 1) for f in users):
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
    costs = any(entries_of(problem.running_cost, k) for k in (POSITIONS, VELOCITIES))
    to_gain = costs or problem.terminal_cost is not None or problem.duration_bounds is not None
    by_x, by_v, by_u = (
        np.any(np.vstack([pattern(user, k) for user in users]), axis=0) for k in (POSITIONS, VELOCITIES, CONTROLS)
    )
    limited = by_u | np.isfinite([*problem.control_bounds, *problem.control_rate_bounds]).any(axis=0)
    if problem.hold or limited.all() or not to_gain or np.equal(*limits).any():
        return
    rated = np.arange(problem.dimension) >= problem.mechanical
    drives = np.vstack([pattern(rule, CONTROLS) for rule in (problem.force, problem.rates)])
    limited |= (drives & (rated & by_v)[:, None]).any(axis=0)
    counts = np.where(rated, by_x | np.isfinite(problem.position_bounds).any(axis=0), by_v)
    velocities = np.array([problem.start_velocity, problem.end_velocity], dtype=float)
    given = np.isfinite(np.where(rated, problem.given_positions, velocities)).any(axis=0)
    symbols = problem.force.sx_in()
    moves = ca.jacobian(ca.vertcat(problem.force(*symbols), problem.rates(*symbols)), symbols[CONTROLS])
    for i in np.flatnonzero(~limited).tolist():
        impulsive = np.any(drives[:, i] & given) or not np.any(drives[:, i] & counts)
        if impulsive and not ca.depends_on(moves[:, i], symbols[CONTROLS][i]):
            yield (
                f"nothing limits the control u[{i}], so that it would act as an impulse: neither running_cost nor "
                "path_constraint depends on it, and it has no bounds. Give control_bounds, or a running_cost that "
                f"depends on it, such as 1e-3 * u[{i}] ** 2"
            )


def _given_outside(problem: Any) -> Iterator[str]:
    """A given value, or a guess of a free one, lies outside its bounds by more than rounding."""
    times = section_times(problem)
    lasting = [end - begin for begin, end in pairwise(times)]
    stated = [(name, getattr(problem, name), "position_bounds") for name in ENDS]
    stated += [(name, getattr(problem, name), "velocity_bounds") for name in END_MOTIONS[:2]]
    stated += [("start", problem.start, "start_bounds"), ("parameters", problem.parameters, "parameter_bounds")]
    stated += [("t_span", times[:1], "initial_time_bounds"), ("the duration", lasting, "duration_bounds")]
    for name, values, kind in stated:
        size = max(map(abs, times)) if name == "the duration" else 0.0
        for i, (value, low, high) in enumerate(zip(values or (), *(getattr(problem, kind) or ((), ())), strict=False)):
            if value is not None and not keeps_to(value, low, high, size):
                place = f"[{i}]" if name != "the duration" else f" of the phase from {times[i]} to {times[i + 1]}"
                place = "" if len(lasting) == 1 and name == "the duration" else place
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
    accepted = FEASIBLE * or_one(np.max(np.where(np.isfinite(sizes), sizes, 0.0), axis=0))
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


RULES = (
    _beside_a_constraint,
    _velocities_of_rates,
    _unused,
    _impulses,
    impossible_constraint,
    _conditions_on_free_ends,
)
RULES_OF_VALUES = (
    _given_outside,
    constraint_at_ends,
    _functions_of_given_ends,
)
