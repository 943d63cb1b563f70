"""Trajectory optimization: exact and published costs, orders, constraints of every kind, what is refused."""

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
    plane,
    resolved,
    varying_mass,
)
from scipy.integrate import solve_ivp
from scipy.optimize import root
from slow import slow

import casadi_galerkin as cg

ROUNDOFF = 1e-12  # of sums of a few hundred terms of order 1 to 100
SOLVED = 1e-8  # what IPOPT leaves of the optimality conditions, amplified by their conditioning


@pytest.mark.parametrize("degree", [2, 3, 5])
def test_minimum_effort_is_exact(degree):
    path = cg.solve(double_integrator(), cg.Galerkin(degree), intervals=5)
    times = np.linspace(0, 1, 33)
    assert path.cost == pytest.approx(6, abs=1e-11)
    assert path(0.25)[0] == pytest.approx(3 * 0.25**2 - 2 * 0.25**3, abs=1e-9 if degree > 2 else 1e-3)
    np.testing.assert_allclose(path.control(times)[0], 6 - 12 * times, rtol=0, atol=1e-10)
    np.testing.assert_allclose(path.costate(times)[0], -(6 - 12 * times), rtol=0, atol=1e-10)
    np.testing.assert_allclose(path.hamiltonian, -18, rtol=0, atol=1e-10)


@pytest.mark.parametrize("degree", [1, 4])
def test_minimum_time_is_exact_with_a_joint_at_the_jump(degree):
    path = cg.solve(minimum_time(), cg.Galerkin(degree), intervals=10)
    assert path.t[-1] == pytest.approx(2, abs=SOLVED)
    assert path.cost == pytest.approx(2, abs=SOLVED)
    np.testing.assert_allclose(path.control.values[0, : 5 * degree], 1, rtol=0, atol=1e-6)
    np.testing.assert_allclose(path.hamiltonian, 0, rtol=0, atol=SOLVED)  # free duration
    assert path.control_misfit.max() <= ROUNDOFF


@pytest.mark.slow
def test_cart_pole_reaches_kellys_cost():
    assert cg.solve(cart_pole(), cg.Galerkin(4), intervals=20).cost == pytest.approx(58.80767, abs=1e-3)
    for intervals in (20, 60):  # it does not lose its way on a fine mesh
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
    (pendulum_in_three, 4): (8, 10, 12),
    (varying_mass, 1): (20, 40, 80),
    (varying_mass, 2): (8, 12, 16),
    (varying_mass, 4): (8, 12, 16),
}


@pytest.mark.parametrize(
    ("problem", "degree"), [(varying_mass, 2), *slow(*(case for case in MESHES if case != (varying_mass, 2)))]
)
@pytest.mark.slow
def test_cost_converges_with_twice_the_degree(problem, degree):
    meshes, (exact, _) = MESHES[problem, degree], resolved(problem)
    errors = [abs(cg.solve(problem(), cg.Galerkin(degree), n).cost - exact) for n in meshes]
    assert errors[-1] > ROUNDOFF
    slope = np.polyfit(np.log(meshes), np.log(errors), 1)[0]
    assert slope == pytest.approx(-2 * degree, abs=0.3)


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


def test_free_parameter_is_optimized_within_its_bounds():
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
    outside = -0.1 - np.min(path(np.linspace(0, 1, 20001)))
    assert path.constraint_excess.max() == pytest.approx(outside / path.sizes[0], rel=0.1)
    assert "excess" in repr(path)


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


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_units_of_length_do_not_matter(factor):
    problem = double_integrator(end=[factor])
    path = cg.solve(problem, cg.Galerkin(3), intervals=10)
    assert path.cost / factor**2 == pytest.approx(6, rel=1e-8)


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


