"""Values of a parametrization that only ``pytest -m slow`` takes: the default run has one or two for each property."""

import pytest


def slow(*values):
    """Mark each of the values; a tuple holds those of several names."""
    return [pytest.param(*(value if isinstance(value, tuple) else [value]), marks=pytest.mark.slow) for value in values]
