"""The unknowns and equations of an optimization as numbered vectors, with their bounds: phase by phase, by stages.

All unknowns and all data of an optimization are one vector ξ = (unknowns, data), phase by phase.  The unknowns of a
phase form a chain of N + 1 stages.  At every joint there is a state: x, p and the free constants, which are the time of
the start, the duration and parameters.  The other unknowns of a stage belong to the interval after the joint: the
values of the path at the other nodes, the controls, and the impulses of a constraint.  The velocities at the two ends
are further unknowns of the first and of the last stage.  The equations of a stage are first those that determine the
next state, and then all others.  Behind the equations of all phases are those that join them.  What a
problem gives and bounds are bounds of these numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import chain as chained

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.nodes import lagrange_values
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.problems.callables import rows_that_depend
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.phases import Joins
from casadi_galerkin.problems.problem import ENDS


@dataclass(frozen=True)
class Field:
    """Unknowns, data or equations that a stage holds under one name.

    Attributes
    ----------
    name : by which `Chain.fields` or `Chain.rows` have their numbers
    label : what messages call a component, with its number in place of {}
    kind : the same for fields whose components are values, or equations with terms, of the same quantities
    components : numbers of the components
    at : where they are, in intervals since the joint of the stage; (count,) where each component is at several places
    """

    name: str
    label: str
    kind: str
    components: range
    at: float | np.ndarray = 0.0

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array of the numbers: (components,), or (count, components)."""
        return (*np.shape(self.at), len(self.components))

    @cached_property
    def size(self) -> int:
        """Number of entries."""
        return math.prod(self.shape)


Stages = Sequence[Sequence[Field]]  # the fields of every stage, in their order


def length(fields: Iterable[Field]) -> int:
    """Number of entries of some fields."""
    return sum(field.size for field in fields)


def numbered(stages: Stages, first: int = 0) -> dict[str, np.ndarray]:
    """Number the entries of all fields, stage by stage; for every name (number of stages that have it, *shape)."""
    parts: dict[str, list[np.ndarray]] = {}
    for field in chained(*stages):
        parts.setdefault(field.name, []).append(first + np.arange(field.size).reshape(field.shape))
        first += field.size
    return {name: np.stack(arrays) for name, arrays in parts.items()}


def kinds_of(stages: Stages, numbers: Mapping[str, np.ndarray]) -> np.ndarray:
    """Number the kinds of all entries: one for each component of the fields of one `kind`, in their order."""
    kinds, firsts, count = np.empty(sum(map(length, stages)), dtype=np.int64), dict[str, int](), 0
    for field in {field.name: field for field in chained(*stages)}.values():
        if field.kind not in firsts:
            firsts[field.kind], count = count, count + len(field.components)
        kinds[numbers[field.name]] = firsts[field.kind] + np.arange(len(field.components))
    return kinds


def located(stages: Stages, number: int) -> tuple[str, float]:
    """What messages call an entry, and its place in intervals since the start."""
    for i, fields in enumerate(stages):
        for field in fields:
            if number < field.size:
                *place, component = np.unravel_index(number, field.shape)
                return field.label.format(field.components[component]), i + float(np.asarray(field.at)[tuple(place)])
            number -= field.size
    raise IndexError(number)


