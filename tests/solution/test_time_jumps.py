"""Steps of callables that no breakpoint names are seen, and what is smooth is not taken for one."""

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, varying_mass

import casadi_galerkin as cg
from casadi_galerkin.solution.time_jumps import largest_step, may_step

WHEN = 0.749015  # no point of the first mesh lies between it and the joint at 0.75


def step(t, before, after):
    return ca.if_else(t < WHEN, before, after)


JUMPING = {
    "cost": {"running_cost": lambda t, x, v, u: step(t, 1, 3) * u[0] ** 2 / 2},
    "force": {"force": lambda t, x, v, u: u + step(t, 0, 3)},
    "potential": {"lagrangian": lambda t, x, v: v[0] ** 2 / 2 - step(t, 0, 5) * x[0]},
    "mass": {"lagrangian": lambda t, x, v: step(t, 1, 3) * v[0] ** 2 / 2},
    "rates": {
        **dict.fromkeys(("lagrangian", "force", "start_velocity", "end_velocity")),
        "rates": lambda t, x, v, u: step(t, 1, 3) * u + x,
    },
}


@pytest.mark.parametrize(("name", "tol"), [(name, 1e-5) for name in JUMPING])
@pytest.mark.slow
def test_a_jump_that_is_not_named_is_met_to_the_tolerance(name, tol):
    """Both degrees agreed to 1e-14 on costs that were wrong by 1e-3."""
    path, named = (cg.solve(double_integrator(**JUMPING[name], breakpoints=b), tol=tol) for b in ((), (WHEN,)))
    assert abs(path.cost / named.cost - 1) <= path.cost_error <= tol
    assert len(named.t) <= 10
    assert np.max(named.between_points.jump_effects) < 1e-12 * named.cost


@pytest.mark.slow
def test_a_jump_that_no_mesh_meets_is_a_limit():
    with pytest.raises(cg.LimitReached, match="tolerance 1e-09 was not reached"):
        cg.solve(double_integrator(**JUMPING["cost"]), tol=1e-9, limits=cg.Limits(intervals=70))


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
    assert 0 < np.sum(path.between_points.jump_effects) < 1e-11 * abs(path.cost)


@pytest.mark.parametrize("name", SMOOTH)
def test_what_is_smooth_along_the_path_does_not_step(name):
    smooth = SMOOTH[name]()
    path = cg.solve(smooth, cg.Galerkin(5), intervals=8)
    assert not may_step(smooth)
    moving = np.zeros(8, dtype=bool)
    z = path.between_points.along(np.array(path.method.quadrature.points))[1:]
    size, _ = largest_step(path.between_points.integrand, path.polynomial, path.method.quadrature, z, moving)
    assert size < 1e-8 * abs(path.cost)


@pytest.mark.slow
def test_what_is_continuous_where_it_compares_does_not_step():
    """Springs of a wall at 0.7, and a force that begins at 0.3, with kinks."""
    path = cg.solve(
        double_integrator(
            force=lambda t, x, v, u: u - 20 * ca.if_else(x[0] < 0.7, 0, x[0] - 0.7) + ca.if_else(t < 0.3, 0, t - 0.3)
        ),
        tol=1e-5,
    )
    assert may_step(path.problem)
    assert path.between_points.largest_step[0] < 1e-6 * path.cost
    assert "NOT RESOLVED" not in repr(path)


