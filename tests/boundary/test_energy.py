"""Paths of given energy: the duration is found, with Kepler's period and orbits that close when integrated."""

import casadi as ca
import numpy as np
import pytest
from constrained import on_circle, planar, unit_length
from motions import henon_heiles, kepler
from scenes import oscillator_problem, pendulum
from scipy.integrate import quad, solve_ivp
from scipy.special import ellipk
from slow import slow

import casadi_galerkin as cg

PERIOD = 1e-12
CLOSED = 1e-11  # when integrated independently
METHOD = cg.Galerkin(10)


def half_orbit(eccentricity, energy=-0.5):
    """Problem and guess of half an orbit from the pericenter to the apocenter, whose distance is free."""
    axis = -1 / (2 * energy)
    half = np.pi * axis**1.5
    guess = 0.9 * half  # of the duration
    problem = cg.BoundaryProblem(kepler, (0, guess), [axis * (1 - eccentricity), 0.0], [None, 0.0], energy=energy)
    turning = lambda t: np.array([np.cos(np.pi * t / guess) - eccentricity, np.sin(np.pi * t / guess)]) * axis  # noqa: E731
    return problem, lambda t: turning(t) * [1, np.sqrt(1 - eccentricity**2)]


@pytest.mark.parametrize("eccentricity", [0.5, *slow(0.9)])
def test_an_orbit_of_given_energy_has_keplers_period(eccentricity):
    problem, guess = half_orbit(eccentricity)
    path = cg.solve(problem, tol=1e-12, guess=guess)
    assert path.t[-1] == pytest.approx(np.pi, rel=PERIOD)
    assert path.x[0, -1] == pytest.approx(-1 - eccentricity, rel=PERIOD)
    np.testing.assert_allclose(path.energy, -0.5, rtol=1e-11)


@pytest.mark.parametrize("energy", [-5.0, *slow(-0.02)])
def test_the_period_is_that_of_the_energy_alone(energy):
    """T = 2π (-2E)^(-3/2); the action of a whole orbit is 3π (-2E)^(-1/2), as ∫ p·v dt = S + E T = 2π (-2E)^(-1/2)."""
    problem, guess = half_orbit(0.3, energy)
    path = cg.solve(problem, METHOD, intervals=16, guess=guess)
    assert 2 * path.t[-1] == pytest.approx(2 * np.pi * (-2 * energy) ** -1.5, rel=PERIOD)
    assert 2 * path.action == pytest.approx(3 * np.pi * (-2 * energy) ** -0.5, rel=PERIOD)


def test_a_given_energy_that_cancels_a_rest_energy_determines_the_duration_up_to_the_rounding_of_both():
    rest = 1e10  # half an energy unit more or less is exact beside it, the energies along a path are not
    lagrangian = lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2 + rest  # noqa: E731
    problem = cg.BoundaryProblem(lagrangian, (0, 0.6), [0.0], [0.5], energy=0.5 - rest)  # of sin(t)
    path = cg.solve(problem, tol=1e-5)
    assert abs(path.t[-1] / (np.pi / 6) - 1) < 5 * path.error_estimate < 1e-4
    with pytest.raises(cg.LimitReached, match="roundoff floor"):
        cg.solve(problem, tol=1e-8)


def test_one_transcription_solves_for_many_energies():
    problem, guess = half_orbit(0.3)
    transcription = cg.transcribe(problem, METHOD, 16)
    for energy in (-0.5, -0.45, -0.55):
        path = transcription.solve(energy=energy, guess=guess)
        assert path.t[-1] == pytest.approx(np.pi * (-2 * energy) ** -1.5, rel=PERIOD)
        assert path.problem.energy == energy


def test_the_times_of_the_answer_are_those_of_its_problem():
    problem, guess = half_orbit(0.3)
    path = cg.solve(problem, METHOD, intervals=16, guess=guess)
    assert path.problem.t_span == (path.t[0], path.t[-1])
    again = cg.solve(path.problem, METHOD, mesh=path.t, guess=path)
    np.testing.assert_allclose(again.t, path.t, rtol=0, atol=1e-14)


@pytest.mark.parametrize("amplitude", [1.0, *slow(3.0)])
def test_a_periodic_pendulum_of_given_energy_has_the_period_of_its_elliptic_integral(amplitude):
    problem = cg.BoundaryProblem(pendulum, (0, 7.0), [None], periodic=True, energy=-np.cos(amplitude))
    path = cg.solve(problem, tol=1e-12, guess=lambda t: [amplitude * np.sin(2 * np.pi * t / 7)])
    assert path.t[-1] == pytest.approx(4 * ellipk(np.sin(amplitude / 2) ** 2), rel=PERIOD)


