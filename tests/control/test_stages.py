"""Components that follow rates, conditions on the ends, phases, held controls, fatrop: exact values and orders."""

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from control_problems import cart_pole, double_integrator, minimum_time, pendulum
from scipy.optimize import minimize_scalar
from slow import slow

import casadi_galerkin as cg

SOLVED = 1e-8  # what a solver leaves of the optimality conditions, amplified by their conditioning
BOTH = pytest.mark.parametrize("solver", [cg.ipopt, cg.fatrop], ids=str)
RULES = pytest.mark.parametrize("rule", [cg.gauss, cg.radau, lambda m: cg.lobatto(m + 1)], ids=["G", "R", "L"])


def first_order(**changes):
    """x' = u - x from 0 to 1 in unit time, least ∫u²/2: u = e^t/sinh(1), cost 1/(1 - e^-2)."""
    fields = {
        **dict.fromkeys(("lagrangian", "force", "start_velocity", "end_velocity")),
        "rates": lambda t, x, v, u: u[0] - x[0],
    }
    return double_integrator(**(fields | changes))


def nonlinear(**changes):
    """A first-order component without a simple solution: x' = sin(x) + u, least ∫(u² + x²)/2 + x⁴."""
    return first_order(
        rates=lambda t, x, v, u: ca.sin(x[0]) + u[0],
        running_cost=lambda t, x, v, u: (u[0] ** 2 + x[0] ** 2) / 2,
        **({"end": [None], "start": [1.5], "terminal_cost": lambda t, x, v: x[0] ** 4} | changes),
    )


def driven(pushed=None, size=0.0, **changes):
    """A pendulum whose torque lags behind its order, and the work it took: a mechanical component and two of rates.

    `pushed` is the component that gets a small extra force or rate, `size` sin(3 t).
    """

    def extra(t, i):
        return size * ca.sin(3 * t) if i == pushed else 0

    fields = {
        "lagrangian": lambda t, x, v: (1 + x[0] ** 2 / 5) * v[0] ** 2 / 2 + ca.cos(x[0]),
        "t_span": (0.0, 2.0),
        "start": [0.0, 0.0, 0.0],
        "end": [1.0, None, None],
        "start_velocity": [0.0, None, None],
        "end_velocity": [0.0, None, None],
        "force": lambda t, x, v, u: x[2] - v[0] / 10 + extra(t, 0),
        "rates": lambda t, x, v, u: [x[2] ** 2 + extra(t, 1), u[0] - x[2] + extra(t, 2)],
        "terminal_cost": lambda t, x, v: x[1] + x[2] ** 2 / 3,
    }
    return double_integrator(**(fields | changes))


# components that follow rates


@BOTH
@RULES
def test_first_order_problem_is_exact(solver, rule):
    path = cg.solve(first_order(), cg.Galerkin(6, quadrature=rule(6)), 4, solver=solver)
    times = np.linspace(0, 1, 9)
    assert path.cost == pytest.approx(1 / (1 - np.exp(-2)), rel=1e-12)
    np.testing.assert_allclose(path(times)[0], np.sinh(times) / np.sinh(1), rtol=0, atol=1e-9)
    np.testing.assert_allclose(path.costate(path.t)[0], -np.exp(path.t) / np.sinh(1), rtol=0, atol=1e-9)
    np.testing.assert_allclose(path.hamiltonian, path.hamiltonian[0], rtol=1e-9)


@cache
def resolved(make):
    return cg.solve(make(), cg.Galerkin(12), 12)


@pytest.mark.parametrize("make", [driven, *slow(nonlinear)])
@pytest.mark.parametrize(("degree", "meshes"), [(3, (6, 9, 12)), *slow((1, (20, 40, 80)))])
@pytest.mark.slow
def test_cost_and_joints_of_components_with_rates_have_twice_the_degree(make, degree, meshes):
    exact, errors = resolved(make), []
    for n in meshes:
        path = cg.solve(make(), cg.Galerkin(degree), n)
        sizes = np.max(np.abs(exact.x), axis=1, keepdims=True)
        errors.append([abs(path.cost - exact.cost), *np.max(np.abs(path.x - exact(path.t)) / sizes, axis=1)])
    slopes = [np.polyfit(np.log(meshes), np.log(error), 1)[0] for error in np.transpose(errors)]
    np.testing.assert_allclose(slopes, -2 * degree, rtol=0, atol=0.4)


