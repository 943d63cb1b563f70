"""Control points and Lagrange polynomials: nodality, partition of unity, derivative rows, high degree."""

import mpmath
import numpy as np
import pytest

import casadi_galerkin as cg
from casadi_galerkin.calculus.nodes import barycentric_weights, differentiation_matrix, lagrange_values

FAMILIES = [cg.lobatto_points, cg.chebyshev_points, cg.equispaced_points]
STABLE = FAMILIES[:2]
DEGREES = [1, 2, 3, 5, 10, 20, 40, 60, 100]
UNITY = 1e-13  # sums of up to 101 terms below 1
SLOPE = 1e-10  # derivative matrices hold entries up to m², of which a row sum at degree 100 loses 1e4 eps and more


def nodes_of(points, degree):
    return np.concatenate(([0.0], points(degree), [1.0]))


def between(nodes):
    """Points off the nodes: a few within every gap."""
    return (nodes[:-1, None] + np.diff(nodes)[:, None] * np.array([0.11, 0.5, 0.83])).ravel()


@pytest.mark.parametrize("points", FAMILIES)
@pytest.mark.parametrize("degree", DEGREES)
def test_control_points_increase_symmetrically_within_the_interval(points, degree):
    c = points(degree)
    assert c.shape == (degree - 1,)
    assert np.all((c > 0) & (c < 1))
    assert np.all(np.diff(c) > 0)
    np.testing.assert_allclose(c + c[::-1], 1, rtol=0, atol=1e-15)


def test_control_points_of_low_degree_are_the_known_ones():
    np.testing.assert_allclose(cg.lobatto_points(3), [(1 - 5**-0.5) / 2, (1 + 5**-0.5) / 2], rtol=1e-15)
    np.testing.assert_allclose(cg.chebyshev_points(4), [(1 - 2**-0.5) / 2, 0.5, (1 + 2**-0.5) / 2], rtol=1e-15)
    np.testing.assert_array_equal(cg.equispaced_points(4), [0.25, 0.5, 0.75])


@pytest.mark.parametrize("points", STABLE)
@pytest.mark.parametrize("degree", DEGREES)
def test_lagrange_polynomials_are_one_at_their_node_and_zero_at_the_others(points, degree):
    nodes = nodes_of(points, degree)
    np.testing.assert_array_equal(lagrange_values(nodes, nodes), np.eye(degree + 1))


@pytest.mark.parametrize("points", STABLE)
@pytest.mark.parametrize("degree", DEGREES)
def test_lagrange_polynomials_sum_to_one_and_reproduce_powers(points, degree):
    nodes = nodes_of(points, degree)
    s = between(nodes)
    values = lagrange_values(nodes, s)
    np.testing.assert_allclose(values.sum(axis=1), 1, rtol=0, atol=UNITY)
    for power in (1, degree // 2, degree):
        np.testing.assert_allclose(values @ nodes**power, s**power, rtol=0, atol=UNITY)


@pytest.mark.parametrize("points", STABLE)
@pytest.mark.parametrize("degree", DEGREES)
def test_interpolation_of_one_degree_more_is_not_exact(points, degree):
    """The other side: s^(m+1) differs from its interpolant by exactly the node polynomial."""
    nodes = nodes_of(points, degree)
    s = between(nodes)
    missing = s ** (degree + 1) - lagrange_values(nodes, s) @ nodes ** (degree + 1)
    product = np.prod(s[:, None] - nodes[None, :], axis=1)
    np.testing.assert_allclose(missing, product, rtol=0, atol=UNITY)
    if degree <= 20:
        assert np.max(np.abs(missing)) > UNITY


@pytest.mark.parametrize("points", STABLE)
@pytest.mark.parametrize("degree", DEGREES)
def test_derivative_rows_sum_to_zero_and_differentiate_powers(points, degree):
    nodes = nodes_of(points, degree)
    matrix = differentiation_matrix(nodes)
    assert np.max(np.abs(matrix.sum(axis=1))) <= SLOPE
    np.testing.assert_allclose(matrix @ nodes, 1, rtol=0, atol=SLOPE)
    power = max(1, degree)
    np.testing.assert_allclose(matrix @ nodes**power, power * nodes ** (power - 1), rtol=0, atol=power * SLOPE)


@pytest.mark.parametrize("degree", [20, 40, 60])
def test_lagrange_polynomials_agree_with_forty_digits(degree):
    """The product formula in 40 digits, for the nodes as doubles."""
    nodes = nodes_of(cg.lobatto_points, degree)
    s = np.array([0.013, 0.377, 0.91])
    values = lagrange_values(nodes, s)
    with mpmath.workdps(40):
        exact = [mpmath.mpf(node) for node in nodes]
        for k, point in enumerate(s):
            for j in (0, 1, degree // 2, degree):
                product = mpmath.fprod(
                    (mpmath.mpf(point) - node) / (exact[j] - node) for i, node in enumerate(exact) if i != j
                )
                assert abs(values[k, j] - product) < UNITY


def test_barycentric_weights_of_degree_500_stay_finite():
    weights = barycentric_weights(nodes_of(cg.lobatto_points, 500))
    assert np.all(np.isfinite(weights))
    assert np.all(weights != 0)
    assert np.all(np.sign(weights[1:]) == -np.sign(weights[:-1]))


def test_equispaced_points_lose_all_digits_by_degree_forty():
    """Why the default is Lobatto: the constant of roundoff's magnification, from both sides."""
    lebesgue = {
        points: np.abs(lagrange_values(nodes_of(points, 40), between(nodes_of(points, 40)))).sum(axis=1).max()
        for points in FAMILIES
    }
    assert lebesgue[cg.equispaced_points] > 1e9
    assert max(lebesgue[points] for points in STABLE) < 5


@pytest.mark.parametrize("points", FAMILIES)
@pytest.mark.parametrize("degree", [2.0, "3", True, None, [2], np.True_])
def test_a_degree_that_is_not_whole_is_refused(points, degree):
    with pytest.raises(TypeError, match="degree must be a whole number, got"):
        points(degree)


@pytest.mark.parametrize("points", FAMILIES)
@pytest.mark.parametrize("degree", [0, -1])
def test_a_degree_below_one_is_refused(points, degree):
    with pytest.raises(ValueError, match=f"degree must be at least 1, got {degree}"):
        points(degree)
