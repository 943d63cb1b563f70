"""What CasADi shares with the whole process: the threads of its OpenBLAS, locks of its own, and ``sys.stderr``.

From some 250,000 multiplications on it shares a product among all cores.  Those of a Newton iteration are small: on two
cores it was no faster and took twice the processor time, and beside another busy pool of threads, such as SciPy's, a
solve took 22 ms instead of 3.  Other users of the library are not asked, so the number is put back.

CasADi runs without Python's own lock, lets one thread at a time into IPOPT, and takes short locks of its own whenever
an expression or a Function is made, evaluated or deleted.  A process that is forked beside a thread that holds one
finds it taken for ever: beside first solves 2 of 60 forked children hung.  So a fork waits for the solves of other
threads, with all that they build, and for evaluations; not for `transcribe`, nor for what is deleted outside of solves.

Its LDLᵀ writes a line to ``sys.stderr`` for every pivot that is exactly zero, and no option stops it.  The package
measures what such a factorization gives and takes another where it is useless, so the line says nothing.
"""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO, cast

import casadi as ca

LIBRARY = "libcasadi-tp-openblas.so.0"  # on Linux; where it is not found, nothing is changed


def _functions() -> tuple[Callable[[], int], Callable[[int], object]]:
    path = Path(ca.__file__).parent / LIBRARY
    if not path.exists():
        return lambda: 1, lambda _: None
    library = ctypes.PyDLL(str(path))  # the one that is loaded already; no fork comes into a call, nor into its locks
    return library.openblas_get_num_threads, library.openblas_set_num_threads


count, use = _functions()


@contextmanager
def one_thread() -> Iterator[None]:
    """Let products use one thread; within another such block, nothing changes."""
    several = count()
    if several == 1:
        yield  # another thread may be at work, and will put the number back
        return
    try:
        use(1)
        yield
    finally:
        use(several)


fork_waits = threading.RLock()  # held by every solve, and wherever buffers are evaluated
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=fork_waits.acquire, after_in_parent=fork_waits.release, after_in_child=fork_waits.release
    )


ZERO_PIVOT = "LDL factorization has zeros in D"


class _Filter:
    """Stands for a stream and passes on all but CasADi's lines on zero pivots, which come in several parts."""

    def __init__(self, stream: TextIO) -> None:
        self.stream, self._line, self.inside = stream, "", 0  # blocks that are under way

    def write(self, text: str) -> int:
        """Pass on whole lines."""
        *lines, self._line = (self._line + text).split("\n")
        for line in lines:
            if ZERO_PIVOT not in line:
                self.stream.write(line + "\n")
        return len(text)

    def finish(self) -> None:
        """Pass on a line that was begun."""
        if self._line:
            self.stream.write(self._line)
            self._line = ""

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextmanager
def without_zero_pivots() -> Iterator[None]:
    """Let ``sys.stderr`` have no lines on zero pivots; within another such block, nothing changes.

    It takes no lock, which an interrupt could leave taken.  What another thread may leave is the filter: it passes on
    all else, and the next to leave takes it away.
    """
    now: object = sys.stderr
    own = now if isinstance(now, _Filter) else _Filter(sys.stderr)
    try:
        own.inside += 1
        sys.stderr = cast(TextIO, own)
        yield
    finally:
        own.inside -= 1
        if own.inside <= 0 and sys.stderr is cast(TextIO, own):
            own.finish()
            sys.stderr = own.stream
