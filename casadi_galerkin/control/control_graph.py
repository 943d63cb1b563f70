"""Cost, equations and their exact derivatives as CasADi graphs: embed, evaluate pointwise, integrate.

With A, Θ and Λ of `control_places`, Ê the rows of A whose inputs depend on unknowns and the columns of the unknowns,
and at every place z_k the cost c_k and the rows e_k,

    cost        f  = Σ w_k c_k                    ∇f = Êᵀ [w_k ∇c_k]
    equations   G  = Θ [e_k] + Λ y                ∇G = Θ blockdiag(∇e_k) Ê + Λ
    Lagrangian  f̄  = φ f + λ·G                    ∇²f̄ = Êᵀ blockdiag(∇²[φ w_k c_k + e_k·(Θᵀλ)_k]) Ê

The y are the unknowns in ξ.  The multipliers λ of the equations of motion are a discrete path, and (Θᵀλ)_k = w_k (δx,
δx') is its embedding at the point, weighted.  The inputs, or the outputs, at all places of one kind are one matrix with
a column for every place.

A violation is relative to what is compared: the terms of an equation, or the largest value of a bounded kind, in which
rounding `EPS` is never a violation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.roundoff import EPS, largest_of, or_one
from casadi_galerkin.control.control_numbering import Chain, Field, Numbering, ProgramBounds
from casadi_galerkin.control.control_places import all_places, linear
from casadi_galerkin.functional.buffers import Evaluator
from casadi_galerkin.functional.pointwise import PointMap, one_by_one
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.phases import Phases, parted, times_free
from casadi_galerkin.problems.statements import FEASIBLE, bound_excess

# part of the cost of a change as large as the path itself above which the cost measures its own errors: the cost of a
# path that follows a curve exactly is that of its errors, which falls with any mesh
LEAST_COST = 1e-6


VANISHED = 1e3 * EPS  # terms below which they are rounding: over those that cancel in them, or along the guess
LEAST_SIZE = EPS / FEASIBLE  # size of terms, over that of what they are part of, from which their rounding is feasible


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
    matrix : A
    """

    def __init__(
        self, problem: ControlProblem | Phases, method: Galerkin, mesh: np.ndarray, mapping: PointMap = one_by_one
    ) -> None:
        parts = parted(problem)
        phases, self.joins = parts.phases, parts.joins
        free = len(phases) > 1 and times_free(phases)
        chains = [Chain(phase, method, one, free) for phase, one in zip(phases, meshes_of(phases, mesh), strict=True)]
        ends = np.cumsum([len(chain.unknown_stages) for chain in chains])
        fields = [
            Field(f"join {i}", join.words, f"join {i}", range(join.rows), float(ends[join.after] - 1 - ends[-1]))
            for i, join in enumerate(self.joins.each)
        ]
        numbering = self.numbering = Numbering(chains, fields, parts.whole is not None)
        self.places, self.matrix, self._test = all_places(phases, self.joins, numbering, mapping)
        self._linear, count = linear(numbering), numbering.unknowns
        self.unknowns, self.data = ca.MX.sym("unknowns", count), ca.MX.sym("data", numbering.size - count)
        self._everything = ca.vertcat(self.unknowns, self.data)
        widths = [place.terms.z.numel() for place in self.places]
        self._inputs = [[z] for z in self._split(ca.mtimes(self.matrix, self._everything), widths)]
        self._costs = self._weighted(self._evaluate("cost", self._inputs))
        self.cost = ca.densify(ca.sum2(ca.horzcat(*self._costs)))
        self._rows = ca.veccat(*self._evaluate("rows", self._inputs))
        self.equations = ca.densify(ca.mtimes(self._test.T, self._rows) + ca.mtimes(self._linear, self.unknowns))

    def _split(self, stacked: ca.MX, widths: Sequence[int]) -> list[ca.MX]:
        """Cut a long vector into one matrix for each kind of place."""
        sizes = [place.count * width for place, width in zip(self.places, widths, strict=True)]
        given = zip(ca.vertsplit(stacked, np.cumsum([0, *sizes]).tolist()), widths, self.places, strict=True)
        return [ca.reshape(part, width, place.count) for part, width, place in given]

    def _evaluate(self, name: str, arguments: list[list[ca.MX]]) -> list[ca.MX]:
        """Evaluate one pointwise expression at all kinds of places."""
        return [place.evaluate(name, *given) for place, given in zip(self.places, arguments, strict=True)]

    def _weighted(self, values: list[ca.MX]) -> list[ca.MX]:
        """Values at all kinds of places, those at quadrature points with their weights."""
        given = zip(values, self.places, strict=True)
        return [value * ca.MX(ca.repmat(place.weights, value.shape[0], 1)) for value, place in given]

    def _active(self, values: list[ca.MX]) -> ca.MX:
        """What belongs to inputs that depend on unknowns, of what belongs to all inputs."""
        given = zip(values, self.places, strict=True)
        return ca.veccat(*(value[place.terms.active.tolist(), :] for value, place in given))

    def _blocks(self, name: str, arguments: list[list[ca.MX]]) -> ca.MX:
        """Blockdiag(·) of one matrix per place."""
        blocks = [pattern for place in self.places for pattern in [getattr(place.terms, name).sparsity()] * place.count]
        return ca.MX(ca.diagcat(*blocks), ca.veccat(*self._evaluate(name, arguments)))

    @cached_property
    def _differentiated(self) -> ca.DM:
        """Rows of A of the inputs that depend on unknowns."""
        numbers = np.arange(self.matrix.shape[0])
        rows = [numbers[p.rows].reshape(p.count, -1)[:, p.terms.active].ravel() for p in self.places]
        return self.matrix[np.concatenate(rows).tolist(), :]

    @cached_property
    def _derivative(self) -> ca.DM:
        """Ê: inputs that depend on unknowns x unknowns."""
        return self._differentiated[:, : self.numbering.unknowns]

    @cached_property
    def _cost_gradients(self) -> ca.MX:
        """[w_k ∇c_k], structurally zero at places without costs."""
        return ca.veccat(*self._weighted(self._evaluate("cost_gradient", self._inputs)))

    @cached_property
    def _derivatives(self) -> ca.MX:
        """Blockdiag(∇e_k)."""
        return self._blocks("jacobian", self._inputs)

    def _function(self, name: str, outputs: list[ca.MX], *extra: ca.MX) -> ca.Function:
        """A Function of (unknowns, data, ...); some have names under which fatrop looks for them."""
        return ca.Function(name, [self.unknowns, self.data, *extra], outputs)

    @cached_property
    def gradient(self) -> ca.Function:
        """(unknowns, data) -> f, ∇f."""
        return self._function("gradient", [self.cost, ca.densify(ca.mtimes(self._derivative.T, self._cost_gradients))])

    @cached_property
    def jacobian(self) -> ca.Function:
        """(unknowns, data) -> G, ∇G."""
        matrix = ca.mtimes(self._test.T, ca.mtimes(self._derivatives, self._derivative)) + self._linear
        return self._function("nlp_jac_g", [self.equations, matrix])

    @cached_property
    def _multipliers(self) -> list[ca.MX]:
        """Symbols φ and λ."""
        return [ca.MX.sym("factor"), ca.MX.sym("multipliers", self.numbering.equations)]

    @cached_property
    def _at_places(self) -> list[list[ca.MX]]:
        """The arguments of the pointwise derivatives of f̄: inputs, φ w_k and (Θᵀλ)_k."""
        factor, multipliers = self._multipliers
        local = self._split(ca.mtimes(self._test, multipliers), [place.terms.rows.numel() for place in self.places])
        return [[*z, factor * ca.MX(p.weights), mu] for z, p, mu in zip(self._inputs, self.places, local, strict=True)]

    @cached_property
    def _upper_hessian(self) -> ca.MX:
        """Upper half of ∇²f̄."""
        left = ca.MX(self._derivative.T)
        right = ca.mtimes(self._blocks("hessian", self._at_places), self._derivative)
        return ca.mac(left, right, ca.MX.zeros(ca.triu(ca.mtimes(left.sparsity(), right.sparsity()))))

    @cached_property
    def hessian(self) -> ca.Function:
        """(unknowns, data, φ, λ) -> upper half of ∇²f̄."""
        return self._function("hessian", [self._upper_hessian], *self._multipliers)

    def _slope(self, gradients: list[ca.MX]) -> ca.MX:
        """∇f̄, from its gradients at the places."""
        linear = ca.mtimes(self._linear.T, self._multipliers[1])
        return ca.densify(ca.mtimes(self._derivative.T, self._active(gradients)) + linear)

    @cached_property
    def whole_hessian(self) -> ca.Function:
        """(unknowns, data, φ, λ) -> ∇f̄, ∇²f̄."""
        slope = self._slope(self._evaluate("gradient", self._at_places))
        return self._function("nlp_hess_l", [slope, ca.triu2symm(self._upper_hessian)], *self._multipliers)

    @cached_property
    def _verification(self) -> Evaluator:
        """(unknowns, data, φ, λ, sizes of the unknowns) -> the arrays of a `Report`.

        Two sizes of every equation are among them: the sum of the sizes of its terms, and the sum of the sizes of the
        terms of these, Σ |∂e/∂z| |z|, which may cancel.
        """
        test, sizes = ca.fabs(self._test.T), ca.MX.sym("sizes", self.numbering.unknowns)
        others = ca.mtimes(ca.fabs(self._linear), sizes)
        magnitudes = ca.mtimes(ca.fabs(self._differentiated), ca.vertcat(sizes, ca.fabs(self.data)))
        canceled = ca.mtimes(ca.fabs(self._derivatives), magnitudes)
        changes = self._active([z - ca.repmat(ca.sum2(z) / z.shape[1], 1, z.shape[1]) for (z,) in self._inputs])
        curvature = [[z, place.weights, 0 * mu] for (z, _, mu), place in zip(self._at_places, self.places, strict=True)]
        of_changes = ca.bilin(ca.fabs(self._blocks("hessian", curvature)), *[ca.fabs(changes)] * 2) / 2
        gradients = self._evaluate("gradient", self._at_places)
        starts = np.concatenate([chain.fields["x"][0, chain.mechanical :] for chain in self.numbering.chains])
        points = [i for i, place in enumerate(self.places) if place.integrated]
        costs, actions, hamiltonians = list[ca.MX](), list[ca.MX](), list[ca.MX]()
        for chain, first, last in zip(self.numbering.chains, points, [*points[1:], None], strict=True):
            place, (z,) = self.places[first], self._inputs[first]
            costs.append(ca.sum2(ca.horzcat(*self._costs[first : last if last or len(points) == 1 else -1])))
            actions.append(ca.sum2(place.evaluate("action", z) * place.weights))
            step = z[place.names["duration"], :]
            by_step = gradients[first][place.names["part"], :]
            hamiltonians.append(ca.sum1(ca.reshape(by_step / step, -1, chain.intervals)).T)
        at_points = [g * float(place.integrated) for g, place in zip(gradients, self.places, strict=True)]
        outputs = [
            self.cost,
            of_changes,
            ca.vertcat(*costs),
            ca.vertcat(*actions),
            self.equations,
            ca.mtimes(test, ca.fabs(self._rows)) + others,
            ca.mtimes(test, canceled) + others,
            self._slope(gradients),
            ca.vertcat(*hamiltonians),
            ca.mtimes(self._derivative[:, starts.tolist()].T, self._active(at_points)),
        ]
        extra = [*self._multipliers, sizes]
        return Evaluator(self._function("verification", [*map(ca.densify, outputs)], *extra))

    def report(self, unknowns: np.ndarray, data: np.ndarray, multipliers: np.ndarray | None = None) -> Report:
        """Evaluate the `Report` of a point.

        The sizes of the unknowns are the largest of their kind: an end or a waypoint may be where the path is at zero.
        """
        numbers = self.numbering
        given = np.zeros(numbers.equations) if multipliers is None else multipliers
        sizes = largest_of(np.abs(unknowns), numbers.unknown_kinds)[numbers.unknown_kinds]
        cost, of_changes, *arrays = self._verification(unknowns, data, np.ones(1), given, sizes)
        costs, actions, equations, *terms, slope, hamiltonian, starts = arrays
        # The terms of a component at rest are only roundoff of its slopes, which is measured by the sizes of the terms
        # that cancel in the slopes.  The sizes of other components do not include these.
        moving, canceled = (largest_of(sizes, numbers.kinds) for sizes in terms)
        at_rest = np.isfinite(canceled) & (moving <= VANISHED * canceled)
        sizes = np.fmax(moving, canceled)
        for chain in numbers.chains:
            sizes[chain.motions] = np.where(at_rest, canceled, moving)[chain.motions]
        size = max(abs(cost.item()), LEAST_COST * of_changes.item())
        return Report(cost.item(), size, costs, actions, equations, sizes, slope, hamiltonian, starts)


