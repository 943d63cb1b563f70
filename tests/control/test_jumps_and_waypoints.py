"""Jumps at breakpoints, and waypoints that are functions: exact values, orders, costates, files and pictures."""

from itertools import pairwise

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np
import pytest
from control_problems import double_integrator, staged
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.control.initial_guess import starting_point

SOLVED = 1e-8  # what a solver leaves of the optimality conditions, amplified by their conditioning
GIVEN = {"duration_bounds": None, "parameter_bounds": None}


def effort(way, first, last, duration):
    """Least ∫u²/2 of a unit mass between places `way` apart with these velocities."""
    return (
        6 * way**2 / duration**3
        - 6 * way * (first + last) / duration**2
        + 2 * (first**2 + first * last + last**2) / duration
    )


def bounce(**changes):
    """From rest at 1 to a wall at 0, where it bounces with 0.8 of its velocity, and back to rest at 1."""
    fields = {"t_span": (0.0, 2.0), "start": [1.0], "waypoints": [(1.0, [0.0])]}
    return double_integrator(**(fields | {"jumps": [(1.0, lambda x, v: (x, -0.8 * v))]} | changes))


def burning(**changes):
    """A mass that the control burns at its own rate, doubled by a refill at half time."""
    fields = {
        "lagrangian": lambda t, x, v: x[1] * v[0] ** 2 / 2,
        "start": [0.0, 1.0],
        "end": [1.0, None],
        "start_velocity": [0.0, None],
        "end_velocity": [0.0, None],
        "rates": lambda t, x, v, u: -(u[0] ** 2) / 50,
        "jumps": [(0.5, lambda x, v: ([x[0], 2 * x[1]], v))],
    }
    return double_integrator(**(fields | changes))


# jumps


def test_a_bounce_has_the_least_effort_of_all_speeds():
    path = cg.solve(bounce(), cg.Galerkin(3), 4)
    speed = 10.8 / 6.56  # of effort(-1, 0, -s, 1) + effort(1, 0.8 s, 0, 1) = 12 - 10.8 s + 3.28 s²
    assert path.cost == pytest.approx(12 - 5.4 * speed, rel=1e-9)
    assert path.cost == pytest.approx(effort(-1, 0, -speed, 1) + effort(1, 0.8 * speed, 0, 1), rel=1e-9)
    assert path.phases[0].end_velocity[0] == pytest.approx(-speed, abs=SOLVED)
    assert (path.velocity[0, 2], path.momentum[0, 2]) == pytest.approx((0.8 * speed, 0.8 * speed), abs=SOLVED)
    assert path(1.0)[0] == pytest.approx(0, abs=SOLVED)
    assert path.before(1.0)[0] == pytest.approx(0, abs=SOLVED)
    assert (path.before(1.0, 1)[0], path(1.0, 1)[0]) == pytest.approx((-speed, 0.8 * speed), abs=SOLVED)


def test_a_bounce_at_a_free_time_keeps_the_hamiltonian():
    """Time costs one half: each leg of duration T takes T/2 beside its effort, and neither knows of the other's."""
    timed = {"running_cost": lambda t, x, v, u: (u[0] ** 2 + 1) / 2, "duration_bounds": (0.2, 5.0)}
    path = cg.solve(bounce(**timed), cg.Galerkin(4), 8)
    np.testing.assert_allclose(path.hamiltonian, 0, atol=1e-7)
    first, second = np.diff([0.0, path.problem.jumps[0][0], path.t[-1]])
    speed = -path.phases[0].end_velocity[0]
    expected = effort(-1, 0, -speed, first) + effort(1, 0.8 * speed, 0, second) + (first + second) / 2
    assert path.cost == pytest.approx(expected, rel=1e-8)
    for change in np.vstack((np.eye(3), -np.eye(3))) * 1e-3:  # nothing near by is cheaper
        a, b, s = np.array([first, second, speed]) + change
        assert effort(-1, 0, -s, a) + effort(1, 0.8 * s, 0, b) + (a + b) / 2 > expected


def lagging(**stated):
    """A position that follows its control with a lag, x' = u - x."""
    first_order = dict.fromkeys(("lagrangian", "force", "start_velocity", "end_velocity"))
    return double_integrator(rates=lambda t, x, v, u: u[0] - x[0], **first_order, **stated)


