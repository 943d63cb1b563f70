"""The optimization's functions and exact derivatives, as CasADi graphs; nothing is differentiated through them.

With A, Ê, Θ and Λ of the `ChainEmbedding`, and at every place z_k the cost c_k and the rows e_k of `pointwise`,

    cost        f  = Σ w_k c_k                    ∇f = Êᵀ [w_k ∇c_k]
    equations   G  = Θ [e_k] + Λ ξ                ∇G = Θ blockdiag(∇e_k) Ê + Λ
    Lagrangian  f̄  = φ f + λ·G                    ∇²f̄ = Êᵀ blockdiag(∇²[φ w_k c_k + e_k·(Θᵀλ)_k]) Ê

The multipliers λ are a discrete path: (Θᵀλ)_k = w_k (δx, δx') is its embedding at the point, weighted.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.lazy import lazy
from casadi_galerkin.control.chain import Chain
from casadi_galerkin.control.embedding import ChainEmbedding
from casadi_galerkin.control.pointwise import places
from casadi_galerkin.functional.buffers import Evaluator, Lender
from casadi_galerkin.functional.mapping import PointMap
from casadi_galerkin.problems.control_problem import ControlProblem

RESTING = 1e-13  # terms of motion below this part of what cancels in them are its roundoff


@dataclass(frozen=True)
class Report:
    """What is told of a point.

    Attributes
    ----------
    cost, action : f, and the discrete action of the Lagrangian alone
    equations, sizes : G, and the largest sum of terms that an equation of every kind compares
    slope : ∇f̄ but for the multipliers of the bounds
    hamiltonian : (N,), mean over each interval; without multipliers that of the cost alone
    arriving : (d, K), derivatives of f̄ by the values before the joints crossed, as far as they count there
    """

    cost: float
    action: float
    equations: np.ndarray
    sizes: np.ndarray
    slope: np.ndarray
    hamiltonian: np.ndarray
    arriving: np.ndarray


class ControlGraph:
    """The nonlinear program of a control problem as Functions of (unknowns, data).

    Parameters
    ----------
    problem : ControlProblem
    chain : Chain
    mapping : how L, cost and forces are evaluated at the points, as for `Functional`

    Attributes
    ----------
    unknowns, data : MX symbols
    cost, equations : MX expressions f and G
    places : kinds of places
    """

    def __init__(self, problem: ControlProblem, chain: Chain, mapping: PointMap) -> None:
        self.chain, self.embedding = chain, ChainEmbedding(chain)
        self.places = places(problem, self.embedding, mapping)
        weights = ca.repmat(ca.DM(chain.method.element.weights).T, 1, chain.intervals)
        self.weights = [weights, *[ca.DM(1)] * (len(self.places) - 1)]
        self.unknowns = ca.MX.sym("unknowns", chain.unknowns)
        self.data = ca.MX.sym("data", chain.size - chain.unknowns)
        everything = ca.mtimes(self.embedding.matrix, ca.vertcat(self.unknowns, self.data))
        self.at = self._split(everything, [place.z.numel() for place in self.places])
        self.cost = self._total("value")
        linear = ca.mtimes(self.embedding.linear, self.unknowns)
        self.equations = ca.mtimes(self.embedding.test.T, self._rows) + linear

    def _total(self, name: str) -> ca.MX:
        """Sum of a weighted pointwise scalar over all places."""
        return ca.sum2(ca.horzcat(*self._evaluate(name, self.at, self.weights)))

    def _split(self, stacked: ca.MX, rows: list[int]) -> list[ca.MX]:
        """Cut a long vector into one matrix (rows, count) for each kind of place."""
        counts = [place.count for place in self.places]
        offsets = np.cumsum([0, *(r * k for r, k in zip(rows, counts, strict=True))]).tolist()
        parts = ca.vertsplit(stacked, offsets)
        return [ca.reshape(part, r, k) for part, r, k in zip(parts, rows, counts, strict=True)]

    def _evaluate(self, name: str, *arguments: list[ca.MX]) -> list[ca.MX]:
        """Evaluate one pointwise Function at all kinds of places."""
        return [getattr(place, name)(*given) for place, *given in zip(self.places, *arguments, strict=True)]

    def _blocks(self, patterns: list[ca.Sparsity], entries: list[ca.MX]) -> ca.MX:
        """blockdiag(·) over all places, from the nonzeros of the blocks."""
        blocks = [p for pattern, place in zip(patterns, self.places, strict=True) for p in [pattern] * place.count]
        return ca.MX(ca.diagcat(*blocks), ca.veccat(*entries))

    @lazy
    def _rows(self) -> ca.MX:
        """[e_k]."""
        return ca.veccat(*self._evaluate("equations", self.at))

    @lazy
    def _gradients(self) -> ca.MX:
        """[w_k ∇c_k]."""
        return ca.veccat(*self._evaluate("gradient", self.at, self.weights))

    @lazy
    def _derivatives(self) -> ca.MX:
        """blockdiag(∇e_k)."""
        return self._blocks([place.jacobian_pattern for place in self.places], self._evaluate("jacobian", self.at))

    def _function(self, name: str, outputs: list[ca.MX], *extra: ca.MX) -> ca.Function:
        """A Function of (unknowns, data, ...); some have the names that the cache of fatrop has for them."""
        return ca.Function(name, [self.unknowns, self.data, *extra], outputs)

    @lazy
    def gradient(self) -> ca.Function:
        """(unknowns, data) -> f, ∇f."""
        total = ca.mtimes(self.embedding.derivative.T, self._gradients)
        return self._function("gradient", [self.cost, ca.densify(total)])

    @lazy
    def jacobian(self) -> ca.Function:
        """(unknowns, data) -> G, ∇G."""
        embedding = self.embedding
        matrix = ca.mtimes(embedding.test.T, ca.mtimes(self._derivatives, embedding.derivative)) + embedding.linear
        return self._function("nlp_jac_g", [self.equations, matrix])

    def _along(self, multipliers: ca.MX) -> list[ca.MX]:
        """Multipliers (Θᵀλ)_k of the rows, at all kinds of places."""
        return self._split(ca.mtimes(self.embedding.test, multipliers), [place.rows.numel() for place in self.places])

    def _slope(self, at_places: ca.MX, multipliers: ca.MX) -> ca.MX:
        """∇f̄, from the gradients of its terms at all places."""
        return ca.mtimes(self.embedding.derivative.T, at_places) + ca.mtimes(self.embedding.linear.T, multipliers)

    @lazy
    def _lagrangian(self) -> tuple[ca.MX, ca.MX, tuple[list[ca.MX], ...]]:
        """Symbols φ and λ, and what the pointwise derivatives of f̄ are evaluated at."""
        factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", self.chain.equations)
        return factor, multipliers, (self.at, [factor * w for w in self.weights], self._along(multipliers))

    @lazy
    def _upper_hessian(self) -> ca.MX:
        """Upper half of ∇²f̄."""
        entries = self._evaluate("hessian", *self._lagrangian[2])
        blocks = self._blocks([place.hessian_pattern for place in self.places], entries)
        left, right = ca.MX(self.embedding.derivative.T), ca.mtimes(blocks, self.embedding.derivative)
        pattern = ca.mtimes(left.sparsity(), right.sparsity())
        return ca.mac(left, right, ca.MX.zeros(ca.triu(pattern)))

    @lazy
    def hessian(self) -> ca.Function:
        """(unknowns, data, φ, λ) -> upper half of ∇²f̄."""
        return self._function("hessian", [self._upper_hessian], *self._lagrangian[:2])

    @lazy
    def whole_hessian(self) -> ca.Function:
        """(unknowns, data, φ, λ) -> ∇f̄, ∇²f̄."""
        factor, multipliers, given = self._lagrangian
        slope = self._slope(ca.veccat(*self._evaluate("lagrangian_gradient", *given)), multipliers)
        outputs = [ca.densify(slope), ca.triu2symm(self._upper_hessian)]
        return self._function("nlp_hess_l", outputs, factor, multipliers)

    @lazy
    def _verification(self) -> Lender[Evaluator]:
        """(unknowns, data, λ) -> all that is told of a point as one vector."""
        chain, embedding, point = self.chain, self.embedding, self.places[0]
        everything = ca.fabs(ca.vertcat(self.unknowns, self.data))
        linear = ca.mtimes(ca.fabs(embedding.linear), everything[: chain.unknowns])
        canceled = ca.mtimes(ca.fabs(self._derivatives), ca.mtimes(ca.fabs(embedding.differentiated), everything))
        multipliers = ca.MX.sym("multipliers", chain.equations)
        along = self._along(multipliers)
        part = int(embedding.points.row("part")[0, 0])
        shares = point.derivative(part)(self.at[0], self.weights[0], along[0])
        durations = self.at[0][int(embedding.points.row("duration")[0, 0]), :]
        given = list(zip(self.places, self.at, self.weights, along, strict=True))
        crossings = given[len(given) - len(chain.crossed) :]
        values = [
            self.cost,
            self._total("weighted_action"),
            self.equations,
            ca.mtimes(ca.fabs(embedding.test.T), ca.fabs(self._rows)) + linear,
            ca.mtimes(ca.fabs(embedding.test.T), canceled) + linear,
            self._slope(self._gradients + ca.mtimes(self._derivatives.T, ca.veccat(*along)), multipliers),
            ca.sum1(ca.reshape(shares / durations, -1, chain.intervals)),
            *(place.lagrangian_gradient(*z)[: chain.dimension] for place, *z in crossings),
        ]
        verification = self._function("verification", [ca.densify(ca.veccat(*values))], multipliers)
        return Lender(lambda: Evaluator(verification))

    def report(self, unknowns: np.ndarray, data: np.ndarray, multipliers: np.ndarray | None = None) -> Report:
        """Evaluate all that is told of a point."""
        count, chain = self.chain.equations, self.chain
        given = np.zeros(count) if multipliers is None else multipliers
        with self._verification.lend() as evaluate:
            (values,) = evaluate(unknowns, data, given)
        (cost, action), rest = values[:2].tolist(), values[2 + 3 * count :]
        equations, *terms = values[2 : 2 + 3 * count].reshape(3, -1)
        # The terms of a component that stands still are roundoff of its slopes: what cancels in the slopes measures it.
        # Those of another are measured without it.
        moving, canceled = map(chain.largest, terms)
        resting = np.isfinite(canceled) & (moving <= RESTING * canceled)
        sizes = np.fmax(moving, canceled)
        sizes[chain.motions] = np.where(resting, canceled, moving)[chain.motions]
        slope, others = rest[: chain.unknowns], rest[chain.unknowns :]
        hamiltonian, arriving = others[: chain.intervals], others[chain.intervals :]
        return Report(cost, action, equations, sizes, slope, hamiltonian, arriving.reshape(-1, chain.dimension).T)
