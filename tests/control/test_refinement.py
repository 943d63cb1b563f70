"""Control problems solved to a tolerance: the true error is below it, whatever the mesh to begin with."""

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from control_problems import (
    FRACTIONS,
    cart_pole,
    double_integrator,
    first_order,
    minimum_time,
    pendulum,
    plane,
    resolved,
    true_error,
)
from paths import script
from scipy.optimize import fsolve, minimize_scalar
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.control.control_refinement import ControlRefinement, fits_any_mesh
from casadi_galerkin.control.control_transcription import ControlTranscription

ROUNDED = 1e-12  # of a cost: IPOPT's tolerance


def late_start(velocity=-0.3):
    """Minimum time with a velocity at the start: the jump falls on no joint of an equal mesh."""
    return double_integrator(
        start_velocity=[velocity],
        running_cost=lambda t, x, v, u: 1,
        control_bounds=(-1.0, 1.0),
        duration_bounds=(0.1, 10.0),
    )


def fastest(velocity):
    """Full thrust until s, then full brake until v + 2 s: the way is 1."""
    s = -velocity + np.sqrt(1 + velocity**2 / 2)
    duration = velocity + 2 * s
    t = FRACTIONS * duration
    way = np.where(t < s, velocity * t + t**2 / 2, 1 - (duration - t) ** 2 / 2)
    return duration, way[None, :]


def exact_effort():
    return 6.0, (3 * FRACTIONS**2 - 2 * FRACTIONS**3)[None, :]


def exact_obstacle():
    """Straight on in x; in y a cubic from rest at 0 to rest at -0.2 at half time, and its mirror image."""
    s = 2 * np.minimum(FRACTIONS, 1 - FRACTIONS)
    return 6 + 12 * 0.2**2 * 8, along_obstacle(s)


def along_obstacle(s):
    """With u_y free at the touch: y'' is linear on each half, y = -d (3 s² - 2 s³)."""
    return np.stack((3 * FRACTIONS**2 - 2 * FRACTIONS**3, -0.2 * (3 * s**2 - 2 * s**3)))


def two_masses_on_a_spring():
    """Pushed at one of them, from rest to rest in minimum time."""
    return plane(
        lagrangian=lambda t, x, v: ca.dot(v, v) / 2 - (x[0] - x[1]) ** 2 / 2,
        t_span=(0.0, 3.0),
        end=[1.0, 1.0],
        force=lambda t, x, v, u: [u[0], 0],
        running_cost=lambda t, x, v, u: 1,
        controls=1,
        control_bounds=(-1.0, 1.0),
        duration_bounds=(0.5, 20.0),
    )


def fastest_on_a_spring():
    """Duration T with u = 1, -1, 1, -1 and switches at T/2 - a, T/2, T/2 + a: the way is 1, the spring ends at rest."""
    omega = np.sqrt(2)

    def missed(unknowns):
        duration, a = unknowns
        left = duration - np.array([0.0, duration / 2 - a, duration / 2, duration / 2 + a, duration])
        signs = np.array([1.0, -1.0, 1.0, -1.0])
        return signs @ -np.diff(left**2) / 4 - 1, signs @ np.diff(np.cos(omega * left))

    return fsolve(missed, [4.0, 1.0], xtol=1e-14)[0]


SCENES = {
    "effort": (double_integrator, exact_effort),
    "minimum time": (minimum_time, lambda: fastest(0.0)),
    "minimum time, moving": (late_start, lambda: fastest(-0.3)),
    "pendulum in 3": (lambda: pendulum(3.0), lambda: resolved(pendulum, 3.0)),
    "pendulum in 5": (lambda: pendulum(5.0), lambda: resolved(pendulum, 5.0)),
    "cart-pole": (cart_pole, lambda: resolved(cart_pole)),
}
SMOOTH = ("effort", "pendulum in 3", "pendulum in 5", "cart-pole")
CASES = [(name, tol) for name in SCENES for tol in (1e-3, 1e-8 if name in SMOOTH else 1e-6)]


