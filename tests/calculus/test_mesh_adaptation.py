"""What a piecewise polynomial leaves out is found where it is, and new meshes spread it evenly."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.polynomial import legendre

import casadi_galerkin as cg
from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus
from casadi_galerkin.calculus.mesh_adaptation import (
    ERROR_TARGET,
    MOST_PARTS_OF_AN_INTERVAL,
    NEIGHBOR_RATIO,
    equidistributed,
    largest_change,
    parts_wanted,
    resized_mesh,
    truncation_error,
)
from casadi_galerkin.calculus.roundoff import component_sizes

SHARP = 30.0  # the estimate may be this factor off the true interpolation error; measured up to 23
ROUNDOFF = 2e-15


def better(mesh, error, order, tol, **options):
    return equidistributed(mesh, parts_wanted(error, order, tol), **options)


def interpolated(function, degree, mesh):
    calculus = DiscreteCalculus(cg.Galerkin(degree), mesh)
    return calculus.emb(np.atleast_2d(function(calculus.node_times)))


def spike(width):
    return lambda t: 1 / (1 + ((t - 0.3) / width) ** 2)


@pytest.mark.parametrize("degree", [4, 5, 8, 11])
@pytest.mark.parametrize("function", [np.exp, np.sin, lambda t: np.cos(3 * t), spike(0.5)])
def test_truncation_is_near_the_interpolation_error(degree, function):
    mesh = np.linspace(0, 1, 4)
    path = interpolated(function, degree, mesh)
    for k, estimate in enumerate(truncation_error(path)):
        t = np.linspace(mesh[k], mesh[k + 1], 101)
        error = np.max(np.abs(path(t)[0] - function(t))) / component_sizes(path.values)[0]
        assert (error - ROUNDOFF) / SHARP < estimate < error * SHARP + ROUNDOFF


def test_what_an_even_path_leaves_out_is_seen_at_an_odd_degree():
    """Its last Legendre coefficient is zero."""
    path = interpolated(np.cos, 5, [-1.0, 1.0])
    times = np.linspace(-1, 1, 101)
    assert truncation_error(path)[0] > np.max(np.abs(path(times)[0] - np.cos(times))) / 10


def test_truncation_of_a_polynomial_is_roundoff():
    path = interpolated(lambda t: 1 + t**3, 6, np.linspace(0, 2, 6))
    assert np.max(truncation_error(path)) < 1e-15


def test_truncation_does_not_see_the_unit_of_a_component():
    mesh = np.linspace(0, 1, 5)
    path = interpolated(lambda t: np.array([np.sin(9 * t), np.cos(7 * t)]), 5, mesh)
    scaled = interpolated(lambda t: np.array([1e9 * np.sin(9 * t), 1e-9 * np.cos(7 * t)]), 5, mesh)
    np.testing.assert_allclose(truncation_error(scaled), truncation_error(path), rtol=1e-9, atol=0)


def test_no_more_is_left_out_than_the_last_coefficient_where_coefficients_do_not_fall():
    highest = interpolated(lambda t: legendre.legval(2 * t - 1, [0, 0, 0, 0, 0, 1]), 5, [0.0, 1.0])
    assert truncation_error(highest)[0] == pytest.approx(1, rel=1e-12)


@pytest.mark.parametrize("degree", [1, 2])
def test_a_single_interval_of_low_degree_leaves_out_no_more_than_is_told(degree):
    path = interpolated(np.exp, degree, [0.0, 1.0])
    times = np.linspace(0, 1, 101)
    (told,) = truncation_error(path)
    assert told >= np.max(np.abs(path(times)[0] - np.exp(times))) / np.e


def test_size_of_a_vanishing_component_is_one():
    path = interpolated(lambda t: np.array([0 * t, 3 - t]), 4, np.linspace(0, 1, 3))
    np.testing.assert_array_equal(component_sizes(path.values), [1.0, 3.0])


def test_the_largest_change_may_lie_between_the_nodes():
    """It is a tenth of the first component, and less of the second, which changes more but is larger."""
    path = interpolated(lambda t: [10 + t / 1e3, 40 + t], 1, np.linspace(0, 3, 4))
    change = interpolated(lambda t: [np.sin(np.pi * t), 2 * np.sin(np.pi * t)], 3, path.mesh)
    expected = abs(float(change(1.5)[0])) / np.max(np.abs(path.values[0]))
    assert largest_change(path, change.nodes, change.values) == pytest.approx(expected, rel=1e-3)


def test_an_even_mesh_with_an_error_on_target_stays():
    mesh = np.linspace(0, 1, 11)
    np.testing.assert_allclose(better(mesh, np.full(10, ERROR_TARGET * 1e-6), 5, 1e-6), mesh, rtol=0, atol=1e-15)


def test_interpolation_on_the_new_mesh_meets_the_tolerance():
    """A spike of width 1e-3 is found from eight intervals, and the mesh grades towards it."""
    mesh, tol, degree = np.linspace(0, 1, 9), 1e-8, 8
    for _ in range(30):
        path = interpolated(spike(1e-3), degree, mesh)
        error = truncation_error(path)
        if error.max() <= tol:
            break
        mesh = better(mesh, error, degree + 1, tol)
    t = np.concatenate([np.linspace(a, b, 30) for a, b in pairwise(mesh)])
    assert np.max(np.abs(path(t)[0] - spike(1e-3)(t))) <= 5 * tol
    shortest = np.argmin(np.diff(mesh))
    assert abs(mesh[shortest] - 0.3) < 1e-2
    assert len(mesh) < 100


@pytest.mark.parametrize("seed", range(20))
def test_new_meshes_increase_keep_their_ends_and_grade_gently(seed):
    random = np.random.default_rng(seed)
    mesh = np.cumsum(random.uniform(0.5, 2.0, 12))
    error = 10.0 ** random.uniform(-14, 0, 11)
    new = better(mesh, error, 6, 1e-6)
    steps = np.diff(new)
    assert new[0] == mesh[0]
    assert new[-1] == mesh[-1]
    assert np.all(steps > 0)
    assert len(new) - 1 <= MOST_PARTS_OF_AN_INTERVAL * 11 + 1
    # densities of old neighbors differ by at most this, and a new interval may straddle two joints
    assert np.max(np.maximum(steps[1:] / steps[:-1], steps[:-1] / steps[1:])) <= NEIGHBOR_RATIO**2


@pytest.mark.parametrize("order", [1, -1])
def test_intervals_grow_shorter_and_longer_step_by_step(order):
    error = np.repeat([1e-16, 1e6], 5)[::order]
    steps = np.diff(better(np.linspace(0, 1, 11), error, 6, 1e-6))
    assert np.max(np.maximum(steps[1:] / steps[:-1], steps[:-1] / steps[1:])) <= NEIGHBOR_RATIO


@pytest.mark.parametrize("mesh", [np.linspace(0, 1, 22), np.array([0.0, 1.0, 1.001, 2.0])], ids=["even", "narrow"])
def test_an_error_of_any_size_splits_its_interval_and_the_next_ones_so_far(mesh):
    middle = len(mesh) // 2 - 1
    error = np.zeros(len(mesh) - 1)
    error[middle] = 1e300
    parts, _ = np.histogram(better(mesh, error, 6, 1e-6), mesh)
    assert MOST_PARTS_OF_AN_INTERVAL - 1 <= parts[middle] <= MOST_PARTS_OF_AN_INTERVAL + 1
    assert np.max(parts) <= MOST_PARTS_OF_AN_INTERVAL + 1
    assert np.sum(parts[: max(middle - 3, 0)]) <= middle


def test_a_mesh_grows_by_a_quarter_at_least():
    error = np.full(100, 1.1 * ERROR_TARGET * 1e-3)
    assert len(better(np.linspace(0, 1, 101), error, 6, 1e-3)) == 126


def test_too_fine_a_mesh_is_made_coarser():
    mesh = np.linspace(0, 1, 101)
    assert len(better(mesh, np.full(100, 1e-15), 6, 1e-3)) < 40
    assert len(better(mesh, np.full(100, 0.1 * ERROR_TARGET * 1e-3), 6, 1e-3)) == 101  # the graph is kept


@pytest.mark.parametrize("halved", [False, True])
def test_breakpoints_take_no_joint_from_an_interval_that_is_to_be_split(halved):
    """Only the last of five parts needs more intervals; where joints are moved onto breakpoints, it may get none."""
    breakpoints = (0.1, 0.3, 0.5, 0.8)
    mesh = np.array([0.0, *breakpoints, 1.0])
    mesh = np.sort(np.append(mesh, (mesh[1:] + mesh[:-1]) / 2)) if halved else mesh
    error = np.where(mesh[:-1] >= 0.8, ERROR_TARGET * 1e-6 * 1.9**6, 1e-16)
    new = better(mesh, error, 6, 1e-6, breakpoints=breakpoints)
    assert set(breakpoints) <= set(new)
    assert np.all(np.diff(new) > 0)
    assert np.sum(new > 0.8) >= 1.9 * np.sum(mesh > 0.8)


@pytest.mark.parametrize("breakpoints", [(0.31,), (0.3, 0.31, 0.32), (0.999,), (0.001, 0.5)])
def test_joints_that_are_graded_alike_hold_the_breakpoints(breakpoints):
    mesh = resized_mesh(np.linspace(0.0, 1.0, 8), 7, breakpoints)
    assert set(breakpoints) <= set(mesh.tolist())
    assert np.all(np.diff(mesh) > 0)
    assert (len(mesh), mesh[0], mesh[-1]) == (8, 0.0, 1.0)


def test_a_mesh_that_is_halved_keeps_its_joints():
    mesh = np.array([0.0, 0.1, 0.3, 0.31, 1.0])
    for breakpoints in ((), (0.3,), (0.1, 0.31)):
        halved = resized_mesh(mesh, 8, breakpoints)
        assert np.array_equal(halved[::2], mesh)
        np.testing.assert_allclose(halved[1::2], (mesh[1:] + mesh[:-1]) / 2, rtol=1e-15)
