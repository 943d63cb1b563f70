"""A sequence of control problems on consecutive spans of time, what links each to the next, and what joins them all.

What joins phases are bounded functions of their ends, as time that goes on, x_+ = x and v_+ = v or a law in its place.
A control problem with jumps, or with breakpoints whose times are free, is parted into such phases.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple, TypeAlias

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.numbers import counted
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.problems import statements
from casadi_galerkin.problems.callables import Rows, Traceable, entries_of, trace, values_given
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.problem import ENDS, Stated, with_values
from casadi_galerkin.problems.statements import (
    FEASIBLE,
    Limit,
    Limited,
    Statement,
    is_limited,
    optional,
    read_limited,
)

OF_START = "start_velocity", "initial_cost", "initial_time_bounds", "start_bounds", "start"
OF_END = "end", "end_velocity", "terminal_cost"
Link: TypeAlias = Traceable | tuple[Traceable, Limit, Limit] | None


class PhaseEnds(NamedTuple):
    """Times, positions and velocities at both ends of a phase, and its parameters."""

    t0: Any
    x0: Any
    v0: Any
    t1: Any
    x1: Any
    v1: Any
    p: Any


class Join(NamedTuple):
    """Equations or inequalities that join phases.

    Attributes
    ----------
    words : what messages call a row, with its number in place of {}
    after : the phase at whose end messages say it is
    rows : SX expressions, later their number
    sides : their bounds; zeros by default
    """

    words: str
    after: int
    rows: Any
    sides: Sequence[tuple[float, ...]] | None = None


@dataclass(frozen=True)
class Joins:
    """All that joins some phases, as Functions of the ends of all of them, one after the other.

    Attributes
    ----------
    each : every `Join`, with the number of its rows
    conditions : (g, lo, hi) of all rows
    cost : Function, or None
    """

    each: tuple[Join, ...]
    conditions: Limited
    cost: ca.Function | None


def _sizes(phases: Sequence[ControlProblem]) -> dict[str, int]:
    """Lengths of the ends of all phases, by name."""
    sizes = dict[str, int]()
    for k, phase in enumerate(phases):
        d = phase.dimension
        of_phase = PhaseEnds(1, d, d, 1, d, d, len(phase.parameters or ()))
        sizes |= {f"{name}_{k}": size for name, size in of_phase._asdict().items()}
    return sizes


def _ends(flat: Sequence[Any]) -> list[PhaseEnds]:
    """The ends of all phases, from one after the other."""
    width = len(PhaseEnds._fields)
    return [PhaseEnds(*flat[k : k + width]) for k in range(0, len(flat), width)]


def times_free(phases: Sequence[ControlProblem]) -> bool:
    """Whether phases begin at times that are unknown."""
    return any((phase.duration_bounds or phase.initial_time_bounds) is not None for phase in phases)


def _consecutive(_: str, phases: Any, __: Phases) -> tuple[ControlProblem, ...]:
    """Control problems of which each begins when the one before ends."""
    if not isinstance(phases, (tuple, list)) or len(phases) < 2:
        raise ValueError(f"phases must be two or more ControlProblems, got {phases!r}")
    made = list[ControlProblem]()
    for k, phase in enumerate(phases):
        if not isinstance(phase, ControlProblem):
            raise TypeError(f"phase {k} must be a ControlProblem, got {type(phase).__name__}")
        end = made[-1].t_span[1] if made else phase.t_span[0]
        if abs(phase.t_span[0] - end) > 4 * EPS * max(map(abs, phase.t_span)):
            raise ValueError(f"phase {k} must begin when phase {k - 1} ends, at t = {end}, got t_span {phase.t_span}")
        made.append(with_values(phase, t_span=(end, phase.t_span[1])))  # without rounding
    return tuple(made)


def _links(_: str, links: Any, problem: Phases) -> tuple[ca.Function | Limited | None, ...]:
    """What links each phase to the next: a law (x, v[, p]) -> x, v, conditions, or None."""
    count, made = len(problem.phases) - 1, list[ca.Function | Limited | None]()
    links = [None] * count if links is None else links
    if not isinstance(links, (tuple, list)) or len(links) != count:
        raise ValueError(f"links must be {count}, one for every phase but the last, got {links!r}")
    for k, (link, (one, other)) in enumerate(zip(links, pairwise(problem.phases), strict=True)):
        name = f"link {k}"
        if callable(link):
            made.append(statements.jump(name, link, one, other))
        elif link is not None:
            made.append(read_limited(name, link, statements.lengths("x v x_after v_after", one, other), trace))
        elif one.dimension == other.dimension:
            made.append(None)
        else:
            raise ValueError(
                f"phase {k} has {counted(one.dimension, 'component')}, and phase {k + 1} has {other.dimension}: give a "
                f"law (x, v) -> (x, v) as {name}"
            )
    return tuple(made)


def _of_ends(name: str, function: Any, sizes: Mapping[str, int], rows: Rows) -> ca.Function:
    """Trace a callable of the ends of every phase as one of all their parts, one after the other."""

    def of_parts(*given: ca.SX) -> Any:  # but for those that are empty
        parts = iter(given)
        return function(*_ends([next(parts) if size else ca.SX(0, 1) for size in sizes.values()]))

    return trace(name, of_parts if callable(function) else function, sizes, rows)


@dataclass(frozen=True, repr=False)
class Phases(Stated):
    """Control problems on consecutive spans of time, solved as one; each has a statement of its own.

    The cost is the sum of theirs.  Where a duration is free, the phases after it begin when it ends.

    Parameters
    ----------
    phases : ControlProblems, each beginning at the time at which the one before ends; with `duration_bounds` these are
        guesses.  What links determine at inner ends is None there
    links : one for every phase but the last, None for all by default.  None: position and velocity go on.  A callable
        (x, v) -> (x, v) from the end of a phase to the start of the next, as where a stage is dropped, with as many
        components as this has.  Or (g, lo, hi) with g(x, v, x_after, v_after) -> scalar or vector, in place of both.
        A callable takes the parameters `p` of the phase before as last argument, where it has some.  Velocities of
        components that follow rates occur in no link, and what a law returns for them is ignored
    conditions : (g, lo, hi) with g(*ends) -> scalar or vector, bounded; every phase has one argument with its t0, x0,
        v0, t1, x1, v1 and p, as for times, or parameters, that several phases share
    cost : callable (*ends) -> scalar, added to the cost

    Raises
    ------
    TypeError, ValueError
        naming what came and what was expected, and the phase or link

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> def fall(begin, start, end):
    ...     return cg.ControlProblem(lambda t, x, v: v[0] ** 2 / 2, (begin, begin + 1), start, end, components=1,
    ...         force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u**2 / 2, controls=1)
    >>> bounce = cg.Phases([fall(0, 1.0, 0.0), fall(1, None, 2.0)], links=[lambda x, v: (x, -v)])
    >>> path = cg.solve(bounce, cg.Galerkin(3), 2)
    >>> round(path.cost, 6), (path([0.0, 1.0, 2.0]).round(6) + 0.0).tolist(), len(path.phases)
    (0.75, [[1.0, 0.0, 2.0]], 2)
    """

    phases: Statement[Sequence[ControlProblem], tuple[ControlProblem, ...]] = Statement(_consecutive)
    links: Statement[Sequence[Link] | None, tuple[ca.Function | Limited | None, ...]] = Statement(_links, None)
    conditions: statements.LimitedOrNone = Statement(
        optional(lambda name, value, problem: read_limited(name, value, _sizes(problem.phases), _of_ends)), None
    )
    cost: statements.FunctionOrNone = Statement(
        optional(lambda name, value, problem: _of_ends(name, value, _sizes(problem.phases), "scalar")), None
    )
    whole: ClassVar[ControlProblem | None] = None  # that is parted into these

    def __post_init__(self) -> None:
        super().__post_init__()
        vars(self)["joins"] = _checked(self)

    @cached_property
    def joins(self) -> Joins:
        """What links each phase to the next, by a law, by conditions or by continuity, and what else is said."""
        symbols, joins, whole = [ca.SX.sym(*size) for size in _sizes(self.phases).items()], list[Join](), self.whole
        ends, on_the_way = _ends(symbols), {} if whole is None else whole.conditions_on_the_way
        for k, ((before, after), link, phase) in enumerate(zip(pairwise(ends), self.links, self.phases, strict=False)):
            p = [] if phase.parameters is None else [before.p]
            if times_free(self.phases):
                joins.append(Join(f"the time at which phase {k + 1} begins", k, after.t0 - before.t1))
            if phase.t_span[1] in on_the_way:
                g, *sides = on_the_way[phase.t_span[1]]
                joins.append(Join("condition {}", k, g(before.x1, before.v1, *p), sides))
            if whole is not None and whole.parameter_bounds is not None:
                joins.append(Join("the continuity of p[{}]", k, after.p - before.p))
            if isinstance(link, tuple):
                rows = link[0](before.x1, before.v1, after.x0, after.v0, *p)
                joins.append(Join(f"condition {{}} of link {k}", k, rows, link[1:]))
            else:
                x, v = (before.x1, before.v1) if link is None else link(before.x1, before.v1, *p)
                gaps = {"x": after.x0 - x, "v": (after.v0 - v)[: self.phases[k + 1].mechanical]}
                joins += [Join(f"the continuity of {name}[{{}}]", k, gap) for name, gap in gaps.items()]
        if whole is not None and self.links:
            (g, *sides), p = whole.conditions_at_ends, [] if whole.parameters is None else [ends[-1].p]
            rows = g(ends[0].x0, ends[0].v0, ends[-1].x1, ends[-1].v1, *p)
            joins.append(Join("end condition {}", len(self.links), rows, sides))
        if self.conditions is not None:
            g, *sides = self.conditions
            joins.append(Join("condition {} on the phases", len(self.links), g(*symbols), sides))
        joins = [join for join in joins if join.rows.numel()]
        rows = ca.densify(ca.vertcat(ca.SX(0, 1), *(join.rows for join in joins)))
        every = [join.sides or ((0.0,) * join.rows.numel(),) * 2 for join in joins]
        low, high = (tuple(side for pair in every for side in pair[k]) for k in (0, 1))
        conditions = ca.Function("joins", symbols, [rows], [*_sizes(self.phases)], ["value"]), low, high
        return Joins(tuple(join._replace(rows=join.rows.numel(), sides=None) for join in joins), conditions, self.cost)

    @property
    def t_span(self) -> tuple[float, float]:
        """Times of the start of the first phase and of the end of the last."""
        return self.phases[0].t_span[0], self.phases[-1].t_span[1]

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times of joints that every mesh has: where phases begin, and their own."""
        return tuple(t for phase in self.phases for t in (*phase.breakpoints, phase.t_span[1]))[:-1]

    @property
    def hold(self) -> bool:
        """Whether the controls of any phase are held."""
        return any(phase.hold for phase in self.phases)

    def varied(self, changes: Mapping[str, Any], t_span: tuple[float, float] | None = None) -> Phases:
        """Copy with other values given at the start of the first phase and at the end of the last."""
        begin, end = self.t_span if t_span is None else t_span
        given = {name: value for name, value in changes.items() if value is not None}
        if not given and (begin, end) == self.t_span:
            return self
        first, *inner, last = self.phases
        starts, ends = ({name: given.pop(name) for name in (end, f"{end}_velocity") if name in given} for end in ENDS)
        if given:
            raise ValueError(f"{' and '.join(given)} are those of single phases: state phases with others")
        first, last = first.varied(starts, (begin, first.t_span[1])), last.varied(ends, (last.t_span[0], end))
        return self.found([first, *inner, last])

    def found(self, phases: Sequence[ControlProblem]) -> Phases:
        """Copy with phases at other times, and with other values, without checks."""
        return with_values(self, phases=tuple(phases))

    def __repr__(self) -> str:
        """State the number of phases, and each of them."""
        return "\n".join([f"{counted(len(self.phases), 'phase')}:", *(f"  {phase!r}" for phase in self.phases)])


