"""Where an optimization evaluates its functions (points, nodes, ends), of what unknowns, and how values are summed.

A kind of place is, in one phase, the quadrature points, either end, both ends together, the nodes of a constraint, or
the changes of bounded controls; or it is the ends of all phases.  The inputs z = A ξ of the pointwise functions are
linear in the vector ξ of unknowns and data (`control_numbering`), and the equations are linear in their rows e,

    G = Θ [e_k] + Λ y        with the transpose Θ of the test matrix, and Λ linear in the unknowns y of ξ.

At a quadrature point z holds (x, x', u, T, π, t_0, s, σ, S): slopes x' = h v, parameters π, the start t_0 and the
duration T of the phase, and s and σ, which are fractions of it.  The time is t = t_0 + T s and the step h = T σ.  With
L̂(t, h, x, x') = h L(t, x, x'/h), the cost and the rows are

    cost  h ℓ(t, x, v, u),        e = [ (∂L̂/∂x + h F) / S,  ∂L̂/∂x' / S,  z' - h ρ,  g ],

with z the components that follow the rates ρ, and g the path constraints.  Θ sums the virtual work on every interval:
its row of node a has the quadrature weights times l_a and l_a'.  Together with Λ, these are the discrete Legendre
transforms (a = 0 and m) and the control equations (a between),

    p_i + Σ ( l_0 f + l_0' g ) = 0,      Σ ( l_a f + l_a' g ) = 0,      p_{i+1} - Σ ( l_m f + l_m' g ) = 0,

with f = ∂L̂/∂x + h F and g = ∂L̂/∂x' at the points and Σ the quadrature sum.  Together they are the discrete
Lagrange-d'Alembert equations.  Momenta are measured in units S, the sizes of the terms of these equations, and the
equations are divided by S.  A component that follows a rate has no momentum: there Θ tests its defect z' - h ρ with the
polynomials of degree m - 1.  Λ also makes every state equal to the value at the end of the interval before, x_{i+1} -
X_m = 0.

At either end e = ∂L/∂v(t, x, v) / S.  At both ends together, the cost is that of the ends, and e are the end
conditions.  A holonomic constraint c is imposed at the nodes by impulses I: there e = [ c,  GᵀI / S ] with G = ∂c/∂x,
and at either end G v + ∂c/∂t is appended to e, so that velocities are tangent.  The impulse is added to the equation of
every node after the path's first; at the first, to the equation of the velocity at the start.  At the ends of all
phases together, e and the cost are what joins these.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.nodes import lagrange_values
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.control.control_numbering import Chain, Numbering
from casadi_galerkin.functional.pointwise import PointMap, pulled_back
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.legendre_transform import momentum_at
from casadi_galerkin.problems.phases import Joins

NO_TERM = ca.SX(1, 1)  # structurally zero

# Numbers of entries, (rows,) alike at all places, (K, rows), or (K, rows, summands), and what they are multiplied by
Part: TypeAlias = tuple[np.ndarray, Any]


@dataclass(frozen=True)
class PointwiseTerms:
    """What is evaluated at one place of a kind, as SX expressions in the inputs z there, a weight and multipliers.

    Parameters
    ----------
    z : inputs at one place
    active : numbers of the inputs that depend on unknowns; derivatives are by these
    rows, cost, action : expressions in z
    """

    z: ca.SX
    active: np.ndarray
    rows: ca.SX
    cost: ca.SX
    action: ca.SX
    _functions: dict[str, ca.Function] = field(default_factory=dict)

    @cached_property
    def _by(self) -> ca.SX:
        return self.z[self.active.tolist()]

    @cached_property
    def _symbols(self) -> list[ca.SX]:
        return [self.z, ca.SX.sym("weight"), ca.SX.sym("multipliers", self.rows.numel())]

    @cached_property
    def lagrangian(self) -> ca.SX:
        """Weight · cost + multipliers · rows."""
        _, weight, multipliers = self._symbols
        return weight * self.cost + ca.dot(multipliers, self.rows)

    @cached_property
    def cost_gradient(self) -> ca.SX:
        """Gradient of the cost."""
        return ca.gradient(self.cost, self._by)

    @cached_property
    def jacobian(self) -> ca.SX:
        """Derivatives of the rows."""
        return ca.jacobian(self.rows, self._by)

    @cached_property
    def gradient(self) -> ca.SX:
        """Gradient of the Lagrangian by all inputs, also those that are data."""
        return ca.gradient(self.lagrangian, self.z)

    @cached_property
    def hessian(self) -> ca.SX:
        """Second derivatives of the Lagrangian."""
        return ca.hessian(self.lagrangian, self._by)[0]

    def function(self, name: str, arguments: int) -> ca.Function:
        """One of these expressions, a column, or the nonzeros of a matrix, as a Function of the first arguments."""
        if name not in self._functions:
            value = getattr(self, name)
            column = ca.vertcat(*value.nonzeros()) if name in ("jacobian", "hessian") else ca.densify(value)
            self._functions[name] = ca.Function(name, self._symbols[:arguments], [column])
        return self._functions[name]


class Kind(NamedTuple):
    """What is embedded, evaluated and integrated at the places of one kind, see `Places`."""

    inputs: Mapping[str, Part]
    outputs: Sequence[Part]
    z: ca.SX
    rows: ca.SX
    cost: ca.SX = NO_TERM
    action: ca.SX = NO_TERM
    weights: np.ndarray = np.ones(1)


@dataclass(frozen=True)
class Places:
    """The places of one kind.

    Attributes
    ----------
    count : number of places, K
    rows : of A, place by place
    names : which of the inputs at one place have a name
    terms : PointwiseTerms
    weights : (1, K), of the costs; the rule's at quadrature points
    integrated : whether they are quadrature points
    """

    count: int
    rows: slice
    names: dict[str, slice]
    terms: PointwiseTerms
    weights: ca.DM
    integrated: bool
    mapping: PointMap

    def evaluate(self, name: str, *given: ca.MX) -> ca.MX:
        """One of the terms' expressions, from matrices of its inputs with a column for every place."""
        value = getattr(self.terms, name)
        if not value.nnz():  # such as second derivatives of linear rows
            return ca.MX(0 if name in ("jacobian", "hessian") else value.numel(), self.count)
        return self.mapping(self.terms.function(name, len(given)), self.count, ())(*given)

    def named(self, inputs: np.ndarray) -> dict[str, np.ndarray]:
        """The inputs by name, (rows, K), of those of all places."""
        here = inputs[self.rows].reshape(self.count, -1).T
        return {name: here[rows] for name, rows in self.names.items()}


