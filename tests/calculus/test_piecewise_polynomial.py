"""Piecewise polynomials: derivatives at the joints and of higher order, times that are refused."""

import numpy as np
import pytest

import casadi_galerkin as cg
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial


def test_derivative_at_a_joint_is_the_right_one_and_at_the_last_the_left_one():
    path = cg.DiscreteCalculus(cg.Galerkin(1), [0.0, 1.0, 3.0]).emb([[0.0, 1.0, 7.0]])
    np.testing.assert_array_equal(path([0.0, 0.5, 1.0, 2.0, 3.0], 1), [[1, 1, 3, 3, 3]])
    np.testing.assert_array_equal(path([0.5, 1.0], 2), [[0, 0]])


def test_derivatives_of_higher_order_and_shapes():
    calculus = cg.DiscreteCalculus(cg.Galerkin(4), [0.0, 0.5, 2.0])
    path = calculus.emb(np.stack([calculus.node_times**4, calculus.node_times]))
    assert path(1.0).shape == (2,)
    assert path(np.zeros((3, 2))).shape == (2, 3, 2)
    np.testing.assert_allclose(path(0.7, 2), [12 * 0.7**2, 0], rtol=1e-12, atol=1e-11)
    np.testing.assert_allclose(path(0.7, 4), [24, 0], rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(path(0.7, 5), [0, 0], rtol=0, atol=1e-8)


@pytest.mark.parametrize("nu", [5, 9, 10**6])
def test_derivatives_beyond_the_degree_are_zero(nu):
    nodes = cg.Galerkin(4).element.nodes
    path = PiecewisePolynomial(np.array([0.0, 1e-3, 1.0]), nodes, np.sin(np.arange(18.0)).reshape(2, 9))
    np.testing.assert_array_equal(path(np.array([[0.0, 0.5, 1.0]]), nu), np.zeros((2, 1, 3)))
    assert path(0.5, 4).all()


def test_derivatives_lose_no_digits_to_an_offset():
    calculus, parts = cg.DiscreteCalculus(cg.Galerkin(4), [0.0, 1.0, 3.0]), np.array([0.1, 0.7])
    values = np.arange(9.0)[None, :] ** 2
    near, far = calculus.emb(values), calculus.emb(values + 2.0**40)
    np.testing.assert_allclose(far.at_parts(parts)[1], near.at_parts(parts)[1], rtol=1e-12)
    np.testing.assert_allclose(far([0.1, 2.4], 1), near([0.1, 2.4], 1), rtol=1e-12)


@pytest.mark.parametrize("t", [-0.1, 2.1, np.nan])
def test_times_outside_the_mesh_are_refused(t):
    path = cg.DiscreteCalculus(cg.Galerkin(1), [0.0, 2.0]).emb([[0.0, 1.0]])
    with pytest.raises(ValueError, match=r"times must lie within \[0.0, 2.0\], got"):
        path(t)


def test_times_that_rounding_puts_outside_count_as_the_ends():
    """The last interval is so short that its polynomial must not be continued even by rounding."""
    path = cg.DiscreteCalculus(cg.Galerkin(2), [0.0, 1.0 - 1e-12, 1.0]).emb([[0.0, 0.0, 0.0, 3.0, 1.0]])
    assert path([-1e-13, 1.0 + 5e-13]).tolist() == [[0.0, 1.0]]
    with pytest.raises(ValueError, match="times must lie within"):
        path(1.0 + 2e-12)


@pytest.mark.parametrize("nu", [-1, 1.5, True, "1"])
def test_an_order_of_derivative_that_is_none_is_refused(nu):
    path = cg.DiscreteCalculus(cg.Galerkin(1), [0.0, 2.0]).emb([[0.0, 1.0]])
    with pytest.raises(ValueError, match="nu must be a whole number from 0 on, got"):
        path(1.0, nu)


def test_a_jump_has_a_value_on_either_side():
    """t² up to 1, then t - 3 up to 3."""
    mesh, nodes = np.array([0.0, 1.0, 3.0]), np.array([0.0, 0.5, 1.0])
    path = PiecewisePolynomial(mesh, nodes, np.array([[0.0, 0.25, -2.0, -1.0, 0.0]]), np.array([[1.0, 0.0]]))
    assert (path(1.0)[0], path.before(1.0)[0], path(3.0)[0], path.before(0.0)[0]) == (-2.0, 1.0, 0.0, 0.0)
    assert (path(1.0, 1)[0], path.before(1.0, 1)[0]) == pytest.approx((1.0, 2.0), abs=1e-14)
    np.testing.assert_allclose(path([0.5, 0.999, 2.0])[0], [0.25, 0.999**2, -1.0], rtol=1e-14)
    assert path.jumps.tolist() == [1]
    times, values = path.line(np.array([0.0, 0.5, 1.0, 3.0]))
    assert times.tolist() == [0.0, 0.5, 1.0, 1.0, 3.0]
    assert values.tolist() == [[0.0, 0.25, 1.0, -2.0, 0.0]]
    assert path.at_parts(np.array([0.0, 1.0]))[0].tolist() == [[[0.0, 1.0], [-2.0, 0.0]]]
    first = path.between(0, 1)
    assert (first(0.5)[0], first(1.0)[0]) == (0.25, 1.0)


def test_a_continuous_path_has_no_jumps():
    path = PiecewisePolynomial(np.array([0.0, 1.0, 3.0]), np.array([0.0, 1.0]), np.array([[0.0, 2.0, 0.0]]))
    assert path.jumps.size == 0
    assert path.before(1.0).tolist() == path(1.0).tolist() == [2.0]


def test_values_may_be_lists_and_must_fit_the_mesh():
    assert PiecewisePolynomial([0.0, 1.0], [0.0, 1.0], [[1.0, 2.0]])(0.5).tolist() == [1.5]
    for values in ([[1.0, 2.0, 3.0]], [1.0, 2.0]):
        with pytest.raises(ValueError, match=r"values at the nodes must have the shape \(d, 2\), got \("):
            PiecewisePolynomial(np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.array(values))