@pytest.mark.parametrize("changes", [{}, {"hold": True}, {"path_constraint": (lambda t, x, v, u: x[2], -9, 6.5)}])
@pytest.mark.slow
def test_the_costate_says_what_a_small_force_or_rate_costs(changes):
    method, step = cg.Galerkin(5, quadrature=cg.lobatto(6)), 1e-3
    paths = [cg.solve(driven(**changes), method, 12, solver=solver) for solver in (cg.ipopt, cg.fatrop)]
    steps = np.diff(paths[0].t)[:, None]
    times = (paths[0].t[:-1, None] + steps * method.quadrature.points).ravel()
    weights = (steps * method.quadrature.weights).ravel()
    for pushed in range(3):
        more, less = (cg.solve(driven(pushed, size, **changes), method, 12).cost for size in (step, -step))
        for path in paths:
            known = np.sum(weights * path.costate(times)[pushed] * np.sin(3 * times))
            assert (more - less) / (2 * step) == pytest.approx(known, rel=1e-4, abs=1e-7)


def test_a_rate_of_a_mechanical_motion_is_its_integral():
    """Effort as a component: bounding it at the end is an integral constraint, and the time then least."""
    problem = double_integrator(
        start=[0.0, 0.0],
        end=[1.0, 6.0],
        start_velocity=[0.0, None],
        end_velocity=[0.0, None],
        force=lambda t, x, v, u: u,
        rates=lambda t, x, v, u: u[0] ** 2 / 2,
        running_cost=lambda t, x, v, u: 1,
        duration_bounds=(0.2, 5.0),
        t_span=(0.0, 1.5),
    )
    path = cg.solve(problem, cg.Galerkin(3), 6)  # 6/T³ of effort for a duration T
    assert path.t[-1] == pytest.approx(1, abs=SOLVED)
    assert path.x[1, -1] == 6
    assert path.end_velocity[1] == pytest.approx(18, rel=1e-6)  # u²/2 at the end


def test_replay_refuses_rates():
    with pytest.raises(ValueError, match=r"an InitialProblem has no rates, which x\[1\] follows"):
        cg.solve(driven(), cg.Galerkin(3), 6).replay()


# conditions on the ends


@BOTH
def test_arrival_on_a_circle_along_it_is_the_best_of_all_angles(solver):
    def effort(angle):  # least ∫|u|²/2 of a free mass from rest: 6 d²/T³ - 6 d·v/T² + 2 v²/T
        place, speed = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        d = place - [3.0, 1.0]
        return 6 * d @ d / 8 - 6 * d @ speed / 4 + speed @ speed

    best = minimize_scalar(effort, bounds=(-1.5, 1.5), method="bounded", options={"xatol": 1e-12})
    problem = double_integrator(
        lagrangian=lambda t, x, v: ca.dot(v, v) / 2,
        t_span=(0.0, 2.0),
        start=[3.0, 1.0],
        end=[None, None],
        start_velocity=[0.0, 0.0],
        end_velocity=[None, None],
        running_cost=lambda t, x, v, u: ca.dot(u, u) / 2,
        controls=2,
        end_conditions=(lambda x0, v0, x1, v1: [ca.dot(x1, x1) - 1, v1[0] + x1[1], v1[1] - x1[0]], 0, 0),
    )
    path = cg.solve(problem, cg.Galerkin(3), 4, solver=solver)
    assert path.cost == pytest.approx(best.fun, rel=1e-9)
    assert np.arctan2(*path.x[::-1, -1]) == pytest.approx(best.x, abs=1e-6)


def test_conditions_join_both_ends_and_hold_within_bounds():
    joined = {"start": [None], "end": [None], "end_conditions": (lambda x0, v0, x1, v1: x1 - x0, 1, np.inf)}
    assert cg.solve(double_integrator(**joined), cg.Galerkin(3), 4).cost == pytest.approx(6, abs=SOLVED)
    coasting = {"start_velocity": [None], "end_velocity": [None]}
    periodic = double_integrator(**coasting, end_conditions=(lambda x0, v0, x1, v1: v1 - v0, 0, 0))
    path = cg.solve(periodic, cg.Galerkin(3), 4)
    assert path.cost == pytest.approx(0, abs=1e-12)
    assert [*path.start_velocity, *path.end_velocity] == pytest.approx([1, 1], abs=SOLVED)


