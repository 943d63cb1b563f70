"""The stationarity conditions ∇S(ξ) = 0 of one transcription, evaluated on NumPy arrays; their second variation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import casadi as ca
import numpy as np

from casadi_galerkin.algebra import Algebra
from casadi_galerkin.layout import Data
from casadi_galerkin.stages import Chain, Evaluator

ROUNDOFF = 50.0  # accepted residual over its roundoff floor; correct solutions were measured at 0.01 to 5
SINGULAR = 1e-12  # second variation over the sum of its terms below which the Hessian is called singular
AGREED = 1e-3  # part of the assembled yᵀ∇²S y that the points must find; families 7e-7 at most, regular paths 1 - 1e-5

STAGED = {  # name -> pointwise Function, what follows it, names of the results
    "action": ("first", ("sum",), ("action",)),
    "gradient": ("first", ("integrate",), ("gradient",)),
    "derivatives": ("derivatives", ("integrate", "assemble"), ("gradient",)),
    "newton": ("derivatives", ("integrate", "assemble", "step"), ("step", "sizes", "norm")),
    "search": ("first", ("integrate", "search"), ("simplified", "length", "bend")),
    "judged": (
        "derivatives",
        ("sum", "integrate", "vary", "assemble", "judge"),
        ("action", "momentum", "gradient", "floor", "regularity"),
    ),
}


@dataclass(frozen=True)
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
    once : whether so little is solved that building "first" would cost more than it saves: "derivatives" does for all
    """

    build: Callable[[str], ca.Function]
    mapped: Callable[[str], ca.Function]
    algebra: Algebra
    blocks: tuple[tuple[int, int], ...]
    pivots: bool = True
    once: bool = False
    _evaluators: dict[str, Evaluator] = field(default_factory=dict, repr=False, compare=False)
    _chains: dict[str, Chain] = field(default_factory=dict, repr=False, compare=False)
    _solvers: dict[tuple[bool, int, int], ca.Function] = field(default_factory=dict, repr=False, compare=False)

    def evaluate(self, name: str, unknowns: np.ndarray, data: Data, *further: np.ndarray) -> list[np.ndarray]:
        """Evaluate at ξ and data, with a further argument for Functions of `build` that take one.

        By stages, embed, evaluate pointwise and integrate, are evaluated

        - action : -> S
        - gradient : -> ∇S by ξ
        - derivatives : -> ∇S; ∇²S is left in `algebra.matrix`
        - judged : -> S, momenta at the joints, ∇S, and what `Algebra.judge` gives with the soft direction of the last
          step; ∇²S is left as well
        """
        if name in STAGED:
            with self.algebra.lock:
                self._chain(name)(unknowns, data)
                return [self.algebra.workspace.arrays[key].copy() for key in STAGED[name][2]]
        if name not in self._evaluators:
            self._evaluators[name] = Evaluator(self.build(name))
        return self._evaluators[name](unknowns, *data, *further)

    def _chain(self, name: str) -> Chain:
        if name not in self._chains:
            workspace, (points, following, _) = self.algebra.workspace, STAGED[name]
            points = "derivatives" if self.once else points
            if points not in self._evaluators:
                self._evaluators[points] = workspace.stage(self.mapped(points))
            stages: dict[str, Callable[[], Evaluator]] = {
                "sum": workspace.sum,
                "integrate": workspace.integrate,
                "vary": workspace.vary,
                "assemble": partial(workspace.assemble, self.blocks),
                "step": self.algebra.step,
                "search": self.algebra.search,
                "judge": self.algebra.judge,
            }
            self._chains[name] = Chain(workspace, self._evaluators[points], [stages[key]() for key in following])
        return self._chains[name]

    def iterate(self, unknowns: np.ndarray, data: Data) -> tuple[np.ndarray, np.ndarray, float]:
        """The Newton step, what the unknowns are measured by, and the largest step relative to that.

        The step is found as by `solve`; its norm is NaN where the Hessian is singular to the last digit, or the
        gradient not finite.  ∇²S is left.
        """
        with self.algebra.lock:
            step, sizes, norm = self._found("newton", "derivatives", "step", unknowns, data)
            return step.copy(), sizes.copy(), norm.item()

    def search(
        self, unknowns: np.ndarray, data: Data, step: np.ndarray, sizes: np.ndarray, damping: float
    ) -> tuple[np.ndarray, float, float]:
        """The step that follows a damped part of `step` with the same matrix, and the measures of `Algebra.search`.

        They are NaN where the gradient is not finite, or the Hessian is singular to the last digit.
        """
        with self.algebra.lock:
            self.algebra.search()
            arrays = self.algebra.workspace.arrays
            arrays["whole"][:], arrays["measured_by"][:], arrays["damping"][:] = step, sizes, damping
            simplified, length, bend = self._found("search", "gradient", "search", unknowns, data)
            return simplified.copy(), length.item(), bend.item()

    def _found(self, name: str, without: str, stage: str, unknowns: np.ndarray, data: Data) -> list[np.ndarray]:
        """Results of a chain that ends with a stage by LDLᵀ, or after the one `without` it by QR where that fails."""
        arrays = self.algebra.workspace.arrays
        self._chain(name if self.pivots else without)(unknowns, data)
        if not (self.pivots and arrays["excess"].item() <= 0):
            self.algebra.by_qr(stage)
        return [arrays[key] for key in STAGED[name][2]]

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
