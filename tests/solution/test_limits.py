"""Limits of a refinement: numbers that are none are refused, an infinite one stops nothing."""

from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator
from scenes import BY_NAME

import casadi_galerkin as cg
from casadi_galerkin.solution.errors import check_tolerance


def test_limits_of_another_kind_are_refused():
    with pytest.raises(TypeError, match=r"limits must be Limits.* got 3"):
        cg.solve(double_integrator(), tol=1e-3, limits=3)


@pytest.mark.parametrize("name", ["intervals", "seconds", "levels"])
@pytest.mark.parametrize("value", [0, -1, np.nan, "10", None, True, 1j, [3], np.True_])
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


@pytest.mark.parametrize("tol", [np.float32(1e-3), np.float64(1e-3), np.array(1e-3), Fraction(1, 1000)])
def test_a_tolerance_is_any_real_number(tol):
    assert check_tolerance(tol) == pytest.approx(1e-3, rel=1e-6)
    assert type(check_tolerance(tol)) is float


@pytest.mark.parametrize("tol", [np.float32(1e-3), np.array(1e-3)])
def test_a_tolerance_may_be_a_scalar_of_numpy(tol, capsys):
    path = cg.solve(BY_NAME["Troesch 10"].problem, tol=tol, verbose=1)
    assert path.error_estimate <= 1e-3
    assert "degree" in capsys.readouterr().out


@pytest.mark.parametrize(
    "tol", [None, [1e-3], np.array([1e-3]), "1e-3", True, np.True_, 1e-3j, 10**400, ca.SX.sym("tol")]
)
def test_a_tolerance_that_is_no_number_is_refused(tol):
    with pytest.raises(ValueError, match="tol must be a number between 0 and 1, got"):
        check_tolerance(tol)
