"""IPOPT on control problems without an answer: its own words, and the time where a value is not finite."""

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, pendulum

import casadi_galerkin as cg

NOT_FINITE = {
    "cost": ({"running_cost": lambda t, x, v, u: u**2 + ca.log(x[0] - 0.5)}, "running_cost .* at t = 0.0211"),
    "force": ({"force": lambda t, x, v, u: u + ca.sqrt(0.5 - t)}, "force .* at t = 0.521"),
    "lagrangian": ({"lagrangian": lambda t, x, v: v[0] ** 2 + ca.log(x[0] - 0.7)}, "lagrangian .* at t = 0.0211"),
    "constraint": (
        {"path_constraint": (lambda t, x, v, u: ca.log(u[0] - 1), -9, 9)},
        "path_constraint .* at t = 0.0211",
    ),
    "end": ({"terminal_cost": lambda t, x, v: ca.sqrt(-x[0])}, r"derivative of the cost by x\[0\] .* at t = 1"),
    "condition": (
        {"end": [None], "end_conditions": (lambda x0, v0, x1, v1: ca.log(x1 - 2), 0, 0)},
        "end condition 0 .* at t = 1",
    ),
    "rate": (
        {
            **dict.fromkeys(("lagrangian", "force", "start_velocity", "end_velocity")),
            "rates": lambda t, x, v, u: u + ca.sqrt(0.5 - t),
        },
        "rates .* at t = 0.521",
    ),
    "slope of the cost": (
        {"running_cost": lambda t, x, v, u: ca.sqrt(u[0])},
        r"derivative of the cost by u\[0\] .* at t = 0.0211",
    ),
    "slope of the force": (
        {"force": lambda t, x, v, u: u + ca.sqrt(u)},
        r"a derivative of the equation of motion of x\[0\] .* at t = 0",
    ),
}


@pytest.mark.parametrize("name", NOT_FINITE)
def test_what_is_not_finite_at_the_guess_is_named_with_its_time(name):
    changes, message = NOT_FINITE[name]
    with pytest.raises(ValueError, match=message):
        cg.solve(double_integrator(**changes), cg.Galerkin(2), intervals=10, guess=lambda t: [t])


@pytest.mark.slow
def test_a_function_that_fails_at_the_guess_is_named():
    z, a = ca.SX.sym("z"), ca.SX.sym("a")
    root = ca.rootfinder("root", "newton", ca.Function("square", [z, a], [z**2 - a]))  # of no negative a
    problem = double_integrator(running_cost=lambda t, x, v, u: u[0] ** 2 + root(1.0, x[0] - 2))
    with pytest.raises(ValueError, match="running_cost calls a casadi Function that fails at the guess") as caught:
        cg.solve(problem, cg.Galerkin(3), 6)
    assert "rootfinder process failed" in str(caught.value.__cause__)


@pytest.mark.parametrize(
    "changes",
    [
        {"running_cost": lambda t, x, v, u: -(u[0] ** 2)},
        {"running_cost": lambda t, x, v, u: -1, "duration_bounds": (0.5, np.inf), "control_bounds": (-1, 1)},
    ],
)
def test_unbounded_problem_ends_with_the_solvers_own_words(changes):
    with pytest.raises(cg.ConvergenceError, match=r"Diverging Iterates.*no lower bound") as caught:
        cg.solve(double_integrator(**changes), cg.Galerkin(3), intervals=10)
    assert caught.value.iterations <= 500


@pytest.mark.parametrize(("sign", "told"), [(1, "more intervals$"), (-1, "; the cost may have no lower bound$")])
def test_too_few_iterations_point_to_an_unbounded_cost_only_where_it_is_negative(sign, told):
    swing = pendulum(3.0, running_cost=lambda t, x, v, u: sign * u[0] ** 2, control_bounds=(-20.0, 20.0))
    words = f"Maximum Iterations .* max_iter allows 4 iterations: .*max_iter=8.* such as the answer on fewer .*{told}"
    with pytest.raises(cg.ConvergenceError, match=words):
        cg.solve(swing, cg.Galerkin(3), 10, solver=cg.ipopt.with_options(max_iter=4))