class Chain:
    """Numbering of the unknowns, data and equations of one phase on N intervals, in numbers of the whole program.

    Parameters
    ----------
    problem : ControlProblem, without jumps and waypoints that are functions
    method : Galerkin
    mesh : (N + 1,), with the breakpoints of the problem among its joints
    begins_free : whether the time of the start is an unknown, as after a phase of free duration

    Attributes
    ----------
    intervals : N
    dimension, mechanical : numbers of all components, and of the components with an equation of motion
    controls, parameters, constraints, path_constraints, conditions : numbers of controls, parameters, holonomic
        constraints, path constraints and end conditions, with path constraints that limit the end
    cost_of_ends : whether there is a cost of the start or of the end
    changes : number of controls whose changes are bounded, all or none
    free : which of "begin", "duration" and "parameters" are unknowns, in this order
    breaks : numbers of the joints at the breakpoints
    velocities_of_rates : whether the running cost or a path constraint depends on the velocity of a component that
        follows a rate
    unknowns, equations, given : numbers of its unknowns, equations and data
    unknown_stages, equation_stages : for every stage the fields of its unknowns, and those of its equations
    fields : name -> entries of ξ: "x" (N + 1, d), "momentum" (N + 1, mechanical), "nodes" (N, m, d), the values at the
        nodes after the first, "controls" (N, points, n), "impulses" (N, m, constraints) at these nodes and
        "start_impulse" (constraints,), "start_velocity", "end_velocity" (mechanical,), "begin" and "duration"
        (N + 1, 1), the time of the start, and the duration, and "parameters" (N + 1, count), equal at all joints.  And
        data: "left" and "part" (N,), the time from the start to the interval, and the length of the interval, both
        over the duration; "sizes" (mechanical,), the units of the momenta
    rows : name -> equations: "x", "momentum", and the free constants (N, ...) determine the next states; "motion"
        (N, m, mechanical) are the equations of motion of the nodes before the last; "rates" (N, m, others); "path"
        (N, r, count); "constraint" (N, m, constraints) and "start_constraint" are a constraint, "start_tangent" and
        "end_tangent" its time derivative; "start", "end" (mechanical,) are ∂L/∂v = p at the ends; "ends" are the end
        conditions; "changes" (N, points - 1, changes) and "joint_changes" (N - 1, changes) are rates of the controls
    departures : (N + 1, mechanical), equations of the momenta at the starts of the intervals, and of the last momentum
    kinds : (equations,), equal for equations whose terms are the same quantity
    unknown_kinds : (unknowns,), equal for unknowns that are values of the same quantity
    motions, rated : those kinds that are equations of motion, and those that are rates
    end_conditions : (g, lo, hi), those of the problem and what path constraints ask of the end
    stages : for every stage the numbers of its states, of its other unknowns, and of its equations that do not
        determine the next state
    control_times : fractions of an interval at which its controls are given; held controls have one value, at 1/2
    """

    def __init__(self, problem: ControlProblem, method: Galerkin, mesh: np.ndarray, begins_free: bool = False) -> None:
        self.method, self.intervals, self.dimension = method, len(mesh) - 1, problem.dimension
        self.mechanical, self.controls, self.constraints = problem.mechanical, problem.controls, problem.constraints
        self.parameters = len(problem.parameters or ())
        self.cost_of_ends = problem.terminal_cost is not None or problem.initial_cost is not None
        self.path_constraints = len(problem.limits[1])
        self.end_conditions = problem.conditions_at_ends
        self.conditions = len(self.end_conditions[1])
        limited = self.conditions > len(problem.end_conditions[1])
        of_ends = "condition {} on the end, stated or by a path constraint" if limited else "end condition {}"
        free = begins_free or problem.initial_time_bounds, problem.duration_bounds, problem.parameter_bounds
        named = zip(("begin", "duration", "parameters"), free, strict=True)
        self.free = tuple(name for name, bounds in named if bounds)
        self.breaks = np.searchsorted(mesh, problem.breakpoints)
        self.control_times = np.array([0.5]) if problem.hold else method.element.points
        self.changes = self.controls * bool(np.isfinite(problem.control_rate_bounds).any())
        if self.changes and self.control_times[-1] - self.control_times[0] == 1:
            raise ValueError(
                f"control_rate_bounds need a rule without points at both ends of intervals, such as gauss, got {method}"
            )
        along = problem.running_cost, problem.limits[0]
        of_rates = np.arange(self.dimension) >= self.mechanical
        self.velocities_of_rates = any(rows_that_depend(f, "v", of_rates).any() for f in along)
        self._number(of_ends)

    def _number(self, of_ends: str) -> None:
        n, moving, nodes = self.intervals, range(self.mechanical), self.method.element.nodes[1:]
        x, velocity = ("x[{}]", "x", range(self.dimension)), ("velocity", moving)
        impulse = "impulse", range(self.constraints)
        constants = [
            Field("begin", "the time of the start", "begin", range(1)),
            Field("duration", "the duration", "duration", range(1)),
            Field("parameters", "p[{}]", "parameters", range(self.parameters)),
        ]
        free = [constant for constant in constants if constant.name in self.free]
        state = [Field("x", *x), Field("momentum", "the momentum[{}]", "momentum", moving), *free]
        chosen = [
            Field("nodes", *x, nodes),
            Field("controls", "u[{}]", "controls", range(self.controls), self.control_times),
            Field("impulses", "impulses[{}]", *impulse, nodes),
        ]
        at_start = [
            Field("start_velocity", "start_velocity[{}]", *velocity),
            Field("start_impulse", "start_impulse[{}]", *impulse),
        ]
        last = Field("end_velocity", "end_velocity[{}]", *velocity)
        lengths = {"left": n, "part": n, "sizes": self.mechanical}
        given = [Field(name, name, name, range(count)) for name, count in lengths.items()]
        data = [constant for constant in constants if constant not in free] + given
        others = [[*chosen, *at_start], *[chosen] * (n - 1), [last]]
        widths = [(length(state), length(other)) for other in others]
        self.unknown_stages: Stages = [[*state, *other] for other in others]
        self.unknowns, self.given = sum(map(sum, widths)), length(data)
        fields = numbered(self.unknown_stages) | numbered([data], self.unknowns)
        once = {field.name: fields[field.name][0] for field in (*at_start, last, *given)}
        alike = {c.name: np.broadcast_to(fields[c.name], (n + 1, *c.shape)) for c in constants}
        self.fields = {**fields, **once, **alike}
        self.unknown_kinds = kinds_of(self.unknown_stages, self.fields)
        d, element, held = self.dimension, self.method.element, range(self.constraints)
        motion = "the equation of motion of x[{}]", "motion", moving
        constraint, tangent = ("constraint {}", "constraint", held), ("the rate of constraint {}", "tangent", held)
        changed = "the rate of u[{}]", "changes", range(self.changes)
        over_joints = Field("joint_changes", *changed)
        tied = [Field("x", "the continuity of x[{}]", "x", range(d), 1.0), Field("momentum", *motion, 1.0)]
        tied += [replace(constant, at=1.0) for constant in free]
        test_points = np.array(gauss(self.method.degree).points)
        inner = [
            Field("motion", *motion, element.nodes[:-1]),
            Field("rates", "the rate of x[{}]", "rates", range(self.mechanical, d), test_points),
            Field("path", "path constraint {}", "path", range(self.path_constraints), element.points),
            Field("constraint", *constraint, element.nodes[1:]),
            Field("changes", *changed, self.control_times[1:]),
        ]
        at_start = [Field("start", *motion), Field("start_constraint", *constraint), Field("start_tangent", *tangent)]
        ends = Field("ends", of_ends, "ends", range(self.conditions))
        at_end = [Field("end", *motion), Field("end_tangent", *tangent), ends]
        further = [[*inner, *at_start], *[[*inner, over_joints]] * (n - 1), at_end]
        self.equation_stages: Stages = [[*(tied if i < n else []), *other] for i, other in enumerate(further)]
        rows = numbered(self.equation_stages)
        rows.setdefault("joint_changes", np.zeros((0, self.changes), dtype=np.int64))
        self.rows = rows | {field.name: rows[field.name][0] for field in (*at_start, *at_end)}
        self.departures = np.vstack((rows["motion"][:, 0], rows["momentum"][-1:]))
        self.equations = sum(map(length, self.equation_stages))
        self.stages = [(*width, length(other)) for width, other in zip(widths, further, strict=True)]
        self.kinds = kinds_of(self.equation_stages, self.rows)
        self.motions, self.rated = np.arange(d, d + self.mechanical), np.unique(self.kinds[self.rows["rates"]])

    def moved(self, unknowns: int, data: int, equations: int, kinds: int, unknown_kinds: int) -> Chain:
        """The chain with all its numbers increased, of unknowns, data, equations and kinds."""
        other, first = copy(self), np.array([unknowns, data])
        other.fields = {name: index + first[(index >= self.unknowns) + 0] for name, index in self.fields.items()}
        other.rows = {name: index + equations for name, index in self.rows.items()}
        other.departures = self.departures + equations
        other.kinds, other.unknown_kinds = self.kinds + kinds, self.unknown_kinds + unknown_kinds
        other.motions, other.rated = self.motions + kinds, self.rated + kinds
        return other

    def path(self, values: dict[str, np.ndarray], mesh: np.ndarray) -> PiecewisePolynomial:
        """The path through the values of the fields."""
        local = np.concatenate((values["x"][:-1, None], values["nodes"][:, :-1]), axis=1)
        everything = np.vstack((local.reshape(-1, self.dimension), values["x"][-1])).T
        return PiecewisePolynomial(mesh, self.method.element.nodes, everything)

    @cached_property
    def _tests(self) -> np.ndarray:
        """Values at the nodes of the polynomials by which rates are tested."""
        return lagrange_values(np.array(gauss(self.method.degree).points), self.method.element.nodes)

    def costate(
        self, multipliers: np.ndarray, bounds: np.ndarray, mesh: np.ndarray, start: np.ndarray
    ) -> PiecewisePolynomial:
        """The multipliers of the equations of motion, and of the rates, as a path.

        Those of the rates are polynomials of degree m - 1 between the joints.  At the joints they are the multipliers
        of the continuity of x, at a breakpoint with those of the bounds.  Where the cost or a path constraint depends
        on the velocity z' of such a component, the latter contain their derivatives by z': there the polynomials hold,
        which jump where z' does.

        Parameters
        ----------
        multipliers, bounds : of the equations, and of the bounds of the unknowns
        mesh : (N + 1,)
        start : derivatives of the Lagrangian by what follows rates at the start
        """
        m, others = self.method.degree, slice(self.mechanical, None)
        motion = multipliers[self.rows["motion"]].reshape(self.intervals * m, self.mechanical)
        motion = np.vstack((motion, -multipliers[self.rows["momentum"][-1]]))
        between = -self._tests @ multipliers[self.rows["rates"]]
        rates, ends = between[:, :-1], between[:, -1]
        if not self.velocities_of_rates:
            ends = -multipliers[self.rows["x"]][:, others]
            rates[1:, 0] = ends[:-1]
            rates[self.breaks, 0] -= bounds[self.fields["x"][self.breaks, others]]
            rates[0, 0] = start
        values = np.hstack((motion, np.vstack((rates.reshape(self.intervals * m, ends.shape[1]), ends[-1])))).T
        jumping = np.arange(1, self.intervals) if self.velocities_of_rates else self.breaks
        arrivals = values[:, m::m].copy()
        arrivals[others, jumping - 1] = ends[jumping - 1].T
        return PiecewisePolynomial(mesh, self.method.element.nodes, values, arrivals if len(jumping) else None)