STEPS = {  # on the path, in a velocity, and in time where the duration is free; costs that were wrong by 0.4 to 10 %
    "cost": {"running_cost": lambda t, x, v, u: u[0] ** 2 / 2 + ca.sin(t) + ca.if_else(x[0] < 0.5, 1, 5)},
    "force": {
        "running_cost": lambda t, x, v, u: u[0] ** 2 / 2 + ca.sin(t),
        "force": lambda t, x, v, u: u - ca.if_else(x[0] < 0.5, 0, 3),
    },
    "friction": {
        "running_cost": lambda t, x, v, u: u[0] ** 2 / 2 + ca.sin(t),
        "start_velocity": [-1.0],
        "force": lambda t, x, v, u: u - ca.sign(v),
    },
    "free duration": {
        "running_cost": lambda t, x, v, u: u[0] ** 2 / 2 + ca.if_else(t < 1, 1, 1.5),
        "duration_bounds": (0.3, 5.0),
    },
    "free duration, named": {
        "running_cost": lambda t, x, v, u: u[0] ** 2 / 2 + ca.if_else(t < 1, 1, 1.5),
        "duration_bounds": (0.3, 5.0),
        "breakpoints": [1.0],
    },
    "free parameter": {
        "lagrangian": lambda t, x, v, p: v[0] ** 2 / 2,
        "running_cost": lambda t, x, v, u, p: u[0] ** 2 / 2 + (p[0] - 0.4) ** 2 / 10,
        "force": lambda t, x, v, u, p: u + ca.if_else(t < p[0], 2, 0),
        "parameters": [0.3],
        "parameter_bounds": (0.05, 1.4),
    },
}


@pytest.mark.parametrize("name", STEPS)
@pytest.mark.slow
def test_steps_that_no_derivative_sees_are_refused(name):
    with pytest.raises(cg.LimitReached, match="steps"):
        cg.solve(double_integrator(t_span=(0.0, 1.5), **STEPS[name]), tol=1e-3)


@pytest.mark.slow
def test_the_time_of_a_step_is_named():
    """The solver, blind to it, takes the way 3 s² - 2 s³ with s = t / 1.5."""
    with pytest.raises(cg.LimitReached, match=r"At t = 0\.75 a callable steps"):
        cg.solve(double_integrator(t_span=(0.0, 1.5), **STEPS["cost"]), tol=1e-3)
    lower = {**STEPS["cost"], "running_cost": lambda t, x, v, u: u[0] ** 2 / 2 + ca.if_else(x[0] < 0.104, 1, 5)}
    with pytest.raises(cg.LimitReached, match=r"At t = 0\.3 a callable steps"):  # at s = 1/5
        cg.solve(double_integrator(t_span=(0.0, 1.5), **lower), tol=1e-3)


@pytest.mark.parametrize("name", STEPS)
def test_on_a_fixed_mesh_such_steps_are_told(name):
    assert "NOT RESOLVED" in repr(cg.solve(double_integrator(t_span=(0.0, 1.5), **STEPS[name]), cg.Galerkin(5), 20))


@pytest.mark.slow
def test_a_step_at_a_given_time_with_a_free_duration_is_stated_by_two_phases():
    """The first lasts until the step, and with it the least of 6/T³ + 1 + 1.5 (T - 1) is found."""
    path = cg.solve(
        double_integrator(
            t_span=(0.0, 1.5),
            running_cost=lambda t, x, v, u: u[0] ** 2 / 2 + ca.if_else(t < 1, 1, 1.5),
            breakpoints=[1.0],
            duration_bounds=([1.0, 0.1], [1.0, 5.0]),
        ),
        tol=1e-8,
    )
    assert path.t[-1] == pytest.approx(12**0.25, rel=1e-8)
    assert path.cost == pytest.approx(6 / 12**0.75 + 1.5 * 12**0.25 - 0.5, rel=1e-8)


@pytest.mark.slow
def test_where_the_path_jumps_the_callables_do_not_step():
    """A bounce from a wall, before which a spring acts: the velocity jumps, and with it a component that counts."""
    bounce = double_integrator(
        start=[0.5, 0.0],
        end=[0.3, None],
        start_velocity=[-1.0, None],
        end_velocity=[0.0, None],
        rates=lambda t, x, v, u: 0 * u,
        force=lambda t, x, v, u: u + 5 * ca.if_else(x[0] < 0.2, 0.2 - x[0], 0) * (1 + x[1]),
        waypoints=[(0.5, [0.0, None])],
        jumps=[(0.5, lambda x, v: ([x[0], x[1] + 1], -0.8 * v))],
    )
    path = cg.solve(bounce, tol=1e-5)
    assert may_step(path.problem)
    assert path.between_points.largest_step[0] < 1e-6 * path.cost
