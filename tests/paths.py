"""Where things are, from whatever folder of tests."""

from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"


def script(name):
    """A scene or a benchmark as a module, which finds the others as where it is run."""
    with pytest.MonkeyPatch.context() as patch:
        for folder in (EXAMPLES, EXAMPLES / "benchmark"):
            patch.syspath_prepend(folder)
        return import_module(name)