def test_a_condition_takes_parameters():
    fields = {
        "lagrangian": lambda t, x, v, p: v[0] ** 2 / 2,
        "force": lambda t, x, v, u, p: u,
        "running_cost": lambda t, x, v, u, p: u[0] ** 2 / 2,
        "end": [None],
        "parameters": [2.0],
        "end_conditions": (lambda x0, v0, x1, v1, p: x1 - p, 0, 0),
    }
    assert cg.solve(double_integrator(**fields), cg.Galerkin(3), 4).cost == pytest.approx(24, abs=SOLVED)
    free = double_integrator(**fields, parameter_bounds=(0.5, 3.0))
    assert cg.solve(free, cg.Galerkin(3), 4).cost == pytest.approx(1.5, abs=SOLVED)  # the nearest place


# phases and held controls


@pytest.mark.parametrize("degree", [2, *slow(6)])
def test_a_switching_time_is_found_and_the_control_exact_between(degree):
    problem = replace(minimum_time(), breakpoints=[0.3], duration_bounds=(0.1, 10.0), hold=True)
    path = cg.solve(problem, cg.Galerkin(degree), 2)
    np.testing.assert_allclose(path.t, [0, 1, 2], rtol=0, atol=SOLVED)
    np.testing.assert_allclose(path.control.values, [[1, -1]], rtol=0, atol=SOLVED)
    assert path.problem.breakpoints == (path.t[1],)
    again = cg.transcribe(problem, cg.Galerkin(degree), 2).solve(guess=path)
    assert again.iterations <= 4
    np.testing.assert_allclose(again.t, path.t, rtol=0, atol=SOLVED)


def test_every_phase_keeps_its_own_bounds():
    fields = {
        "duration_bounds": ([0.1, 0.7], [0.4, 2.0]),
        "running_cost": lambda t, x, v, u: u[0] ** 2 / 2 + 100,
    }
    with pytest.raises(
        ValueError, match=r"the duration of the phase from 0.0 to 0.5 = 0.5 lies outside its duration_bounds"
    ):
        double_integrator(breakpoints=[0.5], **fields)
    problem = double_integrator(breakpoints=[0.25], **fields)
    path = cg.solve(problem, cg.Galerkin(3), 4)
    assert np.diff([0.0, *path.problem.breakpoints, path.t[-1]]) == pytest.approx([0.1, 0.7], abs=SOLVED)
    assert path.cost == pytest.approx(6 / 0.8**3 + 80, abs=1e-6)


@pytest.mark.parametrize("count", [2, *slow(6)])
def test_durations_that_their_bounds_give_are_as_given(count):
    given = double_integrator(breakpoints=[0.3], hold=True)
    bounded = replace(given, duration_bounds=([0.3, 0.7], [0.3, 0.7]))
    costs = [cg.solve(problem, cg.Galerkin(3), count).cost for problem in (given, bounded)]
    assert costs[1] == pytest.approx(costs[0], rel=1e-10)


def held_cost(count):
    """Least ∫u²/2 of the double integrator with `count` equal held values: the nearest point of two conditions on u."""
    middles = (np.arange(count) + 0.5) / count
    rows = np.stack((1 - middles, np.ones(count))) / count  # place and velocity at the end
    values = np.linalg.lstsq(rows, [1.0, 0.0], rcond=None)[0]
    return values @ values / (2 * count)


@BOTH
@pytest.mark.parametrize("count", [5, *slow(12)])
def test_held_controls_have_the_least_cost_of_their_kind(count, solver):
    path = cg.solve(double_integrator(hold=True), cg.Galerkin(3), count, solver=solver)
    assert path.cost == pytest.approx(held_cost(count), rel=1e-10)
    assert path.control.values.shape == (1, count)
    np.testing.assert_array_equal(path.control(path.t[:-1]), path.control.values)
    start = {"start": path.x[:, 0], "velocity": path.start_velocity}
    again = cg.InitialProblem(path.problem.lagrangian, (0, 1), force=path.replay(), **start)
    np.testing.assert_allclose(cg.solve(again, path.method, mesh=path.t).x, path.x, rtol=0, atol=1e-11)


