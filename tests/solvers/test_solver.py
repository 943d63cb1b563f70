"""The four solvers by name: the same paths and orders, their options, what they refuse."""

import re

import casadi as ca
import numpy as np
import pytest
from control_problems import pendulum_in_three
from scenes import BY_NAME, bratu, oscillator, pendulum
from scipy.integrate import solve_ivp
from slow import slow

import casadi_galerkin as cg

CLOSED_FORM = 1e-13  # relative to the largest value along the path


@pytest.mark.parametrize("solver", [cg.newton, cg.rootfinder, cg.ipopt])
def test_the_one_periodic_path_is_found_although_the_hessian_is_singular_at_the_guess(solver):
    """x'' = x³ - cos³t - cos t and y'' = -2 y + cos t have one periodic path, x = y = cos t, a saddle.

    At 0, where the search begins, the Hessian by x is that of a free periodic particle, which may stand anywhere.
    """
    problem = cg.BoundaryProblem(
        lambda t, x, v: (
            ca.dot(v, v) / 2 + x[0] ** 4 / 4 - x[1] ** 2 - (ca.cos(t) ** 3 + ca.cos(t)) * x[0] + ca.cos(t) * x[1]
        ),
        (0, 2 * np.pi),
        [None, None],
        periodic=True,
    )
    tr = cg.transcribe(problem, cg.Galerkin(16), 8)
    zero = np.zeros(tr.gradient.size1_in(0))
    hessian = np.array(ca.DM(tr.hessian(zero, [], [], tr.mesh)))
    sizes = np.abs(np.linalg.eigvalsh(hessian))
    assert np.min(sizes) < 1e-14 * np.max(sizes)  # the first step of Newton's method leads nowhere
    path = tr.solve(solver=solver)
    t = np.linspace(0, 2 * np.pi, 101)
    np.testing.assert_allclose(path(t), np.stack((np.cos(t), np.cos(t))), rtol=0, atol=CLOSED_FORM)
    assert path.morse_index == 3  # y = 1, cos t and sin t lower the action, whatever x does


@pytest.mark.parametrize("name", ["short pendulum", "Bratu 3.0 lower", "catenoid, index 0", "natural end", "Lambert"])
def test_four_solvers_agree(name):
    scene = BY_NAME[name]
    wanted = scene.solve()
    reports = (
        (cg.rootfinder, "CasADi's rootfinder, then Newton"),
        (cg.ipopt, "IPOPT, then Newton"),
        (cg.minimizer, "IPOPT on the action, then Newton"),
    )
    for solver, report in reports:
        path = scene.solve(solver=solver)
        assert path.solver == report
        size = np.max(np.abs(path.x))
        np.testing.assert_allclose(path.polynomial.values, wanted.polynomial.values, rtol=0, atol=CLOSED_FORM * size)


@pytest.mark.parametrize("engine", [cg.newton, cg.rootfinder, cg.ipopt, cg.minimizer])
def test_one_interval_of_degree_one_between_fixed_ends_has_nothing_to_solve(engine):
    path = cg.solve(cg.BoundaryProblem(oscillator, (0, 1), [0.0], [1.0]), cg.Galerkin(1), intervals=1, solver=engine)
    assert path.action == 0.375  # (1² - (1/2)²)/2
    np.testing.assert_array_equal(path.momentum, [[1.25, 0.75]])  # p_0 = -∂S/∂x_0 = 1 + x̄/2, p_1 = 1 - x̄/2
    assert path.morse_index == 0


SOLVERS = [cg.newton, cg.rootfinder, cg.ipopt, cg.minimizer]
BAND = 0.2  # of an order


@pytest.fixture(scope="module")
def valley():
    """A mass that varies in a convex potential: one path, a minimum; and exact values, path and velocity, of it."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: (1 + x[0] ** 2) * v[0] ** 2 / 2 + ca.cosh(x[0]), (0.0, 3.0), [0.3], [1.5]
    )
    path = cg.solve(problem, cg.Galerkin(14), 20)  # its derivative is of order 14, too
    return problem, path


@pytest.mark.parametrize("solver", SOLVERS, ids=str)
@pytest.mark.parametrize(
    ("method", "order", "counts"),
    [
        (cg.Galerkin(2), 4, (10, 20)),
        *slow(
            (cg.Galerkin(1, quadrature=cg.left_rectangle()), 1, (64, 128)),
            (cg.Galerkin(3, quadrature=cg.radau(3)), 5, (8, 16)),
        ),
    ],
    ids=str,
)
def test_every_solver_reaches_the_order_at_the_joints(valley, solver, method, order, counts):
    """The smaller of twice the degree and the rule's order, of positions and momenta."""
    problem, exact = valley
    assert order == min(2 * method.degree, method.quadrature.order)
    errors = []
    for count in counts:
        path = cg.solve(problem, method, count, solver=solver)
        momentum = (1 + exact(path.t) ** 2) * exact(path.t, 1)
        errors.append([np.max(np.abs(path.x - exact(path.t))), np.max(np.abs(path.momentum - momentum))])
    slopes = np.log(np.divide(*errors)) / np.log(counts[1] / counts[0])
    np.testing.assert_allclose(slopes, order, rtol=0, atol=BAND)


