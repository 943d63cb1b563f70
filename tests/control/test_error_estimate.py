"""The estimated error of an optimization is twice a sharp one, on a smooth path, and covers what points do not see."""

from contextlib import suppress

import casadi as ca
import numpy as np
import pytest
from control_problems import cart_pole, double_integrator, first_order, plane, resolved, true_error
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.control.two_comparisons import SAFETY


@pytest.mark.parametrize(("degree", "tol"), [(4, 1e-2), (5, 1e-4)])
@pytest.mark.slow
def test_estimate_is_twice_a_sharp_one_on_a_smooth_path(degree, tol):
    path = cg.solve(cart_pole(), cg.Galerkin(degree), tol=tol)
    assert path.method.degree == degree
    ratio = path.error_estimate / true_error(path, *resolved(cart_pole))
    assert 0.8 < ratio / SAFETY < 1.5


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


@pytest.mark.parametrize(("degree", "tol"), [(3, 1e-4), *slow((5, 1e-4))])
@pytest.mark.slow
def test_estimate_covers_the_error_where_the_phases_are_free(degree, tol):
    """Positions at the same parts of a phase differ by half as much as those at the same time."""
    path = cg.solve(over_bumps(), cg.Galerkin(degree), tol=tol)
    ratio = path.error_estimate / true_error(path, *resolved(over_bumps))
    assert 1 < ratio < 1.5 * SAFETY


def two_rates(running_cost):
    """Two components whose rates are the controls, from (1, 1) to (0, 1/2)."""
    ends = {"start": [1.0, 1.0], "end": [0.0, 0.5], "start_velocity": [None] * 2, "end_velocity": [None] * 2}
    return first_order(controls=2, running_cost=running_cost, **ends)


@pytest.mark.parametrize("weight", [1.0, 1e-6, 1e-12])
@pytest.mark.slow
def test_estimate_is_twice_a_sharp_one_where_a_component_hardly_counts_in_the_cost(weight):
    """It leaves its ends within 0.03.  An optimizer stops long before it knows where, by any tolerance of the slope.

    Begun at the path found, it stops there with the higher degree as well: that estimates 4e-14 for an error of 1e-4.
    """
    width = 0.03
    task = two_rates(lambda t, x, v, u: (u[0] ** 2 + x[0] ** 2 + weight * ((width * u[1]) ** 2 + x[1] ** 2)) / 2)
    path, t = cg.solve(task, tol=1e-5), np.linspace(0.0, 1.0, 2001)
    exact = (np.sinh((1 - t) / width) + 0.5 * np.sinh(t / width)) / np.sinh(1 / width)
    error = np.max(np.abs(path(t)[1] - exact))
    assert 0.8 < path.error_estimate / error / SAFETY < 1.5


@pytest.mark.slow
def test_a_path_that_the_cost_does_not_determine_is_refused_and_its_cost_is_known():
    """The cost knows y = x_1 + x_2 alone, (∫ y'² + y² dt)/2, and not the difference."""
    task = two_rates(lambda t, x, v, u: ((u[0] + u[1]) ** 2 + (x[0] + x[1]) ** 2) / 2)
    with pytest.raises(
        cg.LimitReached,
        match=r"only the path changes: the cost is known to \de-1\d, .* of=lambda path: path\.cost asks",
    ):
        cg.solve(task, tol=1e-5, limits=cg.Limits(intervals=20))
    cost = ((2**2 + 0.5**2) * np.cosh(1) - 2 * 2 * 0.5) / np.sinh(1) / 2
    assert abs(cg.solve(task, tol=1e-5, of=lambda path: path.cost).cost / cost - 1) < 1e-12


