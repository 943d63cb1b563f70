"""The stationarity conditions ∇S(ξ) = 0 of one discrete functional: all that Newton's method needs, in three steps.

    newton_step      ξ, data                                 ->  ∇S, ∇²S; step, softest_direction, sizes, norm
    simplified_step  ξ, data, ∇²S, step, sizes, damping      ->  simplified, length, nonlinearity
    verification     ξ, data, ∇²S, softest_direction         ->  S, momenta, residual, regularity

In each of them a Function of the functional's one graph evaluates, and one of the `LinearSolver`, which serves all
Lagrangians whose ∇²S has the same sparsity, solves or measures.  The `Stationarity` holds both; nobody writes to it, so
it may be shared.  The arrays that a solve writes belong to a `Linearization`, which one solve has for itself: what one
Function writes is where the others read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple, TypeVar, cast

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.functional.buffers import Evaluator, ObjectPool
from casadi_galerkin.functional.functional import Functional, Parts
from casadi_galerkin.functional.numbering import Data
from casadi_galerkin.functional.threads import fork_waits, one_thread, without_zero_pivots
from casadi_galerkin.solvers.linear_solver import METHODS, linear_solver

Built = TypeVar("Built")

ACCEPTED = 50.0  # accepted residual over its roundoff floor; correct solutions were measured at 0.01 to 5
SIGN_SAMPLES = 4  # random choices of the signs of rounding errors, from which the effect of rounding is estimated


class Iterate(NamedTuple):
    """A point with its Newton step.

    Attributes
    ----------
    unknowns : ξ
    step : -∇²S⁻¹ ∇S
    sizes : sizes that the unknowns are measured by
    norm : largest entry of the step relative to them; NaN where the step is not finite
    matrix, softest_direction : nonzeros of ∇²S, and the solution for a generic right-hand side
    """

    unknowns: np.ndarray
    step: np.ndarray
    sizes: np.ndarray
    norm: float
    matrix: np.ndarray
    softest_direction: np.ndarray


class Stationarity:
    """Stationarity conditions of a functional at (ξ, *data), data being (start, end, mesh[, parameters][, given]).

    Parameters
    ----------
    functional : Functional

    Attributes
    ----------
    linear_solver : LinearSolver for the functional's Hessian
    linear_methods : how ∇²S is solved with: LDLᵀ, and QR where that fails; QR alone where ∂²L/∂v_i² is structurally
        zero for some i, or where ∇²S is not symmetric, as with a force
    variational : whether the conditions are those of an action that may be lowered, under conditions if there are some
    """

    def __init__(self, functional: Functional) -> None:
        self.functional = functional
        self.linear_solver = linear_solver(functional)
        self.variational = functional.symmetric and not functional.numbering.stretched
        self.linear_methods = METHODS if functional.pointwise.kinetic and functional.symmetric else METHODS[1:]
        self._workspaces = ObjectPool(lambda: Linearization(self))

    @cached_property
    def unforced(self) -> Stationarity | None:
        """The conditions of the same functional without its force; None where there is none."""
        functional = self.functional.unforced
        return None if functional is None else Stationarity(functional)

    @contextmanager
    def linearization(self, linear_solver: str | None = None) -> Iterator[Linearization]:
        """Lend the arrays of an earlier solve, or new ones, to a solve.

        Parameters
        ----------
        linear_solver : name of a CasADi linear solver; default `linear_methods`
        """
        with fork_waits, self._workspaces.lend() as lent, one_thread(), without_zero_pivots():
            lent.methods = (linear_solver,) if linear_solver else self.linear_methods
            yield lent

    @property
    def floor(self) -> ca.Function:
        """(ξ, data) -> gradient ∇S, and floor, the roundoff floor of every entry of it."""

        def parts() -> Parts:
            _, _, gradient, terms = self.functional.first_variation
            floor = self.linear_solver.floor(self.functional.derivatives[0], self.functional.u, terms)[0]
            return {}, ["gradient", "floor"], [gradient, floor]

        return self.functional.keep("floor", parts)

    def gradient_and_floor(self, unknowns: np.ndarray, data: Data) -> tuple[np.ndarray, np.ndarray]:
        """∇S and the roundoff floor of every entry of it, (n,) each."""
        gradient, floor = self.floor.call([unknowns, *data])
        return np.array(gradient).ravel(), np.array(floor).ravel()

    def sizes(self, unknowns: np.ndarray, data: Data) -> np.ndarray:
        """What each unknown is measured by: the size of its component in the path, or one where that is zero."""
        return np.array(self.linear_solver.sizes(joined(unknowns, data))[0]).ravel()


class Linearization:
    """The arrays of one solve: ∇S, ∇²S and what was found with them at the last iterate.

    Attributes
    ----------
    methods : names of the linear solvers to try, in order
    """

    def __init__(self, stationarity: Stationarity) -> None:
        self.stationarity = stationarity
        self.methods: tuple[str, ...] = METHODS
        numbering = stationarity.functional.numbering
        u, free, end = np.zeros(numbering.size), numbering.free, numbering.size - len(numbering.fixed_end)
        self._arrays: dict[str, np.ndarray] = {"u": u, "unknowns": u[:free], "start": u[free:end], "end": u[end:]}
        self._evaluators: dict[tuple[str, ...], Evaluator] = {}
        self._inputs = list(stationarity.functional.symbols)[1:]
        self._kept: dict[str, Any] = {}
        self._data: Data | None = None

    def keep(self, key: str, build: Callable[[], Built]) -> Built:
        """A CasADi solver, built when it is first asked for: two solves must not share one."""
        if key not in self._kept:
            self._kept[key] = build()
        return cast(Built, self._kept[key])

    @property
    def gradient(self) -> np.ndarray:
        """∇S as it was last evaluated."""
        return self._arrays["gradient"]

    @property
    def matrix(self) -> np.ndarray:
        """Nonzeros of ∇²S as it was last evaluated."""
        return self._arrays["matrix"]

    def _array(self, name: str, size: int) -> np.ndarray:
        """The array of a name, made when it is first asked for."""
        if name not in self._arrays:
            self._arrays[name] = np.zeros(size)
        return self._arrays[name]

    def _bind(self, key: tuple[str, ...], function: ca.Function) -> Evaluator:
        """Let a Function read and write the arrays of the names of its inputs and outputs."""
        self._evaluators[key] = evaluator = Evaluator(function, self._arrays)
        self._arrays |= evaluator.inputs | evaluator.outputs
        return evaluator

    def _evaluate(self, name: str, unknowns: np.ndarray, data: Data) -> None:
        """Evaluate one of the functional's own Functions on the arrays of the names of its inputs and outputs."""
        evaluator = self._evaluators.get((name,)) or self._bind((name,), self.stationarity.functional.function(name))
        if data is not self._data:  # the same tuple in all iterations
            self._data = None  # an interrupt may come between two arrays
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
                arrays[name][:] = np.nan  # what stays where CasADi's QR gives up
            evaluator.run()
            if arrays["defect"][0] <= 0:
                return
            if not np.isfinite(self.gradient).all():
                break
        solved = math.isfinite(arrays["defect"][0]) and np.any(arrays[step])
        if not solved:  # CasADi's QR answers a rank-deficient system with zeros
            for name in measures:
                arrays[name][:] = np.nan

    def newton_step(self, unknowns: np.ndarray, data: Data) -> Iterate:
        """The Newton step and its measures; its norm is NaN where the Hessian is singular to the last digit.

        `matrix` is then ∇²S at this point.
        """
        self._evaluate("derivatives", unknowns, data)
        self._solve(self.stationarity.linear_solver.newton_step, "step", "norm")
        arrays = self._arrays
        left = arrays["matrix"].copy(), arrays["softest_direction"].copy()
        return Iterate(unknowns, arrays["step"].copy(), arrays["sizes"].copy(), arrays["norm"].item(), *left)

    def return_to(self, at: Iterate) -> None:
        """Restore ∇²S and the softest direction of an earlier iterate."""
        self._arrays["matrix"][:], self._arrays["softest_direction"][:] = at.matrix, at.softest_direction

    def relinearize(self, unknowns: np.ndarray, data: Data) -> np.ndarray:
        """Evaluate ∇S and ∇²S, which `gradient` and `matrix` then are; returns a copy of ∇S."""
        self._evaluate("derivatives", unknowns, data)
        return self.gradient.copy()

    def terms(self, unknowns: np.ndarray, data: Data) -> np.ndarray:
        """Sizes of what every entry of ∇S sums, (n,), without a change of ∇²S."""
        self._evaluate("summary", unknowns, data)
        return self._arrays["terms"].copy()

    def simplified_step(
        self, unknowns: np.ndarray, data: Data, at: Iterate, damping: float
    ) -> tuple[np.ndarray, float, float]:
        """Simplified Newton step: the gradient at a trial point, the Hessian at the last iterate `at`.

        Returns
        -------
        the step, its length and its nonlinearity (`LinearSolver.simplified_step`); NaN where the gradient is not finite
        or the Hessian is singular to the last digit
        """
        for name, value in (("step", at.step), ("sizes", at.sizes), ("damping", damping)):
            self._array(name, np.size(value))[:] = value
        self._evaluate("gradient", unknowns, data)
        self._solve(self.stationarity.linear_solver.simplified_step, "simplified", "length", "nonlinearity")
        found, length, nonlinearity = (self._arrays[name] for name in ("simplified", "length", "nonlinearity"))
        return found.copy(), length.item(), nonlinearity.item()

    def verification(self, unknowns: np.ndarray, data: Data) -> tuple[float, np.ndarray, float, float]:
        """S, momenta at the joints, residual and regularity; Hessian and softest direction are of the last iterate."""
        self._evaluate("summary", unknowns, data)
        key = ("verification",)
        (self._evaluators.get(key) or self._bind(key, self.stationarity.linear_solver.verification)).run()
        names = "action", "momentum", "residual", "regularity"
        action, momentum, residual, regularity = (self._arrays[name] for name in names)
        return action.item(), momentum.copy(), residual.item(), regularity.item()

    def evaluate(self, name: str, unknowns: np.ndarray, data: Data, *further: np.ndarray) -> list[np.ndarray]:
        """Evaluate one of the functional's own Functions, without a change of ∇S and ∇²S; returns copies."""
        key = name, "apart"
        if key not in self._evaluators:
            self._evaluators[key] = Evaluator(self.stationarity.functional.function(name))
        return self._evaluators[key](unknowns, *data, *further)

    def weight_inertia(self, unknowns: np.ndarray, data: Data, factor: float) -> None:
        """Evaluate ∇²S with ∂²L/∂v² times a factor; a large one makes ∇²S positive definite where ∂²L/∂v² is."""
        self._array("inertia", 1)[:] = factor
        self._evaluate("inertia_weighted", unknowns, data)

    def solve(self, *rhs: np.ndarray, transposed: bool = False) -> list[np.ndarray]:
        """Solutions of ∇²S y = -b, or (∇²S)ᵀ y = -b, with the last `matrix`; not finite where that is singular."""
        columns, linear = len(rhs), self.stationarity.linear_solver
        for method in self.methods:
            key = "solutions", method, str(columns), str(transposed)
            if key not in self._evaluators:
                solutions = linear.solutions(method, columns, transposed)
                self._evaluators[key] = Evaluator(solutions, {"matrix": self.matrix})
            y, defect = self._evaluators[key](np.concatenate(rhs))
            if defect[0] <= 0:
                break
        else:
            if not np.any(y):  # CasADi's QR answers a rank-deficient system with zeros
                y[:] = np.nan
        return list(y.reshape(columns, -1))

    def refined(self, unknowns: np.ndarray, data: Data, *rhs: np.ndarray) -> list[np.ndarray]:
        """Solutions of ∇²S y = -b with ∇²S at `unknowns`, as it was left, refined once.

        What they leave of b is summed over the points: where ∇²S is nearly singular, rounding of its entries moves
        solutions a thousand times further than that of the terms they sum.
        """
        first = self.solve(*rhs)
        left = [b + self.evaluate("product", unknowns, data, y)[0] for y, b in zip(first, rhs, strict=True)]
        return [y + further for y, further in zip(first, self.solve(*left), strict=True)]

    def rounding_effects(self, terms: np.ndarray) -> np.ndarray:
        """What errors of the equations of these sizes do to the unknowns, for `SIGN_SAMPLES` choices of random signs.

        ∇²S is the last `matrix`; (SIGNS, n).
        """
        signs = np.random.default_rng(len(terms)).choice((-1.0, 1.0), (SIGN_SAMPLES, len(terms)))
        return np.array(self.solve(*(signs * terms)))


def joined(unknowns: np.ndarray, data: Data) -> np.ndarray:
    """The vector u = (ξ, start, end) of the numbering."""
    return np.concatenate((unknowns, *data[:2]))