@cache
def found(name, tol):
    return cg.solve(SCENES[name][0](), tol=tol, intervals=7)


@pytest.mark.parametrize(("name", "tol"), CASES[::2] + slow(*CASES[1::2]))
def test_true_error_is_below_the_tolerance(name, tol):
    path = found(name, tol)
    assert path.error_estimate <= tol
    assert true_error(path, *SCENES[name][1]()) <= tol


@pytest.mark.slow
def test_three_switches_are_found_to_a_tight_tolerance():
    tol = 1e-8
    path, duration = cg.solve(two_masses_on_a_spring(), tol=tol), fastest_on_a_spring()
    assert path.error_estimate <= tol
    assert abs(path.cost / duration - 1) <= max(path.cost_error, 1e-11)


@pytest.mark.slow
def test_obstacle_is_passed_below_at_the_exact_cost():
    tol, module = 1e-4, script("obstacle")
    path = cg.solve(module.problem(), tol=tol, guess=lambda t: [t, -0.8 * t * (1 - t)])
    assert path.error_estimate <= tol
    assert exact_obstacle()[0] == pytest.approx(module.EXACT, rel=1e-14)
    assert true_error(path, *exact_obstacle()) <= tol


@pytest.mark.parametrize(("stiffness", "drag", "speed", "price"), [(1.0, 0.5, 1.0, 0.1), *slow((2.5, 0.2, 1.7, 0.6))])
@pytest.mark.slow
def test_periodic_ends_may_lie_where_a_component_turns(stiffness, drag, speed, price):
    """There x[1] is zero at both ends: what the condition compares is rounding, and was once called violated."""
    follow = first_order(
        t_span=(0.0, 2 * np.pi / speed),
        start=[None] * 2,
        end=[None] * 2,
        start_velocity=[None] * 2,
        end_velocity=[None] * 2,
        rates=lambda t, x, v, u: [x[1], u[0] - stiffness * x[0] - drag * x[1]],
        running_cost=lambda t, x, v, u: ((x[0] - ca.cos(speed * t)) ** 2 + price * u[0] ** 2) / 2,
        end_conditions=(lambda x0, v0, x1, v1: x1 - x0, 0.0, 0.0),
    )
    path = cg.solve(follow, tol=1e-6)
    response = 1 / ((stiffness - speed**2) ** 2 + (drag * speed) ** 2)
    assert path.cost == pytest.approx(np.pi / (2 * speed) * price / (price + response), rel=1e-10)
    assert len(path.t) == 9


@pytest.mark.slow
def test_times_that_are_rounded_too_much_are_told():
    late = double_integrator(t_span=(1.7e9, 1.7e9 + 2), running_cost=lambda t, x, v, u: u**2 + (x - ca.sin(t)) ** 2)
    with pytest.raises(cg.LimitReached, match=r"Times near 1.7e\+09 are rounded by 4e-07: count them from the start"):
        cg.solve(late, tol=1e-8, limits=cg.Limits(seconds=20))


@pytest.mark.slow
def test_a_path_that_a_coarse_mesh_does_not_determine_may_be_known_on_a_finer_one():
    """Least time with a speed limit at the points: on the first meshes controls alternate along it."""
    drive = double_integrator(
        t_span=(0.0, 4.0),
        end=[2.6],
        start_velocity=[0.1],
        end_velocity=[0.3],
        running_cost=lambda t, x, v, u: 1,
        control_bounds=(-2.1, 1.2),
        path_constraint=(lambda t, x, v, u: v, -0.7, 0.7),
        duration_bounds=(0.02, 60.0),
    )
    path = cg.solve(drive, tol=1e-6)
    cruise = 2.6 - (0.7**2 - 0.1**2) / (2 * 1.2) - (0.7**2 - 0.3**2) / (2 * 2.1)
    assert path.cost == pytest.approx(0.6 / 1.2 + 0.4 / 2.1 + cruise / 0.7, rel=1e-6)