def sparse(triplets: Iterable[tuple[Any, ...]], shape: tuple[int, int]) -> ca.DM:
    """Constant sparse matrix from (rows, columns, entries), to be broadcast, without repetitions; zeros are dropped."""
    flat = list[np.ndarray]()
    for triplet in triplets:
        block = np.empty((3, *np.broadcast(*triplet).shape))
        block[0], block[1], block[2] = triplet
        flat.append(block.reshape(3, -1))
    entries = np.concatenate(flat, axis=1)
    rows, columns = entries[:2, entries[2] != 0].astype(int).tolist()
    return ca.DM.triplet(rows, columns, ca.DM(entries[2, entries[2] != 0]), *shape)


def linear(numbering: Numbering) -> ca.DM:
    """Λ: equations x unknowns."""

    def of_phase(f: Mapping[str, np.ndarray], rows: Mapping[str, np.ndarray], free: Sequence[str]) -> Iterator[Any]:
        yield rows["x"], f["x"][1:], 1.0
        yield rows["x"], f["nodes"][:, -1], -1.0
        yield rows["momentum"], f["momentum"][1:], 1.0
        yield rows["motion"][:, 0], f["momentum"][:-1], 1.0
        yield rows["start"], f["momentum"][0], 1.0
        yield rows["end"], f["momentum"][-1], 1.0
        for name in free:
            yield rows[name], f[name][1:], 1.0
            yield rows[name], f[name][:-1], -1.0

    triplets = [triplet for chain in numbering.chains for triplet in of_phase(chain.fields, chain.rows, chain.free)]
    return sparse(triplets, (numbering.equations, numbering.unknowns))


