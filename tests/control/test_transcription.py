"""Trajectory optimisation: exact derivatives, exact and published costs, orders, what the multipliers mean."""

import pickle
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from control_problems import (
    cart_pole,
    double_integrator,
    everything,
    minimum_time,
    pendulum,
    pendulum_in_three,
    varying_mass,
)
from scipy.integrate import quad, solve_ivp
from scipy.optimize import root

import casadi_galerkin as cg

ROUNDOFF = 1e-12  # of sums of a few hundred terms of order 1 to 100
SOLVED = 1e-8  # what IPOPT leaves of the optimality conditions, amplified by their conditioning

METHODS = [
    cg.Galerkin(1),
    cg.Galerkin(3),
    cg.Galerkin(3, quadrature=cg.gauss(4)),
    cg.Galerkin(2, quadrature=cg.lobatto(3)),
]


@pytest.fixture(params=METHODS, ids=str)
def method(request):
    return request.param


@pytest.fixture(params=[everything, cart_pole, minimum_time])
def graph(request, method):
    return cg.transcribe(request.param(), method, 4).graph


@pytest.fixture
def somewhere(graph):
    rng = np.random.default_rng(1)
    sizes = (graph.unknowns.numel(), graph.data.numel(), graph.equations.numel())
    unknowns, data, multipliers = (0.5 + 0.3 * rng.standard_normal(size) for size in sizes)
    data[-5:] = np.linspace(0, 1, 5)  # the mesh, as fractions of the duration
    return unknowns, np.where(data == 0, 0.1, data), multipliers


def largest(matrix):
    return float(ca.norm_inf(ca.vec(ca.densify(matrix))))


def test_gradient_is_casadis_own(graph, somewhere):
    unknowns, data, _ = somewhere
    own = ca.Function("own", [graph.unknowns, graph.data], [ca.gradient(graph.cost, graph.unknowns)])(unknowns, data)
    assert largest(graph.gradient(unknowns, data)[1] - own) <= ROUNDOFF * (1 + largest(own))


def test_jacobian_is_casadis_own_with_no_nonzero_more(graph, somewhere):
    unknowns, data, _ = somewhere
    jacobian = ca.jacobian(graph.equations, graph.unknowns)
    own = ca.Function("own", [graph.unknowns, graph.data], [jacobian])(unknowns, data)
    ours = graph.jacobian(unknowns, data)[1]
    assert ours.sparsity() == own.sparsity()
    assert largest(ours - own) <= ROUNDOFF * (1 + largest(own))


def test_hessian_is_casadis_own_with_no_nonzero_more(graph, somewhere):
    unknowns, data, multipliers = somewhere
    factor, lam = ca.MX.sym("factor"), ca.MX.sym("lam", len(multipliers))
    lagrangian = factor * graph.cost + ca.dot(lam, graph.equations)
    upper = ca.triu(ca.hessian(lagrangian, graph.unknowns)[0])
    own = ca.Function("own", [graph.unknowns, graph.data, factor, lam], [upper])(unknowns, data, 0.7, multipliers)
    ours = graph.hessian(unknowns, data, 0.7, multipliers)
    assert ours.sparsity() == own.sparsity()
    assert largest(ours - own) <= ROUNDOFF * (1 + largest(own))


@pytest.mark.parametrize(("degree", "intervals"), [(1, 9), (4, 20), (7, 5)])
def test_derivatives_are_block_sparse(degree, intervals):
    program = cg.transcribe(cart_pole(), cg.Galerkin(degree), intervals).program
    nodes, d = degree + 1, 2
    path = intervals * (nodes * d) ** 2 - (intervals - 1) * d**2 - 2 * d * nodes * d  # less the ends, which are given
    controls = intervals * degree * nodes  # the control pushes the cart only
    assert program.jacobian.nnz_out(1) == path + controls
    # L is quadratic in the cart's velocity and ignores its position: no second derivative there
    pole, mixed, ends = nodes * (nodes + 1) // 2, nodes**2, 3 * nodes - 1
    path = intervals * (pole + mixed) - (intervals - 1) * 2 - 2 * ends
    assert program.hessian.nnz_out(0) == path + intervals * degree


