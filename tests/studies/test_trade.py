"""Work against precision: every cell measured, orders fitted, failures kept, bad input refused."""

import itertools
from collections import Counter
from importlib import import_module

import casadi as ca
import mpmath
import numpy as np
import pytest
from callbacks import pendulum_with_callback
from control_problems import double_integrator, first_order, pendulum_in_three
from scenes import oscillator_problem, pendulum

import casadi_galerkin as cg

INTERVALS = (4, 8, 16, 32)
BAND = 0.2  # of a fitted order
REFERENCE = 1e-12  # own error of a solved reference, with room to its roundoff of some 1e-15


def test_every_cell_has_its_row(measured):
    cells = [(row.method.degree, row.intervals) for row in measured.rows]
    assert cells == [(degree, count) for degree in (1, 2, 6) for count in INTERVALS]
    assert [row.unknowns for row in measured.rows] == [degree * count - 1 for degree, count in cells]


@pytest.mark.parametrize(("degree", "order"), [(1, 2), (2, 3)])
def test_fitted_order_between_the_joints_is_degree_plus_one(measured, degree, order):
    assert measured.order(cg.Galerkin(degree)) == pytest.approx(order, abs=BAND)


@pytest.mark.slow
def test_order_is_not_fitted_to_roundoff(oscillator):
    fine = cg.trade(oscillator, [cg.Galerkin(12)], [4, 8, 16], reference=lambda t: [np.sin(t)])
    assert fine.order(cg.Galerkin(12)) is None


@pytest.fixture(scope="module")
def every_way():
    """The pendulum nearly over the top, in ten seconds, and its trade over every way there is."""
    problem = cg.BoundaryProblem(pendulum, (0.0, 10.0), [0.0], [1.0])
    guess = cg.solve(problem, cg.Galerkin(3), 12, guess=lambda t: [t / 10 + 3 * np.sin(np.pi * t / 10)])
    measured = cg.trade(
        problem,
        [cg.Galerkin(4), cg.Galerkin(12, quadrature=cg.lobatto(13))],
        (10, 20),
        tolerances=(1e-3, 1e-9),
        solvers=(cg.newton, cg.rootfinder, cg.ipopt),
        shooting=True,
        guess=guess,
    )
    return problem, guess, measured


@pytest.fixture(scope="module")
def exact_swing():
    """Times and the exact path there, sin(x/2) = k sn(t, k), that is 1 at t = 10 on its way down."""
    times = np.linspace(0, 10, 301)
    with mpmath.workdps(30):
        end, bracket = mpmath.sin(mpmath.mpf(1) / 2), (mpmath.mpf("0.9997"), mpmath.mpf("0.99985"))
        k = mpmath.findroot(lambda k: k * mpmath.ellipfun("sn", 10, k=k) - end, bracket, solver="anderson")
        return times, np.array([float(2 * mpmath.asin(k * mpmath.ellipfun("sn", t, k=k))) for t in times.tolist()])


@pytest.mark.slow
def test_every_way_has_its_row(every_way):
    _, _, measured = every_way
    ways = Counter(row.way for row in measured.rows)
    assert ways == {
        **dict.fromkeys(("newton", "rootfinder", "ipopt", "shooting"), 2 * 2),
        **{
            f"{solver}, {kind} {tol:g}": 1
            for solver in ("newton", "rootfinder", "ipopt")
            for kind in ("tol", "mesh of")
            for tol in (1e-3, 1e-9)
        },
    }
    assert [row.failure for row in measured.rows if row.failure is not None] == []
    assert all(0 < row.solve_seconds < np.inf for row in measured.rows)
    assert all(0 < row.first_seconds < np.inf for row in measured.rows)


@pytest.mark.parametrize("tol", [10.0**-k for k in range(3, 12)])
@pytest.mark.slow
def test_the_cheapest_row_solves_again_within_the_tolerance(every_way, exact_swing, tol):
    problem, guess, measured = every_way
    path = measured.cheapest(tol).solve(problem, guess)
    times, exact = exact_swing
    assert np.max(np.abs(path(times)[0] - exact)) <= tol * np.max(exact)