@pytest.mark.slow
def test_a_duration_that_the_cost_hardly_knows_is_not_called_known():
    """It is 2 up to a fourth power; solved from where it had come to, a higher degree came to the same one."""
    task = double_integrator(
        t_span=(0.0, 1.5),
        end=[None],
        end_velocity=[None],
        running_cost=lambda t, x, v, u: (u[0] - 1) ** 2 + 1,
        terminal_cost=lambda t, x, v: (x[0] - 2) ** 4 - t + 1,
        duration_bounds=(0.5, 6.0),
    )
    path = cg.solve(task, tol=1e-4)
    assert abs(path.t[-1] / 2 - 1) <= path.error_estimate
    with pytest.raises(
        cg.LimitReached,
        match=r"only the path changes: the cost is known to \de-\d+, .* of=lambda path: path\.cost asks",
    ):
        cg.solve(task, tol=1e-6, limits=cg.Limits(intervals=20))


@pytest.mark.parametrize(("tol", "most"), [(1e-4, 20), *slow((1e-6, 50))])
@pytest.mark.slow
def test_a_bound_of_a_component_whose_rate_is_controlled_needs_no_square_root(tol, most):
    """Least ∫ (u² / 2 - 4 x) dt with dx/dt = u and x below a cap, where the path a t - 2 t² arrives at rest."""
    cap = 0.3
    rise, arrival = np.sqrt(8 * cap), np.sqrt(8 * cap) / 4
    problem = first_order(end=[0.0], running_cost=lambda t, x, v, u: u**2 / 2 - 4 * x, position_bounds=(-np.inf, cap))
    path, times = cg.solve(problem, tol=tol), np.linspace(0, 1, 1001)
    after = np.minimum(np.minimum(times, 1 - times), arrival)
    error = np.max(np.abs(path(times)[0] - (rise * after - 2 * after**2))) / cap
    assert error <= path.error_estimate <= tol
    assert len(path.t) <= most


@pytest.mark.parametrize(
    ("cap", "asked"), [(0.165817, {"tol": 5.7e-3, "of": lambda path: path.cost}), *slow((0.16596, {"tol": 6.3e-4}))]
)
def test_a_bound_that_is_touched_for_a_short_time_at_a_joint_is_seen_to_be_exceeded(cap, asked):
    """Bryson and Denham's problem, where 4 / (9 cap) is the least cost; the arc at the bound is 1 - 6 cap long."""
    problem = double_integrator(
        end=[0.0],
        start_velocity=[1.0],
        end_velocity=[-1.0],
        running_cost=lambda t, x, v, u: u**2 / 2,
        position_bounds=(-np.inf, cap),
    )
    path = cg.solve(problem, **asked)
    assert abs(path.cost / (4 / (9 * cap)) - 1) <= 2 * path.cost_error
    assert np.max(path(np.linspace(0, 1, 40001))) / cap - 1 <= path.error_estimate


@pytest.mark.slow
@pytest.mark.parametrize(("cap", "asked"), [(0.8, 1e-6)])
def test_what_a_bound_of_a_first_order_component_is_exceeded_by_counts_in_the_cost(cap, asked):
    """Held at the points of Gauss in place of the nodes, the same bound gives the same cost."""
    late = lambda t, x, v, u: (u**2 + 10 * (x - ca.sin(t)) ** 2) / 2  # noqa: E731
    follows = {"t_span": (0.0, 3.0), "end": [0.0], "running_cost": late}
    least = cg.solve(
        first_order(**follows, path_constraint=(lambda t, x, v, u: x, -np.inf, cap)),
        tol=1e-7,
        of=lambda path: path.cost,
    )
    path = cg.solve(first_order(**follows, position_bounds=(-np.inf, cap)), tol=asked, of=lambda path: path.cost)
    assert abs(path.cost / least.cost - 1) <= path.cost_error + least.cost_error
    assert path.cost_error <= asked


@pytest.mark.slow
def test_a_path_constraint_of_no_values_limits_nothing():
    """As of a program that has found no obstacles."""
    path = cg.solve(double_integrator(path_constraint=(lambda t, x, v, u: [], 0, 1)), tol=1e-5)
    assert path.cost == pytest.approx(cg.solve(double_integrator(), tol=1e-5).cost, rel=1e-9)