@pytest.mark.parametrize("degree", [2, 3, 5])
def test_minimum_effort_is_exact(degree):
    path = cg.solve(double_integrator(), cg.Galerkin(degree), intervals=5)
    times = np.linspace(0, 1, 33)
    assert path.cost == pytest.approx(6, abs=1e-11)
    assert path(0.25)[0] == pytest.approx(3 * 0.25**2 - 2 * 0.25**3, abs=1e-9 if degree > 2 else 1e-3)
    np.testing.assert_allclose(path.control(times)[0], 6 - 12 * times, rtol=0, atol=1e-10)
    np.testing.assert_allclose(path.costate(times)[0], -(6 - 12 * times), rtol=0, atol=1e-10)
    np.testing.assert_allclose(path.hamiltonian, -18, rtol=0, atol=1e-10)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_minimum_time_is_exact_with_a_joint_at_the_jump(degree):
    path = cg.solve(minimum_time(), cg.Galerkin(degree), intervals=10)
    assert path.t[-1] == pytest.approx(2, abs=SOLVED)
    assert path.cost == pytest.approx(2, abs=SOLVED)
    np.testing.assert_allclose(path.control.values[0, : 5 * degree], 1, rtol=0, atol=1e-6)
    np.testing.assert_allclose(path.hamiltonian, 0, rtol=0, atol=SOLVED)  # free duration
    assert path.control_overshoot.max() <= ROUNDOFF


def test_bang_bang_control_overshoots_where_the_jump_falls_inside_an_interval():
    path = cg.solve(minimum_time(), cg.Galerkin(3), intervals=5)
    assert np.argmax(path.control_overshoot) == 2
    assert path.control_overshoot[2] > 0.1
    assert path.t[-1] > 2 - SOLVED


def test_cart_pole_reaches_kellys_cost():
    assert cg.solve(cart_pole(), cg.Galerkin(4), intervals=20).cost == pytest.approx(58.80767, abs=1e-3)
    assert cg.solve(cart_pole(), cg.Galerkin(8), intervals=20).cost == pytest.approx(58.807667459, abs=SOLVED)


@pytest.mark.parametrize("intervals", [20, 60])
def test_cart_pole_does_not_lose_its_way_on_a_fine_mesh(intervals):
    path = cg.solve(cart_pole(), cg.Galerkin(8), intervals)
    assert path.cost == pytest.approx(58.807667459, abs=SOLVED)
    assert path.iterations < 40


def shooting_cost(path, duration):
    """Cost of the pendulum by single shooting on Pontryagin's conditions, u = -λ, started from our costate."""

    def rates(t, y):
        return [y[1], -np.sin(y[0]) - y[2], y[3], -np.cos(y[0]) * y[2], y[2] ** 2 / 2]

    def run(costate):
        return solve_ivp(rates, (0, duration), [0, 0, *costate, 0], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]

    answer = root(lambda c: run(c)[:2] - [np.pi, 0], [path.costate(0.0)[0], path.costate(0.0, 1)[0]], tol=1e-13)
    return run(answer.x)[4]


@pytest.mark.parametrize(("duration", "cost"), [(3.0, 2.65658286097), (5.0, 1.21259059574)])
def test_pendulum_swing_up_agrees_with_the_table_and_with_shooting(duration, cost):
    path = cg.solve(pendulum(duration), cg.Galerkin(8), intervals=20)
    assert path.cost == pytest.approx(cost, abs=1e-9)
    assert path.cost == pytest.approx(shooting_cost(path, duration), abs=1e-11)


MESHES = {
    (pendulum_in_three, 1): (20, 40, 80),
    (pendulum_in_three, 2): (8, 16, 32),
    (pendulum_in_three, 3): (6, 8, 12),
    (pendulum_in_three, 4): (8, 10, 12),
    (varying_mass, 1): (20, 40, 80),
    (varying_mass, 2): (8, 12, 16),
    (varying_mass, 3): (6, 8, 12),
    (varying_mass, 4): (8, 12, 16),
}


