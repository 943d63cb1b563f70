"""Lagrangians given as callables: traced, or refused with a reason."""

import math

import casadi as ca
import numpy as np
import pytest
from scenes import oscillator_problem


@pytest.mark.parametrize(
    ("lagrangian", "kind", "message"),
    [
        (lambda t, x, v: v, ValueError, r"lagrangian must return a scalar, got shape \(2, 1\)"),
        (lambda t, x, v: ca.vertcat(v[0], x[0], v[1]), ValueError, r"must return a scalar, got shape \(3, 1\)"),
        (lambda t, x, v: 1.0, ValueError, r"the lagrangian ignores v\[0\], v\[1\]: without a velocity"),
        (lambda t, x, v: None, TypeError, "must return a CasADi expression.* got NoneType: None"),
        (lambda t, x, v: "L", TypeError, "must return a CasADi expression.* got str: 'L'"),
        (lambda t, x, v: ca.DM(1.0), ValueError, r"the lagrangian ignores v\[0\], v\[1\]"),
        (lambda t, x, v: True, TypeError, "must return a CasADi expression.* got bool: True"),
        (lambda t, x, v: ca.MX.sym("a"), TypeError, "must return a CasADi expression, got MX"),
        (lambda t, x, v: ca.SX.sym("a") * v[0] + v[1], ValueError, "lagrangian depends on .*a.* besides its arguments"),
        (lambda t, x, v: v[0] ** 2 + x[1], ValueError, r"ignores v\[1\]: without a velocity"),
        (lambda t, x, v: ca.sum1(x), ValueError, r"ignores v\[0\], v\[1\]"),
        (lambda t, x, v: v[0] ** 2 + v[1] + math.cos(x[0]), TypeError, "not with math or NumPy ones"),
        (lambda t, x, v: v[0] ** 2 + v[1] + np.linalg.norm(x), (TypeError, ValueError), "not with math or NumPy ones"),
        (lambda t, x, v: v[0] ** 2 + v[1] if x[0] > 0 else 0, ValueError, "lagrangian failed when called with CasADi"),
        (lambda t, x: x[0], TypeError, r"lagrangian is called as lagrangian\(t, x, v\):"),
        (lambda t, x, v: v[2] ** 2, ValueError, "lagrangian failed when called with CasADi symbols"),
        (lambda t, x, v: 1 / 0, ValueError, "lagrangian failed when called.*division by zero"),
        ("v**2", TypeError, r"lagrangian must be a callable of \(t, x, v\), got 'v\*\*2'"),
        (None, TypeError, r"lagrangian must be a callable of \(t, x, v\), got None"),
    ],
)
def test_a_lagrangian_that_cannot_be_traced_is_refused(lagrangian, kind, message):
    with pytest.raises(kind, match=message):
        oscillator_problem(lagrangian=lagrangian, start=[0.0, 0.0], end=[1.0, 1.0])


def test_a_lagrangian_of_parameters_is_called_with_them():
    with pytest.raises(TypeError, match=r"is called as lagrangian\(t, x, v, p\):"):
        oscillator_problem(parameters=[1.0, 2.0])
    with pytest.raises(ValueError, match=r"failed when called with CasADi symbols t, x, v, p \(2,\):"):
        oscillator_problem(lagrangian=lambda t, x, v, p: p[2] * v[0] ** 2, parameters=[1.0, 2.0])
    with pytest.raises(TypeError, match=r"is called as lagrangian\(t, x, v\):"):
        oscillator_problem(lagrangian=lambda t, x, v, p: p * v[0] ** 2)


def test_a_function_of_other_sizes_is_refused():
    traced = oscillator_problem(start=[0, 0], end=[1, 1], lagrangian=lambda t, x, v: ca.sumsqr(v)).lagrangian
    with pytest.raises(ValueError, match=r"Function of inputs of lengths \[1, 2, 2\], expected \[1, 1, 1\]"):
        oscillator_problem(lagrangian=traced)
    assert oscillator_problem(lagrangian=oscillator_problem().lagrangian).dimension == 1


@pytest.mark.filterwarnings(r"ignore:\s*casadi. a numpy function:FutureWarning")
@pytest.mark.parametrize("function", [np.cos, np.sqrt, np.exp])
def test_numpy_functions_that_casadi_can_trace_are_taken(function):
    """NumPy's ufuncs call the symbols' own methods: no reason to refuse them."""
    L = lambda t, x, v: v[0] ** 2 / 2 + function(x[0] + 1)  # noqa: E731
    assert oscillator_problem(lagrangian=L).lagrangian.n_in() == 3