def parted(problem: ControlProblem | Phases) -> Phases:
    """The phases of a problem, which end at jumps, at conditions, and, where durations are free, at all breakpoints."""
    if isinstance(problem, Phases):
        return problem
    free, events = problem.duration_bounds is not None, {*dict(problem.jumps), *problem.conditions_on_the_way}
    times = [t for t in problem.breakpoints if free or t in events]
    made, links = object.__new__(Phases), tuple(map(dict(problem.jumps).get, times))
    phases = tuple(_sections(problem, times)) if times else (problem,)
    vars(made).update(phases=phases, links=links, conditions=None, cost=None, whole=problem)
    return made


def _sections(problem: ControlProblem, times: Sequence[float]) -> Iterator[ControlProblem]:
    """The phases of a problem that is parted at some times: with what it states within each, and free ends there."""
    left_out = *OF_START[:-1], *OF_END, "end_conditions"
    inner = {name: vars(ControlProblem)[name].read(name, None, problem) for name in left_out}
    inner |= {"start": (None,) * problem.dimension, "jumps": (), "limits_of_ends": [[], []]}
    places = [place for place in problem.waypoints if not is_limited(place[1])]
    for k, (begin, end) in enumerate(pairwise([problem.t_span[0], *times, problem.t_span[1]])):
        kept = OF_START * (k == 0) + OF_END * (k == len(times))
        of_phase = inner | {name: getattr(problem, name) for name in kept}
        of_phase["breakpoints"] = tuple(t for t in problem.breakpoints if begin < t < end)
        of_phase["waypoints"] = tuple(place for place in places if begin < place[0] <= end)
        of_phase["duration_bounds"] = problem.duration_bounds and tuple((side[k],) for side in problem.duration_bounds)
        yield with_values(problem, t_span=(begin, end), **of_phase)