@pytest.mark.parametrize(("problem", "degree"), MESHES)
def test_cost_converges_with_twice_the_degree(problem, degree):
    meshes, exact = MESHES[problem, degree], cg.solve(problem(), cg.Galerkin(12), intervals=20).cost
    errors = [abs(cg.solve(problem(), cg.Galerkin(degree), n).cost - exact) for n in meshes]
    assert errors[-1] > ROUNDOFF
    slope = np.polyfit(np.log(meshes), np.log(errors), 1)[0]
    assert slope == pytest.approx(-2 * degree, abs=0.3)


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


def test_free_velocity_costs_less_and_has_no_costate():
    path = cg.solve(double_integrator(end_velocity=[None]), cg.Galerkin(3), intervals=4)
    assert path.cost == pytest.approx(1.5, abs=1e-11)
    assert path.end_velocity[0] == pytest.approx(1.5, abs=1e-10)
    assert path.costate(1.0)[0] == pytest.approx(0, abs=1e-10)


@pytest.mark.parametrize("weight", [0.5, 3.0])
def test_terminal_cost_with_free_end(weight):
    problem = double_integrator(
        end=[None], end_velocity=[None], terminal_cost=lambda t, x, v: weight / 2 * (x[0] - 1) ** 2
    )
    path = cg.solve(problem, cg.Galerkin(3), intervals=4)
    assert path.x[0, -1] == pytest.approx(weight / (3 + weight), abs=1e-10)


def test_terminal_cost_of_the_velocity():
    problem = double_integrator(end_velocity=[None], terminal_cost=lambda t, x, v: -v[0])
    # least ∫u²/2 = 6 - 6 w + 2 w² for arriving at 1 with the velocity w; less w that is least at w = 7/4
    path = cg.solve(problem, cg.Galerkin(3), intervals=4)
    assert path.end_velocity[0] == pytest.approx(7 / 4, abs=1e-10)
    assert path.cost == pytest.approx(6 - 7 * 7 / 4 + 2 * (7 / 4) ** 2, abs=1e-11)


def test_free_parameter_is_optimised_within_its_bounds():
    def heavy(bounds):
        return double_integrator(
            lagrangian=lambda t, x, v, p: p[0] * v[0] ** 2 / 2,
            force=lambda t, x, v, u, p: u,
            running_cost=lambda t, x, v, u, p: u[0] ** 2 / 2,
            terminal_cost=lambda t, x, v, p: 12 / p[0],
            parameters=[1.5],
            parameter_bounds=bounds,
        )

    inside = cg.solve(heavy((0.5, 3.0)), cg.Galerkin(3), intervals=4)  # least 6 p² + 12/p: p = 1
    assert inside.parameters[0] == pytest.approx(1, abs=SOLVED)
    assert inside.cost == pytest.approx(18, abs=1e-10)
    held = cg.solve(heavy((1.25, 3.0)), cg.Galerkin(3), intervals=4)
    assert held.parameters[0] == pytest.approx(1.25, abs=SOLVED)
    fixed = cg.solve(heavy(None), cg.Galerkin(3), intervals=4)
    assert fixed.parameters == (1.5,)
    assert fixed.cost == pytest.approx(6 * 1.5**2 + 12 / 1.5, abs=1e-10)


def test_free_duration_balances_time_against_effort():
    problem = double_integrator(
        running_cost=lambda t, x, v, u: 18 + u[0] ** 2 / 2, duration_bounds=(0.2, 5.0), t_span=(1, 3)
    )
    path = cg.solve(problem, cg.Galerkin(3), intervals=4)  # least 18 T + 6/T³: T = 1
    assert path.t[0] == 1
    assert path.t[-1] == pytest.approx(2, abs=SOLVED)
    assert path.cost == pytest.approx(24, abs=1e-10)


def test_position_bounds_hold_at_the_nodes():
    problem = double_integrator(start_velocity=[-2.0], position_bounds=(-0.1, np.inf))
    path = cg.solve(problem, cg.Galerkin(3), intervals=20)
    assert cg.solve(double_integrator(start_velocity=[-2.0]), cg.Galerkin(3), intervals=20).x.min() < -0.15
    assert path.polynomial.values.min() == pytest.approx(-0.1, abs=1e-7)
    assert path.polynomial.values.min() >= -0.1


