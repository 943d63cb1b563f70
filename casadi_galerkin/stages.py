"""Functions called on NumPy arrays without conversion, one after the other: embed, evaluate pointwise, integrate.

A call of a CasADi Function from Python costs about as much as evaluating a small problem, and joining Functions into
one graph costs as much as twenty.  So the Newton iteration calls them one by one through buffers, and what one of
them writes is where the next one reads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin import threads
from casadi_galerkin.layout import Data, Layout, clock
from casadi_galerkin.operators import assembly, boundary_terms, embedding, integration, summation


class Evaluator:
    """Calls a Function on NumPy arrays: nonzeros in, nonzeros out.

    Parameters
    ----------
    function : Function
    bound : arrays for inputs and outputs by name; what is bound is neither passed nor returned

    Attributes
    ----------
    inputs, outputs : arrays of what is not bound
    run : evaluates from and to all arrays, without a look at whether it was aborted
    """

    def __init__(self, function: ca.Function, bound: Mapping[str, np.ndarray] | None = None) -> None:
        self._function = function  # the buffer does not keep it alive
        self._buffer, self.run = function.buffer()
        names = (function.name_in(), function.name_out())
        sizes = (function.nnz_in, function.nnz_out)
        own: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
        for side, bind in enumerate((self._buffer.set_arg, self._buffer.set_res)):
            for i, name in enumerate(names[side]):
                array: Any = None if bound is None else bound.get(name)
                if array is None:
                    array = np.zeros(sizes[side](i))
                    own[side].append(array)
                bind(i, memoryview(array))
        self.inputs, self.outputs = own

    def __call__(self, *arguments: np.ndarray) -> list[np.ndarray]:
        """Evaluate; the returned arrays are copies."""
        for target, argument in zip(self.inputs, arguments, strict=True):
            target[:] = argument
        self.run()
        if self._buffer.ret():  # aborted, as CasADi's QR does on a small pivot: the arrays hold an earlier answer
            return [np.full_like(array, np.nan) for array in self.outputs]
        return [array.copy() for array in self.outputs]


@dataclass(frozen=True)
class Call:
    """A stage that is no CasADi Function.

    Attributes
    ----------
    run : evaluates from and to arrays
    inputs : those that are not shared: parameters p, or nothing
    """

    run: Callable[[], None]
    inputs: list[np.ndarray]


Stage = Evaluator | Call


class Workspace:
    """The arrays of one layout that stages hand on by name, for all Lagrangians; one thread at a time.

    Parameters
    ----------
    layout : Layout
    colind, row : pattern of the second-derivative blocks, as for `assembly`
    """

    def __init__(self, layout: Layout, colind: tuple[int, ...], row: tuple[int, ...]) -> None:
        self._layout, self._pattern = layout, (colind, row)
        self.arrays = {name: np.zeros(layout.points) for name in ("t", "h")}
        self._u, self._joints = self.array("u", layout.size), self.array("mesh", layout.intervals + 1)
        self._data: Data | None = None
        self._mesh = b""
        self._kept: dict[object, Evaluator] = {}

    def array(self, name: str, size: int) -> np.ndarray:
        """The array of a name, made when it is first asked for."""
        return self.arrays.setdefault(name, np.zeros(size))

    def place(self, unknowns: np.ndarray, data: Data) -> None:
        """Put u, the joints, and times and steps at the points in place: arrays u, mesh, t and h."""
        self._u[: self._layout.free] = unknowns
        if data is not self._data:  # the same tuple in all iterations
            self._data = data
            np.concatenate(data[:2], out=self._u[self._layout.free :])
            mesh = data[2].tobytes()  # compared in a tenth of the time that array_equal takes
            if mesh != self._mesh:
                self._mesh, self._joints[:] = mesh, data[2]
                self.arrays["t"][:], self.arrays["h"][:] = clock(self._layout, data[2])

    def stage(self, function: ca.Function) -> Evaluator:
        """Bind inputs and outputs of a Function to the arrays of their names, but parameters p, which are passed."""
        for names, size in ((function.name_in(), function.nnz_in), (function.name_out(), function.nnz_out)):
            for i, name in enumerate(names):
                if name != "p":
                    self.array(name, size(i))
        return Evaluator(function, self.arrays)

    def keep(self, key: object, build: Callable[[], ca.Function]) -> Evaluator:
        """Build and bind a stage when it is first asked for."""
        if key not in self._kept:
            self._kept[key] = self.stage(build())
        return self._kept[key]

    def embed(self) -> Evaluator:
        """Vector u -> (x, slope)."""
        return self.keep("embed", lambda: embedding(self._layout))

    def integrate(self) -> Evaluator:
        """(fx, fv) -> gradient."""
        return self.keep("integrate", lambda: integration(self._layout))

    def sum(self) -> Evaluator:
        """Values f -> action."""
        return self.keep("sum", lambda: summation(self._layout))

    def vary(self) -> Evaluator:
        """(fx, fv) -> (momentum, terms)."""
        return self.keep("vary", lambda: boundary_terms(self._layout))

    def assemble(self, blocks: tuple[tuple[int, int], ...]) -> Evaluator:
        """(block00, ...) -> matrix."""
        return self.keep(blocks, lambda: assembly(self._layout, *self._pattern, blocks))


class Chain:
    """Stages one after the other: from ξ and (start, end, mesh[, p]) to arrays of the workspace.

    Parameters
    ----------
    workspace : Workspace
    stages : such as embed, evaluate pointwise, integrate
    results : names of arrays
    """

    def __init__(self, workspace: Workspace, stages: Sequence[Stage], results: Sequence[str]) -> None:
        self._stages, self._place = stages, workspace.place
        self._runs = [stage.run for stage in stages]
        self._parameters = [array for stage in stages for array in stage.inputs]
        self._results = [workspace.arrays[name] for name in results]

    def __call__(self, unknowns: np.ndarray, data: Data) -> list[np.ndarray]:
        """Evaluate; the results are the arrays themselves, which the next evaluation writes to."""
        self._place(unknowns, data)
        for array in self._parameters:
            array[:] = data[3]
        threads.alone(self._run)
        return self._results

    def _run(self) -> None:
        for run in self._runs:
            run()
