"""Progress bars of long calculations, on ``sys.stderr`` in a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeAlias

from tqdm import tqdm

PATIENT = 2.0  # seconds after which a bar appears

Advance: TypeAlias = Callable[[int], object]  # takes the number of steps


@contextmanager
def progress(what: str, total: int | None = None, unit: str = "solve") -> Iterator[Advance]:
    """Show a bar, and yield the function that advances it; without a total the bar only counts."""
    if sys.stderr is None or not sys.stderr.isatty():  # a hidden bar takes a lock, too, which a fork keeps
        yield lambda _: None
        return
    with tqdm(total=total, desc=what, unit=unit, leave=False, delay=PATIENT) as bar:
        yield bar.update