def test_everything_at_once_is_solved_and_verified():
    path = cg.solve(everything(), cg.Galerkin(3), intervals=10)
    values = path.problem.path_constraint[0].map(30)(
        path.control.times[None, :],
        path(path.control.times),
        path(path.control.times, 1),
        path.control.values,
        np.tile(np.array(path.parameters)[:, None], (1, 30)),
    )
    assert path.violation < 1e-9
    assert np.max(np.array(values)[0]) <= 3 + SOLVED
    assert path.velocity[:, 0] == pytest.approx(path.start_velocity, abs=1e-8)
    assert path.velocity[:, -1] == pytest.approx(path.end_velocity, abs=1e-8)
    assert path.start_velocity[1] == 0.2
    assert path.end_velocity[0] == 0.1


def test_a_free_velocity_imposed_as_found_changes_nothing():
    changes = {"start": [0.0], "start_velocity": [None], "running_cost": lambda t, x, v, u: u[0] ** 2 / 2 + v[0] ** 2}
    free = cg.solve(pendulum(3.0, **changes), cg.Galerkin(5), intervals=10)
    imposed = cg.solve(
        pendulum(3.0, **(changes | {"start_velocity": free.start_velocity})), cg.Galerkin(5), intervals=10
    )
    assert imposed.cost == pytest.approx(free.cost, abs=1e-10)
    np.testing.assert_allclose(imposed.x, free.x, rtol=0, atol=1e-7)


def test_a_total_derivative_in_the_lagrangian_changes_no_path():
    plain = cg.solve(double_integrator(), cg.Galerkin(3), intervals=4)
    # d/dt (t x²); integrands of degree 7 at most, four Gauss points integrate them exactly
    gauged = double_integrator(lagrangian=lambda t, x, v: v[0] ** 2 / 2 + x[0] ** 2 + 2 * t * x[0] * v[0])
    path = cg.solve(gauged, cg.Galerkin(3, quadrature=cg.gauss(4)), intervals=4)
    np.testing.assert_allclose(path.x, plain.x, rtol=0, atol=1e-10)
    assert path.momentum[0, -1] == pytest.approx(2, abs=1e-10)  # 0 + 2 t x


def test_control_points_do_not_matter():
    costs = [
        cg.solve(pendulum(3.0), cg.Galerkin(5, control_points=points(5)), intervals=8).cost
        for points in (cg.lobatto_points, cg.chebyshev_points, cg.equispaced_points)
    ]
    assert np.ptp(costs) < 1e-11


def test_momenta_at_the_ends_are_those_of_the_velocities_imposed():
    problem = pendulum(3.0, start_velocity=[0.3], end_velocity=[-0.2])
    path = cg.solve(problem, cg.Galerkin(4), intervals=10)
    assert path.momentum[0, [0, -1]] == pytest.approx([0.3, -0.2], abs=1e-10)


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_units_of_length_do_not_matter(factor):
    problem = double_integrator(end=[factor])
    path = cg.solve(problem, cg.Galerkin(3), intervals=10)
    assert path.cost / factor**2 == pytest.approx(6, rel=1e-8)


def test_warm_start_from_a_coarser_answer_saves_iterations():
    coarse = cg.solve(cart_pole(), cg.Galerkin(4), intervals=20)
    cold = cg.solve(cart_pole(), cg.Galerkin(4), intervals=40)
    warm = cg.solve(cart_pole(), cg.Galerkin(4), intervals=40, guess=coarse)
    assert warm.cost == pytest.approx(cold.cost, abs=SOLVED)
    assert warm.iterations <= cold.iterations / 2


def test_warm_start_takes_duration_and_parameters():
    first = cg.solve(minimum_time(), cg.Galerkin(2), intervals=10)
    again = cg.transcribe(minimum_time(), cg.Galerkin(2), 10)
    unknowns, data, _ = again._start(first)
    assert again.numbering.unpack(unknowns, data)["duration"][0] == pytest.approx(2, abs=SOLVED)


