"""The linear algebra of Newton's method on NumPy arrays: what depends on the Hessian's sparsity, but not on L.

A call of a CasADi Function from Python costs about as much as evaluating a small problem.  So Functions are called
through buffers (`Evaluator`), the Hessian is never copied, and only solving with it is left to CasADi.
"""

from __future__ import annotations

import threading
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus import ZERO
from casadi_galerkin.operators import LAYOUTS_KEPT, Layout, Pattern, hessian_pattern

LOCAL = 1e-3  # part of a right-hand side that a solution may miss; below such a step, no line search is needed


class Evaluator:
    """Calls a Function on NumPy arrays without conversion: nonzeros in, nonzeros out.

    An input or output named "matrix" is bound to the array `matrix`, and neither passed nor returned: at degree 30
    copying the Hessian would take longer than all else that is done in Python.
    """

    def __init__(self, function: ca.Function, matrix: np.ndarray | None = None) -> None:
        self._function = function  # the buffer does not keep it alive
        self._buffer, self._run = function.buffer()
        shared: Any = np.zeros(0) if matrix is None else matrix
        inputs: dict[str, Any] = {function.name_in(i): np.zeros(function.nnz_in(i)) for i in range(function.n_in())}
        outputs: dict[str, Any] = {function.name_out(i): np.zeros(function.nnz_out(i)) for i in range(function.n_out())}
        for arrays, bind in ((inputs, self._buffer.set_arg), (outputs, self._buffer.set_res)):
            for i, (name, array) in enumerate(arrays.items()):
                bind(i, memoryview(shared if name == "matrix" else array))
        self._inputs = [array for name, array in inputs.items() if name != "matrix"]
        self._outputs = [array for name, array in outputs.items() if name != "matrix"]

    def __call__(self, *arguments: np.ndarray) -> list[np.ndarray]:
        """Evaluate; the returned arrays are copies."""
        for target, argument in zip(self._inputs, arguments, strict=True):
            target[:] = argument
        self._run()
        if self._buffer.ret():  # aborted, as CasADi's QR does on a small pivot: the arrays hold an earlier answer
            return [np.full_like(array, np.nan) for array in self._outputs]
        return [array.copy() for array in self._outputs]


class Algebra:
    """Solutions with ∇²S, and the sizes that unknowns are measured by.

    It is kept for all Lagrangians of a layout, with the Hessian in `matrix` as `System.derivatives` left it there, so
    whoever works with it holds `lock`.

    Parameters
    ----------
    pattern : Pattern of ∇²S
    numbering : (K, d), entries of u = (ξ, start, end) by component
    """

    def __init__(self, pattern: Pattern, numbering: np.ndarray) -> None:
        self.pattern, self._by_component = pattern, np.ascontiguousarray(numbering.T)
        self.matrix, self.lock = np.zeros(pattern.sparsity.nnz()), threading.RLock()
        component = np.zeros(numbering.size, dtype=np.int64)
        component[numbering] = np.arange(numbering.shape[1])
        self._component = component[: len(pattern.starts) - 1]
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
            self._solvers[name, columns] = Evaluator(function, self.matrix)
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
        return scale[self._component]

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
    """The linear algebra for all Lagrangians whose Hessian has this sparsity; arguments as for `hessian_pattern`."""
    return Algebra(hessian_pattern(layout, colind, row), layout.numbering[: layout.size // layout.dimension])
