"""The scripts behind the measured tables find all that they import; what they measure takes minutes."""

import runpy
import sys

import pytest
from paths import EXAMPLES

SCRIPTS = sorted((EXAMPLES / "benchmark").glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_benchmark_finds_what_it_imports(script, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(script.parent), *sys.path])  # as where it is run
    assert "main" in runpy.run_path(str(script), run_name="imported")
