"""The estimated error of a trajectory optimization is sharp on a smooth path."""

import pytest
from control_problems import cart_pole, resolved, true_error

import casadi_galerkin as cg


@pytest.mark.parametrize("tol", [1e-2, 1e-4])
@pytest.mark.parametrize("degree", [4, 5])
def test_estimate_is_sharp_on_a_smooth_path(degree, tol):
    path = cg.solve(cart_pole(), cg.Galerkin(degree), tol=tol)
    assert path.method.degree == degree
    ratio = path.error_estimate / true_error(path, *resolved(cart_pole))
    assert 0.8 < ratio < 1.5
