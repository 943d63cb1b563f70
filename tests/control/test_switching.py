"""Joints are moved to the switches of a bang-bang control."""

import numpy as np
import pytest
from control_problems import double_integrator, minimum_time, pendulum

import casadi_galerkin as cg
from casadi_galerkin.control.bends import bends
from casadi_galerkin.control.switching import passages_of, switches


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
