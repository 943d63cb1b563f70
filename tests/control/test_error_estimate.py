"""The estimated error of a trajectory optimization is sharp on a smooth path, and where its phases are free."""

import casadi as ca
import pytest
from control_problems import cart_pole, double_integrator, resolved, true_error

import casadi_galerkin as cg


@pytest.mark.parametrize("tol", [1e-2, 1e-4])
@pytest.mark.parametrize("degree", [4, 5])
def test_estimate_is_sharp_on_a_smooth_path(degree, tol):
    path = cg.solve(cart_pole(), cg.Galerkin(degree), tol=tol)
    assert path.method.degree == degree
    ratio = path.error_estimate / true_error(path, *resolved(cart_pole))
    assert 0.8 < ratio < 1.5


def over_bumps():
    """Halfway the speed is halved, at a free time: both phases are free, and their mesh with them."""
    return double_integrator(
        lagrangian=lambda t, x, v: v[0] ** 2 / 2 + 2 * ca.cos(4 * x[0]),
        t_span=(0.0, 2.0),
        end=[3.0],
        end_velocity=[None],
        running_cost=lambda t, x, v, u: u[0] ** 2 / 2 + 1,
        duration_bounds=(0.2, 5.0),
        waypoints=[(1.0, [1.0])],
        jumps=[(1.0, lambda x, v: (x, v / 2))],
    )


@pytest.mark.parametrize(("degree", "tol"), [(3, 1e-2), (3, 1e-4), (5, 1e-4)])
def test_estimate_is_sharp_where_the_phases_are_free(degree, tol):
    """Positions at the same parts of a phase differ by half as much as those at the same time."""
    path = cg.solve(over_bumps(), cg.Galerkin(degree), tol=tol)
    ratio = path.error_estimate / true_error(path, *resolved(over_bumps))
    assert 0.95 < ratio < 1.5