def all_places(
    phases: Sequence[ControlProblem], joins: Joins, numbering: Numbering, mapping: PointMap
) -> tuple[list[Places], ca.DM, ca.DM]:
    """All kinds of places that exist, phase by phase, quadrature points first, A, and Θᵀ; equal terms are made once."""
    kinds, places, shared = [*_kinds(phases, joins, numbering)], list[Places](), dict[str, PointwiseTerms]()
    counts = [max(len(numbers) for numbers, _ in kind.inputs.values() if numbers.ndim > 1) for kind in kinds]
    given = [(count, [*kind.inputs.values()]) for count, kind in zip(counts, kinds, strict=True)]
    matrix = _matrix(given, numbering.size)
    test = _matrix([(count, kind.outputs) for count, kind in zip(counts, kinds, strict=True)], numbering.equations)
    depends, first = np.zeros(matrix.shape[0], dtype=bool), 0
    depends[matrix[:, : numbering.unknowns].sparsity().row()] = True
    for kind, count in zip(kinds, counts, strict=True):
        rows = slice(first, first := first + count * kind.z.numel())
        active = np.flatnonzero(depends[rows].reshape(count, -1).any(axis=0))
        key = str(len(places))
        if len(phases) > 1:
            values = ca.Function("terms", [kind.z], [kind.rows, kind.cost, kind.action])
            key = f"{values.serialize()} {active.tolist()}"
        terms = shared.setdefault(key, PointwiseTerms(kind.z, active, kind.rows, kind.cost, kind.action))
        weights, integrated = ca.DM(np.resize(kind.weights, (1, count))), kind.action is not NO_TERM
        places.append(Places(count, rows, _slices(kind.inputs), terms, weights, integrated, mapping))
    return places, matrix, test


def _kinds(phases: Sequence[ControlProblem], joins: Joins, numbering: Numbering) -> Iterator[Kind]:
    for problem, chain in zip(phases, numbering.chains, strict=True):
        yield _at_points(problem, chain)
        yield _at_either_end(problem, chain)
        if chain.conditions or chain.cost_of_ends:
            yield _at_both_ends(problem, chain)
        if problem.constraint is not None:
            yield _at_nodes(problem, chain)
        if chain.changes and chain.intervals * len(chain.control_times) > 1:
            yield _at_changes(chain)
    if len(phases) > 1:
        yield _at_joins(phases, joins, numbering)


def _slices(inputs: Mapping[str, Part]) -> dict[str, slice]:
    """Which of the inputs at one place have a name."""
    ends = np.cumsum([0, *map(_width, inputs.values())]).tolist()
    return {name: slice(*ends[i : i + 2]) for i, name in enumerate(inputs)}


def _width(part: Part) -> int:
    """Number of rows at one place."""
    return part[0].shape[min(1, part[0].ndim - 1)]


def _matrix(kinds: Iterable[tuple[int, Sequence[Part]]], size: int) -> ca.DM:
    """The rows of all parts at all places, kind by kind and place by place, times a vector of this size."""
    triplets, first = list[tuple[Any, ...]](), 0
    for count, parts in kinds:
        starts = first + sum(map(_width, parts)) * np.arange(count)[:, None]
        for numbers, factor in parts:
            rows = starts + np.arange(_width((numbers, factor)))
            triplets.append((rows if numbers.ndim < 3 else rows[..., None], numbers, factor))
            starts, first = starts + rows.shape[1], first + rows.size
    return sparse(triplets, (first, size))


def _symbols(inputs: Mapping[str, Part]) -> tuple[ca.SX, dict[str, Any]]:
    """Symbols of the inputs at one place, as one vector and by name."""
    slices = _slices(inputs)
    z = ca.SX.sym("z", max(rows.stop for rows in slices.values()))
    return z, {name: z[rows, 0] for name, rows in slices.items()}


def _given(problem: ControlProblem, at: Mapping[str, ca.SX]) -> list[ca.SX]:
    """The parameters as last argument of callables, where the problem has some."""
    return [] if problem.parameters is None else [at["parameters"]]


def _when(chain: Chain, interval: np.ndarray, fraction: np.ndarray) -> dict[str, Part]:
    """Times, parameters and S at K places at these fractions of intervals."""
    f = chain.fields
    parts, factors = np.stack((f["left"], f["part"]), axis=1), np.stack((np.ones(len(fraction)), fraction), axis=1)
    fields = {name: (f[name][interval], 1.0) for name in ("begin", "duration", "parameters")}
    return {**fields, "fraction": (parts[interval][:, None], factors[:, None]), "sizes": (f["sizes"], 1.0)}


