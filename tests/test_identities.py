"""Identities: collocation, Störmer-Verlet, control points, gauge, discrete action values, polynomials."""

import casadi as ca
import numpy as np
import pytest
from motions import varying_mass
from scenes import BY_NAME, gravity, pendulum
from slow import slow

import casadi_galerkin as cg

IDENTITY = 1e-13  # both sides are solved to roundoff; values of size 1 to 5


def driven_pair(t, x, v):
    return ca.dot(v, v) / 2 + v[0] * v[1] * ca.cos(x[0] - x[1]) / 2 + ca.cos(x[0]) + ca.sin(t) * x[1]


def collocation_points(stages):
    """Gauss points and Butcher matrix, from NumPy's Legendre roots and integrated Lagrange polynomials."""
    x, w = np.polynomial.legendre.leggauss(stages)
    c, a = (1 + x) / 2, np.zeros((stages, stages))
    for j in range(stages):
        others = np.delete(c, j)
        for i in range(stages):
            nodes = c[i] * (1 + x) / 2
            basis = np.prod([(nodes - o) / (c[j] - o) for o in others], axis=0) * np.ones(stages)
            a[i, j] = c[i] * w @ basis / 2
    return c, a, w / 2


def gauss_collocation(lagrangian, d, t0, x, p, h, stages):
    """One step of Gauss collocation of Hamilton's equations, by Newton's method on the stages in (x, v).

    Stage values (X_i, V_i): X_i = x + h Σ a_ij V_j and P_i = p + h Σ a_ij ∂L/∂x(X_j, V_j), P = ∂L/∂v.
    """
    c, a, b = collocation_points(stages)
    t, xs, vs = ca.SX.sym("t"), ca.SX.sym("x", d), ca.SX.sym("v", d)
    value = lagrangian(t, xs, vs)
    parts = ca.Function("parts", [t, xs, vs], [ca.gradient(value, xs), ca.gradient(value, vs)])
    unknowns, start, step = ca.SX.sym("V", d, stages), ca.SX.sym("s", 2 * d), ca.SX.sym("h")
    X = [start[:d] + step * sum(a[i, j] * unknowns[:, j] for j in range(stages)) for i in range(stages)]
    F = [parts(t0 + c[i] * h, X[i], unknowns[:, i]) for i in range(stages)]
    defect = [F[i][1] - start[d:] - step * sum(a[i, j] * F[j][0] for j in range(stages)) for i in range(stages)]
    residual = ca.vertcat(*defect)
    V = ca.vec(unknowns)
    system = ca.Function("system", [V, start, step], [residual, ca.jacobian(residual, V)])
    end = ca.vertcat(
        start[:d] + step * sum(b[i] * unknowns[:, i] for i in range(stages)),
        start[d:] + step * sum(b[i] * F[i][0] for i in range(stages)),
    )
    y, guess = np.concatenate((x, p)), np.tile(p, stages)
    for _ in range(50):
        r, jacobian = (np.array(k) for k in system(guess, y, h))
        guess = guess - np.linalg.solve(jacobian, r.ravel())
    assert np.max(np.abs(np.array(system(guess, y, h)[0]))) < 1e-14
    y = np.array(ca.Function("end", [V, start, step], [end])(guess, y, h)).ravel()
    return y[:d], y[d:]


@pytest.mark.parametrize("lagrangian", [pendulum, varying_mass, driven_pair], ids=lambda f: f.__name__)
@pytest.mark.parametrize("degree", [1, 2, *slow(5)])
def test_gauss_rule_of_the_degree_is_gauss_collocation_of_hamiltons_equations(lagrangian, degree):
    """The global solution is followed step by step, from its own first momentum."""
    d = 2 if lagrangian is driven_pair else 1
    mesh = np.array([0.0, 0.2, 0.5, 0.6, 1.0])
    start, end = [0.1, -0.2][:d], [0.8, 0.4][:d]
    path = cg.solve(cg.BoundaryProblem(lagrangian, (0, 1), start, end), cg.Galerkin(degree), mesh=mesh)
    for k, h in enumerate(np.diff(mesh)):
        step = gauss_collocation(lagrangian, d, mesh[k], path.x[:, k], path.momentum[:, k], h, degree)
        np.testing.assert_allclose(step, (path.x[:, k + 1], path.momentum[:, k + 1]), rtol=0, atol=IDENTITY)


def test_one_more_gauss_point_is_another_method():
    """The other side: on a mass that depends on x, Gauss(m + 1) is not collocation at Gauss(m)."""
    problem = cg.BoundaryProblem(varying_mass, (0, 1), [0.1], [0.8])
    path = cg.solve(problem, cg.Galerkin(2, quadrature=cg.gauss(3)), intervals=4)
    step = gauss_collocation(varying_mass, 1, 0.0, path.x[:, 0], path.momentum[:, 0], 0.25, 2)
    assert abs(step[0] - path.x[:, 1]) > 1e-8


