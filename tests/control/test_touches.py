import numpy as np
import pytest
from control_problems import double_integrator
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq, fsolve

import casadi_galerkin as cg
from casadi_galerkin.control.better_mesh import symmetric_about
from casadi_galerkin.control.touches import Touch, touch_error, touch_time, touches

WALL = 0.1


def wall(speed, **changes):
    """A mass that comes with a velocity of -speed, must not pass -0.1, and is to rest at 1."""
    return double_integrator(start_velocity=[-speed], position_bounds=(-WALL, np.inf), **changes)


def touched(speed):
    """The time of the touch, where the acceleration is continuous."""

    def jump(t):
        return 6 * WALL / t**2 - 2 * speed / t - 6 * (1 + WALL) / (1 - t) ** 2

    return brentq(jump, 1e-3, 3 * WALL / speed, xtol=1e-15)


def places(speed, times):
    """Two cubics, which meet at rest at the wall."""
    when = touched(speed)
    early, late = times / when, np.maximum(times - when, 0.0) / (1 - when)
    before = -speed * when * early * (1 - early) ** 2 - WALL * early**2 * (3 - 2 * early)
    return np.where(times < when, before, -WALL + (1 + WALL) * late**2 * (3 - 2 * late))


@pytest.mark.parametrize("speed", [2.0, 3.0, 5.0])
@pytest.mark.parametrize("tol", [1e-4, 1e-6, 1e-9])
def test_a_touch_gets_a_joint_and_no_finer_mesh(speed, tol):
    path, times = cg.solve(wall(speed), tol=tol), np.linspace(0, 1, 20001)
    assert np.max(np.abs(path(times)[0] - places(speed, times))) <= path.error_estimate <= tol
    assert len(path.t) <= 12


@pytest.mark.parametrize("tol", [1e-4, 1e-5, 1e-7])  # with even and odd numbers of points
def test_a_path_constraint_that_is_touched_acts_on_both_sides_of_a_joint(tol):
    """With a joint elsewhere it acted at one point near by; errors were 7 and 600 times their estimates."""
    speed, times = 2.0, np.linspace(0, 1, 20001)
    above = (lambda t, x, v, u: x, -WALL, np.inf)
    path = cg.solve(double_integrator(start_velocity=[-speed], path_constraint=above), tol=tol)
    assert np.max(np.abs(path(times)[0] - places(speed, times))) <= path.error_estimate <= tol
    assert len(path.t) <= 20


@pytest.mark.parametrize(
    ("form", "tol", "speed", "wall"),
    [
        ("position_bounds", 1e-7, 5.0881955919992565, 1.1400564114391583),
        ("position_bounds", 1e-6, 3.4078044626103243, 0.9274403044547828),
        ("path_constraint", 1e-7, 5.632980426138671, 1.2126517332377627),
    ],
)
def test_an_excess_between_all_samples_is_seen(form, tol, speed, wall):
    """On the first mesh the free path exceeds the bound by 1e-6 to 1e-5, and at no node, point or sample."""
    bounds = {
        "position_bounds": {"position_bounds": (-np.inf, wall)},
        "path_constraint": {"path_constraint": (lambda t, x, v, u: x, -np.inf, wall)},
    }
    throw = double_integrator(end=[0.0], start_velocity=[4.0], end_velocity=[-speed], **bounds[form])
    path = cg.solve(throw, tol=tol)
    assert np.max(path(np.linspace(0, 1, 20001))) / wall - 1 <= path.error_estimate <= tol


@pytest.mark.parametrize("tol", [1e-4, 1e-5, 1e-6])
def test_a_touch_that_is_late_changes_a_free_duration(tol):
    """Its error was twice the tolerance, when only that of the path counted."""
    drop = double_integrator(
        start=[-0.8920465935768263],
        end=[-0.6436850728334991],
        start_velocity=[-2.4610560903943046],
        end_velocity=[2.204130891912202],
        running_cost=lambda t, x, v, u: 438.95468075455364 + u**2 / 2,
        position_bounds=(-0.9117641524208709, np.inf),
        duration_bounds=(0.02, 20.0),
        waypoints=[(0.5, [-0.7678668332051627])],
        breakpoints=(0.5,),
    )
    path = cg.solve(drop, tol=tol)
    assert abs(path.t[-1] / 0.1914951500 - 1) <= path.error_estimate <= tol


