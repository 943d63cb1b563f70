"""The linear algebra of Newton's method: what depends on the Hessian's sparsity, but not on L.

It is CasADi's, called on NumPy arrays.  The Hessian is never copied: at degree 30 that would take longer than all that
is done in Python.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from functools import cached_property, lru_cache, partial

import casadi as ca
import numpy as np

from casadi_galerkin.layout import LAYOUTS_KEPT, Layout
from casadi_galerkin.operators import hessian_pattern
from casadi_galerkin.precision import EPS, TINY, ZERO
from casadi_galerkin.stages import Evaluator, Workspace

LOCAL = 1e-3  # part of a right-hand side that a solution may miss; below such a step, no line search is needed
FOUND = {"step": ("step", "norm"), "search": ("simplified", "length", "bend")}  # steps of stages, and their measures
METHODS = "ldl", "qr"  # LDLᵀ without pivoting, measured 4 times faster than QR, which is for where it fails


class Algebra:
    """Solutions with ∇²S, the sizes that unknowns are measured by, and the roundoff floors of ∇S.

    It is kept for all Lagrangians of a layout, with u, the gradient and the Hessian as `System.evaluate` left them in
    its workspace, so whoever works with it holds `lock`.

    Parameters
    ----------
    layout : Layout
    colind, row : pattern of the second-derivative blocks, as for `hessian_pattern`

    Attributes
    ----------
    gradient, matrix : ∇S, nonzeros of ∇²S
    """

    def __init__(self, layout: Layout, colind: tuple[int, ...], row: tuple[int, ...]) -> None:
        self.layout, self.pattern = layout, hessian_pattern(layout, colind, row)
        self.workspace = Workspace(layout, colind, row)
        self.matrix = self.workspace.arrays["matrix"] = np.zeros(self.pattern.sparsity.nnz())
        self.gradient = self.workspace.array("gradient", layout.free)
        self._probe = self.workspace.arrays["probe"] = np.cos(1.0 + np.arange(layout.free))
        self.lock = threading.RLock()
        self._evaluators: dict[object, Evaluator] = {}

    def _symbols(self, *names: str) -> dict[str, ca.MX]:
        """The Hessian, the vector u, or one value an unknown."""
        shapes = {"matrix": (self.pattern.sparsity,), "u": (self.layout.size,), "values": (self.layout.size,)}
        return {name: ca.MX.sym(name, *shapes.get(name, (self.layout.free,))) for name in names}

    def _evaluator(self, key: object, build: Callable[[], ca.Function]) -> Evaluator:
        """A Function, built when first needed, that takes all but the Hessian as arguments."""
        if key not in self._evaluators:
            self._evaluators[key] = Evaluator(build(), {"matrix": self.matrix})
        return self._evaluators[key]

    def _function(self, name: str, inputs: dict[str, ca.MX], outputs: dict[str, ca.MX]) -> ca.Function:
        return ca.Function(name, list(inputs.values()), list(outputs.values()), list(inputs), list(outputs))

    @cached_property
    def factors(self) -> ca.Linsol:
        """LDLᵀ without pivoting, its symbolic part done once."""
        return ca.Linsol("ldl", "ldl", self.pattern.sparsity)

    def _solution(self, name: str, matrix: ca.MX, rhs: ca.MX) -> ca.MX:
        """Solution of ∇²S Y = -B."""
        return -(self.factors.solve(matrix, rhs) if name == "ldl" else ca.solve(matrix, rhs, name))

    def _excess(self, matrix: ca.MX, y: ca.MX, rhs: ca.MX) -> ca.MX:
        """Excess of the defect of a solution over a small part of the right-hand side."""
        return ca.norm_1(ca.vec(ca.mac(matrix, y, rhs))) - LOCAL * ca.norm_1(ca.vec(rhs))  # sums keep a NaN

    def _solutions(self, name: str, columns: int) -> ca.Function:
        inputs = self._symbols("matrix") | {"rhs": ca.MX.sym("rhs", self.layout.free, columns)}
        matrix, rhs = inputs.values()
        y = self._solution(name, matrix, rhs)
        return self._function("solutions", inputs, {"y": y, "excess": self._excess(matrix, y, rhs)})

    def solve(self, *rhs: np.ndarray, pivots: bool = True) -> list[np.ndarray]:
        """Solutions of ∇²S y = -b for right-hand sides b: by LDLᵀ, then by QR where that fails.

        They are not finite where the Hessian is singular to the last digit.  Without `pivots`, LDLᵀ is not tried.
        """
        flat = np.concatenate(rhs)
        for name in METHODS if pivots else METHODS[1:]:
            columns = len(rhs)
            y, excess = self._evaluator((name, columns), partial(self._solutions, name, columns))(flat)
            if excess[0] <= 0:
                break
        else:
            if not np.any(y):  # CasADi's QR answers a rank-deficient system with zeros
                y[:] = np.nan
        return list(y.reshape(len(rhs), -1))

    def _step(self, name: str) -> ca.Function:
        inputs = self._symbols("matrix", "gradient", "u", "probe")
        matrix, gradient, u, probe = inputs.values()
        scale = self.largest(u)
        leaning = probe / self._measure(scale)
        step, soft = ca.horzsplit(self._solution(name, matrix, ca.horzcat(gradient, leaning)))
        outputs = {"step": step, "soft": soft, **self._measures(scale, step)}
        return self._function("step", inputs, outputs | {"excess": self._excess(matrix, step, gradient)})

    def _search(self, name: str) -> ca.Function:
        inputs = self._symbols("matrix", "gradient", "whole", "measured_by") | {"damping": ca.MX.sym("damping")}
        matrix, gradient, *others = inputs.values()
        y = self._solution(name, matrix, gradient)
        outputs = {"simplified": y, **self._comparison(y, *others)}
        return self._function("search", inputs, outputs | {"excess": self._excess(matrix, y, gradient)})

    def _measures(self, scale: ca.MX, step: ca.MX) -> dict[str, ca.MX]:
        """What the unknowns are measured by with a step, and the largest step relative to that."""
        whole = ca.vertcat(step, ca.MX.zeros(self.layout.size - self.layout.free))
        sizes = self._measure(ca.fmax(scale, self.largest(whole)))
        return {"sizes": sizes, "norm": ca.norm_inf(step / sizes)}

    def _comparison(self, y: ca.MX, whole: ca.MX, measured_by: ca.MX, damping: ca.MX) -> dict[str, ca.MX]:
        """Length of a step that follows a damped part of a whole one, and how far it is from the rest of that."""
        bend = ca.norm_inf((y - (1 - damping) * whole) / measured_by)
        return {"length": ca.norm_inf(y / measured_by), "bend": bend}

    def step(self, name: str = "ldl") -> Evaluator:
        """(matrix, gradient, u) -> (step, soft, sizes, norm, excess).

        The Newton step, the solution for the right-hand side of `probe`, which leans to the softest direction, what the
        unknowns are measured by, the largest step relative to that, and the excess of its defect.
        """
        return self.workspace.keep(("step", name), partial(self._step, name))

    def search(self, name: str = "ldl") -> Evaluator:
        """(matrix, gradient, whole, measured_by, damping) -> (simplified, length, bend, excess).

        The step that follows a damped part of a whole one with the same matrix, its length, how far it is from the rest
        of the whole step, both as the largest relative to `measured_by`, and the excess of the defect.
        """
        return self.workspace.keep(("search", name), partial(self._search, name))

    def lean(self) -> Evaluator:
        """(u, probe) -> leaning: a right-hand side in the units of ∇S whose solution leans to the softest direction."""

        def build() -> ca.Function:
            inputs = self._symbols("u", "probe")
            leaning = inputs["probe"] / self._measure(self.largest(inputs["u"]))
            return self._function("lean", inputs, {"leaning": leaning})

        return self.workspace.keep("lean", build)

    def measured(self) -> Evaluator:
        """(u, step) -> (sizes, norm), as of `step`."""

        def build() -> ca.Function:
            inputs = self._symbols("u", "step")
            return self._function("measured", inputs, self._measures(self.largest(inputs["u"]), inputs["step"]))

        return self.workspace.keep("measured", build)

    def compared(self) -> Evaluator:
        """(simplified, whole, measured_by, damping) -> (length, bend), as of `search`."""

        def build() -> ca.Function:
            inputs = self._symbols("simplified", "whole", "measured_by") | {"damping": ca.MX.sym("damping")}
            return self._function("compared", inputs, self._comparison(*inputs.values()))

        return self.workspace.keep("compared", build)

    def by_qr(self, stage: str) -> None:
        """Repeat the stage "step" or "search" by QR; its measures become NaN where there is no step."""
        solver = {"step": self.step, "search": self.search}[stage]("qr")
        step, *measures = (self.workspace.arrays[name] for name in FOUND[stage])
        excess = self.workspace.arrays["excess"]
        for array in (*measures, excess):
            array[:] = np.nan  # what stays where CasADi's QR gives up
        if np.isfinite(self.gradient).all():
            solver.run()
        if not (excess[0] <= 0 or (math.isfinite(excess[0]) and np.any(step))):
            for array in measures:
                array[:] = np.nan

    @cached_property
    def largest(self) -> ca.Function:
        """Largest size of each component along a path, from its vector u; (d,)."""
        inputs = self._symbols("values")
        numbering = self.layout.numbering[: self.layout.size // self.layout.dimension]
        values = ca.reshape(inputs["values"].get_nz(False, numbering.T.ravel().tolist()), numbering.shape)
        return self._function("largest", inputs, {"scale": ca.vertcat(*map(ca.norm_inf, ca.horzsplit(values)))})

    def _expanded(self, scale: ca.MX) -> ca.MX:
        """One value a component -> one an unknown."""
        return ca.vec(scale.get_nz(False, self.layout.component[: self.layout.free].tolist()))

    def _measure(self, scale: ca.MX) -> ca.MX:
        """What each unknown is measured by: the size of its component, one for zero."""
        return self._expanded(ca.if_else(scale < ZERO, 1.0, scale))

    def sizes(self, u: np.ndarray) -> np.ndarray:
        """What each unknown is measured by: the size of its component in the path, one for zero."""

        def build() -> ca.Function:
            inputs = self._symbols("u")
            return self._function("sizes", inputs, {"sizes": self._measure(self.largest(inputs["u"]))})

        return self._evaluator("sizes", build)(u)[0]

    def probe(self, u: np.ndarray) -> np.ndarray:
        """A right-hand side without symmetry, in the units of ∇S: its solution leans to the softest direction."""
        return np.asarray(self._probe / self.sizes(u))

    def spread(self, change: np.ndarray) -> np.ndarray:
        """|∇²S||y|, the largest change of the gradient for a change of these sizes."""
        return self._evaluator("spread", self._spread)(change)[0]

    def _spread(self) -> ca.Function:
        inputs = self._symbols("matrix", "change")
        return self._function("spread", inputs, {"spread": ca.mtimes(*map(ca.fabs, inputs.values()))})

    @cached_property
    def floor(self) -> ca.Function:
        """(∇²S, u, sizes of the terms of ∇S) -> roundoff floor of ∇S: eps times those and |∇²S||ξ|; |ξ|; |∇²S||ξ|.

        |ξ| stands for the size of each unknown's component along the path: the rounding of ξ itself counts.  One that
        counts as zero is measured by `ZERO`: relative to itself, what is left of it never is at roundoff.
        """
        inputs = self._symbols("matrix", "u", "terms")
        matrix, u, terms = inputs.values()
        scale = ca.fmax(self._expanded(self.largest(u)), ZERO)
        spread = ca.mtimes(ca.fabs(matrix), scale)
        outputs = {"floor": EPS * (terms + spread) + TINY, "scale": scale, "spread": spread}
        return self._function("floor", inputs, outputs)

    def judge(self) -> Evaluator:
        """(gradient, matrix, u, terms, soft) -> (floor, residual, regularity).

        The roundoff floor of ∇S, its largest entry over that, and yᵀ∇²S y for y = `soft` over a bound of |y|ᵀ|∇²S||y|.
        Zero or NaN tells nothing of that: a component's only unknown has but one term in the Hessian, which cannot tell
        whether it is small.
        """
        return self.workspace.keep("judge", self._judge)

    def _judge(self) -> ca.Function:
        inputs = self._symbols("gradient", "matrix", "u", "terms", "soft")
        gradient, matrix, u, terms, y = inputs.values()
        floor, scale, spread = self.floor(matrix, u, terms)
        ratios = gradient / floor
        residual = ca.norm_inf(ratios) + 0 * ca.sum1(ratios)  # sums keep a NaN
        y = y / ca.norm_inf(y / scale)
        quotient = ca.fabs(ca.bilin(matrix, y, y)) / ca.dot(scale, spread)
        comparable = ca.mmin(scale) > ZERO if self.layout.free > self.layout.dimension else ca.MX(0)
        outputs = {"floor": floor, "residual": residual, "regularity": ca.if_else(comparable, quotient, 0)}
        return self._function("judge", inputs, outputs)


@lru_cache(LAYOUTS_KEPT)
def algebra(layout: Layout, colind: tuple[int, ...], row: tuple[int, ...]) -> Algebra:
    """The linear algebra for all Lagrangians whose Hessian has this sparsity; arguments as for `Algebra`."""
    return Algebra(layout, colind, row)
