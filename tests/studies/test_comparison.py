"""Global against stepwise, on problems whose growth is known in closed form."""

from importlib import import_module

import casadi as ca
import numpy as np
import pytest
from motions import kepler
from scenes import pendulum, saddle

import casadi_galerkin as cg

METHOD = cg.Galerkin(8)


def exact(t, horizon):
    return (np.exp(-t) + np.exp(t - horizon)) / (1 + np.exp(-horizon))


@pytest.fixture(scope="module")
def forty():
    return cg.compare(cg.BoundaryProblem(saddle, (0, 40), [1.0], [1.0]), METHOD, intervals=80)


def test_the_global_path_keeps_all_digits_where_shooting_keeps_none(forty):
    path = forty.global_path
    assert np.max(np.abs(path.x[0] - exact(path.t, 40))) <= 1e-12
    assert forty.shooting.path is None
    assert "A change of the start grows up to 1.2e+17 times along the path" in forty.shooting.failure
    assert forty.shooting.iterations > 0
    assert forty.shooting.gap[0] == 0
    assert forty.shooting.gap[-1] > 1e-2  # of the last path that shooting tried


def test_the_gap_of_the_steps_grows_like_the_saddle(forty):
    assert forty.stepped.gap[0] == 0
    assert forty.gap_growth == pytest.approx(1, abs=0.02)
    assert 28 < forty.parting_time < 38  # where e^t eps is a tenth: 33.8
    assert forty.stepped.gap[-1] > 1


@pytest.mark.parametrize("horizon", [1, 10, 40])
def test_condition_numbers_are_those_of_the_closed_form(horizon):
    comparison = cg.compare(cg.BoundaryProblem(saddle, (0, horizon), [1.0], [1.0]), METHOD, intervals=2 * horizon)
    largest_momentum = np.tanh(horizon / 2)
    stepwise = np.cosh(horizon) + np.sinh(horizon) * largest_momentum
    assert comparison.condition_global == pytest.approx(1, rel=1e-12)
    assert comparison.condition_stepwise == pytest.approx(stepwise, rel=1e-10)


@pytest.mark.parametrize("horizon", [200, 700])
@pytest.mark.slow
def test_long_horizons_are_still_solved_globally(horizon):
    comparison = cg.compare(cg.BoundaryProblem(saddle, (0, horizon), [1.0], [1.0]), METHOD, intervals=horizon)
    path = comparison.global_path
    np.testing.assert_allclose(path.x[0], exact(path.t, horizon), rtol=0, atol=1e-14)
    assert path.morse_index == 0
    assert np.log(comparison.condition_stepwise) == pytest.approx(horizon, abs=1e-6)
    assert comparison.shooting.failure is not None


@pytest.fixture(scope="module")
def parted():
    return cg.compare(cg.BoundaryProblem(pendulum, (0, 10), [0.0], [1.0]), cg.Galerkin(6), intervals=40)


def test_a_gap_as_large_as_the_path_is_that_of_another_path(parted):
    assert np.max(parted.shooting.gap) > 1
    assert parted.shooting.path.action < parted.global_path.action - 1


def test_a_guess_leads_both_ways_to_the_same_path(parted):
    problem, method = cg.BoundaryProblem(pendulum, (0, 10), [0.0], [1.0]), cg.Galerkin(6)
    comparison = cg.compare(problem, method, intervals=40, guess=parted.shooting.path)
    assert np.max(comparison.shooting.gap) < 1e-8


@pytest.mark.parametrize(
    "problem",
    [
        cg.BoundaryProblem(pendulum, (0, 6), [0.0], [1.0]),
        cg.BoundaryProblem(kepler, (0, 2), [1.0, 0.0], [-0.4, 0.9]),  # its gap adds up to 4e-14
        cg.BoundaryProblem(lambda t, x, v: ca.dot(v, v) / 2 - x[0] ** 2 / 2, (0, 40), [1.0], [0.5]),
    ],
    ids=["pendulum", "kepler", "oscillator"],
)
def test_a_gap_at_roundoff_has_no_rate_of_growth(problem):
    comparison = cg.compare(problem, METHOD, intervals=40)
    assert np.isnan(comparison.gap_growth)
    assert "  the gap of the steps stays at roundoff" in str(comparison).splitlines()
    assert "exp(" not in str(comparison)


@pytest.mark.slow
def test_a_gap_that_leaves_roundoff_at_two_joints_has_no_rate_of_growth():
    comparison = cg.compare(cg.BoundaryProblem(saddle, (0, 40), [1.0], [1.0]), cg.Galerkin(16), intervals=3)
    assert np.isnan(comparison.gap_growth)
    assert "between roundoff and a tenth at too few joints to tell how it grows" in str(comparison)


