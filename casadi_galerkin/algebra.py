"""The linear algebra of Newton's method on NumPy arrays: what depends on the Hessian's sparsity, but not on L.

The Hessian is never copied, at degree 30 that would take longer than all else that is done in Python, and only solving
with it is left to CasADi.
"""

from __future__ import annotations

import threading
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

from casadi_galerkin.calculus import ZERO
from casadi_galerkin.operators import LAYOUTS_KEPT, Layout, hessian_pattern
from casadi_galerkin.stages import Evaluator, Workspace

LOCAL = 1e-3  # part of a right-hand side that a solution may miss; below such a step, no line search is needed


class Algebra:
    """Solutions with ∇²S, and the sizes that unknowns are measured by.

    It is kept for all Lagrangians of a layout, with the Hessian in `matrix` as `System.evaluate` left it there, so
    whoever works with it holds `lock`.

    Parameters
    ----------
    layout : Layout
    colind, row : pattern of the second-derivative blocks, as for `hessian_pattern`
    """

    def __init__(self, layout: Layout, colind: tuple[int, ...], row: tuple[int, ...]) -> None:
        self.pattern, self.workspace = hessian_pattern(layout, colind, row), Workspace(layout, colind, row)
        numbering = layout.numbering[: layout.size // layout.dimension]
        self._by_component = np.ascontiguousarray(numbering.T)
        self.matrix = self.workspace.arrays["matrix"] = np.zeros(self.pattern.sparsity.nnz())
        self.lock = threading.RLock()
        self._component = layout.component[: layout.free]
        self._probe = np.cos(1.0 + np.arange(len(self._component)))
        self._solvers: dict[tuple[str, int], Evaluator] = {}

    @cached_property
    def factors(self) -> ca.Linsol:
        """LDLᵀ without pivoting, its symbolic part done once.  Measured 4 times faster than QR."""
        return ca.Linsol("ldl", "ldl", self.pattern.sparsity)

    def _solver(self, name: str, columns: int) -> Evaluator:
        """(∇²S, B) -> solution of ∇²S Y = -B, and the excess of its defect over a small part of B."""
        if (name, columns) not in self._solvers:
            matrix, rhs = ca.MX.sym("matrix", self.pattern.sparsity), ca.MX.sym("rhs", len(self._probe), columns)
            y = -(self.factors.solve(matrix, rhs) if name == "ldl" else ca.solve(matrix, rhs, name))
            excess = ca.norm_1(ca.vec(ca.mac(matrix, y, rhs))) - LOCAL * ca.norm_1(ca.vec(rhs))  # sums keep a NaN
            function = ca.Function("solve", [matrix, rhs], [y, excess], ["matrix", "rhs"], ["y", "excess"])
            self._solvers[name, columns] = Evaluator(function, {"matrix": self.matrix})
        return self._solvers[name, columns]

    def solve(self, *rhs: np.ndarray, pivots: bool = True) -> list[np.ndarray]:
        """Solutions of ∇²S y = -b for right-hand sides b: by LDLᵀ, then by QR where that fails.

        They are not finite where the Hessian is singular to the last digit.  Without `pivots`, LDLᵀ is not tried.
        """
        flat = np.concatenate(rhs)
        for name in ("ldl", "qr") if pivots else ("qr",):
            y, excess = self._solver(name, len(rhs))(flat)
            if excess[0] <= 0:
                break
        else:
            if not np.any(y):  # CasADi's QR answers a rank-deficient system with zeros
                y[:] = np.nan
        return list(y.reshape(len(rhs), -1))

    def scale(self, u: np.ndarray) -> np.ndarray:
        """Largest size of each component along the path, (d,)."""
        return np.asarray(np.abs(u)[self._by_component].max(axis=1))

    def expanded(self, scale: np.ndarray) -> np.ndarray:
        """One value a component -> one an unknown."""
        return np.asarray(scale[self._component])

    def sizes(self, u: np.ndarray, step: np.ndarray | None = None) -> np.ndarray:
        """What each unknown is measured by: the size of its component in the path (and in a step), one for zero."""
        largest = np.abs(u)
        if step is not None:
            np.maximum(largest[: len(step)], np.abs(step), out=largest[: len(step)])
        scale = self.scale(largest)
        scale[scale < ZERO] = 1.0
        return self.expanded(scale)

    def probe(self, u: np.ndarray) -> np.ndarray:
        """A right-hand side without symmetry, in the units of ∇S: its solution leans to the softest direction."""
        return np.asarray(self._probe / self.sizes(u))

    def spread(self, change: np.ndarray) -> np.ndarray:
        """|∇²S||y|, the largest change of the gradient for a change of these sizes."""
        terms = np.abs(self.matrix)
        terms *= np.abs(change)[self.pattern.rows]
        return np.asarray(np.add.reduceat(terms, self.pattern.starts[:-1])) if len(terms) else np.zeros(0)


@lru_cache(LAYOUTS_KEPT)
def algebra(layout: Layout, colind: tuple[int, ...], row: tuple[int, ...]) -> Algebra:
    """The linear algebra for all Lagrangians whose Hessian has this sparsity; arguments as for `Algebra`."""
    return Algebra(layout, colind, row)
