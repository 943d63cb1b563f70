"""The discrete calculus as the paper writes it: emb_m, Δ_m, ∫ Δ_w, the decomposition, the Du Bois-Reymond lemma."""

import numpy as np
import pytest
from rules import lagrange
from scenes import oscillator_problem
from scipy.sparse import coo_array

import casadi_galerkin as cg
from casadi_galerkin.calculus.discrete_calculus import mesh_of

ROUNDOFF = 1e-13  # values of size 1 to 10, derivatives of degree up to 6 on steps of 0.1 to 1
MESHES = {"uniform": np.linspace(-1, 2, 5), "graded": np.array([-1.0, -0.7, 0.4, 0.5, 2.0])}
METHODS = [
    cg.Galerkin(1),
    cg.Galerkin(1, quadrature=cg.trapezoid()),
    cg.Galerkin(2),
    cg.Galerkin(3, control_points=[0.2, 0.7]),
    cg.Galerkin(4, quadrature=cg.lobatto(5)),
    cg.Galerkin(6, control_points=cg.chebyshev_points(6), quadrature=cg.radau(7)),
]


@pytest.fixture(params=list(MESHES))
def mesh(request):
    return MESHES[request.param]


@pytest.fixture(params=METHODS, ids=str)
def calculus(request, mesh):
    return cg.DiscreteCalculus(request.param, mesh)


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def element_basis(calculus, i, j, t):
    """l_{i,j} and its derivative on [t_i, t_{i+1}], independent of the package's."""
    m = calculus.method.degree
    return lagrange(calculus.node_times[i * m : i * m + m + 1], j, t)


def points_within(calculus, i):
    a, b = calculus.mesh[i : i + 2]
    return a + (b - a) * np.array([0.0, 0.15, 0.5, 0.9, 1.0])


def test_nodes_are_joints_and_control_points(calculus):
    m, mesh = calculus.method.degree, calculus.mesh
    np.testing.assert_array_equal(calculus.node_times[::m], mesh)
    for i, h in enumerate(np.diff(mesh)):
        inner = calculus.node_times[i * m + 1 : (i + 1) * m]
        np.testing.assert_allclose(inner, mesh[i] + h * np.array(calculus.method.control_points), rtol=0, atol=1e-15)


def test_embedding_takes_the_node_values_at_the_nodes(calculus, rng):
    values = rng.normal(size=(2, len(calculus.node_times)))
    np.testing.assert_allclose(calculus.emb(values)(calculus.node_times), values, rtol=0, atol=ROUNDOFF)


def test_embedding_is_the_scalar_product_with_lagrange_polynomials(calculus, rng):
    """Equation (interdef)."""
    values = rng.normal(size=len(calculus.node_times))
    path, m = calculus.emb(values[None, :]), calculus.method.degree
    for i in range(len(calculus.mesh) - 1):
        t = points_within(calculus, i)
        parts = [np.array(element_basis(calculus, i, j, t)) * values[i * m + j] for j in range(m + 1)]
        value, slope = sum(parts)
        np.testing.assert_allclose(path(t)[0], value, rtol=0, atol=ROUNDOFF)
        np.testing.assert_allclose(path(t[:-1], 1)[0], slope[:-1], rtol=ROUNDOFF, atol=1e2 * ROUNDOFF)


def test_embedding_derivative_and_antiderivative_are_linear(calculus, rng):
    x, y = rng.normal(size=(2, 1, len(calculus.node_times)))
    t = np.linspace(calculus.mesh[0], calculus.mesh[-1], 23)
    both = calculus.emb(2.5 * x + y)(t)
    np.testing.assert_allclose(both, 2.5 * calculus.emb(x)(t) + calculus.emb(y)(t), rtol=0, atol=ROUNDOFF)
    slopes = 2.5 * calculus.delta(x) + calculus.delta(y)
    np.testing.assert_allclose(calculus.delta(2.5 * x + y), slopes, rtol=ROUNDOFF, atol=1e2 * ROUNDOFF)
    f, g = rng.normal(size=(2, len(calculus.weights)))
    parts = 2.5 * calculus.integral(f) + calculus.integral(g)
    np.testing.assert_allclose(calculus.integral(2.5 * f + g), parts, rtol=0, atol=ROUNDOFF)


