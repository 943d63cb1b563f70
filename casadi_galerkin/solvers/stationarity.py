"""The stationarity conditions ∇S(ξ) = 0 of one discrete functional, and the three Functions that Newton's method needs.

    newton_step      ξ, data                           ->  ∇S, ∇²S; step, direction, sizes, norm
    simplified_step  ξ, data, ∇²S, step, sizes, damping               ->  simplified, length, nonlinearity
    verification     ξ, data, ∇²S, direction       ->  S, momenta, residual, regularity

In each, a Function of the functional's graph evaluates, and a Function of the `LinearSolver` solves or measures.
A `LinearSolver` serves all Lagrangians whose ∇²S has the same sparsity.  A `Stationarity` holds the functional and the
linear solver; it is immutable and may be shared.  The arrays that CasADi writes to belong to a `Linearization`, which
only one solve uses at a time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.functional.buffers import Evaluator, evaluating
from casadi_galerkin.functional.functional import Functional, Parts
from casadi_galerkin.functional.numbering import Data
from casadi_galerkin.solvers.linear_solver import METHODS, linear_solver

Built = TypeVar("Built")

ACCEPTED = 50.0  # accepted residual over its roundoff floor; correct solutions were measured at 0.01 to 5
ROUNDING_SAMPLES = 4  # number of random choices of rounding errors for an estimate of their effect


class Iterate(NamedTuple):
    """A point with its Newton step.

    Attributes
    ----------
    unknowns : ξ
    step : -∇²S⁻¹ ∇S
    sizes : sizes of the unknowns, see `Stationarity.sizes`
    norm : largest entry of the step relative to the sizes; NaN where the step is not finite
    length, step_length : lengths of path and step, see `LinearSolver.newton_step`
    matrix : nonzeros of ∇²S at the point
    """

    unknowns: np.ndarray
    step: np.ndarray
    sizes: np.ndarray
    norm: float
    length: float
    step_length: float
    matrix: np.ndarray


class Stationarity:
    """Stationarity conditions of a functional at (ξ, *data), data being (start, end, mesh[, parameters][, given]).

    Parameters
    ----------
    functional : Functional

    Attributes
    ----------
    linear_solver : LinearSolver for the functional's Hessian
    linear_methods : names of the factorizations of ∇²S: LDLᵀ, and QR where that fails; QR alone where ∂²L/∂v_i² is
        structurally zero for some i, or where ∇²S is not symmetric, as with a force
    variational : whether the conditions are those of a (constrained) minimum of an action: ∇²S is symmetric, and the
        duration is given
    """

    def __init__(self, functional: Functional) -> None:
        self.functional = functional
        self.linear_solver = linear_solver(functional)
        self.variational = functional.symmetric and not functional.numbering.free_duration
        self.linear_methods = METHODS if functional.pointwise.kinetic and functional.symmetric else METHODS[1:]
        self._kept: dict[Any, Any] = {}

    @contextmanager
    def linearization(self, linear_solver: str | None = None) -> Iterator[Linearization]:
        """A new `Linearization` for one solve, by this thread alone.

        Parameters
        ----------
        linear_solver : name of a CasADi linear solver; default `linear_methods`
        """
        with evaluating():
            yield Linearization(self, (linear_solver,) if linear_solver else self.linear_methods)

    def keep(self, key: object, build: Callable[[], Built]) -> Built:
        """What evaluates a Function, built when it is first used."""
        if key not in self._kept:
            self._kept[key] = build()
        built: Built = self._kept[key]
        return built

    @property
    def floor(self) -> ca.Function:
        """(ξ, data) -> gradient ∇S, and floor, the roundoff floor of every entry of it."""

        def parts() -> Parts:
            first, second = self.functional.first_variation, self.functional.derivatives[0]
            floor = self.linear_solver.floor(second, self.functional.u, first["terms"])[0]
            return {}, {"gradient": first["gradient"], "floor": floor}

        return self.functional.keep("floor", parts)

    def newton_step(self, method: str) -> ca.Function:
        """(ξ, data) -> outputs of `LinearSolver`'s Newton step, with ∇²S before the measures."""

        def parts() -> Parts:
            matrix, gradient, _ = self.functional.derivatives
            *outputs, measures = self._solving("newton_step", method, matrix, gradient, self.functional.u)
            return {}, dict([*outputs, ("matrix", matrix), measures])

        return self.functional.keep(f"newton_step_{method}", parts)

    def simplified_step(self, method: str) -> ca.Function:
        """(ξ, data, ∇²S, step, sizes, damping) -> outputs of `LinearSolver`'s simplified step."""

        def parts() -> Parts:
            further = self.linear_solver.symbols("matrix", "step", "sizes", "damping")
            matrix, *others = further.values()
            return further, dict(self._solving("simplified_step", method, matrix, self.functional.gradient, *others))

        return self.functional.keep(f"simplified_step_{method}", parts)

    def _solving(self, name: str, method: str, *inputs: ca.MX) -> list[tuple[str, ca.MX]]:
        """Outputs of a Function of the linear solver by name."""
        function = self.linear_solver.solving(name, method)
        return list(zip(function.name_out(), function.call(inputs), strict=True))

    @property
    def verification(self) -> ca.Function:
        """(ξ, data, ∇²S, direction) -> action, momentum, and outputs of `LinearSolver.verification`."""

        def parts() -> Parts:
            further, found = self.linear_solver.symbols("matrix", "direction"), dict(self.functional.first_variation)
            gradient, terms, (matrix, direction) = found.pop("gradient"), found.pop("terms"), further.values()
            verify = self.linear_solver.verification
            measures = verify.call([gradient, matrix, self.functional.u, terms, direction])
            return further, found | dict(zip(verify.name_out(), measures, strict=True))

        return self.functional.keep("verification", parts)

    def gradient_and_floor(self, unknowns: np.ndarray, data: Data) -> tuple[np.ndarray, np.ndarray]:
        """∇S and the roundoff floor of every entry of it, (n,) each."""
        gradient, floor = Evaluator(self.floor)(unknowns, *data)
        return gradient, floor

    def sizes_of_terms(self, unknowns: np.ndarray, data: Data) -> np.ndarray:
        """Size of the terms of every entry of ∇S, a component that is zero counting as one, by which to scale it; (n,).

        At a guess that is zero there are no terms yet.
        """
        sizes, (nonzeros,) = self.sizes(unknowns, data), Evaluator(self.functional.function("hessian"))(unknowns, *data)
        matrix = ca.DM(self.linear_solver.sparsity, nonzeros.tolist())
        changes = np.array(ca.mtimes(ca.fabs(matrix), np.where(np.isfinite(sizes), sizes, 0.0))).ravel()
        return np.fmax(self.gradient_and_floor(unknowns, data)[1] / EPS, changes)

    def sizes(self, unknowns: np.ndarray, data: Data) -> np.ndarray:
        """Size of every unknown: that of its component in the path, or one where that is zero; (n,)."""
        return np.array(self.linear_solver.sizes(joined(unknowns, data))[0]).ravel()


