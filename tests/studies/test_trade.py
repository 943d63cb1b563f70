import csv
import itertools
from dataclasses import replace
from importlib import import_module

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator, pendulum_in_three

import casadi_galerkin as cg
from casadi_galerkin.studies.trade_table import Row

INTERVALS = (4, 8, 16, 32)
BAND = 0.2  # of a fitted order
REFERENCE = 1e-12  # own error of a solved reference, with room to its roundoff of some 1e-15
TIMES = np.linspace(0, 1, 2001)


@pytest.fixture(scope="module")
def oscillator():
    return cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0.0, 2.0), [0.0], [np.sin(2.0)])


@pytest.fixture(scope="module")
def measured(oscillator):
    return cg.trade(oscillator, [cg.Galerkin(1), cg.Galerkin(2), cg.Galerkin(6)], INTERVALS)


@pytest.fixture(scope="module")
def pendulum():
    return cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), (0.0, 1.0), [0.0], [1.0])


def row(seconds, error, **changes):
    return replace(Row(cg.Galerkin(2), 5, solve_seconds=seconds, error=error), **changes)


def test_every_cell_has_its_row(measured):
    cells = [(row.method.degree, row.intervals) for row in measured.rows]
    assert cells == [(degree, count) for degree in (1, 2, 6) for count in INTERVALS]
    assert [row.unknowns for row in measured.rows] == [degree * count - 1 for degree, count in cells]


def test_solved_and_exact_reference_give_the_same_errors(oscillator, measured):
    exact = cg.trade(oscillator, [cg.Galerkin(1), cg.Galerkin(2)], INTERVALS, reference=lambda t: [np.sin(t)])
    assert measured.reference_error < REFERENCE
    assert exact.reference_error == 0.0
    for ours, theirs in zip(measured.rows, exact.rows, strict=False):
        # sizes of components are the largest value at a reference's nodes, 1e-6 short of the maximum between them;
        # energies of a callable come from differences of its values, with a roundoff of 1e-13 or so
        for name in ("error", "joint_error", "action_error", "energy_error"):
            assert getattr(ours, name) == pytest.approx(getattr(theirs, name), rel=1e-5, abs=3 * REFERENCE)


def test_errors_are_those_of_a_fresh_solve(oscillator, measured):
    worst = measured.rows[4]
    path = cg.solve(oscillator, worst.method, worst.intervals)
    at = np.linspace(0, 2, 4001)
    between, joints = np.abs(path(at)[0] - np.sin(at)), np.abs(path.x[0] - np.sin(path.t))
    assert worst.error == pytest.approx(between.max(), rel=1e-3, abs=0)  # both sample a curve's maximum
    assert worst.joint_error == pytest.approx(joints.max(), rel=1e-5, abs=0)  # the component's size is 1


@pytest.mark.parametrize(("degree", "order"), [(1, 2), (2, 3)])
def test_fitted_order_between_the_joints_is_degree_plus_one(measured, degree, order):
    assert measured.order(cg.Galerkin(degree)) == pytest.approx(order, abs=BAND)


def test_order_is_not_fitted_to_roundoff(oscillator):
    fine = cg.trade(oscillator, [cg.Galerkin(12)], [4, 8, 16], reference=lambda t: [np.sin(t)])
    assert fine.order(cg.Galerkin(12)) is None


def test_front_holds_exactly_the_rows_no_other_beats():
    best, worse, fine, slow = row(1.0, 1e-3), row(2.0, 1e-2), row(3.0, 1e-6), row(4.0, 1e-6)
    failed = Row(cg.Galerkin(2), 5, failure="no path")
    assert cg.Trade((slow, failed, worse, fine, best), "given", 0.0).front() == [best, fine]


def test_cheapest_is_the_fastest_row_within_the_tolerance():
    rows = row(1.0, 1e-3), row(2.0, 1e-5), row(3.0, 1e-6)
    assert cg.Trade(rows, "given", 0.0).cheapest(1e-4) is rows[1]
    assert cg.Trade(rows, "solved", 5e-6).cheapest(1e-5) is rows[2]  # the reference's own error counts


def test_cheapest_refuses_what_no_row_reaches():
    with pytest.raises(ValueError, match=r"at most 1e-09: the least is 1\.0e-03"):
        cg.Trade((row(1.0, 1e-3),), "given", 0.0).cheapest(1e-9)


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
    with pytest.raises(cg.ConvergenceError, match="no cell of the trade was solved"):
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


def path_of(lagrangian, t_span, *ends, **changes):
    return cg.solve(cg.BoundaryProblem(lagrangian, t_span, *ends, **changes), cg.Galerkin(3), 4)


def free(t, x, v):
    return ca.sumsqr(v) / 2


