"""Joints are moved to the switches of a bang-bang control."""

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, minimum_time, pendulum

import casadi_galerkin as cg
from casadi_galerkin.control.bends import bends
from casadi_galerkin.control.switching import passages_of, switches

SOLVED = 1e-10  # what IPOPT leaves of a cost


@pytest.mark.parametrize("intervals", [5, 7])
def test_a_joint_is_moved_to_the_switch(intervals):
    path = cg.solve(minimum_time(), tol=1e-6, intervals=intervals)
    assert np.min(np.abs(path.t - 1)) <= 1e-6
    assert np.min(np.abs(cg.solve(minimum_time(), cg.Galerkin(4), intervals).t - 1)) > 0.1
    assert path.cost == pytest.approx(2, abs=1e-8)
    assert path.control_overshoot.max() <= 1e-3


def fast_pendulum():
    """Minimum time to swing up with half the weight: two switches, neither known in advance."""
    return pendulum(6.0, running_cost=lambda t, x, v, u: 1, control_bounds=(-0.5, 0.5), duration_bounds=(0.1, 20.0))


def test_two_switches_are_found():
    """The cost is that to a tolerance of 1e-7 from another mesh."""
    tol = 1e-5
    path = cg.solve(fast_pendulum(), tol=tol, intervals=8)
    assert path.cost == pytest.approx(7.586693493, rel=tol / 100)  # of second order in the switching times
    jumps = np.flatnonzero(np.abs(np.diff(path.control.values[0])) > 0.5)
    assert len(jumps) == 2
    np.testing.assert_allclose(path.control.times[jumps], [2.37217, 6.33145], rtol=0, atol=2 * tol * path.cost)


def steep(price):
    """A mass is to rest at zero soon; of the force, which is at most one, the cost is so small that it nearly jumps."""
    return double_integrator(
        t_span=(0.0, 5.0),
        start=[1.0],
        end=[None],
        end_velocity=[None],
        running_cost=lambda t, x, v, u: x[0] ** 2 + price * u[0] ** 2,
        control_bounds=(-1.0, 1.0),
    )


def test_a_steep_passage_from_bound_to_bound_is_no_switch_where_both_its_ends_are_joints():
    path = cg.solve(steep(1e-5), tol=1e-5)
    narrow, wide = passages_of(bends(path), 0)
    assert np.max(np.min(np.abs(path.t - np.reshape(wide, (2, 1))), axis=1)) < 1e-3
    (switch,) = switches(path, bends(path))
    assert narrow[0] < switch.when < narrow[1] < narrow[0] + 1e-3
    assert len(path.t) <= 30
    finer = cg.solve(steep(1e-5), cg.Galerkin(3), mesh=np.union1d(np.linspace(0, 5, 301), path.t))
    assert path.cost == pytest.approx(finer.cost, rel=1e-7)
    assert np.max(np.abs(path(finer.t) - finer.x)) <= path.error_estimate


def test_a_control_of_convex_cost_switches_in_the_middle_of_its_passage():
    path = cg.solve(steep(1e-2), cg.Galerkin(6), mesh=[0, 0.5, 1.5, 2, 3, 4, 5])
    ((left, met),), (switch,) = passages_of(bends(path), 0), switches(path, bends(path))
    assert 0.5 < left < met < 1.5
    assert switch.due == pytest.approx((left + met) / 2)


def burnt(start, strongest):
    """Cost, slope and curvature by the two times of a burn that lifts a mass from x = 0.3 in 2.4 units of time."""
    times, s, x, v, cost = ca.SX.sym("times", 2), ca.SX.sym("s"), 0.3, start, 0
    points, weights = np.polynomial.legendre.leggauss(3)
    for force, h in zip((0, strongest, 0), (times[0], times[1] - times[0], 2.4 - times[1]), strict=True):
        place = x + v * s + force * s**2 / 2
        squares = [ca.substitute(place**2, s, h * (point + 1) / 2) for point in points]
        cost += h * force + h / 4 * ca.dot(ca.vertcat(*squares), ca.DM(weights))
        x, v = ca.substitute(place, s, h), v + force * h
    cost += 5 * (x - 0.6) ** 2
    return ca.Function("burnt", [times], [cost, ca.gradient(cost, times), ca.hessian(cost, times)[0]])


@pytest.mark.parametrize("tol", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize(("start", "near"), [(-0.1, (0.047, 0.071)), (-0.2, (0.032, 0.068))])
def test_the_fuel_of_a_short_burn_is_known_to_the_tolerance(start, near, tol):
    """A delay of a thousandth of the duration is a tenth of a burn: the estimates were up to 30 times too small."""
    closed, times, strongest = burnt(start, 8.0), np.array(near), 8.0
    for _ in range(20):
        cost, slope, curvature = map(np.array, closed(times))
        times = times - np.linalg.solve(curvature, slope).ravel()
    assert np.max(np.abs(slope)) < 1e-11
    problem = cg.ControlProblem(
        lambda t, x, v: v[0] ** 2 / 2,
        (0.0, 2.4),
        [0.3, 0.0],
        [None, None],
        [start, None],
        [None, None],
        force=lambda t, x, v, u: u,
        rates=lambda t, x, v, u: u,
        controls=1,
        control_bounds=(0.0, strongest),
        running_cost=lambda t, x, v, u: u[0] + x[0] ** 2 / 2,
        terminal_cost=lambda t, x, v: 5 * (x[0] - 0.6) ** 2,
    )
    path = cg.solve(problem, tol=tol)
    t = np.concatenate([np.linspace(0, 2.4, 1001), np.linspace(*times, 1001)])
    fuel = strongest * np.clip(t - times[0], 0, times[1] - times[0])
    assert np.max(np.abs(path(t)[1] - fuel)) / np.max(fuel) <= path.error_estimate <= tol
    assert abs(path.cost / cost.item() - 1) <= path.cost_error + SOLVED