def wall():
    """A mass that comes with velocity -2 and must not pass -0.1: it touches there once."""
    return double_integrator(start_velocity=[-2.0], position_bounds=(-0.1, np.inf))


def touching(t):
    """Least cost with the touch at t: two cubics, by 6 d²/T³ - 6 d v/T² + 2 v²/T each."""
    return 6 * 0.1**2 / t**3 - 6 * 0.1 * 2 / t**2 + 2 * 2**2 / t + 6 * 1.1**2 / (1 - t) ** 3


def wall_cost():
    return minimize_scalar(touching, bounds=(0.01, 0.4), method="bounded", options={"xatol": 1e-10}).fun


@pytest.mark.parametrize(("intervals", "tol"), [(7, 1e-3), *slow((8, 1e-5))])
@pytest.mark.slow
def test_a_bound_of_the_position_is_touched_at_the_exact_cost(intervals, tol):
    path = cg.solve(wall(), tol=tol, intervals=intervals)
    assert path.error_estimate <= tol
    assert path.cost == pytest.approx(wall_cost(), rel=tol / 10)  # of second order in the time of the touch


@pytest.mark.slow
def test_a_loose_tolerance_takes_less_work():
    loose, tight = (cg.solve(pendulum(3.0), tol=tol) for tol in (1e-3, 1e-8))
    assert len(loose.polynomial.values[0]) < len(tight.polynomial.values[0])
    assert loose.error_estimate > tight.error_estimate


@pytest.mark.parametrize(
    ("name", "tol"),
    [
        ("pendulum in 5", 1e-3),
        *slow(("minimum time, moving", 1e-3), ("minimum time, moving", 1e-7), ("cart-pole", 1e-3)),
    ],
)
def test_tolerance_of_the_cost_alone_bounds_its_error_with_fewer_unknowns(name, tol):
    make, known = SCENES[name]
    path, whole = cg.solve(make(), tol=tol, of=lambda path: path.cost, intervals=7), found(name, tol)
    assert path.cost_error <= tol
    assert abs(path.cost / known()[0] - 1) <= tol
    assert len(path.polynomial.values[0]) <= len(whole.polynomial.values[0])
    assert whole.cost_error <= whole.error_estimate <= tol
    assert path.error_estimate >= true_error(path, *known()) / 2
    assert f"{path.cost_error:.1e} of the cost, {path.error_estimate:.1e} of the path" in repr(path)


@pytest.mark.slow
def test_a_mesh_for_the_cost_alone_does_not_resolve_a_singular_arc():
    """Two catalysts are mixed over twelve hours; a mesh for as small an error of the path has 500 intervals at once."""
    mixing = cg.ControlProblem(
        t_span=(0.0, 12.0), start=[1.0, 0.0],
        controls=1,
        terminal_cost=lambda t, x, v: x[0] + x[1] - 1,
        control_bounds=(0.0, 1.0),
        rates=lambda t, x, v, u: [u[0] * (10 * x[1] - x[0]), u[0] * (x[0] - 10 * x[1]) - (1 - u[0]) * x[1]],
    )  # fmt: skip
    path = cg.solve(mixing, tol=1e-4, of=lambda path: path.cost, limits=cg.Limits(intervals=250))
    assert path.cost == pytest.approx(-0.4777115, rel=1e-4)  # by collocation on 200 intervals
    assert path.error_estimate > 1e-2


@pytest.mark.parametrize("asked", [None, *slow(lambda path: path.cost)])
@pytest.mark.slow
def test_a_control_that_jumps_where_the_speed_limit_is_met_is_seen(asked):
    """Where the speed limit is met the control jumps; here degrees 6 and 8 agree to 1e-12 on a time 3e-6 too short."""
    problem = double_integrator(
        end=[1.5],
        running_cost=lambda t, x, v, u: 1,
        control_bounds=(-1.0, 1.0),
        duration_bounds=(0.1, 10.0),
        path_constraint=(lambda t, x, v, u: v[0], -1.0, 1.0),
    )
    path = cg.solve(problem, tol=1e-5, of=asked)
    assert abs(path.cost / 2.5 - 1) <= path.cost_error <= 1e-5
    assert path.cost_error <= path.error_estimate or asked is not None
    assert problem.autonomous
    assert not double_integrator(force=lambda t, x, v, u: u * (1 + t)).autonomous


