"""The optimisation's functions and exact derivatives, as CasADi graphs; nothing is differentiated through them.

With A, Ê and Θ of the `ControlLayout`, and at every quadrature point z_k the cost and the rows

    c_k = w_k h ℓ(t, x, v, u),      e_k = [ ∂L̂/∂x + h F,  ∂L̂/∂x',  g ],      L̂ = h L(t, x, x'/h),

(at the ends c = τ, the terminal cost, and e = [p_0, p_N] with p = ∂L/∂v(t, x, v))

    cost        f  = Σ c_k                        ∇f = Êᵀ [∇c_k]
    equations   G  = Θ [e_k]                      ∇G = Θ blockdiag(∇e_k) Ê
    Lagrangian  f̄  = φ f + λ·G                    ∇²f̄ = Êᵀ blockdiag(∇²[φ c_k + e_k·(Θᵀλ)_k]) Ê

The multipliers λ are a discrete path: (Θᵀλ)_k = w_k (δx, δx') is its embedding at the point, weighted.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from casadi_galerkin.control_layout import ControlLayout
from casadi_galerkin.control_problem import ControlProblem


@dataclass(frozen=True)
class Place:
    """The pointwise Functions at one kind of place, and how many such places there are.

    Parameters
    ----------
    name : of the place
    count : number of places
    z : SX, what is known at the place
    active : rows of z that are differentiated by
    cost, rows : SX expressions in z
    """

    name: str
    count: int
    z: ca.SX
    active: np.ndarray
    cost: ca.SX
    rows: ca.SX

    @property
    def _by(self) -> ca.SX:
        return self.z[self.active.tolist()]

    def _function(self, inputs: list[ca.SX], output: ca.SX) -> ca.Function:
        function = ca.Function(self.name, inputs, [ca.densify(output)])
        return function.map(self.count) if self.count > 1 else function

    @cached_property
    def value(self) -> ca.Function:
        """(z, weight) -> weighted cost, one a place."""
        weight = ca.SX.sym("weight")
        return self._function([self.z, weight], weight * self.cost)

    @cached_property
    def gradient(self) -> ca.Function:
        """(z, weight) -> weighted gradient of the cost."""
        weight = ca.SX.sym("weight")
        return self._function([self.z, weight], weight * ca.gradient(self.cost, self._by))

    @cached_property
    def equations(self) -> ca.Function:
        """Rows of (z)."""
        return self._function([self.z], self.rows)

    @cached_property
    def _jacobian(self) -> ca.SX:
        return ca.jacobian(self.rows, self._by)

    @property
    def jacobian_pattern(self) -> ca.Sparsity:
        """Pattern of the derivatives of the rows at one place."""
        return self._jacobian.sparsity()

    @cached_property
    def jacobian(self) -> ca.Function:
        """Nonzeros of the derivatives of the rows, of (z)."""
        return self._function([self.z], ca.vertcat(*self._jacobian.nonzeros()))

    @cached_property
    def _lagrangian(self) -> tuple[list[ca.SX], ca.SX]:
        """Inputs (z, weight, multipliers), and the weighted cost with the multiplied rows."""
        weight, multipliers = ca.SX.sym("weight"), ca.SX.sym("multipliers", self.rows.numel())
        return [self.z, weight, multipliers], weight * self.cost + ca.dot(multipliers, self.rows)

    @cached_property
    def _hessian(self) -> ca.SX:
        return ca.hessian(self._lagrangian[1], self._by)[0]

    @property
    def hessian_pattern(self) -> ca.Sparsity:
        """Pattern of the second derivatives at one place."""
        return self._hessian.sparsity()

    @cached_property
    def hessian(self) -> ca.Function:
        """(z, weight, multipliers) -> nonzeros of the second derivatives of the Lagrangian."""
        return self._function(self._lagrangian[0], ca.vertcat(*self._hessian.nonzeros()))

    def derivative(self, row: int) -> ca.Function:
        """(z, weight, multipliers) -> derivative of the Lagrangian by one row of z."""
        inputs, value = self._lagrangian
        return self._function(inputs, ca.jacobian(value, self.z[row]))


def places(problem: ControlProblem, layout: ControlLayout) -> tuple[Place, Place]:
    """Quadrature points and ends of a problem."""
    d, n = layout.dimension, layout.parameters
    sizes = [d, d, layout.controls, 1, n, 1, 1, 1]
    z = ca.SX.sym("z", layout.point_rows)
    x, slope, u, duration, p, begin, share, part = ca.vertsplit(z, np.cumsum([0, *sizes]).tolist())
    t, h, given = begin + duration * share, duration * part, [p] if n else []
    pulled = h * problem.lagrangian(t, x, slope / h, *given)
    at = (t, x, slope / h, u, *given)
    rows = [ca.gradient(pulled, x) + h * problem.force(*at), ca.gradient(pulled, slope)]
    if problem.path_constraint is not None:
        rows.append(problem.path_constraint[0](*at))
    point = Place(
        "point",
        layout.points,
        z,
        layout.active(2 * d + layout.controls),
        h * problem.running_cost(*at),
        ca.vertcat(*rows),
    )
    z = ca.SX.sym("z", layout.end_rows)
    sizes = [d, d, d, d, 1, n, 1, 1, 1]
    *states, duration, p, begin, first, last = ca.vertsplit(z, np.cumsum([0, *sizes]).tolist())
    given = [p] if n else []
    start, end = ((begin + duration * s, *states[2 * k : 2 * k + 2]) for k, s in ((0, first), (1, last)))
    momenta = [ca.gradient(problem.lagrangian(*at, *given), at[2]) for at in (start, end)]
    terminal = ca.SX(1, 1) if problem.terminal_cost is None else problem.terminal_cost(*end, *given)
    return point, Place("ends", 1, z, layout.active(4 * d), terminal, ca.vertcat(*momenta))


class ControlGraph:
    """The NLP of a control problem as Functions of (unknowns, data).

    Parameters
    ----------
    problem : ControlProblem
    layout : ControlLayout
    first : (unknowns and data,) a guess, to measure the equations of motion by

    Attributes
    ----------
    unknowns, data : MX symbols
    cost, equations : MX expressions f and G
    places : quadrature points, and the ends
    sizes : (d,), what the equations of motion of each component are divided by, so that the solver's tolerance, which
        is absolute, does not depend on units
    test : Θᵀ so divided
    """

    def __init__(self, problem: ControlProblem, layout: ControlLayout, first: np.ndarray) -> None:
        self.layout, self.places = layout, places(problem, layout)
        self.sizes = self._sizes(first)
        divisors = np.append(np.tile(self.sizes, layout.nodes), np.ones(layout.constraints * layout.points))
        self.test = ca.mtimes(layout.test, ca.diag(1 / divisors))
        self.unknowns = ca.MX.sym("unknowns", layout.unknowns)
        self.data = ca.MX.sym("data", layout.size - layout.unknowns)
        everything = ca.mtimes(ca.MX(layout.matrix), ca.vertcat(self.unknowns, self.data))
        self.at = self._split(everything, [place.z.numel() for place in self.places])
        weights = ca.repmat(ca.DM(layout.method.element.weights).T, 1, layout.intervals)
        self.weights = [ca.MX(weights), ca.MX(1)]
        self.rows = self._evaluate("equations")
        self.cost = sum(ca.sum2(value) for value in self._evaluate("value", self.weights))
        self.equations = ca.mtimes(ca.MX(self.test.T), self._stack(self.rows))

    def _sizes(self, first: np.ndarray) -> np.ndarray:
        """Largest sum of terms of an equation of motion at a guess, one a component; 1 where that says nothing."""
        at = np.split(
            np.array(ca.mtimes(self.layout.matrix, first)).ravel(), [self.layout.points * self.layout.point_rows]
        )
        rows = [
            np.array(place.equations(z.reshape(place.count, -1).T)).ravel(order="F")
            for place, z in zip(self.places, at, strict=True)
        ]
        terms = ca.mtimes(ca.fabs(self.layout.test.T), np.abs(np.concatenate(rows)))
        sizes = np.max(
            np.array(terms)[: self.layout.nodes * self.layout.dimension].reshape(-1, self.layout.dimension), axis=0
        )
        return np.asarray(np.where(np.isfinite(sizes) & (sizes > 0), sizes, 1.0))

    def _split(self, stacked: ca.MX, rows: list[int]) -> list[ca.MX]:
        """Cut a long vector into one matrix (rows, count) a kind of place."""
        counts = [place.count for place in self.places]
        offsets = np.cumsum([0, *(r * k for r, k in zip(rows, counts, strict=True))]).tolist()
        parts = ca.vertsplit(stacked, offsets)
        return [ca.reshape(part, r, k) for part, r, k in zip(parts, rows, counts, strict=True)]

    @staticmethod
    def _stack(parts: list[ca.MX]) -> ca.MX:
        return ca.vertcat(*(ca.vec(part) for part in parts))

    def _evaluate(self, name: str, *arguments: list[ca.MX]) -> list[ca.MX]:
        """Evaluate one pointwise Function at all kinds of places."""
        return [getattr(place, name)(*given) for place, *given in zip(self.places, self.at, *arguments, strict=True)]

    def _blocks(self, patterns: list[ca.Sparsity], entries: list[ca.MX]) -> ca.MX:
        """blockdiag(·) over all places, from the nonzeros of the blocks."""
        blocks = [p for pattern, place in zip(patterns, self.places, strict=True) for p in [pattern] * place.count]
        return ca.MX(ca.diagcat(*blocks), self._stack(entries))

    def _name(self, name: str, outputs: list[ca.MX], *extra: ca.MX) -> ca.Function:
        return ca.Function(name, [self.unknowns, self.data, *extra], outputs)

    @cached_property
    def gradient(self) -> ca.Function:
        """(unknowns, data) -> f, ∇f."""
        gradients = self._stack(self._evaluate("gradient", self.weights))
        total = ca.mtimes(ca.MX(self.layout.derivative.T), gradients)
        return self._name("gradient", [self.cost, ca.densify(total)])

    @cached_property
    def jacobian(self) -> ca.Function:
        """(unknowns, data) -> G, ∇G."""
        blocks = self._blocks([place.jacobian_pattern for place in self.places], self._evaluate("jacobian"))
        matrix = ca.mtimes(ca.MX(self.test.T), ca.mtimes(blocks, ca.MX(self.layout.derivative)))
        return self._name("jacobian", [self.equations, matrix])

    def _multiplied(self, factor: ca.MX, multipliers: ca.MX) -> tuple[list[ca.MX], list[ca.MX]]:
        """Weights φ w_k, and multipliers (Θᵀλ)_k of the rows, at all kinds of places."""
        everywhere = ca.mtimes(ca.MX(self.test), multipliers)
        return [factor * w for w in self.weights], self._split(everywhere, [p.rows.numel() for p in self.places])

    @cached_property
    def hessian(self) -> ca.Function:
        """(unknowns, data, φ, λ) -> upper half of ∇²f̄."""
        factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", self.equations.numel())
        entries = self._evaluate("hessian", *self._multiplied(factor, multipliers))
        blocks = self._blocks([place.hessian_pattern for place in self.places], entries)
        right = ca.mtimes(blocks, ca.MX(self.layout.derivative))
        left = ca.MX(self.layout.derivative.T)
        upper = ca.triu(ca.mtimes(left.sparsity(), right.sparsity()))
        return self._name("hessian", [ca.mac(left, right, ca.MX.zeros(upper))], factor, multipliers)

    @cached_property
    def report(self) -> ca.Function:
        """What is told of a point, of (unknowns, data, λ).

        f, G, sizes of the terms of G, z and the rows at the quadrature points, and the derivative of every point's
        Lagrangian by its share of the duration.
        """
        multipliers = ca.MX.sym("multipliers", self.equations.numel())
        weights, rows = self._multiplied(ca.MX(1), multipliers)
        slope = self.places[0].derivative(self.layout.point_rows - 1)(self.at[0], weights[0], rows[0])
        sizes = ca.mtimes(ca.MX(ca.fabs(self.test.T)), ca.fabs(self._stack(self.rows)))
        outputs = [self.cost, self.equations, sizes, self.at[0], self.rows[0], slope]
        return self._name("report", [ca.densify(output) for output in outputs], multipliers)
