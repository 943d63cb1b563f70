"""Paths to a tolerance, of every number of turns, and on surfaces."""

import casadi as ca
import numpy as np
import pytest
from scenes import bratu, bratu_theta, pendulum

import casadi_galerkin as cg

TURN = 2 * np.pi
LONG = cg.BoundaryProblem(pendulum, (0.0, 10.0), [0.0], [1.0])


@pytest.mark.slow
def test_the_pendulum_swings_and_turns_in_nine_ways():
    """Five swings, and one rotation for each number of turns, here up to two either way."""
    found = cg.paths(LONG, intervals=20, count=9, periods=[TURN])
    turns = [round((path.x[0, -1] - 1) / TURN) for path in found]
    assert sorted(turns) == sorted([0] * 5 + [-2, -1, 1, 2])
    assert found.alternating_sum == 5
    assert "the sum of (-1)^index is 5" in str(found)
    assert "missing" not in str(found)


def test_a_sum_that_is_not_that_of_all_paths_tells_that_some_are_missing():
    found = cg.paths(LONG, cg.Galerkin(8), 16, count=3, periods=[TURN])
    assert found.alternating_sum == 1
    if sum((-1) ** path.morse_index for path in found) != 1:
        assert "and not 1: some are missing" in str(found)


def test_both_paths_of_bratu_are_found_to_a_tolerance():
    found = cg.paths(cg.BoundaryProblem(bratu(2.0), (0, 1), [0.0], [0.0]), tol=1e-9, count=2)
    assert [path.morse_index for path in found] == [0, 1]
    for path, upper in zip(found, (False, True), strict=True):
        assert path.error_estimate <= 1e-9
        assert path(0.5)[0] == pytest.approx(2 * np.log(np.cosh(bratu_theta(2.0, upper) / 4)), rel=1e-9)
    assert found.alternating_sum is None


@pytest.mark.slow
def test_paths_with_free_ends_are_counted_once_for_all_turns():
    found = cg.paths(cg.BoundaryProblem(pendulum, (0.0, 5.0), [None], [None]), cg.Galerkin(6), 8, periods=[TURN])
    assert [path.morse_index for path in found] == [0, 1, 1, 2]  # upright, two swings with half a period of 5, hanging
    assert found.alternating_sum == 0


@pytest.mark.slow
def test_a_length_beside_an_angle_has_no_turns():
    """A mass on a spring that turns round: one path for each number of turns, of the same action either way."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: (v[0] ** 2 + v[1] ** 2) / 2 + ca.cos(x[0]) - x[1] ** 2 / 2, (0, 1), [0.0, 0.0], [0.0, 1.0]
    )
    found = cg.paths(problem, cg.Galerkin(6), 4, count=3, periods=[TURN, None])
    assert sorted(round(path.x[0, -1] / TURN) for path in found) == [-1, 0, 1]
    np.testing.assert_allclose([path.x[1, -1] for path in found], 1.0)
    assert found.alternating_sum is None


@pytest.mark.slow
def test_both_arcs_of_a_great_circle_are_found():
    sphere = cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2,
        (0, 1),
        [1.0, 0.0, 0.0],
        [0.0, np.cos(0.4), np.sin(0.4)],
        constraint=lambda t, x: ca.sumsqr(x) - 1,
    )
    found = cg.paths(sphere, tol=1e-6, count=2)
    np.testing.assert_allclose([np.sqrt(2 * path.action) for path in found], np.array([0.5, 1.5]) * np.pi, rtol=1e-9)
    assert [path.morse_index for path in found] == [0, 1]


@pytest.mark.slow
def test_what_no_mesh_resolves_is_dropped_and_counted():
    step = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.floor(5 * x[0]) * x[0], (0, 1), [0.0], [1.0])
    with pytest.raises(cg.ConvergenceError, match="no path was found in 20 solves"):
        cg.paths(step, tol=1e-8)


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"periods": [TURN, None]}, ValueError, "periods must be 1 number or None, one per component, got"),
        ({"periods": TURN}, ValueError, "periods must be 1 number or None, one per component, got"),
        ({"periods": [-1.0]}, ValueError, r"periods\[0\] must be a positive number, or None, got -1\.0"),
        ({"periods": [True]}, ValueError, r"periods\[0\] must be a positive number, or None, got True"),
        (
            {"periods": [3.0]},
            ValueError,
            r"periods\[0\] = 3 is no period of the problem: its lagrangian is another one",
        ),
        ({"tol": 2.0}, ValueError, "tol must be a number between 0 and 1, got 2"),
    ],
)
def test_bad_input_is_refused(given, error, message):
    with pytest.raises(error, match=message):
        cg.paths(LONG, **{"method": cg.Galerkin(4), "intervals": 2, **given})


def test_a_period_that_the_constraint_does_not_have_is_refused():
    helix = cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2, (0, 1), [0.0, 0.0], [1.0, 1.0], constraint=lambda t, x: x[0] - x[1]
    )
    with pytest.raises(ValueError, match="is no period of the problem: its constraint is another one where"):
        cg.paths(helix, cg.Galerkin(4), 4, periods=[TURN, None])