@pytest.mark.parametrize("asked", [{"tol": 1e-7}, {"tol": 1e-9, "of": lambda path: path.cost}], ids=str)
@pytest.mark.parametrize("stated", ["control_bounds", *slow("path_constraint")])
@pytest.mark.slow
def test_a_bound_of_the_control_that_no_point_meets_is_seen(stated, asked):
    """It acts in the first thousandth; degrees 8 and 10 on the same mesh agreed to 1e-11 on a path 9e-7 away."""
    most, law = 6 - 12e-3, (lambda t, x, v, u: u, -np.inf, 6 - 12e-3)
    problem = double_integrator(**{stated: (-np.inf, most) if stated == "control_bounds" else law})
    path = cg.solve(problem, **asked)
    s = 1 - 3 * (most / 2 - 1) / most  # u = most until s, then falls on a straight line
    slope, t = 2 * most / (1 - s) ** 2, path.t
    cost = most**2 * s / 2 + (most**3 + (slope * (1 - s) - most) ** 3) / (6 * slope)
    way = most * t**2 / 2 - slope * np.maximum(t - s, 0) ** 3 / 6
    assert abs(path.cost / cost - 1) <= 2 * path.cost_error + ROUNDED
    assert path.cost_error <= 1e-9
    assert np.max(np.abs(path.x[0] - way)) <= 2 * path.error_estimate
    assert len(path.t) < 20


@pytest.mark.slow
def test_a_limit_of_the_speed_that_no_point_meets_is_seen():
    """It acts in the middle, between two points; both degrees agreed to 5e-9 on a path 1.5e-6 away."""
    most = 1.5 - 2e-5
    path = cg.solve(double_integrator(path_constraint=(lambda t, x, v, u: v, -np.inf, most)), tol=1e-6)
    s = 3 * (most - 1) / (2 * most)  # v rises to it until s
    t = path.t[path.t <= 0.5]
    way = np.where(t < s, most * t**2 * (1 - t / (3 * s)) / s, most * (t - s / 3))
    assert path.cost / (4 * most**2 / (3 * s)) == pytest.approx(1, abs=2 * path.cost_error)
    assert np.max(np.abs(path.x[0, : len(t)] - way)) <= path.error_estimate <= 1e-6


COASTING = {"start_velocity": [1.5], "end_velocity": [0.5], "lagrangian": lambda t, x, v: v[0] ** 2 / 2 - x[0]}
SWUNG = cg.solve(cg.InitialProblem(pendulum(2.0).lagrangian, (0, 2), [1.0], velocity=[0.0]), cg.Galerkin(8), 10).x[
    0, -1
]
FREE = {
    "a swing": lambda: pendulum(3.0, start=[1.0], end=[None], end_velocity=[None]),
    "a swing to where it goes": lambda: pendulum(
        2.0, start=[1.0], end=[SWUNG], end_velocity=[None], control_bounds=(-1, 1)
    ),
    "a swing in its own time": lambda: pendulum(
        1.2, start=[1.0], end=[-0.5], end_velocity=[None], duration_bounds=(0.3, 6.0)
    ),
    "a fall": lambda: double_integrator(**COASTING),
    "nothing counts": lambda: double_integrator(running_cost=None),
    "terms that cancel": lambda: double_integrator(running_cost=lambda t, x, v, u: u[0] ** 2 / 2 - 6),
}


