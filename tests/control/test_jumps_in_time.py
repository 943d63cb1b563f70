"""Jumps in time that no breakpoint names are seen, and what is smooth in time is not taken for one."""

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, varying_mass

import casadi_galerkin as cg
from casadi_galerkin.control.jumps_in_time import jumps_in_time

WHEN = 0.749015  # no point of the first mesh lies between it and the joint at 0.75


def step(t, before, after):
    return ca.if_else(t < WHEN, before, after)


JUMPING = {
    "cost": {"running_cost": lambda t, x, v, u: step(t, 1, 3) * u[0] ** 2 / 2},
    "force": {"force": lambda t, x, v, u: u + step(t, 0, 3)},
    "potential": {"lagrangian": lambda t, x, v: v[0] ** 2 / 2 - step(t, 0, 5) * x[0]},
    "mass": {"lagrangian": lambda t, x, v: step(t, 1, 3) * v[0] ** 2 / 2},
    "rates": {
        "lagrangian": None,
        "force": None,
        "start_velocity": [None],
        "end_velocity": [None],
        "rates": lambda t, x, v, u: step(t, 1, 3) * u + x,
    },
}


@pytest.mark.parametrize(("name", "tol"), [("cost", 1e-3), *((name, 1e-5) for name in JUMPING)])
def test_a_jump_that_is_not_named_is_met_to_the_tolerance(name, tol):
    """Both degrees agreed to 1e-14 on costs that were wrong by 1e-3."""
    path, named = (cg.solve(double_integrator(**JUMPING[name], breakpoints=b), tol=tol) for b in ((), (WHEN,)))
    assert abs(path.cost / named.cost - 1) <= path.cost_error <= tol
    assert len(named.t) <= 10
    assert np.max(jumps_in_time(named)) < 1e-12 * named.cost


def test_a_jump_that_no_mesh_meets_is_named():
    with pytest.raises(cg.LimitReached, match=r"not smooth in time near t = 0\.7490.*: name that time in the break"):
        cg.solve(double_integrator(**JUMPING["cost"]), tol=1e-9, limits=cg.Limits(intervals=400))


def test_a_peak_that_a_finer_mesh_resolves_is_no_jump():
    peak = double_integrator(running_cost=lambda t, x, v, u: (1 + 20 * ca.exp(-2e4 * (t - 0.44) ** 2)) * u[0] ** 2 / 2)
    for levels, told in ((1, True), (2, False)):
        with pytest.raises(cg.LimitReached) as caught:
            cg.solve(peak, tol=1e-10, limits=cg.Limits(levels=levels))
        assert ("near t = 0.4375, or changes there too fast for this mesh" in str(caught.value)) is told


SMOOTH = {
    "lever and friction": varying_mass,
    "waves": lambda: double_integrator(running_cost=lambda t, x, v, u: (1.5 + ca.sin(10 * t)) * u[0] ** 2),
    "bang-bang": lambda: double_integrator(
        running_cost=lambda t, x, v, u: 1 + ca.sin(3 * t) / 3,
        force=lambda t, x, v, u: u * (1 + ca.cos(5 * t) / 5),
        control_bounds=(-1.0, 1.0),
        duration_bounds=(0.1, 10.0),
    ),
    "constraint": lambda: double_integrator(
        path_constraint=(lambda t, x, v, u: v - 1.2 - ca.sin(4 * t) / 10, -np.inf, 0.0)
    ),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_what_is_smooth_in_time_is_no_jump(name):
    """Controls that switch between the points are none either."""
    path = cg.solve(SMOOTH[name](), cg.Galerkin(5), intervals=8)
    assert 0 < np.sum(jumps_in_time(path)) < 1e-11 * abs(path.cost)