@pytest.mark.parametrize("guess", [lambda t: [t], np.linspace(0, 1, 6)[None, :], "path"])
def test_guess_may_be_a_callable_an_array_or_an_earlier_trajectory(guess):
    if isinstance(guess, str):
        free = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0])
        guess = cg.solve(free, cg.Galerkin(2), intervals=3)
    path = cg.solve(double_integrator(), cg.Galerkin(3), intervals=5, guess=guess)
    assert path.cost == pytest.approx(6, abs=1e-10)


def test_control_is_a_polynomial_of_its_points_and_jumps_at_joints():
    path = cg.solve(minimum_time(), cg.Galerkin(3), intervals=4)
    np.testing.assert_allclose(path.control(path.control.times), path.control.values, rtol=0, atol=1e-12)
    assert path.control(path.t[2])[0] == pytest.approx(-1, abs=1e-6)
    assert path.control(np.nextafter(path.t[2], 0))[0] == pytest.approx(1, abs=1e-6)
    assert path.control(np.zeros((2, 3))).shape == (1, 2, 3)
    with pytest.raises(ValueError, match="times must lie within"):
        path.control(3.0)


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
    start = {"position": path.x[:, 0], "velocity": path.start_velocity, "parameters": found.parameters}
    again = cg.InitialProblem(found.lagrangian, found.t_span, force=path.replay(), **start)
    stepped = cg.solve(again, path.method, mesh=path.t)
    return np.max(np.abs(stepped.x - path.x)), np.max(np.abs(stepped.momentum - path.momentum))


@pytest.mark.parametrize("degree", [20, 30, 40])
def test_replay_is_the_same_path_at_high_degrees(degree):
    # IPOPT holds the equations to roundoff of terms of order 10; monomials lost 5e-10 at degree 20, 2e-3 at 40
    assert max(replayed(cg.solve(pendulum(3.0), cg.Galerkin(degree), intervals=3))) < ROUNDOFF


def jumps(path):
    """Jumps of the one control at the inner joints, (N - 1,)."""
    ends = path.control.at(np.array([0.0, 1.0])).reshape(-1, 2)
    return np.abs(ends[1:, 0] - ends[:-1, 1])


LEFT_RADAU = cg.Quadrature(1 - np.array(cg.radau(3).points)[::-1], cg.radau(3).weights[::-1])


@pytest.mark.parametrize(("problem", "jump"), [(minimum_time, 1.9), (varying_mass, 5e-4)])
@pytest.mark.parametrize("rule", [cg.radau(3), LEFT_RADAU, cg.gauss(3)], ids=["radau", "left radau", "gauss"])
def test_replay_is_the_same_path_where_controls_jump_at_a_joint(problem, jump, rule):
    path = cg.solve(problem(), cg.Galerkin(3, quadrature=rule), intervals=10)
    assert np.max(jumps(path)) > jump
    np.testing.assert_allclose(path.control(path.control.times), path.control.values, rtol=0, atol=ROUNDOFF)
    assert max(replayed(path)) < ROUNDOFF


def test_replay_refuses_two_values_at_one_time():
    one = cg.solve(minimum_time(), cg.Galerkin(3, quadrature=cg.lobatto(4)), intervals=10)
    assert max(replayed(one)) < ROUNDOFF  # points on both sides of a joint, and one value there
    following = double_integrator(running_cost=lambda t, x, v, u: (u[0] - v[0] ** 3) ** 2)  # u follows v, which jumps
    two = cg.solve(following, cg.Galerkin(2, quadrature=cg.lobatto(3)), intervals=4)
    when = two.t[1 + np.argmax(jumps(two))]
    with pytest.raises(ValueError, match=rf"u\[0\] jumps by .* at the joint t = {when:g}, where .* both sides"):
        two.replay()


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


def test_controls_replayed_by_another_integrator_land_where_the_optimiser_said():
    path = cg.solve(pendulum(3.0), cg.Galerkin(6), intervals=12)

    def rates(t, y):
        return [y[1], -np.sin(y[0]) + path.control(min(t, 3.0))[0]]

    landed = solve_ivp(rates, (0, 3), [0, 0], method="DOP853", rtol=1e-11, atol=1e-12, max_step=0.05).y[:, -1]
    np.testing.assert_allclose(landed, [np.pi, 0], rtol=0, atol=1e-7)  # the controls themselves are of order 6


