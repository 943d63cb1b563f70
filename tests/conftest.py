"""What tests of several folders need."""

import pytest


@pytest.fixture
def headless():
    """No screen, and no figure left open."""
    import matplotlib

    matplotlib.use("Agg")
    yield
    import matplotlib.pyplot as plt

    plt.close("all")