def test_degree_one_with_the_trapezoid_is_stoermer_verlet():
    path = cg.solve(
        cg.BoundaryProblem(pendulum, (0, 2), [0.3], [1.0]), cg.Galerkin(1, quadrature=cg.trapezoid()), intervals=12
    )
    x, p, h = path.x[0], path.momentum[0], 2 / 12
    np.testing.assert_allclose(x[2:] - 2 * x[1:-1] + x[:-2], -(h**2) * np.sin(x[1:-1]), rtol=0, atol=IDENTITY)
    for k in range(12):  # leapfrog, kick by half - drift - kick by half
        half = p[k] - h / 2 * np.sin(x[k])
        assert x[k] + h * half == pytest.approx(x[k + 1], abs=IDENTITY)
        assert half - h / 2 * np.sin(x[k + 1]) == pytest.approx(p[k + 1], abs=IDENTITY)


def test_degree_one_with_the_midpoint_is_the_implicit_midpoint_rule():
    path = cg.solve(cg.BoundaryProblem(pendulum, (0, 2), [0.3], [1.0]), cg.Galerkin(1), intervals=12)
    x, p, h = path.x[0], path.momentum[0], 2 / 12
    np.testing.assert_allclose(np.diff(x), h * (p[1:] + p[:-1]) / 2, rtol=0, atol=IDENTITY)
    np.testing.assert_allclose(np.diff(p), -h * np.sin((x[1:] + x[:-1]) / 2), rtol=0, atol=IDENTITY)


def test_degree_one_with_the_left_rectangle_is_symplectic_euler():
    path = cg.solve(
        cg.BoundaryProblem(pendulum, (0, 2), [0.3], [1.0]), cg.Galerkin(1, quadrature=cg.left_rectangle()), intervals=12
    )
    x, p, h = path.x[0], path.momentum[0], 2 / 12
    np.testing.assert_allclose(np.diff(p), -h * np.sin(x[:-1]), rtol=0, atol=IDENTITY)
    np.testing.assert_allclose(np.diff(x), h * p[1:], rtol=0, atol=IDENTITY)


@pytest.mark.parametrize("degree", [5, *slow(9)])
@pytest.mark.parametrize("other", ["chebyshev", "equispaced", "odd"])
def test_two_families_of_control_points_give_the_same_path(degree, other):
    points = {
        "chebyshev": cg.chebyshev_points(degree),
        "equispaced": cg.equispaced_points(degree),
        "odd": cg.lobatto_points(degree) ** 1.3,
    }[other]
    problem = cg.BoundaryProblem(driven_pair, (0, 1), [0.1, -0.2], [0.8, 0.4])
    a = cg.solve(problem, cg.Galerkin(degree), intervals=3)
    b = cg.solve(problem, cg.Galerkin(degree, control_points=points), intervals=3)
    t = np.linspace(0, 1, 50)
    np.testing.assert_allclose(a(t), b(t), rtol=0, atol=IDENTITY)
    np.testing.assert_allclose(a.momentum, b.momentum, rtol=0, atol=10 * IDENTITY)
    assert a.action == pytest.approx(b.action, rel=IDENTITY)


def gauge(t, x, v):
    """d/dt of F = t x³/3 - x², a polynomial of degree 3 m + 1 in t along a path of degree m."""
    return x[0] ** 3 / 3 + (t * x[0] ** 2 - 2 * x[0]) * v[0]


@pytest.mark.parametrize("degree", [1, 4])
def test_adding_a_total_derivative_moves_nothing_once_the_quadrature_is_exact(degree):
    F = lambda t, x: t * x**3 / 3 - x**2  # noqa: E731
    points = (3 * degree + 2) // 2  # dF/dt is of degree 3 m: 2 r - 1 >= 3 m
    assert cg.gauss(points).order > 3 * degree
    method = cg.Galerkin(degree, quadrature=cg.gauss(points))
    plain = cg.solve(cg.BoundaryProblem(pendulum, (0, 1), [0.2], [1.0]), method, intervals=5)
    moved = cg.BoundaryProblem(lambda t, x, v: pendulum(t, x, v) + gauge(t, x, v), (0, 1), [0.2], [1.0])
    path = cg.solve(moved, method, intervals=5)
    np.testing.assert_allclose(path.polynomial.values, plain.polynomial.values, rtol=0, atol=IDENTITY)
    assert path.action - plain.action == pytest.approx(F(1, 1.0) - F(0, 0.2), abs=IDENTITY)
    shift = path.t * path.x[0] ** 2 - 2 * path.x[0]  # ∂F/∂x
    np.testing.assert_allclose(path.momentum[0] - plain.momentum[0], shift, rtol=0, atol=10 * IDENTITY)


