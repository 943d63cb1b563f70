"""CasADi Functions called on NumPy arrays without conversion, on one thread."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.functional.threads import fork_waits, one_thread

Lent = TypeVar("Lent")


class ObjectPool(Generic[Lent]):
    """A pool of objects that calls write to: each call gets an idle one, or a new one.

    It goes back after the call, but not after an interrupt, which may have left it half written.

    Parameters
    ----------
    make : makes a new one
    """

    def __init__(self, make: Callable[[], Lent]) -> None:
        self._make, self._idle = make, list[Lent]()

    @contextmanager
    def lend(self) -> Iterator[Lent]:
        """Lend one to a block."""
        try:
            lent = self._idle.pop()
        except IndexError:  # none yet, or all lent to other threads
            lent = self._make()
        try:
            yield lent
        except SystemError:  # what an interrupt becomes that meets CasADi's own code
            raise
        except Exception:  # a failed solve; an interrupt is none
            self._idle.append(lent)
            raise
        self._idle.append(lent)


class Evaluator:
    """Calls a Function on NumPy arrays: nonzeros in, nonzeros out.

    Parameters
    ----------
    function : Function
    bound : arrays for inputs and outputs by name; what is bound is neither passed nor returned

    Attributes
    ----------
    inputs, outputs : arrays of what is not bound, by name
    """

    def __init__(self, function: ca.Function, bound: Mapping[str, np.ndarray] | None = None) -> None:
        self._function = function  # the buffer does not keep it alive
        self._buffer, self._run = function.buffer()
        self.inputs, self.outputs = dict[str, np.ndarray](), dict[str, np.ndarray]()
        for names, own, size, bind in (
            (function.name_in(), self.inputs, function.nnz_in, self._buffer.set_arg),
            (function.name_out(), self.outputs, function.nnz_out, self._buffer.set_res),
        ):
            for i, name in enumerate(names):
                array: Any = bound.get(name) if bound else None
                if array is None:
                    array = own[name] = np.zeros(size(i))
                bind(i, memoryview(array))

    def run(self) -> None:
        """Evaluate from and to all arrays, without a look at whether it was aborted."""
        with fork_waits:
            self._run()

    def __call__(self, *arguments: ArrayLike) -> list[np.ndarray]:
        """Evaluate; the returned arrays are copies."""
        for target, argument in zip(self.inputs.values(), arguments, strict=True):
            target[:] = argument
        with one_thread():
            try:
                self.run()
            except SystemError as error:  # an interrupt that IPOPT was stopped by
                raise error.__cause__ or error from None
            except RuntimeError as error:  # and fatrop
                raise KeyboardInterrupt if str(error) == "KeyboardInterrupt" else error from None
        if self._buffer.ret():  # aborted, as CasADi's QR does on a small pivot: the arrays hold an earlier answer
            for array in self.outputs.values():
                array[:] = np.nan
        return [array.copy() for array in self.outputs.values()]

    @property
    def stats(self) -> dict[str, Any]:
        """What CasADi tells of the last call."""
        return dict(self._buffer.stats())
