"""Cost, equations and their exact derivatives as CasADi graphs, assembled from pointwise derivatives.

With A, Ê, Θ and Λ of the `ChainEmbedding`, and at every place z_k the cost c_k and the rows e_k of `control_terms`,

    cost        f  = Σ w_k c_k                    ∇f = Êᵀ [w_k ∇c_k]
    equations   G  = Θ [e_k] + Λ y                ∇G = Θ blockdiag(∇e_k) Ê + Λ
    Lagrangian  f̄  = φ f + λ·G                    ∇²f̄ = Êᵀ blockdiag(∇²[φ w_k c_k + e_k·(Θᵀλ)_k]) Ê

The y are the unknowns in ξ.  The multipliers λ of the equations of motion are a discrete path, and (Θᵀλ)_k = w_k (δx,
δx') is its embedding at the point, weighted.  The inputs, or the outputs, at all places of one kind are one matrix with
a column for every place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.roundoff import largest_of
from casadi_galerkin.control.control_embedding import ChainEmbedding, PlaceLayout
from casadi_galerkin.control.control_numbering import Chain
from casadi_galerkin.control.control_terms import pointwise_terms
from casadi_galerkin.functional.buffers import Evaluator, ObjectPool
from casadi_galerkin.functional.mapping import PointMap
from casadi_galerkin.problems.control_problem import ControlProblem

ROUNDOFF_ONLY = 1e-13  # ratio of the two sizes of an equation of motion below which its terms are roundoff only
# part of the cost of a change as large as the path itself above which the cost measures its own errors: the cost of a
# path that follows a curve exactly is that of its errors, which falls with any mesh
LEAST_COST = 1e-6


@dataclass(frozen=True)
class Report:
    """Values and sizes at a point of the program.

    Attributes
    ----------
    cost, action : f, and the discrete action of the Lagrangian alone
    cost_size : size of f or, where that is larger, `LEAST_COST` times that of the terms of its second variation for the
        changes of all values along the path
    equations, sizes : G, and for every kind of equation the largest sum of the sizes of the terms of one
    slope : ∇f̄ without the multipliers of the bounds
    hamiltonian : (N,), mean over each interval; without multipliers that of the cost alone
    arriving : (d, K), derivatives by x before the crossings of the terms of f̄ there
    """

    cost: float
    cost_size: float
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
    terms : PointwiseTerms of all kinds of places
    inputs : MX expressions A ξ, the inputs at all kinds of places
    """

    def __init__(self, problem: ControlProblem, chain: Chain, mapping: PointMap) -> None:
        self.chain, self.embedding = chain, ChainEmbedding(chain)
        made = self.embedding
        self.terms = pointwise_terms(problem, made, mapping)
        self.unknowns, self.data = ca.MX.sym("unknowns", chain.unknowns), ca.MX.sym("data", chain.size - chain.unknowns)
        self._everything = ca.vertcat(self.unknowns, self.data)
        self.inputs = _split(ca.mtimes(made.matrix, self._everything), made.inputs)
        self._weights = ca.MX(ca.repmat(ca.DM(chain.method.element.weights).T, 1, chain.intervals))
        self.cost = ca.densify(self._integral(self._evaluate("value", self.inputs)))
        self._rows = self._evaluate("equations", self.inputs)
        summed = ca.mtimes(made.test.T, ca.veccat(*self._rows)) + ca.mtimes(made.linear, self.unknowns)
        self.equations = ca.densify(summed)

    def _evaluate(self, name: str, *arguments: list[ca.MX]) -> list[ca.MX]:
        """Evaluate one pointwise Function at all kinds of places."""
        return [getattr(place, name)(*given) for place, *given in zip(self.terms, *arguments, strict=True)]

    def _integral(self, values: list[ca.MX]) -> ca.MX:
        """The integral of values at the quadrature points, plus those at all other kinds of places."""
        return ca.sum2(ca.horzcat(self._weights * values[0], *values[1:]))

    def _blocks(self, patterns: list[ca.Sparsity], entries: list[ca.MX]) -> ca.MX:
        """Blockdiag(·) of one matrix per place, from their nonzeros at all kinds of places."""
        kinds = zip(patterns, self.embedding.inputs, strict=True)
        blocks = [block for pattern, place in kinds for block in [pattern] * place.count]
        return ca.MX(ca.diagcat(*blocks), ca.veccat(*entries))

    @cached_property
    def _gradients(self) -> ca.MX:
        """[w_k ∇c_k], structurally zero at places without costs."""
        gradients = self._evaluate("gradient", self.inputs)
        gradients[0] *= ca.repmat(self._weights, gradients[0].size1(), 1)
        return ca.veccat(*gradients)

    @cached_property
    def _derivatives(self) -> ca.MX:
        """Blockdiag(∇e_k)."""
        patterns = [place.derivatives.sparsity() for place in self.terms]
        return self._blocks(patterns, self._evaluate("jacobian", self.inputs))

    def _function(self, name: str, outputs: list[ca.MX], *extra: ca.MX) -> ca.Function:
        """A Function of (unknowns, data, ...); some have names under which fatrop looks for them."""
        return ca.Function(name, [self.unknowns, self.data, *extra], outputs)

    @cached_property
    def gradient(self) -> ca.Function:
        """(unknowns, data) -> f, ∇f."""
        slope = ca.densify(ca.mtimes(self.embedding.derivative.T, self._gradients))
        return self._function("gradient", [self.cost, slope])

    @cached_property
    def jacobian(self) -> ca.Function:
        """(unknowns, data) -> G, ∇G."""
        made = self.embedding
        matrix = ca.mtimes(made.test.T, ca.mtimes(self._derivatives, made.derivative)) + made.linear
        return self._function("nlp_jac_g", [self.equations, matrix])

    @cached_property
    def _lagrangian(self) -> tuple[ca.MX, ca.MX, tuple[list[ca.MX], ...], ca.MX]:
        """Symbols φ and λ, the arguments of the pointwise derivatives of f̄, and Λᵀλ."""
        made, factor, multipliers = self.embedding, ca.MX.sym("factor"), ca.MX.sym("multipliers", self.chain.equations)
        weights = [factor * self._weights] + [factor] * (len(self.terms) - 1)
        local_multipliers = _split(ca.mtimes(made.test, multipliers), made.outputs)
        return factor, multipliers, (self.inputs, weights, local_multipliers), ca.mtimes(made.linear.T, multipliers)

    @cached_property
    def _upper_hessian(self) -> ca.MX:
        """Upper half of ∇²f̄."""
        patterns = [place.second_derivatives.sparsity() for place in self.terms]
        blocks = self._blocks(patterns, self._evaluate("hessian", *self._lagrangian[2]))
        left, right = ca.MX(self.embedding.derivative.T), ca.mtimes(blocks, self.embedding.derivative)
        return ca.mac(left, right, ca.MX.zeros(ca.triu(ca.mtimes(left.sparsity(), right.sparsity()))))

    @cached_property
    def hessian(self) -> ca.Function:
        """(unknowns, data, φ, λ) -> upper half of ∇²f̄."""
        return self._function("hessian", [self._upper_hessian], *self._lagrangian[:2])

    @cached_property
    def whole_hessian(self) -> ca.Function:
        """(unknowns, data, φ, λ) -> ∇f̄, ∇²f̄."""
        factor, multipliers, given, linear = self._lagrangian
        gradients = ca.veccat(*self._evaluate("lagrangian_gradient", *given))
        slope = ca.densify(ca.mtimes(self.embedding.derivative.T, gradients) + linear)
        return self._function("nlp_hess_l", [slope, ca.triu2symm(self._upper_hessian)], factor, multipliers)

    @cached_property
    def _verification(self) -> ObjectPool[Evaluator]:
        """(unknowns, data, φ, λ, sizes of the unknowns) -> the arrays of a `Report`.

        Two sizes of every equation are among them: the sum of the sizes of its terms, and the sum of the sizes of the
        terms of these, Σ |∂e/∂z| |z|, which may cancel.
        """
        chain, made, (factor, multipliers, given, linear) = self.chain, self.embedding, self._lagrangian
        (at, weights, local_multipliers), points = given, made.points
        part, duration = (int(points.row(name)[0, 0]) for name in ("part", "duration"))
        actions, by_step = self.terms[0].action_and_derivative(part)(at[0], weights[0], local_multipliers[0])
        test, sizes = ca.fabs(made.test.T), ca.MX.sym("sizes", chain.unknowns)
        others = ca.mtimes(ca.fabs(made.linear), sizes)
        magnitudes = ca.mtimes(ca.fabs(made.differentiated), ca.vertcat(sizes, ca.fabs(self.data)))
        canceled = ca.mtimes(ca.fabs(self._derivatives), magnitudes)
        slopes = self._gradients + ca.mtimes(self._derivatives.T, ca.veccat(*local_multipliers))
        active = [z[place.active.tolist(), :] for place, z in zip(self.terms, self.inputs, strict=True)]
        changes = [z - ca.repmat(ca.sum2(z) / z.shape[1], 1, z.shape[1]) for z in active]
        crossings = list(zip(self.terms, *given, strict=True))[len(at) - len(chain.crossed) :]
        arriving = ca.veccat(*(place.lagrangian_gradient(*z)[: chain.dimension] for place, *z in crossings))
        outputs = [
            self.cost,
            self._integral(self._evaluate("cost_terms", self.inputs, changes)),
            self.equations,
            ca.sum2(self._weights * actions),
            ca.mtimes(test, ca.fabs(ca.veccat(*self._rows))) + others,
            ca.mtimes(test, canceled) + others,
            ca.mtimes(made.derivative.T, slopes) + linear,
            ca.sum1(ca.reshape(by_step / at[0][duration, :], -1, chain.intervals)),
            arriving,
        ]
        verification = self._function("verification", [*map(ca.densify, outputs)], factor, multipliers, sizes)
        return ObjectPool(lambda: Evaluator(verification))

    def report(self, unknowns: np.ndarray, data: np.ndarray, multipliers: np.ndarray | None = None) -> Report:
        """Evaluate the `Report` of a point.

        The sizes of the unknowns are the largest of their kind: an end or a waypoint may be where the path is at zero.
        """
        chain = self.chain
        given = np.zeros(chain.equations) if multipliers is None else multipliers
        sizes = largest_of(np.abs(unknowns), chain.unknown_kinds)[chain.unknown_kinds]
        with self._verification.lend() as evaluate:
            values = evaluate(unknowns, data, np.ones(1), given, sizes)
        cost, of_changes, equations, action, *terms, slope, hamiltonian, arriving = values
        # The terms of a component at rest are only roundoff of its slopes, which is measured by the sizes of the terms
        # that cancel in the slopes.  The sizes of other components do not include these.
        moving, canceled = (largest_of(sizes, chain.kinds) for sizes in terms)
        at_rest = np.isfinite(canceled) & (moving <= ROUNDOFF_ONLY * canceled)
        sizes = np.fmax(moving, canceled)
        sizes[chain.motions] = np.where(at_rest, canceled, moving)[chain.motions]
        arriving = arriving.reshape(-1, chain.dimension).T
        size = max(abs(cost.item()), LEAST_COST * of_changes.item())
        return Report(cost.item(), size, action.item(), equations, sizes, slope, hamiltonian, arriving)


def _split(stacked: ca.MX, places: Sequence[PlaceLayout]) -> list[ca.MX]:
    """Cut a long vector into one matrix for each kind of place."""
    parts = ca.vertsplit(stacked, [0, *(place.last for place in places)])
    return [ca.reshape(part, place.width, place.count) for part, place in zip(parts, places, strict=True)]
