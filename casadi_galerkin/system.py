"""The stationarity conditions ∇S(ξ) = 0 of one transcription, evaluated on NumPy arrays without conversion.

A call of a CasADi Function from Python costs about as much as evaluating a small problem.  So Functions are called
through buffers (`Evaluator`), what Newton's method does between two evaluations is bundled into few of them
(`Algebra`), and the Hessian is never copied.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.operators import LAYOUTS_KEPT, Layout, assembly

EPS = float(np.finfo(float).eps)
ROUNDOFF = 50.0  # accepted residual over its roundoff floor; correct solutions were measured at 0.01 to 5
LOCAL = 1e-3  # below this relative step, Newton's method needs no line search
SINGULAR = 1e-12  # second variation over the sum of its terms below which the Hessian is called singular

Data = tuple[np.ndarray, ...]


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
    """Newton's method between two evaluations: what depends on the Hessian's sparsity and the scale, but not on L.

    It is kept for all Lagrangians of a layout, with the Hessian in `matrix` as `System.derivatives` left it there, so
    whoever works with it holds `lock`.  The steps of an iteration are bundled into few Functions, since a call from
    Python costs about as much as evaluating a small problem.  Those that solve with ∇²S are built for a linear
    solver, "ldl" or "qr"; their first output is the solution, the last one the excess of the defect over a small
    part of the right-hand side.

    Parameters
    ----------
    sparsity : of ∇²S
    component : int array, the component of the path that each unknown is a value of
    scale : (ξ, start, end) -> largest size of each component along the path
    """

    def __init__(self, sparsity: ca.Sparsity, component: np.ndarray, scale: ca.Function) -> None:
        self.component, self.scale = component, scale
        self._ends = [ca.MX.sym(scale.name_in(i), scale.size1_in(i)) for i in range(3)]
        self._matrix, self._damping = ca.MX.sym("matrix", sparsity), ca.MX.sym("damping")
        self._vectors = [ca.MX.sym(f"vector{i}", sparsity.size1()) for i in range(4)]
        self.matrix, self.lock = np.zeros(sparsity.nnz()), threading.Lock()
        self._evaluators: dict[tuple[str, str | None], Evaluator] = {}

    def evaluate(self, name: str, solver: str | None, *arguments: np.ndarray) -> list[np.ndarray]:
        """Evaluate the Function of that name, built when it is first asked for."""
        evaluator = self._evaluators.get((name, solver))
        if evaluator is None:
            inputs, outputs = getattr(self, name)(*([solver] if solver else []))
            names = ["matrix" if symbol is self._matrix else f"input{i}" for i, symbol in enumerate(inputs)]
            function = ca.Function(name, inputs, outputs, names, [f"output{i}" for i in range(len(outputs))])
            evaluator = self._evaluators[name, solver] = Evaluator(function, self.matrix)
        return evaluator(*arguments)

    @cached_property
    def factors(self) -> ca.Linsol:
        """LDLᵀ without pivoting, its symbolic part done once.  Measured 4 times faster than QR."""
        return ca.Linsol("ldl", "ldl", self._matrix.sparsity())

    def _solve(self, solver: str, rhs: ca.MX) -> list[ca.MX]:
        """Solution of ∇²S y = -rhs, and the excess of its defect; a sum of sizes does not lose a NaN."""
        matrix = self._matrix
        y = -(self.factors.solve(matrix, rhs) if solver == "ldl" else ca.solve(matrix, rhs, solver))
        return [y, ca.norm_1(ca.mac(matrix, y, rhs)) - LOCAL * ca.norm_1(rhs)]

    def _expand(self, values: ca.MX) -> ca.MX:
        """One value a component -> one an unknown."""
        return ca.vec(values.get_nz(False, self.component.tolist()))

    def direction(self, solver: str) -> tuple[list[ca.MX], list[ca.MX]]:
        """(∇²S, g) -> step -∇²S⁻¹ g."""
        return [self._matrix, self._vectors[0]], self._solve(solver, self._vectors[0])

    def descent(self, solver: str) -> tuple[list[ca.MX], list[ca.MX]]:
        """(∇²S, g, ξ, start, end) -> Newton step, the sizes that it is measured by, its norm."""
        step, excess = self._solve(solver, self._vectors[0])
        change = self.scale(step, *(ca.MX.zeros(a.shape) for a in self._ends[1:]))
        largest = ca.fmax(self.scale(*self._ends), change)
        sizes = self._expand(largest + (largest == 0))
        inputs = [self._matrix, self._vectors[0], *self._ends]
        return inputs, [step, sizes, ca.norm_inf(step / sizes), excess]

    def trial(self, solver: str) -> tuple[list[ca.MX], list[ca.MX]]:
        """(∇²S, g, step, sizes, damping) -> next step with the same matrix, norms of it and of the path's bend."""
        g, step, sizes, _ = self._vectors
        y, excess = self._solve(solver, g)
        norms = [ca.norm_inf(y / sizes), ca.norm_inf((y - (1 - self._damping) * step) / sizes)]
        return [self._matrix, g, step, sizes, self._damping], [y, *norms, excess]

    def variation(self, solver: str) -> tuple[list[ca.MX], list[ca.MX]]:
        """(∇²S, ξ, start, end) -> direction after three inverse iterations."""
        scale, excess = self.scale(*self._ends), 0
        y = np.cos(1.0 + np.arange(len(self.component))) * self._expand(scale + (scale == 0))
        for _ in range(3):
            y, defect = self._solve(solver, y)
            y, excess = y / ca.norm_inf(y), ca.fmax(excess, defect) + 0 * defect  # the last term keeps a NaN
        return [self._matrix, *self._ends], [y, excess]

    def forecast(self) -> tuple[list[ca.MX], list[ca.MX]]:
        """(last step, the one simplified after it, step, sizes) -> factor on the damping (Deuflhard, eq. 3.47)."""
        last, simplified, step, sizes = self._vectors
        norms = [ca.norm_inf(y / sizes) for y in (last, simplified, simplified - step, step)]
        return self._vectors, [norms[0] * norms[1] / ca.fmax(norms[2] * norms[3], 1e-300)]

    def length(self) -> tuple[list[ca.MX], list[ca.MX]]:
        """(step, ξ, start, end) -> the step's norm relative to the path's size; not finite where the step is not."""
        step, scale = self._vectors[0], self.scale(*self._ends)
        relative = step / self._expand(scale + (scale == 0))
        return [step, *self._ends], [ca.norm_inf(relative) + 0 * ca.norm_1(step)]

    def ratios(self) -> tuple[list[ca.MX], list[ca.MX]]:
        """(∇²S, g, terms, ξ, start, end) -> residuals over their own roundoff floors."""
        g, terms, *_ = self._vectors
        spread = ca.mtimes(ca.fabs(self._matrix), self._expand(self.scale(*self._ends)))
        floor = ca.fmax(EPS * (terms + spread), float(np.finfo(float).tiny))
        return [self._matrix, g, terms, *self._ends], [ca.fabs(g) / floor]