def _at_points(problem: ControlProblem, chain: Chain) -> Kind:
    f, equations, element, m = chain.fields, chain.rows, chain.method.element, chain.method.degree
    r, dm = len(element.points), chain.mechanical
    interval, k = np.divmod(np.arange(chain.intervals * r), r)
    nodes = np.concatenate((f["x"][:-1, None], f["nodes"]), axis=1).swapaxes(1, 2)[interval]  # (N r, d, m + 1)
    inputs: dict[str, Part] = {
        "x": (nodes, element.values[k][:, None]),
        "slope": (nodes, element.slopes[k][:, None]),
        "controls": (f["controls"][interval, k % f["controls"].shape[1]], 1.0),
        **_when(chain, interval, element.points[k]),
        "part": (f["part"][interval][:, None], 1.0),
    }
    z, at = _symbols(inputs)
    x, slope, p = at["x"], at["slope"], _given(problem, at)
    t, h = at["begin"] + at["duration"] * at["fraction"], at["duration"] * at["part"]
    state = (t, x, slope / h, at["controls"], *p)
    action = pulled_back(problem.lagrangian, t, h, x, slope, *p)
    work, momentum = (ca.gradient(action, by)[:dm, 0] for by in (x, slope))
    rows = [(work + h * problem.force(*state)) / at["sizes"], momentum / at["sizes"]]
    if dm < problem.dimension:
        rows.append(slope[dm:, 0] - h * problem.rates(*state))
    rows.append(problem.limits[0](*state))
    works = np.concatenate((equations["motion"], equations["momentum"][:, None]), axis=1)
    works, weights = works.swapaxes(1, 2)[interval], element.weights[:, None]
    sign, tests = np.append(np.ones(m), -1.0), lagrange_values(np.array(gauss(m).points), element.points)
    outputs = [
        (works, (weights * element.values * sign)[k][:, None]),
        (works, (weights * element.slopes * sign)[k][:, None]),
        (equations["rates"].swapaxes(1, 2)[interval], (weights * tests)[k][:, None]),
        (equations["path"].reshape(len(k), -1), 1.0),
    ]
    return Kind(inputs, outputs, z, ca.vertcat(*rows), h * problem.running_cost(*state), action, element.weights)


def _at_either_end(problem: ControlProblem, chain: Chain) -> Kind:
    f, equations, ends = chain.fields, chain.rows, [0, -1]
    inputs: dict[str, Part] = {
        "x": (f["x"][ends], 1.0),
        "velocity": (np.stack((f["start_velocity"], f["end_velocity"])), 1.0),
        "parameters": (f["parameters"][ends], 1.0),
        "time": (np.stack((f["begin"], f["duration"]), axis=-1)[ends], np.array([[[1.0, 0.0]], [[1.0, 1.0]]])),
        "sizes": (f["sizes"], 1.0),
    }
    z, at = _symbols(inputs)
    x, v, t, p = at["x"], at["velocity"], at["time"], _given(problem, at)
    rows = [momentum_at(problem.lagrangian, t, x, _filled(v, x), *p)[: chain.mechanical, 0] / at["sizes"]]
    if problem.constraint is not None:
        g = problem.constraint(t, x, *p)
        rows.append(ca.mtimes(ca.jacobian(g, x), v) + ca.jacobian(g, t))
    tangent = np.stack((equations["start_tangent"], equations["end_tangent"]))
    outputs = [(np.stack((equations["start"], equations["end"])), -1.0), (tangent, 1.0)]
    return Kind(inputs, outputs, z, ca.vertcat(*rows))


def _ends(chain: Chain, of_phase: str = "") -> dict[str, Part]:
    """Times, positions and velocities at both ends, and the parameters, by names with this ending."""
    f = chain.fields
    inputs: dict[str, Part] = {
        "t0": (f["begin"][0], 1.0),
        "x0": (f["x"][0], 1.0),
        "v0": (f["start_velocity"], 1.0),
        "t1": (np.stack((f["begin"][-1], f["duration"][-1]), axis=-1)[None], 1.0),
        "x1": (f["x"][-1], 1.0),
        "v1": (f["end_velocity"], 1.0),
        "parameters": (f["parameters"][-1], 1.0),
    }
    return {name + of_phase: part for name, part in inputs.items()}