def test_an_oscillator_whose_period_is_that_of_every_energy_has_the_amplitude_of_its_own():
    """At a given duration its matrix is singular, so that the duration cannot be eliminated first."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 6.0), [None], periodic=True, energy=0.5
    )
    path = cg.solve(problem, METHOD, intervals=8, guess=lambda t: [0.9 * np.sin(np.pi * t / 3)])
    assert path.t[-1] == pytest.approx(2 * np.pi, rel=PERIOD)
    np.testing.assert_allclose(path.x[0] ** 2 + path.momentum[0] ** 2, 1, rtol=0, atol=PERIOD)


def test_a_periodic_pendulum_in_the_plane_has_the_period_of_its_elliptic_integral():
    problem = cg.BoundaryProblem(
        planar, (0, 6.5), [None, None], periodic=True, constraint=unit_length, energy=-np.cos(1.0)
    )
    path = cg.solve(problem, METHOD, intervals=12, guess=lambda t: on_circle(np.sin(2 * np.pi * t / 6.5)))
    assert path.t[-1] == pytest.approx(4 * ellipk(np.sin(0.5) ** 2), rel=PERIOD)


@pytest.mark.slow
def test_many_intervals_of_a_constrained_path_of_given_energy_are_solved():
    """The row of the duration is full: QR of all rows would have full factors, and take minutes."""
    problem = cg.BoundaryProblem(planar, (0, 1), on_circle(0.2), on_circle(1.3), constraint=unit_length, energy=0.4)
    path = cg.solve(problem, cg.Galerkin(4), intervals=400, guess=lambda t: on_circle(0.2 + 1.1 * t))
    time = quad(lambda a: 1 / np.sqrt(2 * (0.4 + np.cos(a))), 0.2, 1.3, epsabs=1e-14)[0]
    assert path.t[-1] == pytest.approx(time, rel=PERIOD)


def test_the_phase_of_a_periodic_path_is_that_of_its_guess():
    problem = cg.BoundaryProblem(pendulum, (0, 7.0), [None], periodic=True, energy=-np.cos(1.0))
    paths = [
        cg.solve(problem, METHOD, intervals=12, guess=lambda t, phase=phase: [np.sin(2 * np.pi * t / 7 + phase)])
        for phase in (0.3, 1.1)
    ]
    for path, phase in zip(paths, (0.3, 1.1), strict=True):
        assert path.x[0, 0] == pytest.approx(np.sin(phase), rel=1e-12)  # on the plane across its velocity
    assert paths[0].t[-1] == pytest.approx(paths[1].t[-1], rel=PERIOD)
    assert paths[0].action == pytest.approx(paths[1].action, rel=1e-11)


def test_the_time_of_flight_of_given_energy_is_an_integral():
    """Over the hill of cos x from -2 to 2 with energy 1.1: dt = dx/√(2 (E - V)), V = cos x."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - ca.cos(x[0]), (0, 3.0), start=[-2.0], end=[2.0], energy=1.1
    )
    path = cg.solve(problem, tol=1e-12)
    time = quad(lambda x: 1 / np.sqrt(2 * (1.1 - np.cos(x))), -2, 2, epsabs=1e-13, epsrel=1e-13)[0]
    assert path.t[-1] == pytest.approx(time, rel=PERIOD)


@pytest.mark.parametrize("began", [1e6, *slow(1e9)])
def test_the_clock_of_a_path_of_given_energy_may_have_begun_long_ago(began):
    def problem(start):
        return cg.BoundaryProblem(kepler, (start, start + 1.5), [1.0, 0.0], [-0.2, 0.9], energy=-0.5)

    path, later = (cg.solve(problem(start), METHOD, intervals=8) for start in (0.0, began))
    assert later.t[-1] == pytest.approx(began + path.t[-1], rel=1e-15)
    assert later.action == pytest.approx(path.action, rel=1e-13)
    assert later.iterations <= path.iterations + 1


