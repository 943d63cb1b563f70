"""First paths from guesses with corners and noise: the path that was meant, and by which way it was found."""

from functools import partial

import casadi as ca
import numpy as np
import pytest
from motions import kepler, on_ellipse
from scipy.integrate import solve_ivp
from slow import slow

import casadi_galerkin as cg

TOL = 1e-6


def great_circle():
    """New York to London on a sphere, in latitude and longitude."""
    return cg.BoundaryProblem(
        lambda t, x, v: (v[0] ** 2 + ca.cos(x[0]) ** 2 * v[1] ** 2) / 2,
        (0, 1),
        [0.70933, -1.28762],
        [0.89832, -0.00793],
    )


def comet(eccentricity):
    """A path around the sun, from a quarter of a period before the perihelion to one after it; and that path."""
    exact, quarter = partial(on_ellipse, eccentricity), np.pi / 2
    return cg.BoundaryProblem(kepler, (-quarter, quarter), exact(-quarter), exact(quarter)), exact


def joined(exact, span, count, noise=0.0, seed=0):
    """A path at some times, with noise of its size, joined by lines."""
    times = np.linspace(*span, count)
    values = exact(times)
    values += noise * np.max(np.abs(values), axis=1)[:, None] * np.random.default_rng(seed).normal(size=values.shape)
    return times, values


def off(path, exact):
    times = np.linspace(*path.problem.t_span, 101)
    return np.max(np.abs(path(times) - exact(times))) / np.max(np.abs(exact(times)))


@pytest.mark.parametrize("seed", [1, *slow(3)])
@pytest.mark.slow
def test_noise_does_not_hide_a_great_circle(seed):
    problem = great_circle()
    exact = cg.solve(problem, tol=1e-9)
    path = cg.solve(problem, tol=TOL, guess=joined(exact, problem.t_span, 25, 0.05, seed))
    assert off(path, exact) < 10 * TOL


@pytest.mark.parametrize(
    ("potential", "duration", "start", "end"),
    [
        (lambda x: x**4 / 4 - x**2 / 2, 2.0, 0.0, 2.0),
        *slow(
            (lambda x: x**4 / 4, 4.0, 0.0, 2.0),
            (lambda x: x**4 / 4, 10.0, 1.0, -2.0),
            (lambda x: x**2 / 2 + x**4 / 4, 8.0, -1.5, 0.5),
        ),
    ],
)
@pytest.mark.slow
def test_a_stiffening_spring_swings_between_its_ends(potential, duration, start, end):
    """Newton's method and IPOPT fail from the straight line; the load that holds it leads to a swing."""
    spring = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - potential(x[0]), (0, duration), [start], [end])
    path = cg.solve(spring, tol=1e-8)
    assert "the load of the guess taken away" in path.solver
    x = ca.SX.sym("x")
    force = ca.Function("force", [x], [-ca.gradient(potential(x), x)])
    state = [start, path.velocity[0, 0]]
    swing = solve_ivp(lambda t, y: [y[1], float(force(y[0]))], (0, duration), state, rtol=1e-11, atol=1e-12)
    assert abs(swing.y[0, -1] - end) < 1e-6


def test_a_guess_is_put_on_the_first_mesh_once():
    calls = []

    def guess(t):
        calls.append(t)
        return np.array([t, t**2])

    fall = cg.BoundaryProblem(lambda t, x, v: ca.dot(v, v) / 2 + x[1], (0, 1), [0.0, 0.0], [1.0, 1.0])
    path = cg.solve(fall, tol=TOL, guess=guess)
    assert path.solver == "Newton"
    assert len(set(calls)) == len(calls)


@pytest.mark.slow
@pytest.mark.parametrize(("strength", "speed", "height"), [(101.28, 147.92, 0.878), (147.5, 193.48, 1.142)])
def test_many_swings_are_found_on_a_finer_mesh_than_the_first(strength, speed, height):
    """A driven double well that swings 25 to 30 times, of which eight intervals see nothing."""

    def lagrangian(t, x, v):
        q = height * ca.sin(speed * t) + t
        drive = -(speed**2) * height * ca.sin(speed * t) + strength * (q**3 - q)
        return v[0] ** 2 / 2 - strength * (x[0] ** 4 / 4 - x[0] ** 2 / 2) + drive * x[0]

    path = cg.solve(cg.BoundaryProblem(lagrangian, (0.0, 1.0), [0.0], [height * np.sin(speed) + 1]), tol=1e-6)
    assert path.error_estimate <= 1e-6


def test_a_guess_that_turns_sharply_is_resolved_by_the_first_mesh():
    """On the coarse one alone the path on the other side was found."""
    problem, exact = comet(0.97)
    path = cg.solve(problem, tol=1e-3, guess=exact)
    assert off(path, exact) < 1e-2


def pendulums(count):
    """A row of pendulums, each joined to the next by a spring, that hang at first and swing to places in a line."""

    def lagrangian(t, x, v):
        stretched = ca.diff(x)
        return ca.dot(v, v) / 2 + ca.sum1(ca.cos(x)) - ca.dot(stretched, stretched) / 2

    return cg.BoundaryProblem(lagrangian, (0.0, 3.0), [0.0] * count, np.linspace(0.2, 1.0, count).tolist())