def test_free_parameter_that_nothing_depends_on_is_refused():
    fields = {
        "lagrangian": lambda t, x, v, p: v[0] ** 2 / 2,
        "force": lambda t, x, v, u, p: u * p[0],
        "running_cost": lambda t, x, v, u, p: u[0] ** 2 / 2,
        "parameters": [1.0, 2.0],
    }
    with pytest.raises(ValueError, match=r"free parameter p\[1\] occurs in no"):
        double_integrator(**fields, parameter_bounds=(0, 5))
    assert double_integrator(**fields, parameter_bounds=([0, 2], [5, 2])).parameters == (1.0, 2.0)
    assert double_integrator(**fields).parameters == (1.0, 2.0)


def _mass(**changes):
    return double_integrator(
        **{
            "lagrangian": lambda t, x, v, p: p[0] * v[0] ** 2 / 2,
            "force": lambda t, x, v, u, p: u,
            "running_cost": lambda t, x, v, u, p: u[0] ** 2 / 2,
            "parameters": [1.0],
        }
        | changes
    )


FAR = (-9.0, 9.0)
ODD = {  # problem, degree, intervals, exact cost
    "one interval": (lambda: double_integrator(), 3, 1, 6.0),
    "nothing given at the ends": (
        lambda: double_integrator(start=[None], end=[None], start_velocity=[None], end_velocity=[None]),
        3,
        10,
        0.0,
    ),
    "already there": (lambda: double_integrator(start=[None]), 3, 10, 0.0),
    "already there, far from zero": (lambda: double_integrator(start=[None], end=[1e9]), 3, 10, 0.0),
    "rest at zero": (lambda: double_integrator(end=[0.0]), 3, 10, 0.0),
    "fixed controls": (lambda: double_integrator(control_bounds=(1, 1), end=[None], end_velocity=[None]), 3, 10, 0.5),
    "no path constraint in one": (lambda: double_integrator(path_constraint=(lambda t, x, v, u: [], 0, 1)), 3, 10, 6.0),
    "constraint without bounds": (
        lambda: double_integrator(path_constraint=(lambda t, x, v, u: x[0], -np.inf, np.inf)),
        3,
        10,
        6.0,
    ),
    "cost of nothing": (lambda: double_integrator(running_cost=None), 3, 10, 0.0),
    "cost of time only": (lambda: double_integrator(running_cost=lambda t, x, v, u: t), 3, 10, 0.5),
    "cost at the end only": (
        lambda: double_integrator(
            running_cost=None,
            terminal_cost=lambda t, x, v: (x[0] - 2) ** 2,
            end=[None],
            end_velocity=[None],
            control_bounds=(-1, 1),
        ),
        3,
        10,
        2.25,  # full thrust all the way to 1/2
    ),
    "duration free within one value": (lambda: double_integrator(duration_bounds=(1, 1)), 3, 10, 6.0),
    "duration free without a bound": (
        lambda: double_integrator(duration_bounds=(0.1, np.inf), running_cost=lambda t, x, v, u: u[0] ** 2 / 2 + 1),
        3,
        10,
        4 / 3 * 18**0.25,  # 6/T³ + T at T⁴ = 18
    ),
    "parameter only": (
        lambda: _mass(
            force=lambda t, x, v, u, p: p[0] + u[0],
            lagrangian=lambda t, x, v, p: v[0] ** 2 / 2,
            running_cost=lambda t, x, v, u, p: x[0] ** 2,
            control_bounds=(0, 0),
            end_velocity=[None],
            parameter_bounds=FAR,
        ),
        3,
        10,
        0.2,  # p = 2, ∫t⁴ dt
    ),
    "lightest mass": (lambda: _mass(parameter_bounds=(0.5, 2)), 3, 10, 1.5),
    "late": (lambda: double_integrator(t_span=(1e6, 1e6 + 1)), 3, 10, 6.0),
    "long": (lambda: double_integrator(t_span=(0, 1e8)), 3, 10, 6e-24),
    "wide": (lambda: double_integrator(end=[1e12]), 3, 10, 6e24),
}


