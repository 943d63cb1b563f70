"""The answer of a trajectory optimization: Hamiltonian, costate, replay, the problem found, summary and plot."""

import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from control_problems import (
    cart_pole,
    cartesian_pendulum,
    double_integrator,
    everything,
    first_order,
    minimum_time,
    pendulum,
    speed_limited,
    varying_mass,
)
from scipy.integrate import quad, solve_ivp

import casadi_galerkin as cg

ROUNDOFF = 1e-12  # of sums of a few hundred terms of order 1 to 100
SOLVED = 1e-8  # what IPOPT leaves of the optimality conditions, amplified by their conditioning


def test_hamiltonian_is_constant_to_twice_the_degree():
    spread = [np.ptp(cg.solve(pendulum(3.0), cg.Galerkin(3), n).hamiltonian) for n in (8, 16)]
    assert np.log2(spread[0] / spread[1]) == pytest.approx(6, abs=0.5)


def test_hamiltonian_is_the_mean_that_its_definition_says():
    # everything depends on the velocity, nothing is separable
    problem = varying_mass()
    path = cg.solve(problem, cg.Galerkin(4), intervals=6)
    t, x, v, u, costate, rate = (ca.SX.sym(name) for name in ("t", "x", "v", "u", "costate", "rate"))
    lagrangian = problem.lagrangian(t, x, v)
    force = ca.gradient(lagrangian, x) + problem.force(t, x, v, u)
    integrand = problem.running_cost(t, x, v, u) + costate * force + rate * ca.gradient(lagrangian, v)
    mean = integrand - v * ca.gradient(integrand, v) - rate * ca.gradient(integrand, rate)
    function, times = ca.Function("mean", [t, x, v, u, costate, rate], [mean]), path.control.times
    along = (path(times), path(times, 1), path.control.values, path.costate(times), path.costate(times, 1))
    values = np.array(function(times[None, :], *along)).reshape(6, -1)
    np.testing.assert_allclose(values @ path.method.quadrature.weights, path.hamiltonian, rtol=0, atol=ROUNDOFF)


def test_hamiltonian_is_what_more_time_costs():
    def held(bounds):
        changes = {"running_cost": lambda t, x, v, u: 18 + u[0] ** 2 / 2, "duration_bounds": bounds}
        return cg.solve(double_integrator(t_span=(0, 0.5), **changes), cg.Galerkin(3), intervals=4)

    # least 18 T + 6/T³, whose derivative is 18 - 18/T⁴: zero at T = 1, and not where a bound holds T = 1/2
    np.testing.assert_allclose(held((0.2, 5.0)).hamiltonian, 0, rtol=0, atol=1e-6)
    np.testing.assert_allclose(held((0.2, 0.5)).hamiltonian, 18 - 18 * 2**4, rtol=1e-8, atol=0)


def test_costate_is_the_price_of_a_force():
    def with_push(size):
        problem = pendulum(3.0, force=lambda t, x, v, u: u + size * ca.sin(2 * t))
        return cg.solve(problem, cg.Galerkin(6), intervals=12)

    path, step = with_push(0.0), 1e-4
    slope = (with_push(step).cost - with_push(-step).cost) / (2 * step)
    price = quad(lambda t: path.costate(t)[0] * np.sin(2 * t), 0, 3, epsabs=1e-10, limit=200)[0]
    assert slope == pytest.approx(price, abs=1e-6)  # central difference: step², and roundoff / step


def test_momenta_at_the_ends_are_those_of_the_velocities_imposed():
    problem = pendulum(3.0, start_velocity=[0.3], end_velocity=[-0.2])
    path = cg.solve(problem, cg.Galerkin(4), intervals=10)
    assert path.momentum[0, [0, -1]] == pytest.approx([0.3, -0.2], abs=1e-10)


def test_replayed_force_is_that_of_the_controls():
    path = cg.solve(cart_pole(), cg.Galerkin(4), intervals=7)
    force, rng = path.replay(), np.random.default_rng(2)
    for t in np.linspace(0.01, 1.99, 23):
        x, v = rng.standard_normal((2, 2))
        np.testing.assert_allclose(
            np.array(force(t, x, v)), np.array(path.problem.force(t, x, v, path.control(t))), rtol=1e-11, atol=1e-11
        )


