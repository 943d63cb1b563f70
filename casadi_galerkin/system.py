"""The stationarity conditions ∇S(ξ) = 0 of one transcription, evaluated on NumPy arrays; their second variation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import casadi as ca
import numpy as np

from casadi_galerkin.algebra import Algebra
from casadi_galerkin.layout import Data
from casadi_galerkin.stages import Call, Chain, Evaluator, Stage

ROUNDOFF = 50.0  # accepted residual over its roundoff floor; correct solutions were measured at 0.01 to 5
SINGULAR = 1e-12  # second variation over the sum of its terms below which the Hessian is called singular
AGREED = 1e-3  # part of the assembled yᵀ∇²S y that the points must find; families 7e-7 at most, regular paths 1 - 1e-5

STAGED = {  # name -> stages, names of the results; last the excess of what was solved for
    "action": (("embed", "first", "sum"), ("action",)),
    "gradient": (("embed", "first", "integrate"), ("gradient",)),
    "derivatives": (("embed", "derivatives", "integrate", "assemble"), ("gradient",)),
    "newton": (("embed", "derivatives", "integrate", "assemble", "step"), ("step", "sizes", "norm", "excess")),
    "newton again": (("embed", "first", "integrate", "step"), ("step", "sizes", "norm", "excess")),
    "search": (("embed", "first", "integrate", "search"), ("simplified", "length", "bend", "excess")),
    "judged": (
        ("embed", "derivatives", "sum", "integrate", "vary", "assemble", "judge"),
        ("action", "momentum", "residual", "regularity", "gradient", "floor"),
    ),
    "ended": (
        ("embed", "first", "sum", "integrate", "vary", "judge"),
        ("action", "momentum", "residual", "regularity"),
    ),
    "compiled newton": (("lean", "iterate", "measured"), ("step", "sizes", "norm", "excess")),
    "compiled search": (
        ("embed", "first", "integrate", "resolve", "compared"),
        ("simplified", "length", "bend", "excess"),
    ),
}


class Iterate(NamedTuple):
    """A point with its Newton step.

    Attributes
    ----------
    unknowns : ξ
    step : -∇²S⁻¹ ∇S
    sizes : what the unknowns are measured by
    norm : largest step relative to them; NaN where the step is not finite
    """

    unknowns: np.ndarray
    step: np.ndarray
    sizes: np.ndarray
    norm: float


@dataclass(eq=False)
class System:
    """Stationarity conditions of a discrete action, evaluated at (ξ, *data), data being (start, end, mesh, ...).

    Attributes
    ----------
    build : name -> Function of (ξ, *data), for those that take further inputs and for other solvers; called when the
        Function is first needed, since building costs more than evaluating
    mapped : name -> pointwise Function over all points, "first" or "derivatives"
    algebra : Algebra
    blocks : which second-derivative blocks the pointwise Function has
    pivots : whether LDLᵀ without pivoting can work: False where ∂²L/∂v_i² is structurally zero for some i
    quadratic : whether the Hessian depends on the data alone
    compiled : the stages "iterate" and "resolve" of a compiled Newton iteration, bound to the workspace of `algebra`;
        empty without one
    once : whether so little is solved that building "first" would cost more than it saves: "derivatives" does for all
    """

    build: Callable[[str], ca.Function]
    mapped: Callable[[str], ca.Function]
    algebra: Algebra
    blocks: tuple[tuple[int, int], ...]
    pivots: bool = True
    quadratic: bool = False
    compiled: Mapping[str, Call] = field(default_factory=dict)
    once: bool = False
    _holds_factors: bool = False  # the compiled iteration, of the last iterate
    _evaluators: dict[str, Evaluator] = field(default_factory=dict, repr=False, compare=False)
    _chains: dict[str, Chain] = field(default_factory=dict, repr=False, compare=False)
    _solvers: dict[tuple[bool, int, int], ca.Function] = field(default_factory=dict, repr=False, compare=False)

    def evaluate(self, name: str, unknowns: np.ndarray, data: Data, *further: np.ndarray) -> list[np.ndarray]:
        """Evaluate at ξ and data, with a further argument for Functions of `build` that take one.

        By stages, embed, evaluate pointwise and integrate, are evaluated

        - action : -> S
        - gradient : -> ∇S by ξ
        - derivatives : -> ∇S; ∇²S is left in `algebra.matrix`
        - judged : -> what `judge` gives, with the Hessian at ξ itself, ∇S, and its roundoff floor
        """
        if name in STAGED:
            with self.algebra.lock:
                return [array.copy() for array in self._chain(name)(unknowns, data)]
        if name not in self._evaluators:
            self._evaluators[name] = Evaluator(self.build(name))
        return self._evaluators[name](unknowns, *data, *further)

    def _chain(self, name: str) -> Chain:
        if name not in self._chains:
            workspace, algebra = self.algebra.workspace, self.algebra
            stages: dict[str, Callable[[], Stage]] = {
                "embed": workspace.embed,
                "first": partial(self._at_points, "derivatives" if self.once else "first"),
                "derivatives": partial(self._at_points, "derivatives"),
                "sum": workspace.sum,
                "integrate": workspace.integrate,
                "vary": workspace.vary,
                "assemble": partial(workspace.assemble, self.blocks),
                "step": algebra.step,
                "search": algebra.search,
                "judge": algebra.judge,
                "lean": algebra.lean,
                "measured": algebra.measured,
                "compared": algebra.compared,
            }
            of_chain, results = STAGED[name]
            built = [self.compiled.get(stage) or stages[stage]() for stage in of_chain]
            self._chains[name] = Chain(workspace, built, results)
        return self._chains[name]

    def _at_points(self, name: str) -> Evaluator:
        if name not in self._evaluators:
            self._evaluators[name] = self.algebra.workspace.stage(self.mapped(name))
        return self._evaluators[name]

    def iterate(self, unknowns: np.ndarray, data: Data, again: bool = False) -> Iterate:
        """The Newton step, found as by `solve`, and its measures.

        Its norm is NaN where the Hessian is singular to the last digit, or the gradient not finite.  ∇²S is left; if it
        was already that of the same data, `again` spares a quadratic Lagrangian its evaluation.
        """
        with self.algebra.lock:
            if self.compiled:
                step, sizes, norm, excess = self._chain("compiled newton")(unknowns, data)
                self._holds_factors = excess.item() <= 0
            if not self._holds_factors:
                kept = again and self.quadratic and not self.compiled  # a compiled iterate assembles no Hessian
                names = ("newton again", "gradient") if kept else ("newton", "derivatives")
                step, sizes, norm, _ = self._found(*names, "step", unknowns, data)
            return Iterate(unknowns, step.copy(), sizes.copy(), norm.item())

    def restore(self, unknowns: np.ndarray, data: Data) -> None:
        """Leave what `search` needs of an earlier iterate again: its Hessian, or the factors of that."""
        if self.compiled:
            self.iterate(unknowns, data)
        else:
            self.evaluate("derivatives", unknowns, data)

    def search(
        self, unknowns: np.ndarray, data: Data, step: np.ndarray, sizes: np.ndarray, damping: float
    ) -> tuple[np.ndarray, float, float]:
        """The step that follows a damped part of `step` with the same matrix, and the measures of `Algebra.search`.

        They are NaN where the gradient is not finite, or the Hessian is singular to the last digit.
        """
        with self.algebra.lock:
            chain = self._chain("compiled search" if self._holds_factors else "search")  # makes its arrays
            arrays = self.algebra.workspace.arrays
            arrays["whole"][:], arrays["measured_by"][:], arrays["damping"][:] = step, sizes, damping
            if not self._holds_factors:
                simplified, length, bend, _ = self._found("search", "gradient", "search", unknowns, data)
            else:
                simplified, length, bend, excess = chain(unknowns, data)
                if not excess.item() <= 0:
                    length[:] = bend[:] = np.nan
            return simplified.copy(), length.item(), bend.item()

    def judge(self, unknowns: np.ndarray, data: Data) -> tuple[float, np.ndarray, float, float]:
        """S, momenta at the joints, and residual and regularity by `Algebra.judge`.

        For a point that a step led to: Hessian and soft direction are those of the last `iterate`, which `search` still
        finds afterwards.
        """
        with self.algebra.lock:
            chain = self._chain("judged" if self._holds_factors else "ended")
            action, momentum, residual, regularity, *_ = chain(unknowns, data)
            return action.item(), momentum.copy(), residual.item(), regularity.item()

    def _found(self, name: str, without: str, stage: str, unknowns: np.ndarray, data: Data) -> list[np.ndarray]:
        """Results of a chain that ends with a stage by LDLᵀ, or of the one `without` it and the stage by QR."""
        if self.pivots:
            results = self._chain(name)(unknowns, data)
            if results[-1].item() <= 0:
                return results
        else:
            self._chain(without)(unknowns, data)
        self.algebra.by_qr(stage)
        return [self.algebra.workspace.arrays[key] for key in STAGED[name][1]]

    def add_inertia(self, factor: float) -> None:
        """Multiply ∂²L/∂v² by a factor, in the Hessian as last evaluated.

        A large one makes the Hessian positive definite where the kinetic energy is.
        """
        workspace = self.algebra.workspace
        if (1, 1) in self.blocks:
            workspace.arrays["block11"] *= factor
        workspace.assemble(self.blocks)()

    def solve(self, *rhs: np.ndarray) -> list[np.ndarray]:
        """Solutions of ∇²S y = -b; not finite where the Hessian is singular to the last digit."""
        return self.algebra.solve(*rhs, pivots=self.pivots)


def joined(unknowns: np.ndarray, data: Data) -> np.ndarray:
    """The layout's vector u = (ξ, start, end)."""
    return np.concatenate((unknowns, *data[:2]))


