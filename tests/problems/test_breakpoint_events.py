"""Jumps and waypoints that are stated badly are refused before anything is solved."""

import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from control_problems import cartesian_pendulum, double_integrator


def keep(x, v):
    return x, v


BADLY_STATED = {
    "jumps as a number": ({"jumps": 3.0}, TypeError, r"jumps must be pairs \(t, law\), got 3.0"),
    "a law alone": ({"jumps": [keep]}, TypeError, r"jumps must be pairs \(t, law\), got <function keep"),
    "a time in words": ({"jumps": [("noon", keep)]}, ValueError, "time of a jump must be a finite number, got 'noon'"),
    "two at a time": (
        {"jumps": [(0.5, keep), (0.5, keep)]},
        ValueError,
        "jumps must have different times, got two at t = 0.5",
    ),
    "a jump at the end": (
        {"jumps": [(1.0, keep)]},
        ValueError,
        r"breakpoints, waypoints and jumps must increase inside of \(0.0, 1.0\) by more than roundoff, got \(1.0,\)",
    ),
    "a law as numbers": (
        {"jumps": [(0.5, ([1.0], [2.0]))]},
        TypeError,
        r"at t = 0.5: jump must be a callable of \(x, v\), got \(\[1.0\], \[2.0\]\)",
    ),
    "a law of x": ({"jumps": [(0.5, lambda x: x)]}, TypeError, r"jump is called as jump\(x, v\), got one of \(x\)$"),
    "a law of parameters": (
        {"jumps": [(0.5, lambda x, v, p: (x, p * v))]},
        TypeError,
        "If it takes p, give parameters",
    ),
    "a law of one value": (
        {"jumps": [(0.5, lambda x, v: -v)]},
        TypeError,
        "must return a pair: x and v after the jump, got SX",
    ),
    "a law of too many": (
        {"jumps": [(0.5, lambda x, v: (x, [v, v]))]},
        ValueError,
        r"at t = 0.5: jump failed .*: it must return 1 position and as many velocities, got \[1, 2\]",
    ),
    "a law of other functions": (
        {"jumps": [(0.5, lambda x, v: (x, math.cos(v)))]},
        TypeError,
        r"jump holds a constant that is not a number, as math.cos\(x\) gives",
    ),
    "a waypoint without bounds": (
        {"waypoints": [(0.5, lambda x, v: v)]},
        TypeError,
        r"waypoint must be \(g, lo, hi\), a callable g and .*, got <function",
    ),
    "a waypoint with one bound": (
        {"waypoints": [(0.5, (lambda x, v: v, 1.0))]},
        TypeError,
        r"waypoint must be \(g, lo, hi\), a callable g and .*, got \(<function",
    ),
    "a waypoint that contradicts": (
        {"waypoints": [(0.5, (lambda x, v: v, 1.0, 0.0))]},
        ValueError,
        "at t = 0.5: waypoint must have lo <= hi, got 1.0 and 0.0$",
    ),
    "a waypoint of time": (
        {"waypoints": [(0.5, (lambda t, x, v: v, 1.0, 2.0))]},
        TypeError,
        r"waypoint is called as waypoint\(x, v\)",
    ),
    "waypoints at one time": (
        {"waypoints": [(0.5, [0.2]), (0.5, (lambda x, v: v, 1.0, 2.0))]},
        ValueError,
        "waypoints must have different times, got two at t = 0.5",
    ),
}


@pytest.mark.parametrize("name", BADLY_STATED)
def test_a_jump_or_waypoint_that_is_stated_badly_is_refused(name):
    changes, kind, message = BADLY_STATED[name]
    with pytest.raises(kind, match=message):
        double_integrator(**changes)


RATES = {
    "start": [0.0, 1.0],
    "end": [1.0, None],
    "start_velocity": [0.0, None],
    "end_velocity": [0.0, None],
    "rates": lambda t, x, v, u: -(u[0] ** 2),
}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"jumps": [(0.5, lambda x, v: ([x[0], x[1] + v[1]], v))]}, "the jump at t = 0.5 must not depend on v\\[1\\]"),
        ({"jumps": [(0.5, lambda x, v: (x, [v[1], 0]))]}, "the jump at t = 0.5 must not depend on v\\[1\\]"),
        ({"waypoints": [(0.5, (lambda x, v: v, 0, 1))]}, "the waypoint at t = 0.5 must not depend on v\\[1\\]"),
    ],
)
def test_the_velocity_of_a_rate_is_refused(changes, message):
    with pytest.raises(ValueError, match=message + r", the rate of x\[1\]: write that rate instead"):
        double_integrator(**RATES, **changes)


def test_what_a_law_returns_for_the_velocity_of_a_rate_is_passed_over():
    assert double_integrator(**RATES, jumps=[(0.5, lambda x, v: (x, v))]).breakpoints == (0.5,)


@pytest.mark.parametrize(
    "changes",
    [{"jumps": [(1.0, keep)]}, {"waypoints": [(1.0, (lambda x, v: v[0], 0.0, 1.0))]}],
    ids=["jump", "waypoint"],
)
def test_a_constraint_has_no_place_beside_them(changes):
    with pytest.raises(ValueError, match="a constraint takes no jumps, and no functions as waypoints"):
        cartesian_pendulum(**changes)


def test_a_law_may_write_into_what_it_is_given():
    def bounce(x, v):
        v[0] = -v[0]
        return x, v

    ((_, law),) = double_integrator(jumps=[(0.5, bounce)]).jumps
    assert [float(value) for value in law(1.0, 2.0)] == [1.0, -2.0]


def test_a_parameter_of_a_jump_or_a_waypoint_alone_is_taken():
    fields = {
        "lagrangian": lambda t, x, v, p: v[0] ** 2 / 2,
        "force": lambda t, x, v, u, p: u,
        "running_cost": lambda t, x, v, u, p: u[0] ** 2,
        "parameters": [0.5],
        "parameter_bounds": (0.1, 1.0),
    }
    for stated in (
        {"jumps": [(0.5, lambda x, v, p: (x, -p * v))]},
        {"waypoints": [(0.5, (lambda x, v, p: v - p, 0.0, 0.0))]},
    ):
        assert double_integrator(**fields, **stated).parameter_bounds == ((0.1,), (1.0,))
    with pytest.raises(ValueError, match=r"the free parameter p\[0\] occurs in no"):
        double_integrator(**fields, jumps=[(0.5, lambda x, v, p: (x, -v))])


def test_a_problem_with_jumps_may_be_replaced():
    problem = double_integrator(
        jumps=[(0.7, lambda x, v: (x, ca.sin(v)))], waypoints=[(0.3, (lambda x, v: v, 0.0, 1.0)), (0.7, [0.2])]
    )
    other = replace(problem, end=(2.0,))
    assert other.breakpoints == (0.3, 0.7)
    assert list(other.conditions_on_the_way) == [0.3]
    assert [t for t, _ in other.jumps] == [0.7]
    assert other.waypoints[0][1][1:] == ((0.0,), (1.0,))
    assert float(other.jumps[0][1](0.0, 1.0)[1]) == pytest.approx(np.sin(1))