def test_path_decomposes_into_its_joints_part_and_its_control_part(calculus, rng):
    """Equation (decomp): x̄ = x + x_C, where x_C vanishes on T and x at the control points."""
    values = rng.normal(size=(1, len(calculus.node_times)))
    at_joint = np.arange(values.size) % calculus.method.degree == 0
    x, x_c = calculus.emb(np.where(at_joint, values, 0)), calculus.emb(np.where(at_joint, 0, values))
    t = np.linspace(calculus.mesh[0], calculus.mesh[-1], 31)
    np.testing.assert_allclose(calculus.emb(values)(t), x(t) + x_c(t), rtol=0, atol=ROUNDOFF)
    np.testing.assert_array_equal(x_c(calculus.mesh), 0)
    if calculus.method.degree == 1:
        np.testing.assert_array_equal(x_c(t), 0)
    else:
        np.testing.assert_allclose(x(calculus.node_times[~at_joint]), 0, rtol=0, atol=ROUNDOFF)


def test_discrete_derivative_is_the_right_derivative_on_all_joints_but_the_last(calculus, rng):
    values = rng.normal(size=(1, len(calculus.node_times)))
    m = calculus.method.degree
    got = calculus.delta(values)
    assert got.shape == (1, len(calculus.mesh) - 1)
    for i, t in enumerate(calculus.mesh[:-1]):
        slope = sum(element_basis(calculus, i, j, np.array([t]))[1] * values[0, i * m + j] for j in range(m + 1))
        np.testing.assert_allclose(got[:, i], slope, rtol=ROUNDOFF, atol=1e2 * ROUNDOFF)


def test_discrete_derivative_of_degree_one_is_the_forward_difference(mesh, rng):
    x = rng.normal(size=(1, len(mesh)))
    got = cg.DiscreteCalculus(cg.Galerkin(1), mesh).delta(x)
    np.testing.assert_allclose(got, np.diff(x) / np.diff(mesh), rtol=1e-14)


@pytest.mark.parametrize("degree", [1, 2, 3, 5, 8])
def test_a_polynomial_of_the_degree_is_embedded_and_differentiated_exactly_and_the_next_is_not(degree, mesh):
    calculus = cg.DiscreteCalculus(cg.Galerkin(degree), mesh)
    t = np.linspace(mesh[0], mesh[-1], 41)
    for power in (degree, degree + 1):
        path = calculus.emb(calculus.node_times[None, :] ** power)
        off = np.max(np.abs(path(t)[0] - t**power)) / 2.0**power
        off_slope = np.max(np.abs(path(t, 1)[0] - power * t ** (power - 1))) / 2.0**power
        if power == degree:
            assert off < ROUNDOFF
            assert off_slope < 1e3 * ROUNDOFF
        else:
            assert off > 1e3 * ROUNDOFF
            assert off_slope > 1e5 * ROUNDOFF


def test_antiderivative_is_the_papers_sum_with_the_step(calculus, rng):
    """The sum over interval k carries the factor h_k, which the text leaves out."""
    f = rng.normal(size=len(calculus.weights))
    rule, steps = calculus.method.quadrature, np.diff(calculus.mesh)
    total, expected = 0.0, [0.0]
    for k, h in enumerate(steps):
        for j, w in enumerate(rule.weights):
            total += h * w * f[k * len(rule) + j]
        expected.append(total)
    np.testing.assert_allclose(calculus.integral(f), expected, rtol=0, atol=ROUNDOFF)


def test_antiderivative_of_a_polynomial_is_exact_below_the_order_and_not_at_it(calculus):
    t, order = calculus.quadrature_times, calculus.method.quadrature.order
    exact = lambda k: (calculus.mesh ** (k + 1) - calculus.mesh[0] ** (k + 1)) / (k + 1)  # noqa: E731
    for k in range(order):
        np.testing.assert_allclose(calculus.integral(t**k), exact(k), rtol=ROUNDOFF, atol=ROUNDOFF)
    missed = np.abs(calculus.integral(t**order) - exact(order))[-1]
    assert missed > 1e-10


def test_antiderivative_keeps_leading_axes(calculus, rng):
    f = rng.normal(size=(3, 2, len(calculus.weights)))
    got = calculus.integral(f)
    assert got.shape == (3, 2, len(calculus.mesh))
    np.testing.assert_allclose(got[1, 0], calculus.integral(f[1, 0]), rtol=0, atol=ROUNDOFF)
    np.testing.assert_allclose(got[..., -1], f @ calculus.weights, rtol=0, atol=ROUNDOFF)