def test_dynamics_defect_is_of_the_order_of_the_degree():
    defect = [cg.solve(pendulum(3.0), cg.Galerkin(3), n).dynamics_defect for n in (10, 20)]
    assert defect[0].shape == (10,)
    assert np.log2(defect[0].max() / defect[1].max()) == pytest.approx(3, abs=0.4)


def test_summary_tells_where_the_points_do_not_see_a_jump():
    seen, unseen = (str(cg.solve(minimum_time(), cg.Galerkin(2), n)).splitlines() for n in (4, 5))
    assert [sum("defect" in line for line in lines) for lines in (seen, unseen)] == [1, 1]
    assert not any("overshoot" in line for line in seen)
    path = cg.solve(minimum_time(), cg.Galerkin(2), 5)
    where = f"[{path.t[2]:.4g}, {path.t[3]:.4g}]"  # the middle interval, which holds the jump
    assert any(line.startswith("  overshoot") and where in line for line in unseen)
    assert any(line.startswith(f"  defect      {path.dynamics_defect[2]:.1e}") and where in line for line in unseen)


def test_graded_mesh_is_kept():
    mesh = np.array([0.0, 0.1, 0.4, 1.0])
    path = cg.solve(double_integrator(), cg.Galerkin(3), mesh=mesh)
    assert path.cost == pytest.approx(6, abs=1e-11)
    np.testing.assert_array_equal(path.t, mesh)


def test_transcription_is_built_once_and_solved_often():
    program = cg.transcribe(pendulum(3.0), cg.Galerkin(5), 10)
    first, second = program.solve(), program.solve(guess=lambda t: [3 * np.sin(t)])
    assert first.cost == pytest.approx(second.cost, abs=1e-11)
    assert second.build_seconds == first.build_seconds


def test_problem_and_answer_survive_pickling():
    problem = pickle.loads(pickle.dumps(everything()))
    path = cg.solve(problem, cg.Galerkin(3), intervals=4)
    again = pickle.loads(pickle.dumps(path))
    assert again.cost == path.cost
    np.testing.assert_array_equal(again.control(0.7), path.control(0.7))
    np.testing.assert_array_equal(again.dynamics_defect, path.dynamics_defect)


def test_summary_and_plot(capsys):
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    path = cg.transcribe(minimum_time(), cg.Galerkin(2), 4).solve(verbose=1)
    assert "cost        2" in capsys.readouterr().out
    axes = path.plot()
    assert [a.get_ylabel() for a in axes.figure.axes] == ["x[0]", "u[0]", "λ[0]"]
    assert path.plot(axes) is axes
    plt.close("all")


@pytest.mark.parametrize("problem", [pendulum_in_three, minimum_time, varying_mass])
def test_controls_stepped_forward_with_the_same_method_meet_every_joint(problem):
    assert max(replayed(cg.solve(problem(), cg.Galerkin(4), intervals=12))) < 1e-10


@pytest.mark.parametrize("size", [0.1, 1e-5])
@pytest.mark.parametrize("rule", [cg.gauss(2), cg.lobatto(2)], ids=["gauss", "lobatto"])
def test_a_component_that_vanishes_is_found_from_a_guess_where_it_does_not(rule, size):
    """What is left of its terms is the roundoff of those along the guess, and is not measured by itself."""
    problem = cg.ControlProblem(
        lambda t, x, v: ca.dot(v, v) / 2,
        (0.0, 1.0),
        [0.0, 0.0],
        [1.0, 0.0],
        [0.0, 0.0],
        [0.0, 0.0],
        force=lambda t, x, v, u: u,
        running_cost=lambda t, x, v, u: ca.dot(u, u),
        controls=2,
    )
    path = cg.solve(problem, cg.Galerkin(2, quadrature=rule), 20, guess=lambda t: [t, size * np.sin(3 * t)])
    assert np.max(np.abs(path.x[1])) <= 1e-13 * size
    np.testing.assert_allclose(path.x[0], path.t**2 * (3 - 2 * path.t), rtol=0, atol=2e-3)  # of order 2