@pytest.mark.slow
def test_an_optimum_that_roundoff_keeps_from_the_tolerance_is_found():
    def joined(factor):
        return cg.ControlProblem(
            lambda t, x, v: (1 + 0.3 * x[1] ** 2) * v[0] ** 2 / 2 + v[1] ** 2 + 0.2 * v[0] * v[1] - ca.cos(x[0] + t),
            (0.0, 2.0),
            start=[0.0, 0.5],
            end=[1.5, -0.3],
            start_velocity=[0.0, 0.2],
            end_velocity=[0.0, 0.1],
            force=lambda t, x, v, u: [u[0] - 0.1 * v[0], u[1] - 0.2 * v[1] * v[0]],
            running_cost=lambda t, x, v, u: factor * (u[0] ** 2 / 2 + u[1] ** 2),
            controls=2,
            hold=True,
        )

    factors = np.array([1, 2, 5, 10, 20, 30, 50, 70, 100, 1e3, 1e4])
    costs = [cg.solve(joined(factor), cg.Galerkin(3), 8).cost for factor in factors]
    np.testing.assert_allclose(costs / factors, costs[0], rtol=1e-10)


def test_fatrop_keeps_bounds_of_zero_by_itself():
    """It relaxes every bound, and the program's are narrower by as much."""
    changes = {"controls": 2, "force": lambda t, x, v, u: u[0] - u[1], "running_cost": lambda t, x, v, u: u[0] + u[1]}
    task = double_integrator(**changes, control_bounds=(0.0, 6.0))
    path = cg.solve(task, cg.Galerkin(3), intervals=6, solver=cg.fatrop)
    assert path.solver.startswith("fatrop (")
    assert path.control.values.min() >= 0
    assert path.control.values.max() <= 6


def test_fatrop_takes_the_derivatives_of_the_graph():
    """They are in its cache by names of CasADi's own; under others it would differentiate the graph again."""
    transcription = cg.transcribe(double_integrator(), cg.Galerkin(3), 4)
    program, graph = transcription.program(cg.fatrop, warm=False, verbose=0), transcription.graph
    for name, function in (("nlp_jac_g", graph.jacobian), ("nlp_hess_l", graph.whole_hessian)):
        assert hash(program.get_function(name)) == hash(function)


@pytest.mark.parametrize(
    "changes",
    [
        {"control_bounds": (-5e-9, 5e-9), "end": [None], "end_velocity": [None]},
        {"duration_bounds": (1 - 1e-9, 1 + 1e-9)},
        {"waypoints": [(0.5, [(0.5, 0.5 + 1e-8)])]},
    ],
)
def test_bounds_narrower_than_fatrop_relaxes_them_are_kept(changes):
    problem = double_integrator(**changes)
    narrow, other = (cg.solve(problem, cg.Galerkin(3), 8, solver=solver) for solver in (cg.fatrop, cg.ipopt))
    assert narrow.cost == pytest.approx(other.cost, abs=1e-6)


@pytest.mark.slow
def test_sequential_quadratic_programs_begin_from_an_earlier_answer():
    program = cg.transcribe(pendulum(3.0, control_bounds=(-2.5, 2.5)), cg.Galerkin(3), 12)
    cold = program.solve(solver=cg.sqp)
    near, by_ipopt = (program.solve(start=[0.02], guess=cold, solver=solver) for solver in (cg.sqp, cg.ipopt))
    assert cold.solver == "IPOPT (Solve Succeeded), as sqp begins from an answer of the same layout"
    assert near.solver == "SQP (Solve Succeeded)"
    assert near.iterations < by_ipopt.iterations
    assert near.cost == pytest.approx(by_ipopt.cost, rel=1e-9)
    np.testing.assert_allclose(near.control.values, by_ipopt.control.values, rtol=0, atol=1e-6)
    assert near.estimate_error() == pytest.approx(by_ipopt.estimate_error(), rel=1e-3)


def test_where_sequential_quadratic_programs_are_lost_ipopt_solves_and_the_report_says_so():
    program = cg.transcribe(pendulum(3.0), cg.Galerkin(3), 12)
    path = program.solve(start=[0.5], guess=program.solve(), solver=cg.sqp.with_options(max_iter=1))
    lost = "after SQP stopped with 'Maximum Iterations Exceeded' after 1 iterations"
    assert path.solver == f"IPOPT (Solve Succeeded), from the same start, {lost}"


def test_an_option_that_sqp_does_not_have_is_refused():
    with pytest.raises(ValueError, match="sqp has no option max_iterations that takes 9"):
        cg.sqp.with_options(max_iterations=9)
