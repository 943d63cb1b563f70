"""The table of scenes, checked: exact paths obey the equations, numbers agree with an independent solver."""

import casadi as ca
import mpmath
import numpy as np
import pytest
from scenes import BY_NAME, CATENARIES, SCENES, TROESCH, Scene, bratu_theta, great_circle_ends
from scipy.integrate import solve_ivp

import casadi_galerkin as cg

EXACT = [scene for scene in SCENES if scene.path is not None]
# Shooting cannot follow a layer: an error of the start grows by e^1e4 (boundary layer), e^20 and more (Troesch).
UNSTABLE = ("boundary layer", "Troesch 20", "Troesch 30", "Troesch 50")
SHOT = [scene for scene in SCENES if scene.velocities[0] is not None and not scene.name.startswith(UNSTABLE)]
EULER_LAGRANGE = 1e-12  # relative to the sizes of the terms; cancellation between them costs a few digits of 1e-16
SHOOTING = 1e3  # an initial velocity's last digit moves the end of the worst scene (Troesch, long pendulum) by this
NAMES = {"ids": lambda scene: scene.name}


def rates(scene: Scene) -> ca.Function:
    """Rates of position, velocity and action, (t, (x, v, S)) -> (v, a, L)."""
    d = len(scene.start)
    t, x, v = ca.SX.sym("t"), ca.SX.sym("x", d), ca.SX.sym("v", d)
    value = ca.SX(scene.lagrangian(t, x, v))
    momentum = ca.gradient(value, v)
    mass = ca.jacobian(momentum, v)
    force = ca.gradient(value, x) - ca.jacobian(momentum, t) - ca.jacobian(momentum, x) @ v
    state, change = ca.vertcat(x, v, ca.SX.sym("S")), ca.vertcat(v, ca.solve(mass, force), value)
    return ca.Function("rates", [t, state], [ca.densify(change)])


@pytest.mark.parametrize("scene", EXACT, **NAMES)
def test_exact_path_obeys_euler_lagrange_equations(scene):
    d = len(scene.start)
    t, x, v = ca.SX.sym("t"), ca.SX.sym("x", d), ca.SX.sym("v", d)
    value = ca.SX(scene.lagrangian(t, x, v))
    momentum = ca.gradient(value, v)
    path = ca.vertcat(*scene.path(t))
    first = ca.jacobian(path, t)
    second = ca.jacobian(first, t)
    terms = [ca.jacobian(momentum, v) @ second, ca.jacobian(momentum, x) @ first, ca.jacobian(momentum, t)]
    terms = ca.substitute([ca.horzcat(*terms, -ca.gradient(value, x))], [x, v], [path, first])[0]
    residual = ca.Function("residual", [t], [ca.sum2(terms), ca.sum2(ca.fabs(terms)) + ca.fabs(path)])
    a, b = scene.t_span
    for time in a + (b - a) * np.array([0.0, 0.03, 0.21, 0.5, 0.77, 1.0]):
        off, size = (np.array(values).ravel() for values in residual(time))
        assert np.all(np.abs(off) <= EULER_LAGRANGE * np.max(size))