@pytest.mark.parametrize("high", [False, True], ids=["low", "high"])
def test_a_projectile_of_given_energy_hits_by_the_low_and_by_the_high_arc(high):
    """Speed 10 over 6 m: sin 2α = g d/v², T = 2 v sin α/g."""
    g, speed, distance = 9.81, 10.0, 6.0
    angle = np.arcsin(g * distance / speed**2) / 2
    angle, duration, top = (np.pi / 2 - angle, 2.0, 5.0) if high else (angle, 0.6, 0.5)
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2 - g * x[1], (0, duration), [0.0, 0.0], [distance, 0.0], energy=speed**2 / 2
    )
    arc = lambda t: [distance * t / duration, 4 * top * t / duration * (1 - t / duration)]  # noqa: E731
    path = cg.solve(problem, cg.Galerkin(2), intervals=2, guess=arc)
    assert path.t[-1] == pytest.approx(2 * speed * np.sin(angle) / g, rel=PERIOD)


# orbits that close


def returned(path, accelerate):
    """Where the first state of a path leads in its duration, and that state."""
    d, start = len(path.x), np.concatenate((path.x[:, 0], path.velocity[:, 0]))
    rate = lambda t, y: np.concatenate((y[d:], accelerate(y[:d], y[d:])))  # noqa: E731
    flow = solve_ivp(rate, (path.t[0], path.t[-1]), start, "DOP853", rtol=1e-13, atol=1e-14)
    return flow.y[:, -1], start


@pytest.mark.parametrize(
    "guess",
    [
        lambda t: [0.35 * np.cos(t), 0.35 * np.sin(t)],
        lambda t: [0.0, 0.5 * np.sin(t)],
    ],
    ids=["loop", "line"],
)
def test_a_henon_heiles_orbit_of_energy_one_eighth_closes_when_integrated(guess):
    problem = cg.BoundaryProblem(henon_heiles, (0, 6.3), [None, None], periodic=True, energy=1 / 8)
    path = cg.solve(problem, METHOD, intervals=16, guess=guess)
    end, start = returned(path, lambda x, v: np.array([-x[0] - 2 * x[0] * x[1], -x[1] - x[0] ** 2 + x[1] ** 2]))
    np.testing.assert_allclose(end, start, rtol=0, atol=CLOSED)
    np.testing.assert_allclose(path.energy, 1 / 8, rtol=1e-12)


MOON = 0.012150585609624  # of the masses of Earth and Moon
BALANCE = 0.8369151257723568  # place of the libration point between them


def circular_restricted(t, x, v):
    earth, moon = x - ca.DM([-MOON, 0]), x - ca.DM([1 - MOON, 0])
    turning = v + ca.vertcat(-x[1], x[0])
    return ca.sumsqr(turning) / 2 + (1 - MOON) / ca.norm_2(earth) + MOON / ca.norm_2(moon)


def pulled(x, v):
    earth, moon = x - [-MOON, 0], x - [1 - MOON, 0]
    gravity = (1 - MOON) * earth / np.hypot(*earth) ** 3 + MOON * moon / np.hypot(*moon) ** 3
    return np.array([2 * v[1] + x[0], -2 * v[0] + x[1]]) - gravity


@pytest.mark.parametrize(("jacobi", "width"), [(3.15, 0.03), *slow((3.1, 0.05))])
def test_half_a_lyapunov_orbit_meets_the_axis_at_right_angles_when_integrated(jacobi, width):
    problem = cg.BoundaryProblem(circular_restricted, (0, 1.35), [None, 0.0], [None, 0.0], energy=-jacobi / 2)
    phase = lambda t: np.pi * t / 1.35  # noqa: E731
    path = cg.solve(
        problem,
        METHOD,
        intervals=12,
        guess=lambda t: [BALANCE - width * np.cos(phase(t)), 3.6 * width * np.sin(phase(t))],
    )
    end, start = returned(path, pulled)
    assert start[2] == pytest.approx(0, abs=CLOSED)
    np.testing.assert_allclose(end, [path.x[0, -1], 0, 0, path.velocity[1, -1]], rtol=0, atol=CLOSED)


def test_a_lyapunov_orbit_found_as_periodic_is_twice_that_found_by_halves():
    guess = lambda t: [BALANCE - 0.03 * np.cos(np.pi * t / 1.35), 0.108 * np.sin(np.pi * t / 1.35)]  # noqa: E731
    half, whole = (
        cg.solve(
            cg.BoundaryProblem(circular_restricted, span, *ends, energy=-1.575, **more), METHOD, count, guess=guess
        )
        for span, ends, more, count in (
            ((0, 1.35), ([None, 0.0], [None, 0.0]), {}, 12),
            ((0, 2.7), ([None, None],), {"periodic": True}, 24),
        )
    )
    assert whole.t[-1] == pytest.approx(2 * half.t[-1], rel=PERIOD)
    assert whole.action == pytest.approx(2 * half.action, rel=PERIOD)