@pytest.mark.parametrize(
    ("reference", "error", "message"),
    [
        (path_of(free, (0, 1), [0.0], [1.0]), ValueError, r"reference must be a path of 2 component\(s\), got 1"),
        (path_of(free, (0, 2), [0, 0], [1, 1]), ValueError, r"reference must run from 0\.0 to 1\.0, got 0\.0 to 2\.0"),
        (
            path_of(lambda t, x, v, p: p[0] * free(t, x, v), (0, 1), [0, 0], [1, 1], parameters=[1.0]),
            ValueError,
            r"reference must have 0 parameter\(s\), got 1",
        ),
        (lambda t: t, ValueError, r"the reference must return an array of shape \(2,\), got \(\)"),
        (lambda t: [t], ValueError, r"the reference must return an array of shape \(2,\), got \(1,\)"),
        (lambda t: [t, np.nan], ValueError, r"the reference must be finite on \(0\.0, 1\.0\), got"),
        (lambda t: ["a", "b"], TypeError, "values of the reference must be real numbers, got"),
        ("x", TypeError, r"the reference must be a Trajectory or a callable t -> \(2,\), got 'x'"),
    ],
    ids=["components", "span", "parameters", "scalar", "length", "nan", "text", "no path"],
)
def test_a_reference_that_does_not_fit_is_refused_before_any_cell(reference, error, message, monkeypatch):
    module = import_module("casadi_galerkin.studies.trade")
    monkeypatch.setattr(module, "_first", lambda *given: pytest.fail("solved before the reference was checked"))
    problem = cg.BoundaryProblem(free, (0.0, 1.0), [0.0, 0.0], [1.0, 1.0])
    with pytest.raises(error, match=message):
        cg.trade(problem, [cg.Galerkin(2)], [4], reference=reference)


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


def test_periodic_paths_count_their_first_joint_once():
    forced = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 + x[0] * ca.cos(t), (0.0, 2 * np.pi), [None], periodic=True
    )
    measured = cg.trade(forced, [cg.Galerkin(3)], (8,))
    assert measured.rows[0].unknowns == 24


def test_parameters_reach_the_reference():
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * x[0] ** 2 / 2, (0.0, 1.0), [0.0], [np.sin(2.0)], parameters=[4.0]
    )
    measured = cg.trade(problem, [cg.Galerkin(8)], (8,), reference=lambda t: [np.sin(2 * t)])
    assert max(measured.rows[0].error, measured.rows[0].action_error, measured.rows[0].energy_error) < REFERENCE


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


def test_table_holds_every_row_and_the_reference(measured):
    text = str(measured)
    assert len(text.splitlines()) == 3 + len(measured.rows)
    assert f"own error {measured.reference_error:.1e}" in text


def test_csv_holds_every_row(measured, tmp_path):
    measured.to_csv(tmp_path / "trade.csv")
    with (tmp_path / "trade.csv").open(encoding="utf-8", newline="") as file:
        read = list(csv.DictReader(file))
    assert [float(line["error"]) for line in read] == [row.error for row in measured.rows]
    assert [int(line["degree"]) for line in read] == [row.method.degree for row in measured.rows]


def test_every_method_has_its_own_line_and_name(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    methods = [
        cg.Galerkin(4),
        cg.Galerkin(4, cg.chebyshev_points(4)),
        cg.Galerkin(4, quadrature=cg.lobatto(5)),
        cg.Galerkin(1, quadrature=cg.left_rectangle()),
        cg.Galerkin(1, quadrature=cg.radau(1)),
    ]
    trade = cg.Trade(tuple(row(1.0, 1e-3, method=method) for method in methods), "given", 0.0)
    axes = trade.plot()
    labels = [line.get_label() for line in axes.lines]
    assert labels == [str(method) for method in methods]
    assert len(set(labels)) == len(methods)
    assert all(label in str(trade) for label in labels)
    import matplotlib.pyplot as plt

    plt.close(axes.figure)


def test_lines_of_one_name_are_all_drawn(monkeypatch):
    """Rules of the same ends and order differ within."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    rules = [cg.Quadrature([0.0, 0.5 - s, 0.5 + s, 1.0], [0.25, 0.25, 0.25, 0.25]) for s in (0.1, 0.2)]
    rows = tuple(row(1.0, 1e-3, method=cg.Galerkin(2, quadrature=rule)) for rule in rules)
    axes = cg.Trade(rows, "given", 0.0).plot()
    assert len(axes.lines) == 2
    import matplotlib.pyplot as plt

    plt.close(axes.figure)


def test_plot_shows_orders_and_the_floor(measured, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    axes = measured.plot()
    labels = [line.get_label() for line in axes.lines]
    assert any("degree 2" in label and "N^-" in label for label in labels)
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert "reference" in axes.texts[0].get_text()
    import matplotlib.pyplot as plt

    plt.close(axes.figure)