def test_what_the_solver_leaves_at_a_joint_is_no_square_root():
    """At the middle, the joint of any even mesh, the bound is exceeded by some 1e-12."""
    swing = double_integrator(end=[0.0], start_velocity=[1.0], end_velocity=[-1.0], position_bounds=(-np.inf, 0.2))
    path = cg.solve(swing, tol=1e-9)
    assert path.cost == pytest.approx(2.24, rel=1e-10)
    assert len(path.t) == 9


def test_a_bound_acts_where_the_path_is_nearest_once_there_is_a_joint():
    speed = 2.0
    coarse, fine = (
        cg.solve(wall(speed), cg.Galerkin(7), mesh=mesh)
        for mesh in (np.linspace(0, 1, 9), [0.0, touched(speed), 0.5, 1.0])
    )
    (first,), (second,) = touches(coarse), touches(fine)
    assert abs(first.acts - first.extreme) > 1e-4
    assert first.error > 1e-3
    assert second.extreme == pytest.approx(touched(speed), abs=1e-11)
    assert second.error < 1e-9


@pytest.mark.parametrize(
    "problem",
    [
        wall(0.1),  # it turns before the wall
        double_integrator(position_bounds=(-1.0, 1.0)),  # the end is on the bound
        double_integrator(end=[0.0], start_velocity=[1.0], end_velocity=[-1.0], position_bounds=(-np.inf, 0.1)),
        double_integrator(waypoints=[(0.5, [0.9])], breakpoints=(0.5,), position_bounds=(-1.0, 2.0)),
        double_integrator(path_constraint=(lambda t, x, v, u: v, -2.0, 1.4)),  # bounds of velocities are not touched
    ],
)
def test_free_paths_and_those_along_a_bound_touch_none(problem):
    assert touches(cg.solve(problem, cg.Galerkin(5), 8)) == []


@pytest.mark.parametrize(
    ("mesh", "fixed", "expected"),
    [
        ([0.0, 0.1, 0.5, 0.8, 1.0], [0.5], [0.0, 0.2, 0.5, 0.8, 1.0]),  # the other end of the longer interval is moved
        ([0.0, 0.1, 0.5, 0.8, 1.0], [0.1, 0.5], [0.0, 0.1, 0.35, 0.5, 0.65, 0.8, 1.0]),
        ([0.0, 0.3, 0.5, 1.0], [0.5], [0.0, 0.3, 0.5, 0.7, 1.0]),
        ([0.0, 0.5 + 1e-16, 1.0], [0.5 + 1e-16], [0.0, 0.25, 0.5, 0.75, 1.0]),  # rounding makes no short intervals
    ],
)
def test_intervals_beside_a_touch_get_one_length(mesh, fixed, expected):
    times = [mesh[int(np.argmin(np.abs(np.array(mesh) - 0.5)))]]
    np.testing.assert_allclose(symmetric_about(np.array(mesh), times, fixed), expected, rtol=1e-14)


@pytest.mark.parametrize("slope", [-1.5, -0.1, 0.4])
def test_two_paths_give_the_fixed_point_of_a_line(slope):
    def touch(acts):
        return Touch(0, acts, 0.3 + slope * (acts - 0.3), 0.1, 0.2)

    assert touch_time(touch(0.32), [touch(0.29)]) == pytest.approx(0.3)


def test_where_the_extreme_hardly_depends_on_when_the_bound_acts_the_error_is_small():
    own, other = Touch(0, 0.32, 0.30, 0.1, 0.2), Touch(0, 0.33, 0.30001, 0.1, 0.2)
    assert touch_error(own, [other]) == pytest.approx(2e-4)
    assert touch_error(own, [Touch(0, 0.33, 0.27, 0.1, 0.2)]) == touch_error(own, []) == 0.1


def test_without_another_path_at_another_time_the_bound_is_to_act_half_way():
    own = Touch(0, 0.32, 0.30, 0.1, 0.2)
    for others in (
        [],
        [own],
        [Touch(1, 0.31, 0.3, 0.1, 0.2)],
        [Touch(0, 0.35, 0.3299, 0.1, 0.2)],
    ):  # the last secant leads far
        assert touch_time(own, others) == pytest.approx(0.31)


RESTITUTION = 0.6
CEILING = 0.56


