"""What an optimized path misses between the quadrature points: equations of motion, and bounds."""

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, pendulum, plane, speed_limited

import casadi_galerkin as cg


def test_dynamics_defect_is_of_the_order_of_the_degree():
    defect = [cg.solve(pendulum(3.0), cg.Galerkin(3), n).dynamics_defect for n in (10, 20)]
    assert defect[0].shape == (10,)
    assert np.log2(defect[0].max() / defect[1].max()) == pytest.approx(3, abs=0.4)


def test_an_obstacle_between_the_points_is_not_resolved():
    """A pole of radius 0.01 in the way, on ten intervals: no point meets it."""
    pole = lambda t, x, v, u: ca.sumsqr(x - ca.DM([0.5, 0.0]))  # noqa: E731
    path = cg.solve(plane(path_constraint=(pole, 0.01**2, np.inf)), cg.Galerkin(4), 10)
    assert path.cost == pytest.approx(0.75, abs=1e-6)  # straight through
    assert "NOT RESOLVED: bounds are exceeded by 1e+00 of the path between t = 0.8 and 1" in repr(path)


def test_a_step_in_time_that_no_breakpoint_names_is_not_resolved():
    push = lambda t, x, v, u: u + ca.if_else(t < 0.3173, 2.0, 0.0)  # noqa: E731
    unnamed = cg.solve(double_integrator(force=push), cg.Galerkin(4), 10)
    assert "NOT RESOLVED: a callable jumps, by up to 5e-03 of the cost between t = 0.3 and 0.4; name its" in repr(
        unnamed
    )
    named = double_integrator(force=push, breakpoints=[0.3173])
    mesh = [*np.linspace(0, 0.3173, 4), *np.linspace(0.3173, 1, 8)[1:]]
    assert "NOT RESOLVED" not in repr(cg.solve(named, cg.Galerkin(4), mesh=mesh))


@pytest.mark.slow
def test_excess_between_the_points_is_told():
    coarse, fine = (
        cg.solve(speed_limited(0.6), cg.Galerkin(4), count) for count in (3, 20)
    )  # 20 have joints where it bends
    velocities = coarse(np.linspace(0, 2, 4001), 1)
    exceeded = (velocities.max() - 0.6) / np.max(np.abs(coarse(coarse.t, 1)))
    assert coarse.constraint_excess.max() == pytest.approx(exceeded, rel=0.02)
    assert "excess" in repr(coarse)
    assert fine.constraint_excess.max() < 1e-8
    assert "excess" not in repr(fine)
    assert not np.any(cg.solve(double_integrator(), cg.Galerkin(4), 3).constraint_excess)


def test_a_path_through_a_pole_is_told_by_how_much():
    """Squares of distances differ by 0.0024 only, but the path would have to move by the radius of the pole."""
    problem = plane(path_constraint=(lambda t, x, v, u: ca.sumsqr(x - ca.DM([0.5, 0.01])), 0.05**2, np.inf))
    path = cg.solve(problem, cg.Galerkin(2), 5)
    assert np.min(np.hypot(*(path(np.linspace(0, 2, 1001)) - [[0.5], [0.01]]))) < 0.011
    assert path.constraint_excess.max() > 0.1
    assert "excess" in repr(path)


def test_without_path_constraints_there_are_no_values_of_any():
    path = cg.solve(double_integrator(), cg.Galerkin(3), intervals=4)
    assert path.path_constraints(np.array([0.0, 0.5, 1.0])).shape == (0, 4, 3)
    assert path.constraint_excess.tolist() == [0.0] * 4
