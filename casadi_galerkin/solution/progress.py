"""Progress bars of long calculations, in a terminal and in a notebook."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from multiprocessing import parent_process
from typing import TypeAlias

PATIENT = 2.0  # seconds after which a bar appears

Advance: TypeAlias = Callable[[int], object]  # takes the number of steps


def watched() -> bool:
    """Whether someone looks at ``sys.stderr``: a terminal or a notebook, and no worker writes to it beside others."""
    if sys.stderr is None or parent_process() is not None:
        return False
    return sys.stderr.isatty() or type(sys.stderr).__module__.partition(".")[0] == "ipykernel"


@contextmanager
def progress(what: str, total: int | None = None, unit: str = "solve") -> Iterator[Advance]:
    """Show a bar, and yield the function that advances it; without a total the bar only counts."""
    if not watched():  # a hidden bar takes a lock, too, which a fork keeps
        yield lambda _: None
        return
    if find_spec("ipywidgets"):
        from tqdm.auto import tqdm
    else:  # a bar of text; the other one would warn
        from tqdm import tqdm
    with tqdm(total=total, desc=what, unit=unit, leave=False, delay=PATIENT) as bar:
        yield bar.update