@pytest.mark.parametrize("tol", [1e-3, *slow(1e-7)])
@pytest.mark.parametrize("name", FREE)
def test_a_cost_that_is_zero_is_told_at_once(name, tol):
    """Two costs of 1e-29 and 1e-34 were far apart, relative to themselves, on all of 80 meshes.

    Multipliers that are all but zero, over a cost that is so, bent it down along dozens of directions.
    """
    path = cg.solve(FREE[name](), tol=tol, of=lambda path: path.cost)
    assert abs(path.cost) < 1e-12
    assert path.cost_error < 1e-20
    assert len(path.t) == 9
    assert path.morse_index == 0


@pytest.mark.slow
def test_a_mesh_with_too_short_an_interval_is_a_limit(monkeypatch):
    """It was told in words for the joints of a user."""
    monkeypatch.setattr("casadi_galerkin.control.control_refinement.SHORTEST_STEP", 1e-2)
    with pytest.raises(cg.LimitReached, match=r"the mesh would need intervals of \d.*, estimated from degree"):
        cg.solve(late_start(), tol=1e-6)


@pytest.mark.slow
def test_error_of_the_cost_is_told_where_a_limit_is_reached():
    with pytest.raises(cg.LimitReached, match="estimated error of") as caught:
        cg.solve(cart_pole(), cg.Galerkin(10), tol=1e-12, of=lambda path: path.cost, limits=cg.Limits(levels=1))
    assert 1e-12 < caught.value.path.cost_error < 1e-6
    with pytest.raises(
        cg.LimitReached, match=r"only the path changes: .* which is all that of=lambda path: path\.cost asks for"
    ):
        cg.solve(script("goddard").problem(), tol=1e-5, limits=cg.Limits(levels=1))


@pytest.mark.slow
def test_what_the_solver_leaves_of_the_cost_is_part_of_its_error():
    """The least cost of a move within T is 6 / T³: both degrees agreed to 1e-14 on one that is 1.5e-5 too high."""
    slow = double_integrator(duration_bounds=(0.1, 1e3))
    path = cg.solve(slow, tol=1e-3)
    error = path.cost * 1e9 / 6 - 1
    assert 1e-5 < error < 1.01 * path.cost_error
    assert error < 1.01 * path.error_estimate < 1e-4


def with_price(price):
    return double_integrator(running_cost=lambda t, x, v, u: price * u[0] ** 2, control_bounds=(-5.0, 5.0))


@pytest.mark.slow
def test_the_unit_of_the_cost_changes_nothing():
    """The solver's tolerances are absolute: from an earlier path a small cost is measured in its own size."""
    alike, *paths = (cg.solve(with_price(price), tol=tol) for price, tol in ((1.0, 1e-8), (5e-10, 1e-5), (1e6, 1e-5)))
    for price, path in zip((5e-10, 1e6), paths, strict=True):
        assert abs(path.cost / alike.cost / price - 1) <= path.cost_error <= path.error_estimate <= 1e-5


@pytest.mark.slow
def test_lines_of_the_levels(capsys):
    path = cg.solve(cart_pole(), tol=1e-4, verbose=1)
    lines = capsys.readouterr().out.splitlines()
    assert sum(int(line.split()[3]) for line in lines if line.split()[0].isdigit()) == path.iterations
    assert lines[0].split()[:3] == ["Level", "Degree", "Intervals"]
    assert lines[1].split()[:3] == ["0", "5", "8"]
    assert any(line.startswith("ControlTrajectory") for line in lines)


@pytest.mark.slow
def test_lines_of_the_solver_of_all_levels(capfd):
    """IPOPT prints past Python: one exit for each of three paths."""
    cg.solve(double_integrator(), tol=1e-4, verbose=2)
    assert capfd.readouterr().out.count("EXIT: ") == 3


LIMITS = {
    "intervals": (cg.Limits(intervals=9), "would need .* intervals"),
    "levels": (cg.Limits(levels=1), "1 level was not enough"),
}