def replayed(path):
    """Largest differences of positions and momenta at the joints from the same method stepped under its controls."""
    found = path.problem
    start = {"start": path.x[:, 0], "velocity": path.start_velocity, "parameters": found.parameters}
    again = cg.InitialProblem(found.lagrangian, found.t_span, force=path.replay(), **start)
    stepped = cg.solve(again, path.method, mesh=path.t)
    return np.max(np.abs(stepped.x - path.x)), np.max(np.abs(stepped.momentum - path.momentum))


@pytest.mark.parametrize("degree", [20, 40])
def test_replay_is_the_same_path_at_high_degrees(degree):
    # IPOPT holds the equations to 1e-12 of terms of order 10; monomials lost 5e-10 at degree 20, 2e-3 at 40
    assert max(replayed(cg.solve(pendulum(3.0), cg.Galerkin(degree), intervals=3))) < 1e-11


def jumps(path):
    """Jumps of the one control at the inner joints, (N - 1,)."""
    ends = path.control.at(np.array([0.0, 1.0])).reshape(-1, 2)
    return np.abs(ends[1:, 0] - ends[:-1, 1])


LEFT_RADAU = cg.Quadrature(1 - np.array(cg.radau(3).points)[::-1], cg.radau(3).weights[::-1])


def held():
    return double_integrator(hold=True)


@pytest.mark.parametrize(("problem", "jump"), [(minimum_time, 1.9), (varying_mass, 5e-4), (held, 0.4)])
@pytest.mark.parametrize("rule", [cg.radau(3), LEFT_RADAU, cg.gauss(3)], ids=["radau", "left radau", "gauss"])
def test_replay_is_the_same_path_where_controls_jump_at_a_joint(problem, jump, rule):
    path = cg.solve(problem(), cg.Galerkin(3, quadrature=rule), intervals=10)
    assert np.max(jumps(path)) > jump
    np.testing.assert_allclose(path.control(path.control.times), path.control.values, rtol=0, atol=ROUNDOFF)
    assert max(replayed(path)) < ROUNDOFF


def test_replay_refuses_two_values_at_one_time():
    one = cg.solve(double_integrator(), cg.Galerkin(3, quadrature=cg.lobatto(4)), intervals=10)
    assert max(replayed(one)) < ROUNDOFF  # points on both sides of a joint, and one value there
    following = double_integrator(running_cost=lambda t, x, v, u: (u[0] - v[0] ** 3) ** 2)  # u follows v, which jumps
    two = cg.solve(following, cg.Galerkin(2, quadrature=cg.lobatto(3)), intervals=4)
    when = two.t[1 + np.argmax(jumps(two))]
    with pytest.raises(ValueError, match=rf"u\[0\] jumps by .* at the joint t = {when:g}, where .* both sides"):
        two.replay()
    with pytest.raises(ValueError, match=r"u\[0\] jumps by 1.21 at the joint .*, where .* both sides"):
        cg.solve(held(), cg.Galerkin(3, quadrature=cg.lobatto(4)), intervals=10).replay()


def test_what_cannot_be_replayed_is_summarized_under_a_constraint():
    rod = cartesian_pendulum(
        t_span=(0.0, 2.0),
        end=[1.0, 0.0],
        force=lambda t, x, v, u: [u[0], 0],
        running_cost=lambda t, x, v, u: (u[0] - 10 * v[0] ** 3) ** 2,  # u follows v, which jumps
    )
    path = cg.solve(rod, cg.Galerkin(2, quadrature=cg.lobatto(3)), intervals=8)
    with pytest.raises(ValueError, match="no force of time alone has both values"):
        path.replay()
    assert "defect" in repr(path)


@pytest.mark.slow
def test_the_problem_found_has_the_times_and_parameters_found_and_is_solved_by_the_same_path():
    path = cg.solve(everything(), cg.Galerkin(3), intervals=10)
    assert path.problem.t_span == (0.3, path.t[-1]) != everything().t_span
    assert path.problem.parameters == path.parameters != everything().parameters
    assert max(replayed(path)) < ROUNDOFF
    again = cg.solve(path.problem, path.method, intervals=10)  # both still free
    assert again.cost == pytest.approx(path.cost, abs=1e-10)
    assert again.t[-1] == pytest.approx(path.t[-1], abs=SOLVED)