@pytest.mark.slow
def test_every_row_solves_again_with_the_error_it_had(every_way, exact_swing):
    problem, guess, measured = every_way
    times, exact = exact_swing
    for row in measured.rows:
        path = row.solve(problem, guess)
        assert (path.method, len(path.t) - 1) == (row.method, row.intervals)
        assert np.max(np.abs(path(times)[0] - exact)) / np.max(exact) <= 1.01 * row.error + 1e-14, row


def test_a_row_of_shooting_solves_no_other_kind_of_problem(every_way):
    row = next(row for row in every_way[2].rows if row.shooting)
    with pytest.raises(TypeError, match="problem must be a BoundaryProblem, got ControlProblem"):
        row.solve(double_integrator())


def test_a_mesh_that_a_tolerance_has_found_is_solved_on_again(every_way):
    problem, guess, measured = every_way
    (row,) = (row for row in measured.rows if row.way == "newton, mesh of 1e-09")
    found = cg.solve(problem, tol=1e-9, guess=guess)
    assert row.solve(problem, guess).t.tolist() == list(row.mesh) == found.t.tolist()
    first, last = problem.t_span
    longer = row.solve(problem.varied({}, (first, 1.1 * last)))
    np.testing.assert_allclose(longer.t, 1.1 * found.t, rtol=1e-14)


def test_no_row_solves_what_is_no_problem(every_way):
    for row in every_way[2].rows:
        with pytest.raises(TypeError, match=r"problem must be a BoundaryProblem.*, got int"):
            row.solve(3)


def test_a_problem_with_a_function_of_this_process_is_refused_before_any_cell():
    with pytest.raises(TypeError, match=r"cannot be pickled, .* such as a casadi\.Callback"):
        cg.trade(pendulum_with_callback(), [cg.Galerkin(4)], [10])


@pytest.mark.slow
def test_a_way_that_fails_is_a_row_that_says_why():
    """Beyond half a period the path of an oscillator is a saddle of the action, which no minimizer finds."""
    problem = oscillator_problem(t_span=(0.0, 4.0))
    measured = cg.trade(problem, [cg.Galerkin(4)], [8], tolerances=[1e-6], solvers=[cg.newton, cg.minimizer])
    failed = {row.way for row in measured.rows if row.failure is not None}
    assert failed == {"minimizer", "minimizer, tol 1e-06"}
    assert measured.cheapest(1e-3).solver is cg.newton


@pytest.mark.slow
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
    with pytest.raises(cg.ConvergenceError, match="no way led to a path"):
        cg.trade(none, [cg.Galerkin(2)], (4,))


@pytest.mark.parametrize(
    ("methods", "intervals", "changes", "error", "message"),
    [
        ([], [4], {}, ValueError, "give at least one method and one number of intervals, or a tolerance, got"),
        ([], [], {"tolerances": [1e-3, 1.5]}, ValueError, "tol must be a number between 0 and 1, got 1.5"),
        ([cg.Galerkin(2)], [4], {"solvers": [cg.newton, "ipopt"]}, TypeError, "solvers must be Solvers.*got 'ipopt'"),
        ([cg.Galerkin(2)], [4], {"shooting": 1}, TypeError, "shooting must be True or False, got 1"),
        ([cg.Galerkin(2)], [4], {"of": 1.0}, TypeError, "of must be a callable path -> number or array, got 1.0"),
        (
            [cg.Galerkin(2)],
            [4],
            {"shooting": True, "guess": lambda t: [t]},
            TypeError,
            "must fit every way: a Trajectory, as shooting needs its start, got",
        ),
        ([cg.Galerkin(2)], [4, 0], {}, ValueError, "intervals must be at least 1, got 0"),
        ([cg.Galerkin(2)], [4, 2.5], {}, TypeError, "intervals must be a whole number, got 2.5"),
        ([cg.Galerkin(2), 2], [4], {}, TypeError, "method must be a Galerkin, .*, got 2"),
        ([cg.Galerkin(2)], [4], {"guess": lambda t: t}, ValueError, r"the guess must return .* \(1,\), got \(\)"),
        (
            [cg.Galerkin(2)],
            [4],
            {"guess": lambda t: [np.nan]},
            ValueError,
            r"the guess must be finite, got \[nan\] at t = 0$",
        ),
        ([cg.Galerkin(2)], [4], {"guess": np.zeros((1, 5))}, TypeError, "must fit every way: a callable or a Traj"),
        ([cg.Galerkin(2)], [4], {"guess": "line"}, TypeError, "must fit every way: .* got 'line'"),
    ],
)
def test_what_does_not_fit_is_refused_before_any_cell(methods, intervals, changes, error, message, monkeypatch):
    module = import_module("casadi_galerkin.studies.trade")
    monkeypatch.setattr(module, "_measured", lambda *given: pytest.fail("solved before the input was checked"))
    with pytest.raises(error, match=message):
        cg.trade(oscillator_problem(), methods, intervals, **changes)