class Numbering:
    """Numbering of ξ, and of the equations, of a whole program.

    Parameters
    ----------
    chains : of the phases, each as if it were alone
    joins : fields of the equations that join the phases
    alike : whether components, controls and parameters are the same quantities in all phases

    Attributes
    ----------
    chains : of the phases, in numbers of the program
    unknowns, equations, size : numbers of unknowns, of equations, and of entries of ξ
    joins : name -> equations that join the phases
    kinds, unknown_kinds, alike : as those of a chain, and as given
    unknown_stages, equation_stages : of all phases, and behind them one of the equations that join them
    """

    def __init__(self, chains: Sequence[Chain], joins: Sequence[Field], alike: bool) -> None:
        lengths = [(c.unknowns, c.given, c.equations, max(c.kinds) + 1, max(c.unknown_kinds) + 1) for c in chains]
        parts = np.array(lengths)
        before = np.cumsum(np.vstack((np.zeros_like(parts[:1]), parts)), axis=0)
        if alike:
            before[:-1, 3:], before[-1, 3:] = 0, parts[:, 3:].max(axis=0)
        self.unknowns, data, first, kinds, _ = before[-1].tolist()
        others = self.unknowns - parts[:, 0]
        self.chains = [
            chain.moved(unknowns, data + other, *numbers)
            for chain, other, (unknowns, data, *numbers) in zip(chains, others.tolist(), before.tolist(), strict=False)
        ]
        self.size, self.equations = self.unknowns + data, first + length(joins)
        self.joins = {name: index[0] for name, index in numbered([joins], first).items()}
        self.alike = alike
        self.unknown_stages: Stages = [stage for chain in chains for stage in chain.unknown_stages]
        self.equation_stages: Stages = [*(stage for chain in chains for stage in chain.equation_stages), joins]
        self.unknown_kinds = np.concatenate([chain.unknown_kinds for chain in self.chains])
        self.kinds = np.concatenate([*(chain.kinds for chain in self.chains), kinds + np.arange(length(joins))])

    def pack(self, values: Iterable[dict[str, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns and data from one array per field of every phase; zero where a field has none."""
        everything = np.zeros(self.size)
        for chain, arrays in zip(self.chains, values, strict=True):
            for name, array in arrays.items():
                everything[chain.fields[name]] = array
        return everything[: self.unknowns], everything[self.unknowns :]

    def unpack(self, unknowns: np.ndarray, data: np.ndarray) -> list[dict[str, np.ndarray]]:
        """One array per field of every phase; free constants without the axis of the joints."""
        everything, phases = np.concatenate((unknowns, data)), list[dict[str, np.ndarray]]()
        for chain in self.chains:
            values = {name: everything[index] for name, index in chain.fields.items()}
            phases.append(values | {name: values[name][-1] for name in ("begin", "duration", "parameters")})
        return phases

    def whole(self) -> dict[str, np.ndarray]:
        """Entries of x at the joints (N + 1, d), of controls (N points, n) and durations, where phases are alike."""
        *others, last = self.chains
        joints = np.vstack([*(chain.fields["x"][:-1] for chain in others), last.fields["x"]])
        controls = np.vstack([np.concatenate(chain.fields["controls"]) for chain in self.chains])
        durations = np.concatenate([chain.fields["duration"][-1] for chain in self.chains])
        return {"x": joints, "controls": controls, "durations": durations}

    def entries(self, *names: str) -> np.ndarray:
        """Numbers of the unknowns in fields of all phases, one after the other; data are left out."""
        found = np.concatenate([chain.fields[name].ravel() for chain in self.chains for name in names])
        return found[found < self.unknowns]

    def units(self, values: Iterable[dict[str, np.ndarray]]) -> np.ndarray:
        """Unit of every equation: the "sizes" of the phases for the equations of motion, else one."""
        units = np.ones(max(self.kinds) + 1)
        for chain, arrays in zip(self.chains, values, strict=True):
            units[chain.motions] = arrays["sizes"]
        return units[self.kinds]


@dataclass(frozen=True)
class ProgramBounds:
    """Lower and upper bounds of the unknowns, (2, unknowns), and of the equations, (2, equations)."""

    unknowns: np.ndarray
    equations: np.ndarray

    def narrowed(self, relaxed: float) -> ProgramBounds:
        """Bounds that become these after a solver relaxes every bound b by this part of max(1, |b|)."""
        if not relaxed:
            return self
        narrow = list[np.ndarray]()
        for sides in (self.unknowns, self.equations):
            low, high = sides
            moves = relaxed * (low < high) * np.fmax(1.0, np.where(np.isfinite(sides), np.abs(sides), 1.0))
            moved = sides + moves * [[1], [-1]]
            crossed = moved[0] > moved[1]  # what has no room between its bounds is fixed in the middle
            moved[:, crossed] = (low[crossed] + high[crossed]) / 2
            narrow.append(moved)
        return ProgramBounds(*narrow)


def bounds_of(
    phases: Sequence[ControlProblem], joins: Joins, numbering: Numbering, implied: bool = False
) -> ProgramBounds:
    """Bounds of the unknowns and of the equations; for given values both bounds are equal.

    Free constants are bounded at the last joint only, because they are equal at all joints.  Equations of a constraint
    that are satisfied anyway, by given ends or by the phase before, are not imposed, unless `implied` is set.
    """
    sides, equations = np.full((2, numbering.size), [[-np.inf], [np.inf]]), np.zeros((2, numbering.equations))
    for k, (problem, chain) in enumerate(zip(phases, numbering.chains, strict=True)):
        f, rows, velocity = chain.fields, chain.rows, np.array(problem.velocity_bounds)[:, : chain.mechanical]
        for index, given in (
            (f["x"], problem.position_bounds),
            (f["nodes"][:, :-1], problem.position_bounds),
            (f["controls"], problem.control_bounds),
            (f["start_velocity"], velocity),
            (f["end_velocity"], velocity),
            (f["begin"][-1], problem.initial_time_bounds or (None if k else (problem.t_span[0],) * 2)),
            (f["duration"][-1], problem.duration_bounds),
            (f["parameters"][-1], problem.parameter_bounds),
        ):
            if given is not None:
                _limit(sides, index, given)
        joints = dict(zip(problem.breakpoints, chain.breaks.tolist(), strict=True))
        places = [(f["x"][joints.get(t, -1)], np.transpose(place)) for t, place in problem.waypoints]
        for index, (low, high) in [(f["x"][0], np.array(problem.start_bounds)), *places]:
            _limit(sides, index, (np.maximum(sides[0, index], low), np.minimum(sides[1, index], high)))
        (_, *first, _), (_, *last, _) = problem.given_at_ends.values()
        at_ends = f["x"][0], f["start_velocity"], f["x"][-1], f["end_velocity"]
        for index, values in zip(at_ends, (*first, *last), strict=True):
            stated = np.flatnonzero(np.isfinite(values[: len(index)]))
            sides[:, index[stated]] = values[stated]
        changes = np.array(problem.control_rate_bounds)[:, : chain.changes]
        for name, limits in (
            ("path", problem.limits[1:]),
            ("ends", chain.end_conditions[1:]),
            ("changes", changes),
            ("joint_changes", changes),
        ):
            _limit(equations, rows[name], limits)
        of_constraint = rows["start_constraint"], rows["constraint"][-1, -1]
        goes_on = k > 0 and phases[k - 1].constraint is not None, False
        for name, held, on, satisfied in zip(ENDS, of_constraint, goes_on, problem.constraint_satisfied, strict=True):
            for index, anyway in zip((held, rows[f"{name}_tangent"]), satisfied, strict=True):
                free = np.where((anyway | on) & (not implied), np.inf, 0.0)
                _limit(equations, index, (-free, free))
    _limit(equations, slice(numbering.equations - len(joins.conditions[1]), None), joins.conditions[1:])
    return ProgramBounds(sides[:, : numbering.unknowns], equations)


def _limit(sides: np.ndarray, index: np.ndarray | slice, bounds: ArrayLike) -> None:
    """Set lower and upper bounds, (2, count), of the entries (..., count) of two long vectors."""
    for side, bound in zip(sides, np.asarray(bounds), strict=True):
        side[index] = bound