@pytest.mark.parametrize("name", LIMITS)
@pytest.mark.slow
def test_best_path_is_attached_when_a_limit_is_reached(name):
    limits, message = LIMITS[name]
    with pytest.raises(cg.LimitReached, match=message) as caught:
        cg.solve(cart_pole(), tol=1e-8, limits=limits)
    best = caught.value.path
    assert best.cost == pytest.approx(58.8, abs=0.1)
    assert best.error_estimate > 1e-8
    assert cg.solve(cart_pole(), tol=1e-3, guess=best).error_estimate <= 1e-3


@pytest.mark.slow
def test_levels_that_go_round_in_circles_are_ended(monkeypatch):
    estimate, errors = ControlRefinement.estimate, iter([3e-2, 2e-2, 4e-2, 1e-2, *[2e-2, 3e-2, 4e-2] * 5])
    monkeypatch.setattr(ControlRefinement, "estimate", lambda *args: replace(estimate(*args), error=next(errors)))
    monkeypatch.setattr(ControlRefinement, "solve_on", lambda self, mesh, level: level)
    with pytest.raises(
        cg.LimitReached, match=r"15 levels in a row came no nearer.* error of 1.0e-02.*looser or tighter"
    ):
        cg.solve(pendulum(3.0), tol=1e-8)
    assert next(errors, None) is None


@pytest.mark.slow
def test_many_switches_are_found_to_a_loose_tolerance():
    """Two meshes led to one another for ever; to a tighter tolerance it was solved."""
    waves = 20
    push = double_integrator(
        t_span=(0.0, 3.0),
        end=[None],
        end_velocity=[None],
        running_cost=lambda t, x, v, u: ca.sin(waves * t) * u[0],
        control_bounds=(-1.0, 1.0),
    )
    halves, rest = divmod(3 * waves, np.pi)
    exact = -(2 * halves + 1 - np.cos(rest)) / waves
    assert cg.solve(push, tol=1e-3, of=lambda path: path.cost).cost == pytest.approx(exact, rel=1e-3)


@pytest.mark.slow
def test_a_flight_of_many_switches_is_resolved():
    """A drone through three gates, nearly in the least time: meshes of about as many intervals came no nearer."""
    mass, inertia, arm, gravity = 1.0, 0.1, 0.3, 9.81
    flight = cg.ControlProblem(
        lambda t, x, v: mass * ca.sumsqr(v[:2]) / 2 + inertia * v[2] ** 2 / 2 - mass * gravity * x[1],
        (0.0, 4.0),
        start=[0.0, 0.0, 0.0],
        end=[6.0, 1.0, 0.0],
        start_velocity=[0.0] * 3,
        end_velocity=[0.0] * 3,
        force=lambda t, x, v, u: [
            -ca.sum1(u) * ca.sin(x[2]),
            ca.sum1(u) * ca.cos(x[2]),
            arm * (u[1] - u[0]),
        ],
        running_cost=lambda t, x, v, u: 1 + 1e-3 * ca.sumsqr(u - gravity / 2),
        controls=2,
        control_bounds=(0.5, 12.0),
        duration_bounds=(0.1, 6.0),
        waypoints=[
            (1.0, [1.5, (0.8, 1.2), None]),
            (2.0, [3.0, (-0.6, -0.2), None]),
            (3.0, [4.5, (1.3, 1.7), None]),
        ],
    )
    path = cg.solve(flight, tol=1e-3)
    assert path.cost == pytest.approx(2.78837, abs=1e-5)


@pytest.mark.slow
def test_a_callable_that_overflows_on_a_later_mesh_is_a_limit(monkeypatch):
    """It was refused as if it were bad input, after minutes."""
    solve = ControlTranscription.solve

    def overflowing(self, **given):
        if len(self.mesh) > 9:
            raise ValueError("running_cost is not finite at the guess, got inf")
        return solve(self, **given)

    monkeypatch.setattr(ControlTranscription, "solve", overflowing)
    with pytest.raises(cg.LimitReached, match="from the path on the last mesh, running_cost is not finite") as caught:
        cg.solve(cart_pole(), tol=1e-8)
    assert caught.value.path.cost > 0