def test_only_what_comes_before_the_parting_is_growth():
    module = import_module("casadi_galerkin.studies.comparison")
    t = np.arange(40.0)
    gap = 1e-13 * np.exp(t)
    gap[30:] = 1e-3  # by chance
    assert module._growth_rate(t, gap) == pytest.approx(1, rel=1e-12)


@pytest.mark.slow
def test_ways_agree_on_a_short_arc_of_kepler():
    comparison = cg.compare(cg.BoundaryProblem(kepler, (0, 2), [1.0, 0.0], [-0.4, 0.9]), METHOD, intervals=10)
    assert comparison.shooting.failure is None
    assert np.max(comparison.shooting.gap) < 1e-13
    assert np.max(comparison.stepped.gap) < comparison.condition_stepwise * 1e-14
    assert comparison.parting_time == np.inf
    assert 1 <= comparison.condition_global < comparison.condition_stepwise
    assert comparison.stepped.seconds > 0


@pytest.mark.parametrize(
    "problem",
    [
        cg.BoundaryProblem(saddle, (0, 2), [1.0], [None]),
        cg.BoundaryProblem(saddle, (0, 2), [None], [1.0]),
        cg.BoundaryProblem(
            lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * x[0] ** 2 + x[0] * ca.cos(t),
            (0, 2 * np.pi),
            [None],
            parameters=[1.0],
            periodic=True,
        ),
    ],
    ids=["free end", "free start", "periodic with parameters"],
)
def test_every_kind_of_end_is_compared(problem):
    comparison = cg.compare(problem, METHOD, mesh=problem.t_span[1] * np.linspace(0, 1, 9) ** 1.2)
    assert np.max(comparison.shooting.gap) < 1e-12
    given = [value for value in problem.start + problem.end if value is not None]
    assert comparison.condition_global == pytest.approx(1.0 if given else np.nan, rel=1e-12, nan_ok=True)


@pytest.mark.parametrize(
    "problem",
    [
        cg.BoundaryProblem(saddle, (0, 2), [None], [None], end_action=lambda x0, x1: ca.sumsqr(x0 - 1) + ca.sumsqr(x1)),
        cg.BoundaryProblem(saddle, (0, 2), [None], [1.0], start_velocity=[0.3]),
        cg.BoundaryProblem(
            lambda t, x, v: ca.sumsqr(v) / 2 - x[1],
            (0, 1),
            [0.6, -0.8],
            [None, None],
            end_conditions=lambda x0, x1: x1[0] + x1[1] / 2,
            constraint=lambda t, x: ca.sumsqr(x) - 1,
        ),
    ],
    ids=["springs", "velocity", "circle to a line"],
)
def test_ends_that_are_not_given_are_compared(problem):
    comparison = cg.compare(problem, METHOD, intervals=8)
    assert np.max(comparison.shooting.gap) < 1e-12
    lines = str(comparison).splitlines()
    assert [line.split()[0] for line in lines[2:5]] == ["global", "steps", "shooting"]
    assert "failed" not in str(comparison)
    given = [value for value in (*problem.start, *problem.end) if value is not None]
    assert np.isnan(comparison.condition_global) == (not given)
    assert (lines[2].split()[-1] == "nan") == (not given)
    assert lines[-1] == "  the gap of the steps stays at roundoff"


def test_a_given_energy_is_compared():
    """Along one orbit of speed u, with part f of the time gone, ∂x/∂x_0 = (1 - f) u/u_0 and ∂x/∂x_N = f u/u_N."""
    problem = cg.BoundaryProblem(pendulum, (0, 0.8), [0.0], [1.0], energy=0.5)
    comparison = cg.compare(problem, METHOD, intervals=8)
    path = comparison.global_path
    np.testing.assert_allclose(comparison.shooting.path.t, path.t, rtol=1e-14)
    assert np.max(comparison.shooting.gap) < 1e-14
    assert np.max(comparison.stepped.gap) < 1e-14
    assert "failed" not in str(comparison)
    gone, speed = path.t / path.t[-1], np.sqrt(2 * (0.5 + np.cos(path.x[0])))
    magnified = (1 - gone) * speed / speed[0] + gone * speed / speed[-1]
    assert comparison.condition_global == pytest.approx(np.max(magnified), rel=1e-9)


@pytest.mark.slow
def test_a_periodic_path_of_given_energy_is_compared():
    problem = cg.BoundaryProblem(pendulum, (0, 7.0), [None], periodic=True, energy=-0.5)
    turning = cg.solve(problem, cg.Galerkin(4), 12, guess=lambda t: [np.sin(2 * np.pi * t / 7 + 0.3)])
    comparison = cg.compare(problem, METHOD, intervals=12, guess=turning)
    np.testing.assert_allclose(comparison.shooting.path.t, comparison.global_path.t, rtol=1e-13)
    assert np.max(comparison.shooting.gap) < 1e-13
    assert np.isnan(comparison.condition_global)