# options


def test_options_are_kept_added_and_written_as_they_are_given():
    few = cg.ipopt.with_options(max_iter=50)
    both = few.with_options(tol=1e-6)
    assert (dict(cg.ipopt.options), dict(few.options)) == ({}, {"max_iter": 50})
    assert dict(both.options) == {"max_iter": 50, "tol": 1e-6}
    assert repr(both) == "cg.ipopt.with_options(max_iter=50, tol=1e-06)"
    assert eval(repr(both), {"cg": cg}) == both
    assert {both: "kept"}[few.with_options(tol=1e-6)] == "kept"
    assert both.with_options(max_iter=3).options["max_iter"] == 3


@pytest.mark.parametrize("solver", [cg.newton, cg.rootfinder], ids=str)
@pytest.mark.parametrize("linear_solver", ["qr", "csparse"])
def test_another_linear_solver_gives_the_same_path(solver, linear_solver):
    scene = BY_NAME["long pendulum, index 1"]
    here, there = (scene.solve(solver=each) for each in (solver, solver.with_options(linear_solver=linear_solver)))
    np.testing.assert_allclose(there.polynomial.values, here.polynomial.values, rtol=0, atol=CLOSED_FORM)
    assert (there.morse_index, there.solver) == (1, here.solver)


def test_a_linear_solver_is_taken_to_a_tolerance_too():
    solver = cg.newton.with_options(linear_solver="qr")
    problem = BY_NAME["short pendulum"].problem
    here, there = cg.solve(problem, tol=1e-9), cg.solve(problem, tol=1e-9, solver=solver)
    np.testing.assert_allclose(there.polynomial.values, here.polynomial.values, rtol=0, atol=CLOSED_FORM)


@pytest.mark.parametrize("linear_solver", ["csparse", "lapacklu", "symbolicqr"])
def test_a_singular_hessian_is_named_whatever_the_linear_solver(linear_solver):
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 4, (0, 1), [0], [0])  # the line is a path, without inertia
    with pytest.raises(cg.ConjugatePointError, match="singular"):
        cg.solve(problem, cg.Galerkin(3), 4, solver=cg.newton.with_options(linear_solver=linear_solver))


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize(
    ("solver", "words"),
    [
        (cg.ipopt, "IPOPT stopped with 'Maximum Iterations Exceeded'"),
        (cg.minimizer, "IPOPT on the action stopped with 'Maximum Iterations Exceeded'"),
        (cg.newton, "Newton's method: no convergence in {count} iterations"),
    ],
    ids=["ipopt", "minimizer", "newton"],
)
def test_the_most_iterations_are_those_of_the_solver_underneath(solver, words, count):
    """Beyond Bratu's fold there is no path."""
    problem = cg.BoundaryProblem(bratu(3.6), (0, 1), [0.0], [0.0])
    with pytest.raises(cg.ConvergenceError, match=words.format(count=count)) as caught:
        cg.solve(problem, cg.Galerkin(4), 6, solver=solver.with_options(max_iter=count))
    if solver is not cg.newton:  # which is rescued, in vain
        assert caught.value.iterations == count


def test_newton_with_few_iterations_is_rescued():
    problem = cg.BoundaryProblem(pendulum, (0, 10), [0.0], [1.0])
    assert cg.solve(problem, cg.Galerkin(4), 20).solver == "Newton"
    rescued = cg.solve(problem, cg.Galerkin(4), 20, solver=cg.newton.with_options(max_iter=1))
    assert rescued.solver == "IPOPT on the action, then Newton"


def test_the_rootfinder_with_few_iterations_leaves_more_to_newton():
    problem = cg.BoundaryProblem(pendulum, (0, 2), [0.0], [1.0])
    tr = cg.transcribe(problem, cg.Galerkin(4), 20)
    whole, brief = (tr.solve(solver=cg.rootfinder.with_options(max_iter=count)) for count in (50, 1))
    assert whole.solver == brief.solver == "CasADi's rootfinder, then Newton"
    np.testing.assert_allclose(whole.x, brief.x, rtol=0, atol=1e-14)