def test_fundamental_theorem(mesh, rng):
    """∫ dx̄/dt Δ_w t = x̄(t_i) - x̄(a), exact because the rule integrates degree m - 1."""
    calculus = cg.DiscreteCalculus(cg.Galerkin(4), mesh)
    values = rng.normal(size=(1, len(calculus.node_times)))
    path = calculus.emb(values)
    got = calculus.integral(path(calculus.quadrature_times, 1))
    np.testing.assert_allclose(got, path(mesh) - values[:, :1], rtol=0, atol=ROUNDOFF)


def test_operator_is_the_embedding_and_its_derivative_at_the_quadrature_points(calculus, rng):
    n_points, n_nodes = len(calculus.weights), len(calculus.node_times)
    matrix = coo_array(calculus.operator(), shape=(2 * n_points, n_nodes)).tocsr()
    x = rng.normal(size=n_nodes)
    both, path = matrix @ x, calculus.emb(x[None, :])
    np.testing.assert_allclose(both[:n_points], path(calculus.quadrature_times)[0], rtol=0, atol=ROUNDOFF)
    r, m = len(calculus.method.quadrature), calculus.method.degree
    for k, t in enumerate(calculus.quadrature_times):  # the derivative is always this interval's, also at q = 1
        i = k // r
        slope = sum(element_basis(calculus, i, j, np.array([t]))[1] * x[i * m + j] for j in range(m + 1))
        np.testing.assert_allclose(both[n_points + k], slope[0], rtol=ROUNDOFF, atol=1e2 * ROUNDOFF)


@pytest.mark.parametrize("method", METHODS, ids=str)
@pytest.mark.slow
def test_discrete_du_bois_reymond_lemma(method, rng):
    """∫ (f y + g y') Δ_w t = 0 for all Y with zero ends if and only if (cond1) and (cond2) hold.

    The rows of `conditions` are the left-hand sides of (cond1) for the inner joints and (cond2), written with
    the Lagrange polynomials of `lagrange`; (f, g) is drawn from their null space.
    """
    calculus = cg.DiscreteCalculus(method, MESHES["graded"])
    m, r, n = method.degree, len(method.quadrature), len(calculus.mesh) - 1
    points, weights = calculus.quadrature_times.reshape(n, r), calculus.weights.reshape(n, r)

    def row(pieces):
        f, g = np.zeros((n, r)), np.zeros((n, r))
        for i, j in pieces:
            value, slope = element_basis(calculus, i, j, points[i])
            f[i] += weights[i] * value
            g[i] += weights[i] * slope
        return np.concatenate((f.ravel(), g.ravel()))

    joints = [row([(i - 1, m), (i, 0)]) for i in range(1, n)]
    controls = [row([(i, j)]) for i in range(n) for j in range(1, m)]
    conditions = np.array(joints + controls)
    _, sizes, basis = np.linalg.svd(conditions)
    assert sizes[-1] > 1e-3  # the conditions are independent
    good = basis[len(conditions) :].T @ rng.normal(size=basis.shape[0] - len(conditions))

    def integral(pair, y):
        f, g = pair.reshape(2, -1)
        path = calculus.emb(y[None, :])
        # slopes interval by interval, from the operator: at q = 1 the path itself would take the next interval's
        matrix = coo_array(calculus.operator(), shape=(2 * n * r, n * m + 1)).tocsr()
        value, slope = (matrix @ y).reshape(2, -1)
        np.testing.assert_allclose(value, path(points.ravel())[0], rtol=0, atol=ROUNDOFF)
        return float(calculus.weights @ (f * value + g * slope))

    for _ in range(5):
        y = rng.normal(size=n * m + 1)
        y[[0, -1]] = 0
        assert abs(integral(good, y)) < ROUNDOFF * np.abs(good).max() * 10
    y = rng.normal(size=n * m + 1)
    assert abs(integral(good, y)) > 1e-3  # without the zero ends it does not vanish
    for k in range(len(conditions)):  # violate one condition, keep the others: some Y sees it, and only its own node
        bad = good + np.linalg.pinv(conditions)[:, k]
        order = [i * m for i in range(1, n)] + [i * m + j for i in range(n) for j in range(1, m)]
        seen = [integral(bad, np.eye(n * m + 1)[node]) for node in order]
        np.testing.assert_allclose(seen, np.eye(len(conditions))[k], rtol=0, atol=1e-11)


METHOD = cg.Galerkin(2)