@pytest.mark.parametrize("scene", EXACT, **NAMES)
def test_exact_path_meets_the_ends_and_the_stated_velocities(scene):
    t = ca.SX.sym("t")
    path = ca.vertcat(*scene.path(t))
    function = ca.Function("path", [t], [path, ca.jacobian(path, t)])
    for time, end, velocity in zip(scene.t_span, (scene.start, scene.end), scene.velocities, strict=True):
        x, v = (np.array(values).ravel() for values in function(time))
        for got, given in zip(x, end, strict=True):
            assert given is None or got == pytest.approx(given, rel=1e-14, abs=3e-14)
        if velocity is not None:
            np.testing.assert_allclose(v, velocity, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("scene", [s for s in EXACT if s.action is not None], **NAMES)
def test_stated_action_is_the_integral_of_the_lagrangian(scene):
    t = ca.SX.sym("t")
    path = ca.vertcat(*scene.path(t))
    function = ca.Function("value", [t], [scene.lagrangian(t, path, ca.jacobian(path, t))])
    points, weights = (np.array(a) for a in (cg.gauss(20).points, cg.gauss(20).weights))
    total = 0.0
    for a, b in zip(scene.joints[:-1], scene.joints[1:], strict=True):
        total += (b - a) * float(weights @ np.array(function(a + (b - a) * points[None, :])).ravel())
    assert total == pytest.approx(scene.action, rel=1e-13, abs=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("scene", SHOT, **NAMES)
def test_stated_velocity_leads_to_the_end_with_the_stated_values(scene):
    """Shoot with DOP853: an oracle that shares nothing with the package."""
    change, d = rates(scene), len(scene.start)

    def rate(t, y):
        return np.array(change(t, y)).ravel()

    initial = np.concatenate((scene.start, scene.velocities[0], [0.0]))
    times = [*scene.values, scene.t_span[1]]
    sizes = np.maximum(np.abs(initial), 1e-6)
    answer = solve_ivp(rate, scene.t_span, initial, "DOP853", sorted(times), rtol=3e-14, atol=1e-14 * sizes)
    tolerance = SHOOTING * scene.digits
    last = answer.y[:, -1]
    for got, given in zip(last[:d], scene.end, strict=True):
        assert given is None or got == pytest.approx(given, rel=tolerance, abs=tolerance)
    if scene.velocities[1] is not None:
        np.testing.assert_allclose(last[d : 2 * d], scene.velocities[1], rtol=tolerance, atol=tolerance)
    if scene.action is not None:
        assert last[-1] == pytest.approx(scene.action, rel=tolerance, abs=tolerance)
    for time, x in scene.values.items():
        np.testing.assert_allclose(answer.y[:d, list(answer.t).index(time)], x, rtol=tolerance)


@pytest.mark.parametrize("scene", [s for s in SCENES if s.conserved and s.path], **NAMES)
def test_first_integral_is_constant_along_the_exact_path(scene):
    d = len(scene.start)
    t, x, v = ca.SX.sym("t"), ca.SX.sym("x", d), ca.SX.sym("v", d)
    path = ca.vertcat(*scene.path(t))
    integral = ca.substitute([scene.conserved(t, x, v)], [x, v], [path, ca.jacobian(path, t)])[0]
    function = ca.Function("integral", [t], [integral])
    values = np.array(function(np.linspace(*scene.t_span, 7)[None, :])).ravel()
    np.testing.assert_allclose(values, values[0], rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("rate", list(TROESCH))
def test_velocities_of_troeschs_problem_give_it_the_duration_one(rate):
    """Energy: x'² = x'(0)² + 4 sinh²(λx/2), so the time from 0 to 1 is an integral of x, here in 25 digits."""
    first, last = (mpmath.mpf(v) for v in TROESCH[rate])
    with mpmath.workdps(25):
        speed = lambda x: mpmath.sqrt(first**2 + 4 * mpmath.sinh(rate * x / 2) ** 2)  # noqa: E731
        stretched = lambda u: first / rate * mpmath.cosh(u) / speed(first / rate * mpmath.sinh(u))  # noqa: E731
        duration = mpmath.quad(stretched, mpmath.linspace(0, mpmath.asinh(rate / first), 8))
        # dT/d log x'(0) is close to -1/λ
        assert abs(duration - 1) * rate < 1e-15
        assert abs(speed(mpmath.mpf(1)) / last - 1) < 1e-15


def test_catenary_parameters_are_the_published_ones():
    np.testing.assert_allclose(CATENARIES, [0.848337938094979, 0.235094990234533], rtol=0, atol=5e-16)


def test_bratu_branches_differ_and_meet_at_the_fold():
    fold = 3.513830719125
    assert bratu_theta(3.0, True) > bratu_theta(3.0, False) + 1
    below = fold * (1 - 1e-12)
    assert bratu_theta(below, True) - bratu_theta(below, False) == pytest.approx(0, abs=1e-4)


def test_great_circle_arc_is_the_angle_between_its_ends():
    a, b = great_circle_ends()
    cosine = np.sin(a[0]) * np.sin(b[0]) + np.cos(a[0]) * np.cos(b[0]) * np.cos(a[1] - b[1])
    assert np.sqrt(2 * BY_NAME["great circle"].action) == pytest.approx(np.arccos(cosine), rel=1e-15)


def test_names_are_unique():
    assert len(BY_NAME) == len(SCENES)
