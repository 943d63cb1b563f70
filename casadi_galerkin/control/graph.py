"""The optimization's functions and exact derivatives, as CasADi graphs; nothing is differentiated through them.

With A, Ê, Θ and Λ of the `ChainEmbedding`, and at every place z_k the cost c_k and the rows e_k of `pointwise`,

    cost        f  = Σ w_k c_k                    ∇f = Êᵀ [w_k ∇c_k]
    equations   G  = Θ [e_k] + Λ ξ                ∇G = Θ blockdiag(∇e_k) Ê + Λ
    Lagrangian  f̄  = φ f + λ·G                    ∇²f̄ = Êᵀ blockdiag(∇²[φ w_k c_k + e_k·(Θᵀλ)_k]) Ê

The multipliers λ are a discrete path: (Θᵀλ)_k = w_k (δx, δx') is its embedding at the point, weighted.  All but the
pointwise functions is kept for the next problem with the same chain, see `assembly`.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.control import assembly
from casadi_galerkin.control.chain import Chain
from casadi_galerkin.control.pointwise import places
from casadi_galerkin.functional.buffers import Evaluator, ObjectPool
from casadi_galerkin.functional.mapping import PointMap
from casadi_galerkin.problems.control_problem import ControlProblem

RESTING = 1e-13  # terms of motion below this part of what cancels in them are its roundoff


@dataclass(frozen=True)
class Report:
    """Values and sizes at a point of the program.

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
        self.chain, self.embedding = chain, assembly.matrices(chain)
        self.places = places(problem, self.embedding, mapping)
        self.unknowns, self.data = assembly.symbols(chain)
        self.at: list[ca.MX] = assembly.embedding(chain).call([self.unknowns, self.data])
        self.cost = assembly.summation(chain)(*self._of_costs("value"))
        self.equations = assembly.equations(chain)(self.unknowns, *self._rows)

    def _evaluate(self, name: str, *arguments: list[ca.MX]) -> list[ca.MX]:
        """Evaluate one pointwise Function at all kinds of places."""
        return [getattr(place, name)(*given) for place, *given in zip(self.places, *arguments, strict=True)]

    def _of_costs(self, name: str) -> list[ca.MX]:
        """Evaluate one pointwise Function at the kinds of places with costs."""
        return [getattr(self.places[k], name)(self.at[k]) for k in self.embedding.with_costs]

    @cached_property
    def _rows(self) -> list[ca.MX]:
        """[e_k]."""
        return self._evaluate("equations", self.at)

    @cached_property
    def _gradients(self) -> list[ca.MX]:
        """∇c_k at the kinds of places with costs."""
        return self._of_costs("gradient")

    @cached_property
    def _derivatives(self) -> list[ca.MX]:
        """Nonzeros of ∇e_k."""
        return self._evaluate("jacobian", self.at)

    @cached_property
    def _patterns(self) -> tuple[assembly.Pattern, ...]:
        """Patterns of ∇e_k."""
        return tuple(place.jacobian_pattern for place in self.places)

    def _function(self, name: str, outputs: list[ca.MX], *extra: ca.MX) -> ca.Function:
        """A Function of (unknowns, data, ...); some have the names that the cache of fatrop has for them."""
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
        """Symbols φ and λ, what the pointwise derivatives of f̄ are evaluated at, and Λᵀλ."""
        factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", self.chain.equations)
        *at_places, linear = assembly.multiplication(self.chain).call([factor, multipliers])
        count = len(self.places)
        return factor, multipliers, (self.at, at_places[:count], at_places[count:]), linear

    @cached_property
    def _upper_hessian(self) -> ca.MX:
        """Upper half of ∇²f̄."""
        patterns = tuple(place.hessian_pattern for place in self.places)
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
        """(unknowns, data, φ, λ) -> all that is told of a point."""
        chain, (factor, multipliers, (at, weights, along), linear) = self.chain, self._lagrangian
        part = int(self.embedding.points.row("part")[0, 0])
        at_points = at[0], *self.places[0].action_and_derivative(part)(at[0], weights[0], along[0])
        at_places = *self._gradients, *self._rows, *self._derivatives, *along
        given = [self.unknowns, self.data, *at_points, *at_places, linear]
        told = assembly.verification(chain, self._patterns).call(given)
        crossings = list(zip(self.places, at, weights, along, strict=True))[len(along) - len(chain.crossed) :]
        arriving = ca.densify(ca.veccat(*(place.lagrangian_gradient(*z)[: chain.dimension] for place, *z in crossings)))
        outputs = [self.cost, self.equations, *told, arriving]
        verification = self._function("verification", outputs, factor, multipliers)
        return ObjectPool(lambda: Evaluator(verification))

    def report(self, unknowns: np.ndarray, data: np.ndarray, multipliers: np.ndarray | None = None) -> Report:
        """Evaluate the `Report` of a point."""
        chain = self.chain
        given = np.zeros(chain.equations) if multipliers is None else multipliers
        with self._verification.lend() as evaluate:
            cost, equations, action, *terms, slope, hamiltonian, arriving = evaluate(unknowns, data, np.ones(1), given)
        # The terms of a component that stands still are roundoff of its slopes: what cancels in the slopes measures it.
        # Those of another are measured without it.
        moving, canceled = map(chain.largest, terms)
        resting = np.isfinite(canceled) & (moving <= RESTING * canceled)
        sizes = np.fmax(moving, canceled)
        sizes[chain.motions] = np.where(resting, canceled, moving)[chain.motions]
        arriving = arriving.reshape(-1, chain.dimension).T
        return Report(cost.item(), action.item(), equations, sizes, slope, hamiltonian, arriving)