@pytest.mark.slow
def test_another_path_of_the_same_energy_takes_another_time():
    problem = cg.BoundaryProblem(pendulum, (0, 3.0), [0.0], [1.0], energy=0.5)
    comparison = cg.compare(problem, METHOD, intervals=16)
    assert comparison.shooting.path.t[-1] > 5 * comparison.global_path.t[-1]  # it swings to the other side first


def test_steps_that_fail_are_part_of_the_answer():
    def walls(t, x, v):  # x'' = x where |x| < 2, and no Lagrangian beyond: only the global path stays within
        return v[0] ** 2 / 2 + x[0] ** 2 / 2 - 1e-9 * ca.log(2 - x[0]) - 1e-9 * ca.log(2 + x[0])

    comparison = cg.compare(cg.BoundaryProblem(walls, (0, 60), [1.0], [1.0]), METHOD, intervals=120)
    assert comparison.stepped.path is None
    assert "was not solved" in comparison.stepped.failure
    assert np.isfinite(comparison.stepped.gap[:40]).all()
    assert np.isnan(comparison.stepped.gap[-1])
    assert comparison.stepped.failure in str(comparison)
    assert comparison.parting_time < 40


def test_the_table_holds_all_ways(forty):
    text = str(forty)
    for part in ("global", "steps from its start", "shooting", "failed", "2.4e+17", "grows like exp(1 t)"):
        assert part in text


@pytest.mark.usefixtures("headless")
def test_the_plot_shows_the_gap(forty):
    axes = forty.plot(time="t in s")
    (line,) = [line for line in axes.lines if line.get_label().startswith("steps")]
    assert (axes.get_yscale(), axes.get_xlabel()) == ("log", "t in s")
    assert line.get_ydata()[-1] == forty.stepped.gap[-1]
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == ["steps from its start", "shooting (failed)"]
    assert forty.plot(axes) is axes


@pytest.mark.slow
def test_a_global_failure_is_raised():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, np.pi), [0.0], [1.0])
    with pytest.raises(cg.ConvergenceError):
        cg.compare(problem, cg.Galerkin(6), intervals=10)


def test_only_a_boundary_problem_is_compared():
    start = cg.InitialProblem(saddle, (0, 1), [0.0], velocity=[1.0])
    with pytest.raises(TypeError, match="problem must be a BoundaryProblem, got InitialProblem"):
        cg.compare(start, METHOD, 4)


@pytest.mark.usefixtures("headless")
def test_a_start_that_cannot_be_stepped_from_is_part_of_the_answer():
    """There the mass vanishes, which the global solve does not mind."""
    compared = cg.compare(cg.BoundaryProblem(lambda t, x, v: x[0] * v[0] ** 2 / 2, (0, 1), [0.0], [1.0]), METHOD, 20)
    assert "mass matrix ∂²L/∂v² is singular at the start" in compared.stepped.failure
    assert compared.stepped.path is None
    assert compared.stepped.iterations == 0
    assert compared.global_path(1.0)[0] == 1.0
    assert not compared.plot().lines


@pytest.mark.usefixtures("headless")
@pytest.mark.slow
def test_steps_that_leave_the_range_of_doubles_are_compared_and_drawn():
    compared = cg.compare(cg.BoundaryProblem(saddle, (0, 1000), [1.0], [1.0]), METHOD, 500)
    assert compared.condition_stepwise == np.inf
    assert np.nanmax(compared.stepped.gap) > 1e300
    compared.plot().figure.draw_without_rendering()


def test_a_guess_that_shooting_cannot_start_from_is_refused_before_any_solve(monkeypatch):
    module = import_module("casadi_galerkin.studies.comparison")
    monkeypatch.setattr(module, "solve", lambda *_, **__: pytest.fail("the problem was solved"))
    with pytest.raises(TypeError, match=r"guess must be a Trajectory of 1 component, got <function"):
        cg.compare(cg.BoundaryProblem(pendulum, (0, 1), [0.0], [1.0]), METHOD, 4, guess=lambda t: [t])


def test_one_interval_is_no_plural():
    compared = cg.compare(cg.BoundaryProblem(pendulum, (0, 1), [0.0], [1.0]), METHOD, 1)
    assert "1 interval, " in repr(compared)


@pytest.mark.slow
def test_a_tolerance_chooses_degree_and_mesh_of_all_three_ways():
    comparison = cg.compare(cg.BoundaryProblem(pendulum, (0, 4), [0.0], [1.0]), tol=1e-6)
    assert comparison.global_path.error_estimate <= 1e-6
    for way in (comparison.stepped, comparison.shooting):
        np.testing.assert_array_equal(way.path.t, comparison.global_path.t)
        assert way.path.method == comparison.global_path.method
    assert cg.compare(comparison.global_path.problem, intervals=4).global_path.method == cg.Galerkin(8)
