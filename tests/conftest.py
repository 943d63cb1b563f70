"""What tests of several folders need."""

from importlib import import_module

import pytest


@pytest.fixture(scope="session", autouse=True)
def brief_trades():
    """Every way of a trade is solved once for the first time, and repeated once: nothing here tests seconds."""
    with pytest.MonkeyPatch.context() as patch:
        module = import_module("casadi_galerkin.studies.trade")
        patch.setattr(module, "LONG", 0.0)
        patch.setattr(module, "FIRST_CALLS", 1)
        yield


@pytest.fixture
def headless():
    """No screen, and no figure left open."""
    import matplotlib

    matplotlib.use("Agg")
    yield
    import matplotlib.pyplot as plt

    plt.close("all")
