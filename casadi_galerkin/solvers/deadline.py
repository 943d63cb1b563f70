"""A time limit for all solves of one thread, such as those of a refinement with `limits`."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from casadi_galerkin.calculus.roundoff import EPS

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


def limited(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options of IPOPT, with the seconds that are left if there is a deadline; what is built with these serves once."""
    if math.isinf(seconds_left()):
        return dict(options)
    seconds = min(seconds_left(), options.get("max_wall_time", math.inf))
    return {**options, "max_wall_time": max(seconds, EPS)}
