"""Joints are moved to the switches of a bang-bang control."""

import numpy as np
import pytest
from control_problems import minimum_time, pendulum

import casadi_galerkin as cg


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
