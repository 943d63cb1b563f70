"""A sequence of control problems on consecutive spans of time, what links each to the next, and what joins them all.

What joins phases are bounded functions of their ends, as time that goes on, x_+ = x and v_+ = v or a law in its place.
A control problem with jumps, or with breakpoints whose times are free, is parted into such phases.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple, TypeAlias

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.discrete_calculus import mesh_of
from casadi_galerkin.calculus.numbers import counted
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.problems.bounds import FEASIBLE, Limit, Limited, bounds
from casadi_galerkin.problems.breakpoint_events import is_limited, positions_and_velocities
from casadi_galerkin.problems.callables import Traceable, arguments, of_zeros, trace
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.expressions import entries_of, rows_that_depend
from casadi_galerkin.problems.problem import with_values

NOTHING = ca.Function("joins", [], [ca.SX(0, 1)])
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


@dataclass(frozen=True)
class Join:
    """Equations or inequalities that join phases.

    Attributes
    ----------
    words : what messages call a row, with its number in place of {}
    after : the phase at whose end messages say it is
    rows : SX expressions
    sides : their bounds
    of_positions : whether the rows are what x is at the start of the next phase, less what it should be
    """

    words: str
    after: int
    rows: ca.SX
    sides: Sequence[tuple[float, ...]]
    of_positions: bool = False


@dataclass(frozen=True)
class Joins:
    """All that joins some phases, as Functions of the ends of all of them, one after the other.

    Attributes
    ----------
    words, after, of_positions, counts : as those of every `Join`, and the number of its rows
    conditions : (g, lo, hi) of all rows
    cost : Function, or None
    """

    words: tuple[str, ...] = ()
    after: tuple[int, ...] = ()
    of_positions: tuple[bool, ...] = ()
    counts: tuple[int, ...] = ()
    conditions: Limited = (NOTHING, (), ())
    cost: ca.Function | None = None

    def after_link(self, k: int, position: np.ndarray) -> np.ndarray | None:
        """Where phase k begins by its link from a position at rest before it, or None where no law says so."""
        g, which = self.conditions[0], [after == k - 1 for after in self.after]
        chosen = [i for i, ours in enumerate(which) if ours and self.of_positions[i]]
        if not chosen:
            return None
        given = [np.zeros(g.size1_in(i)) for i in range(g.n_in())]
        given[7 * (k - 1) + 4] = position
        first = sum(self.counts[: chosen[0]])
        return -np.array(g(*given)).ravel()[first : first + self.counts[chosen[0]]]


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


def joined(
    phases: Sequence[ControlProblem],
    make: Callable[[list[PhaseEnds]], list[Join]],
    cost: ca.Function | None = None,
) -> Joins:
    """What `make` says that joins phases, with times that follow one another where one of them is free."""
    sizes = _sizes(phases)
    symbols = [ca.SX.sym(name, size) for name, size in sizes.items()]
    ends, joins = _ends(symbols), list[Join]()
    if any(phase.duration_bounds is not None for phase in phases):
        for k, (one, other) in enumerate(pairwise(ends)):
            joins.append(Join(f"the time at which phase {k + 1} begins", k, other.t0 - one.t1, ((0.0,), (0.0,))))
    joins = [join for join in [*joins, *make(ends)] if join.rows.numel()]
    rows = ca.densify(ca.vertcat(*(join.rows for join in joins)))
    low, high = (tuple(side for join in joins for side in join.sides[k]) for k in (0, 1))
    conditions = ca.Function("joins", symbols, [rows], list(sizes), ["value"])
    words, after, of_positions = (tuple(getattr(j, name) for j in joins) for name in ("words", "after", "of_positions"))
    return Joins(words, after, of_positions, tuple(j.rows.numel() for j in joins), (conditions, low, high), cost)


def continuity(
    phases: Sequence[ControlProblem], k: int, after: Sequence[ca.SX], ends: list[PhaseEnds], words: str
) -> list[Join]:
    """Phase k + 1 begins with these positions and velocities; `words` name a row of x or v, the first {}."""
    dm = phases[k + 1].mechanical
    gaps = {"x": ends[k + 1].x0 - after[0], "v": (ends[k + 1].v0 - after[1])[:dm]}
    zeros = {name: (0.0,) * gap.numel() for name, gap in gaps.items()}
    return [Join(words.format(name, "{}"), k, gap, [zeros[name]] * 2, name == "x") for name, gap in gaps.items()]


def sections(problem: ControlProblem) -> list[ControlProblem]:
    """The phases of a problem: it changes at crossings, and, where the duration is free, at all breakpoints."""
    times = [crossing.time for crossing in problem.crossings]
    if problem.duration_bounds is not None:
        times = list(problem.breakpoints)
    if not times:
        return [problem]
    marks, d = [problem.t_span[0], *times, problem.t_span[1]], problem.dimension
    none, phases = (None,) * d, list[ControlProblem]()
    stated = problem.end_conditions[0]
    nothing = of_zeros("end_conditions", {stated.name_in(i): stated.size1_in(i) for i in range(stated.n_in())}, 0)
    places = [waypoint for waypoint in problem.waypoints if not is_limited(waypoint[1])]
    for k, (begin, end) in enumerate(pairwise(marks)):
        first, last = k == 0, k == len(times)
        lasting = problem.duration_bounds and tuple((side[k],) for side in problem.duration_bounds)
        phases.append(
            with_values(
                problem,
                t_span=(begin, end),
                breakpoints=tuple(t for t in problem.breakpoints if begin < t < end),
                waypoints=tuple(place for place in places if begin < place[0] <= end),
                jumps=(),
                duration_bounds=lasting,
                start=problem.start if first else none,
                start_velocity=problem.start_velocity if first else none,
                end=problem.end if last else none,
                end_velocity=problem.end_velocity if last else none,
                terminal_cost=problem.terminal_cost if last else None,
                initial_cost=problem.initial_cost if first else None,
                initial_time_bounds=problem.initial_time_bounds if first else None,
                start_bounds=problem.start_bounds if first else bounds("start_bounds", None, d),
                end_conditions=(nothing, (), ()),
                limits_of_end=[],
            )
        )
    return phases


def joined_sections(problem: ControlProblem, phases: Sequence[ControlProblem]) -> Joins:
    """What joins the phases of one problem: jumps or continuity, waypoints that are functions, and end conditions."""
    if len(phases) == 1:
        return Joins()
    crossings = {crossing.time: crossing for crossing in problem.crossings}

    def make(ends: list[PhaseEnds]) -> list[Join]:
        joins = list[Join]()
        for k, phase in enumerate(phases[:-1]):
            before, crossing = ends[k], crossings.get(phase.t_span[1])
            p = [] if problem.parameters is None else [before.p]
            after = before.x1, before.v1
            if crossing is not None and crossing.jump is not None:
                after = crossing.jump(*after, *p)
            joins += continuity(phases, k, after, ends, "the continuity of {}[{}]")
            if crossing is not None and crossing.condition is not None:
                g, *sides = crossing.condition
                joins.append(Join("condition {}", k, g(before.x1, before.v1, *p), sides))
            if problem.parameter_bounds is not None:
                zeros = (0.0,) * len(problem.parameters or ())
                joins.append(Join("the continuity of p[{}]", k, ends[k + 1].p - before.p, (zeros, zeros)))
        g, *sides = problem.conditions_at_ends
        first, last = ends[0], ends[-1]
        p = [] if problem.parameters is None else [last.p]
        joins.append(Join("end condition {}", len(phases) - 1, g(first.x0, first.v0, last.x1, last.v1, *p), sides))
        return joins

    return joined(phases, make)


@dataclass(frozen=True, init=False, repr=False)
class Phases:
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
    >>> round(path.cost, 6), path([0.0, 1.0, 2.0]).round(6).tolist(), len(path.phases)
    (0.75, [[1.0, 0.0, 2.0]], 2)
    """

    phases: tuple[ControlProblem, ...]
    joins: Joins

    def __init__(
        self,
        phases: Sequence[ControlProblem],
        links: Sequence[Link] | None = None,
        conditions: tuple[Traceable, Limit, Limit] | None = None,
        cost: Traceable | None = None,
    ) -> None:
        given = self.__dict__  # the class is frozen
        given["phases"] = _consecutive(phases)
        count, sizes = len(self.phases) - 1, _sizes(self.phases)
        links = [None] * count if links is None else links
        if not isinstance(links, (tuple, list)) or len(links) != count:
            raise ValueError(f"links must be {count}, one for every phase but the last, got {links!r}")
        of_all, limits = (None, None) if conditions is None else _limited("conditions", conditions)
        g = None if of_all is None else trace("conditions", _of_ends(of_all, sizes), sizes, "any")
        total = None if cost is None else trace("cost", _of_ends(cost, sizes), sizes, "scalar")

        def make(ends: list[PhaseEnds]) -> list[Join]:
            joins = [join for k, link in enumerate(links) for join in _linked(self.phases, k, link, ends)]
            if g is not None:
                rows = g(*(value for phase in ends for value in phase))
                joins.append(
                    Join("condition {} on the phases", count, rows, bounds("conditions", limits, rows.numel()))
                )
            return joins

        given["joins"] = _checked(self.phases, joined(self.phases, make, total))

    @property
    def t_span(self) -> tuple[float, float]:
        """Times of the start of the first phase and of the end of the last."""
        return self.phases[0].t_span[0], self.phases[-1].t_span[1]

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times of joints that every mesh has: where phases begin, and their own."""
        return tuple(t for phase in self.phases for t in (*phase.breakpoints, phase.t_span[1]))[:-1]

    def mesh(self, intervals: Sequence[int]) -> np.ndarray:
        """Joints with a number of intervals for every phase."""
        if len(intervals) != len(self.phases):
            raise ValueError(f"intervals must be {len(self.phases)} numbers, one for every phase, got {intervals!r}")
        meshes = [
            mesh_of(phase.t_span, n, None, phase.breakpoints) for phase, n in zip(self.phases, intervals, strict=True)
        ]
        return np.append(np.concatenate([mesh[:-1] for mesh in meshes]), meshes[-1][-1])

    def varied(self, changes: Mapping[str, Any], t_span: tuple[float, float] | None = None) -> Phases:
        """Copy with other values given at the start of the first phase and at the end of the last."""
        begin, end = self.t_span if t_span is None else t_span
        given = {name: value for name, value in changes.items() if value is not None}
        if not given and (begin, end) == self.t_span:
            return self
        if "parameters" in given:
            raise ValueError("parameters are those of single phases: state phases with others")
        first, *inner, last = self.phases
        ends = {name: value for name, value in given.items() if name.startswith("end")}
        starts = {name: value for name, value in given.items() if name not in ends}
        first, last = first.varied(starts, (begin, first.t_span[1])), last.varied(ends, (last.t_span[0], end))
        return self.found([first, *inner, last])

    def found(self, phases: Sequence[ControlProblem]) -> Phases:
        """Copy with phases at other times, and with other values, without checks."""
        return with_values(self, phases=tuple(phases))  # type: ignore[type-var]

    def __repr__(self) -> str:
        """State the number of phases, and each of them."""
        return "\n".join([f"{counted(len(self.phases), 'phase')}:", *(f"  {phase!r}" for phase in self.phases)])


def _consecutive(phases: Any) -> tuple[ControlProblem, ...]:
    """Control problems of which each begins when the one before ends."""
    if not isinstance(phases, (tuple, list)) or len(phases) < 2:
        raise ValueError(f"phases must be two or more ControlProblems, got {phases!r}")
    for k, phase in enumerate(phases):
        if not isinstance(phase, ControlProblem):
            raise TypeError(f"phase {k} must be a ControlProblem, got {type(phase).__name__}")
        end = phases[k - 1].t_span[1] if k else phase.t_span[0]
        if abs(phase.t_span[0] - end) > 4 * EPS * max(map(abs, phase.t_span)):
            raise ValueError(f"phase {k} must begin when phase {k - 1} ends, at t = {end}, got t_span {phase.t_span}")
    begins = [phases[0].t_span[0], *(phase.t_span[1] for phase in phases[:-1])]  # without rounding
    return tuple(with_values(p, t_span=(begin, p.t_span[1])) for p, begin in zip(phases, begins, strict=True))


def _of_ends(function: Any, sizes: Mapping[str, int]) -> Any:
    """A callable of the ends of every phase as one of all their parts that are not empty, one after the other."""

    def of_parts(*given: ca.SX) -> Any:
        parts = iter(given)
        return function(*_ends([next(parts) if size else ca.SX(0, 1) for size in sizes.values()]))

    return of_parts if callable(function) else function


def _limited(name: str, given: Any) -> tuple[Traceable, tuple[Limit, Limit]]:
    if not isinstance(given, (tuple, list)) or len(given) != 3:
        raise TypeError(f"{name} must be (g, lo, hi), a callable g and the bounds of its values, got {given!r}")
    return given[0], (given[1], given[2])


def _linked(phases: Sequence[ControlProblem], k: int, link: Link, ends: list[PhaseEnds]) -> list[Join]:
    """What links phase k to the next."""
    one, other = phases[k : k + 2]
    before, after, name = ends[k], ends[k + 1], f"link {k}"
    p = [] if one.parameters is None else [before.p]
    words = f"the link of {{}}[{{}}] to phase {k + 1}"
    sizes = arguments(one.parameters, x=one.dimension, v=one.dimension)
    if link is None:
        if one.dimension != other.dimension:
            counts = counted(one.dimension, "component"), other.dimension
            raise ValueError(
                f"phase {k} has {counts[0]}, and phase {k + 1} has {counts[1]}: give a law (x, v) -> (x, v) as {name}"
            )
        return continuity(phases, k, (before.x1, before.v1), ends, words)
    if callable(link):
        law = positions_and_velocities(name, link, sizes, other.dimension, other.mechanical)
        return continuity(phases, k, law(before.x1, before.v1, *p), ends, words)
    (condition, limits), sizes = _limited(name, link), dict.fromkeys(("x", "v"), one.dimension)
    sizes |= dict.fromkeys(("x_after", "v_after"), other.dimension)
    g = trace(name, condition, arguments(one.parameters, **sizes), "any")
    rows = g(before.x1, before.v1, after.x0, after.v0, *p)
    return [Join(f"condition {{}} of {name}", k, rows, bounds(name, limits, rows.numel()))]


def _checked(phases: Sequence[ControlProblem], joins: Joins) -> Joins:
    """What joins phases, without the rows that given values fulfil; refuses rows that depend on nothing else."""
    values, moving, (g, low, high) = list[np.ndarray](), False, joins.conditions
    for k, phase in enumerate(phases):
        d, moved = phase.dimension, moving
        moving |= phase.duration_bounds is not None
        p = phase.parameters or ()
        begin, end = [None if moved else phase.t_span[0]], [None if moving else phase.t_span[1]]
        given = p if phase.parameter_bounds is None else [None] * len(p)
        flat = begin, phase.start, phase.start_velocity, end, phase.end, phase.end_velocity, given
        values += [np.array(value, dtype=float) for value in flat]
        for function in (g, joins.cost):
            uses = [] if function is None else [entries_of(function, 7 * k + i) for i in (2, 5)]
            for i in sorted(set().union(*uses) & set(range(phase.mechanical, d))):
                raise ValueError(
                    f"what joins phases depends on v[{i}] of phase {k}, the rate of x[{i}]: write that rate instead, "
                    "or give a law (x, v) -> (x, v) as link"
                )
    found = np.array(g(*map(np.nan_to_num, values))).ravel()
    free = np.any([rows_that_depend(g, k, np.isnan(a)) for k, a in enumerate(values)], axis=0)
    names = [words.format(i) for words, count in zip(joins.words, joins.counts, strict=True) for i in range(count)]
    sides = np.array([low, high])
    for i in np.flatnonzero(~free).tolist():
        if "condition" in names[i]:
            raise ValueError(f"{names[i]} depends on nothing that is free: it is {found[i]}, whatever the path")
        if abs(found[i]) > FEASIBLE:
            raise ValueError(f"{names[i]} is missed by {found[i]} by what both give: leave out one of these ends")
        sides[:, i] = -np.inf, np.inf
    return replace(joins, conditions=(g, *map(tuple, sides.tolist())))