@lru_cache(LAYOUTS_KEPT)
def algebra(
    layout: Layout, colind: tuple[int, ...], row: tuple[int, ...], blocks: tuple[tuple[int, int], ...]
) -> Algebra:
    """Newton's method for all Lagrangians whose Hessian has this sparsity; arguments as for `assembly`."""
    d, numbering = layout.dimension, layout.numbering
    component = np.zeros(layout.size, dtype=np.int64)
    component[numbering] = np.arange(d)
    by_component = numbering[: layout.size // d].T
    sizes = {"unknowns": layout.free, "start": len(layout.fixed_start), "end": len(layout.fixed_end)}
    ends = [ca.MX.sym(name, size) for name, size in sizes.items()]
    values = ca.MX.sym("values", by_component.shape[1])
    peak = ca.Function("peak", [values], [ca.norm_inf(values)]).map(d)
    paths = ca.reshape(ca.vertcat(*ends).get_nz(False, by_component.ravel().tolist()), -1, d)
    scale = ca.Function("scale", ends, [peak(paths).T], list(sizes), ["scale"])
    return Algebra(assembly(layout, colind, row, blocks).sparsity_out(0), component[: layout.free], scale)


@dataclass(frozen=True)
class System:
    """Stationarity conditions of a discrete action as CasADi Functions of (ξ, *data), data being (start, end, ...).

    Attributes
    ----------
    build : name -> Function; called when the Function is first needed, since building costs more than evaluating.
        The names are

        - action : -> S
        - gradient : -> ∇S by ξ
        - hessian : -> ∇²S by ξ, sparse and symmetric
        - derivatives : -> both; by `evaluate`, only ∇S is returned and ∇²S is left in `algebra.matrix`
        - terms : -> sizes of the terms that `gradient` sums
        - curvature : with a direction y as last input -> yᵀ∇²S y, and the same with every term positive
        - inertial : with a factor on ∂²L/∂v² as last input -> ∇²S, left in `algebra.matrix`
    algebra : Algebra
    pivots : whether LDLᵀ without pivoting can work: False where ∂²L/∂v_i² is structurally zero for some i
    """

    build: Callable[[str], ca.Function]
    algebra: Algebra
    pivots: bool = True
    _evaluators: dict[str, Evaluator] = field(default_factory=dict, repr=False, compare=False)
    _solvers: dict[tuple[bool, int, int], ca.Function] = field(default_factory=dict, repr=False, compare=False)

    def evaluate(self, name: str, *arguments: np.ndarray) -> list[np.ndarray]:
        """Evaluate one of the Functions by name on NumPy arrays."""
        if name not in self._evaluators:
            self._evaluators[name] = Evaluator(self.build(name), self.algebra.matrix)
        return self._evaluators[name](*arguments)

    def solved(self, name: str, *arguments: np.ndarray) -> list[np.ndarray]:
        """Evaluate one of the Functions that solve with ∇²S: by LDLᵀ, then by QR where that fails.

        The first output is not finite where the Hessian is singular to the last digit.
        """
        for solver in ("ldl", "qr") if self.pivots else ("qr",):
            results = self.algebra.evaluate(name, solver, *arguments)
            if results[-1][0] <= 0:
                return results
        if not np.any(results[0]):  # CasADi's QR answers a rank-deficient system with zeros
            results[0][:] = np.nan
        return results

    def ratios(self, gradient: np.ndarray, unknowns: np.ndarray, data: Data) -> np.ndarray:
        """Residuals over their own roundoff floors."""
        (terms,) = self.evaluate("terms", unknowns, *data)
        return self.algebra.evaluate("ratios", None, gradient, terms, unknowns, *data[:2])[0]


def second_variation(system: System, unknowns: np.ndarray, data: Data) -> float:
    """Smallest second variation relative to the sizes of its terms; 0 at a conjugate point.

    Three inverse iterations find the direction y, the pointwise sums give its quotient
    yᵀ∇²S y / Σ |z|ᵀ|∇²L̂||z|, which does not depend on scales or on the mesh.
    """
    if len(unknowns) == 0:
        return np.inf  # nothing can vary
    system.evaluate("derivatives", unknowns, *data)
    y = system.solved("variation", unknowns, *data[:2])[0]
    signed, positive = (float(value[0]) for value in system.evaluate("curvature", unknowns, *data, y))
    return abs(signed) / positive if math.isfinite(signed) and 0 < positive < math.inf else 0.0


def negative_eigenvalues(system: System, unknowns: np.ndarray, data: Data) -> int | None:
    """Morse index: number of negative eigenvalues of the Hessian, from the inertia of its LDLᵀ factors.

    None where the kinetic energy is indefinite by structure, such as v_0 v_1: the index then grows without bound
    as the mesh is refined, and LDLᵀ without pivoting does not find it.
    """
    if not system.pivots:
        return None
    if len(unknowns) == 0:
        return 0
    (matrix,) = system.build("hessian").call([unknowns, *data])
    system.algebra.factors.nfact(matrix)
    return int(system.algebra.factors.neig(matrix))