def _checked(problem: Phases) -> Joins:
    """What joins phases, without the rows that given values fulfil; refuses rows that depend on nothing else."""
    joins, values, moving = problem.joins, list[np.ndarray](), False
    g, low, high = joins.conditions
    for k, phase in enumerate(problem.phases):
        (t0, x0, v0, p), (t1, x1, v1, _) = phase.given_at_ends.values()
        begin, moving = np.where(moving, np.nan, t0), moving or bool(np.isnan(t1))
        values += [begin, x0, v0, np.where(moving, np.nan, t1), x1, v1, p]
        for function in (g, joins.cost):
            uses = [] if function is None else [entries_of(function, 7 * k + i) for i in (2, 5)]
            for i in sorted(set().union(*uses) & set(range(phase.mechanical, phase.dimension))):
                raise ValueError(
                    f"what joins phases depends on v[{i}] of phase {k}, the rate of x[{i}]: write that rate instead, "
                    "or give a law (x, v) -> (x, v) as link"
                )
    found, sides = values_given(g, values), np.array([low, high])
    names = [join.words.format(i) for join in joins.each for i in range(join.rows)]
    for i in np.flatnonzero(~np.isnan(found)).tolist():
        if "condition" in names[i]:
            raise ValueError(f"{names[i]} depends on nothing that is free: it is {found[i]}, whatever the path")
        if abs(found[i]) > FEASIBLE:
            raise ValueError(f"{names[i]} is missed by {found[i]} by what both give: leave out one of these ends")
        sides[:, i] = -np.inf, np.inf
    return replace(joins, conditions=(g, *map(tuple, sides.tolist())))
