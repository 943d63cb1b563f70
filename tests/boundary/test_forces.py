"""Forces along a path between two ends: closed forms, the potential that a force is the gradient of, refinement."""

import casadi as ca
import numpy as np
import pytest
from scenes import oscillator_problem, pendulum
from scipy.integrate import solve_ivp
from slow import slow

import casadi_galerkin as cg

CLOSED_FORM = 1e-13  # of values of size 1
SAME = 1e-13  # two ways of solving the same equations
DIGITS = 1e-11  # reference numbers are given to twelve decimals, of sizes up to 35
METHOD = cg.Galerkin(10)


def friction(t, x, v):
    return -v / 2


def falling(t, x, v):
    return ca.sumsqr(v) / 2 - 9.81 * x[1]


def drag(t, x, v):
    return -0.01 * ca.norm_2(v) * v


def projectile(**changes):
    stated = {"t_span": (0.0, 4.0), "start": [0.0, 0.0], "end": [60.0, 0.0], "force": drag} | changes
    return cg.BoundaryProblem(falling, **stated)


@pytest.mark.parametrize("rule", [cg.gauss(10), cg.gauss(11), cg.lobatto(11), cg.radau(10)], ids=str)
def test_a_damped_oscillator_between_two_positions_has_its_closed_form(rule):
    """x'' + x'/2 + 4 x = 0: e^(-t/4) times an oscillation of frequency √(4 - 1/16)."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - 2 * x[0] ** 2, (0, 2), start=[1.0], end=[0.5], force=friction
    )
    path, w = cg.solve(problem, cg.Galerkin(10, quadrature=rule), intervals=8), np.sqrt(4 - 1 / 16)
    sine = (0.5 * np.exp(0.5) - np.cos(2 * w)) / np.sin(2 * w)
    t = np.linspace(0, 2, 101)
    exact = np.exp(-t / 4) * (np.cos(w * t) + sine * np.sin(w * t))
    np.testing.assert_allclose(path(t)[0], exact, rtol=0, atol=CLOSED_FORM)
    assert path(1.0)[0] == pytest.approx(-1.767917533169265, abs=CLOSED_FORM)


def test_a_projectile_with_quadratic_drag_has_its_computed_velocities():
    path = cg.solve(projectile(), METHOD, intervals=8)
    np.testing.assert_allclose(path.velocity[:, 0], [21.997650341247, 23.207649053857], rtol=0, atol=DIGITS)
    np.testing.assert_allclose(path(2.0), [34.993271683199, 19.693554134516], rtol=0, atol=DIGITS)
    np.testing.assert_allclose(path.velocity[:, 4], [14.533117872692, -1.190493484620], rtol=0, atol=DIGITS)


def test_a_projectile_in_space_stays_in_its_plane_exactly():
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2 - 9.81 * x[2], (0.0, 4.0), [0.0, 0.0, 0.0], [60.0, 0.0, 0.0], force=drag
    )
    path, planar = cg.solve(problem, METHOD, intervals=8), cg.solve(projectile(), METHOD, intervals=8)
    assert not np.any(path.x[1])
    np.testing.assert_allclose(path.x[::2], planar.x, rtol=0, atol=60 * SAME)


def test_the_velocity_found_for_a_projectile_hits_the_target_when_integrated():
    path = cg.solve(projectile(), METHOD, intervals=8)

    def rate(t, y):
        speed = np.hypot(*y[2:])
        return [*y[2:], -0.01 * speed * y[2], -9.81 - 0.01 * speed * y[3]]

    start = [0, 0, *path.velocity[:, 0]]
    end = solve_ivp(rate, (0, 4), start, "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(end, [60, 0, *path.velocity[:, -1]], rtol=0, atol=1e-11)


@pytest.mark.parametrize("degree", [2, *slow(5)])
@pytest.mark.parametrize("rule", [cg.gauss, lambda m: cg.gauss(m + 1), lambda m: cg.lobatto(m + 1), cg.radau])
def test_a_force_that_is_a_gradient_gives_the_path_of_its_potential(degree, rule):
    method = cg.Galerkin(degree, quadrature=rule(degree))
    bound = cg.solve(cg.BoundaryProblem(pendulum, (0, 3), [0.2], [1.0]), method, intervals=12)
    free = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 3), [0.2], [1.0], force=lambda t, x, v: -ca.sin(x[0]))
    path = cg.solve(free, method, intervals=12, guess=bound)
    np.testing.assert_allclose(path.polynomial.values, bound.polynomial.values, rtol=0, atol=SAME)
    np.testing.assert_allclose(path.momentum, bound.momentum, rtol=0, atol=SAME)


def test_the_energy_that_a_force_takes_is_its_work():
    path = cg.solve(projectile(), METHOD, intervals=8)
    points, weights = (np.array(a) for a in (cg.gauss(20).points, cg.gauss(20).weights))
    times = path.t[:-1, None] + np.diff(path.t)[:, None] * points
    v = path(times.ravel(), 1)
    power = (-0.01 * np.sum(v**2, axis=0) ** 1.5).reshape(times.shape)
    work = np.diff(path.t) * (power @ weights)
    np.testing.assert_allclose(np.diff(path.energy), work, rtol=1e-10)


def test_a_forced_path_has_no_morse_index():
    assert cg.solve(projectile(), METHOD, intervals=4).morse_index is None


def test_a_force_at_a_free_end_leaves_the_momentum_zero_there():
    path = cg.solve(cg.BoundaryProblem(pendulum, (0, 2), [0.5], [None], force=friction), METHOD, intervals=6)
    assert path.momentum[0, -1] == pytest.approx(0, abs=SAME)


def test_parameters_reach_a_force_and_change():
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * x[0] ** 2 / 2,
        (0, 1),
        [0.0],
        [1.0],
        parameters=[1.0, 0.0],
        force=lambda t, x, v, p: -p[1] * v,
    )
    transcription = cg.transcribe(problem, METHOD, 4)
    for stiffness, damping in ((1.0, 0.0), (5.0, 0.6)):
        path = transcription.solve(parameters=[stiffness, damping])
        w = np.sqrt(stiffness - damping**2 / 4)
        exact = np.exp(damping / 2 * (1 - path.t)) * np.sin(w * path.t) / np.sin(w)
        np.testing.assert_allclose(path.x[0], exact, rtol=0, atol=CLOSED_FORM)


@pytest.mark.parametrize("tol", [1e-7, *slow(1e-10)])
def test_a_forced_path_found_to_a_tolerance_meets_it(tol):
    path, exact = cg.solve(projectile(), tol=tol), cg.solve(projectile(), cg.Galerkin(12), intervals=16)
    times = np.linspace(0, 4, 401)
    sizes = np.max(np.abs(exact(times)), axis=1, keepdims=True)
    assert path.error_estimate <= tol
    assert np.max(np.abs(path(times) - exact(times)) / sizes) <= tol


def test_a_periodic_path_takes_from_its_drive_what_friction_takes_from_it():
    """x'' + c x' + x = cos 2t has the one periodic response -(3 cos 2t - 2 c sin 2t)/(9 + 4 c²)."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2 + x[0] * ca.cos(2 * t),
        (0, np.pi),
        [None],
        periodic=True,
        force=lambda t, x, v: -0.3 * v,
    )
    path, c = cg.solve(problem, METHOD, intervals=6), 0.3
    exact = (-3 * np.cos(2 * path.t) + 2 * c * np.sin(2 * path.t)) / (9 + 4 * c**2)
    np.testing.assert_allclose(path.x[0], exact, rtol=0, atol=CLOSED_FORM)


