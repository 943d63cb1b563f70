"""Quantities of a path: their errors, and tolerances of them."""

import pickle
from functools import partial

import casadi as ca
import numpy as np
import pytest
from random_quantities import OF_OPTIMA, problem, pushed_swing
from random_quantities import QUANTITIES as RANDOM
from slow import slow

import casadi_galerkin as cg

SWING = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), (0, 10), start=[0.0], end=[1.0])
QUANTITIES = {
    "end momentum": lambda path: path.momentum[:, -1],
    "end velocity": lambda path: path(path.t[-1], 1),
    "position": lambda path: path(3.3)[0],
    "action": lambda path: path.action,
    "energy": lambda path: path.energy[0],
    "start velocity": lambda path: path.velocity[:, 0],
}


@pytest.fixture(scope="module")
def exact():
    return cg.solve(SWING, cg.Galerkin(16), intervals=12, guess=cg.solve(SWING, tol=1e-11))


def pushed(**changes):
    rules = {"force": lambda t, x, v, u: u - ca.sin(x), "running_cost": lambda t, x, v, u: u**2 / 2, "controls": 1}
    ends = [0.0], [1.0], [0.0], [0.0]
    return cg.ControlProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), *ends, **{**rules, **changes})


@pytest.mark.parametrize("name", QUANTITIES)
@pytest.mark.parametrize("degree", [3, 5])
def test_the_error_of_a_quantity_is_its_difference_to_the_path_of_a_higher_degree(exact, name, degree):
    path, of = cg.solve(SWING, cg.Galerkin(degree), intervals=10, guess=exact), QUANTITIES[name]
    true, error = np.abs(of(path) - of(exact)), path.error_of(of)
    assert error.shape == np.shape(of(path))
    assert 0.9 * error.max() <= true.max() <= 1.1 * error.max()


@pytest.mark.parametrize("name", QUANTITIES)
@pytest.mark.parametrize("tol", [1e-5, *slow(1e-9)])
def test_a_tolerance_of_a_quantity_is_met_by_the_quantity(exact, name, tol):
    of = QUANTITIES[name]
    path = cg.solve(SWING, tol=tol, of=of, guess=exact)
    true = np.max(np.abs(of(path) - of(exact))) / np.max(np.abs(of(exact)))
    assert true <= max(1.1 * path.asked_error, 1e-13)
    assert path.asked_error <= tol
    assert np.array_equal(path.asked, of(path))
    assert f"error {path.asked_error:.1e} of its size" in repr(path)
    assert f"error       {path.error_estimate:.1e} of the path, estimated" in repr(path)


@pytest.mark.slow
def test_momenta_need_fewer_intervals_than_positions_and_velocities_more():
    few, some, more = (
        len(cg.solve(SWING, cg.Galerkin(4), tol=1e-7, of=of).t)
        for of in (QUANTITIES["end momentum"], None, QUANTITIES["end velocity"])
    )
    assert few < 0.6 * some < some < more


def test_paths_of_higher_degree_are_found_once_and_kept_on_the_way_to_another_process():
    path = cg.solve(SWING, tol=1e-8, of=QUANTITIES["action"])
    again = pickle.loads(pickle.dumps(path))
    assert again.error_of(QUANTITIES["energy"]) == path.error_of(QUANTITIES["energy"])
    assert again.__dict__["_comparisons"].finer[0].action == path.__dict__["_comparisons"].finer[0].action


@pytest.mark.parametrize("solve", [cg.solve, *slow(cg.shoot)])
def test_stepped_paths_know_the_errors_of_quantities(exact, solve):
    if solve is cg.solve:
        start = cg.InitialProblem(SWING.lagrangian, (0, 10), [0.0], momentum=exact.momentum[:, 0])
        path = solve(start, cg.Galerkin(4), 20)
    else:
        path = solve(SWING, cg.Galerkin(4), 20, guess=exact)
    true = abs(path.action - exact.action)
    assert 0.9 * true < path.error_of(lambda path: path.action) < 1.5 * true


