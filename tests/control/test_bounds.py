"""Bounds of velocities, of rates of controls and of the start, a cost of the start, and bounds that change."""

from dataclasses import replace

import numpy as np
import pytest
from control_problems import double_integrator, first_order
from slow import slow

import casadi_galerkin as cg

METHOD = cg.Galerkin(3)
BRAKED = {"t_span": (0, 2), "velocity_bounds": (-np.inf, 0.6)}
SOLVED = 1e-8


def test_a_velocity_is_bounded_as_by_a_path_constraint():
    bounded = cg.solve(double_integrator(**BRAKED), METHOD, 12)
    stated = {"t_span": (0, 2), "path_constraint": (lambda t, x, v, u: v, -np.inf, 0.6)}
    np.testing.assert_allclose(bounded.x, cg.solve(double_integrator(**stated), METHOD, 12).x, rtol=0, atol=SOLVED)
    assert bounded.path_multipliers is not None


def test_the_velocity_of_a_rated_component_is_its_rate():
    """Where x' = u and the end is dear, u would be 9."""
    problem = first_order(t_span=(0, 1), end=None, terminal_cost=lambda t, x, v: -9 * x[0], velocity_bounds=(0, 0.5))
    path = cg.solve(problem, METHOD, 4)
    assert path.x[0, -1] == pytest.approx(0.5, abs=SOLVED)


@pytest.mark.parametrize("side", ["start", "end"])
def test_a_free_velocity_at_an_end_keeps_its_bounds(side):
    rewarded = {"start": "initial_cost", "end": "terminal_cost"}[side]
    problem = double_integrator(
        **{f"{side}_velocity": None, rewarded: lambda t, x, v: -30 * v[0], "velocity_bounds": (-np.inf, 1.5)}
    )
    assert getattr(cg.solve(problem, METHOD, 8), f"{side}_velocity")[0] == pytest.approx(1.5, abs=SOLVED)


def test_a_start_is_free_within_bounds_and_its_speed_has_a_cost():
    """From 1/2, the least of 3 v² - 3 v + 3/2, by hand."""
    freed = {"start": [None], "start_velocity": None, "start_bounds": (-0.5, 0.5)}
    path = cg.solve(double_integrator(**freed, initial_cost=lambda t, x, v: v[0] ** 2), METHOD, 4)
    found = path.x[0, 0], path.start_velocity[0], path.cost
    np.testing.assert_allclose(found, (0.5, 0.5, 0.75), rtol=0, atol=SOLVED)


def test_the_time_of_the_start_is_found():
    """A unit is gone in one unit of time, when it is cheapest: around t = 2."""
    problem = first_order(
        t_span=(0.5, 1.5), running_cost=lambda t, x, v, u: u**2 * (1 + (t - 2) ** 2), initial_time_bounds=(0, 3)
    )
    path = cg.solve(problem, cg.Galerkin(6), 8)
    np.testing.assert_allclose(path.t[[0, -1]], [1.5, 2.5], rtol=0, atol=SOLVED)
    early = cg.solve(replace(problem, initial_time_bounds=(0, 1)), cg.Galerkin(6), 8)
    assert early.t[0] == pytest.approx(1.0, abs=SOLVED)


LEAST_TIME = {
    "running_cost": lambda t, x, v, u: 1,
    "control_bounds": (-1, 1),
    "control_rate_bounds": (-2, 2),
    "duration_bounds": (0.1, 10),
    "t_span": (0, 3),
}


@pytest.mark.parametrize("intervals", [8, *slow(64)])
def test_a_control_turns_over_as_fast_as_it_may(intervals):
    """Full thrust, a turn within one unit of time, full brake: 2 √(13/12)."""
    path = cg.solve(double_integrator(**LEAST_TIME), METHOD, intervals)
    changes = np.diff(path.control.values[0]) / np.diff(path.control.times)
    assert np.max(np.abs(changes)) == pytest.approx(2, abs=SOLVED)
    assert path.cost == pytest.approx(2 * np.sqrt(13 / 12), abs=0.05 / intervals**1.5)


