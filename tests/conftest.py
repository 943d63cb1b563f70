"""What tests of several folders need."""

import time
from importlib import import_module

import pytest


def called_once(solve):
    began = time.perf_counter()
    return solve(), time.perf_counter() - began


@pytest.fixture(scope="session", autouse=True)
def brief_trades():
    """Every way of a trade is solved once for the first time, and once again: nothing here tests seconds."""
    with pytest.MonkeyPatch.context() as patch:
        module = import_module("casadi_galerkin.studies.trade")
        patch.setattr(module, "_timed", called_once)
        yield


@pytest.fixture
def headless():
    """No screen, and no figure left open."""
    import matplotlib

    matplotlib.use("Agg")
    yield
    import matplotlib.pyplot as plt

    plt.close("all")
