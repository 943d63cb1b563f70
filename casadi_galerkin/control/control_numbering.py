"""The numbering of the unknowns and of the equations of an optimization, stage by stage.

All unknowns and all data of an optimization are one vector ξ = (unknowns, data).  The unknowns form a chain of N + 1
stages.  At every joint there is a state: x, p and the free constants, which are durations and parameters.  The other
unknowns of a stage belong to the interval after the joint: the values of the path at the other nodes, the controls, and
the impulses of a constraint.  The velocities at the two ends are further unknowns of the first and of the last stage.
The equations of a stage are first those that determine the next state, and then all others.

The value of the path at the end of an interval and the state after it are different unknowns, which an equation makes
equal.  Where the path jumps, the law of the jump replaces this equation.  It depends on the velocity just before the
jump, and so does a waypoint that is a function.  This velocity is then a further unknown of the interval, determined by
the momentum with which the path arrives.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.nodes import lagrange_values
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.expressions import VELOCITIES, rows_that_depend


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
    for field in chain(*stages):
        parts.setdefault(field.name, []).append(first + np.arange(field.size).reshape(field.shape))
        first += field.size
    return {name: np.stack(arrays) for name, arrays in parts.items()}


def kinds_of(stages: Stages, numbers: Mapping[str, np.ndarray]) -> np.ndarray:
    """Number the kinds of all entries: one for each component of the fields of one `kind`, in their order."""
    kinds, firsts, count = np.empty(sum(map(length, stages)), dtype=np.int64), dict[str, int](), 0
    for field in {field.name: field for field in chain(*stages)}.values():
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
    """Numbering of ξ, and of the equations, of a control problem on N intervals.

    Parameters
    ----------
    problem : ControlProblem
    method : Galerkin
    mesh : (N + 1,), with the breakpoints of the problem among its joints

    Attributes
    ----------
    intervals : N
    dimension, mechanical : numbers of all components, and of the components with an equation of motion
    controls, parameters, constraints, path_constraints, conditions : numbers of controls, parameters, holonomic
        constraints, path constraints and end conditions, with path constraints that limit the end
    terminal_cost : whether there is a terminal cost
    free : which of "durations" and "parameters" are unknowns, in this order
    breaks : numbers of the joints at the breakpoints
    conditions_there : numbers of conditions at the crossings
    crossed : (K,), numbers of the joints of the crossings
    jumped : (K,), whether the path jumps there
    phases : (N,), number of the phase to which every interval belongs; phases have free durations of their own
    velocities_of_rates : whether the running cost or a path constraint depends on the velocity of a component that
        follows a rate
    unknowns, equations, size : numbers of unknowns, of equations, and of entries of ξ
    unknown_stages, equation_stages : for every stage the fields of its unknowns, and those of its equations
    fields : name -> entries of ξ: "x" (N + 1, d), "momentum" (N + 1, mechanical), "nodes" (N, m, d), the values at the
        nodes after the first, "controls" (N, points, n), "impulses" (N, m, constraints) at these nodes and
        "start_impulse" (constraints,), "start_velocity", "end_velocity" (mechanical,), "velocity" (K, mechanical)
        before the crossings, "durations" (N + 1, phases) and "parameters" (N + 1, count), equal at all joints.  And
        data: "begin" (1,), the time of the start; "left" and "part" (N,), the time from the start of the phase to the
        interval, and the length of the interval, both over the duration of the phase; "sizes" (mechanical,), the units
        of the momenta
    rows : name -> equations: "x", "momentum", "constants" (N, ...) determine the next states; "motion"
        (N, m, mechanical) are the equations of motion of the nodes before the last; "rates" (N, m, others); "path"
        (N, r, count); "constraint" (N, m, constraints) and "start_constraint" are a constraint, "start_tangent" and
        "end_tangent" its time derivative; "start", "end" (mechanical,) are ∂L/∂v = p at the ends; "ends" are the end
        conditions; "arrival" (K, mechanical) are the momenta before the crossings, and "waypoint 0" and so on the
        conditions there
    arrivals : (N, mechanical), equations of the momenta at the ends of the intervals
    departures : (N + 1, mechanical), equations of the momenta at the starts of the intervals, and of the last momentum
    kinds : (equations,), equal for equations whose terms are the same quantity
    unknown_kinds : (unknowns,), equal for unknowns that are values of the same quantity
    motions, rated : those kinds that are equations of motion, a slice, and those that are rates, indices
    end_conditions : (g, lo, hi), those of the problem and what path constraints ask of the end
    stages : for every stage the numbers of its states, of its other unknowns, and of its equations that do not
        determine the next state
    control_times : fractions of an interval at which its controls are given; held controls have one value, at 1/2
    """

    def __init__(self, problem: ControlProblem, method: Galerkin, mesh: np.ndarray) -> None:
        self.method, self.intervals, self.dimension = method, len(mesh) - 1, problem.dimension
        self.mechanical, self.controls, self.constraints = problem.mechanical, problem.controls, problem.constraints
        self.parameters, self.terminal_cost = len(problem.parameters or ()), problem.terminal_cost is not None
        self.path_constraints = len(problem.path_constraint[1])
        self.end_conditions = problem.conditions_at_ends
        self.conditions = len(self.end_conditions[1])
        limited = self.conditions > len(problem.end_conditions[1])
        self._words_of_ends = (
            "condition {} on the end, stated or by a path constraint" if limited else "end condition {}"
        )
        bounded = {"durations": problem.duration_bounds, "parameters": problem.parameter_bounds}
        self.free = tuple(name for name, bounds in bounded.items() if bounds is not None)
        self.breaks, crossings = np.searchsorted(mesh, problem.breakpoints), problem.crossings
        self.crossed = np.searchsorted(mesh, [crossing.time for crossing in crossings]).astype(np.int64)
        self.jumped = np.array([crossing.jump is not None for crossing in crossings], dtype=bool)
        self.conditions_there = [0 if c.condition is None else len(c.condition[1]) for c in crossings]
        parted = self.breaks if "durations" in self.free else ()
        self.phases = np.searchsorted(parted, np.arange(self.intervals), side="right")
        self.control_times = np.array([0.5]) if problem.hold else method.element.points
        along = problem.running_cost, problem.path_constraint[0]
        of_rates = np.arange(self.dimension) >= self.mechanical
        self.velocities_of_rates = any(rows_that_depend(f, VELOCITIES, of_rates).any() for f in along)
        self._number_unknowns()
        self._number_equations()

    def _number_unknowns(self) -> None:
        n, moving, nodes = self.intervals, range(self.mechanical), self.method.element.nodes[1:]
        x, velocity = ("x[{}]", "x", range(self.dimension)), ("velocity", moving)
        impulse, phases = ("impulse", range(self.constraints)), range(int(self.phases[-1]) + 1)
        constants = [
            Field("durations", "the duration" + "[{}]" * (len(phases) > 1), "durations", phases),
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
        at_end = Field("end_velocity", "end_velocity[{}]", *velocity)
        crossing = Field("velocity", "the velocity[{}]", *velocity, 1.0)
        lengths = {"begin": 1, "left": n, "part": n, "sizes": self.mechanical}
        given = [Field(name, name, name, range(count)) for name, count in lengths.items()]
        data = [constant for constant in constants if constant not in free] + given
        others = [[*chosen, *([crossing] if i + 1 in self.crossed else [])] for i in range(n)]
        others = [[*others[0], *at_start], *others[1:], [at_end]]
        self._widths = [(length(state), length(other)) for other in others]
        self.unknown_stages: Stages = [[*state, *other] for other in others]
        self.unknowns = sum(map(sum, self._widths))
        self.size = self.unknowns + length(data)
        fields = numbered(self.unknown_stages) | numbered([data], self.unknowns)
        fields.setdefault("velocity", np.zeros((0, self.mechanical), dtype=np.int64))
        once = {field.name: fields[field.name][0] for field in (*at_start, at_end, *given)}
        alike = {c.name: np.broadcast_to(fields[c.name], (n + 1, *c.shape)) for c in constants}
        self.fields = {**fields, **once, **alike}
        self.free_constants = length(free)
        self.unknown_kinds = kinds_of(self.unknown_stages, self.fields)

    def _number_equations(self) -> None:
        n, d, element, held = self.intervals, self.dimension, self.method.element, range(self.constraints)
        motion = "the equation of motion of x[{}]", "motion", range(self.mechanical)
        constraint, tangent = ("constraint {}", "constraint", held), ("the rate of constraint {}", "tangent", held)
        constants = "the continuity of the duration or parameter[{}]", "constants", range(self.free_constants)
        tied = [
            Field("x", "the continuity of x[{}]", "x", range(d), 1.0),
            Field("momentum", *motion, 1.0),
            Field("constants", *constants, 1.0),
        ]
        test_points = np.array(gauss(self.method.degree).points)
        inner = [
            Field("motion", *motion, element.nodes[:-1]),
            Field("rates", "the rate of x[{}]", "rates", range(self.mechanical, d), test_points),
            Field("path", "path constraint {}", "path", range(self.path_constraints), element.points),
            Field("constraint", *constraint, element.nodes[1:]),
        ]
        at_start = [Field("start", *motion), Field("start_constraint", *constraint), Field("start_tangent", *tangent)]
        ends = Field("ends", self._words_of_ends, "ends", range(self.conditions))
        at_end = [Field("end", *motion), Field("end_tangent", *tangent), ends]
        named = [(f"waypoint {k}", range(count)) for k, count in enumerate(self.conditions_there)]
        waypoints = [Field(name, "condition {}", name, conditions, 1.0) for name, conditions in named]
        arrival, joints = Field("arrival", *motion, 1.0), self.crossed.tolist()
        passed = {joint - 1: [arrival, waypoint] for joint, waypoint in zip(joints, waypoints, strict=True)}
        further = [[*inner, *passed.get(i, [])] for i in range(n)]
        further = [[*further[0], *at_start], *further[1:], at_end]
        self.equation_stages: Stages = [[*(tied if i < n else []), *other] for i, other in enumerate(further)]
        rows = numbered(self.equation_stages)
        rows.setdefault("arrival", np.zeros((0, self.mechanical), dtype=np.int64))
        self.rows = rows | {field.name: rows[field.name][0] for field in (*at_start, *at_end, *waypoints)}
        self.arrivals = rows["momentum"].copy()
        self.arrivals[self.crossed - 1] = rows["arrival"]
        self.departures = np.vstack((rows["motion"][:, 0], rows["momentum"][-1:]))
        self.equations = sum(map(length, self.equation_stages))
        self.stages = [(*width, length(other)) for width, other in zip(self._widths, further, strict=True)]
        self.kinds = kinds_of(self.equation_stages, self.rows)
        self.motions, self.rated = slice(d, d + self.mechanical), np.unique(self.kinds[self.rows["rates"]])

    def pack(self, values: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns and data from one array per field; zero where a field has none."""
        everything = np.zeros(self.size)
        for name, array in values.items():
            everything[self.fields[name]] = array
        return everything[: self.unknowns], everything[self.unknowns :]

    def unpack(self, unknowns: np.ndarray, data: np.ndarray) -> dict[str, np.ndarray]:
        """One array per field from unknowns and data; durations and parameters without the axis of the joints."""
        everything = np.concatenate((unknowns, data))
        values = {name: everything[index] for name, index in self.fields.items()}
        return values | {name: values[name][-1] for name in ("durations", "parameters")}

    def units(self, sizes: np.ndarray) -> np.ndarray:
        """Unit of every equation: `sizes` for the equations of motion, else one."""
        units = np.ones(self.kinds.max() + 1)
        units[self.motions] = sizes
        return units[self.kinds]

    def path(self, values: dict[str, np.ndarray], mesh: np.ndarray) -> PiecewisePolynomial:
        """The path, with separate values before the joints where it jumps."""
        local = np.concatenate((values["x"][:-1, None], values["nodes"][:, :-1]), axis=1)
        everything = np.vstack((local.reshape(-1, self.dimension), values["x"][-1])).T
        jumped = self.crossed[self.jumped]
        return self._jumping(mesh, everything, jumped, values["nodes"][jumped - 1, -1])

    def _jumping(
        self, mesh: np.ndarray, values: np.ndarray, joints: np.ndarray, before: np.ndarray
    ) -> PiecewisePolynomial:
        """Node values (d, N m + 1) as a path, with separate values (K, d) before some joints."""
        m, arrivals = self.method.degree, None
        if len(joints):
            arrivals = values[:, m::m].copy()
            arrivals[:, joints - 1] = before.T
        return PiecewisePolynomial(mesh, self.method.element.nodes, values, arrivals)

    @cached_property
    def _rate_basis(self) -> np.ndarray:
        """Test polynomials of the rates at the nodes; (m + 1, m)."""
        return lagrange_values(np.array(gauss(self.method.degree).points), self.method.element.nodes)

    def costate(
        self, multipliers: np.ndarray, bounds: np.ndarray, arriving: np.ndarray, mesh: np.ndarray
    ) -> PiecewisePolynomial:
        """The multipliers of the equations of motion, and of the rates, as a path.

        Those of the rates are polynomials of degree m - 1 between the joints.  At the joints they are the multipliers
        of the continuity of x, at a breakpoint with those of the bounds.  Where the cost or a path constraint depends
        on the velocity z' of such a component, the latter contain their derivatives by z': there the polynomials hold,
        which jump where z' does.

        Parameters
        ----------
        multipliers, bounds : of the equations, and of the bounds of the unknowns
        arriving : (d, K), derivatives of the Lagrangian by x before the crossings
        mesh : (N + 1,)
        """
        m, others = self.method.degree, slice(self.mechanical, None)
        motion = multipliers[self.rows["motion"]].reshape(self.intervals * m, self.mechanical)
        motion = np.vstack((motion, -multipliers[self.rows["momentum"][-1]]))
        between = -self._rate_basis @ multipliers[self.rows["rates"]]
        rates, ends = between[:, :-1], between[:, -1]
        if not self.velocities_of_rates:
            ends = -multipliers[self.rows["x"]][:, others]
            rates[1:, 0] = ends[:-1]
            rates[self.breaks, 0] -= bounds[self.fields["x"][self.breaks, others]]
        values = np.hstack((motion, np.vstack((rates.reshape(self.intervals * m, ends.shape[1]), ends[-1])))).T
        jumping = np.arange(1, self.intervals) if self.velocities_of_rates else self.breaks
        before = np.hstack((motion[m * jumping], ends[jumping - 1]))
        at_crossings = np.isin(jumping, self.crossed)
        before[at_crossings, : self.mechanical] = -multipliers[self.rows["arrival"]]
        if not self.velocities_of_rates:
            arrived = arriving[others].T + bounds[self.fields["nodes"][self.crossed - 1, -1, others]]
            before[at_crossings, others] = arrived
        return self._jumping(mesh, values, jumping, before)