def test_a_component_of_first_order_jumps():
    """x' = u - x, and x falls by 1 at half time: the least ∫u²/2 is that of reaching 1 + e^(1/2)/e without a fall."""
    problem = lagging(jumps=[(0.5, lambda x, v: (x - 1, v))])
    path = cg.solve(problem, cg.Galerkin(6), 4)
    goal = 1 + np.exp(-0.5)
    assert path.cost == pytest.approx(goal**2 / (1 - np.exp(-2)), rel=1e-11)
    times = np.linspace(0, 1, 9)
    expected = goal * np.sinh(times) / np.sinh(1)
    np.testing.assert_allclose(path(times)[0], expected - (times >= 0.5) * np.exp(0.5 - times), rtol=0, atol=1e-8)
    np.testing.assert_allclose(path.before(0.5), expected[4], rtol=0, atol=1e-9)
    np.testing.assert_allclose(path.costate(times)[0], -goal * np.exp(times) / np.sinh(1), rtol=1e-8)


def differences(path, exact):
    """Largest errors on both sides of the joints: positions, costate and velocities; and of the cost."""
    when = np.array(path.problem.breakpoints)
    sides = [
        (side(when), known(when))
        for a, b in ((path, exact), (path.costate, exact.costate))
        for side, known in ((a, b), (a.before, b.before))
    ]
    after = [p.velocity[0, np.searchsorted(p.t, when)] for p in (path, exact)]
    arrived = [[phase.end_velocity[:1] for phase in p.phases[:-1]] for p in (path, exact)]
    pairs = [*sides, arrived, after, (path.cost, exact.cost)]
    return [np.max(np.abs(np.subtract(*pair))) for pair in pairs]


@pytest.mark.parametrize(("degree", "parts"), [(2, (3, 6, 9)), *slow((3, (2, 3, 4)))])
@pytest.mark.slow
def test_both_sides_of_a_jump_have_twice_the_degree(degree, parts):
    problem = staged(**GIVEN, waypoints=())
    marks = [0.0, *problem.breakpoints, 2.0]
    exact, errors = cg.solve(problem, cg.Galerkin(12), 12), []
    for count in parts:
        mesh = np.interp(np.arange(3 * count + 1) / count, np.arange(4), marks)
        errors.append(differences(cg.solve(problem, cg.Galerkin(degree), mesh=mesh), exact))
    slopes = np.polyfit(np.log(parts), np.log(errors), 1)[0]
    np.testing.assert_allclose(slopes, -2 * degree, rtol=0, atol=0.4)


@pytest.mark.parametrize("pushed", [0, 1])
@pytest.mark.slow
def test_the_costate_says_what_a_small_force_or_rate_costs_on_both_sides(pushed):
    method, step = cg.Galerkin(5, quadrature=cg.gauss(6)), 1e-3

    def solved(size):
        def extra(t, i):
            return size * ca.sin(3 * t) if i == pushed else 0

        return cg.solve(
            staged(
                **GIVEN,
                force=lambda t, x, v, u, p: u[0] - v[0] / 10 + extra(t, 0),
                rates=lambda t, x, v, u, p: u[0] * x[0] - x[1] + extra(t, 1),
            ),
            method,
            12,
        )

    path, more, less = solved(0), solved(step), solved(-step)
    steps = np.diff(path.t)[:, None]
    times = (path.t[:-1, None] + steps * method.quadrature.points).ravel()
    weights = (steps * method.quadrature.weights).ravel()
    known = np.sum(weights * path.costate(times)[pushed] * np.sin(3 * times))
    assert (more.cost - less.cost) / (2 * step) == pytest.approx(known, rel=1e-4)
    for when in path.problem.breakpoints:  # the polynomials go on to the values at the joints
        np.testing.assert_allclose(path.costate.before(when), path.costate(when - 1e-7), rtol=0, atol=1e-5)
        np.testing.assert_allclose(path.costate(when), path.costate(when + 1e-7), rtol=0, atol=1e-5)
    assert abs(path.costate.before(0.8) - path.costate(0.8))[pushed] > 0.01


