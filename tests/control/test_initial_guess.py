"""Where a trajectory optimisation begins: guesses of every kind, warm starts, what is refused."""

import casadi as ca
import numpy as np
import pytest
from control_problems import cart_pole, double_integrator, minimum_time

import casadi_galerkin as cg

SOLVED = 1e-8  # what IPOPT leaves of the optimality conditions, amplified by their conditioning


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