@pytest.mark.parametrize("tol", [1e-6, *slow(1e-9)])
@pytest.mark.parametrize("n", [1, *slow(3)])
def test_a_force_with_a_pole_that_a_radial_path_cancels_is_no_jump(n, tol):
    """x'' = 1 - n x'/t with x(1) = 0 in a ball: v/t is constant, but rounding of v over a small t is not."""
    ball = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2, (0, 1), [None], [0.0], force=lambda t, x, v: 1 - n * v[0] / t
    )
    path = cg.solve(ball, tol=tol)
    np.testing.assert_allclose(path.x[0], (path.t**2 - 1) / (2 * n + 2), rtol=0, atol=CLOSED_FORM)
    assert len(path.t) < 20


@pytest.mark.parametrize("solver", [cg.rootfinder, cg.ipopt], ids=str)
def test_solvers_agree_on_a_forced_path(solver):
    newton, other = (cg.solve(projectile(), METHOD, intervals=4, solver=each) for each in (cg.newton, solver))
    np.testing.assert_allclose(other.x, newton.x, rtol=0, atol=60 * SAME)


def test_the_minimizer_refuses_a_force():
    with pytest.raises(
        ValueError, match=r"minimizer lowers the action, which a force, .* do not allow: take newton or"
    ):
        cg.solve(projectile(), METHOD, intervals=4, solver=cg.minimizer)


@pytest.mark.parametrize(
    ("force", "kind", "message"),
    [
        (lambda t, x, v: [0, 0], ValueError, r"force must return a vector of length 1, got shape \(2, 1\)"),
        (lambda t, x: 0, TypeError, r"force is called as force\(t, x, v\)"),
        (lambda t, x, v, p: p, TypeError, r"force is called as force\(t, x, v\).* If it takes p, give parameters"),
        (lambda t, x, v, u: u, TypeError, r"force is called as force\(t, x, v\).* Controls u .* a ControlProblem"),
        (lambda t, x, v: -v[1], ValueError, "an index is out of range of so many components, t has 1, x has 1, v has"),
        (lambda t, x, v: -v[0] * ca.SX.sym("drag"), ValueError, "force depends on drag besides its arguments t, x, v"),
        (0.5, TypeError, r"force must be a callable of \(t, x, v\), got 0.5"),
    ],
)
def test_a_force_that_does_not_fit_is_refused(force, kind, message):
    with pytest.raises(kind, match=message):
        oscillator_problem(force=force)


@pytest.mark.parametrize("options", [{"tol": 1e-6}, {"method": cg.Galerkin(8), "intervals": 8}], ids=str)
@pytest.mark.parametrize("coupling", [1e-6, *slow(1e-17)])
def test_a_component_that_is_driven_is_accurate_down_to_a_small_part_of_the_others(coupling, options):
    """x₀'' = -4x₀ and x₁'' = -x₁ + ε x₀, whose own component is of size ε; below rounding of the other it is zero."""
    driven = cg.BoundaryProblem(
        lambda t, x, v: (v[0] ** 2 - 4 * x[0] ** 2 + v[1] ** 2 - x[1] ** 2) / 2,
        (0.0, 1.0),
        [0.0, 0.0],
        [1.0, 0.0],
        force=lambda t, x, v: [0, coupling * x[0]],
    )
    t = np.linspace(0, 1, 9)
    exact = (np.sin(2) / np.sin(1) * np.sin(t) - np.sin(2 * t)) / (3 * np.sin(2)) * (coupling > 1e-16)
    np.testing.assert_allclose(cg.solve(driven, **options)(t)[1] / coupling, exact, rtol=0, atol=1e-8)
