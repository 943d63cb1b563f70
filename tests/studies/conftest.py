"""A problem with a closed form, and its trade, which three files of tests look at."""

import numpy as np
import pytest
from scenes import oscillator_problem

import casadi_galerkin as cg


@pytest.fixture(scope="session")
def oscillator():
    return oscillator_problem(t_span=(0.0, 2.0), end=[np.sin(2.0)])


@pytest.fixture(scope="session")
def measured(oscillator):
    return cg.trade(oscillator, [cg.Galerkin(1), cg.Galerkin(2), cg.Galerkin(6)], (4, 8, 16, 32))
