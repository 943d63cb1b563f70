"""Paths of given energy, shot: their durations in closed form, and the discrete path of the global solve."""

import casadi as ca
import numpy as np
import pytest
from constrained import on_circle, planar, unit_length
from motions import henon_heiles, kepler, of_anomaly
from scenes import free_particle, pendulum
from scipy.integrate import quad
from scipy.special import ellipk
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.stepping.shooting_residual import accumulated
from casadi_galerkin.stepping.stepper import Stepper

METHOD = cg.Galerkin(8)
SAME = 1e-12  # the same discrete equations solved in two ways
DURATION = 1e-12


def launched(problem, velocity, intervals=40):
    """Guess: the path from the start of a problem with some velocity."""
    start = cg.InitialProblem(problem.lagrangian, problem.t_span, problem.start, velocity=velocity)
    return cg.solve(start, METHOD, intervals)


def shot_and_solved(problem, method, mesh, guess=None):
    """The path found in both ways, which is the same one."""
    shot, whole = (way(problem, method, mesh=mesh, guess=guess) for way in (cg.shoot, cg.solve))
    length, momentum = np.max(np.abs(whole.x)), np.max(np.abs(whole.momentum))
    sizes = length, momentum, length * momentum, whole.t[-1]
    pairs = (shot.x, whole.x), (shot.momentum, whole.momentum), (shot.action, whole.action), (shot.t, whole.t)
    for (ours, theirs), size in zip(pairs, sizes, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=SAME * size)
    assert shot.problem.t_span == (shot.t[0], shot.t[-1])
    assert shot.residual <= 50
    return shot


# from one end to the other


@pytest.mark.parametrize("eccentricity", [0.5, *slow(0.9)])
@pytest.mark.slow
def test_half_an_ellipse_of_given_energy_takes_half_of_keplers_period(eccentricity):
    mesh = of_anomaly(eccentricity, np.linspace(0, np.pi, 25))[1] * 0.98  # the duration is a guess
    problem = cg.BoundaryProblem(kepler, (0, mesh[-1]), [1 - eccentricity, 0.0], [None, 0.0], energy=-0.5)
    fast = np.sqrt((1 + eccentricity) / (1 - eccentricity))
    start = cg.InitialProblem(kepler, problem.t_span, problem.start, velocity=[0.0, fast * 1.001])
    path = shot_and_solved(problem, METHOD, mesh, cg.solve(start, METHOD, mesh=mesh))
    assert path.t[-1] == pytest.approx(np.pi, rel=DURATION)
    np.testing.assert_allclose(path.x[:, -1], [-1 - eccentricity, 0], rtol=0, atol=10 * DURATION)


@pytest.mark.parametrize(("eccentricity", "first", "last"), [(0.2, 0.5, 2.0), (0.9, 1.0, 4.0)])
@pytest.mark.slow
def test_an_arc_of_given_energy_takes_the_time_of_keplers_equation(eccentricity, first, last):
    (start, began), (end, ended) = (of_anomaly(eccentricity, anomaly) for anomaly in (first, last))
    problem = cg.BoundaryProblem(kepler, (0, 1.1 * (ended - began)), start.tolist(), end.tolist(), energy=-0.5)
    (before, _), (after, time) = (of_anomaly(eccentricity, first + d) for d in (-1e-3, 1e-3))
    rate = (after - before) / (time - of_anomaly(eccentricity, first - 1e-3)[1])
    path = shot_and_solved(problem, cg.Galerkin(10), np.linspace(*problem.t_span, 31), launched(problem, rate.tolist()))
    assert path.t[-1] == pytest.approx(ended - began, rel=10 * DURATION)


FALL = lambda t, x, v: ca.sumsqr(v) / 2 - x[1]  # noqa: E731
ENDS = {
    "over a hill": (
        cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - ca.cos(x[0]), (0, 2.0), [-2.0], [2.0], energy=1.1),
        quad(lambda x: 1 / np.sqrt(2 * (1.1 - np.cos(x))), -2, 2, epsabs=1e-14)[0],
    ),
    "on a circle": (
        cg.BoundaryProblem(
            planar, (0, 0.6), on_circle(0.2).tolist(), on_circle(1.3).tolist(), constraint=unit_length, energy=0.4
        ),
        quad(lambda a: 1 / np.sqrt(2 * (0.4 + np.cos(a))), 0.2, 1.3, epsabs=1e-14)[0],
    ),
    "to a place that is a condition, of energy zero": (
        cg.BoundaryProblem(
            lambda t, x, v: ca.sumsqr(v) / 2 + 2,
            (0, 3.0),
            [0.0, 0.0],
            [None, 1.0],
            end_conditions=lambda x0, x1: x1[0] ** 2 - x1[0] - 2,
            energy=0.0,
        ),
        np.sqrt(2) / 2,
    ),
    "thrown to any height": (  # it meets the wall at right angles
        cg.BoundaryProblem(FALL, (0, 0.8), [0.0, 0.0], [1.0, None], energy=2.0),
        np.sqrt(2 - np.sqrt(3)),
    ),
}