def test_steps_are_halved_until_a_quantity_is_known(exact):
    start = cg.InitialProblem(SWING.lagrangian, (0, 10), [0.0], momentum=exact.momentum[:, 0])
    path = cg.solve(start, cg.Galerkin(4), tol=1e-7, of=QUANTITIES["end momentum"])
    assert path.asked_error <= 1e-7 < path.error_estimate
    assert path.asked == pytest.approx(exact.momentum[:, -1], rel=2e-7)


@pytest.mark.slow
def test_a_kink_that_both_degrees_miss_is_an_error_of_every_quantity():
    bounce = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - 50 * ca.fabs(x[0] - 0.3337), (0, 1), start=[0.0], end=[1.0]
    )
    path = cg.solve(bounce, cg.Galerkin(8), intervals=3)
    exact = cg.solve(bounce, cg.Galerkin(4), intervals=2000, guess=path)
    assert abs(path.action - exact.action) <= path.error_of(lambda path: path.action)


@pytest.mark.parametrize(
    ("of", "error", "match"),
    [
        (3.0, TypeError, r"of must be a callable path -> number or array, got 3\.0"),
        (lambda path: None, TypeError, "what of returns must be real numbers, got None"),
        (lambda path: "x", TypeError, "what of returns must be real numbers, got 'x'"),
        (lambda path: np.nan, ValueError, "of must return finite numbers, got nan"),
        (lambda path: [], ValueError, r"of must return finite numbers, got \[\]"),
        (lambda path: path.x[3], ValueError, "of raised IndexError"),
        (lambda path: path.polynomial.values, ValueError, "whose shape does not depend on the path"),
    ],
)
def test_what_is_no_quantity_is_refused(of, error, match):
    with pytest.raises(error, match=match):
        cg.solve(SWING, tol=1e-3, of=of)


def test_no_error_is_claimed_below_rounding():
    path = cg.solve(SWING, tol=1e-12)
    for of in QUANTITIES.values():
        assert np.min(path.error_of(of)) > 1e-16 * np.max(np.abs(of(path)))
    assert path.error_of(lambda path: path(5.0, 1)) > 10 * path.error_of(lambda path: path(5.0))


def test_a_quantity_needs_its_tolerance():
    with pytest.raises(ValueError, match="of is what a tolerance is asked of: give tol with it"):
        cg.solve(SWING, cg.Galerkin(3), 10, of=QUANTITIES["action"])


def test_a_limit_returns_the_quantity_with_the_error_reached():
    with pytest.raises(cg.LimitReached, match="tolerance 1e-09 was not reached") as caught:
        cg.solve(SWING, cg.Galerkin(2), tol=1e-9, of=QUANTITIES["end velocity"], limits=cg.Limits(intervals=400))
    path = caught.value.path
    assert path.asked == QUANTITIES["end velocity"](path)
    assert 1e-9 < path.asked_error < 1e-2


@pytest.mark.slow
def test_an_optimum_is_refined_for_a_quantity_of_it():
    path = cg.solve(pushed(), cg.Galerkin(3), tol=1e-6, of=lambda path: path.momentum[:, -1] + path.cost)
    assert path.asked_error <= 1e-6 < path.error_estimate
    finer = cg.solve(pushed(), cg.Galerkin(10), 12)
    assert abs(finer.momentum[0, -1] + finer.cost - path.asked[0]) <= 1e-6 * abs(path.asked[0])
    assert "asked" in repr(path)


def test_the_errors_of_an_optimum_are_at_least_those_of_the_cost():
    path, finer = cg.solve(pushed(), cg.Galerkin(3), 4), cg.solve(pushed(), cg.Galerkin(10), 12)
    true = abs(path.cost - finer.cost)
    assert true <= path.error_of(lambda path: path.cost) <= 2.5 * true


