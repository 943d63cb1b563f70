"""Work against precision: every cell measured, orders fitted, failures kept, bad input refused."""

import itertools
from importlib import import_module

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, pendulum_in_three

import casadi_galerkin as cg

INTERVALS = (4, 8, 16, 32)
BAND = 0.2  # of a fitted order
REFERENCE = 1e-12  # own error of a solved reference, with room to its roundoff of some 1e-15
TIMES = np.linspace(0, 1, 2001)


@pytest.fixture(scope="module")
def pendulum():
    return cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), (0.0, 1.0), [0.0], [1.0])


def test_every_cell_has_its_row(measured):
    cells = [(row.method.degree, row.intervals) for row in measured.rows]
    assert cells == [(degree, count) for degree in (1, 2, 6) for count in INTERVALS]
    assert [row.unknowns for row in measured.rows] == [degree * count - 1 for degree, count in cells]


@pytest.mark.parametrize(("degree", "order"), [(1, 2), (2, 3)])
def test_fitted_order_between_the_joints_is_degree_plus_one(measured, degree, order):
    assert measured.order(cg.Galerkin(degree)) == pytest.approx(order, abs=BAND)


def test_order_is_not_fitted_to_roundoff(oscillator):
    fine = cg.trade(oscillator, [cg.Galerkin(12)], [4, 8, 16], reference=lambda t: [np.sin(t)])
    assert fine.order(cg.Galerkin(12)) is None


@pytest.mark.parametrize("tol", [1e-3, 1e-6, 1e-9])
def test_fresh_solve_with_the_cheapest_method_meets_the_tolerance(pendulum, tol):
    chosen = cg.trade(pendulum, [cg.Galerkin(m) for m in (2, 4, 8)], (2, 4, 8, 16)).cheapest(tol)
    path = cg.solve(pendulum, chosen.method, chosen.intervals)
    fine = cg.solve(pendulum, cg.Galerkin(14), 12)
    assert np.max(np.abs(path(TIMES) - fine(TIMES))) <= tol


def test_failed_cells_stay_with_their_reason():
    """Bratu's critical value is 8/e = 2.94 for the trapezoidal rule on 2 intervals, 3.5138 in the limit."""
    bratu = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 3.513 * ca.exp(x[0]), (0.0, 1.0), [0.0], [0.0])
    measured = cg.trade(bratu, [cg.Galerkin(1, quadrature=cg.trapezoid()), cg.Galerkin(4)], (2, 40))
    failed = [row for row in measured.rows if row.failure is not None]
    assert failed
    assert len(failed) < len(measured.rows)
    for row in failed:
        assert "no path was found" in row.failure
        assert np.isnan(row.error)
        assert row not in measured.front()
    assert "failed: no path was found" in str(measured)


def test_a_trade_in_which_nothing_is_solved_raises():
    none = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 5 * ca.exp(x[0]), (0.0, 1.0), [0.0], [0.0])
    with pytest.raises(cg.ConvergenceError, match="no method solved the problem on any mesh"):
        cg.trade(none, [cg.Galerkin(2)], (4,))


def test_an_empty_grid_is_refused(pendulum):
    with pytest.raises(ValueError, match="at least one method"):
        cg.trade(pendulum, [], (4,))


@pytest.mark.parametrize(
    ("methods", "intervals", "changes", "error", "message"),
    [
        ([cg.Galerkin(2)], [4, 0], {}, ValueError, "intervals must be at least 1, got 0"),
        ([cg.Galerkin(2)], [4, 2.5], {}, TypeError, "intervals must be a whole number, got 2.5"),
        ([cg.Galerkin(2), 2], [4], {}, TypeError, "method must be a Galerkin, .*, got 2"),
        ([cg.Galerkin(2)], [4], {"guess": lambda t: t}, ValueError, r"the guess must return .* \(1,\), got \(\)"),
        (
            [cg.Galerkin(2)],
            [4],
            {"guess": lambda t: [np.nan]},
            ValueError,
            r"the guess must be finite, got \[nan\] at t = 0.0",
        ),
        ([cg.Galerkin(2)], [4], {"guess": np.zeros((1, 5))}, TypeError, "must fit every mesh: a callable or a Traj"),
        ([cg.Galerkin(2)], [4], {"guess": "line"}, TypeError, "must fit every mesh: .* got 'line'"),
    ],
)
def test_what_does_not_fit_is_refused_before_any_cell(
    pendulum, methods, intervals, changes, error, message, monkeypatch
):
    module = import_module("casadi_galerkin.studies.trade")
    monkeypatch.setattr(module, "_first", lambda *given: pytest.fail("solved before the input was checked"))
    with pytest.raises(error, match=message):
        cg.trade(pendulum, methods, intervals, **changes)


def test_a_trade_of_no_problem_is_refused():
    with pytest.raises(TypeError, match="BoundaryProblem or InitialProblem or ControlProblem, got function"):
        cg.trade(lambda t, x, v: v[0] ** 2, [cg.Galerkin(2)], [4])


def test_an_initial_problem_is_traded_without_a_guess():
    problem = cg.InitialProblem(lambda t, x, v: v[0] ** 2 / 2, (0.0, 2.0), [0.0], velocity=[1.0])
    with pytest.raises(ValueError, match="an initial problem takes no guess"):
        cg.trade(problem, [cg.Galerkin(2)], [4], guess=lambda t: [t])


def test_guess_chooses_the_branch():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), (0.0, 10.0), [0.0], [1.0])
    over = cg.trade(problem, [cg.Galerkin(6)], (30, 60), guess=lambda t: [3 * np.sin(np.pi * t / 10) + t / 10])
    path = cg.solve(problem, cg.Galerkin(6), 60)
    other = cg.trade(problem, [cg.Galerkin(6)], (60,), reference=path, guess=lambda t: [3 * np.sin(np.pi * t / 10)])
    assert over.rows[-1].error < 1e-8
    assert other.rows[0].error > 0.1


def test_initial_problems_are_traded_alike():
    """Between the joints the order is m + 1, at the joints 2m: 8 times and 16 times for twice the intervals."""
    problem = cg.InitialProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0.0, 2.0), [0.0], velocity=[1.0])
    measured = cg.trade(problem, [cg.Galerkin(2)], (16, 32, 64), reference=lambda t: [np.sin(t)])
    assert [row.unknowns for row in measured.rows] == [32, 64, 128]
    assert measured.order(cg.Galerkin(2)) == pytest.approx(3, abs=BAND)
    ratios = [a.joint_error / b.joint_error for a, b in itertools.pairwise(measured.rows)]
    np.testing.assert_allclose(ratios, 16, rtol=0.03, atol=0)


def test_control_problems_are_traded_alike():
    measured = cg.trade(pendulum_in_three(), [cg.Galerkin(2), cg.Galerkin(4)], (4, 8, 16))
    assert measured.reference_error < 1e-10  # IPOPT's tolerance, not roundoff
    assert measured.order(cg.Galerkin(2)) == pytest.approx(3, abs=BAND)
    assert measured.rows[0].unknowns == 7 + 8  # inner nodes, and a control at each of two points an interval
    assert measured.cheapest(1e-6).method.degree == 4


def test_energy_error_is_relative_to_the_whole_path():
    """A path at rest at both ends has no energy at the joints to compare with."""
    exact = cg.trade(double_integrator(), [cg.Galerkin(3)], (1,), reference=lambda t: [3 * t**2 - 2 * t**3])
    assert max(exact.rows[0].error, exact.rows[0].action_error, exact.rows[0].energy_error) < REFERENCE
