"""Process-wide state of CasADi: the threads of its OpenBLAS, and its own locks.

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
