"""What CasADi shares with the whole process: the threads of its OpenBLAS, and the lock of IPOPT.

From some 250,000 multiplications on it shares a product among all cores.  Those of a Newton iteration are small: on two
cores it was no faster and took twice the processor time, and beside another busy pool of threads, such as SciPy's, a
solve took 22 ms instead of 3.  Other users of the library are not asked, so the number is put back.

CasADi lets one thread at a time into IPOPT, by a lock of its own.  A process that is forked meanwhile would find it
taken for ever: a fork waits until IPOPT is left.
"""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import casadi as ca

LIBRARY = "libcasadi-tp-openblas.so.0"  # on Linux; where it is not found, nothing is changed


def _functions() -> tuple[Callable[[], int], Callable[[int], object]]:
    path = Path(ca.__file__).parent / LIBRARY
    if not path.exists():
        return lambda: 1, lambda _: None
    library = ctypes.CDLL(str(path))  # the one that is loaded already
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


within_ipopt = threading.RLock()  # held wherever IPOPT is called
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=within_ipopt.acquire, after_in_parent=within_ipopt.release, after_in_child=within_ipopt.release
    )