@pytest.mark.parametrize("solver", SOLVERS, ids=str)
@pytest.mark.parametrize("name", ["max_iterations", "no_such_option"])
def test_an_unknown_option_is_refused_by_its_name(solver, name, capfd):
    with pytest.raises(ValueError, match=name):
        solver.with_options(**{name: 3})
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("solver", "option"),
    [
        (cg.newton, {"max_iter": 0}),
        (cg.newton, {"max_iter": True}),
        (cg.newton, {"max_iter": 2.5}),
        (cg.newton, {"linear_solver": "no such"}),
        (cg.newton, {"linear_solver": None}),
        (cg.rootfinder, {"linear_solver": "no such"}),
        (cg.rootfinder, {"max_iter": "many"}),
        (cg.ipopt, {"max_iter": "many"}),
        (cg.ipopt, {"linear_solver": "no such"}),
        (cg.ipopt, {"linear_solver": "pardiso"}),  # from a library that CasADi does not bring along
        (cg.minimizer, {"tol": "small"}),
    ],
    ids=str,
)
def test_a_value_that_an_option_does_not_take_is_refused_by_both(solver, option):
    ((name, value),) = option.items()
    with pytest.raises(ValueError, match=f"{name}.*{re.escape(repr(value))}"):
        solver.with_options(**option)


@pytest.mark.parametrize("solver", [cg.newton, cg.rootfinder], ids=str)  # IPOPT prints what the option takes
def test_refusing_a_value_prints_nothing(solver, capfd):
    with pytest.raises(ValueError, match="linear_solver"):
        solver.with_options(linear_solver="no such")
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_an_answer_of_the_rootfinder_that_cannot_be_verified_is_refused():
    problem = cg.BoundaryProblem(pendulum, (0, 20), [0.0], [10.0])
    with pytest.raises(cg.ConvergenceError, match=r"CasADi's rootfinder, then Newton's method:"):
        cg.solve(problem, cg.Galerkin(4), 40, solver=cg.rootfinder)
    assert cg.solve(problem, cg.Galerkin(4), 40, solver=cg.newton).residual <= 50


def test_options_reach_the_optimizer_of_a_control_problem():
    solver = cg.ipopt.with_options(max_iter=1)
    with pytest.raises(cg.ConvergenceError, match="Maximum Iterations Exceeded"):
        cg.solve(pendulum_in_three(), cg.Galerkin(3), 8, solver=solver)


@pytest.mark.parametrize(
    ("push", "duration", "end"),
    [
        (lambda t, v: -0.3 * v, 8.0, 1.5),
        (lambda t, v: -v * ca.fabs(v), 4.0, 1.5),
        (lambda t, v: 3 * ca.sin(3 * t) - 0.2 * v, 4.0, 1.5),
    ],
    ids=["friction", "drag", "driven"],
)
@pytest.mark.parametrize("discretization", [{"tol": 1e-6}, *slow({"method": cg.Galerkin(4), "intervals": 200})])
@pytest.mark.slow
def test_a_pendulum_with_a_force_is_found_from_the_straight_line(push, duration, end, discretization):
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 + 4 * ca.cos(x[0]),
        (0.0, duration),
        [0.0],
        [end],
        force=lambda t, x, v: ca.vertcat(push(t, v[0])),
    )
    path = cg.solve(problem, **discretization)
    thrown = solve_ivp(
        lambda t, y: [y[1], -4 * np.sin(y[0]) + float(push(t, y[1]))],
        (0.0, duration),
        [0.0, path.velocity[0, 0]],
        method="DOP853",
        rtol=1e-12,
        atol=1e-12,
    )
    assert thrown.y[0, -1] == pytest.approx(end, abs=1e-4)


def test_the_rootfinder_solves_from_a_guess_of_zeros():
    """The rows of an end condition have no terms there, by which they could be scaled."""
    turn = np.array([[0.76, -0.64], [0.64, 0.76]])
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 - ca.dot(x, x) / 2,
        (0, 2),
        [None, None],
        [None, None],
        end_conditions=lambda first, last: last - turn @ first,
        force=lambda t, x, v: [0.3 * ca.cos(t) - 0.1 * v[0], 0.2 - 0.1 * v[1]],
    )
    known = cg.solve(problem, cg.Galerkin(8), 8)
    assert cg.solve(problem, cg.Galerkin(8), 8, solver=cg.rootfinder).action == pytest.approx(known.action, rel=1e-10)


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: cg.ipopt(), r"write solver=cg.ipopt, or solver=cg.ipopt.with_options\(...\)"),
        (lambda: cg.newton(max_iter=50), r"write solver=cg.newton, or solver=cg.newton.with_options\(max_iter=50\)"),
    ],
    ids=["without arguments", "with an option"],
)
def test_a_solver_that_is_called_says_how_it_is_handed_to_a_solve(call, match):
    with pytest.raises(TypeError, match=match):
        call()
