"""The error of an answer is estimated when asked for, kept, and told; a mesh too coarse is named unasked."""

import pickle

import casadi as ca
import numpy as np
import pytest
from motions import kepler
from scenes import BY_NAME, pendulum

import casadi_galerkin as cg

SHARP = 3.0  # estimated over true error and the inverse, on smooth paths that are resolved


def orbit(eccentricity):
    """Kepler's ellipse from its pericenter."""
    speed = np.sqrt((1 + eccentricity) / (1 - eccentricity))
    return cg.InitialProblem(kepler, (0, 3), [1 - eccentricity, 0.0], velocity=[0.0, speed])


def difference(path, fine):
    times = np.linspace(*path.t[[0, -1]], 2001)
    x = fine(times)
    return np.max(np.abs(path(times) - x) / np.max(np.abs(x), axis=1, keepdims=True))


@pytest.mark.parametrize("degree", [1, 4, 7])
@pytest.mark.parametrize("name", ["short pendulum", "Troesch 5", "oscillator 7.0"])
def test_the_estimate_between_ends_is_sharp(name, degree):
    scene = BY_NAME[name]
    path = cg.solve(scene.problem, cg.Galerkin(degree), 24, guess=scene.guess)
    fine = cg.solve(scene.problem, cg.Galerkin(14), 40, guess=path)
    assert path.error_estimate is None
    assert 1 / SHARP < path.estimate_error() / difference(path, fine) < SHARP


@pytest.mark.parametrize("degree", [1, 4])
@pytest.mark.parametrize("eccentricity", [0.0, 0.3])
def test_the_estimate_of_steps_is_sharp(eccentricity, degree):
    path = cg.solve(orbit(eccentricity), cg.Galerkin(degree), 40)
    fine = cg.solve(orbit(eccentricity), cg.Galerkin(14), 40)
    assert 1 / SHARP < path.estimate_error() / difference(path, fine) < SHARP


def test_the_estimate_of_forced_steps_is_sharp():
    problem = cg.InitialProblem(
        lambda t, x, v, p: (v[0] ** 2 - p[0] * x[0] ** 2) / 2,
        (0, 6),
        [1.0],
        velocity=[0.0],
        parameters=[2.0],
        force=lambda t, x, v, p: -p[0] * v / 5,
    )
    path, fine = cg.solve(problem, cg.Galerkin(3), 12), cg.solve(problem, cg.Galerkin(14), 12)
    assert 1 / SHARP < path.estimate_error() / difference(path, fine) < SHARP


@pytest.mark.slow
def test_a_kink_that_both_degrees_miss_shows_in_the_estimate():
    """Free fall through x = 0, where the force turns round, on joints that refinement moved: by the estimate of the
    higher degree alone an error of 4e-5 was 2.9e-15."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 10 * ca.fabs(x[0]), (0, 2), [1.0], [-0.5])
    path = cg.solve(problem, cg.Galerkin(8), 7)
    fine = cg.solve(problem, cg.Galerkin(2), 20_000, guess=path)
    assert path.estimate_error() > difference(path, fine) / SHARP


def test_steps_that_a_higher_degree_cannot_follow_have_an_infinite_error():
    problem = cg.InitialProblem(
        lambda t, x, v: ca.dot(v, v) / 2 + 1 / ca.norm_2(x), (0, 2), [1.0, 0.0], velocity=[0.0, 0.0]
    )
    path = cg.solve(problem, cg.Galerkin(1, quadrature=cg.trapezoid()), 7)  # through the sun
    assert path.estimate_error() == np.inf


@pytest.mark.parametrize("asked", [False, True])
def test_an_estimate_survives_pickling(asked):
    path = cg.solve(BY_NAME["short pendulum"].problem, cg.Galerkin(3), 8)
    if asked:
        path.estimate_error()
    copy = pickle.loads(pickle.dumps(path))
    assert copy.error_estimate == path.error_estimate
    assert copy.estimate_error() == path.estimate_error() == path.error_estimate


def test_a_known_estimate_is_not_found_again():
    path = cg.solve(BY_NAME["short pendulum"].problem, tol=1e-6)
    assert path.estimate_error() == path.error_estimate <= 1e-6


def test_an_estimate_is_printed_once_known():
    path = cg.solve(BY_NAME["short pendulum"].problem, cg.Galerkin(3), 8)
    assert "estimated" not in str(path)
    path.estimate_error()
    assert f"error       {path.error_estimate:.1e} of the path, estimated" in str(path)


def test_a_trade_counts_the_known_error_of_its_reference():
    problem = BY_NAME["short pendulum"].problem
    reference = cg.solve(problem, cg.Galerkin(4), 10)
    assert cg.trade(problem, [cg.Galerkin(1)], [8], reference).reference_error == 0.0
    error = reference.estimate_error()
    table = cg.trade(problem, [cg.Galerkin(1)], [8], reference)
    assert table.reference_error == error
    assert f"given, own error {error:.1e}" in str(table)


@pytest.mark.parametrize(("degree", "few", "many"), [(1, 6, 400), (2, 5, 60), (4, 4, 30), (8, 2, 10)])
def test_a_path_that_is_plainly_not_resolved_says_so(degree, few, many):
    problem = cg.BoundaryProblem(pendulum, (0, 10), [0.0], [1.0])
    coarse = cg.solve(problem, cg.Galerkin(degree), few)
    fine = cg.solve(problem, cg.Galerkin(degree), many)
    assert "NOT RESOLVED" in str(coarse)
    assert "NOT RESOLVED" not in str(fine)
    assert coarse.estimate_error() > 1e-3
    assert f"{coarse.error_estimate:.1e} of the path, estimated" in str(coarse)


def test_steps_past_a_center_say_that_they_do_not_keep_the_balance_of_energy():
    """The path beyond is so fast that it is nearly a line, which its polynomials do resolve."""
    potential = lambda x: 1 / ca.sqrt(x[0] ** 2 + 0.01)  # noqa: E731
    fall = cg.InitialProblem(lambda t, x, v: v[0] ** 2 / 2 + potential(x), (0.0, 5.0), [1.0], velocity=[0.0])
    assert "NOT RESOLVED: the balance of energy" in str(cg.solve(fall, cg.Galerkin(4), 40))


def test_the_balance_of_energy_is_printed_also_where_the_energy_changes():
    driven = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] * ca.cos(5 * t), (0, 2), [0.0], [1.0])
    path = cg.solve(driven, cg.Galerkin(8), 10)
    assert np.ptp(path.energy) > 0.1
    assert "its balance kept to rounding" in str(path)