@pytest.mark.parametrize(
    ("width", "when", "height", "asked"),
    [
        (0.0083, 0.3658, 0.42, {"tol": 1.4e-4, "of": lambda path: path.cost}),
        *slow((0.00115, 0.2827, 1.19, {"tol": 1e-4, "of": lambda path: path.cost})),
    ],
)
@pytest.mark.slow
def test_an_obstacle_narrower_than_the_points_are_apart_counts_in_the_cost(width, when, height, asked):
    """One point of the path meets it, and it rises between the points.  To pass at its height costs almost as much."""
    bump = lambda t, x, v, u: x[0] - height * ca.exp(-(((t - when) / width) ** 2))  # noqa: E731
    path = cg.solve(double_integrator(end=[0.0], path_constraint=(bump, -1e-9, np.inf)), **asked)
    least = cg.solve(double_integrator(end=[0.0], waypoints=[(when, [(height, np.inf)])]), cg.Galerkin(3), 10).cost
    assert 1 - path.cost / least <= 1.2 * path.cost_error
    assert path.cost_error <= asked["tol"]


@pytest.mark.slow
def test_a_path_constraint_that_is_not_finite_at_an_end_does_not_stop_the_refinement():
    """A glide slope down to the origin, where it is zero over zero."""
    glide = plane(
        t_span=(0.0, 1.0),
        start=[2.0, 1.0],
        end=[0.0, 0.0],
        start_velocity=[0.0, -1.0],
        end_velocity=[None, None],
        path_constraint=(lambda t, x, v, u: x[1] / x[0], 0.4, np.inf),
    )
    path = cg.solve(glide, tol=1e-6, of=lambda path: path.cost)
    assert path.cost_error <= 1e-6
    assert np.all(path.x[1, :-1] >= 0.4 * path.x[0, :-1] - 1e-6)


@pytest.mark.slow
def test_a_pole_that_no_quadrature_point_meets_is_passed():
    """Its squared distance is exceeded by the square of its radius, which is small beside that of the path."""
    radius, where = 1.2, 45.5
    distance = lambda t, x, v, u: (x[0] - where) ** 2 + (x[1] - 0.01) ** 2  # noqa: E731
    flight = plane(t_span=(0.0, 20.0), end=[100.0, 0.0], path_constraint=(distance, radius**2, np.inf))
    exact, *paths = (
        cg.solve(flight, tol=tol, of=of)
        for tol, of in ((1e-6, lambda path: path.cost), (1e-3, None), (1e-3, lambda path: path.cost))
    )
    for path in paths:
        nearest = np.min(np.hypot(*(path(np.linspace(0, 20, 20001)) - [[where], [0.01]])))
        assert nearest > 0.98 * radius
        assert abs(path.cost / exact.cost - 1) <= path.cost_error <= 1e-3


@pytest.mark.parametrize("asked", [{"tol": 1e-2}, {"tol": 1e-3, "of": lambda path: path.cost}], ids=list)
@pytest.mark.slow
def test_a_wall_thinner_than_an_interval_is_not_flown_through(asked):
    """An ellipse: to move along the path changes its distance most, and does not help."""
    wall = lambda t, x, v, u: ((x[0] - 0.53) / 0.005) ** 2 + ((x[1] - 0.03) / 0.1) ** 2  # noqa: E731
    flight = plane(t_span=(0.0, 1.0), path_constraint=(wall, 1.0, np.inf))
    with suppress(cg.LimitReached):
        path = cg.solve(flight, limits=cg.Limits(seconds=3), **asked)
        assert path.cost == pytest.approx(6.472, rel=2e-2)


