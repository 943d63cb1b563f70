"""Cost, equations and their exact derivatives as CasADi graphs, assembled from pointwise derivatives.

With A, Ê, Θ and Λ of the `Embedding`, and at every place z_k the cost c_k and the rows e_k of `control_terms`,

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
from itertools import pairwise

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.roundoff import largest_of
from casadi_galerkin.control.control_embedding import Embedding, PlaceLayout
from casadi_galerkin.control.control_numbering import Chain, Field, Numbering
from casadi_galerkin.control.control_terms import all_places
from casadi_galerkin.functional.buffers import Evaluator, ObjectPool
from casadi_galerkin.functional.mapping import PointMap, one_by_one
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.phases import Phases, joined_sections, sections, times_free

ROUNDOFF_ONLY = 1e-13  # ratio of the two sizes of an equation of motion below which its terms are roundoff only
# part of the cost of a change as large as the path itself above which the cost measures its own errors: the cost of a
# path that follows a curve exactly is that of its errors, which falls with any mesh
LEAST_COST = 1e-6


@dataclass(frozen=True)
class Report:
    """Values and sizes at a point of the program.

    Attributes
    ----------
    cost : f
    costs, actions : (phases,), parts of f, and the discrete actions of the Lagrangians alone
    cost_size : size of f or, where that is larger, `LEAST_COST` times that of the terms of its second variation for the
        changes of all values along the path
    equations, sizes : G, and for every kind of equation the largest sum of the sizes of the terms of one
    slope : ∇f̄ without the multipliers of the bounds
    hamiltonian : mean over each interval of all phases; without multipliers that of the cost alone
    starts : derivatives of the terms of f̄ at the quadrature points by what follows rates at the starts of all phases
    """

    cost: float
    cost_size: float
    costs: np.ndarray
    actions: np.ndarray
    equations: np.ndarray
    sizes: np.ndarray
    slope: np.ndarray
    hamiltonian: np.ndarray
    starts: np.ndarray


class ControlGraph:
    """The nonlinear program of control problems as Functions of (unknowns, data).

    Parameters
    ----------
    problem : ControlProblem or Phases
    method : Galerkin
    mesh : (N + 1,)
    mapping : how L, cost and forces are evaluated at the points, as for `Functional`

    Attributes
    ----------
    joins : what joins the phases
    numbering : Numbering
    unknowns, data : MX symbols
    cost, equations : MX expressions f and G
    places : Places of all kinds
    inputs : MX expressions A ξ, the inputs at all kinds of places
    """

    def __init__(
        self, problem: ControlProblem | Phases, method: Galerkin, mesh: np.ndarray, mapping: PointMap = one_by_one
    ) -> None:
        phases, several = phases_of(problem), isinstance(problem, Phases)
        self.joins = problem.joins if isinstance(problem, Phases) else joined_sections(problem, phases)
        free = len(phases) > 1 and times_free(phases)
        chains = [Chain(phase, method, one, free) for phase, one in zip(phases, meshes_of(phases, mesh), strict=True)]
        ends = np.cumsum([len(chain.unknown_stages) for chain in chains])
        fields = [
            Field(f"join {i}", join.words, f"join {i}", range(join.rows), float(ends[join.after] - 1 - ends[-1]))
            for i, join in enumerate(self.joins.each)
        ]
        numbering = self.numbering = Numbering(chains, fields, not several)
        made = self.embedding = Embedding(numbering)
        count, self.places = numbering.unknowns, all_places(phases, self.joins, made, mapping)
        self.unknowns, self.data = ca.MX.sym("unknowns", count), ca.MX.sym("data", numbering.size - count)
        self._everything = ca.vertcat(self.unknowns, self.data)
        self.inputs = _split(ca.mtimes(made.matrix, self._everything), made.inputs)
        rule = ca.DM(numbering.chains[0].method.element.weights).T
        counts = {place.count for place in self.places if place.integrated}
        every = {count: ca.MX(ca.repmat(rule, 1, count // rule.numel())) for count in counts}
        self._weights = [every[place.count] if place.integrated else 1.0 for place in self.places]
        self._costs = self._weighted(self._evaluate("value", self.inputs))
        self.cost = ca.densify(ca.sum2(ca.horzcat(*self._costs)))
        self._rows = self._evaluate("equations", self.inputs)
        summed = ca.mtimes(made.test.T, ca.veccat(*self._rows)) + ca.mtimes(made.linear, self.unknowns)
        self.equations = ca.densify(summed)

    def _evaluate(self, name: str, *arguments: list[ca.MX]) -> list[ca.MX]:
        """Evaluate one pointwise Function at all kinds of places."""
        given = zip(self.places, *arguments, strict=True)
        return [place.evaluate(getattr(place.terms, name), *arrays) for place, *arrays in given]

    def _weighted(self, values: list[ca.MX]) -> list[ca.MX]:
        """Values at all kinds of places, those at quadrature points with their weights."""
        return [value * weight for value, weight in zip(values, self._weights, strict=True)]

    def _blocks(self, patterns: list[ca.Sparsity], entries: list[ca.MX]) -> ca.MX:
        """Blockdiag(·) of one matrix per place, from their nonzeros at all kinds of places."""
        kinds = zip(patterns, self.embedding.inputs, strict=True)
        blocks = [block for pattern, place in kinds for block in [pattern] * place.count]
        return ca.MX(ca.diagcat(*blocks), ca.veccat(*entries))

    @cached_property
    def _gradients(self) -> ca.MX:
        """[w_k ∇c_k], structurally zero at places without costs."""
        gradients = zip(self.places, self._evaluate("gradient", self.inputs), self._weights, strict=True)
        return ca.veccat(*(g * ca.repmat(w, g.size1(), 1) if place.integrated else g for place, g, w in gradients))

    @cached_property
    def _derivatives(self) -> ca.MX:
        """Blockdiag(∇e_k)."""
        patterns = [place.terms.derivatives.sparsity() for place in self.places]
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
        made, factor = self.embedding, ca.MX.sym("factor")
        multipliers = ca.MX.sym("multipliers", self.numbering.equations)
        weights = [factor * weight for weight in self._weights]
        local_multipliers = _split(ca.mtimes(made.test, multipliers), made.outputs)
        return factor, multipliers, (self.inputs, weights, local_multipliers), ca.mtimes(made.linear.T, multipliers)

    @cached_property
    def _upper_hessian(self) -> ca.MX:
        """Upper half of ∇²f̄."""
        patterns = [place.terms.second_derivatives.sparsity() for place in self.places]
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
        made, (factor, multipliers, given, linear) = self.embedding, self._lagrangian
        local_multipliers = given[2]
        test, sizes = ca.fabs(made.test.T), ca.MX.sym("sizes", self.numbering.unknowns)
        others = ca.mtimes(ca.fabs(made.linear), sizes)
        magnitudes = ca.mtimes(ca.fabs(made.differentiated), ca.vertcat(sizes, ca.fabs(self.data)))
        canceled = ca.mtimes(ca.fabs(self._derivatives), magnitudes)
        starts = np.concatenate([chain.fields["x"][0, chain.mechanical :] for chain in self.numbering.chains])
        at_points = [np.full(place.count * len(place.terms.active), float(place.integrated)) for place in self.places]
        slopes = self._gradients + ca.mtimes(self._derivatives.T, ca.veccat(*local_multipliers))
        active = [z[place.terms.active.tolist(), :] for place, z in zip(self.places, self.inputs, strict=True)]
        changes = [z - ca.repmat(ca.sum2(z) / z.shape[1], 1, z.shape[1]) for z in active]
        costs, actions, hamiltonians, at_places = (
            list[ca.MX](),
            list[ca.MX](),
            list[ca.MX](),
            [*zip(*given, strict=True)],
        )
        for phase in made.phases:
            i = made.inputs.index(phase.points)
            part, duration = (int(phase.points.row(name)[0, 0] - phase.points.first) for name in ("part", "duration"))
            function = self.places[i].terms.action_and_derivative(part)
            action, by_step = self.places[i].evaluate(function, *at_places[i])
            costs.append(ca.sum2(ca.horzcat(*self._costs[i : i + len(phase.inputs)])))
            actions.append(ca.sum2(self._weights[i] * action))
            step = self.inputs[i][duration, :]
            hamiltonians.append(ca.sum1(ca.reshape(by_step / step, -1, phase.chain.intervals)).T)
        outputs = [
            self.cost,
            ca.sum2(ca.horzcat(*self._weighted(self._evaluate("cost_terms", self.inputs, changes)))),
            ca.vertcat(*costs),
            ca.vertcat(*actions),
            self.equations,
            ca.mtimes(test, ca.fabs(ca.veccat(*self._rows))) + others,
            ca.mtimes(test, canceled) + others,
            ca.mtimes(made.derivative.T, slopes) + linear,
            ca.vertcat(*hamiltonians),
            ca.mtimes(made.derivative[:, starts.tolist()].T, slopes * ca.DM(np.concatenate(at_points))),
        ]
        verification = self._function("verification", [*map(ca.densify, outputs)], factor, multipliers, sizes)
        return ObjectPool(lambda: Evaluator(verification))

    def report(self, unknowns: np.ndarray, data: np.ndarray, multipliers: np.ndarray | None = None) -> Report:
        """Evaluate the `Report` of a point.

        The sizes of the unknowns are the largest of their kind: an end or a waypoint may be where the path is at zero.
        """
        numbers = self.numbering
        given = np.zeros(numbers.equations) if multipliers is None else multipliers
        sizes = largest_of(np.abs(unknowns), numbers.unknown_kinds)[numbers.unknown_kinds]
        with self._verification.lend() as evaluate:
            cost, of_changes, *arrays = evaluate(unknowns, data, np.ones(1), given, sizes)
        costs, actions, equations, *terms, slope, hamiltonian, starts = arrays
        # The terms of a component at rest are only roundoff of its slopes, which is measured by the sizes of the terms
        # that cancel in the slopes.  The sizes of other components do not include these.
        moving, canceled = (largest_of(sizes, numbers.kinds) for sizes in terms)
        at_rest = np.isfinite(canceled) & (moving <= ROUNDOFF_ONLY * canceled)
        sizes = np.fmax(moving, canceled)
        for chain in numbers.chains:
            sizes[chain.motions] = np.where(at_rest, canceled, moving)[chain.motions]
        size = max(abs(cost.item()), LEAST_COST * of_changes.item())
        return Report(cost.item(), size, costs, actions, equations, sizes, slope, hamiltonian, starts)


def phases_of(problem: ControlProblem | Phases) -> Sequence[ControlProblem]:
    """The phases into which a problem is parted."""
    return problem.phases if isinstance(problem, Phases) else sections(problem)


def meshes_of(phases: Sequence[ControlProblem], mesh: np.ndarray) -> list[np.ndarray]:
    """The joints of every phase, of those of the whole."""
    cuts = np.searchsorted(mesh, [phase.t_span[1] for phase in phases]).tolist()
    return [mesh[first : last + 1] for first, last in pairwise([0, *cuts])]


def _split(stacked: ca.MX, places: Sequence[PlaceLayout]) -> list[ca.MX]:
    """Cut a long vector into one matrix for each kind of place."""
    parts = ca.vertsplit(stacked, [0, *(place.last for place in places)])
    return [ca.reshape(part, place.width, place.count) for part, place in zip(parts, places, strict=True)]