def test_a_trade_of_no_problem_is_refused():
    with pytest.raises(TypeError, match="BoundaryProblem or InitialProblem or ControlProblem, got function"):
        cg.trade(lambda t, x, v: v[0] ** 2, [cg.Galerkin(2)], [4])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"guess": lambda t: [t]}, "an InitialProblem is solved step by step, and takes no guess"),
        ({"solvers": [cg.newton]}, "and takes no solvers"),
        ({"shooting": True}, "only a BoundaryProblem is solved by shooting, got InitialProblem"),
    ],
)
def test_an_initial_problem_is_traded_step_by_step(changes, message):
    problem = cg.InitialProblem(lambda t, x, v: v[0] ** 2 / 2, (0.0, 2.0), [0.0], velocity=[1.0])
    with pytest.raises(ValueError, match=message):
        cg.trade(problem, [cg.Galerkin(2)], [4], **changes)


def test_a_control_problem_is_not_traded_by_solvers_of_equations():
    with pytest.raises(ValueError, match=r"solved by cg\.ipopt, cg\.fatrop or cg\.sqp, got the solver cg\.newton"):
        cg.trade(double_integrator(), [cg.Galerkin(3)], [4], solvers=[cg.newton])


@pytest.mark.slow
def test_guess_chooses_the_branch():
    problem = cg.BoundaryProblem(pendulum, (0.0, 10.0), [0.0], [1.0])
    over = cg.trade(problem, [cg.Galerkin(6)], (30, 60), guess=lambda t: [3 * np.sin(np.pi * t / 10) + t / 10])
    path = cg.solve(problem, cg.Galerkin(6), 60)
    other = cg.trade(problem, [cg.Galerkin(6)], (60,), reference=path, guess=lambda t: [3 * np.sin(np.pi * t / 10)])
    assert over.rows[-1].error < 1e-8
    assert other.rows[0].error > 0.1


@pytest.mark.slow
def test_initial_problems_are_traded_alike():
    """Between the joints the order is m + 1, at the joints 2m: 8 times and 16 times for twice the intervals."""
    problem = cg.InitialProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0.0, 2.0), [0.0], velocity=[1.0])
    measured = cg.trade(problem, [cg.Galerkin(2)], (16, 32, 64), reference=lambda t: [np.sin(t)])
    assert [row.unknowns for row in measured.rows] == [32, 64, 128]
    assert measured.order(cg.Galerkin(2)) == pytest.approx(3, abs=BAND)
    ratios = [a.joint_error / b.joint_error for a, b in itertools.pairwise(measured.rows)]
    np.testing.assert_allclose(ratios, 16, rtol=0.03, atol=0)


@pytest.mark.slow
def test_control_problems_are_traded_alike():
    measured = cg.trade(pendulum_in_three(), [cg.Galerkin(2), cg.Galerkin(4)], (4, 8, 16))
    assert measured.reference_error < 1e-10  # IPOPT's tolerance, not roundoff
    assert measured.order(cg.Galerkin(2)) == pytest.approx(3, abs=BAND)
    assert measured.rows[0].unknowns == 7 + 8  # inner nodes, and a control at each of two points an interval
    assert measured.cheapest(1e-6).method.degree == 4


