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
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

LIBRARY = "libcasadi-tp-openblas.so.0"  # on Linux; where it is not found, nothing is changed


def _functions() -> tuple[Callable[[], int], Callable[[int], object]]:
    path = Path(ca.__file__).parent / LIBRARY
    if not path.exists():
        return lambda: 1, lambda _: None
    library = ctypes.PyDLL(str(path))  # loaded already; PyDLL keeps the global lock, so no fork happens within a call
    return library.openblas_get_num_threads, library.openblas_set_num_threads


thread_count, use_threads = _functions()


fork_waits = threading.RLock()  # held by every solve, wherever a graph is built, and wherever buffers are evaluated
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=fork_waits.acquire, after_in_parent=fork_waits.release, after_in_child=fork_waits.release
    )


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


@contextmanager
def evaluating() -> Iterator[None]:
    """Let this thread alone evaluate, on one core and without CasADi's warnings; a block within changes nothing."""
    with fork_waits:  # one thread at a time, so that each restores what it found
        several, stderr = thread_count(), sys.stderr
        try:
            use_threads(1)
            sys.stderr = stderr if isinstance(stderr, WithoutCasadi) else WithoutCasadi(stderr)
            yield
        finally:
            sys.stderr = stderr
            use_threads(several)


class Evaluator:
    """Calls a Function on NumPy arrays: nonzeros in, nonzeros out.

    Solves may share it, also after an interrupt: a call writes all inputs, and one thread at a time calls.

    Attributes
    ----------
    failure : why the last evaluation failed, as where a rootfinder within L has found nothing; its results are then NaN
    """

    def __init__(self, function: ca.Function) -> None:
        self._function = function  # the buffer does not hold a reference to it
        self._buffer, self._run = function.buffer()
        self.failure: RuntimeError | None = None
        self._inputs = [np.zeros(function.nnz_in(i)) for i in range(function.n_in())]
        self._outputs = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
        for i, array in enumerate(self._inputs):
            self._buffer.set_arg(i, array.data)
        for i, array in enumerate(self._outputs):
            self._buffer.set_res(i, array.data)

    def __call__(self, *arguments: ArrayLike) -> list[np.ndarray]:
        """Evaluate; the returned arrays are copies."""
        with evaluating(), interrupts_raised():
            return self.evaluated(*arguments)

    def evaluated(self, *arguments: ArrayLike) -> list[np.ndarray]:
        """The same within a block of `evaluating`."""
        for target, argument in zip(self._inputs, arguments, strict=True):
            target[:] = argument
        self.failure = None
        try:
            self._run()
        except RuntimeError as error:
            if "KeyboardInterrupt" in str(error):
                raise
            self.failure = error
        if self.failure or self._buffer.ret():  # aborted, as by CasADi's QR: the outputs are those of an earlier call
            return [np.full_like(array, np.nan) for array in self._outputs]
        return [array.copy() for array in self._outputs]

    @property
    def stats(self) -> dict[str, Any]:
        """CasADi's statistics of the last call, which must not have failed."""
        if self.failure is not None:
            raise self.failure
        return self._buffer.stats()
