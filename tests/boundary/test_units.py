"""A path does not depend on the units: those of action, length and time each span 24 orders of magnitude."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from slow import slow

import casadi_galerkin as cg

METHOD, INTERVALS = cg.Galerkin(8), 4
SAME = 1e-12
DERIVATIVE = (
    1e-7  # of what follows by one linear system, refined once; 2e-8 beside an unknown velocity in units of 1e12
)
UNITS = [(1e-12, 1e-12, 1e12), (1e-12, 1e12, 1e-12), (1e12, 1e-12, 1e-12), (1e12, 1e12, 1e12)]  # every pair of extremes


def stated(ends, units, *acting):
    """Two coupled masses on springs with more of what a problem may state, in units of action, length and time."""
    action, length, time = units
    mass = action * time / length**2

    def lagrangian(t, x, v):
        return mass * (ca.sumsqr(v) + v[0] * v[1] / 2 - ca.sumsqr(x) / 2 / time**2)

    said = {
        "drag": {"force": lambda t, x, v: -0.3 * mass / time * v},
        "circle": {"constraint": lambda t, x: ca.sumsqr(x) - length**2},
        "line": {"end_conditions": lambda x0, x1: x1[0] - x1[1] - length},
        "spring": {"end_action": lambda x0, x1: mass / time * ca.sumsqr(x1)},
        "energy": {"energy": 9 * mass * (length / time) ** 2},
    }
    more = {name: value for kind in acting for name, value in said[kind].items()}
    measures = {"start": length, "end": length, "start_velocity": length / time, "end_velocity": length / time}
    measures["start_momentum"] = mass * length / time
    given = {name: [None if a is None else a * measures[name] for a in values] for name, values in ends.items()}
    return cg.BoundaryProblem(lagrangian, (0, time), **given, **more)


FIXED = {"start": [0.3, 0.2], "end": [1.0, 2.0]}
TO_A_LINE = {"start": [0.3, 0.2], "end": [None, None]}
ON_THE_CIRCLE = {"start": [0.6, 0.8], "end": [0.8, 0.6]}
STATED = [
    (FIXED, "drag"),
    (FIXED, "energy"),
    (TO_A_LINE, "line"),
    (TO_A_LINE, "line", "drag"),
    (TO_A_LINE, "spring"),
    (ON_THE_CIRCLE, "circle"),
    (ON_THE_CIRCLE, "circle", "drag"),
    ({"start": [0.6, 0.8], "end": [None, None]}, "circle", "drag"),
    ({"start": [None, 0.2], "end": [1.0, 2.0], "start_momentum": [0.1, None]},),
    ({"start": [None, None], "end": [1.0, 2.0], "start_velocity": [0.2, 0.1]},),
    ({"start": [0.3, None], "end": [None, None], "end_velocity": [0.2, 0.1]}, "drag"),
]
ONE = (1.0, 1.0, 1.0)
NUMBERS = range(len(STATED))
NAMES = {"ids": lambda number: ", ".join([*STATED[number][0], *STATED[number][1:]])}


@cache
def solved(number, units):
    """The path of one of the problems, which several tests look at."""
    ends, *acting = STATED[number]
    return cg.solve(stated(ends, units, *acting), METHOD, intervals=INTERVALS)


@pytest.mark.parametrize("number", [0, 6, *slow(*(number for number in NUMBERS if number not in (0, 6)))], **NAMES)
def test_a_path_is_the_same_in_any_units(number):
    expected = solved(number, ONE)
    for units in UNITS:
        path = solved(number, units)
        np.testing.assert_allclose(path.x / units[1], expected.x, rtol=0, atol=SAME, err_msg=f"units {units}")
        assert path.action / units[0] == pytest.approx(expected.action, rel=0, abs=SAME * 100)


@pytest.mark.parametrize("number", [2, *slow(*NUMBERS[3:])], **NAMES)
@pytest.mark.slow
def test_derivatives_by_the_ends_are_the_same_in_any_units(number):
    expected, *others = (cg.sensitivity(solved(number, units)) for units in [ONE, *UNITS])
    for other in others:
        for name, by in expected.x.items():
            np.testing.assert_allclose(other.x[name], by, rtol=0, atol=DERIVATIVE)


# a given energy is no duration, and a path at rest has no momentum that its end could be judged by
@pytest.mark.parametrize("number", [0, *slow(*(number for number in NUMBERS if number not in (0, 1, 7)))], **NAMES)
@pytest.mark.slow
def test_a_shot_is_the_same_in_any_units(number):
    (ends, *acting), expected = STATED[number], solved(number, ONE)
    for units in UNITS:
        shot = cg.shoot(stated(ends, units, *acting), METHOD, INTERVALS)
        np.testing.assert_allclose(shot.x / units[1], expected.x, rtol=0, atol=SAME, err_msg=f"units {units}")
        assert shot.action / units[0] == pytest.approx(expected.action, rel=0, abs=SAME * 100)


@pytest.mark.parametrize("drag", [("drag",), ()], ids=["drag", "none"])
@pytest.mark.slow
def test_multipliers_and_shooting_are_the_same_in_any_units(drag):
    def found(units):
        action, length, time = units
        problem = stated(ON_THE_CIRCLE, units, "circle", *drag)
        path, shot = cg.solve(problem, METHOD, intervals=INTERVALS), cg.shoot(problem, METHOD, INTERVALS)
        multipliers = path.multipliers(time * np.linspace(0, 1, 5)) * time * length**2 / action
        return np.concatenate(
            (multipliers.ravel(), (path.momentum * length / action).ravel(), (shot.x / length).ravel())
        )

    expected = found(ONE)
    for units in UNITS:
        np.testing.assert_allclose(found(units), expected, rtol=0, atol=DERIVATIVE, err_msg=f"units {units}")
