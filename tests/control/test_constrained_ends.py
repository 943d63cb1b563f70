"""What given ends leave of a holonomic constraint: where they satisfy it already, and where it determines the rest."""

import casadi as ca
import numpy as np
import pytest
from control_problems import cartesian_pendulum
from slow import slow

import casadi_galerkin as cg

METHOD, INTERVALS = cg.Galerkin(6), 12


def quarter(t):
    """A quarter turn of the circle in 2 s, from below to the side."""
    return [np.sin(t * np.pi / 4), -np.cos(t * np.pi / 4)]


def on_circle(**changes):
    """A mass of 1 kg that is pushed along the circle of radius 1 m, at the least effort."""
    stated = {"lagrangian": lambda t, x, v: ca.dot(v, v) / 2, "t_span": (0.0, 2.0), "end": [1.0, 0.0]}
    return cartesian_pendulum(**(stated | changes))


def of_free_radius(**changes):
    """The same on the circle of a free radius p, which is to be near 0.9 m."""
    return on_circle(
        lagrangian=lambda t, x, v, p: ca.dot(v, v) / 2,
        force=lambda t, x, v, u, p: [-u[0] * x[1], u[0] * x[0]],
        constraint=lambda t, x, p: ca.dot(x, x) - p[0] ** 2,
        running_cost=lambda t, x, v, u, p: u[0] ** 2 / 2 + 10 * (p[0] - 0.9) ** 2,
        **{"parameters": [1.0], "parameter_bounds": (0.5, 2.0), **changes},
    )


def on_wave(**changes):
    """A carriage pushed along x[0], held by a slot that moves up and down: x[1] = sin t."""
    stated = {
        "t_span": (0.0, 2.6),
        "start": [0.0, 0.0],
        "end": [1.0, 0.5],
        "start_velocity": [0.0, None],
        "end_velocity": [0.0, None],
        "force": lambda t, x, v, u: [u[0], 0],
        "running_cost": lambda t, x, v, u: u[0] ** 2 / 2 + 0.1,
        "constraint": lambda t, x: x[1] - ca.sin(t),
        "duration_bounds": (2.0, 3.0),
    }
    return on_circle(**{**stated, **changes})


def test_a_given_velocity_determines_the_free_position_at_which_it_is_tangent():
    """From rest over an angle f to a rate w in T seconds the least effort is 6 f²/T³ - 6 f w/T² + 2 w²/T."""
    path = cg.solve(on_circle(end=[None, None], end_velocity=[0.5, 0.5]), METHOD, INTERVALS, guess=quarter)
    np.testing.assert_allclose(path.x[:, -1], [np.sqrt(0.5), -np.sqrt(0.5)], rtol=0, atol=1e-12)
    np.testing.assert_allclose(path.velocity[:, -1], [0.5, 0.5], rtol=0, atol=1e-12)
    f, w = np.pi / 4, np.sqrt(0.5)
    assert path.cost == pytest.approx(6 * f**2 / 8 - 6 * f * w / 4 + w**2, rel=1e-9)


