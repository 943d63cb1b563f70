"""IPOPT, on the action and on its stationarity conditions: minima only, rescues, any units."""

import casadi as ca
import numpy as np
import pytest
from callbacks import pendulum_with_callback
from scenes import BY_NAME, oscillator, pendulum
from slow import slow

import casadi_galerkin as cg


def test_the_minimizer_finds_the_minimum_where_newton_finds_a_saddle():
    problem = BY_NAME["long pendulum, index 0"].problem
    newton = cg.solve(problem, cg.Galerkin(8), intervals=30)
    least = cg.solve(problem, cg.Galerkin(8), intervals=30, solver=cg.minimizer)
    assert newton.morse_index > 0
    assert least.morse_index == 0
    assert least.action == pytest.approx(-3.918564307581, abs=1e-9)


def test_minimizing_past_the_conjugate_point_fails_while_the_path_exists():
    problem = cg.BoundaryProblem(oscillator, (0, 4.0), [0.0], [1.0])
    with pytest.raises(cg.ConvergenceError, match=r"no minimum \(Morse index 1\)|IPOPT on the action stopped with"):
        cg.solve(problem, cg.Galerkin(4), intervals=10, solver=cg.minimizer)
    assert cg.solve(problem, cg.Galerkin(4), intervals=10).morse_index == 1


@pytest.mark.parametrize(("T", "end"), [(10, 3.0), *slow((50, 3.0))])
def test_large_swings_are_rescued_and_the_report_says_so(T, end):
    path = cg.solve(cg.BoundaryProblem(pendulum, (0, T), [0.0], [end]), cg.Galerkin(4), intervals=4 * T)
    assert path.solver == "IPOPT on the action, then Newton"
    assert path.morse_index == 0
    assert path.residual <= 50


@pytest.mark.parametrize("solver", [cg.ipopt, cg.minimizer])
@pytest.mark.parametrize(("action", "length", "time"), [(1e-74, 1e6, 1e-3), (1e50, 1e-8, 1e7)])
def test_ipopt_finds_the_same_path_in_any_units(solver, action, length, time):
    """A long swing from a straight line."""

    def swing(action, length, time):
        def lagrangian(t, x, v):
            angle = x[0] / length
            return action * ((v[0] * time / length) ** 2 / 2 + 1.5 * ca.cos(angle) + 0.3 * ca.sin(t / time) * angle)

        problem = cg.BoundaryProblem(lagrangian, (0.0, 17.0 * time), [0.0], [-5.0 * length])
        return cg.solve(problem, cg.Galerkin(4), 20, solver=solver)

    expected, path = swing(1.0, 1.0, 1.0), swing(action, length, time)
    assert (path.solver, path.iterations) == (expected.solver, expected.iterations)
    np.testing.assert_allclose(path.x / length, expected.x, rtol=0, atol=1e-9)
    assert path.action / action / time == pytest.approx(expected.action, rel=1e-9)


@pytest.mark.parametrize("solver", [cg.ipopt, cg.minimizer])
def test_ipopt_needs_no_third_derivatives(solver):
    """A Callback for a cosine may have a first and a second derivative, and no more."""
    actions = [
        cg.solve(problem, cg.Galerkin(4), 10, solver=solver).action
        for problem in (pendulum_with_callback(), cg.BoundaryProblem(pendulum, (0, 2), [0.0], [1.0]))
    ]
    assert actions[0] == pytest.approx(actions[1], rel=1e-12)
