"""What is tried in turn where an optimization finds nothing."""

import numpy as np
import pytest
from control_problems import double_integrator

import casadi_galerkin as cg


def swing_to_rest(duration):
    """A mass on a spring, from x = 3 to rest at 0 in least time: its force is the weaker one, so it has to swing."""
    return double_integrator(
        lagrangian=lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2,
        t_span=(0.0, duration),
        start=[3.0],
        end=[0.0],
        running_cost=lambda t, x, v, u: 1 + 0 * u[0],
        control_bounds=(-1.0, 1.0),
        duration_bounds=(0.5, 30.0),
    )


LEAST_TIME = np.pi + 2 * np.arcsin(0.75)  # semicircles about 1 and -1 in the phase plane, by their angles


@pytest.mark.parametrize("duration", [5.0, 8.0])
def test_a_free_duration_is_begun_with_longer_ones_where_none_is_found(duration):
    path = cg.solve(swing_to_rest(duration), cg.Galerkin(4), intervals=30)
    assert "times the duration of the guess" in path.solver
    assert path.t[-1] == pytest.approx(LEAST_TIME, rel=2e-3)
    near = cg.solve(swing_to_rest(20.0), cg.Galerkin(4), intervals=30)
    assert "times the duration" not in near.solver
    assert path.cost == pytest.approx(near.cost, rel=1e-6)


def test_longer_durations_that_lead_nowhere_are_told():
    far = double_integrator(end=[100.0], control_bounds=(-1.0, 1.0), duration_bounds=(0.5, 10.0))
    with pytest.raises(cg.ConvergenceError, match="From longer durations no path was found, either"):
        cg.solve(far, cg.Galerkin(3), intervals=10)