def softest(system: System, unknowns: np.ndarray, data: Data) -> tuple[np.ndarray, float]:
    """Direction of the smallest second variation relative to the sizes of its terms, and that; 0 at a conjugate point.

    Three inverse iterations, weighted by the sizes of the Hessian's rows, find the direction y; the pointwise sums
    give its quotient yᵀ∇²S y / Σ |z|ᵀ|∇²L̂||z|, which does not depend on scales or on the mesh.  Where a free
    component enters L by its velocity alone, y is a constant, and its terms are roundoff of which nothing cancels:
    the assembled Hessian then makes more of y than the points do.  The Hessian at `unknowns` is left in
    `System.algebra`.
    """
    if len(unknowns) == 0:
        return unknowns, np.inf  # nothing can vary
    system.evaluate("derivatives", unknowns, data)
    u = joined(unknowns, data)
    sizes, rhs = system.algebra.sizes(u), system.algebra.probe(u)
    weights = system.algebra.spread(sizes) / sizes
    y = force = np.zeros(len(unknowns))
    for _ in range(3):
        (solved,) = system.solve(rhs)
        if not np.isfinite(solved).all():
            return y, 0.0  # singular to the last digit
        largest = np.max(np.abs(solved / sizes))
        y, force = solved / largest, rhs / largest  # ∇²S y = -force
        rhs = weights * y
    signed, positive = (float(value[0]) for value in system.evaluate("curvature", unknowns, data, y))
    regular = math.isfinite(signed) and AGREED * abs(y @ force) < positive < math.inf
    return y, abs(signed) / positive if regular else 0.0


def second_variation(system: System, unknowns: np.ndarray, data: Data) -> float:
    """Smallest second variation relative to the sizes of its terms, as `softest` finds it."""
    return softest(system, unknowns, data)[1]


def negative_eigenvalues(system: System, unknowns: np.ndarray, data: Data) -> int | None:
    """Morse index: number of negative eigenvalues of the Hessian, from the inertia of its LDLᵀ factors.

    None where the kinetic energy is indefinite by structure, such as v_0 v_1: the index then grows without bound
    as the mesh is refined, and LDLᵀ without pivoting does not find it.
    """
    if not system.pivots:
        return None
    if len(unknowns) == 0:
        return 0
    matrix = system.build("derivatives").call([unknowns, *data])[0]
    with system.algebra.lock:
        system.algebra.factors.nfact(matrix)
        return int(system.algebra.factors.neig(matrix))