@pytest.mark.parametrize("begin", [0.0, 1e6, 3e7])
def test_the_problem_found_may_be_changed_where_a_bound_holds_its_duration(begin):
    # less time costs more, so that the bound holds; t_0 + T is rounded, upwards for the last two
    problem = double_integrator(duration_bounds=(0.1, 2.3), t_span=(begin, begin + 1))
    found = cg.solve(problem, cg.Galerkin(3), intervals=4).problem
    assert found.t_span[1] - begin == pytest.approx(2.3, abs=SOLVED)
    assert replace(found, end=[2.0]).t_span == found.t_span


def test_controls_replayed_by_another_integrator_land_where_the_optimizer_said():
    path = cg.solve(pendulum(3.0), cg.Galerkin(6), intervals=12)

    def rates(t, y):
        return [y[1], -np.sin(y[0]) + path.control(min(t, 3.0))[0]]

    landed = solve_ivp(rates, (0, 3), [0, 0], method="DOP853", rtol=1e-11, atol=1e-12, max_step=0.05).y[:, -1]
    np.testing.assert_allclose(landed, [np.pi, 0], rtol=0, atol=1e-7)  # the controls themselves are of order 6


def test_summary_tells_where_the_points_do_not_see_a_jump():
    seen, unseen = (str(cg.solve(minimum_time(), cg.Galerkin(2), n)).splitlines() for n in (4, 5))
    assert [sum("defect" in line for line in lines) for lines in (seen, unseen)] == [1, 1]
    path = cg.solve(minimum_time(), cg.Galerkin(2), 5)
    where = f"[{path.t[2]:.4g}, {path.t[3]:.4g}]"  # the middle interval, which holds the jump
    assert any(line.startswith(f"  defect      {path.dynamics_defect[2]:.1e}") and where in line for line in unseen)


def test_the_defect_of_a_problem_without_momenta_is_of_its_values():
    assert "of the largest value" in str(cg.solve(first_order(), cg.Galerkin(2), 4))
    assert "of the largest momentum" in str(cg.solve(double_integrator(), cg.Galerkin(2), 4))


@pytest.mark.usefixtures("headless")
@pytest.mark.slow
def test_summary_and_plot(capsys):
    path = cg.transcribe(minimum_time(), cg.Galerkin(2), 4).solve(verbose=1)
    assert "cost        2" in capsys.readouterr().out
    axes = path.plot()
    assert [a.get_ylabel() for a in axes.figure.axes] == ["x[0]", "u[0]", "λ[0]"]
    assert path.plot(axes) is axes


# path constraints


def test_multipliers_of_a_path_constraint_are_what_its_bound_is_worth():
    path, step = cg.solve(speed_limited(0.6), cg.Galerkin(4), 20), 1e-4
    costs = [cg.solve(speed_limited(0.6 + change), cg.Galerkin(4), 20).cost for change in (-step, step)]
    weights = np.outer(np.diff(path.t), path.method.quadrature.weights).ravel()
    worth = path.path_multipliers.values[0] @ weights
    assert worth == pytest.approx(-(costs[1] - costs[0]) / (2 * step), rel=1e-6)
    assert path.path_multipliers(1.0)[0] > 1 > 1e-6 > path.path_multipliers(0.25)[0] >= 0  # held, not reached


@pytest.mark.slow
def test_a_mesh_that_misses_the_layers_is_told():
    layers = first_order(
        t_span=(0.0, 1000.0),
        start=[1.0],
        end=[1.5],
        rates=lambda t, x, v, u: -(x**3) + u,
        running_cost=lambda t, x, v, u: (x**2 + u**2) / 2,
    )
    assert "NOT RESOLVED" in repr(cg.solve(layers, cg.Galerkin(3), 10))
    assert "NOT RESOLVED" not in repr(cg.solve(layers, tol=1e-3, of=lambda path: path.cost))


@pytest.mark.parametrize("intervals", [1, 4])
def test_a_path_that_the_degree_holds_exactly_is_resolved(intervals):
    """A cubic, whose last Legendre coefficient is as large as others: the equations hold between the points, too."""
    assert "NOT RESOLVED" not in repr(cg.solve(double_integrator(), cg.Galerkin(3), intervals))


@pytest.mark.parametrize("hold", [False, True])
def test_a_hamiltonian_that_should_be_constant_shows_what_no_derivative_sees(hold):
    """A cost that jumps with the control has no derivative that tells of it; held controls have no such Hamiltonian."""
    blind = cg.solve(
        double_integrator(running_cost=lambda t, x, v, u: u[0] ** 2 / 2 + ca.floor(4 * u[0]), hold=hold),
        cg.Galerkin(3),
        10,
    )
    assert ("NOT RESOLVED: the Hamiltonian, which should be constant, varies by" in repr(blind)) is not hold