@pytest.mark.slow
def test_best_path_is_not_always_the_last(monkeypatch):
    estimate, errors = ControlRefinement.estimate, iter([2e-2, 1e-2, 3e-2])
    monkeypatch.setattr(ControlRefinement, "estimate", lambda *args: replace(estimate(*args), error=next(errors)))
    with pytest.raises(cg.LimitReached, match=r"an estimated error of 1.0e-02") as caught:
        cg.solve(cart_pole(), tol=1e-4, limits=cg.Limits(levels=3))
    assert caught.value.path.error_estimate == 1e-2


def test_best_path_is_attached_when_the_time_is_up(monkeypatch):
    monkeypatch.setattr(ControlRefinement, "out_of_time", lambda self: True)
    with pytest.raises(cg.LimitReached, match=r"120 seconds have passed.* Solve on a fixed mesh") as caught:
        cg.solve(cart_pole(), tol=1e-8)
    assert caught.value.path.cost == pytest.approx(58.8, abs=0.1)


@pytest.mark.slow
def test_time_is_a_limit_within_a_level():
    with pytest.raises(
        cg.LimitReached, match=r"before there was a path.*Maximum WallTime Exceeded.*Allow more"
    ) as caught:
        cg.solve(cart_pole(), tol=1e-8, intervals=300, limits=cg.Limits(seconds=1e-3))
    assert caught.value.path.x.shape == (2, 301)


@pytest.mark.parametrize("failing", ["the estimate", "the next mesh"])
@pytest.mark.slow
def test_a_level_that_fails_is_tried_on_a_finer_mesh(monkeypatch, failing):
    """IPOPT is made to give up on one solve in the middle: the answer is true nevertheless."""
    solve, levels = ControlRefinement.solve, []

    def once(self, method, mesh, guess):
        levels.append((method.degree, len(mesh) - 1))
        if len(levels) == (2 if failing == "the estimate" else 3):
            raise cg.ConvergenceError("made to fail")
        return solve(self, method, mesh, guess)

    monkeypatch.setattr(ControlRefinement, "solve", once)
    path = cg.solve(cart_pole(), tol=1e-4)
    (degree, count), (next_degree, next_count) = levels[1:3] if failing == "the estimate" else levels[2:4]
    assert next_count == 2 * count
    assert next_degree == (degree - 2 if failing == "the estimate" else degree)
    assert true_error(path, *resolved(cart_pole)) <= 1e-4


@pytest.mark.slow
def test_an_array_as_guess_is_not_tried_on_another_mesh():
    guess = np.linspace(0.0, 1.0, 8 * 5 + 1)[None, :]
    with pytest.raises(cg.ConvergenceError, match="Infeasible"):
        cg.solve(double_integrator(control_bounds=(-1, 1)), cg.Galerkin(5), tol=1e-4, guess=guess)


def test_infeasible_problem_is_refused_in_ipopts_words():
    with pytest.raises(cg.ConvergenceError, match=r"Infeasible.* a guess nearer to it, several `starts`, or units"):
        cg.solve(double_integrator(control_bounds=(-1, 1)), tol=1e-4)


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="tol must be a number between 0 and 1, got 2"):
        cg.solve(double_integrator(), tol=2)
    with pytest.raises(ValueError, match="tol must be a number between 0 and 1, got 0"):
        cg.solve(double_integrator(), tol=0, of=lambda path: path.cost)
    with pytest.raises(TypeError, match="or give tol instead"):
        cg.solve(double_integrator(), intervals=4)


@pytest.mark.parametrize("breakpoints", [(1.5, 4.5), *slow([3.0])])
@pytest.mark.slow
def test_an_answer_of_other_times_and_breakpoints_is_a_guess(breakpoints):
    """Its breakpoints were taken for those of the mesh: refused where their number differs, else the mesh is skewed."""
    guess = cg.solve(double_integrator(t_span=(0.0, 6.0), breakpoints=breakpoints), cg.Galerkin(3), 6)
    problem = double_integrator(breakpoints=[0.1])
    path = cg.solve(problem, tol=1e-5, guess=guess)
    assert path.cost == pytest.approx(6, rel=1e-9)
    np.testing.assert_array_equal(path.t, cg.solve(problem, tol=1e-5).t)


