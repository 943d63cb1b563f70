"""Controls over time: polynomials within the intervals that jump at joints."""

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, minimum_time
from scipy.integrate import solve_ivp

import casadi_galerkin as cg
from casadi_galerkin.solution.control_path import ControlPath


def test_control_is_a_polynomial_of_its_points_and_jumps_at_joints():
    path = cg.solve(minimum_time(), cg.Galerkin(3), intervals=4)
    np.testing.assert_allclose(path.control(path.control.times), path.control.values, rtol=0, atol=1e-12)
    assert path.control(path.t[2])[0] == pytest.approx(-1, abs=1e-6)
    assert path.control(np.nextafter(path.t[2], 0))[0] == pytest.approx(1, abs=1e-6)
    assert path.control(np.zeros((2, 3))).shape == (1, 2, 3)
    with pytest.raises(ValueError, match="times must lie within"):
        path.control(3.0)


@pytest.mark.parametrize(("rule", "at_joint"), [(cg.lobatto(2), 5.0), (cg.radau(2), 1.0)])
def test_the_value_at_a_joint_is_the_later_one_unless_the_rule_has_only_the_earlier(rule, at_joint):
    points = np.array(rule.points)
    control = ControlPath(np.array([0.0, 1.0, 2.0]), points, np.array([[1.0, 1.0, 5.0, 5.0]]), points)
    assert control(1.0).tolist() == [at_joint]


def in_least_time(**changes):
    """From a running start: the switch is inside of an interval, and not in the middle of it."""
    timed = {"running_cost": lambda t, x, v, u: 1.0, "control_bounds": (-1.0, 1.0), "duration_bounds": (0.1, 10.0)}
    return double_integrator(start_velocity=[0.3], **(timed | changes))


def flown(path, control):
    """Where a unit mass arrives with a control, from the start of the path."""
    state = np.array([0.0, 0.3])
    for begin, end in zip(path.t[:-1], path.t[1:], strict=True):
        before_end = np.nextafter(end, begin)
        rates = lambda t, y, last=before_end: [y[1], control(min(t, last))[0]]  # noqa: E731
        state = solve_ivp(rates, (begin, end), state, rtol=1e-9, atol=1e-10, max_step=(end - begin) / 20).y[:, -1]
    return state


@pytest.mark.parametrize("bounds", [(-1.0, 1.0), (-1.0, np.inf)])
@pytest.mark.slow
def test_a_control_is_cut_at_its_bounds_and_keeps_its_impulse(bounds):
    path = cg.solve(in_least_time(), cg.Galerkin(3), 4)
    given = path.t, path.control.points, path.control.values, path.control.rule
    control, polynomial, times = ControlPath(*given, bounds), ControlPath(*given), np.linspace(0, path.t[-1], 10_001)
    assert np.min(polynomial(times)) < -1.5
    assert np.min(control(times)) >= bounds[0]
    assert np.max(control(times)) <= bounds[1]
    np.testing.assert_allclose(control(control.times), control.values, rtol=0, atol=1e-12)
    as_stated = lambda t: np.clip(polynomial(t), *bounds)  # noqa: E731
    missed, cut = (abs(flown(path, some)[1]) for some in (control, as_stated))
    assert missed < 1e-5 < 1e-2 < cut
    symbol = ca.SX.sym("t")
    expression = ca.Function("control", [symbol], [control.expression(symbol)])
    np.testing.assert_allclose(expression(times[None]).full(), control(times), rtol=0, atol=1e-12)


@pytest.mark.slow
def test_what_a_tolerance_returns_can_be_flown():
    path = cg.solve(in_least_time(), tol=1e-4)
    np.testing.assert_allclose(flown(path, path.control), [1, 0], rtol=0, atol=1e-4)
    assert np.max(np.abs(path.control(np.linspace(0, path.t[-1], 10_000)))) <= 1