def meshes_of(phases: Sequence[ControlProblem], mesh: np.ndarray) -> list[np.ndarray]:
    """The joints of every phase, of those of the whole."""
    cuts = np.searchsorted(mesh, [phase.t_span[1] for phase in phases]).tolist()
    return [mesh[first : last + 1] for first, last in pairwise([0, *cuts])]


def equation_scales(numbering: Numbering, bounds: ProgramBounds, report: Report, before: np.ndarray) -> np.ndarray:
    """Sizes of the terms of the equations, to which their residuals are relative; (equations,).

    For the equations of motion of a component it is the largest sum of the sizes of the terms of one of them along the
    path; for a path constraint or an end condition g it is |∇g||z|, or its finite bound if that is larger.  Where these
    terms are only rounding of those along the guess (`before`, by kind), it is the latter.  All are at least a rounding
    of a rounding, for a rate a rounding of its given positions.
    """
    least, stated = np.full(len(before), LEAST_SIZE), largest_of(_finite_sizes(bounds.equations), numbering.kinds)
    for chain in numbering.chains:
        given = np.max(_finite_sizes(bounds.unknowns)[chain.fields["x"][:, chain.mechanical :]], axis=0)
        least[chain.rated] = np.fmax(least[chain.rated], np.minimum(or_one(given), 1.0))
    sizes = np.where(report.sizes <= VANISHED * before, before, report.sizes)
    return or_one(np.fmax(np.fmax(sizes, stated), LEAST_SIZE * least))[numbering.kinds]


def violations(
    numbering: Numbering, bounds: ProgramBounds, unknowns: np.ndarray, equations: np.ndarray, scales: np.ndarray
) -> np.ndarray:
    """Violation of every equation, relative to its scale, then of every unknown's bounds, relative to its kind's size.

    A value outside its bounds is not compared with itself: where an equation and a bound leave a single value, IPOPT
    moves the bound by rounding, and a value that should be zero is then as large as this shift.
    """
    kinds, stated = numbering.unknown_kinds, or_one(_finite_sizes(bounds.unknowns))
    sizes = np.maximum(largest_of(np.abs(unknowns), kinds), LEAST_SIZE * largest_of(stated, kinds))[kinds]
    return np.concatenate((_excess(equations, *bounds.equations) / scales, _excess(unknowns, *bounds.unknowns) / sizes))


def _finite_sizes(sides: np.ndarray) -> np.ndarray:
    """Larger sizes of the finite ones of lower and upper bounds (2, n); zero where there is none."""
    return np.max(np.where(np.isfinite(sides), np.abs(sides), 0.0), axis=0)


def _excess(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Distances of values from their bounds; infinite where the values are not finite."""
    return np.where(np.isfinite(values), bound_excess(values, low, high), np.inf)