@pytest.mark.slow
def test_a_free_duration_is_known_to_its_tolerance():
    bounds = {"duration_bounds": (0.5, 4.0), "control_bounds": ([-2.0], [2.0])}
    fastest = pushed(running_cost=lambda t, x, v, u: 1.0 + 0 * t, force=lambda t, x, v, u: u, **bounds)
    path = cg.solve(fastest, tol=1e-6, of=lambda path: path.t[-1])
    assert abs(path.asked - np.sqrt(2.0)) <= 1.42e-6
    assert isinstance(path.asked, float)


def end_momentum(path):
    return path.momentum[:, -1]


def test_many_solves_know_a_quantity_to_its_tolerance():
    transcription = cg.transcribe(SWING, tol=1e-7, of=end_momentum)
    alone = [transcription.solve(end=[end]) for end in (1.0, 1.1)]
    swept = cg.sweep(SWING, [{"end": [1.0]}, {"end": [1.1]}], tol=1e-7, of=end_momentum)
    assert all(path.asked_error <= 1e-7 for path in (*alone, *swept))
    assert [path.asked[0] for path in swept] == pytest.approx([path.asked[0] for path in alone], rel=2e-7)
    found = cg.paths(SWING, tol=1e-5, of=end_momentum, count=2)
    assert all(path.asked_error <= 1e-5 for path in found)


@pytest.mark.slow
def test_many_optima_know_a_quantity_to_its_tolerance():
    transcription = cg.transcribe(pushed(), cg.Galerkin(3), tol=1e-6, of=lambda path: path.cost)
    assert "nothing solved yet" in repr(transcription)
    first, other = transcription.solve(), transcription.solve(end=[1.2], verbose=0)
    assert transcription.first is first
    assert "first path of" in repr(transcription)
    assert max(first.asked_error, other.asked_error) <= 1e-6
    (swept,) = cg.sweep(pushed(), [{"end": [1.2]}], cg.Galerkin(3), tol=1e-6, of=lambda path: path.cost)
    assert swept.asked == pytest.approx(other.asked, rel=2e-6)


@pytest.mark.parametrize("solve", [cg.transcribe, partial(cg.sweep, variations=[]), cg.paths], ids=str)
def test_many_solves_need_the_tolerance_of_a_quantity(solve):
    with pytest.raises(ValueError, match="of is what a tolerance is asked of: give tol with it"):
        solve(SWING, of=end_momentum)


def test_a_quantity_for_other_processes_is_a_function_of_a_module(tmp_path):
    with pytest.raises(TypeError, match=r"of .*give a module's function"):
        cg.sweep(SWING, [{}], tol=1e-5, of=lambda path: path.action, file=tmp_path / "sweep")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1000, 1003))
@pytest.mark.parametrize(("degree", "tol"), [(None, 1e-9), (3, 1e-6)])
def test_quantities_of_random_paths_are_within_their_tolerances(seed, degree, tol):
    """Of 171 paths with eight or nine quantities each, other seeds, none was beyond."""
    stated, method = problem(seed), None if degree is None else cg.Galerkin(degree)
    exact = cg.solve(stated, tol=1e-12)
    known = {name: of(exact) for name, of in RANDOM.items()} | {"end velocity": exact.velocity[:, -1]}
    quantities = dict(RANDOM)
    if stated.constraint is not None:
        quantities["multiplier"] = lambda path: path.multipliers(path.t[-1])
        known["multiplier"] = exact.multipliers(exact.t[-1])
    for name, of in quantities.items():
        path = cg.solve(stated, method, tol=tol, of=of, guess=exact)
        assert path.asked_error <= tol
        assert np.max(np.abs(path.asked - known[name])) <= tol * np.max(np.abs(known[name])), name


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20, 23))
def test_quantities_of_random_optima_are_within_their_tolerances(seed):
    """Of 14 optima with four quantities and two tolerances each, other seeds, none was beyond, and three refused."""
    stated = pushed_swing(seed)
    exact = cg.solve(stated, tol=1e-8)
    for name, of in OF_OPTIMA.items():
        path = cg.solve(stated, tol=1e-5, of=of, guess=exact)
        assert path.asked_error <= 1e-5
        assert np.max(np.abs(path.asked - of(exact))) <= 1e-5 * np.max(np.abs(of(exact))), name
