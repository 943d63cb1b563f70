"""How many threads the OpenBLAS that comes with CasADi may use.

From some 250,000 multiplications on it shares a product among all cores.  Those of a Newton iteration are small: on two
cores it was no faster and took twice the processor time, and beside another busy pool of threads, such as SciPy's, a
solve took 22 ms instead of 3.  IPOPT's linear solver uses the same library, so the number is put back.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import partial, wraps
from pathlib import Path
from typing import ParamSpec, TypeVar

import casadi as ca

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

LIBRARY = "libcasadi-tp-openblas.so.0"  # on Linux; where it is not found, nothing is changed


def _functions() -> tuple[Callable[[], int], Callable[[int], object]]:
    path = Path(ca.__file__).parent / LIBRARY
    if not path.exists():
        return lambda: 1, lambda _: None
    library = ctypes.CDLL(str(path))  # the one that is loaded already
    return library.openblas_get_num_threads, library.openblas_set_num_threads


count, use = _functions()


def alone(call: Callable[[], Result]) -> Result:
    """Call with one thread; within another such call, nothing changes."""
    several = count()
    if several == 1:
        return call()  # another thread may be at work, and will put the number back
    use(1)
    try:
        return call()
    finally:
        use(several)


def single(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Let a function use one thread."""

    @wraps(function)
    def limited(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        return alone(partial(function, *args, **kwargs))

    return limited
