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
    "bounds with None": ({"control_bounds": (None, 1)}, TypeError, "lo of control_bounds .* -inf where there is none"),
    "bounds in words": ({"control_bounds": ("-1", "1")}, TypeError, "lo of control_bounds .* got '-1'"),
    "bounds without an order": ({"control_bounds": {0, 1}}, TypeError, r"must be a pair \(lo, hi\), got {0, 1}"),
    "bounds that are truths": ({"control_bounds": (False, True)}, TypeError, "must be a number .* got False"),
    "nothing above": ({"control_bounds": (np.inf, np.inf)}, ValueError, "lo of control_bounds must not be .* got inf"),
    "nothing below": ({"position_bounds": (-np.inf, [-np.inf])}, ValueError, "hi of position_bounds must not be"),
    "constraint of no value": (
        {"path_constraint": (lambda t, x, v, u: u, np.inf, np.inf)},
        ValueError,
        "lo of path_constraint must not be NaN, nor inf",
    ),
    "start that leaves its bounds": (
        {"start_velocity": [-1.0], "position_bounds": (0, 1)},
        ValueError,
        r"start\[0\] = 0.0 lies on its position_bounds \[0.0, 1.0\], and start_velocity\[0\] = -1.0",
    ),
    "end that comes from outside": (
        {"end_velocity": [-1.0], "position_bounds": (0, 1)},
        ValueError,
        r"end\[0\] = 1.0 lies on its position_bounds",
    ),
    "nested forces": ({"force": lambda t, x, v, u: [[u[0]]]}, TypeError, "force must return one CasADi expression a"),
    "force as a number": ({"force": 3.0}, TypeError, "force must be a callable"),
    "terminal cost of controls": ({"terminal_cost": lambda t, x, v, u: u}, TypeError, "terminal_cost is called as"),
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
    "too many forces": (
        {"force": lambda t, x, v, u: [u[0], 0]},
        ValueError,
        "force must return a vector of length 1, got",
    ),
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


def test_limits_of_another_kind_are_refused():
    with pytest.raises(TypeError, match=r"limits must be Limits.* got 3"):
        cg.solve(double_integrator(), tol=1e-3, limits=3)


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
    "cost of nothing": (lambda: double_integrator(running_cost=lambda t, x, v, u: 0), 3, 10, 0.0),
    "cost of time only": (lambda: double_integrator(running_cost=lambda t, x, v, u: t), 3, 10, 0.5),
    "cost at the end only": (
        lambda: double_integrator(
            running_cost=lambda t, x, v, u: 0,
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
    assert caught.value.path.t[-1] == 1
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
        cg.transcribe(3, cg.Galerkin(2), 4)
    with pytest.raises(TypeError, match="Galerkin"):
        cg.transcribe(pendulum(3.0), 4, 4)
