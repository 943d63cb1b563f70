import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, minimum_time

import casadi_galerkin as cg
from casadi_galerkin.control.bends import PARTS, bend_errors, bends, minimizers
from casadi_galerkin.control.better_mesh import better_mesh
from casadi_galerkin.control.error_estimate import HigherDegree
from casadi_galerkin.functional.mapping import at_places

STRENGTH = 1.6


def carried(distance, **changes):
    """From rest to rest within 2 s by a force of at most 1.6, with least ∫u²/2: u bends at `bend` and at 2 - `bend`."""
    fields = {"t_span": (0.0, 2.0), "end": [distance], "running_cost": lambda t, x, v, u: u[0] ** 2 / 2}
    return double_integrator(**fields, control_bounds=(-STRENGTH, STRENGTH), **changes)


def bend(distance):
    return 1 - np.sqrt(3 - 3 * distance / STRENGTH)


def cost(distance):
    return STRENGTH**2 * (1 + 2 * bend(distance)) / 3


def places(distance, times):
    begin = bend(distance)
    early = np.minimum(times, 2 - times)
    since = np.maximum(early - begin, 0)
    half = STRENGTH * (np.minimum(early, begin) ** 2 / 2 + begin * since + since**2 / 2 - since**3 / (6 * (1 - begin)))
    return np.where(times > 1, distance - half, half)


def test_a_control_that_is_off_throughout_does_not_bend():
    """What the solver leaves of it, 1e-10, is at the bound in some places and not in others."""
    spring = double_integrator(
        lagrangian=lambda t, x, v: (v[0] ** 2 - x[0] ** 2) / 2,
        start=[-1.0],
        end=[None],
        end_velocity=[None],
        force=lambda t, x, v, u: u[0] - u[1] - 0.3 * v[0],
        running_cost=lambda t, x, v, u: (u[0] - u[1]) ** 2 / 4 + 0.3 * (u[0] + u[1]),
        terminal_cost=lambda t, x, v: 3 * x[0] ** 2,
        controls=2,
        control_bounds=(0.0, [0.5, 1.5]),
    )
    path = cg.solve(spring, tol=1e-6)
    largest = np.max(path.control.values, axis=1)
    assert largest[1] < 1e-6 < largest[0]
    assert [bend.control for bend in bends(path)] == [0, 0]
    assert len(path.t) <= 12  # 130 with a joint at every other bend


def largest_miss(path):
    return np.max(np.abs(np.vstack(bend_errors(path))))


@pytest.mark.parametrize(
    ("distance", "asked"),
    [
        (1.552, {"tol": 1e-4}),  # bends at 0.005 of an interval, before the first point of both degrees
        (1.552, {"tol": 1e-5}),
        (1.44, {"tol": 1e-7}),
        (1.12, {"tol": 1e-8}),  # IPOPT's own complementarity of 1e-12 would leave more than this of the path
        (1.2166667, {"tol": 1e-9}),
        (1.1973333, {"cost_tol": 1e-6}),
        (1.4486667, {"cost_tol": 1e-6}),
    ],
)
def test_errors_by_bends_are_bounded_by_their_estimates(distance, asked):
    path, times = cg.solve(carried(distance), **asked), np.linspace(0, 2, 4001)
    assert abs(path.cost / cost(distance) - 1) <= max(1.2 * path.cost_error, 1e-11)
    if "tol" in asked:
        error = np.max(np.abs(path(times)[0] - places(distance, times))) / distance
        assert error <= path.error_estimate <= asked["tol"]