@pytest.mark.slow
@pytest.mark.parametrize("count", [12, 20])
def test_a_row_of_pendulums_swings_from_the_straight_line(count):
    """Conjugate points lie between the ends: the action has no minimum that a descent could find."""
    path = cg.solve(pendulums(count), tol=TOL)
    assert "descent" not in path.solver
    assert path.morse_index >= count // 2

    def rates(t, y):
        x, v = np.split(y, 2)
        pulled = np.diff(x, prepend=x[0], append=x[-1])
        return np.concatenate((v, np.diff(pulled) - np.sin(x)))

    swing = solve_ivp(rates, (0, 3), np.concatenate((path.x[:, 0], path.momentum[:, 0])), rtol=1e-11, atol=1e-11)
    assert np.max(np.abs(swing.y[:count, -1] - path.x[:, -1])) < 1e-4


@pytest.mark.slow
def test_a_layer_is_found_from_the_straight_line():
    troesch = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cosh(50 * x[0]), (0, 1), [0.0], [1.0])
    path = cg.solve(troesch, tol=TOL)
    energy = path.momentum[0] ** 2 / 2 - np.cosh(50 * path.x[0])
    np.testing.assert_allclose(energy, energy[0], rtol=0, atol=TOL * np.cosh(50))


@pytest.mark.slow
def test_a_layer_thinner_than_doubles_tell_is_no_bad_mesh(capsys):
    """After all other ways the last one is tried, too."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cosh(5 * x[0]), (0, 1), [0.0], [18.0])
    with pytest.raises(cg.ConvergenceError, match="no path was found"):
        cg.solve(problem, tol=TOL, verbose=1)
    assert "random guesses: no path" in capsys.readouterr().out


@pytest.mark.slow
def test_values_at_the_first_joints_are_a_guess_on_any_mesh():
    """On so few intervals Newton's method finds nothing, and a finer mesh is tried; the next time the first is fine."""
    bead = cg.BoundaryProblem(lambda t, x, v: ca.sqrt((1 + v[0] ** 2) / x[0]), (0, 1), [1e-2], [1.0])
    line = np.linspace(1e-2, 1, 7)[None]
    expected = cg.solve(bead, tol=TOL, intervals=6, guess=([0, 1], [[1e-2, 1]]))
    assert "first path by" in expected.solver
    transcription = cg.transcribe(bead, tol=TOL, intervals=6)
    for path in (cg.solve(bead, tol=TOL, intervals=6, guess=line), *(transcription.solve(guess=line) for _ in "ab")):
        assert path.action == pytest.approx(expected.action, rel=TOL)


def solved_after_a_shorter_time(problem):
    """The path from graphs that were built for another time span, and so for another mesh."""
    first, last = problem.t_span
    transcription = cg.transcribe(problem.varied({}, (first, (first + last) / 2)), tol=1e-8)
    transcription.solve()
    return transcription.solve(t_span=problem.t_span)


@pytest.mark.slow
@pytest.mark.parametrize("solved", [partial(cg.solve, tol=1e-8), solved_after_a_shorter_time])
def test_random_guesses_lead_to_a_path_beyond_the_fold_of_the_straight_line(solved):
    """From T = 1.7 on, the quartic oscillator in the plane has no path of index 0 or 1 between these ends."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 - ca.sumsqr(x) ** 2 / 4, (0.0, 2.0), [1.0, 0.3], [-0.2, 0.8]
    )
    path = solved(problem)
    assert path.t[[0, -1]].tolist() == [0.0, 2.0]
    state = np.concatenate((path.x[:, 0], path.velocity[:, 0]))
    flown = solve_ivp(
        lambda t, y: np.concatenate((y[2:], -(y[:2] @ y[:2]) * y[:2])), (0, 2), state, rtol=1e-11, atol=1e-12
    )
    np.testing.assert_allclose(flown.y[:2, -1], problem.end, rtol=0, atol=1e-5)


def forced(stiffness, start, end, force):
    """Where stiffness times x'' is a force."""
    return cg.BoundaryProblem(lambda t, x, v: stiffness * v[0] ** 2 / 2, (0.0, 1.0), [start], [end], force=force)


@pytest.mark.parametrize(("stiffness", "tol"), [(1e-3, 1e-9), *slow((1e-6, 1e-3))])
@pytest.mark.slow
def test_a_corner_layer_is_found_under_a_growing_force(stiffness, tol):
    """Cash's test problem 20: from a straight line to a corner at 0.745, which a straight line does not tell of."""

    def exact(t):
        far = np.abs(t - 0.745) / stiffness
        return 1 + stiffness * (far + np.log1p(np.exp(-2 * far)) - np.log(2))

    path = cg.solve(forced(stiffness, exact(0.0), exact(1.0), lambda t, x, v: 1 - v**2), tol=tol)
    assert path.solver == "Newton; first path by Newton's method under a growing force"
    times = np.union1d(np.linspace(0, 1, 101), path.t)
    assert np.max(np.abs(path(times)[0] - exact(times))) <= tol * np.max(exact(times))


