"""Control problems that are stated badly, or have no answer, end in an error that says why."""

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, pendulum

import casadi_galerkin as cg

BADLY_STATED = {
    "bounds that contradict": ({"control_bounds": (1, -1)}, ValueError, "control_bounds contradict .* component 0"),
    "bounds of a wrong length": ({"control_bounds": ([0, 0], 1)}, ValueError, "lo of control_bounds .* 1 numbers"),
    "bounds that are no pair": ({"control_bounds": 3}, TypeError, "must be a pair"),
    "bounds that are no numbers": ({"control_bounds": ("a", 1)}, TypeError, "lo of control_bounds"),
    "bounds with NaN": ({"control_bounds": (np.nan, 1)}, ValueError, "must not be NaN"),
    "end outside": ({"position_bounds": (-1, 0.5)}, ValueError, r"end\[0\] = 1.0 lies outside"),
    "start outside": ({"position_bounds": (0.5, 2)}, ValueError, r"start\[0\] = 0.0 lies outside"),
    "end outside the path": (
        {"path_constraint": (lambda t, x, v, u: x[0], -1, 0.5)},
        ValueError,
        "path constraint 0 is 1.0 at the end",
    ),
    "no duration": ({"t_span": (1, 1)}, ValueError, "t_span must increase"),
    "duration bound of zero": ({"duration_bounds": (0, 2)}, ValueError, "duration_bounds must be positive"),
    "duration guess outside": ({"duration_bounds": (2, 3)}, ValueError, "must hold the guess, t_span lasts 1.0"),
    "no controls": ({"controls": 0}, ValueError, "at least one control, got 0"),
    "controls by name": ({"controls": "u"}, TypeError, "number of controls"),
    "unused control": (
        {"controls": 2, "force": lambda t, x, v, u: u[0]},
        ValueError,
        r"u\[1\] occurs in no force, cost or constraint",
    ),
    "too many forces": ({"force": lambda t, x, v, u: [u[0], 0]}, ValueError, "force must return 1 .* got 2"),
    "cost that is no scalar": (
        {"running_cost": lambda t, x, v, u: ca.vertcat(u, u)},
        ValueError,
        "running_cost must return a scalar",
    ),
    "cost that fails": ({"running_cost": lambda t, x, v, u: u[7]}, ValueError, "running_cost failed"),
    "path constraint alone": ({"path_constraint": ca.sin}, TypeError, r"path_constraint must be \(g, lo, hi\)"),
    "parameter bounds alone": ({"parameter_bounds": (0, 1)}, ValueError, "parameter_bounds need parameters"),
    "velocity of a wrong length": ({"end_velocity": [0, 0]}, ValueError, "end_velocity must have 1"),
}


@pytest.mark.parametrize("name", BADLY_STATED)
def test_badly_stated_problem_is_refused(name):
    changes, kind, message = BADLY_STATED[name]
    with pytest.raises(kind, match=message):
        double_integrator(**changes)


def test_parameter_guess_outside_its_bounds_is_refused():
    with pytest.raises(ValueError, match=r"parameters\[0\] = 3.0 lies outside"):
        double_integrator(
            lagrangian=lambda t, x, v, p: p * v[0] ** 2,
            force=lambda t, x, v, u, p: u,
            running_cost=lambda t, x, v, u, p: u**2,
            parameters=[3],
            parameter_bounds=(0, 1),
        )


NOT_FINITE = {
    "cost": ({"running_cost": lambda t, x, v, u: u**2 + ca.log(x[0] - 0.5)}, "running_cost .* at t = 0.0211"),
    "force": ({"force": lambda t, x, v, u: u + ca.sqrt(0.5 - t)}, "force .* at t = 0.521"),
    "lagrangian": ({"lagrangian": lambda t, x, v: v[0] ** 2 + ca.log(x[0] - 0.7)}, "lagrangian .* at t = 0.0211"),
    "constraint": (
        {"path_constraint": (lambda t, x, v, u: ca.log(u[0] - 1), -9, 9)},
        "path_constraint .* at t = 0.0211",
    ),
    "end": ({"terminal_cost": lambda t, x, v: ca.sqrt(-x[0])}, "terminal_cost .* at t = 1"),
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


def test_infeasible_problem_names_the_worst_violated_constraint():
    with pytest.raises(cg.ConvergenceError, match=r"Infeasible.* equation of motion of x\[0\] at t = ") as caught:
        cg.solve(double_integrator(control_bounds=(-1, 1)), cg.Galerkin(3), intervals=10)
    assert caught.value.path.mesh[-1] == 1
    assert 0 < caught.value.iterations <= 500


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


def test_more_equations_than_unknowns_are_refused():
    with pytest.raises(ValueError, match="2 equations for 1 unknowns on 1 interval"):
        cg.solve(double_integrator(), cg.Galerkin(1), intervals=1)


def test_guess_that_does_not_fit_is_refused():
    problem = double_integrator()
    two = cg.solve(
        double_integrator(
            controls=2, force=lambda t, x, v, u: u[0] + u[1], running_cost=lambda t, x, v, u: ca.sumsqr(u)
        ),
        cg.Galerkin(2),
        intervals=4,
    )
    with pytest.raises(ValueError, match=r"1 control\(s\), got 2"):
        cg.solve(problem, cg.Galerkin(2), intervals=4, guess=two)
    with pytest.raises(ValueError, match="shape"):
        cg.solve(problem, cg.Galerkin(2), intervals=4, guess=np.zeros((2, 5)))
    with pytest.raises(ValueError, match="guess must be finite"):
        cg.solve(problem, cg.Galerkin(2), intervals=4, guess=lambda t: [np.nan])


def test_other_solvers_are_refused():
    with pytest.raises(ValueError, match="solved by ipopt"):
        cg.solve(double_integrator(), cg.Galerkin(2), intervals=4, solver=cg.minimizer)


def test_transcription_takes_control_problems_only():
    with pytest.raises(TypeError, match="ControlProblem"):
        cg.transcribe_control(3, cg.Galerkin(2), 4)
    with pytest.raises(TypeError, match="Galerkin"):
        cg.transcribe_control(pendulum(3.0), 4, 4)