@pytest.mark.parametrize("make", [burning, *slow(staged)])
@pytest.mark.slow
def test_a_tolerance_is_met_with_jumps(make):
    exact = cg.solve(make(), cg.Galerkin(12), 12)
    path = cg.solve(make(), tol=1e-6, intervals=7)
    assert set(path.problem.breakpoints) <= set(path.t)
    assert abs(path.cost / exact.cost - 1) <= path.error_estimate <= 1e-6
    fractions = np.linspace(0, 1, 100)  # no breakpoint, which has two values
    found, known = (
        p(np.interp(fractions, np.linspace(0, 1, 2 + len(b)), [0, *b, p.t[-1]]))
        for p, b in ((path, path.problem.breakpoints), (exact, exact.problem.breakpoints))
    )
    assert np.max(np.abs(found - known)) <= 1e-6 * np.max(np.abs(known))


def test_a_constant_of_a_phase_may_be_zero_all_along():
    """What rounding leaves of it, 1e-24, was compared with itself, and called a violation."""
    problem = burning(
        start=[0.0, 1.0, 0.0],
        end=[1.0, None, None],
        start_velocity=[0.0, None, None],
        end_velocity=[0.0, None, None],
        force=lambda t, x, v, u: u[0] * (1 + ca.sin(x[2] + v[0])),
        rates=lambda t, x, v, u: [-(u[0] ** 2) / 50, 0],
        jumps=[(0.5, lambda x, v: ([x[0], 2 * x[1], x[2]], v))],
    )
    path = cg.solve(problem, cg.Galerkin(6), 8)
    np.testing.assert_allclose(path.x[2], 0, atol=1e-15)


@pytest.mark.slow
def test_an_answer_is_a_guess_with_its_jumps():
    cold = cg.transcribe(staged(), cg.Galerkin(4), 8)
    known = cold.solve()
    assert cold.solve(guess=known).iterations <= 2
    finer = cg.transcribe(staged(), cg.Galerkin(6), 12)
    values = starting_point(finer.graph, finer.problem, finer.calculus, known).values
    jumps = np.array([after["x"][0] - before["x"][-1] for before, after in pairwise(values)])
    when = np.array(known.problem.breakpoints)
    np.testing.assert_allclose(jumps.T, known(when) - known.before(when), rtol=0, atol=1e-12)
    assert finer.solve(guess=known).iterations < finer.solve().iterations


@pytest.mark.slow
def test_a_jump_in_a_function_to_embed():
    f = cg.solution_function(burning(), cg.Galerkin(4), 6)
    path = cg.solve(burning(end=[1.5, None]), cg.Galerkin(4), 6)
    found = f(
        start=[0, 1],
        end=[1.5],
        start_velocity=0,
        end_velocity=0,
        guess=path.polynomial.values,
        controls=path.control.values,
    )
    assert float(found["cost"]) == pytest.approx(path.cost, rel=1e-9)
    np.testing.assert_allclose(found["x"], path.x, rtol=0, atol=SOLVED)


def test_bounds_hold_before_a_jump_too():
    falls = {"start": [0.0], "end": [0.0], "jumps": [(0.5, lambda x, v: (x - 1, v))]}
    free = cg.solve(double_integrator(**falls), cg.Galerkin(3), 4)
    assert free.before(0.5)[0] == pytest.approx(0.5, abs=SOLVED)
    bounded = cg.solve(double_integrator(**falls, position_bounds=(-5.0, 0.2)), cg.Galerkin(3), 4)
    assert bounded.before(0.5)[0] == pytest.approx(0.2, abs=SOLVED)
    assert bounded(0.5)[0] == pytest.approx(-0.8, abs=SOLVED)


def test_files_and_pictures_show_both_sides(tmp_path):
    path = cg.solve(burning(), cg.Galerkin(4), 6)
    row = path.to_dict()["t"].index(0.5)
    assert path.to_dict()["x[1]"][row] == path(0.5)[1] == pytest.approx(2 * path.before(0.5)[1], rel=1e-12)
    line = path.plot().lines[2]
    at = line.get_xdata() == 0.5
    assert line.get_ydata()[at].tolist() == [path.before(0.5)[1], path(0.5)[1]]
    plt.close("all")


def test_what_has_no_jumps_refuses_them():
    with pytest.raises(ValueError, match="an InitialProblem has no jumps, but the path jumps at t = 1"):
        cg.solve(bounce(), cg.Galerkin(3), 4).replay()


def test_a_law_that_is_not_finite_at_the_guess_is_named():
    problem = double_integrator(jumps=[(0.5, lambda x, v: (x, ca.sqrt(-1 - v)))])
    with pytest.raises(ValueError, match=r"the continuity of v\[0\] is not finite at the guess, at t = 0.5"):
        cg.solve(problem, cg.Galerkin(3), 4)


