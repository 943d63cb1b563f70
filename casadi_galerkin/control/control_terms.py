"""Cost and equations at one quadrature point, end, node or breakpoint, as SX Functions with their derivatives.

At a quadrature point, with L̂(t, h, x, x') = h L(t, x, x'/h), the cost and the rows of the equations are

    cost  h ℓ(t, x, v, u),        e = [ (∂L̂/∂x + h F) / S,  ∂L̂/∂x' / S,  z' - h ρ,  g ],

with z the components that follow the rates ρ, and g the path constraints.  At either end e = ∂L/∂v(t, x, v) / S.  At
both ends together, the cost is the terminal cost, and e are the end conditions.  A holonomic constraint c is imposed at
the nodes by impulses I: there e = [ c,  GᵀI / S ] with G = ∂c/∂x, and at either end G v + ∂c/∂t is appended to e, so
that velocities are tangent.  At a crossing, with (x, v) -> (x_+, v_+) the law of a jump or no change,
e = [ x_+,  p / S,  p_+ / S,  w ], with p = ∂L/∂v before it and p_+ after it, and w the function that is bounded there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.control.control_embedding import ChainEmbedding, PlaceLayout
from casadi_galerkin.functional.mapping import PointMap
from casadi_galerkin.functional.pointwise import pulled_back
from casadi_galerkin.problems.breakpoint_events import Crossing
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.legendre_transform import momentum_at

Terms = dict[str, ca.SX]  # the rows, and the cost and the action where there are any
NO_TERM = ca.SX(1, 1)  # structurally zero


@dataclass(frozen=True)
class PointwiseTerms:
    """The pointwise Functions at the places of one kind.

    Each Function takes the inputs z of all places, (len(z), count), and for some weights and multipliers at all places.

    Parameters
    ----------
    mapping : how a Function is evaluated at all places
    count : number of places
    z : SX symbols of the inputs at one place
    active : numbers of the inputs that depend on unknowns; derivatives are by these
    rows, cost, action : SX expressions in z
    """

    mapping: PointMap
    count: int
    z: ca.SX
    active: np.ndarray
    rows: ca.SX
    cost: ca.SX = NO_TERM
    action: ca.SX = NO_TERM

    @cached_property
    def _by(self) -> ca.SX:
        return self.z[self.active.tolist()]

    def _function(self, inputs: list[ca.SX], *outputs: ca.SX) -> Callable[..., Any]:
        """A Function of one place, evaluated at all places."""
        if not any(output.nnz() for output in outputs):  # such as second derivatives of linear rows
            return lambda *_: ca.MX(outputs[0].numel(), self.count)
        function = ca.Function("terms", inputs, [*map(ca.densify, outputs)])
        return self.mapping(function, self.count, ())

    @cached_property
    def value(self) -> Callable[..., ca.MX]:
        """(z) -> cost, one per place."""
        return self._function([self.z], self.cost)

    @cached_property
    def gradient(self) -> Callable[..., ca.MX]:
        """(z) -> gradient of the cost."""
        return self._function([self.z], ca.gradient(self.cost, self._by))

    @cached_property
    def cost_terms(self) -> Callable[..., ca.MX]:
        """(z, y) -> |y|ᵀ|∇²c||y| / 2 with changes y of the active inputs, one per place: the cost of these."""
        change = ca.SX.sym("change", len(self.active))
        terms = ca.bilin(ca.fabs(ca.hessian(self.cost, self._by)[0]), *[ca.fabs(change)] * 2) / 2
        return self._function([self.z, change], terms)

    @cached_property
    def equations(self) -> Callable[..., ca.MX]:
        """(z) -> rows."""
        return self._function([self.z], self.rows)

    @cached_property
    def derivatives(self) -> ca.SX:
        """Derivatives of the rows at one place."""
        return ca.jacobian(self.rows, self._by)

    @cached_property
    def jacobian(self) -> Callable[..., ca.MX]:
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
    def hessian(self) -> Callable[..., ca.MX]:
        """(z, weight, multipliers) -> nonzeros of the second derivatives of the Lagrangian."""
        return self._function(self._lagrangian[0], ca.vertcat(*self.second_derivatives.nonzeros()))

    @cached_property
    def lagrangian_gradient(self) -> Callable[..., ca.MX]:
        """(z, weight, multipliers) -> gradient of the Lagrangian."""
        inputs, value = self._lagrangian
        return self._function(inputs, ca.gradient(value, self._by))

    def action_and_derivative(self, row: int) -> Callable[..., tuple[ca.MX, ca.MX]]:
        """(z, weight, multipliers) -> action, and derivative of the Lagrangian by one input."""
        inputs, value = self._lagrangian
        return self._function(inputs, self.action, ca.jacobian(value, self.z[row]))


def pointwise_terms(problem: ControlProblem, embedding: ChainEmbedding, mapping: PointMap) -> list[PointwiseTerms]:
    """The terms at all kinds of places that exist."""
    make: dict[PlaceLayout, Callable[..., Terms]] = {
        embedding.points: _at_points,
        embedding.either_end: _at_either_end,
        embedding.both_ends: partial(_at_both_ends, conditions=embedding.chain.end_conditions[0]),
        embedding.nodes: _at_nodes,
        **{
            place: partial(_at_crossing, crossing=crossing)
            for place, crossing in zip(embedding.crossings, problem.crossings, strict=True)
        },
    }
    all_terms = []
    for place, active in zip(embedding.inputs, embedding.active, strict=True):
        z = ca.SX.sym("z", place.width)
        inputs = dict(zip(place.rows, ca.vertsplit(z, np.cumsum([0, *place.rows.values()]).tolist()), strict=True))
        inputs["parameters"] = [] if problem.parameters is None else [inputs["parameters"]]
        terms = make[place](problem, *inputs.values())
        all_terms.append(PointwiseTerms(mapping, place.count, z, active, **terms))
    return all_terms


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
    rows.append(problem.path_constraint[0](*state))
    return {"rows": ca.vertcat(*rows), "cost": h * problem.running_cost(*state), "action": action}


def _at_either_end(problem: ControlProblem, *inputs: Any) -> Terms:
    x, v, p, t, sizes = inputs
    rows = [_momentum(problem, t, x, _filled(v, x), p) / sizes]
    if problem.constraint is not None:
        g = problem.constraint(t, x, *p)
        rows.append(ca.mtimes(ca.jacobian(g, x), v) + ca.jacobian(g, t))
    return {"rows": ca.vertcat(*rows)}


def _at_both_ends(problem: ControlProblem, *inputs: Any, conditions: ca.Function) -> Terms:
    x0, v0, x1, v1, p, t = inputs
    last = x1, _filled(v1, x1)
    rows = conditions(x0, _filled(v0, x0), *last, *p)
    cost = {} if problem.terminal_cost is None else {"cost": problem.terminal_cost(t, *last, *p)}
    return {"rows": rows, **cost}


def _at_nodes(problem: ControlProblem, *inputs: Any) -> Terms:
    x, impulse, duration, p, begin, fraction, sizes = inputs
    assert problem.constraint is not None, "there are such places only with a constraint"
    g = problem.constraint(begin + duration * fraction, x, *p)
    return {"rows": ca.vertcat(g, ca.mtimes(ca.jacobian(g, x).T, impulse) / sizes)}


def _at_crossing(problem: ControlProblem, *inputs: Any, crossing: Crossing) -> Terms:
    x, v, duration, p, begin, fraction, sizes = inputs
    t, before = begin + duration * fraction, (x, _filled(v, x))
    after = before if crossing.jump is None else crossing.jump(*before, *p)
    rows = [after[0], *(_momentum(problem, t, place, velocity, p) / sizes for place, velocity in (before, after))]
    if crossing.condition is not None:
        rows.append(crossing.condition[0](*before, *p))
    return {"rows": ca.vertcat(*rows)}


def _momentum(problem: ControlProblem, t: ca.SX, x: ca.SX, v: ca.SX, p: list[ca.SX]) -> ca.SX:
    """∂L/∂v of the mechanical components."""
    return momentum_at(problem.lagrangian, t, x, v, *p)[: problem.mechanical, 0]


def _filled(v: ca.SX, x: ca.SX) -> ca.SX:
    """Velocities of all components, with zeros for those that follow a rate, on whose velocities nothing depends."""
    return v if v.numel() == x.numel() else ca.vertcat(v, ca.SX(x.numel() - v.numel(), 1))