def bounce():
    """A ball is thrown up to a ceiling and falls on the floor at 0.5, the cubics before and behind it."""

    def cubics(unknowns):
        touch, speed = unknowns
        before = CubicHermiteSpline([0, touch, 0.5], [0.5, CEILING, 0], [1.5, 0, speed])
        return before, CubicHermiteSpline([0.5, 1], [0, 0.3], [-RESTITUTION * speed, -1])

    def residuals(unknowns):
        (cube, square), after = cubics(unknowns)[0].c[:2], cubics(unknowns)[1].c[1, 0]
        at_touch, at_floor = square + 3 * cube * (unknowns[0], 0.5 - unknowns[0])
        return at_touch - square[1], at_floor + RESTITUTION * after

    return cubics(fsolve(residuals, (0.09, -2.1), xtol=1e-14))


@pytest.mark.parametrize("quadrature", [cg.gauss(4), cg.radau(4), cg.lobatto(5)])
@pytest.mark.parametrize(
    "ceiling",
    [
        {"position_bounds": (-np.inf, CEILING)},
        {"path_constraint": (lambda t, x, v, u: x, -np.inf, CEILING)},
    ],
)
@pytest.mark.parametrize("tol", [1e-5, 1e-7])
def test_a_path_that_jumps_touches_between_the_jumps(quadrature, ceiling, tol):
    """Without joints at these touches, errors were up to three times the tolerance, on hundreds of intervals."""
    before, after = bounce()
    throw = double_integrator(
        start=[0.5],
        end=[0.3],
        start_velocity=[1.5],
        end_velocity=[-1.0],
        waypoints=[(0.5, [0.0])],
        jumps=[(0.5, lambda x, v: (x, -RESTITUTION * v))],
        **ceiling,
    )
    path, times = cg.solve(throw, cg.Galerkin(4, quadrature=quadrature), tol=tol), np.linspace(0, 1, 20001)
    exact = np.where(times < 0.5, before(times), after(times))
    assert np.max(np.abs(path(times)[0] - exact)) <= path.error_estimate * CEILING <= tol * CEILING
    assert len(path.t) <= 32


def limited_speed(most, last):
    """The speed of a mass that moves by 1, to a speed of `last`: quartics before and behind the touch of `most`."""

    def coefficients(touch):
        after = 1 - touch
        powers = np.arange(2, 5)
        early, late = touch**powers, after**powers
        none = np.zeros(3)
        equations = [
            [*early, *none],  # it is `most` at the touch
            [*(powers * early / touch), *none],  # and does not change there
            [2, 6 * touch, 12 * touch**2, -2, 0, 0],  # its second derivative, the control, is continuous
            [0, 0, 1, 0, 0, -1],  # the costate of the position is constant
            [*none, *late],
            [*(early * touch / (powers + 1)), *(late * after / (powers + 1))],
        ]
        return np.linalg.solve(equations, [most, 0, 0, 0, last - most, 1 - most * after])

    def slope_at_end(touch):
        return float(coefficients(touch)[3:] @ (np.arange(2, 5) * (1 - touch) ** np.arange(1, 4)))

    touch = brentq(slope_at_end, 0.47, 0.53, xtol=1e-15)
    early, late = np.split(coefficients(touch), 2)
    return touch, np.poly1d([*early[::-1], 0, 0]), np.poly1d([*late[::-1], 0, most])


@pytest.mark.parametrize("last", [1e-4, -3e-3])
@pytest.mark.parametrize("tol", [1e-4, 1e-5])
@pytest.mark.parametrize("method", [None, cg.Galerkin(4)], ids=str)
def test_a_limit_of_a_velocity_whose_force_lags_is_touched(last, tol, method):
    """Both degrees acted at the joint in the middle: errors were up to 60 times their estimates."""
    touch, early, late = limited_speed(1.75, last)
    lagging = double_integrator(
        start=[0.0, 0.0],
        end=[1.0, 0.0],
        start_velocity=[0.0, None],
        end_velocity=[last, None],
        force=lambda t, x, v, u: x[1],
        rates=lambda t, x, v, u: u,
        path_constraint=(lambda t, x, v, u: v[0], -np.inf, 1.75),
    )
    path, times = cg.solve(lagging, method, tol=tol), np.linspace(0, 1, 2001)
    before, after = np.minimum(times, touch), np.maximum(times - touch, 0.0)
    places = early.integ()(before) + late.integ()(after)
    forces = np.where(times < touch, early.deriv()(before), late.deriv()(after))
    errors = np.abs(path(times) - [places, forces]) / np.max(np.abs([places, forces]), axis=1)[:, None]
    assert np.max(errors) <= path.error_estimate <= tol