class Linearization:
    """The linearized conditions of one solve: ∇S and ∇²S where they were last evaluated, and what solves with them.

    Attributes
    ----------
    methods : names of the linear solvers to try, in order
    matrix : nonzeros of ∇²S where it was last evaluated, by `newton_step` or `relinearize`
    direction : near that of smallest curvature, of the last `newton_step`: a solution for a generic right-hand side
    """

    def __init__(self, stationarity: Stationarity, methods: Sequence[str]) -> None:
        self.stationarity, self.methods, self.keep = stationarity, methods, stationarity.keep
        self.matrix = self.direction = self._masses = np.empty(0)

    def evaluate(self, name: str, unknowns: np.ndarray, data: Data, *further: ArrayLike) -> list[np.ndarray]:
        """Evaluate one of the functional's own Functions."""
        evaluator = self.keep(name, partial(_evaluator, self.stationarity.functional.function, name))
        return evaluator.evaluated(unknowns, *data, *further)

    def _solved(
        self, key: object, build: Callable[[str], ca.Function], *inputs: ArrayLike
    ) -> tuple[list[np.ndarray], list[float]]:
        """Outputs by the first method that solves the linear equations, and measures, NaN where none does."""
        outputs, measures = list[np.ndarray](), np.empty(0)
        for method in self.methods:
            evaluator = self.keep((key, method), partial(_evaluator, build, method))
            *outputs, measures = evaluator.evaluated(*inputs)
            if measures[-1] <= 0:
                break
        else:
            if not (math.isfinite(measures[-1]) and np.any(outputs[0])):  # of a singular matrix QR makes zeros
                measures[:] = np.nan
        return outputs, measures.tolist()

    @property
    def mass(self) -> np.ndarray:
        """∂²L̂/∂x'² at all points of the last `relinearize`; (N r, d, d)."""
        pointwise = self.stationarity.functional.pointwise
        return pointwise.matrices(self._masses.reshape(-1, pointwise.pattern.nnz()))

    def relinearize(self, unknowns: np.ndarray, data: Data) -> np.ndarray:
        """Evaluate ∇S and ∇²S at a point; returns ∇S."""
        self.matrix, gradient, self._masses = self.evaluate("derivatives", unknowns, data)
        return gradient

    def newton_step(self, unknowns: np.ndarray, data: Data) -> Iterate:
        """Evaluate ∇S and ∇²S at a point, and solve for the Newton step.

        The norm of the step is NaN where ∇²S is singular to the last digit.
        """
        outputs, lengths = self._solved("newton_step", self.stationarity.newton_step, unknowns, *data)
        step, self.direction, sizes, self.matrix = outputs
        norm, length, step_length, _ = lengths
        return Iterate(unknowns, step, sizes, norm, length, step_length, self.matrix)

    def simplified_step(
        self, unknowns: np.ndarray, data: Data, at: Iterate, damping: float
    ) -> tuple[np.ndarray, float, float]:
        """Simplified Newton step: the gradient at a trial point, the Hessian at the last iterate.

        Parameters
        ----------
        unknowns : trial point
        at : the last iterate, whose ∇²S is taken
        damping : factor of the Newton step that led to the trial point

        Returns
        -------
        the step, its length and its nonlinearity (`LinearSolver.simplified_step`); NaN where the gradient is not finite
        or the Hessian is singular to the last digit
        """
        inputs = [unknowns, *data, at.matrix, at.step, at.sizes, np.array([damping])]
        (step,), (length, nonlinearity, _) = self._solved("simplified", self.stationarity.simplified_step, *inputs)
        return step, length, nonlinearity

    def verification(self, unknowns: np.ndarray, data: Data) -> tuple[float, np.ndarray, float, float, np.ndarray]:
        """S, momenta, residual and importance of components at a point; before the last, the last ∇²S's regularity."""
        evaluator = self.keep("verification", lambda: Evaluator(self.stationarity.verification))
        found = evaluator.evaluated(unknowns, *data, self.matrix, self.direction)
        action, momentum, residual, regularity, importance = found
        return action.item(), momentum, residual.item(), regularity.item(), importance

    def solve(self, *rhs: np.ndarray, transposed: bool = False) -> list[np.ndarray]:
        """Solutions of ∇²S y = -b, or (∇²S)ᵀ y = -b, with the present `matrix`; not finite where that is singular."""
        count, linear = len(rhs), self.stationarity.linear_solver
        build = partial(linear.solving, "solutions", columns=count, transposed=transposed)
        (y,), (defect,) = self._solved((count, transposed), build, self.matrix, np.concatenate(rhs))
        return list(y.reshape(count, -1) + 0 * defect)

    def least_squares(self, unknowns: np.ndarray, data: Data, multipliers: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """The multipliers, by their numbers, which are zero among `unknowns`, that leave the least of ∇S.

        Virtual work is measured, ∇S times the `sizes` of components, (d,).  With G the rows of ∇²S that belong to the
        multipliers, and W the squares of one over the sizes, W y + Gᵀμ = -∇S and G y = 0.
        """
        gradient, linear = self.relinearize(unknowns, data), self.stationarity.linear_solver
        gradient[multipliers] = self.matrix[linear.without_multipliers] = 0.0
        for entries, size in zip(linear.diagonal, sizes, strict=True):
            self.matrix[entries] = size**-2.0
        if linear.numbering.free_duration:
            self.matrix[-1] = 1.0
        build = partial(linear.solving, "newton_step")
        return self._solved("squares", build, self.matrix, gradient, joined(unknowns, data))[0][0][multipliers]

    def integrals(self, unknowns: np.ndarray, data: Data) -> tuple[np.ndarray, np.ndarray]:
        """By how much given integrals are missed, (k,), and their derivatives by the free values, (k, positions)."""
        numbering, gradient = self.stationarity.linear_solver.numbering, self.relinearize(unknowns, data)
        chosen = slice(numbering.everywhere.start, numbering.everywhere.start + numbering.integrals)
        matrix = ca.DM(self.stationarity.linear_solver.sparsity, self.matrix.tolist())
        return gradient[chosen], np.array(matrix[chosen, : numbering.positions])

    def refined(
        self, unknowns: np.ndarray, data: Data, rhs: Iterable[np.ndarray], solutions: list[np.ndarray]
    ) -> list[np.ndarray]:
        """Solutions of ∇²S y = -b after one step of iterative refinement; the present ∇²S is that at `unknowns`.

        The residual is summed over the points, without the entries of ∇²S: where ∇²S is nearly singular, the rounding
        of its entries changes the solutions a thousand times more than the rounding of the terms at the points.
        """
        residuals = [b + self.evaluate("product", unknowns, data, y)[0] for y, b in zip(solutions, rhs, strict=True)]
        return [y + correction for y, correction in zip(solutions, self.solve(*residuals), strict=True)]

    def rounding_effects(self, unknowns: np.ndarray, data: Data) -> np.ndarray:
        """Changes of the unknowns by rounding of the terms of ∇S at a point, at random up to half of eps.

        ∇²S must be that at the point.  Terms may cancel within the derivatives of L, which do not tell their sizes.  So
        those of each component are taken to be as large as the other components' at the same node, with forces measured
        by the square roots of stiffnesses.  Returns a change for each of `ROUNDING_SAMPLES` samples, (·, n).
        """
        linear, terms = self.stationarity.linear_solver, self.evaluate("summary", unknowns, data)[3]
        numbering, positions = linear.numbering, linear.numbering.positions
        stiffness = np.sqrt([np.max(np.abs(self.matrix[entries]), initial=0.0) for entries in linear.diagonal])
        shared = np.append(terms, np.zeros(numbering.size - numbering.free))[numbering.of_nodes]
        shared = np.max(np.divide(shared, stiffness, out=np.zeros(shared.shape), where=stiffness > 0), axis=1)
        of_others = stiffness[numbering.component[:positions]] * shared[numbering.place // numbering.dimension]
        terms[:positions] = np.fmax(terms[:positions], of_others)
        rounded = np.random.default_rng(len(terms)).uniform(-EPS / 2, EPS / 2, (ROUNDING_SAMPLES, len(terms)))
        return np.array(self.solve(*(rounded * terms)))


def _evaluator(build: Callable[[str], ca.Function], name: str) -> Evaluator:
    return Evaluator(build(name))


def joined(unknowns: np.ndarray, data: Data) -> np.ndarray:
    """The vector u = (ξ, start, end) of the numbering."""
    return np.concatenate((unknowns, *data[:2]))