@pytest.mark.slow
def test_refinement_begins_on_the_mesh_of_a_refined_answer(capsys):
    """Its degree and its duration may be others; the mesh of a fixed discretization says nothing of the path."""
    problem, first = double_integrator(breakpoints=[0.1]), double_integrator(t_span=(0.0, 6.0), breakpoints=[1.5])
    fixed, refined = cg.solve(first, cg.Galerkin(3), 30), cg.solve(first, cg.Galerkin(3), 30, tol=1e-3)
    for guess, limits, intervals in (
        (fixed, cg.Limits(), "9"),
        (refined, cg.Limits(), "30"),
        (refined, cg.Limits(intervals=20), "9"),
    ):
        cg.solve(problem, tol=1e-5, guess=guess, limits=limits, verbose=1)
        assert capsys.readouterr().out.splitlines()[1].split()[:3] == ["0", "6", intervals]


@pytest.mark.slow
def test_where_a_coarse_path_leads_nowhere_the_first_guess_is_tried(monkeypatch):
    """As for a path above the peaks of the alp rider, which meshes of 8 intervals miss."""
    solve, refused, solved = ControlRefinement.solve, [], []

    def from_guesses_only(self, method, mesh, guess):
        if len(mesh) > 9 and method == self.method and isinstance(guess, cg.ControlTrajectory) and not refused:
            refused.append(len(mesh) - 1)
            raise cg.ConvergenceError("no path", None)
        solved.append((len(mesh) - 1, guess))
        return solve(self, method, mesh, guess)

    monkeypatch.setattr(ControlRefinement, "solve", from_guesses_only)
    path = cg.solve(cart_pole(), cg.Galerkin(3), tol=1e-4)
    assert (2 * refused[0], None) in solved
    assert path.cost == pytest.approx(58.8077, rel=1e-4)


@pytest.mark.slow
def test_two_controls_may_switch_at_the_same_time():
    """Two joints, one for each, were as close as rounding, and refused."""
    tol = 1e-6
    problem = plane(
        t_span=(0.0, 1.3),
        end=[1.0, -1.0],
        start_velocity=[-0.3, 0.3],
        running_cost=lambda t, x, v, u: 1,
        control_bounds=(-1.0, 1.0),
        duration_bounds=(0.1, 10.0),
    )
    path = cg.solve(problem, tol=tol)
    assert abs(path.cost / fastest(-0.3)[0] - 1) <= path.error_estimate <= tol


@pytest.mark.parametrize(
    ("guess", "fits"),
    [
        (None, True),
        (lambda t: [t], True),
        ((lambda t: [t], None), True),
        ((([0.0, 1.0], [[0.0, 1.0]]), None), True),
        (np.zeros((1, 9)), False),
        ((lambda t: [t], np.zeros((1, 24))), False),
    ],
)
def test_times_with_values_are_a_guess_for_any_mesh_and_values_alone_are_not(guess, fits):
    assert fits_any_mesh(guess) is fits


@pytest.mark.slow
def test_a_path_along_a_wall_that_hardly_pushes_it_is_as_in_closed_form():
    """IPOPT's own last barrier kept it 1e-5 off the wall, at a cost of 1e-12 (Bryson and Ho, section 3.11)."""
    wall = 0.05
    problem = double_integrator(end=[0.0], start_velocity=[1.0], end_velocity=[-1.0], position_bounds=(-np.inf, wall))
    path, times = cg.solve(problem, tol=1e-6), np.linspace(0, 1, 1001)
    reached = np.minimum(np.minimum(times, 1 - times) / (3 * wall), 1)
    exact = wall * (1 - (1 - reached) ** 3)
    assert np.max(np.abs(path(times)[0] - exact)) <= path.error_estimate * wall
    assert path.error_estimate <= 1e-6