@pytest.mark.slow
@pytest.mark.parametrize("parameters", [None, [1.0]])
def test_a_shock_is_found_under_a_growing_force(parameters):
    """Cash's test problem 30: between its ends, where x' = 1 or x = 0, it jumps from -5/6 to 5/6 at t = 1/3."""
    problem = cg.BoundaryProblem(
        lambda t, x, v, *p: 1e-6 * v[0] ** 2 / 2, (0.0, 1.0), [-7 / 6], [1.5],
        parameters=parameters, force=lambda t, x, v, *p: x - x * v if p == () else p[0][0] * (x - x * v),
    )  # fmt: skip
    path = cg.solve(problem, tol=1e-6)
    outer = np.array([0.1, 0.3, 0.5, 0.9])
    np.testing.assert_allclose(path(outer)[0], outer + np.where(outer < 1 / 3, -7 / 6, 0.5), rtol=0, atol=1e-4)


@pytest.mark.slow
def test_a_force_that_leaves_no_path_is_refused():
    """Bratu's problem beyond its fold; the time may be up on the way to it."""
    problem = forced(1.0, 0.0, 0.0, lambda t, x, v: -4 * ca.exp(x))
    with pytest.raises(cg.ConvergenceError, match=r"^no path was found"):
        cg.solve(problem, tol=TOL)
    with pytest.raises(cg.LimitReached, match="seconds have passed before there was a path"):
        cg.solve(problem, tol=TOL, limits=cg.Limits(seconds=0.01))


@pytest.mark.parametrize("tol", [1e-6, *slow(1e-11)])
@pytest.mark.slow
def test_a_front_that_nothing_holds_ends_no_search(tol):
    """Newton's method finds fronts in the middle, where the second variation vanishes; the path's is at its end."""
    stiffness, potential = 1e-4, lambda x: x**2 / 2 - x**4 / 4
    well = cg.BoundaryProblem(lambda t, x, v: stiffness * v[0] ** 2 / 2 - potential(x[0]), (0, 1), [1.0], [-0.5])
    path = cg.solve(well, tol=tol)
    assert path.error_estimate <= tol
    front = np.sqrt(2 * stiffness) * 0.5625  # ∫ (1 - x²)/2 dx from -1/2 to 1
    assert path.action == pytest.approx(-0.25 + front, abs=1e-8 + 0.1 * tol)


@pytest.mark.slow
def test_paths_of_a_family_are_refused():
    """ε x'' = t x', whose middle only exp(-1/2ε) ties to the ends."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: 3e-3 * v[0] ** 2 / 2, (-1.0, 1.0), [0.0], [1.0], force=lambda t, x, v: t * v
    )
    with pytest.raises(cg.ConjugatePointError):
        cg.solve(problem, tol=1e-6)


@pytest.mark.slow
def test_ends_that_are_nearly_conjugate_are_named():
    """After 500 half-turns of an oscillator: the mesh leaves out little, but cannot tell how far it swings."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0.0, 500 * np.pi), [0.0], [np.sin(500 * np.pi)]
    )
    with pytest.raises(cg.ConvergenceError, match="nearly conjugate"):
        cg.solve(problem, tol=1e-3)


@pytest.mark.slow
def test_a_guess_that_is_a_path_is_kept_where_a_coarse_mesh_would_lose_it():
    """A comet passes the sun twice; from lines between 2,000 of its places Newton's method led to another path."""
    start = cg.InitialProblem(kepler, (0.0, 7.0), [1.0, 0.0], velocity=[0.0, 0.55])
    known = cg.solve(start, cg.Galerkin(6), intervals=2000)
    problem = cg.BoundaryProblem(kepler, (0.0, 7.0), [1.0, 0.0], known.x[:, -1])
    path = cg.solve(problem, tol=TOL, guess=(known.t, known.x))
    np.testing.assert_allclose(path(known.t), known.x, rtol=0, atol=1e-4)


def double_pendulum(t, x, v):
    kinetic = v[0] ** 2 + v[1] ** 2 / 2 + v[0] * v[1] * ca.cos(x[0] - x[1])
    return kinetic + 9.81 * (2 * ca.cos(x[0]) + ca.cos(x[1]))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_straight_line_as_guess_costs_no_more_than_no_guess(seed):
    """It is the same guess, and a path that is found is kept, however far from the guess it is."""
    start, end = np.random.default_rng(seed).uniform(-2, 2, (2, 2))
    problem = cg.BoundaryProblem(double_pendulum, (0, 2), start, end)
    path, same = (cg.solve(problem, tol=TOL, guess=guess) for guess in (None, ([0, 2], np.transpose([start, end]))))
    assert same.iterations <= 1.5 * path.iterations
    assert off(same, path) < 10 * TOL


def test_a_path_far_from_the_guess_is_reported_as_such():
    start, end = np.random.default_rng(3).uniform(-2, 2, (2, 2))
    problem = cg.BoundaryProblem(double_pendulum, (0, 2), start, end)
    path = cg.solve(problem, tol=TOL, guess=([0, 2], np.transpose([start, end])))
    assert "of the guess's size away from the guess" in path.solver
