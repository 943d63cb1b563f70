"""Cost and equations at one quadrature point, end or node, and at the ends of all phases, with their derivatives.

At a quadrature point, with L̂(t, h, x, x') = h L(t, x, x'/h), the cost and the rows of the equations are

    cost  h ℓ(t, x, v, u),        e = [ (∂L̂/∂x + h F) / S,  ∂L̂/∂x' / S,  z' - h ρ,  g ],

with z the components that follow the rates ρ, and g the path constraints.  At either end e = ∂L/∂v(t, x, v) / S.  At
both ends together, the cost is the terminal cost, and e are the end conditions.  A holonomic constraint c is imposed at
the nodes by impulses I: there e = [ c,  GᵀI / S ] with G = ∂c/∂x, and at either end G v + ∂c/∂t is appended to e, so
that velocities are tangent.  At the ends of all phases together, e and the cost are what joins these.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.control.control_embedding import Embedding, PlaceLayout
from casadi_galerkin.functional.mapping import PointMap
from casadi_galerkin.functional.pointwise import pulled_back
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.legendre_transform import momentum_at
from casadi_galerkin.problems.phases import Joins

Terms = dict[str, ca.SX]  # the rows, and the cost and the action where there are any
NO_TERM = ca.SX(1, 1)  # structurally zero


@dataclass(frozen=True)
class PointwiseTerms:
    """The pointwise Functions at one place of a kind.

    Each Function takes the inputs z, and some a weight and multipliers.

    Parameters
    ----------
    z : SX symbols of the inputs at one place
    active : numbers of the inputs that depend on unknowns; derivatives are by these
    rows, cost, action : SX expressions in z
    """

    z: ca.SX
    active: np.ndarray
    rows: ca.SX
    cost: ca.SX = NO_TERM
    action: ca.SX = NO_TERM

    @cached_property
    def _by(self) -> ca.SX:
        return self.z[self.active.tolist()]

    def _function(self, inputs: list[ca.SX], *outputs: ca.SX) -> ca.Function:
        """A Function of one place; dense, unless all that it returns is structurally zero."""
        some = any(output.nnz() for output in outputs)
        return ca.Function("terms", inputs, [*map(ca.densify, outputs)] if some else [*outputs])

    @cached_property
    def value(self) -> ca.Function:
        """(z) -> cost."""
        return self._function([self.z], self.cost)

    @cached_property
    def gradient(self) -> ca.Function:
        """(z) -> gradient of the cost."""
        return self._function([self.z], ca.gradient(self.cost, self._by))

    @cached_property
    def cost_terms(self) -> ca.Function:
        """(z, y) -> |y|ᵀ|∇²c||y| / 2 with changes y of the active inputs: the cost of these."""
        change = ca.SX.sym("change", len(self.active))
        terms = ca.bilin(ca.fabs(ca.hessian(self.cost, self._by)[0]), *[ca.fabs(change)] * 2) / 2
        return self._function([self.z, change], terms)

    @cached_property
    def equations(self) -> ca.Function:
        """(z) -> rows."""
        return self._function([self.z], self.rows)

    @cached_property
    def derivatives(self) -> ca.SX:
        """Derivatives of the rows at one place."""
        return ca.jacobian(self.rows, self._by)

    @cached_property
    def jacobian(self) -> ca.Function:
        """(z) -> nonzeros of the derivatives of the rows."""
        return self._function([self.z], ca.vertcat(*self.derivatives.nonzeros()))

    @cached_property
    def _lagrangian(self) -> tuple[list[ca.SX], ca.SX]:
        """Symbols (z, weight, multipliers), and the Lagrangian weight · cost + multipliers · rows."""
        weight, multipliers = ca.SX.sym("weight"), ca.SX.sym("multipliers", self.rows.numel())
        return [self.z, weight, multipliers], weight * self.cost + ca.dot(multipliers, self.rows)

    @cached_property
    def second_derivatives(self) -> ca.SX:
        """Second derivatives of the Lagrangian at one place."""
        return ca.hessian(self._lagrangian[1], self._by)[0]

    @cached_property
    def hessian(self) -> ca.Function:
        """(z, weight, multipliers) -> nonzeros of the second derivatives of the Lagrangian."""
        return self._function(self._lagrangian[0], ca.vertcat(*self.second_derivatives.nonzeros()))

    @cached_property
    def lagrangian_gradient(self) -> ca.Function:
        """(z, weight, multipliers) -> gradient of the Lagrangian."""
        inputs, value = self._lagrangian
        return self._function(inputs, ca.gradient(value, self._by))

    def action_and_derivative(self, row: int) -> ca.Function:
        """(z, weight, multipliers) -> action, and derivative of the Lagrangian by one input."""
        inputs, value = self._lagrangian
        return self._function(inputs, self.action, ca.jacobian(value, self.z[row]))


@dataclass(frozen=True)
class Places:
    """The places of one kind, and how a Function is evaluated at all of them.

    Attributes
    ----------
    terms : PointwiseTerms
    count : number of places
    mapping : PointMap
    integrated : whether their costs are weighted, as at quadrature points
    """

    terms: PointwiseTerms
    count: int
    mapping: PointMap
    integrated: bool

    def evaluate(self, function: ca.Function, *given: ca.MX) -> Any:
        """Outputs of a pointwise Function for matrices of its inputs, with a column for every place."""
        if not function.nnz_out():  # such as second derivatives of linear rows
            zeros = [ca.MX(function.size1_out(i), self.count) for i in range(function.n_out())]
            return zeros if len(zeros) > 1 else zeros[0]
        return self.mapping(function, self.count, ())(*given)


def all_places(phases: Sequence[ControlProblem], joins: Joins, embedding: Embedding, mapping: PointMap) -> list[Places]:
    """All kinds of places that exist, in the order of the embedding; equal terms are made once."""
    made, shared = list[tuple[PlaceLayout, tuple[ca.SX, Terms]]](), dict[str, PointwiseTerms]()
    for problem, of_phase in zip(phases, embedding.phases, strict=True):
        make: dict[PlaceLayout, Callable[..., Terms]] = {
            of_phase.points: _at_points,
            of_phase.either_end: _at_either_end,
            of_phase.both_ends: partial(_at_both_ends, conditions=of_phase.chain.end_conditions[0]),
            of_phase.nodes: _at_nodes,
            of_phase.changes: _at_changes,
        }
        for place in of_phase.inputs:
            z, inputs = _inputs(place)
            inputs["parameters"] = [] if problem.parameters is None else [inputs["parameters"]]
            made.append((place, (z, make[place](problem, *inputs.values()))))
    if embedding.joins is not None:
        made.append((embedding.joins, _of_joins(phases, joins, embedding.joins)))
    places, integrated = list[Places](), [of_phase.points for of_phase in embedding.phases]
    for (place, (z, given)), active in zip(made, embedding.active, strict=True):
        key = str(len(places))
        if len(phases) > 1:
            values = ca.Function("terms", [z], [given["rows"], *(given.get(k, NO_TERM) for k in ("cost", "action"))])
            key = f"{values.serialize()} {active.tolist()}"
        terms = shared.setdefault(key, PointwiseTerms(z, active, **given))
        places.append(Places(terms, place.count, mapping, place in integrated))
    return places


def _inputs(place: PlaceLayout) -> tuple[ca.SX, dict[str, Any]]:
    """Symbols of the inputs at one place, as one vector and by name."""
    z = ca.SX.sym("z", place.width)
    parts = ca.vertsplit(z, np.cumsum([0, *place.rows.values()]).tolist())
    return z, dict(zip(place.rows, parts, strict=True))


def _of_joins(phases: Sequence[ControlProblem], joins: Joins, place: PlaceLayout) -> tuple[ca.SX, Terms]:
    """The symbols, and what is evaluated, at the ends of all phases."""
    z, inputs = _inputs(place)
    ends = list(inputs.values())
    for k, problem in enumerate(phases):
        for i in (7 * k + 2, 7 * k + 5):
            ends[i] = _filled(ends[i], ca.SX(problem.dimension, 1))
    terms = {"rows": joins.conditions[0](*ends)}
    return z, terms if joins.cost is None else {**terms, "cost": joins.cost(*ends)}


def _at_points(problem: ControlProblem, *inputs: Any) -> Terms:
    x, slope, u, duration, p, begin, fraction, part, sizes = inputs
    t, h = begin + duration * fraction, duration * part
    mechanical, others = slice(problem.mechanical), slice(problem.mechanical, None)
    state = (t, x, slope / h, u, *p)
    action = pulled_back(problem.lagrangian, t, h, x, slope, *p)
    work, momentum = (ca.gradient(action, by)[mechanical, 0] for by in (x, slope))
    rows = [(work + h * problem.force(*state)) / sizes, momentum / sizes]
    if problem.mechanical < problem.dimension:
        rows.append(slope[others, 0] - h * problem.rates(*state))
    rows.append(problem.limits[0](*state))
    return {"rows": ca.vertcat(*rows), "cost": h * problem.running_cost(*state), "action": action}


def _at_either_end(problem: ControlProblem, *inputs: Any) -> Terms:
    x, v, p, t, sizes = inputs
    rows = [momentum_at(problem.lagrangian, t, x, _filled(v, x), *p)[: problem.mechanical, 0] / sizes]
    if problem.constraint is not None:
        g = problem.constraint(t, x, *p)
        rows.append(ca.mtimes(ca.jacobian(g, x), v) + ca.jacobian(g, t))
    return {"rows": ca.vertcat(*rows)}


def _at_both_ends(problem: ControlProblem, *inputs: Any, conditions: ca.Function) -> Terms:
    t0, x0, v0, t1, x1, v1, p = inputs
    first, last = (x0, _filled(v0, x0)), (x1, _filled(v1, x1))
    ends = (problem.initial_cost, (t0, *first)), (problem.terminal_cost, (t1, *last))
    costs = [cost(*at, *p) for cost, at in ends if cost is not None]
    return {"rows": conditions(*first, *last, *p), **({"cost": sum(costs)} if costs else {})}


def _at_nodes(problem: ControlProblem, *inputs: Any) -> Terms:
    x, impulse, duration, p, begin, fraction, sizes = inputs
    assert problem.constraint is not None, "there are such places only with a constraint"
    g = problem.constraint(begin + duration * fraction, x, *p)
    return {"rows": ca.vertcat(g, ca.mtimes(ca.jacobian(g, x).T, impulse) / sizes)}


def _at_changes(_: ControlProblem, *inputs: Any) -> Terms:
    before, after, duration, part = inputs[:4]
    return {"rows": (after - before) / (duration * part)}


def _filled(v: ca.SX, x: ca.SX) -> ca.SX:
    """Velocities of all components, with zeros for those that follow a rate, on whose velocities nothing depends."""
    return v if v.numel() == x.numel() else ca.vertcat(v, ca.SX(x.numel() - v.numel(), 1))