def test_adding_a_total_derivative_moves_the_path_where_the_quadrature_is_not_exact():
    method = cg.Galerkin(4)  # Gauss(4) is exact to degree 7, dF/dt has 12
    plain = cg.solve(cg.BoundaryProblem(pendulum, (0, 1), [0.2], [1.0]), method, intervals=1)
    moved = cg.BoundaryProblem(lambda t, x, v: pendulum(t, x, v) + gauge(t, x, v), (0, 1), [0.2], [1.0])
    assert (
        np.max(np.abs(cg.solve(moved, method, intervals=1).polynomial.values - plain.polynomial.values))
        > 1e3 * IDENTITY
    )


@pytest.mark.parametrize(
    ("degree", "rule", "action"),
    [
        (2, cg.gauss(2), 1.3310071117351),
        (2, cg.lobatto(3), 1.3310045562506598),
        (3, cg.gauss(3), 1.3310039942622305),
        (3, cg.lobatto(4), 1.3310039926057784),
        (4, cg.gauss(4), 1.3310039926548922),
    ],
)
def test_discrete_action_of_the_short_pendulum_has_its_computed_value(degree, rule, action):
    path = cg.solve(BY_NAME["short pendulum"].problem, cg.Galerkin(degree, quadrature=rule), intervals=4)
    assert path.action == pytest.approx(action, rel=IDENTITY)


@pytest.mark.parametrize("degree", [2, *slow(8)])
@pytest.mark.parametrize("rule", [cg.gauss, lambda m: cg.lobatto(m + 1), lambda m: cg.radau(m)])
@pytest.mark.parametrize("name", ["free particle", "uniform gravity"])
def test_parabolas_are_reproduced_on_any_mesh(degree, rule, name):
    scene = BY_NAME[name]
    a, b = scene.t_span
    mesh = a + (b - a) * np.array([0.0, 0.1, 0.45, 1.0])
    path = cg.solve(scene.problem, cg.Galerkin(degree, quadrature=rule(degree)), mesh=mesh)
    t = ca.SX.sym("t")
    exact = ca.Function("exact", [t], [ca.vertcat(*scene.path(t))])
    times = np.linspace(a, b, 40)
    np.testing.assert_allclose(path(times), np.array(exact(times[None, :])), rtol=0, atol=IDENTITY * 5)


def test_degree_one_does_not_reproduce_the_parabola_between_the_joints():
    path = cg.solve(cg.BoundaryProblem(gravity, (0, 2), [0, 0], [6, 1]), cg.Galerkin(1), intervals=4)
    assert abs(path(0.25)[1] - (10.31 * 0.25 - 9.81 * 0.25**2 / 2)) > 0.1


def test_time_reversal_is_exact_for_symmetric_rules():
    forth = cg.solve(cg.BoundaryProblem(pendulum, (0, 1), [0.2], [1.0]), cg.Galerkin(3), intervals=5)
    back = cg.solve(cg.BoundaryProblem(pendulum, (0, 1), [1.0], [0.2]), cg.Galerkin(3), intervals=5)
    np.testing.assert_allclose(back.polynomial.values, forth.polynomial.values[:, ::-1], rtol=0, atol=IDENTITY)
    np.testing.assert_allclose(back.momentum, -forth.momentum[:, ::-1], rtol=0, atol=IDENTITY)


def test_momentum_map_of_a_rotation_is_conserved_at_the_joints():
    """Angular momentum, at whatever accuracy: the discrete action is invariant under rotations."""
    problem = cg.BoundaryProblem(lambda t, x, v: ca.dot(v, v) / 2 + 1 / ca.norm_2(x), (0, 2), [1.0, 0.0], [-0.5, 0.9])
    path = cg.solve(problem, cg.Galerkin(2), intervals=4)
    angular = path.x[0] * path.momentum[1] - path.x[1] * path.momentum[0]
    np.testing.assert_allclose(angular, angular[0], rtol=IDENTITY)
    assert np.ptp(path.energy) > 1e-6  # while energy is not


def test_momenta_are_the_derivatives_of_the_action_by_the_ends():
    """The discrete Legendre transform, by differences of S over the ends: order h² of the difference."""
    tr = cg.transcribe(cg.BoundaryProblem(pendulum, (0, 1), [0.2], [1.0]), cg.Galerkin(2), 3)
    path, e = tr.solve(), 1e-5
    by_start = (tr.solve(start=[0.2 + e]).action - tr.solve(start=[0.2 - e]).action) / (2 * e)
    by_end = (tr.solve(end=[1 + e]).action - tr.solve(end=[1 - e]).action) / (2 * e)
    np.testing.assert_allclose(path.momentum[0, [0, -1]], [-by_start, by_end], rtol=0, atol=1e-9)
