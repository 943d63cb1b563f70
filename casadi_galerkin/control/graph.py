"""The optimization's functions and exact derivatives, as CasADi graphs; nothing is differentiated through them.

With A, Ê, Θ and Λ of the `ChainEmbedding`, and at every place z_k the cost c_k and the rows e_k of `pointwise`,

    cost        f  = Σ w_k c_k                    ∇f = Êᵀ [w_k ∇c_k]
    equations   G  = Θ [e_k] + Λ ξ                ∇G = Θ blockdiag(∇e_k) Ê + Λ
    Lagrangian  f̄  = φ f + λ·G                    ∇²f̄ = Êᵀ blockdiag(∇²[φ w_k c_k + e_k·(Θᵀλ)_k]) Ê

The multipliers λ are a discrete path, and (Θᵀλ)_k = w_k (δx, δx') is its embedding at the point, weighted.  Everything
except the pointwise functions is cached for problems with the same chain, see `assembly`.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.roundoff import largest_of
from casadi_galerkin.control import assembly
from casadi_galerkin.control.chain import Chain
from casadi_galerkin.control.pointwise import pointwise_terms
from casadi_galerkin.functional.buffers import Evaluator, ObjectPool
from casadi_galerkin.functional.mapping import PointMap
from casadi_galerkin.problems.control_problem import ControlProblem

RESTING = 1e-13  # ratio of the two sizes of an equation of motion below which its terms are roundoff only


@dataclass(frozen=True)
class Report:
    """Values and sizes at a point of the program.

    Attributes
    ----------
    cost, action : f, and the discrete action of the Lagrangian alone
    equations, sizes : G, and for every kind of equation the largest sum of the sizes of the terms of one
    slope : ∇f̄ without the multipliers of the bounds
    hamiltonian : (N,), mean over each interval; without multipliers that of the cost alone
    arriving : (d, K), derivatives by x before the crossings of the terms of f̄ there
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
    terms : PointwiseTerms of all kinds of places
    inputs : MX expressions A ξ, the inputs at all kinds of places
    """

    def __init__(self, problem: ControlProblem, chain: Chain, mapping: PointMap) -> None:
        self.chain, self.embedding = chain, assembly.matrices(chain)
        self.terms = pointwise_terms(problem, self.embedding, mapping)
        self.unknowns, self.data = assembly.symbols(chain)
        self.inputs: list[ca.MX] = assembly.embedding(chain).call([self.unknowns, self.data])
        self.cost = assembly.summation(chain)(*self._of_costs("value"))
        self.equations = assembly.equations(chain)(self.unknowns, *self._rows)

    def _evaluate(self, name: str, *arguments: list[ca.MX]) -> list[ca.MX]:
        """Evaluate one pointwise Function at all kinds of places."""
        return [getattr(place, name)(*given) for place, *given in zip(self.terms, *arguments, strict=True)]

    def _of_costs(self, name: str) -> list[ca.MX]:
        """Evaluate one pointwise Function at the kinds of places with costs."""
        return [getattr(self.terms[k], name)(self.inputs[k]) for k in self.embedding.with_costs]

    @cached_property
    def _rows(self) -> list[ca.MX]:
        """[e_k]."""
        return self._evaluate("equations", self.inputs)

    @cached_property
    def _gradients(self) -> list[ca.MX]:
        """∇c_k at the kinds of places with costs."""
        return self._of_costs("gradient")

    @cached_property
    def _derivatives(self) -> list[ca.MX]:
        """Nonzeros of ∇e_k."""
        return self._evaluate("jacobian", self.inputs)

    @cached_property
    def _patterns(self) -> tuple[assembly.Pattern, ...]:
        """Patterns of ∇e_k."""
        return tuple(assembly.pattern_of(place.derivatives) for place in self.terms)

    def _function(self, name: str, outputs: list[ca.MX], *extra: ca.MX) -> ca.Function:
        """A Function of (unknowns, data, ...); some have names under which fatrop looks for them."""
        return ca.Function(name, [self.unknowns, self.data, *extra], outputs)

    @cached_property
    def gradient(self) -> ca.Function:
        """(unknowns, data) -> f, ∇f."""
        return self._function("gradient", [self.cost, assembly.gradient(self.chain)(*self._gradients)])

    @cached_property
    def jacobian(self) -> ca.Function:
        """(unknowns, data) -> G, ∇G."""
        matrix = assembly.jacobian(self.chain, self._patterns)(*self._derivatives)
        return self._function("nlp_jac_g", [self.equations, matrix])

    @cached_property
    def _lagrangian(self) -> tuple[ca.MX, ca.MX, tuple[list[ca.MX], ...], ca.MX]:
        """Symbols φ and λ, the arguments of the pointwise derivatives of f̄, and Λᵀλ."""
        factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", self.chain.equations)
        *at_places, linear = assembly.multiplication(self.chain).call([factor, multipliers])
        count = len(self.terms)
        return factor, multipliers, (self.inputs, at_places[:count], at_places[count:]), linear

    @cached_property
    def _upper_hessian(self) -> ca.MX:
        """Upper half of ∇²f̄."""
        patterns = tuple(assembly.pattern_of(place.second_derivatives) for place in self.terms)
        return assembly.hessian(self.chain, patterns)(*self._evaluate("hessian", *self._lagrangian[2]))

    @cached_property
    def hessian(self) -> ca.Function:
        """(unknowns, data, φ, λ) -> upper half of ∇²f̄."""
        return self._function("hessian", [self._upper_hessian], *self._lagrangian[:2])

    @cached_property
    def whole_hessian(self) -> ca.Function:
        """(unknowns, data, φ, λ) -> ∇f̄, ∇²f̄."""
        factor, multipliers, given, linear = self._lagrangian
        slope = assembly.slope(self.chain)(*self._evaluate("lagrangian_gradient", *given), linear)
        return self._function("nlp_hess_l", [slope, ca.triu2symm(self._upper_hessian)], factor, multipliers)

    @cached_property
    def _verification(self) -> ObjectPool[Evaluator]:
        """(unknowns, data, φ, λ) -> the arrays of a `Report`."""
        chain, (factor, multipliers, (at, weights, local_multipliers), linear) = self.chain, self._lagrangian
        part = int(self.embedding.points.row("part")[0, 0])
        at_points = at[0], *self.terms[0].action_and_derivative(part)(at[0], weights[0], local_multipliers[0])
        at_places = *self._gradients, *self._rows, *self._derivatives, *local_multipliers
        given = [self.unknowns, self.data, *at_points, *at_places, linear]
        values = assembly.verification(chain, self._patterns).call(given)
        crossings = list(zip(self.terms, at, weights, local_multipliers, strict=True))[len(at) - len(chain.crossed) :]
        arriving = ca.densify(ca.veccat(*(place.lagrangian_gradient(*z)[: chain.dimension] for place, *z in crossings)))
        outputs = [self.cost, self.equations, *values, arriving]
        verification = self._function("verification", outputs, factor, multipliers)
        return ObjectPool(lambda: Evaluator(verification))

    def report(self, unknowns: np.ndarray, data: np.ndarray, multipliers: np.ndarray | None = None) -> Report:
        """Evaluate the `Report` of a point."""
        chain = self.chain
        given = np.zeros(chain.equations) if multipliers is None else multipliers
        with self._verification.lend() as evaluate:
            cost, equations, action, *terms, slope, hamiltonian, arriving = evaluate(unknowns, data, np.ones(1), given)
        # The terms of a component at rest are only roundoff of its slopes, which is measured by the sizes of the terms
        # that cancel in the slopes.  The sizes of other components do not include these.
        moving, canceled = (largest_of(sizes, chain.kinds) for sizes in terms)
        resting = np.isfinite(canceled) & (moving <= RESTING * canceled)
        sizes = np.fmax(moving, canceled)
        sizes[chain.motions] = np.where(resting, canceled, moving)[chain.motions]
        arriving = arriving.reshape(-1, chain.dimension).T
        return Report(cost.item(), action.item(), equations, sizes, slope, hamiltonian, arriving)