@pytest.mark.parametrize("name", ODD)
def test_odd_but_legal_problem_has_its_exact_cost(name):
    make, degree, intervals, cost = ODD[name]
    path = cg.solve(make(), cg.Galerkin(degree), intervals)
    assert path.cost == pytest.approx(cost, rel=1e-8, abs=1e-12 if cost == 0 else 0)  # late: t keeps 10 digits of h
    assert path.violation <= 1e-8
    assert "cost" in str(path)


def test_fixed_controls_between_given_ends_are_refused_before_any_solve():
    with pytest.raises(
        ValueError, match=r"25 equations for 23 unknowns .* control_bounds whose sides are equal leave no"
    ):
        cg.solve(double_integrator(control_bounds=(1, 1)), cg.Galerkin(3), intervals=8)


def hole(x):
    """Not a number near x = 0.37."""
    return 1e-3 * ca.sqrt((x[0] - 0.37) ** 2 - 1e-3)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("running_cost", {"running_cost": lambda t, x, v, u: u[0] ** 2 / 2 + hole(x)}),
        ("force", {"force": lambda t, x, v, u: u[0] + hole(x)}),
        ("path_constraint", {"path_constraint": (lambda t, x, v, u: hole(x), -1, 5)}),
        ("lagrangian", {"lagrangian": lambda t, x, v: v[0] ** 2 / 2 + hole(x)}),
    ],
)
def test_a_callable_that_is_not_finite_between_the_points_is_an_error(name, changes):
    with pytest.raises(cg.ConvergenceError, match=rf"{name} is nan between .* at t = 0.41\d*, where x = \[0.37\d+\]"):
        cg.solve(double_integrator(**changes), cg.Galerkin(3), 2)


def test_more_equations_than_unknowns_are_refused():
    with pytest.raises(ValueError, match="2 equations for 1 unknown on 1 interval of"):
        cg.solve(double_integrator(), cg.Galerkin(1), intervals=1)


def test_equations_between_controls_at_more_points_than_there_are_controls_are_refused():
    """With hold, one control of every interval would have to meet them at four points."""
    same = (lambda t, x, v, u: u[1] - u[0], 0, 0)
    tied = double_integrator(controls=2, hold=True, force=lambda t, x, v, u: u[1], path_constraint=same)
    with pytest.raises(ValueError, match="32 of them are path_constraint with equal bounds, at every quadrature point"):
        cg.solve(tied, cg.Galerkin(4), intervals=8)


def test_other_solvers_are_refused():
    with pytest.raises(ValueError, match="solved by cg"):
        cg.solve(double_integrator(), cg.Galerkin(2), intervals=4, solver=cg.minimizer)


def test_transcription_takes_control_problems_only():
    with pytest.raises(TypeError, match="ControlProblem"):
        cg.transcribe(3, cg.Galerkin(2), 4)
    with pytest.raises(TypeError, match="Galerkin"):
        cg.transcribe(pendulum(3.0), 4, 4)


# built once, solved often

SWING, METHOD = pendulum(3.0), cg.Galerkin(4)
CHANGES = {
    "start": {"start": [0.4]},
    "end": {"end": [2.0]},
    "velocities": {"start_velocity": [0.3], "end_velocity": [-0.2]},
    "all ends": {"start": [-0.1], "end": [2.5], "start_velocity": [0.1], "end_velocity": [0.5]},
    "mesh": {"mesh": 0.5 + 3.5 * np.linspace(0, 1, 11) ** 1.2},
    "nothing": {},
}