# with constraints and end conditions, to tolerances, by other solvers


def test_a_pendulum_in_the_plane_of_given_energy_has_the_duration_of_that_in_its_angle():
    angle = cg.solve(cg.BoundaryProblem(pendulum, (0, 1), [0.2], [1.3], energy=0.4), METHOD, intervals=8)
    problem = cg.BoundaryProblem(planar, (0, 1), on_circle(0.2), on_circle(1.3), constraint=unit_length, energy=0.4)
    path = cg.solve(problem, METHOD, intervals=8, guess=lambda t: on_circle(0.2 + 1.1 * t))
    assert path.t[-1] == pytest.approx(angle.t[-1], rel=PERIOD)
    np.testing.assert_allclose(path.x, on_circle(angle.x[0]), rtol=0, atol=CLOSED)


def test_an_orbit_of_given_energy_to_a_circle_is_radial_in_its_least_time():
    """From a point on the way out: across the circle where the path may end anywhere on it."""
    problem = cg.BoundaryProblem(
        kepler, (0, 1.0), [1.0, 0.0], [None, None], energy=-0.25, end_conditions=lambda x0, x1: ca.sumsqr(x1) - 4
    )
    path = cg.solve(problem, METHOD, intervals=8, guess=lambda t: [1 + t, 0.0])
    time = quad(lambda r: 1 / np.sqrt(2 / r - 0.5), 1, 2, epsabs=1e-13)[0]
    assert path.t[-1] == pytest.approx(time, rel=PERIOD)
    np.testing.assert_allclose(path.x[1], 0, rtol=0, atol=1e-15)


@pytest.mark.parametrize("tol", [1e-4, *slow(1e-10)])
def test_a_path_of_given_energy_found_to_a_tolerance_meets_it(tol):
    problem, guess = half_orbit(0.6)
    path = cg.solve(problem, tol=tol, guess=guess)
    assert path.error_estimate <= tol
    assert abs(path.t[-1] - np.pi) <= 10 * tol
    anomaly = np.linspace(0, np.pi, 200)
    times = np.minimum(anomaly - 0.6 * np.sin(anomaly), path.t[-1])
    exact = np.array([np.cos(anomaly) - 0.6, 0.8 * np.sin(anomaly)])
    assert np.max(np.abs(path(times) - exact)) <= 10 * tol  # times are off by that of the path over its speed


def test_ipopt_agrees_on_a_path_of_given_energy():
    problem, guess = half_orbit(0.5)
    newton, other = (cg.solve(problem, METHOD, 12, guess=guess, solver=each) for each in (cg.newton, cg.ipopt))
    np.testing.assert_allclose(other.x, newton.x, rtol=0, atol=1e-13)
    assert other.t[-1] == pytest.approx(newton.t[-1], rel=1e-13)


def test_the_rootfinder_agrees_from_nearby_on_a_path_of_given_energy():
    problem, guess = half_orbit(0.1)
    newton = cg.solve(problem, METHOD, 12, guess=guess)
    other = cg.solve(problem, METHOD, 12, guess=newton, solver=cg.rootfinder)
    np.testing.assert_allclose(other.x, newton.x, rtol=0, atol=1e-13)


def test_the_minimizer_refuses_a_given_energy():
    problem, guess = half_orbit(0.5)
    with pytest.raises(ValueError, match=r"a given energy, .* do not allow: take newton or ipopt"):
        cg.solve(problem, METHOD, 12, guess=guess, solver=cg.minimizer)


@pytest.mark.parametrize("guess", [None, lambda t: [np.cos(2 * np.pi * t / 7)]], ids=["none", "from a turning point"])
def test_a_periodic_path_of_given_energy_needs_a_guess_that_moves_at_its_start(guess):
    problem = cg.BoundaryProblem(pendulum, (0, 7.0), [None], periodic=True, energy=-0.5)
    with pytest.raises(ValueError, match="needs a guess that moves at its start, got one that rests there"):
        cg.solve(problem, METHOD, intervals=4, guess=guess)


@pytest.mark.parametrize("phase", [1.73, *slow(4.56)])
@pytest.mark.parametrize("way", [{"method": METHOD, "intervals": 12}, {"tol": 1e-8}], ids=["mesh", "tolerance"])
def test_a_path_that_turns_back_where_it_began_is_not_periodic(phase, way):
    """Near a turning point another path of the same energy goes through the start twice, there and back."""
    problem = cg.BoundaryProblem(pendulum, (0, 6.0), [None], periodic=True, energy=-np.cos(1.0))
    with pytest.raises(cg.ConvergenceError, match="not periodic: it comes back to its start against the way it left"):
        cg.solve(problem, guess=lambda t: [0.95 * np.sin(np.pi * t / 3 + phase)], **way)