def test_what_a_bend_beside_a_joint_hides_is_found_where_it_is():
    """The force leaves its bound shortly after the joint of an interval on which it is at the bound at all points."""
    begin = bend(1.44)
    mesh = np.array([0, begin - 0.01, 0.8, 1.2, 2.01 - begin, 2])
    path, higher = (cg.solve(carried(1.44), cg.Galerkin(degree), mesh=mesh) for degree in (6, 8))
    (of_impulse,), of_cost = np.abs(bend_errors(path)[0]), bend_errors(path)[1]
    assert np.min(of_impulse[[1, 3]]) > 1e-6 > np.max(of_impulse[[0, 2, 4]])
    assert np.min(of_cost[[1, 3]]) > 0 == np.max(of_cost[[0, 2, 4]])
    better = better_mesh(HigherDegree(path, higher), tol=1e-3, cost_tol=1e-8)
    for when in (begin, 2 - begin):
        assert np.min(np.abs(better - when)) < 1e-3 < np.min(np.abs(mesh - when))


@pytest.mark.parametrize("tol", [1e-6, 1e-9])
def test_there_is_a_joint_at_every_bend_so_that_the_mesh_stays_coarse(tol):
    path, begin = cg.solve(carried(1.44), tol=tol), bend(1.44)
    assert len(path.t) <= 12
    for when in (begin, 2 - begin):
        assert np.min(np.abs(path.t - when)) < 1e-4


def test_times_of_bends():
    path, begin = cg.solve(carried(1.44), cg.Galerkin(4), mesh=np.linspace(0, 2, 42)), bend(1.44)
    np.testing.assert_allclose([bend.when for bend in bends(path)], [begin, 2 - begin], atol=5e-5)


def test_a_force_that_passes_between_its_bounds_within_an_interval_bends_twice():
    """In -1 ≤ u ≤ 1 the cost 0.05 u² - u cos(πt) is least at u = 10 cos(πt) or a bound, whatever the path does."""
    passing = double_integrator(
        end=[None],
        end_velocity=[None],
        running_cost=lambda t, x, v, u: 0.05 * u[0] ** 2 - u[0] * ca.cos(np.pi * t),
        control_bounds=(-1.0, 1.0),
    )
    around = np.arccos([0.1, -0.1]) / np.pi
    first, second = bends(cg.solve(passing, cg.Galerkin(4), 3))
    np.testing.assert_allclose([first.when, second.when], around, atol=1e-6)
    assert (first.before, first.after, second.before, second.after) == (1, 0, 0, -1)


def test_a_steep_control_takes_no_fine_mesh():
    """A smoothed cost of fuel, whose curvature varies by 1e8: near a bound one step of Newton's method leads far."""
    fuel = lambda t, x, v, u: ca.sqrt(u[0] ** 2 + 0.004**2) + 0.17 * v[0] ** 2  # noqa: E731
    problem = double_integrator(t_span=(0.0, 1.85), running_cost=fuel, control_bounds=(-5.8, 5.8))
    path = cg.solve(problem, tol=1e-6)
    assert len(path.t) <= 150
    assert path.cost == pytest.approx(cg.solve(problem, cg.Galerkin(3), 400).cost, rel=1e-5)


def test_what_oscillating_impulses_carry_far_is_estimated():
    """The force is clip(1.14 sin(1.9 t), -1, 1), whatever the path, which stays small while impulses add up."""
    height, rate, end = 1.14, 1.9, 24.7
    swung = double_integrator(
        t_span=(0.0, end),
        end=[None],
        start_velocity=[-0.5],
        end_velocity=[None],
        running_cost=lambda t, x, v, u: u[0] ** 2 / 2 - height * ca.sin(rate * t) * u[0],
        control_bounds=(-1.0, 1.0),
    )
    path, times = cg.solve(swung, tol=1e-4), np.linspace(0, end, 400_001)
    middle, step = (times[1:] + times[:-1]) / 2, times[1]
    pushed = np.clip(height * np.sin(rate * middle), -1, 1) * step
    before = -0.5 + np.append(0.0, np.cumsum(pushed)[:-1])
    places = np.append(0.0, np.cumsum(before * step + pushed * step / 2))
    assert np.max(np.abs(path(times)[0] - places)) / path.sizes[0] <= path.error_estimate <= 1e-4