def agree(path, other):
    assert path.cost == pytest.approx(other.cost, rel=1e-10)
    np.testing.assert_allclose(path.t, other.t, rtol=0, atol=SOLVED)
    np.testing.assert_allclose(path.x, other.x, rtol=0, atol=SOLVED)
    np.testing.assert_allclose(path.momentum, other.momentum, rtol=0, atol=1e-7)
    np.testing.assert_allclose(path.hamiltonian, other.hamiltonian, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", CHANGES)
def test_solving_again_with_changes_is_solving_afresh(name):
    program, changes = cg.transcribe(SWING, METHOD, 10), dict(CHANGES[name])
    path = program.solve(**changes)
    mesh = changes.pop("mesh", np.linspace(0, 3, 11))
    agree(path, cg.solve(pendulum(3.0, t_span=mesh[[0, -1]], **changes), METHOD, mesh=mesh))
    assert path.problem.t_span == (mesh[0], mesh[-1])
    for field, value in changes.items():
        assert getattr(path.problem, field) == tuple(value)


@pytest.mark.slow
def test_solving_again_takes_parameters_given_or_free():
    path = cg.transcribe(_mass(), cg.Galerkin(3), 4).solve(parameters=[2.0])
    assert path.cost == pytest.approx(24, abs=1e-10)
    assert path.parameters == path.problem.parameters == (2.0,)
    program = cg.transcribe(everything(), cg.Galerkin(3), 8)
    changes = {"start": [0.2, None], "end": [None, 0.3], "start_velocity": [None, 0.1], "end_velocity": [0.0, None]}
    path = program.solve(**changes, parameters=[1.3, 0.1])
    agree(path, cg.solve(replace(everything(), **changes), cg.Galerkin(3), 8, guess=path))


def test_repeated_solves_do_not_influence_one_another():
    program = cg.transcribe(SWING, METHOD, 10)
    before = [program.solve(), program.solve(end=[2.0])]
    kept = [path.polynomial.values.copy() for path in before]
    program.solve(start=[0.3], guess=before[0])
    with pytest.raises(ValueError, match="finite"):
        program.solve(guess=lambda t: [np.nan])
    for path, values, changes in zip(before, kept, ({}, {"end": [2.0]}), strict=True):
        np.testing.assert_array_equal(path.polynomial.values, values)
        np.testing.assert_array_equal(program.solve(**changes).polynomial.values, values)
    assert program.problem is SWING
    assert before[0].problem.end == (np.pi,)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"start": [None]}, r"start must have None where the problem has it, \(0.0,\), got \(None,\)"),
        ({"end_velocity": [1.0]}, r"end_velocity must have None where the problem has it, \(None,\), got \(1.0,\)"),
        ({"end": [1.0, 2.0]}, r"end must have 1 component, got 2"),
        ({"start_velocity": [np.inf]}, r"start_velocity\[0\] must be finite, got inf"),
        ({"start": [-3.0]}, r"start\[0\] = -3.0 lies outside its position_bounds \[-1.0, 2.0\]"),
        ({"parameters": [1.0]}, r"the problem has no parameters, got parameters=\[1.0\]"),
        ({"mesh": np.linspace(0, 1, 4)}, r"this transcription has 4 intervals, got a mesh of 3"),
        ({"mesh": [0, 1, 2, 4, 3]}, "the joints of a mesh must be finite and increase"),
        ({"solver": cg.newton}, "solved by cg"),
    ],
)
def test_changes_that_do_not_fit_are_refused(changes, message):
    program = cg.transcribe(double_integrator(end_velocity=[None], position_bounds=(-1, 2)), cg.Galerkin(3), 4)
    with pytest.raises(ValueError, match=message):
        program.solve(**changes)


def test_wrong_number_of_parameters_and_a_duration_out_of_bounds_are_refused():
    with pytest.raises(ValueError, match=r"parameters must have 1 component, got 2"):
        cg.transcribe(_mass(), cg.Galerkin(3), 4).solve(parameters=[1.0, 2.0])
    with pytest.raises(ValueError, match=r"the duration = 20.0 lies outside its duration_bounds \[0.1, 10.0\]"):
        cg.transcribe(minimum_time(), cg.Galerkin(3), 4).solve(mesh=np.linspace(0, 20, 5))