def test_a_held_control_is_no_matter_of_tolerance():
    with pytest.raises(ValueError, match="with hold every interval has one value of the controls"):
        cg.solve(double_integrator(hold=True), tol=1e-6)


# fatrop


@pytest.mark.parametrize("make", [minimum_time, *slow(cart_pole, lambda: pendulum(3.0))])
@RULES
def test_fatrop_finds_what_ipopt_finds(make, rule):
    method = cg.Galerkin(4, quadrature=rule(4))
    first, other = (cg.solve(make(), method, 20, solver=solver) for solver in (cg.ipopt, cg.fatrop))
    assert other.cost == pytest.approx(first.cost, rel=1e-8)
    sizes = np.max(np.abs(first.x))
    np.testing.assert_allclose(other.x, first.x, rtol=0, atol=1e-6 * sizes)
    np.testing.assert_allclose(
        other.costate(other.t), first.costate(first.t), rtol=0, atol=1e-4 * np.max(np.abs(sizes))
    )
    assert other.solver == "fatrop (Solve Succeeded)"


@pytest.mark.parametrize("factor", [1e-5, 1e4])
def test_fatrop_takes_units_of_some_orders(factor):
    path = cg.solve(double_integrator(end=[factor]), cg.Galerkin(3), 10, solver=cg.fatrop)
    assert path.cost / factor**2 == pytest.approx(6, rel=1e-8)


def test_where_both_solvers_fail_both_are_named():
    problem = double_integrator(control_bounds=(-1, 1))  # too weak
    both = r"fatrop stopped with .No Optimum Found. after \d+ iterations; .*IPOPT found no path from the same start"
    with pytest.raises(cg.ConvergenceError, match=both):
        cg.solve(problem, cg.Galerkin(3), 5, solver=cg.fatrop)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"start": [None], "end_conditions": (lambda x0, v0, x1, v1: x1 - x0, 1, 1)}, "fatrop takes end_conditions on"),
        ({"end_conditions": (lambda x0, v0, x1, v1: x1, 1, 1)}, "got 4 for 3 at the end: state nothing twice, or take"),
    ],
)
def test_what_fatrop_cannot_take_is_refused_and_solved_by_ipopt(changes, message):
    problem = double_integrator(**changes)
    with pytest.raises(ValueError, match=rf"{message}.*"):
        cg.solve(problem, cg.Galerkin(3), 4, solver=cg.fatrop)
    assert cg.solve(problem, cg.Galerkin(3), 4).cost == pytest.approx(6, abs=SOLVED)


def test_fatrop_takes_no_phases():
    timed = double_integrator(duration_bounds=(0.1, 0.9), breakpoints=[0.5])
    for problem in (timed, double_integrator(jumps=[(0.5, lambda x, v: (x, -v))])):
        with pytest.raises(
            ValueError, match="fatrop takes no phases, such as jumps and breakpoints with free times make"
        ):
            cg.solve(problem, cg.Galerkin(3), 4, solver=cg.fatrop)


@pytest.mark.parametrize("option", [{"nonsense": 1}, {"max_iter": "many"}, {"tol": np.nan}, {"max_iter": 0}], ids=str)
def test_options_that_fatrop_does_not_take_are_refused_at_once(option):
    with pytest.raises(ValueError, match=f"fatrop has no option {next(iter(option))} that takes"):
        cg.fatrop.with_options(**option)


def test_options_reach_fatrop_and_ipopt_solves_where_it_fails():
    path, best = (
        cg.solve(pendulum(3.0), cg.Galerkin(3), 8, solver=solver)
        for solver in (cg.fatrop.with_options(max_iter=1), cg.ipopt)
    )
    failed = "fatrop stopped with 'No Optimum Found' after 2 iterations"
    assert path.solver == f"{best.solver}, from the same start, after {failed}"
    assert (path.cost, path.iterations) == (best.cost, best.iterations + 2)
