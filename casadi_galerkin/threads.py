"""How many threads the OpenBLAS that comes with CasADi may use.

From some 250,000 multiplications on it shares a product among all cores.  Those of a Newton iteration are small: on two
cores it was no faster and took twice the processor time, and beside another busy pool of threads, such as SciPy's, a
solve took 22 ms instead of 3.  IPOPT's linear solver uses the same library, so the number is put back.
"""

from __future__ import annotations

import ctypes
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
def single() -> Iterator[None]:
    """Use one thread; within another `single`, nothing changes."""
    several = count()
    if several == 1:
        yield  # another thread may be at work, and will put the number back
        return
    use(1)
    try:
        yield
    finally:
        use(several)
