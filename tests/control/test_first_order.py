"""Boundary problems of first order: no controls, as many conditions as components."""

import runpy

import casadi as ca
import numpy as np
import pytest
from paths import EXAMPLES
from scipy.optimize import brentq
from slow import slow

import casadi_galerkin as cg

TIMES = np.linspace(0, 1, 501)


def bratu(t):
    """The lower solution of x'' = -exp(x), zero at both ends."""
    theta = brentq(lambda q: q - np.sqrt(2) * np.cosh(q / 4), 1, 2, xtol=1e-15)
    return -2 * np.log(np.cosh((t - 0.5) * theta / 2) / np.cosh(theta / 4))


HEAT = {"rates": lambda t, x: [x[1], -ca.exp(x[0])], "t_span": (0, 1), "start": [0.0, None], "end": [0.0, None]}


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_order_is_twice_the_degree(degree):
    problem, errors = cg.ControlProblem(**HEAT), []
    for count in (2, 4, 8):
        path = cg.solve(problem, cg.Galerkin(degree), count)
        errors.append(np.max(np.abs(path.x[0] - bratu(path.t))))
    slopes = np.diff(np.log2(errors))
    assert -slopes[-1] == pytest.approx(2 * degree, abs=0.2)


@pytest.mark.parametrize("tol", [1e-4, *slow(1e-10)])
def test_the_error_is_at_most_what_is_said(tol):
    path = cg.solve(cg.ControlProblem(**HEAT), tol=tol)
    error = np.max(np.abs(path(TIMES)[0] - bratu(TIMES))) / bratu(0.5)
    assert error - 1e-14 <= path.error_estimate <= tol  # but for rounding of what is exact


@pytest.mark.parametrize("name", ["shock", *slow("Sturm-Liouville", "Emden", "electrodes", "Cash 33", "Mathieu")])
@pytest.mark.slow
def test_errors_of_the_benchmark_are_at_most_what_is_said(name):
    benchmark = runpy.run_path(str(EXAMPLES / "benchmark" / "first_order.py"))
    case = benchmark["CASES"][name]
    path = cg.solve(case.problem, tol=1e-6, guess=None if case.guess(0.0) is None else case.guess)
    finest = None if case.exact else case.here(1e-12)[0]
    error = benchmark["error"](case, (path, path.parameters or ()), finest)
    assert error <= path.error_estimate <= 1e-6


def test_blasius_layer_is_found_by_newtons_method_from_a_line():
    """IPOPT is caught in a least violation there; f''(0) to sixteen digits: J. P. Boyd, SIAM Review 50 (2008)."""
    layer = cg.ControlProblem(
        rates=lambda t, x: [x[1], x[2], -x[0] * x[2] / 2], t_span=(0, 12), start=[0, 0, None], end=[None, 1, None]
    )
    path = cg.solve(layer, cg.Galerkin(8), 12)
    assert path.x[2, 0] == pytest.approx(0.33205733621519630, abs=1e-9)
    assert path.solver.startswith("Newton")


@pytest.mark.slow
def test_where_newtons_method_is_lost_it_is_ipopt_that_finds_or_says_so():
    """No swing from below is so fast that it is at 1 after three seconds, but for one that goes back first."""
    motor = {
        "lagrangian": lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]),
        "t_span": (0.0, 3.0),
        "start": [0.0, 0.0],
        "end": [1.0, None],
        "force": lambda t, x, v: x[1],
        "rates": lambda t, x, v: 1 - x[1] - v[0],
    }
    with pytest.raises(cg.ConvergenceError, match="IPOPT stopped with 'Infeasible Problem Detected'"):
        cg.solve(cg.ControlProblem(**motor), cg.Galerkin(4), 8)
    back = cg.solve(
        cg.ControlProblem(**motor), cg.Galerkin(4), 8, guess=lambda t: [t / 3 - 2 * np.sin(np.pi * t / 3), 0.5]
    )
    assert -2.5 < back.start_velocity[0] < -2.0


def test_gauss_points_make_it_the_mechanical_path():
    """Both are Gauss collocation, of Hamilton's equations and of those that are stated."""
    mechanical = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - ca.exp(x[0]), (0, 1), 0.0, 0.0)
    path = cg.solve(mechanical, cg.Galerkin(3), 4)
    first = cg.solve(cg.ControlProblem(**HEAT), cg.Galerkin(3), 4)
    np.testing.assert_allclose(first.x, [path.x[0], path.momentum[0]], rtol=0, atol=1e-12)