def test_bounds_of_rates_that_do_not_act_change_nothing():
    free, bounded = (cg.solve(double_integrator(control_rate_bounds=b), METHOD, 4) for b in (None, (-12.5, 12.5)))
    np.testing.assert_allclose(bounded.control.values, free.control.values, rtol=0, atol=1e-6)


def test_held_controls_change_by_their_rate_times_an_interval():
    """They would follow 10 t, and may change by half as much."""
    problem = first_order(
        hold=True,
        t_span=(0, 1.2),
        end=None,
        running_cost=lambda t, x, v, u: (u - 10 * t) ** 2,
        control_rate_bounds=(0, 5),
    )
    path = cg.solve(problem, METHOD, 6)
    np.testing.assert_allclose(np.diff(path.control.values[0]), 5 * 0.2, rtol=0, atol=SOLVED)


@pytest.mark.parametrize(
    "changes", [{"velocity_bounds": (-9, 0.7)}, *slow({"control_bounds": (-2, 2)}, {"position_bounds": (-1, 1)})]
)
@pytest.mark.slow
def test_bounds_change_and_nothing_is_rebuilt(changes):
    program = cg.transcribe(double_integrator(**BRAKED), METHOD, 8)
    built, again = program.graph, program.solve(**changes)
    fresh = cg.solve(double_integrator(**(BRAKED | changes)), METHOD, 8)
    assert again.cost == pytest.approx(fresh.cost, rel=SOLVED)
    assert program.graph is built


BAD = {
    "velocity in the wrong order": ({"velocity_bounds": (1, -1)}, "velocity_bounds must have lo <= hi, got 1.0 and"),
    "velocities of a wrong shape": ({"velocity_bounds": ([0, 0], 1)}, "lo of velocity_bounds must be a number or 1"),
    "rates of a wrong shape": ({"control_rate_bounds": (0, [1, 1])}, "hi of control_rate_bounds must be a number or"),
    "a velocity outside": (
        {"velocity_bounds": (0.5, 1)},
        r"start_velocity\[0\] = 0.0 lies outside its velocity_bounds",
    ),
    "a start outside": ({"start_bounds": (1, 2)}, r"start\[0\] = 0.0 lies outside its start_bounds \[1.0, 2.0\]"),
    "bounds that exclude each other": (
        {"start": [None], "position_bounds": (0, 1), "start_bounds": (2, 3)},
        r"start_bounds\[0\] = \(2.0, 3.0\) lie outside the position_bounds of x\[0\]",
    ),
    "a time outside": (
        {"initial_time_bounds": (1, 2)},
        r"t_span\[0\] = 0.0 lies outside its initial_time_bounds \[1.0, 2.0\]",
    ),
    "times in the wrong order": ({"initial_time_bounds": (1, 0)}, "initial_time_bounds must have lo <= hi"),
}


@pytest.mark.parametrize("name", BAD)
def test_bounds_that_contradict_are_refused(name):
    changes, message = BAD[name]
    with pytest.raises(ValueError, match=message):
        double_integrator(**changes)


def test_a_cost_of_the_start_does_not_depend_on_a_rate():
    with pytest.raises(ValueError, match=r"initial_cost must not depend on v\[0\], the rate of x\[0\]"):
        first_order(initial_cost=lambda t, x, v: v[0])


def test_rows_of_velocities_stay_those_of_the_problem():
    program = cg.transcribe(double_integrator(), METHOD, 4)
    with pytest.raises(ValueError, match=r"velocity_bounds must bound the same components .* \[False\], got \[True\]"):
        program.solve(velocity_bounds=(-1, 1))


def test_rates_of_controls_need_points_apart_and_ipopt():
    problem = double_integrator(control_rate_bounds=(-9, 9))
    with pytest.raises(ValueError, match="control_rate_bounds need a rule without points at both ends"):
        cg.solve(problem, cg.Galerkin(2, quadrature=cg.lobatto(3)), 4)
    with pytest.raises(ValueError, match="fatrop takes no control_rate_bounds"):
        cg.solve(problem, METHOD, 4, solver=cg.fatrop)