def test_a_velocity_given_to_a_solve_determines_the_position_as_well():
    """Rest is tangent wherever the path ends, so that what was built has no such condition yet."""
    transcription = cg.transcribe(on_circle(end=[None, None]), METHOD, INTERVALS)
    assert transcription.solve(guess=quarter).cost == pytest.approx(0, abs=1e-12)
    path = transcription.solve(end_velocity=[0.5, 0.5], guess=quarter)
    np.testing.assert_allclose(path.x[:, -1], [np.sqrt(0.5), -np.sqrt(0.5)], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_a_velocity_that_is_tangent_nowhere_has_no_path():
    with pytest.raises(cg.ConvergenceError, match="worst violated constraint is constraint 0 at t = 0"):
        cg.solve(on_circle(start=[None, -0.8], start_velocity=[1.0, 0.0]), METHOD, INTERVALS, guess=quarter)


def test_given_ends_determine_a_free_parameter_of_the_constraint():
    path = cg.solve(of_free_radius(), METHOD, INTERVALS, guess=quarter)
    np.testing.assert_allclose(path.parameters, [1.0], rtol=0, atol=1e-12)
    assert path.cost == pytest.approx(6 * (np.pi / 2) ** 2 / 8 + 0.2, rel=1e-9)


@pytest.mark.parametrize("radius", [1.8, *slow(1.0)])
def test_a_path_is_held_to_the_parameters_that_are_found_not_to_their_guess(radius):
    """The control is the angular acceleration, whose effort does not depend on the radius: that is 0.9 m."""
    problem = of_free_radius(start=[0.0, None], end=[None, 0.0], parameters=[radius])
    path = cg.solve(problem, METHOD, INTERVALS, guess=lambda t: np.multiply(radius, quarter(t)))
    assert path.cost == pytest.approx(6 * (np.pi / 2) ** 2 / 8, rel=1e-9)
    assert path.parameters[0] == pytest.approx(0.9, abs=1e-9)


def test_a_given_end_determines_the_time_at_which_a_moving_constraint_allows_it():
    path = cg.solve(on_wave(), METHOD, INTERVALS)
    assert path.t[-1] == pytest.approx(np.pi - np.arcsin(0.5), abs=1e-12)
    assert path.x[1, -1] == 0.5


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: on_wave(start_velocity=[0.0, 0.0]), "start_velocity must be tangent"),
        (lambda: on_wave(start=[0.0, 0.1]), "constraint must be zero at the given start"),
        (lambda: on_wave(constraint=lambda t, x: [x[0] - t, x[1]]), "2 values for 2 components"),
    ],
)
def test_what_is_given_at_the_start_is_checked_where_the_duration_is_free(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_constraint_that_is_not_finite_at_the_guess_is_named():
    """Its logarithm is not defined on the straight line between the ends, which passes too near to the center."""
    inside = on_circle(constraint=lambda t, x: ca.log(2.2 * ca.dot(x, x) - 1.2))
    with pytest.raises(ValueError, match=r"constraint 0 is not finite at the guess, at t = 0\."):
        cg.solve(inside, METHOD, INTERVALS)
    assert cg.solve(inside, METHOD, INTERVALS, guess=quarter).cost == pytest.approx(
        cg.solve(on_circle(), METHOD, INTERVALS, guess=quarter).cost, rel=1e-9
    )


def on_bent_rod(**changes):
    """A mass on the circle in two coordinates, beside a third one that follows p times the first, p being free."""
    stated = {
        "lagrangian": lambda t, x, v, p: ca.dot(v, v) / 2,
        "start": [0.0, -1.0, 0.0],
        "end": [1.0, 0.0, None],
        "start_velocity": [0.0, 0.0, 0.0],
        "end_velocity": [None, None, None],
        "force": lambda t, x, v, u, p: [u[0], u[1], 0],
        "running_cost": lambda t, x, v, u, p: ca.dot(u, u) / 2,
        "controls": 2,
        "constraint": lambda t, x, p: [ca.dot(x[:2], x[:2]) - 1, x[2] - p[0] * x[0]],
        "parameters": [1.0],
        "parameter_bounds": (0.5, 2.0),
    }
    return on_circle(**{**stated, **changes})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"start": [0.0, -1.05, 0.0]}, r"zero at the given start, .*: constraint\[0\] is 0.1025"),
        (
            {"start_velocity": [0.5, 0.3, 0.5]},
            r"start_velocity must be tangent .*: the rate of constraint\[0\] is -0.6",
        ),
    ],
)
def test_a_constraint_that_depends_on_nothing_free_is_checked_beside_one_that_does(changes, message):
    assert on_bent_rod().constraints == 2
    with pytest.raises(ValueError, match=message):
        on_bent_rod(**changes)