def test_a_periodic_condition_joins_both_ends():
    stock = cg.ControlProblem(
        rates=lambda t, x: -x + ca.cos(2 * np.pi * t),
        t_span=(0, 1),
        components=1,
        end_conditions=(lambda x0, x1: x1 - x0, 0, 0),
    )
    path = cg.solve(stock, cg.Galerkin(8), 4)
    exact = (np.cos(2 * np.pi * path.t) + 2 * np.pi * np.sin(2 * np.pi * path.t)) / (1 + 4 * np.pi**2)
    np.testing.assert_allclose(path.x[0], exact, rtol=0, atol=1e-11)


@pytest.mark.parametrize("number", [1, 2, 3])
def test_an_unknown_parameter_is_found(number):
    string = cg.ControlProblem(
        rates=lambda t, x, p: [x[1], -p * x[0]],
        t_span=(0, 1),
        start=[0.0, 1.0],
        end=[0.0, None],
        parameters=0.9 * (number * np.pi) ** 2,
        parameter_bounds=(1.0, 200.0),
    )
    path = cg.solve(string, cg.Galerkin(8), 4, guess=lambda t: [np.sin(number * np.pi * t), np.cos(number * np.pi * t)])
    assert path.parameters[0] == pytest.approx((number * np.pi) ** 2, rel=1e-11)


def test_both_orders_together_are_one_problem():
    """A mass that is pulled by what grows like exp(t): x'' = z, z' = z."""
    problem = cg.ControlProblem(
        lambda t, x, v: v[0] ** 2 / 2,
        (0, 1),
        start=[0.0, 1.0],
        end=[1.0, None],
        force=lambda t, x, v: x[1],
        rates=lambda t, x, v: x[1],
    )
    path = cg.solve(problem, cg.Galerkin(7), 2)
    np.testing.assert_allclose(path.x, [np.exp(path.t) - 1 + (2 - np.e) * path.t, np.exp(path.t)], rtol=0, atol=1e-12)
    assert path.start_velocity[0] == pytest.approx(3 - np.e, abs=1e-12)


def test_an_answer_without_controls_is_printed_and_drawn():
    path = cg.solve(cg.ControlProblem(**HEAT), cg.Galerkin(3), 4)
    assert repr(path).startswith("ControlTrajectory of 2 components on [0, 1], 4 intervals\n")
    assert "cost" not in repr(path)
    assert len(path.plot().figure.axes) == 2
    with pytest.raises(ValueError, match="there are no controls to draw"):
        path.plot_controls()


@pytest.mark.slow
def test_an_answer_without_controls_is_a_casadi_function_of_its_ends():
    answer = cg.solution_function(cg.ControlProblem(**HEAT), cg.Galerkin(4), 4)
    path = cg.solve(cg.ControlProblem(**(HEAT | {"end": [0.1, None]})), cg.Galerkin(4), 4)
    np.testing.assert_allclose(answer(start=[0.0], end=[0.1])["x"], path.x, rtol=0, atol=1e-9)


def test_rates_of_zero_keep_a_constant_and_do_not_meet_a_change():
    still = {"rates": lambda t, x: 0 * x, "t_span": (0, 1)}
    assert cg.solve(cg.ControlProblem(**still, start=2.0), cg.Galerkin(2), 2).x[0, -1] == 2.0
    changed = cg.ControlProblem(**still, components=1, end_conditions=(lambda x0, x1: x1 - x0 - 1, 0, 0))
    with pytest.raises(cg.ConvergenceError, match="IPOPT stopped with"):
        cg.solve(changed, cg.Galerkin(2), 2)


def test_a_root_that_violates_a_bound_is_not_taken_for_an_answer():
    falls = cg.ControlProblem(rates=lambda t, x: -x, t_span=(0, 1), start=1.0, position_bounds=(0.5, 2))
    with pytest.raises(cg.ConvergenceError, match="IPOPT stopped with 'Infeasible"):
        cg.solve(falls, cg.Galerkin(3), 4)
