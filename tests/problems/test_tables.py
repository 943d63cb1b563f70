"""Tables as splines in callables; answers that leave their grids are refused."""

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, first_order
from scipy.interpolate import CubicSpline

import casadi_galerkin as cg

GRID = np.linspace(-1.0, 2.0, 7)


def test_a_table_is_the_spline_through_its_values():
    made, known = cg.table(np.sin(GRID), GRID), CubicSpline(GRID, np.sin(GRID))
    places = np.linspace(-1, 2, 31)
    np.testing.assert_allclose([float(made(x)) for x in places], known(places), rtol=0, atol=1e-14)


def test_a_table_of_two_arguments_is_read_as_numpy_writes_it():
    made = cg.table(np.add.outer(np.arange(5.0), 10 * np.arange(4.0)), range(5), range(4))
    assert float(made(3.5, 1.25)) == pytest.approx(16.0)


def test_a_linear_table_needs_two_points():
    assert float(cg.table([1.0, 3.0], [0.0, 1.0], linear=True)(0.25)) == 1.5


@pytest.mark.parametrize(
    ("values", "grids", "message"),
    [
        ([1, 2, 3], [[0, 1, 2, 3]], r"values must have the shape of their grids, \(4,\), got \(3,\)"),
        ([1, 2, 3], [], r"values must have the shape of their grids, \(\), got \(3,\)"),
        ([1, 2, 3], [[0, 1, 2]], r"grid 0 must be at least 4 increasing numbers, got \[0.0, 1.0, 2.0\]"),
        ([1, 2, 3, 4], [[0, 2, 1, 3]], "grid 0 must be at least 4 increasing numbers"),
    ],
)
def test_a_table_that_does_not_fit_its_grid_is_refused(values, grids, message):
    with pytest.raises(ValueError, match=message):
        cg.table(values, *grids)


def test_a_lagrangian_of_a_table_has_the_path_of_its_polynomial():
    cubic = cg.table(GRID**3 / 6, GRID)
    paths = [
        cg.solve(cg.BoundaryProblem(lambda t, x, v, U=U: v[0] ** 2 / 2 - U(x[0]), (0, 1), 0.0, 1.0), cg.Galerkin(4), 4)
        for U in (cubic, lambda x: x**3 / 6)
    ]
    np.testing.assert_allclose(paths[0].x, paths[1].x, rtol=0, atol=1e-12)


def test_a_path_beyond_a_table_of_its_lagrangian_is_refused():
    hill = cg.table(np.cos(GRID), GRID)
    far = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - hill(x[0]), (0, 1), 0.0, 2.5)
    with pytest.raises(cg.ConvergenceError, match=r"lagrangian calls a table beyond its grid near t = 1, by 16.7% of"):
        cg.solve(far, cg.Galerkin(4), 4)
    fallen = cg.InitialProblem(far.lagrangian, (0, 1), 1.9, velocity=1.0)
    with pytest.raises(cg.ConvergenceError, match="lagrangian calls a table beyond its grid"):
        cg.solve(fallen, cg.Galerkin(4), 4)


def test_a_control_beyond_a_table_is_refused_and_one_within_is_taken():
    pull = cg.table(2 * GRID, GRID)
    flown = double_integrator(force=lambda t, x, v, u: pull(u[0]), control_bounds=(-1, 2), t_span=(0, 3))
    path = cg.solve(flown, cg.Galerkin(3), 4)
    assert path.cost == pytest.approx(6 / 27 / 4, rel=1e-9)  # of twice the force, in three times the time
    priced = cg.table(1 + GRID**2, GRID)
    longer = double_integrator(running_cost=lambda t, x, v, u: priced(t) * u**2, t_span=(0, 3))
    with pytest.raises(
        cg.ConvergenceError, match=r"running_cost calls a table beyond its grid near t = 3, by 33.3% of"
    ):
        cg.solve(longer, cg.Galerkin(3), 4)


def test_rates_and_costs_of_tables_are_in_the_programs_derivatives():
    slow = cg.table(1 + GRID**2, GRID)
    problems = [
        first_order(rates=lambda t, x, v, u, f=f: u * f(x[0]), running_cost=lambda t, x, v, u, f=f: u**2 * f(t) / 2)
        for f in (slow, lambda x: 1 + x**2)
    ]
    costs = [cg.solve(problem, cg.Galerkin(4), 4).cost for problem in problems]
    assert costs[0] == pytest.approx(costs[1], rel=1e-10)
    assert ca.DM(problems[0].rates(0, 1.5, 0, 2.0)) == pytest.approx(6.5)