@pytest.mark.slow
def test_control_problems_are_traded_by_their_cost_and_to_tolerances():
    """Degree 2 has the cost to the fourth order, while the path between the joints is of the third."""
    problem, degree = pendulum_in_three(), cg.Galerkin(2)
    measured = cg.trade(problem, [degree], (8, 16, 32), tolerances=[1e-5], of=lambda path: path.cost)
    ways = ["ipopt, tol 1e-05", "ipopt, tol 1e-05 of it", "ipopt, mesh of 1e-05", "ipopt, mesh of 1e-05 of it"]
    assert [row.way for row in measured.rows[3:]] == ways
    assert measured.quantity == "it"
    assert measured.order(degree) == pytest.approx(4, abs=BAND)
    cheap = measured.cheapest(1e-4)
    assert cheap.solve(problem).cost == pytest.approx(cg.solve(problem, tol=1e-8).cost, rel=1e-4)


@pytest.mark.slow
def test_phases_found_to_a_tolerance_are_solved_again_on_their_mesh():
    legs = double_integrator(
        running_cost=lambda t, x, v, u: 1 + u[0] ** 2 / 2, duration_bounds=(0.1, 5.0), waypoints=[(0.5, [0.2])]
    )
    measured = cg.trade(legs, [], [], tolerances=[1e-6])
    assert [row.failure for row in measured.rows] == [None] * 2
    assert max(row.error for row in measured.rows) < 1e-6


@pytest.mark.parametrize("power", [2, 10])
@pytest.mark.slow
def test_the_error_of_a_free_duration_is_an_error_of_the_path(power):
    """Least ∫ (u²/2 + 0.3 t^k) dt: at the same parts of the duration every row has the same path, a straight line."""
    problem = first_order(
        t_span=(0.0, 1.5),
        running_cost=lambda t, x, v, u: u[0] ** 2 / 2 + 0.3 * t**power,
        duration_bounds=(0.2, 8.0),
    )
    exact = (1 / 0.6) ** (1 / (power + 2))  # where 1 / (2 T²) = 0.3 T^k
    rows = cg.trade(problem, [cg.Galerkin(1), cg.Galerkin(2)], [1, 2]).rows
    durations = [abs(row.solve(problem).t[-1] / exact - 1) for row in rows]
    assert max(durations) > 1e-3
    np.testing.assert_allclose([row.error for row in rows], durations, rtol=1e-3, atol=1e-10)


def test_the_reference_has_an_interval_between_any_two_breakpoints():
    """Of a higher degree it would need fewer intervals than the rows have."""
    line, tenths = lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, [k / 10 for k in range(1, 10)]
    problem = cg.BoundaryProblem(line, (0, 1), [0.0], [1.0], breakpoints=tenths)
    (row,) = cg.trade(problem, [cg.Galerkin(2)], [10]).rows
    assert 1e-8 < row.error < 1e-4


@pytest.mark.slow
def test_a_breakpoint_at_any_time_is_no_error():
    """Nothing happens there, so that each row has it elsewhere."""
    problem = double_integrator(
        t_span=(0.0, 2.0),
        running_cost=lambda t, x, v, u: 1.0,
        control_bounds=(-1, 1),
        duration_bounds=(0.2, 5.0),
        breakpoints=[0.3],
    )
    measured = cg.trade(problem, [cg.Galerkin(2)], [8], tolerances=[1e-5])
    assert next(row for row in measured.rows if "tol" in row.way).error < 1e-5


@pytest.mark.slow
def test_errors_of_paths_that_jump_at_free_times_have_the_order_of_the_method():
    """Joints of one path match those of the other, whichever comes first."""
    problem = double_integrator(
        lagrangian=lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]),
        start=[1.0],
        running_cost=lambda t, x, v, u: 1 + u[0] ** 2,
        duration_bounds=(0.1, 3.0),
        waypoints=[(0.45, [0.0])],
        jumps=[(0.45, lambda x, v: (x - 0.3, -0.8 * v))],
    )
    degree = cg.Galerkin(2)
    measured = cg.trade(problem, [degree], (16, 32, 64))
    assert measured.order(degree) == pytest.approx(3, abs=BAND)
    assert max(row.joint_error for row in measured.rows) < 1e-4


@pytest.mark.slow
def test_shooting_a_given_energy_has_the_errors_of_the_global_path():
    problem = cg.BoundaryProblem(pendulum, (0.0, 0.8), [0.0], [1.0], energy=0.5)
    whole, shot = cg.trade(problem, [cg.Galerkin(3)], [6], shooting=True).rows
    assert (shot.way, shot.failure) == ("shooting", None)
    assert shot.error == pytest.approx(whole.error, rel=1e-6)