@pytest.mark.slow
def test_an_impulse_shorter_than_the_distance_of_the_first_point_is_seen():
    """The speed is 0.0024 off the singular arc x' = -x.  Both degrees reached it within an instant, at a cost of x²/2.

    The errors were estimated to be 6e-10 of the path, with a true one of 1.2e-5, and 1e-14 of the cost, with 4.5e-8.
    """
    x, v, late = -0.435, 0.4374, 3.5
    problem = double_integrator(
        t_span=(0.0, late),
        start=[x],
        start_velocity=[v],
        end=[None],
        end_velocity=[None],
        running_cost=lambda t, x, v, u: (x[0] ** 2 + v[0] ** 2) / 2,
        terminal_cost=lambda t, x, v: x[0] ** 2 / 2,
        control_bounds=(-1.0, 1.0),
    )
    path, t = cg.solve(problem, tol=1e-6), np.linspace(0.0, late, 20001)
    arrival = v - 1 + np.sqrt((v - 1) ** 2 + 2 * (x + v))  # on the arc, with u = -1
    braked = np.minimum(t, arrival)
    exact = (x + v * braked - braked**2 / 2) * np.exp(braked - t)
    error = np.max(np.abs(path(t)[0] - exact)) / np.max(np.abs(exact))
    assert error < min(1e-6, 2 * path.error_estimate)


@pytest.mark.slow
def test_a_force_that_an_overshoot_of_its_control_leaves_undefined_does_not_stop_the_refinement():
    """u^1.5 is not a number where the polynomial of u is below zero, beside the jump inside an interval."""
    start, end = 0.0236, 0.4505
    problem = double_integrator(
        force=lambda t, x, v, u: u[0] ** 1.5 - u[1] ** 1.5,
        running_cost=lambda t, x, v, u: 1.0,
        controls=2,
        control_bounds=(0.0, 1.0),
        duration_bounds=(0.5, 5.0),
        start_velocity=[start],
        end_velocity=[end],
    )
    path = cg.solve(problem, tol=1e-4)
    fastest = np.sqrt(1 + (start**2 + end**2) / 2)
    assert abs(path.cost / (2 * fastest - start - end) - 1) <= path.cost_error <= 1e-4


@pytest.mark.parametrize("tol", [1e-4, 1e-6])
def test_a_fit_without_residual_needs_no_finer_mesh_than_others(tol):
    """The least cost is zero, and errors relative to that of a discrete path did not fall with the mesh."""
    fit = double_integrator(
        lagrangian=lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * x[0] ** 2 / 2,
        t_span=(0.0, 3.0),
        start=[None],
        end=[None],
        start_velocity=[None],
        end_velocity=[None],
        force=lambda t, x, v, u, p: u,
        running_cost=lambda t, x, v, u, p: (x[0] - ca.cos(2 * t)) ** 2 + u[0] ** 2 / 100,
        parameters=[1.0],
        parameter_bounds=(0.1, 20.0),
    )
    path = cg.solve(fit, tol=tol)
    assert path.parameters[0] == pytest.approx(4.0, rel=tol)
    assert len(path.t) <= 17
    assert path.cost < 1e-12


@pytest.mark.slow
def test_an_offset_of_the_path_does_not_hide_errors_of_the_cost():
    """A curve around 7000 is followed as one around zero is, with the same errors."""

    def followed(offset):
        return double_integrator(
            t_span=(0.0, 1.0),
            start=[offset + 0.1],
            end=[offset - 0.1],
            running_cost=lambda t, x, v, u: (x[0] - offset - ca.sin(8 * t) / 10) ** 2 + u[0] ** 2 / 1e4,
            control_bounds=(-4.0, 4.0),
        )

    true = cg.solve(followed(0.0), tol=1e-7, of=lambda path: path.cost).cost
    path = cg.solve(followed(7000.0), tol=1e-5, of=lambda path: path.cost)
    assert abs(path.cost / true - 1) < min(1e-5, 2 * path.cost_error)