@pytest.mark.parametrize(
    ("arguments", "kind", "message"),
    [
        ({"intervals": 0}, ValueError, "intervals must be at least 1, got 0"),
        ({"intervals": -1}, ValueError, "intervals must be at least 1, got -1"),
        ({"intervals": 2.0}, TypeError, "intervals must be a whole number, got 2.0"),
        ({"intervals": True}, TypeError, "intervals must be a whole number, got True"),
        ({"intervals": "3"}, TypeError, "intervals must be a whole number, got '3'"),
        ({}, ValueError, "give either intervals or mesh, got intervals=None and mesh=None"),
        ({"intervals": 2, "mesh": [0, 1]}, ValueError, "give either intervals or mesh, got intervals=2"),
        (
            {"mesh": [0, 0.7, 0.4, 1]},
            ValueError,
            r"must be finite and increase by more than roundoff, got t\[1\] = 0.7 and t\[2\] = 0.4",
        ),
        (
            {"mesh": [0, 0.6, 1.5 * 0.4, 1]},
            ValueError,
            r"more than roundoff, got t\[1\] = 0.6 and t\[2\] = 0.6000000000000001",
        ),
        (
            {"mesh": [0, 0.5, 0.5, 1]},
            ValueError,
            r"must be finite and increase by more than roundoff, got t\[1\] = 0.5 and t\[2\] = 0.5",
        ),
        ({"mesh": [0, np.nan, 1]}, ValueError, "joints of a mesh must be finite"),
        ({"mesh": [0.1, 1]}, ValueError, "the mesh must run from 0.0 to 1.0, got 0.1 to 1.0"),
        ({"mesh": [0]}, ValueError, r"a sequence of at least 2 joints, got shape \(1,\)"),
        ({"mesh": 1.0}, ValueError, r"a sequence of at least 2 joints, got shape \(\)"),
        ({"mesh": [[0, 1]]}, ValueError, r"a sequence of at least 2 joints, got shape \(1, 2\)"),
        ({"mesh": "01"}, TypeError, "the joints of a mesh must be real numbers, got '01'"),
        ({"mesh": [0, 0.5j, 1]}, TypeError, "the joints of a mesh must be real numbers"),
    ],
)
def test_a_mesh_that_does_not_fit_is_refused(arguments, kind, message):
    with pytest.raises(kind, match=message):
        cg.solve(oscillator_problem(), METHOD, **arguments)


@pytest.mark.parametrize("call", ["emb", "delta"])
@pytest.mark.parametrize("shape", [(4,), (1, 4), (2, 3, 5)])
def test_node_values_of_another_shape_are_refused(call, shape):
    calculus = cg.DiscreteCalculus(METHOD, [0.0, 0.5, 1.0])
    with pytest.raises(ValueError, match=r"values at the nodes must have the shape \(d, 5\), got \("):
        getattr(calculus, call)(np.zeros(shape))


@pytest.mark.parametrize("values", [np.zeros(3), np.zeros((4, 3)), 1.0])
def test_integrands_of_another_shape_are_refused(values):
    calculus = cg.DiscreteCalculus(METHOD, [0.0, 0.5, 1.0])
    with pytest.raises(ValueError, match=r"quadrature points must have the shape \(\.\.\., 4\), got"):
        calculus.integral(values)


@pytest.mark.parametrize("intervals", [3, 4, 7, 20])
def test_equal_intervals_bend_to_hold_the_breakpoints(intervals):
    mesh = mesh_of((0.0, 2.0), intervals, None, (0.3, 1.7))
    assert len(mesh) == intervals + 1
    assert {0.3, 1.7} <= set(mesh.tolist())
    assert np.all(np.diff(mesh) > 0)
    assert np.max(np.diff(mesh)) <= 1.4 if intervals == 3 else np.max(np.diff(mesh)) <= 4 / intervals


def test_a_mesh_that_misses_a_breakpoint_is_refused():
    with pytest.raises(ValueError, match=r"every breakpoint as a joint, but has none at 0\.5; the nearest is 0\.4"):
        mesh_of((0.0, 1.0), None, [0.0, 0.4, 1.0], (0.5,))
    with pytest.raises(ValueError, match="intervals must be at least 3, as 2 breakpoints are joints, got 2"):
        mesh_of((0.0, 1.0), 2, None, (0.2, 0.3))


def test_what_is_no_method_has_no_calculus():
    with pytest.raises(TypeError, match=r"method must be a Galerkin, such as Galerkin\(degree=4\), got 3"):
        cg.DiscreteCalculus(3, [0.0, 1.0])
