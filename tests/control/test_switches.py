"""Switches of a control: the path is known to a tolerance, with joints on both sides of each."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from control_problems import FRACTIONS, double_integrator, true_error
from scipy.optimize import brentq
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.control.control_refinement import without_idle_breakpoints

IPOPTS = 1e-11  # of a cost, which rounding keeps IPOPT from

RACE = {
    "running_cost": lambda t, x, v, u: 1,
    "control_bounds": (-1.0, 1.0),
    "t_span": (0.0, 2.0),
    "duration_bounds": (0.1, 10.0),
    "breakpoints": [1.0],
}


def race(**changes):
    """From rest to rest a unit length away, with a guess of the switch."""
    return double_integrator(**(RACE | changes))


def with_weight(g):
    """Up with 1 - g until s, then down with 1 + g: the way is 1, the durations are as 1 + g to 1 - g."""
    s = np.sqrt((1 + g) / (1 - g))
    duration = 2 / ((1 - g) * s)
    t = FRACTIONS * duration
    way = np.where(t < s, (1 - g) * t**2 / 2, 1 - (1 + g) * (duration - t) ** 2 / 2)
    return duration, way[None, :], [s]


def with_friction():
    """Where dv/dt = ±1 - v: 1 - v falls by exp(-t) until s, then 1 + v by exp(s - t) for log(1 + v(s))."""
    s = brentq(lambda s: s - np.log(2 - np.exp(-s)) - 1, 0.1, 10.0)
    speed = 1 - np.exp(-s)
    duration = s + np.log(1 + speed)
    t = FRACTIONS * duration
    late = np.maximum(t - s, 0)
    way = np.where(t < s, t - 1 + np.exp(-t), s - speed + (1 + speed) * (1 - np.exp(-late)) - late)
    return duration, way[None, :], [s]


SCENES = {
    "on a line": (race, lambda: with_weight(0.0)),
    "a bad guess": (lambda: race(breakpoints=[0.7]), lambda: with_weight(0.0)),
    "against a weight": (
        lambda: race(lagrangian=lambda t, x, v: v[0] ** 2 / 2 - 0.3 * x[0]),
        lambda: with_weight(0.3),
    ),
    "with friction": (lambda: race(force=lambda t, x, v, u: u - v), with_friction),
    "two masses": (
        lambda: cg.ControlProblem(
            **RACE,
            lagrangian=lambda t, x, v: (v[0] ** 2 + 2 * v[1] ** 2) / 2,
            start=[0.0, 0.0],
            end=[1.0, 0.5],
            start_velocity=[0.0, 0.0],
            end_velocity=[0.0, 0.0],
            force=lambda t, x, v, u: ca.vertcat(u, u),
            controls=1,
        ),
        lambda: (2.0, with_weight(0.0)[1] * [[1.0], [0.5]], [1.0]),
    ),
}


@pytest.mark.parametrize("name", ["a bad guess", *slow(*(name for name in SCENES if name != "a bad guess"))])
@pytest.mark.slow
def test_the_path_is_known_and_joints_are_beside_the_switches(name):
    """The breakpoints that were stated say nothing, and are left out."""
    tol, (make, exact) = 1e-6, SCENES[name]
    cost, way, switched = exact()
    path = cg.solve(make(), tol=tol)
    assert true_error(path, cost, way) <= path.error_estimate <= tol
    assert abs(path.cost / cost - 1) <= path.cost_error + IPOPTS
    assert path.problem.breakpoints == ()
    for when in switched:
        before, after = path.t[path.t <= when].max(), path.t[path.t >= when].min()
        assert after - before < 2e-2 * cost
    assert len(path.t) <= 20


def test_breakpoints_that_guess_no_switch_do_no_harm():
    """The cost is 6 / T³ + T; an optimum that may choose the breakpoints has them elsewhere with every degree."""
    smooth = race(running_cost=lambda t, x, v, u: u[0] ** 2 / 2 + 1, control_bounds=None, breakpoints=[0.3, 1.2])
    path = cg.solve(smooth, tol=1e-6)
    duration = 18**0.25
    assert path.cost == pytest.approx(6 / duration**3 + duration, rel=1e-12)
    assert path.error_estimate < 1e-10
    assert path.problem.breakpoints == ()


@pytest.mark.slow
def test_the_sum_of_the_bounds_holds():
    """No less than 1.2 each: the least effort in 2.4 or more is that in 2.4."""
    slow = race(
        running_cost=lambda t, x, v, u: u[0] ** 2 / 2 + 1,
        control_bounds=None,
        breakpoints=[1.5],
        t_span=(0.0, 3.0),
        duration_bounds=(1.2, 10.0),
    )
    path = cg.solve(slow, tol=1e-6)
    assert path.cost == pytest.approx(6 / 2.4**3 + 2.4, rel=1e-8)
    assert path.t[-1] == pytest.approx(2.4, rel=1e-9)


def test_only_breakpoints_that_say_nothing_are_left_out():
    gate = {"waypoints": [(0.5, [0.2])], "jumps": [(1.5, lambda x, v: (x, v / 2))]}
    problem = race(**gate, breakpoints=[0.2, 0.7, 1.0], duration_bounds=([0.2, *[0.1] * 5], [0.2, *[3.0] * 5]))
    joined = without_idle_breakpoints(problem)
    assert joined.breakpoints == (0.2, 0.5, 1.5)
    np.testing.assert_allclose(joined.duration_bounds, [[0.2, 0.1, 0.3, 0.1], [0.2, 3.0, 9.0, 3.0]])
    assert without_idle_breakpoints(double_integrator(breakpoints=[0.3])).breakpoints == (0.3,)


@pytest.mark.slow
def test_a_breakpoint_at_a_given_time_stays():
    """From the speed 1/2 at 1/8, with a force of 2: full thrust for a, the brake for a + 1/4."""
    doubled = race(
        force=lambda t, x, v, u: u * ca.if_else(t < 0.5, 1, 2),
        breakpoints=[0.5],
        duration_bounds=([0.5, 0.1], [0.5, 10.0]),
    )
    path = cg.solve(doubled, tol=1e-6)
    a = (np.sqrt(15 / 2) - 1) / 4  # 1/8 + a/2 + a² + (a + 1/4)² = 1
    assert path.problem.breakpoints == (0.5,)
    assert path.cost == pytest.approx(0.75 + 2 * a, abs=2 * path.cost_error)
    assert path.cost_error <= 1e-6


def slow_gate():
    """Past 0.8 with a speed of at most 0.2."""
    slow = (lambda x, v: [x[0], v[0]], [0.8, -0.2], [0.8, 0.2])
    return race(breakpoints=[0.1, 0.9], waypoints=[(0.6, slow)])


@pytest.mark.slow
def test_an_answer_with_all_breakpoints_is_a_guess():
    """The waypoint is passed at 0.7 of the time, not at 0.3 as stated: its part of the time must not be lost."""
    path = cg.solve(slow_gate(), tol=1e-3)
    joined = replace(path, problem=without_idle_breakpoints(path.problem))
    again, same = (cg.solve(slow_gate(), tol=1e-3, guess=guess) for guess in (path, joined))
    assert again.iterations == same.iterations
