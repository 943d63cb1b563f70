"""Velocities from momenta, also where the slopes of the path do not help, or no velocity exists."""

import casadi as ca
import numpy as np
import pytest

import casadi_galerkin as cg
from casadi_galerkin.problems.legendre_transform import convex, legendre_transform
from casadi_galerkin.problems.legendre_transform import velocities as velocities_of_momenta


def test_velocities_are_found_where_the_slopes_of_the_path_are_beyond_the_lagrangians_domain():
    """A relativistic particle on few intervals: the derivative of the polynomial exceeds 1 at a joint."""
    problem = cg.BoundaryProblem(lambda t, x, v: -ca.sqrt(1 - v[0] ** 2) - 5 * x[0] ** 2, (0, 2), [0.0], [1.2])
    path = cg.solve(problem, cg.Galerkin(2), intervals=4)
    assert np.max(np.abs(path(path.t, 1))) > 1
    np.testing.assert_allclose(path.velocity, path.momentum / np.sqrt(1 + path.momentum**2), rtol=1e-14)
    assert np.isfinite(path.energy).all()


def test_a_velocity_that_does_not_exist_is_not_a_number():
    t, x, v = (ca.SX.sym(name) for name in "txv")
    lagrangian = ca.Function("L", [t, x, v], [ca.sqrt(1 + v**2)])  # momenta lie within ]-1, 1[
    momenta = np.array([[0.5, 2.0, -0.5]])
    found = velocities_of_momenta(
        legendre_transform(lagrangian), np.zeros(3), np.zeros((1, 3)), momenta, np.full((1, 3), 30.0)
    )
    np.testing.assert_allclose(found, [[1 / np.sqrt(3), np.nan, -1 / np.sqrt(3)]], rtol=1e-14)


def test_a_velocity_that_passes_through_zero_in_one_component_is_found():
    """Its momentum is roundoff there, and the velocity settles to the roundoff of the other component."""
    swing = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 - 9.81 * x[1],
        (0.0, 0.5),
        [-np.sin(0.5), -np.cos(0.5)],
        [np.sin(0.5), -np.cos(0.5)],
        constraint=lambda t, x: ca.dot(x, x) - 1,
    )
    path = cg.solve(swing, cg.Galerkin(4), 10, guess=lambda t: [np.sin(2 * t - 0.5), -np.cos(2 * t - 0.5)])
    np.testing.assert_allclose(path.velocity, path.momentum, rtol=0, atol=1e-15)


@pytest.mark.slow
def test_rest_is_found_from_any_slow_guess():
    """Nothing is small beside a velocity of zero: what is left of a guess is measured by the guess."""
    problem = cg.InitialProblem(
        lambda t, x, v: 0.65 * v[0] ** 2 + 0.15 * v[0] * v[1] * ca.cos(x[1]) + 0.0375 * v[1] ** 2,
        (0, 1),
        [0.0, 0.0],
        velocity=[0.0, 0.0],
    )
    transform, count = legendre_transform(problem.lagrangian), 500
    guess, zero = 1e-4 * np.random.default_rng(1).normal(size=(2, count)), np.zeros((2, count))
    velocities = velocities_of_momenta(transform, zero[0], zero, zero, guess)
    np.testing.assert_allclose(velocities, 0, rtol=0, atol=1e-18)


def test_where_the_mass_vanishes_the_velocity_is_the_slope_of_the_path():
    """The Lane-Emden equation of index 1, θ = sin r / r: at the center any velocity has the momentum 0."""
    problem = cg.BoundaryProblem(
        lambda r, x, v: r**2 * (v[0] ** 2 / 2 - x[0] ** 2 / 2), (0.0, 3.0), [None], [np.sin(3.0) / 3.0]
    )
    path = cg.solve(problem, cg.Galerkin(8), 10)
    r = path.t[1:]
    np.testing.assert_allclose(path.velocity[0, 1:], np.cos(r) / r - np.sin(r) / r**2, rtol=1e-12)
    np.testing.assert_allclose(path.velocity[0, 0], 0.0, atol=1e-8)
    assert abs(path.energy[0]) < 1e-20


def test_rest_is_found_where_its_momentum_is_not_zero():
    """Under a magnetic term p = M v + A(x): the rounding of p is all that a velocity of zero has to be measured by."""
    mass, x = ca.DM([[5.7, -2.1], [-2.1, 2.4]]), np.random.default_rng(1).uniform(-1, 1, (2, 500))
    potential = ca.DM([[-0.27, -0.0071], [0.037, -0.19]])
    problem = cg.InitialProblem(
        lambda t, x, v: ca.bilin(mass, v, v) / 2 + ca.bilin(potential, ca.sin(x), v), (0, 1), [0, 0], velocity=[0, 0]
    )
    zero, at_rest = np.zeros(x.shape), potential.full().T @ np.sin(x)
    rounded = at_rest * (1 + np.random.default_rng(2).choice([-1, 1], x.shape) * np.finfo(float).eps)
    found = velocities_of_momenta(legendre_transform(problem.lagrangian), zero[0], x, rounded, zero)
    np.testing.assert_allclose(found, 0, rtol=0, atol=1e-15)


def test_a_component_at_rest_is_found_beside_a_momentum_larger_than_its_velocity():
    """In a rotating frame; its guess is off by less than what settles the other component."""
    t, x, v = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("v", 2)
    turning = ca.Function("L", [t, x, v], [ca.dot(v, v) / 2 + x[0] * v[1] - x[1] * v[0]])
    place, momentum, guess = (np.array([a]).T for a in ([0.8, 0.0], [1.00e-14, 1.02], [1.07e-14, 0.22]))
    found = velocities_of_momenta(legendre_transform(turning), np.zeros(1), place, momentum, guess)
    np.testing.assert_allclose(found.ravel(), [1e-14, 0.22], rtol=0, atol=1e-15)


@pytest.mark.parametrize("unit", [1.0, 1e8, 1e12, 1e24])
def test_velocities_are_found_in_any_units(unit):
    """A velocity that is counted in larger units has a mass as many times smaller, squared: no direction is lost."""
    t, x, v = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("v", 2)
    scaled = v * ca.DM([1.0, unit])
    transform = legendre_transform(ca.Function("L", [t, x, v], [ca.sumsqr(scaled) / 2 + scaled[0] * scaled[1] / 2]))
    expected = np.array([[0.7], [-1.3 / unit]])
    zero = np.zeros((2, 1))
    momentum = np.array(transform(0, zero, expected)[0])
    found = velocities_of_momenta(transform, zero[0], zero, momentum, zero)
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    assert convex(transform, zero[0], zero, zero)
