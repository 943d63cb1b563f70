"""The optimisation's functions and exact derivatives, as CasADi graphs; nothing is differentiated through them.

With A, Ê and Θ of the `ControlNumbering`, and at every quadrature point z_k the cost and the rows

    c_k = w_k h ℓ(t, x, v, u),      e_k = [ ∂L̂/∂x + h F,  ∂L̂/∂x',  g ],      L̂ = h L(t, x, x'/h),

(at the ends c = τ, the terminal cost, and e = [p_0, p_N] with p = ∂L/∂v(t, x, v))

    cost        f  = Σ c_k                        ∇f = Êᵀ [∇c_k]
    equations   G  = Θ [e_k]                      ∇G = Θ blockdiag(∇e_k) Ê
    Lagrangian  f̄  = φ f + λ·G                    ∇²f̄ = Êᵀ blockdiag(∇²[φ c_k + e_k·(Θᵀλ)_k]) Ê

The multipliers λ are a discrete path: (Θᵀλ)_k = w_k (δx, δx') is its embedding at the point, weighted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.lazy import lazy
from casadi_galerkin.control.numbering import ControlNumbering
from casadi_galerkin.control.pointwise import places
from casadi_galerkin.problems.control_problem import ControlProblem

RESTING = 1e-13  # terms of motion below this part of what cancels in them are its roundoff

Vector: TypeAlias = Any  # MX in the graph, DM where the same is evaluated in numbers


@dataclass(frozen=True)
class Report:
    """What is told of a point.

    Attributes
    ----------
    cost : f
    equations, terms : G, and the sizes of the terms it compares
    slopes : (N r,), derivative of every point's Lagrangian by its share of the duration
    z, rows : (rows, N r), what is known at the quadrature points, and e there
    """

    cost: float
    equations: np.ndarray
    terms: np.ndarray
    slopes: np.ndarray
    z: np.ndarray
    rows: np.ndarray


class ControlGraph:
    """The NLP of a control problem as Functions of (unknowns, data).

    Parameters
    ----------
    problem : ControlProblem
    numbering : ControlNumbering
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

    def __init__(self, problem: ControlProblem, numbering: ControlNumbering, first: np.ndarray) -> None:
        self.numbering, self.places = numbering, places(problem, numbering)
        weights = ca.repmat(ca.DM(numbering.method.element.weights).T, 1, numbering.intervals)
        self.weights = [weights, ca.DM(1)]
        self.sizes = self._sizes(first)
        divisors = np.append(np.tile(self.sizes, numbering.nodes), np.ones(numbering.constraints * numbering.points))
        self.test = ca.mtimes(numbering.test, ca.diag(1 / divisors))
        self.unknowns = ca.MX.sym("unknowns", numbering.unknowns)
        self.data = ca.MX.sym("data", numbering.size - numbering.unknowns)
        self.at = self._embedded(ca.vertcat(self.unknowns, self.data))
        self.cost = self._cost(self.at)
        self.equations = ca.mtimes(self.test.T, self._stack(self._evaluate("equations", self.at)))

    def _sizes(self, first: np.ndarray) -> np.ndarray:
        """Largest sum of terms of an equation of motion at a guess, one per component; 1 where that says nothing."""
        at = self._embedded(ca.DM(first))
        terms = self._terms(self.numbering.test, at, self._evaluate("equations", at), first)
        d = self.numbering.dimension
        sizes = np.max(terms[: self.numbering.nodes * d].reshape(-1, d), axis=0)
        return np.asarray(np.where(np.isfinite(sizes) & (sizes > 0), sizes, 1.0))

    def _terms(self, test: ca.DM, at: list[ca.DM], rows: list[ca.DM], everything: np.ndarray) -> np.ndarray:
        """Sizes |Θ| |e| of the terms of the equations; |Θ| |∇e| |A| |ξ| for a component that stands still.

        There the first are roundoff of slopes, and say nothing; the second are what cancels in the slopes.
        """
        blocks = self._blocks([p.jacobian_pattern for p in self.places], self._evaluate("jacobian", at))
        spread = ca.mtimes(ca.fabs(blocks), ca.mtimes(ca.fabs(self.numbering.differentiated), np.abs(everything)))
        weights, shape = ca.fabs(test.T), (self.numbering.nodes, self.numbering.dimension)
        terms, cancelled = (np.array(ca.mtimes(weights, part)).ravel() for part in (ca.fabs(self._stack(rows)), spread))
        motion = np.prod(shape)
        moving, still = terms[:motion].reshape(shape), cancelled[:motion].reshape(shape)
        resting = np.max(moving, axis=0) <= RESTING * np.max(still, axis=0)
        terms[:motion] = np.where(resting & np.all(np.isfinite(still), axis=0), still, moving).ravel()
        terms[motion:] = np.fmax(terms, cancelled)[motion:]  # a path constraint compares what its value is made of
        return np.asarray(terms)

    def _embedded(self, everything: Vector) -> list[Vector]:
        """What is known at all kinds of places, A ξ, as one matrix (rows, count) each."""
        return self._split(ca.mtimes(self.numbering.matrix, everything), [place.z.numel() for place in self.places])

    def _cost(self, at: list[Vector]) -> Vector:
        return sum(ca.sum2(value) for value in self._evaluate("value", at, self.weights))

    def _split(self, stacked: Vector, rows: list[int]) -> list[Vector]:
        """Cut a long vector into one matrix (rows, count) a kind of place."""
        counts = [place.count for place in self.places]
        offsets = np.cumsum([0, *(r * k for r, k in zip(rows, counts, strict=True))]).tolist()
        parts = ca.vertsplit(stacked, offsets)
        return [ca.reshape(part, r, k) for part, r, k in zip(parts, rows, counts, strict=True)]

    @staticmethod
    def _stack(parts: list[Vector]) -> Vector:
        return ca.vertcat(*(ca.vec(part) for part in parts))

    def _evaluate(self, name: str, *arguments: list[Vector]) -> list[Vector]:
        """Evaluate one pointwise Function at all kinds of places."""
        return [getattr(place, name)(*given) for place, *given in zip(self.places, *arguments, strict=True)]

    def _blocks(self, patterns: list[ca.Sparsity], entries: list[Vector]) -> Vector:
        """blockdiag(·) over all places, from the nonzeros of the blocks."""
        blocks = [p for pattern, place in zip(patterns, self.places, strict=True) for p in [pattern] * place.count]
        stacked = self._stack(entries)
        return type(stacked)(ca.diagcat(*blocks), stacked)

    def _name(self, name: str, outputs: list[ca.MX], *extra: ca.MX) -> ca.Function:
        return ca.Function(name, [self.unknowns, self.data, *extra], outputs)

    @lazy
    def gradient(self) -> ca.Function:
        """(unknowns, data) -> f, ∇f."""
        gradients = self._stack(self._evaluate("gradient", self.at, self.weights))
        total = ca.mtimes(self.numbering.derivative.T, gradients)
        return self._name("gradient", [self.cost, ca.densify(total)])

    @lazy
    def jacobian(self) -> ca.Function:
        """(unknowns, data) -> G, ∇G."""
        blocks = self._blocks([place.jacobian_pattern for place in self.places], self._evaluate("jacobian", self.at))
        matrix = ca.mtimes(self.test.T, ca.mtimes(blocks, self.numbering.derivative))
        return self._name("jacobian", [self.equations, matrix])

    def _multiplied(self, factor: Vector, multipliers: Vector) -> tuple[list[Vector], list[Vector]]:
        """Weights φ w_k, and multipliers (Θᵀλ)_k of the rows, at all kinds of places."""
        everywhere = ca.mtimes(self.test, multipliers)
        return [factor * w for w in self.weights], self._split(everywhere, [p.rows.numel() for p in self.places])

    @lazy
    def hessian(self) -> ca.Function:
        """(unknowns, data, φ, λ) -> upper half of ∇²f̄."""
        factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", self.equations.numel())
        entries = self._evaluate("hessian", self.at, *self._multiplied(factor, multipliers))
        blocks = self._blocks([place.hessian_pattern for place in self.places], entries)
        right = ca.mtimes(blocks, self.numbering.derivative)
        left = ca.MX(self.numbering.derivative.T)
        upper = ca.triu(ca.mtimes(left.sparsity(), right.sparsity()))
        return self._name("hessian", [ca.mac(left, right, ca.MX.zeros(upper))], factor, multipliers)

    def report(self, unknowns: np.ndarray, data: np.ndarray, multipliers: np.ndarray | None = None) -> Report:
        """Evaluate all that is told of a point, in numbers; without λ its `slopes` are those of the cost."""
        everything = np.concatenate((unknowns, data))
        at = self._embedded(ca.DM(everything))
        rows = self._evaluate("equations", at)
        given = np.zeros(self.equations.numel()) if multipliers is None else multipliers
        weights, by_rows = self._multiplied(ca.DM(1), ca.DM(given))
        slopes = self.places[0].derivative(self.numbering.point_rows - 1)(at[0], weights[0], by_rows[0])
        equations, slopes = (np.array(a).ravel() for a in (ca.mtimes(self.test.T, self._stack(rows)), slopes))
        terms = self._terms(self.test, at, rows, everything)
        return Report(float(self._cost(at)), equations, terms, slopes, np.array(at[0]), np.array(rows[0]))