def test_a_jump_that_fails_is_named_with_its_time():
    problem = double_integrator(end=[0.0], jumps=[(0.5, lambda x, v: (ca.sqrt(x), v))])
    with pytest.raises(ValueError, match=r"a derivative of the continuity of x\[0\] is not finite .* at t = 0.5"):
        cg.solve(problem, cg.Galerkin(3), 4)


# waypoints that are functions


@pytest.mark.parametrize("given", [0.25, -0.5])
def test_a_velocity_on_the_way_is_that_asked_for(given):
    problem = double_integrator(
        t_span=(0.0, 2.0), waypoints=[(1.0, (lambda x, v: [x[0], v[0]], [0.3, given], [0.3, given]))]
    )
    path = cg.solve(problem, cg.Galerkin(3), 4)
    assert path.cost == pytest.approx(effort(0.3, 0, given, 1) + effort(0.7, given, 0, 1), rel=1e-9)
    assert path.velocity[0, 2] == pytest.approx(given, abs=SOLVED)
    assert path(1.0)[0] == pytest.approx(0.3, abs=SOLVED)


def test_a_bound_on_the_way_that_is_loose_costs_nothing():
    problem = double_integrator(waypoints=[(0.5, (lambda x, v: v[0] ** 2, -np.inf, 9))])
    assert cg.solve(problem, cg.Galerkin(3), 4).cost == pytest.approx(6, abs=SOLVED)


def test_a_condition_holds_before_a_jump_at_its_time():
    speed = 0.5
    path = cg.solve(bounce(waypoints=[(1.0, (lambda x, v: [x[0], v[0]], [0, -speed], [0, np.inf]))]), cg.Galerkin(3), 4)
    assert path.phases[0].end_velocity[0] == pytest.approx(-speed, abs=SOLVED)
    assert path.velocity[0, 2] == pytest.approx(0.8 * speed, abs=SOLVED)
    assert path.cost == pytest.approx(effort(-1, 0, -speed, 1) + effort(1, 0.8 * speed, 0, 1), rel=1e-8)


def test_the_costate_of_a_rate_jumps_at_a_place_to_pass():
    """x' = u - x from 0 over 0.2 to 1: u = A e^s on each half, s since its start, and the costate is -u."""
    problem = lagging(waypoints=[(0.5, [0.2])])
    path = cg.solve(problem, cg.Galerkin(6), 4)
    half, left = np.sinh(0.5), np.exp(-0.5)
    assert path.costate.before(0.5)[0] == pytest.approx(-0.2 / half / left, rel=1e-8)
    assert path.costate(0.5)[0] == pytest.approx(-(1 - 0.2 * left) / half, rel=1e-8)


def test_a_failure_names_the_condition():
    problem = double_integrator(waypoints=[(0.5, (lambda x, v: x[0] ** 2 + v[0] ** 2, -2.0, -1.0))])
    with pytest.raises(cg.ConvergenceError, match=r"constraint is condition 0 at t = 0\.5"):
        cg.solve(problem, cg.Galerkin(3), 4)


def test_a_waypoint_leaves_the_bounds_of_positions_as_they_are():
    """The cheapest way would be up to 1.3 at half time, but no more than 0.7 is allowed."""
    wants = {"running_cost": lambda t, x, v, u: u[0] ** 2 / 2 - 500 * x[0], "end": [0.0]}
    for waypoint in ([None], [(0.1, 5.0)]):
        problem = double_integrator(**wants, position_bounds=(-1.0, 0.7), waypoints=[(0.5, waypoint)])
        assert np.max(cg.solve(problem, cg.Galerkin(3), 8).x) == pytest.approx(0.7, abs=SOLVED)


@pytest.mark.slow
def test_a_waypoint_that_asks_for_nothing_at_a_free_time_is_named():
    """The path is known, but not when the waypoint is passed."""
    free = double_integrator(
        running_cost=lambda t, x, v, u: u[0] ** 2 / 2 + 1, duration_bounds=(0.2, 5.0), waypoints=[(0.5, [None])]
    )
    with pytest.raises(cg.LimitReached, match="leave out a waypoint at a free time that asks for nothing"):
        cg.solve(free, tol=1e-5)