def test_a_component_that_was_built_at_rest_is_solved_in_motion():
    program = cg.transcribe(double_integrator(end=[0.0]), cg.Galerkin(3), 10)
    for end in (1e-3, 1.0, 1e3):
        assert program.solve(end=[end]).cost == pytest.approx(6 * end**2, rel=1e-10)


@pytest.mark.parametrize(("height", "cost"), [(1.0, 12.75), ((0.5, 2.0), 3.75)])
def test_waypoints_are_passed_at_their_cost(height, cost):
    """Up and down again from rest to rest, u = 12 h (1 - 2 t) on the way up: 12 h² in all, beside 6/8 for the way."""
    problem = plane(waypoints=[(1.0, [None, height])])
    path = cg.solve(problem, cg.Galerkin(3), 5)
    assert path.cost == pytest.approx(cost, abs=SOLVED)
    assert path(1.0)[1] == pytest.approx(np.atleast_1d(height)[0], abs=SOLVED)
    assert 1.0 in path.t


def test_an_interval_too_short_to_judge_is_refused():
    """The rounding of its terms, |x|/h, passed for the size of all others: a cost of zero was called an optimum."""
    for mesh in ([0, 0.3, 0.3 + 1e-13, 1.0], [0, 0.3, 0.3 + 1e-11, 1.0]):
        with pytest.raises(ValueError, match=r"interval from t = 0.3 to 0.3\d+ is shorter than 1e-10 of the duration"):
            cg.solve(double_integrator(), cg.Galerkin(3), mesh=mesh)
    program = cg.transcribe(double_integrator(), cg.Galerkin(3), 3)
    with pytest.raises(ValueError, match="is shorter than 1e-10"):
        program.solve(mesh=[0, 0.3, 0.3 + 1e-13, 1.0])


def test_a_problem_with_waypoints_may_be_replaced():
    problem = double_integrator(t_span=(0.0, 2.0), waypoints=[(1.0, [0.3])])
    other = replace(problem, end=(2.0,))
    assert other.waypoints == problem.waypoints
    assert cg.solve(other, cg.Galerkin(3), 4)(1.0)[0] == pytest.approx(0.3, abs=1e-12)


DEGENERATE = {
    "linear in a velocity": lambda t, x, v: v[0] ** 2 / 2 + x[0] * v[1],
    "of one combination": lambda t, x, v: (v[0] + v[1]) ** 2 / 2,
    "without any mass": lambda t, x, v: v[0] + v[1],
    "beside a rate": lambda t, x, v: x[2] * (v[0] + v[1]) ** 2 / 2,
}


@pytest.mark.parametrize("name", DEGENERATE)
def test_a_degenerate_lagrangian_is_refused_when_it_is_stated(name):
    """An infimum of the cost that no path reaches was called a local minimum."""
    rates = {"rates": lambda t, x, v, u: -x[2]} if name == "beside a rate" else {}
    others, free = [1.0] * len(rates), [None] * len(rates)
    with pytest.raises(ValueError, match=r"degenerate: its mass matrix .* is singular wherever it was tried"):
        plane(
            lagrangian=DEGENERATE[name],
            start=[0.0, 0.0, *others],
            end=[1.0, 0.5, *free],
            start_velocity=[0.0, 0.0, *free],
            end_velocity=[0.0, 0.0, *free],
            **rates,
        )


def test_a_mass_that_vanishes_with_the_parameters_is_refused():
    problem = double_integrator(
        lagrangian=lambda t, x, v, p: p[0] * v[0] ** 2 / 2,
        force=lambda t, x, v, u, p: u,
        running_cost=lambda t, x, v, u, p: u[0] ** 2,
        parameters=[1.0],
    )
    transcription = cg.transcribe(problem, cg.Galerkin(3), intervals=4)
    assert transcription.solve(parameters=[2.0]).cost == pytest.approx(48.0)
    with pytest.raises(ValueError, match="degenerate"):
        transcription.solve(parameters=[0.0])