def test_a_corner_of_the_control_inside_of_an_interval_is_no_reason_to_doubt():
    """The Hamiltonian varies by a thousandth of the cost, the cost is right to 2e-5."""
    bounded = cg.solve(double_integrator(control_bounds=(-4.5, 4.5)), cg.Galerkin(2), 20)
    assert bounded.cost == pytest.approx(6.227885682970176, rel=2e-5)
    assert np.ptp(bounded.hamiltonian) > 1e-3
    assert "NOT RESOLVED" not in repr(bounded)


def test_a_path_without_costs_has_no_hamiltonian_that_varies():
    """What is left of it is rounding, and says nothing of the mesh."""
    move = cg.ControlProblem(
        lambda t, x, v: v[0] ** 2 / 2, (0, 1), 0.0, 1.0, 0.0, 0.0, force=lambda t, x, v, u: u, controls=1
    )
    path = cg.solve(move, cg.Galerkin(4), 8)
    assert path.cost == 0
    assert "NOT RESOLVED" not in repr(path)


@pytest.mark.slow
def test_a_hamiltonian_jumps_at_given_times_and_is_constant_between_them():
    passing = cg.solve(double_integrator(waypoints=[(0.3, [0.9])]), cg.Galerkin(3), 10)
    assert np.ptp(passing.hamiltonian) > 100
    assert re.search(r"Hamiltonian .* varies by \S+e-1\d between breakpoints", repr(passing))
    assert "between breakpoints" not in repr(cg.solve(double_integrator(), cg.Galerkin(3), 10))


@pytest.mark.usefixtures("headless")
@pytest.mark.slow
def test_a_picture_shows_path_constraints_bounds_and_breakpoints():
    problem = double_integrator(
        t_span=(0.0, 2.0),
        path_constraint=(lambda t, x, v, u: v, -1, 0.6),
        position_bounds=(-np.inf, 1.5),
        breakpoints=[0.5],
    )
    path = cg.solve(problem, cg.Galerkin(4), 4)
    figure = path.plot().figure
    top, _, limited, _, multipliers = figure.axes
    assert (limited.get_ylabel(), multipliers.get_ylabel()) == ("g[0]", "multiplier μ")
    dashed = [line.get_ydata()[0] for line in limited.lines if line.get_linestyle() == "--"]
    assert dashed == [-1, 0.6]
    assert [line.get_ydata()[0] for line in top.lines if line.get_linestyle() == "--"] == [1.5]
    assert [line.get_xdata()[0] for line in top.lines if line.get_color() == "0.6"] == [0.5]
    with pytest.raises(ValueError, match="there is no path constraint to draw"):
        cg.solve(double_integrator(), cg.Galerkin(4), 3).plot_constraints()


def test_costate_is_the_price_of_a_rate_where_the_cost_depends_on_the_velocity():
    """More of a rate, ε f(t), costs ∫ λ f dt."""

    def solved(more):
        problem = first_order(
            rates=lambda t, x, v, u: u - x / 2 + more * ca.exp(-20 * (t - 0.4) ** 2),
            running_cost=lambda t, x, v, u: (v[0] ** 2 + u[0] ** 2) / 2,
        )
        return cg.solve(problem, cg.Galerkin(4), 8)

    price = (solved(1e-4).cost - solved(-1e-4).cost) / 2e-4
    path = solved(0.0)
    priced = quad(lambda t: path.costate(t)[0] * np.exp(-20 * (t - 0.4) ** 2), 0, 1, points=path.t)[0]
    assert priced == pytest.approx(price, rel=1e-6)


def race(curvature):
    """Full speed to the middle and back."""
    return first_order(
        end=[0.0],
        control_bounds=(-1.0, 1.0),
        running_cost=lambda t, x, v, u: -x[0] - curvature * v[0] ** 2 / 2,
    )


@pytest.mark.parametrize("curvature", [1.0, 0.01])
def test_costate_jumps_with_the_velocity_that_the_cost_depends_on(curvature):
    """λ is t - 1/2, and -c x' with it."""
    times = np.array([0.3, 0.45, 0.499, 0.501, 0.7])
    slope = cg.solve(race(curvature), cg.Galerkin(4), 4).costate(times)[0] - (times - 0.5)
    np.testing.assert_allclose(slope, -curvature * np.sign(0.5 - times), rtol=0, atol=1e-5)
