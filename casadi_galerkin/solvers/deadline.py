"""The time at which the solves of this thread stop, such as that of a refinement with limits."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_deadline: ContextVar[float] = ContextVar("deadline", default=math.inf)


@contextmanager
def until(deadline: float) -> Iterator[None]:
    """Let solves within stop at a time of ``time.perf_counter()``."""
    before = _deadline.set(deadline)
    try:
        yield
    finally:
        _deadline.reset(before)


def seconds_left() -> float:
    """Seconds until the deadline; infinite where nothing limits the solve."""
    return _deadline.get() - time.perf_counter()