@pytest.mark.parametrize("kind", ENDS)
def test_ends_of_every_kind_are_met_with_the_energy_given(kind):
    problem, duration = ENDS[kind]
    path = shot_and_solved(problem, METHOD, problem.t_span[1] * np.linspace(0, 1, 13) ** 1.2)
    assert path.t[-1] == pytest.approx(duration, rel=DURATION)
    np.testing.assert_allclose(path.energy, problem.energy, rtol=0, atol=1e-11)


@pytest.mark.parametrize("rule", [cg.gauss(3), *slow(cg.lobatto(4), cg.radau(4))], ids=["Gauss", "Lobatto", "Radau"])
@pytest.mark.parametrize(("action", "length", "time"), [(1.0, 1.0, 1.0), (1e-8, 1e8, 1e-8), (1e8, 1e-8, 1e8)])
def test_units_and_rules_change_nothing(action, length, time, rule):
    def scaled(t, x, v):
        return action * henon_heiles(t / time, x / length, v * time / length)

    start, end = length * np.array([0.0, 0.1]), length * np.array([0.2, 0.3])
    problem = cg.BoundaryProblem(scaled, (0, time), start.tolist(), end.tolist(), energy=action / 8)
    path = shot_and_solved(problem, cg.Galerkin(3, quadrature=rule), np.linspace(0, time, 9))
    assert path.t[-1] / time == pytest.approx(0.65349759, rel=1e-5)


# periodic


@pytest.mark.parametrize("amplitude", [1.0, *slow(2.5)])
def test_a_libration_has_the_period_of_its_elliptic_integral(amplitude):
    problem = cg.BoundaryProblem(pendulum, (0, 7.0), [None], periodic=True, energy=-np.cos(amplitude))
    turning = lambda t: [amplitude * np.sin(2 * np.pi * t / 7 + 0.3)]  # noqa: E731
    guess = cg.solve(problem, cg.Galerkin(4), 12, guess=turning)
    path = shot_and_solved(problem, METHOD, np.linspace(0, 7, 25), guess)
    assert path.t[-1] == pytest.approx(4 * ellipk(np.sin(amplitude / 2) ** 2), rel=10 * DURATION)
    assert path.x[0, 0] == pytest.approx(amplitude * np.sin(0.3), rel=1e-12)  # on the plane through the guess


@pytest.mark.parametrize(
    ("problem", "guess", "period"),
    [
        (
            cg.BoundaryProblem(
                planar, (0, 6.5), [None, None], periodic=True, constraint=unit_length, energy=-np.cos(1.0)
            ),
            lambda t: on_circle(np.sin(2 * np.pi * t / 6.5)),
            4 * ellipk(np.sin(0.5) ** 2),
        ),
        (
            cg.BoundaryProblem(
                lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 6.0), [None], periodic=True, energy=0.5
            ),
            lambda t: [0.9 * np.sin(np.pi * t / 3 + 0.3)],
            2 * np.pi,
        ),
        (
            cg.BoundaryProblem(henon_heiles, (0, 6.3), [None, None], periodic=True, energy=1 / 8),
            lambda t: [0.35 * np.cos(t), 0.35 * np.sin(t)],
            6.075615784,
        ),
    ],
    ids=["constraint", "every energy has this period", "loop of Henon and Heiles"],
)
@pytest.mark.slow
def test_a_periodic_path_of_given_energy_is_closed(problem, guess, period):
    coarse = cg.solve(problem, cg.Galerkin(4), 12, guess=guess)
    path = shot_and_solved(problem, METHOD, problem.t_span[1] * np.linspace(0, 1, 19) ** 1.1, coarse)
    np.testing.assert_allclose(path.x[:, -1], path.x[:, 0], rtol=0, atol=SAME)
    np.testing.assert_allclose(path.momentum[:, -1], path.momentum[:, 0], rtol=0, atol=1e-10)
    assert path.t[-1] == pytest.approx(period, rel=1e-9)


# the stretch of the steps


def test_derivatives_by_the_stretch_are_those_of_the_whole_path():
    problem, mesh, difference = cg.InitialProblem(pendulum, (0, 2), [0.5], momentum=[1.0]), np.linspace(0, 2, 8), 1e-5
    stepper = Stepper(problem, cg.Galerkin(3), free_duration=True)
    roll = lambda stretch: stepper.roll(np.array([0.5, stretch]), np.array([1.0, 0.0]), np.ones(1), mesh)  # noqa: E731
    states = lambda stretch: np.concatenate((roll(stretch).x, roll(stretch).p))  # noqa: E731
    middle = roll(1.2)
    product = accumulated(stepper.jacobians(mesh, middle.x, middle.p, middle.unknowns))
    by_stretch = (states(1.2 + difference) - states(1.2 - difference)) / (2 * difference)
    np.testing.assert_allclose(product[:, :, 1].T, by_stretch, rtol=0, atol=1e-8)
    np.testing.assert_allclose(middle.p[1], -mesh * (0.5 - np.cos(0.5)), rtol=1e-5)  # -∫ H dt over the stretch
    assert middle.unstretched().mesh[-1] == pytest.approx(2.4, rel=1e-15)
    assert middle.unstretched().slopes.shape == (1, 7, 3)