def level():
    """A swing up to 90° on either side, which begins below."""
    return cg.BoundaryProblem(pendulum, (0, 7.0), [0.0], periodic=True, energy=0.0)


@pytest.mark.parametrize("way", [{"method": METHOD, "intervals": 12}, {"tol": 1e-8}], ids=["mesh", "tolerance"])
def test_half_a_swing_through_a_given_start_is_not_periodic(way):
    with pytest.raises(cg.ConvergenceError, match="not periodic: it comes back to its start against the way it left"):
        cg.solve(level(), guess=lambda t: [1.5 * np.sin(np.pi * t / 7)], **way)
    whole = cg.solve(level(), guess=lambda t: [1.5 * np.sin(2 * np.pi * t / 7)], **way)
    assert whole.t[-1] == pytest.approx(4 * ellipk(0.5), rel=1e-8)


@pytest.mark.slow
def test_a_search_through_a_given_start_finds_whole_swings():
    found = cg.paths(level(), cg.Galerkin(8), 12, count=2)
    for path in found:
        swings = path.t[-1] / (4 * ellipk(0.5))
        assert swings == pytest.approx(round(swings), abs=1e-6)
        np.testing.assert_allclose(path.momentum[:, 0], path.momentum[:, -1], rtol=1e-8)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"energy": np.nan}, "energy must be a finite number, got nan"),
        ({"energy": "1"}, "energy must be a finite number, got '1'"),
        ({"energy": True}, "energy must be a finite number, got True"),
        (
            {"lagrangian": lambda t, x, v: v[0] ** 2 / 2 - t * x[0]},
            "needs a lagrangian and a constraint that do not dep",
        ),
        ({"force": lambda t, x, v: -v}, "a force changes the energy: give force or energy, got both"),
        ({"breakpoints": [0.5]}, r"frees the duration, so that breakpoints have no place, got \(0.5,\)"),
    ],
)
def test_an_energy_that_does_not_fit_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        oscillator_problem(**({"energy": 1.0} | changes))


def test_an_energy_beside_a_constraint_that_moves_is_refused():
    with pytest.raises(ValueError, match="needs a lagrangian and a constraint that do not depend on t"):
        cg.BoundaryProblem(
            planar, (0, 1), [None, None], [None, None], constraint=lambda t, x: ca.norm_2(x) - 1 - t, energy=1.0
        )


@pytest.mark.parametrize("duration", [0.01, *slow(50.0)])
def test_a_duration_of_given_energy_stays_positive_whatever_its_guess(duration):
    """Time of flight of a pendulum, ∫ dx / sqrt(2 (E + cos x))."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), (0.0, duration), [0.0], [1.0], energy=0.5
    )
    flight = quad(lambda x: 1 / np.sqrt(2 * (0.5 + np.cos(x))), 0.0, 1.0, epsabs=1e-14)[0]
    assert cg.solve(problem, tol=1e-10).t[-1] == pytest.approx(flight, rel=1e-10)


@pytest.mark.slow
def test_a_duration_that_times_far_from_zero_cannot_hold_is_at_its_roundoff_floor():
    """Times near 1e9 are rounded by 1e-7: so is the last one, and with it the duration."""
    began = 1e9
    orbit = cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2 + 1 / ca.norm_2(x), (began, began + 1.5), [1.0, 0.0], [0.0, 1.0], energy=-0.5
    )
    with pytest.raises(cg.LimitReached, match=r"1e-10 asked, .* is the roundoff floor"):
        cg.solve(orbit, tol=1e-10)
    path = cg.solve(orbit, tol=1e-6)
    assert path.t[-1] - began == pytest.approx(np.pi / 2, rel=1e-6)


def test_a_periodic_path_of_given_period_that_may_begin_anywhere_is_told_how_to_fix_its_phase():
    problem = cg.BoundaryProblem(pendulum, (0, 7.0), [None], periodic=True)
    with pytest.raises(cg.ConjugatePointError, match=r"begin anywhere .* give its energy instead of its period"):
        cg.solve(problem, tol=1e-8, guess=lambda t: [1.2 * np.cos(2 * np.pi * t / 7.0)])
