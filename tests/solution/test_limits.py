"""Limits of a refinement: numbers that are none are refused, an infinite one stops nothing."""

import numpy as np
import pytest
from control_problems import double_integrator
from scenes import BY_NAME

import casadi_galerkin as cg


def test_limits_of_another_kind_are_refused():
    with pytest.raises(TypeError, match=r"limits must be Limits.* got 3"):
        cg.solve(double_integrator(), tol=1e-3, limits=3)


@pytest.mark.parametrize("name", ["intervals", "seconds", "levels"])
@pytest.mark.parametrize("value", [0, -1, np.nan, "10", None, True])
def test_bad_limits_are_refused(name, value):
    with pytest.raises(ValueError, match=f"the limit of {name} must be a positive number, got"):
        cg.Limits(**{name: value})


@pytest.mark.parametrize("name", ["intervals", "levels"])
def test_half_a_mesh_is_no_limit(name):
    with pytest.raises(ValueError, match=f"the limit of {name} must be a whole number or inf, got 2.5"):
        cg.Limits(**{name: 2.5})


def test_an_infinite_limit_stops_nothing():
    limits = cg.Limits(intervals=np.inf, seconds=np.inf, levels=np.inf)
    problem = BY_NAME["Troesch 10"].problem
    path, limited = (cg.solve(problem, tol=1e-6, limits=given) for given in (limits, None))
    np.testing.assert_array_equal(path.x, limited.x)