def test_a_guess_gives_the_duration_too():
    problem = cg.BoundaryProblem(pendulum, (0, 1.0), [0.0], [1.0], energy=0.5)
    path = cg.shoot(problem, METHOD, 8)
    again = cg.shoot(problem, METHOD, 8, guess=path)
    assert again.iterations <= 1
    np.testing.assert_allclose(again.t, path.t, rtol=1e-14)


# what fails


@pytest.mark.parametrize("velocity", [-1.0, -1e-3])
def test_a_duration_is_never_negative(velocity):
    """Backward in time, the free motion to the left would meet the end on the right."""
    problem = cg.BoundaryProblem(free_particle, (0, 1), [0.0], [1.0], energy=0.5)
    with pytest.raises(cg.ConvergenceError, match="shooting failed"):
        cg.shoot(problem, METHOD, 4, guess=launched(problem, [velocity], 4))


@pytest.mark.parametrize("periodic", [False, True])
def test_no_duration_is_no_answer(periodic):
    """In no time a path is back at its start, with every energy."""
    ends = {"periodic": True} if periodic else {"end": [0.2]}
    problem = cg.BoundaryProblem(pendulum, (0, 0.66), [0.2], energy=0.0, **ends)
    with pytest.raises(cg.ConvergenceError, match="the path has shrunk to a point"):
        cg.shoot(problem, METHOD, 12, guess=launched(problem, [1.4]))


@pytest.mark.slow
def test_an_energy_that_does_not_reach_over_the_top_is_named():
    problem = cg.BoundaryProblem(pendulum, (0, 1), [0.0], [6.0], energy=0.5)
    with pytest.raises(cg.ConvergenceError, match=r"the end is missed by .* solve it globally"):
        cg.shoot(problem, METHOD, 8)


def test_a_path_that_turns_back_where_it_began_is_not_periodic():
    problem = cg.BoundaryProblem(pendulum, (0, 6.0), [None], periodic=True, energy=-np.cos(1.0))
    there = cg.InitialProblem(pendulum, (0, 6.0), [0.95], momentum=[-0.29])
    with pytest.raises(cg.ConvergenceError, match="not periodic: it comes back to its start against the way it left"):
        cg.shoot(problem, METHOD, 12, guess=cg.solve(there, METHOD, 12))


def test_half_a_swing_through_a_given_start_is_not_periodic():
    problem = cg.BoundaryProblem(pendulum, (0, 3.7), [0.0], periodic=True, energy=0.0)
    there = cg.InitialProblem(pendulum, (0, 3.7), [0.0], momentum=[1.4])
    with pytest.raises(cg.ConvergenceError, match="not periodic: it comes back to its start against the way it left"):
        cg.shoot(problem, METHOD, 12, guess=cg.solve(there, METHOD, 12))


def test_a_guess_that_rests_tells_no_duration():
    problem = cg.BoundaryProblem(
        free_particle, (0, 1), [0.0, 0.0], [None, None], end_conditions=lambda x0, x1: ca.sumsqr(x1) - 4, energy=0.5
    )
    with pytest.raises(cg.ConjugatePointError, match="or the guess rests at its start: give one that moves"):
        cg.shoot(problem, METHOD, 4)


def test_a_periodic_path_of_given_energy_needs_a_guess_that_moves_at_its_start():
    problem = cg.BoundaryProblem(pendulum, (0, 7.0), [None], periodic=True, energy=-0.5)
    with pytest.raises(ValueError, match="needs a guess that moves at its start, got one that rests there"):
        cg.shoot(problem, METHOD, 8)


@pytest.mark.parametrize("length", [1e-10, *slow(1e8)])
@pytest.mark.parametrize("intervals", [4, 40])
@pytest.mark.slow
def test_a_given_energy_is_met_on_a_circle_of_any_length(length, intervals):
    """The stretch of the steps is near 1, whatever the unit of length; it says nothing of the size of a step."""
    ends = [[0.0, -length], [length * np.sin(0.5), -length * np.cos(0.5)]]
    swing = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 - x[1],
        (0.0, 0.5 * np.sqrt(length)),
        *ends,
        constraint=lambda t, x: ca.dot(x, x) - length**2,
        energy=0.5 * length,
    )
    shot, path = (way(swing, cg.Galerkin(4), intervals) for way in (cg.shoot, cg.solve))
    assert shot.t[-1] == pytest.approx(path.t[-1], rel=1e-13)
    assert shot.iterations <= 6
