"""CasADi Functions called on NumPy arrays without conversion, on one thread, and safely from several.

From some 250,000 multiplications on, OpenBLAS computes a product on all cores.  The products of a Newton iteration are
small: two cores were no faster and took twice the processor time, and beside another busy pool of threads, such as
SciPy's, a solve took 22 ms instead of 3.  So a solve uses one thread, and restores the number for other users after it.

CasADi releases Python's global lock, admits one thread at a time to IPOPT, and takes short locks whenever an expression
or a Function is made, evaluated or deleted.  If a process is forked while another thread holds such a lock, the lock
stays taken in the child: during first solves 2 of 60 forked children hung.  So a fork waits for the solves of other
threads, for the graphs that are built, and for evaluations.  It does not wait for problems to be stated, nor for
deletions outside of solves.
"""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Generic, TextIO, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

Lent = TypeVar("Lent")
LIBRARY = "libcasadi-tp-openblas.so.0"  # on Linux; where it is not found, nothing is changed


def _functions() -> tuple[Callable[[], int], Callable[[int], object]]:
    path = Path(ca.__file__).parent / LIBRARY
    if not path.exists():
        return lambda: 1, lambda _: None
    library = ctypes.PyDLL(str(path))  # loaded already; PyDLL keeps the global lock, so no fork happens within a call
    return library.openblas_get_num_threads, library.openblas_set_num_threads


thread_count, use_threads = _functions()


@contextmanager
def one_thread() -> Iterator[None]:
    """Let OpenBLAS use one thread; a nested block changes nothing."""
    several = thread_count()
    if several == 1:
        yield  # another thread may be solving, and will restore the number
        return
    try:
        use_threads(1)
        yield
    finally:
        use_threads(several)


fork_waits = threading.RLock()  # held by every solve, wherever a graph is built, and wherever buffers are evaluated
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=fork_waits.acquire, after_in_parent=fork_waits.release, after_in_child=fork_waits.release
    )


class ObjectPool(Generic[Lent]):
    """A pool of objects that calls write to: each call borrows an idle one, or a new one.

    It is returned after the call, except after an interrupt, which may have left it in an inconsistent state.

    Parameters
    ----------
    make : makes a new object
    """

    def __init__(self, make: Callable[[], Lent]) -> None:
        self._make, self._idle = make, list[Lent]()

    @contextmanager
    def lend(self) -> Iterator[Lent]:
        """Lend an object to a block."""
        try:
            lent = self._idle.pop()
        except IndexError:  # none was made yet, or all are lent to other threads
            lent = self._make()
        try:
            yield lent
        except SystemError:  # an interrupt within CasADi's own code
            raise
        except Exception:  # a failed solve; KeyboardInterrupt is not an Exception
            self._idle.append(lent)
            raise
        self._idle.append(lent)


@contextmanager
def interrupts_raised() -> Iterator[None]:
    """Raise the KeyboardInterrupt that CasADi has turned into another error."""
    try:
        yield
    except SystemError as error:  # of IPOPT, and of arrays
        raise error.__cause__ or error from None
    except RuntimeError as error:  # of fatrop, and of the rootfinder among words of its own
        if "KeyboardInterrupt" in str(error):
            raise KeyboardInterrupt from None
        raise


class WithoutCasadi:
    """A stream that leaves out CasADi's warnings, which come in pieces from "CasADi - " to the end of the line.

    What they warn of, such as a zero pivot, is seen in the numbers that come back; what others write is passed on.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self._stream, self._within = stream, False

    def write(self, text: str) -> int:
        """Pass on what is not CasADi's."""
        self._within = self._within or text.startswith("CasADi - ")
        if not self._within and self._stream is not None:
            self._stream.write(text)
        self._within = self._within and not text.endswith("\n")
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class Evaluator:
    """Calls a Function on NumPy arrays: nonzeros in, nonzeros out.

    Parameters
    ----------
    function : Function
    bound : arrays by name that inputs and outputs are read from and written to; these are neither passed nor returned

    Attributes
    ----------
    inputs, outputs : arrays of the other inputs and outputs, by name
    failure : why the last evaluation failed, as where a rootfinder within L has found nothing; its results are then NaN
    """

    def __init__(self, function: ca.Function, bound: Mapping[str, np.ndarray] | None = None) -> None:
        self._function = function  # the buffer does not hold a reference to it
        self._buffer, self._run = function.buffer()
        self.failure: RuntimeError | None = None
        given = bound or {}
        arguments = {
            name: given[name] if name in given else np.zeros(function.nnz_in(i))
            for i, name in enumerate(function.name_in())
        }
        results = {
            name: given[name] if name in given else np.zeros(function.nnz_out(i))
            for i, name in enumerate(function.name_out())
        }
        self._results = list(results.values())
        self.inputs, self.outputs = (
            {name: array for name, array in arrays.items() if name not in given} for arrays in (arguments, results)
        )
        for i, array in enumerate(arguments.values()):
            self._buffer.set_arg(i, array.data)
        for i, array in enumerate(self._results):
            self._buffer.set_res(i, array.data)

    def run(self) -> None:
        """Evaluate on all arrays, without a check whether the evaluation was aborted."""
        self.failure = None
        with fork_waits:  # one thread at a time, so that each restores the stream that it found
            stderr = sys.stderr
            try:
                sys.stderr = WithoutCasadi(stderr)
                self._run()
            except RuntimeError as error:
                if "KeyboardInterrupt" in str(error):
                    raise
                self.failure = error
                for array in self._results:
                    array[:] = np.nan
            finally:
                sys.stderr = stderr

    def __call__(self, *arguments: ArrayLike) -> list[np.ndarray]:
        """Evaluate; the returned arrays are copies."""
        for target, argument in zip(self.inputs.values(), arguments, strict=True):
            target[:] = argument
        with one_thread(), interrupts_raised():
            self.run()
        if self._buffer.ret():  # aborted, as by CasADi's QR at a small pivot: the outputs are those of an earlier call
            for array in self.outputs.values():
                array[:] = np.nan
        return [array.copy() for array in self.outputs.values()]

    @property
    def stats(self) -> dict[str, Any]:
        """CasADi's statistics of the last call, which must not have failed."""
        if self.failure is not None:
            raise self.failure
        return self._buffer.stats()
