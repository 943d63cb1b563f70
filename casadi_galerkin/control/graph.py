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

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.lazy import lazy
from casadi_galerkin.control.numbering import ControlNumbering
from casadi_galerkin.control.pointwise import places
from casadi_galerkin.functional.embedding import boundary_terms
from casadi_galerkin.functional.numbering import Numbering
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.solvers.buffers import Evaluator

RESTING = 1e-13  # terms of motion below this part of what cancels in them are its roundoff


@dataclass(frozen=True)
class Report:
    """What is told of a point.

    Attributes
    ----------
    cost, action : f, and the discrete action of the Lagrangian alone
    equations, terms : G, not divided by `sizes`, and the sizes of the terms it compares
    momentum : (d, N + 1), at the joints, by the discrete Legendre transform
    hamiltonian : (N,), mean over each interval; without multipliers that of the cost alone
    """

    cost: float
    action: float
    equations: np.ndarray
    terms: np.ndarray
    momentum: np.ndarray
    hamiltonian: np.ndarray


class ControlGraph:
    """The NLP of a control problem as Functions of (unknowns, data).

    Parameters
    ----------
    problem : ControlProblem
    numbering : ControlNumbering
    first : unknowns and data of a guess, to measure the equations of motion by

    Attributes
    ----------
    unknowns, data : MX symbols
    cost, equations : MX expressions f and G
    places : quadrature points, and the ends
    sizes : (equations,), what the solver's equations are divided by: those of motion of each component so that its
        tolerance, which is absolute, does not depend on units
    test : Θᵀ so divided
    """

    def __init__(self, problem: ControlProblem, numbering: ControlNumbering, *first: np.ndarray) -> None:
        self.numbering, self.places = numbering, places(problem, numbering)
        weights = ca.repmat(ca.DM(numbering.method.element.weights).T, 1, numbering.intervals)
        self.weights = [weights, ca.DM(1)]
        self.unknowns = ca.MX.sym("unknowns", numbering.unknowns)
        self.data = ca.MX.sym("data", numbering.size - numbering.unknowns)
        self.at = self._embedded(ca.vertcat(self.unknowns, self.data))
        self.cost = self._total("value")
        self.sizes = self._sizes(*first)
        self.test = ca.mtimes(numbering.test, ca.diag(1 / self.sizes))
        self.equations = ca.mtimes(self.test.T, self._stack(self._evaluate("equations", self.at)))

    def _sizes(self, unknowns: np.ndarray, data: np.ndarray) -> np.ndarray:
        """Largest sum of terms of an equation of motion at a guess, by component; 1 where that says nothing."""
        nodes, d = self.numbering.nodes, self.numbering.dimension
        sizes = np.max(self.report(unknowns, data).terms[: nodes * d].reshape(-1, d), axis=0)
        motion = np.tile(np.where(np.isfinite(sizes) & (sizes > 0), sizes, 1.0), nodes)
        return np.append(motion, np.ones(self.numbering.constraints * self.numbering.points))

    def _terms(self, moving: np.ndarray, cancelled: np.ndarray) -> np.ndarray:
        """Sizes |Θ| |e| of the terms of the equations; |Θ| |∇e| |A| |ξ| for a component that stands still.

        There the first are roundoff of slopes, and say nothing; the second are what cancels in the slopes.
        """
        shape = nodes, d = self.numbering.nodes, self.numbering.dimension
        terms, motion = np.fmax(moving, cancelled), nodes * d  # a path constraint compares what its value is made of
        moving, still = moving[:motion].reshape(shape), cancelled[:motion].reshape(shape)
        largest = still.max(axis=0)
        resting = (moving.max(axis=0) <= RESTING * largest) & np.isfinite(largest)
        terms[:motion] = np.where(resting, still, moving).ravel()
        return np.asarray(terms)

    def _embedded(self, everything: ca.MX) -> list[ca.MX]:
        """What is known at all kinds of places, A ξ, as one matrix (rows, count) each."""
        return self._split(ca.mtimes(self.numbering.matrix, everything), [place.z.numel() for place in self.places])

    def _total(self, name: str) -> ca.MX:
        """Sum of a weighted pointwise scalar over all places."""
        return sum(ca.sum2(value) for value in self._evaluate(name, self.at, self.weights))

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
        return [getattr(place, name)(*given) for place, *given in zip(self.places, *arguments, strict=True)]

    def _blocks(self, patterns: list[ca.Sparsity], entries: list[ca.MX]) -> ca.MX:
        """blockdiag(·) over all places, from the nonzeros of the blocks."""
        blocks = [p for pattern, place in zip(patterns, self.places, strict=True) for p in [pattern] * place.count]
        stacked = self._stack(entries)
        return ca.MX(ca.diagcat(*blocks), stacked)

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

    def _along(self, test: ca.DM, multipliers: ca.MX) -> list[ca.MX]:
        """Multipliers (Θᵀλ)_k of the rows, at all kinds of places."""
        return self._split(ca.mtimes(test, multipliers), [place.rows.numel() for place in self.places])

    @lazy
    def hessian(self) -> ca.Function:
        """(unknowns, data, φ, λ) -> upper half of ∇²f̄."""
        factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", self.equations.numel())
        weights, along = [factor * w for w in self.weights], self._along(self.test, multipliers)
        entries = self._evaluate("hessian", self.at, weights, along)
        blocks = self._blocks([place.hessian_pattern for place in self.places], entries)
        right = ca.mtimes(blocks, self.numbering.derivative)
        left = ca.MX(self.numbering.derivative.T)
        upper = ca.triu(ca.mtimes(left.sparsity(), right.sparsity()))
        return self._name("hessian", [ca.mac(left, right, ca.MX.zeros(upper))], factor, multipliers)

    @lazy
    def _verification(self) -> ca.Function:
        """(unknowns, data, λ) -> all that is told of a point as one vector, with equations that nothing divides."""
        numbering, (point, _) = self.numbering, self.places
        d, test = numbering.dimension, numbering.test
        rows = self._evaluate("equations", self.at)
        blocks = self._blocks([place.jacobian_pattern for place in self.places], self._evaluate("jacobian", self.at))
        everything = ca.vertcat(self.unknowns, self.data)
        cancelled = ca.mtimes(ca.fabs(blocks), ca.mtimes(ca.fabs(numbering.differentiated), ca.fabs(everything)))
        by_part = np.arange(numbering.points).reshape(numbering.intervals, -1).T.ravel().tolist()
        slopes = (rows[0][:d, by_part], rows[0][d : 2 * d, by_part])
        multipliers = ca.MX.sym("multipliers", numbering.equations)
        along, _ = self._along(test, multipliers)
        shares = point.derivative(numbering.point_rows - 1)(self.at[0], self.weights[0], along)
        duration = everything[numbering.fields["duration"].tolist()]
        told = [
            self.cost,
            self._total("weighted_action"),
            ca.mtimes(test.T, self._stack(rows)),
            ca.mtimes(ca.fabs(test.T), ca.fabs(self._stack(rows))),
            ca.mtimes(ca.fabs(test.T), cancelled),
            boundary_terms(Numbering(numbering.method, numbering.intervals, d))(*slopes)[0],
            ca.sum1(ca.reshape(shares, -1, numbering.intervals)) / duration,
        ]
        return self._name("verification", [ca.densify(ca.veccat(*told))], multipliers)

    def report(self, unknowns: np.ndarray, data: np.ndarray, multipliers: np.ndarray | None = None) -> Report:
        """Evaluate all that is told of a point; the multipliers are those of the undivided equations."""
        count, d = self.numbering.equations, self.numbering.dimension
        given = np.zeros(count) if multipliers is None else multipliers
        (told,) = Evaluator(self._verification)(unknowns, data, given)
        cost, action = told[:2].tolist()
        equations, moving, cancelled = told[2 : 2 + 3 * count].reshape(3, -1)
        momentum = told[2 + 3 * count : -self.numbering.intervals].reshape(d, -1, order="F")
        terms, hamiltonian = self._terms(moving, cancelled), told[-self.numbering.intervals :]
        return Report(cost, action, equations, terms, momentum, hamiltonian)