def rated(cost, bounds):
    """A component that follows its control, the rate, for two seconds from zero."""
    ends = [0.0], [None], [None], [None]
    return cg.ControlProblem(
        None,
        (0.0, 2.0),
        *ends,
        force=None,
        rates=lambda t, x, v, u: u,
        running_cost=lambda t, x, v, u: cost(t, u[0]),
        controls=1,
        control_bounds=bounds,
    )


def missed_by(path, rate, count):
    """Largest error of such a path, over its size, by the midpoint rule on so many intervals."""
    times = np.linspace(0, 2, count + 1)
    places = np.append(0.0, np.cumsum(rate((times[1:] + times[:-1]) / 2)) * times[1])
    return np.max(np.abs(path(times)[0] - places)) / path.sizes[0]


def test_a_steep_arc_beside_a_bend_gets_a_finer_mesh():
    """A rate is to follow a narrow peak, by at most one: it meets that bound on both steep sides of the peak."""

    def peak(t):
        return 4 / (1 + ((t - 0.65) / 0.01) ** 2) - 0.2

    path = cg.solve(rated(lambda t, u: u**2 / 2 - peak(t) * u, (-0.5, 1.0)), tol=1e-3, limits=cg.Limits(levels=20))
    assert missed_by(path, lambda t: np.clip(peak(t), -0.5, 1), 400_000) <= path.error_estimate <= 1e-3


def test_a_control_that_leaves_its_bound_like_a_cube_root_is_known():
    """The cost (u + 0.0001)⁴/4 - u sin(3t + 1) is nearly flat at u = 0, where Newton's first step is far too long."""

    def rate(t):
        return np.clip(np.cbrt(np.sin(3 * t + 1)) - 0.0001, 0, 0.8)

    path = cg.solve(rated(lambda t, u: (u + 0.0001) ** 4 / 4 - u * ca.sin(3 * t + 1), (0.0, 0.8)), tol=1e-6)
    assert missed_by(path, rate, 1_000_000) <= path.error_estimate <= 1e-6
    best, _ = minimizers(path)
    np.testing.assert_allclose(best[0], rate(path.polynomial.sampled(PARTS)[0]), atol=1e-6)


def test_a_bend_at_a_joint_is_no_error():
    begin = bend(1.44)
    path = cg.solve(carried(1.44), cg.Galerkin(4), mesh=[0, begin, 1, 2 - begin, 2])
    assert largest_miss(path) < 1e-8
    assert path.cost == pytest.approx(cost(1.44), rel=1e-8)


@pytest.mark.parametrize("strength", [50.0, 4.0, 1.5])
def test_between_the_points_controls_that_act_together_minimize_the_cost(strength):
    """Two coupled forces, of which none, one or both are at a bound in a part of an interval."""
    coupled = lambda t, x, v, u: u[0] ** 2 + u[1] ** 2 + 1.5 * u[0] * u[1] + x[0] ** 2  # noqa: E731
    bounds = {"control_bounds": (-strength, [50.0, strength])}
    problem = double_integrator(force=lambda t, x, v, u: 3 * u[0] + u[1], running_cost=coupled, controls=2, **bounds)
    path = cg.solve(problem, cg.Galerkin(6), 4)
    best, convex = minimizers(path)
    times, x, v, u, *others = path.between_points.along(PARTS)
    slope, size = at_places(path.between_points.integrand, times, x, v, best, *others)[2], np.max(np.abs(best))
    low, high = (np.array(side)[:, None] for side in problem.control_bounds)
    assert np.all((low <= best) & (best <= high) & convex)
    assert np.all(slope[best - low > 1e-9] < 1e-9 * size)
    assert np.all(slope[high - best > 1e-9] > -1e-9 * size)
    if strength == 50.0:
        np.testing.assert_allclose(best, u, atol=1e-5 * size)
        assert largest_miss(path) == 0


def test_controls_without_bounds_held_ones_and_those_that_switch_do_not_bend():
    for problem in (double_integrator(), carried(1.44, hold=True), minimum_time()):
        path = cg.solve(problem, cg.Galerkin(3), 7)
        assert largest_miss(path) < 1e-15
        assert bends(path) == []