def _at_both_ends(problem: ControlProblem, chain: Chain) -> Kind:
    inputs = _ends(chain)
    z, at = _symbols(inputs)
    t0, x0, v0, t1, x1, v1, _ = at.values()
    first, last, p = (x0, _filled(v0, x0)), (x1, _filled(v1, x1)), _given(problem, at)
    ends = (problem.initial_cost, (t0, *first)), (problem.terminal_cost, (t1, *last))
    cost = sum((cost(*at_end, *p) for cost, at_end in ends if cost is not None), NO_TERM)
    return Kind(inputs, [(chain.rows["ends"], 1.0)], z, chain.end_conditions[0](*first, *last, *p), cost)


def _at_nodes(problem: ControlProblem, chain: Chain) -> Kind:
    f, equations, n, m = chain.fields, chain.rows, chain.intervals, chain.method.degree
    interval, a = np.divmod(np.arange(n * m), m)  # the first node, then those after it on every interval
    fraction = np.append(0.0, chain.method.element.nodes[1:][a])
    inputs: dict[str, Part] = {
        "x": (np.vstack((f["x"][:1], f["nodes"].reshape(n * m, -1))), 1.0),
        "impulse": (np.vstack((f["start_impulse"], f["impulses"].reshape(n * m, -1))), 1.0),
        **_when(chain, np.append(0, interval), fraction),
    }
    z, at = _symbols(inputs)
    assert problem.constraint is not None, "there are such places only with a constraint"
    t = at["begin"] + at["duration"] * at["fraction"]
    g = problem.constraint(t, at["x"], *_given(problem, at))
    rows = ca.vertcat(g, ca.mtimes(ca.jacobian(g, at["x"]).T, at["impulse"]) / at["sizes"])
    later = np.concatenate((equations["motion"][:, 1:], equations["momentum"][:, None]), axis=1)
    pushed = np.vstack((equations["start"], later.reshape(n * m, -1)))
    signs = np.append(-1.0, np.where(a < m - 1, 1.0, -1.0))
    imposed = np.vstack((equations["start_constraint"], equations["constraint"].reshape(n * m, -1)))
    return Kind(inputs, [(imposed, 1.0), (pushed, signs[:, None])], z, rows)


def _at_changes(chain: Chain) -> Kind:
    f, equations, times, n = chain.fields, chain.rows, chain.control_times, chain.intervals
    interval, k = np.divmod(np.arange(n * len(times) - 1), len(times))
    joint = k == len(times) - 1  # to the first control of the next interval
    factors = np.where(joint, 1 - times[-1], np.append(np.diff(times), 0.0)[k]), times[0] * joint
    u = f["controls"].reshape(n * len(times), -1)
    inputs: dict[str, Part] = {
        "before": (u[:-1], 1.0),
        "after": (u[1:], 1.0),
        "duration": (f["duration"][0], 1.0),
        "part": (
            np.stack((f["part"][interval], f["part"][interval + joint]), axis=1)[:, None],
            np.stack(factors, 1)[:, None],
        ),
    }
    z, at = _symbols(inputs)
    changed = np.empty((len(k), chain.changes), dtype=np.int64)
    changed[~joint] = equations["changes"].reshape(-1, chain.changes)
    changed[joint] = equations["joint_changes"]
    return Kind(inputs, [(changed, 1.0)], z, (at["after"] - at["before"]) / (at["duration"] * at["part"]))


def _at_joins(phases: Sequence[ControlProblem], joins: Joins, numbering: Numbering) -> Kind:
    inputs = {name: part for k, chain in enumerate(numbering.chains) for name, part in _ends(chain, f" {k}").items()}
    z, at = _symbols(inputs)
    for k, problem in enumerate(phases):
        for name in ("v0", "v1"):
            at[f"{name} {k}"] = _filled(at[f"{name} {k}"], ca.SX(problem.dimension, 1))
    cost = NO_TERM if joins.cost is None else joins.cost(*at.values())
    outputs = [(index, 1.0) for index in numbering.joins.values()]
    return Kind(inputs, outputs, z, joins.conditions[0](*at.values()), cost)


def _filled(v: ca.SX, x: ca.SX) -> ca.SX:
    """Velocities of all components, with zeros for those that follow a rate, on whose velocities nothing depends."""
    return v if v.numel() == x.numel() else ca.vertcat(v, ca.SX(x.numel() - v.numel(), 1))
