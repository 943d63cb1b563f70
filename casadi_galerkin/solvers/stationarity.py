"""The stationarity conditions ∇S(ξ) = 0 of one discrete functional, and the three Functions that Newton's method needs.

    newton_step      ξ, data                           ->  ∇S, ∇²S; step, smallest_curvature_direction, sizes, norm
    simplified_step  ξ, data, ∇²S, step, sizes, damping               ->  simplified, length, nonlinearity
    verification     ξ, data, ∇²S, smallest_curvature_direction       ->  S, momenta, residual, regularity

In each, a Function of the functional's graph evaluates, and a Function of the `LinearSolver` solves or measures.
A `LinearSolver` serves all Lagrangians whose ∇²S has the same sparsity.  A `Stationarity` holds the functional and the
linear solver; it is immutable and may be shared.  The arrays that a solve writes to belong to a `Linearization`, which
only one solve uses at a time.  The outputs of one Function and the inputs of another with the same name are one array.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple, TypeVar

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.functional.buffers import Evaluator, ObjectPool, fork_waits, one_thread
from casadi_galerkin.functional.functional import Functional, Parts
from casadi_galerkin.functional.numbering import Data
from casadi_galerkin.solvers.linear_solver import METHODS, linear_solver

Built = TypeVar("Built")

ACCEPTED = 50.0  # accepted residual over its roundoff floor; correct solutions were measured at 0.01 to 5
SIGN_SAMPLES = 4  # number of random choices of the signs of rounding errors for an estimate of their effect


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
    smallest_curvature_direction : solution of the linear equations with ∇²S for a generic right-hand side
    """

    unknowns: np.ndarray
    step: np.ndarray
    sizes: np.ndarray
    norm: float
    length: float
    step_length: float
    matrix: np.ndarray
    smallest_curvature_direction: np.ndarray


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
        self._workspaces = ObjectPool(lambda: Linearization(self))

    @contextmanager
    def linearization(self, linear_solver: str | None = None) -> Iterator[Linearization]:
        """Lend a `Linearization` to one solve: that of an earlier solve, or a new one.

        Parameters
        ----------
        linear_solver : name of a CasADi linear solver; default `linear_methods`
        """
        with fork_waits, self._workspaces.lend() as lent, one_thread():
            lent.methods = (linear_solver,) if linear_solver else self.linear_methods
            yield lent

    @property
    def floor(self) -> ca.Function:
        """(ξ, data) -> gradient ∇S, and floor, the roundoff floor of every entry of it."""

        def parts() -> Parts:
            first, second = self.functional.first_variation, self.functional.derivatives[0]
            floor = self.linear_solver.floor(second, self.functional.u, first["terms"])[0]
            return {}, {"gradient": first["gradient"], "floor": floor}

        return self.functional.keep("floor", parts)

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
    """The arrays of one solve, which its methods overwrite.

    ∇S (`gradient`) is that of the last point at which a method evaluated it: `newton_step`, `relinearize`,
    `simplified_step`, `terms`, `rounding_effects` and `verification` do.  ∇²S (`matrix`) is that of the last
    `newton_step` or `relinearize`, or the one restored by `return_to`; the other methods keep it.  The direction of
    smallest curvature is that of the last `newton_step` or `return_to`.  `solve`, `refined` and `rounding_effects`
    solve with the present ∇²S, and `simplified_step` with the present ∇²S and a new ∇S.  `evaluate` has arrays of its
    own.

    Attributes
    ----------
    methods : names of the linear solvers to try, in order
    """

    def __init__(self, stationarity: Stationarity) -> None:
        self.stationarity = stationarity
        self.methods: tuple[str, ...] = METHODS
        numbering = stationarity.functional.numbering
        u = np.zeros(numbering.size)
        self._arrays = dict(zip(("u", "unknowns", "start", "end"), (u, *numbering.parted(u)), strict=True))
        self._evaluators: dict[tuple[str, ...], Evaluator] = {}
        self._inputs = list(stationarity.functional.symbols)[1:]
        self._kept: dict[str, Any] = {}
        self._data: Data | None = None

    def keep(self, key: str, build: Callable[[], Built]) -> Built:
        """A CasADi solver, built when it is first used; kept here because two solves must not share one."""
        if key not in self._kept:
            self._kept[key] = build()
        return self._kept[key]

    @property
    def gradient(self) -> np.ndarray:
        """∇S at the point where it was last evaluated; (n,)."""
        return self._arrays["gradient"]

    @property
    def matrix(self) -> np.ndarray:
        """Nonzeros of the present ∇²S, see the class."""
        return self._arrays["matrix"]

    @property
    def mass(self) -> np.ndarray:
        """∂²L̂/∂x'² at all points where ∇²S was last evaluated; (N r, d, d)."""
        pointwise = self.stationarity.functional.pointwise
        return pointwise.matrices(self._arrays["mass"].reshape(-1, pointwise.pattern.nnz()))

    def _bind(self, key: tuple[str, ...], function: ca.Function) -> Evaluator:
        """Bind the inputs and outputs of a Function to the arrays with their names."""
        self._evaluators[key] = evaluator = Evaluator(function, self._arrays)
        self._arrays |= evaluator.inputs | evaluator.outputs
        return evaluator

    def _evaluate(self, name: str, unknowns: np.ndarray, data: Data) -> None:
        """Evaluate one of the functional's own Functions on the arrays with the names of its inputs and outputs."""
        evaluator = self._evaluators.get((name,)) or self._bind((name,), self.stationarity.functional.function(name))
        if data is not self._data:  # the same tuple in all iterations
            self._data = None  # until all arrays are written, because an interrupt may come between two
            for key, values in zip(self._inputs, data, strict=True):
                self._arrays[key][:] = values
            self._data = data
        self._arrays["unknowns"][:] = unknowns
        evaluator.run()

    def _solve(self, build: Callable[[str], ca.Function], step: str, *measures: str) -> None:
        """Solve by the first method that succeeds; the measures are NaN where none does."""
        arrays = self._arrays
        for method in self.methods:
            key = build.__name__, method
            evaluator = self._evaluators.get(key) or self._bind(key, build(method))
            for name in (*measures, "defect") if method != METHODS[0] else ():
                arrays[name][:] = np.nan  # CasADi's QR leaves the outputs unchanged where it fails
            evaluator.run()
            if arrays["defect"][0] <= 0:
                return
            if not np.isfinite(self.gradient).all():
                break
        solved = math.isfinite(arrays["defect"][0]) and np.any(arrays[step])
        if not solved:  # for a singular matrix CasADi's QR returns zeros
            for name in measures:
                arrays[name][:] = np.nan

    def newton_step(self, unknowns: np.ndarray, data: Data) -> Iterate:
        """Evaluate ∇S and ∇²S at a point, and solve for the Newton step.

        The norm of the step is NaN where ∇²S is singular to the last digit.
        """
        self._evaluate("derivatives", unknowns, data)
        self._solve(self.stationarity.linear_solver.newton_step, "step", "norm")
        arrays = self._arrays
        matrix, smallest_curvature_direction = arrays["matrix"].copy(), arrays["smallest_curvature_direction"].copy()
        step, sizes = arrays["step"].copy(), arrays["sizes"].copy()
        norm, length, step_length = (arrays[name].item() for name in ("norm", "path_length", "step_length"))
        return Iterate(unknowns, step, sizes, norm, length, step_length, matrix, smallest_curvature_direction)

    def return_to(self, at: Iterate) -> None:
        """Restore ∇²S and the direction of smallest curvature of an earlier iterate."""
        self._arrays["matrix"][:], self._arrays["smallest_curvature_direction"][:] = (
            at.matrix,
            at.smallest_curvature_direction,
        )

    def relinearize(self, unknowns: np.ndarray, data: Data) -> np.ndarray:
        """Evaluate ∇S and ∇²S at a point; returns a copy of ∇S."""
        self._evaluate("derivatives", unknowns, data)
        return self.gradient.copy()

    def terms(self, unknowns: np.ndarray, data: Data) -> np.ndarray:
        """Sums of the sizes of the terms of every entry of ∇S, (n,); evaluates ∇S, but not ∇²S."""
        self._evaluate("summary", unknowns, data)
        return self._arrays["terms"].copy()

    def simplified_step(
        self, unknowns: np.ndarray, data: Data, at: Iterate, damping: float
    ) -> tuple[np.ndarray, float, float]:
        """Simplified Newton step: the gradient at a trial point, the Hessian at the last iterate.

        Parameters
        ----------
        unknowns : trial point
        at : the last iterate, whose ∇²S is the present one
        damping : factor of the Newton step that led to the trial point

        Returns
        -------
        the step, its length and its nonlinearity (`LinearSolver.simplified_step`); NaN where the gradient is not finite
        or the Hessian is singular to the last digit
        """
        for name, value in (("step", at.step), ("sizes", at.sizes), ("damping", damping)):
            self._arrays.setdefault(name, np.zeros(np.size(value)))[:] = value
        self._evaluate("gradient", unknowns, data)
        self._solve(self.stationarity.linear_solver.simplified_step, "simplified", "length", "nonlinearity")
        step, length, nonlinearity = (self._arrays[name] for name in ("simplified", "length", "nonlinearity"))
        return step.copy(), length.item(), nonlinearity.item()

    def verification(self, unknowns: np.ndarray, data: Data) -> tuple[float, np.ndarray, float, float, np.ndarray]:
        """S, momenta, residual and importance of components at a point; before the last, the last ∇²S's regularity."""
        self._evaluate("summary", unknowns, data)
        key = ("verification",)
        (self._evaluators.get(key) or self._bind(key, self.stationarity.linear_solver.verification)).run()
        names = "action", "momentum", "residual", "regularity", "importance"
        action, momentum, residual, regularity, importance = (self._arrays[name].copy() for name in names)
        return action.item(), momentum, residual.item(), regularity.item(), importance

    def evaluate(self, name: str, unknowns: np.ndarray, data: Data, *further: np.ndarray) -> list[np.ndarray]:
        """Evaluate one of the functional's own Functions without changing ∇S and ∇²S; returns copies."""
        key = name, "apart"
        if key not in self._evaluators:
            self._evaluators[key] = Evaluator(self.stationarity.functional.function(name))
        return self._evaluators[key](unknowns, *data, *further)

    def solve(self, *rhs: np.ndarray, transposed: bool = False) -> list[np.ndarray]:
        """Solutions of ∇²S y = -b, or (∇²S)ᵀ y = -b, with the present `matrix`; not finite where that is singular."""
        columns, linear = len(rhs), self.stationarity.linear_solver
        y = np.full(columns * linear.numbering.free, np.nan)
        for method in self.methods:
            key = "solutions", method, str(columns), str(transposed)
            if key not in self._evaluators:
                solutions = linear.solutions(method, columns, transposed)
                self._evaluators[key] = Evaluator(solutions, {"matrix": self.matrix})
            y, defect = self._evaluators[key](np.concatenate(rhs))
            if defect[0] <= 0:
                break
        else:
            if not np.any(y):  # for a singular matrix CasADi's QR returns zeros
                y[:] = np.nan
        return list(y.reshape(columns, -1))

    def least_squares(self, unknowns: np.ndarray, data: Data, multipliers: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """The multipliers, by their numbers, which are zero among `unknowns`, that leave the least of ∇S.

        Virtual work is measured, ∇S times the `sizes` of components, (d,).  With G the rows of ∇²S that belong to the
        multipliers, and W the squares of one over the sizes, W y + Gᵀμ = -∇S and G y = 0.
        """
        self._evaluate("derivatives", unknowns, data)
        linear = self.stationarity.linear_solver
        self.gradient[multipliers] = self.matrix[linear.without_multipliers] = 0.0
        for entries, size in zip(linear.diagonal, sizes, strict=True):
            self.matrix[entries] = size**-2.0
        if linear.numbering.free_duration:
            self.matrix[-1] = 1.0
        self._solve(linear.newton_step, "step", "norm")
        return self._arrays["step"][multipliers]

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
        """Changes of the unknowns by rounding of the terms of ∇S at a point, by eps and with random signs.

        ∇²S must be that at the point.  Terms may cancel within the derivatives of L, which do not tell their sizes.  So
        those of each component are taken to be as large as the other components' at the same node, with forces measured
        by the square roots of stiffnesses.  Returns a change for each of `SIGN_SAMPLES` choices of the signs, (·, n).
        """
        linear, terms = self.stationarity.linear_solver, self.terms(unknowns, data)
        numbering, positions = linear.numbering, linear.numbering.positions
        stiffness = np.sqrt([np.max(np.abs(self.matrix[entries]), initial=0.0) for entries in linear.diagonal])
        shared = np.append(terms, np.zeros(numbering.size - numbering.free))[numbering.of_nodes]
        shared = np.max(np.divide(shared, stiffness, out=np.zeros(shared.shape), where=stiffness > 0), axis=1)
        of_others = stiffness[numbering.component[:positions]] * shared[numbering.place // numbering.dimension]
        terms[:positions] = np.fmax(terms[:positions], of_others)
        signs = np.random.default_rng(len(terms)).choice((-EPS, EPS), (SIGN_SAMPLES, len(terms)))
        return np.array(self.solve(*(signs * terms)))


def joined(unknowns: np.ndarray, data: Data) -> np.ndarray:
    """The vector u = (ξ, start, end) of the numbering."""
    return np.concatenate((unknowns, *data[:2]))
