"""Every row of the table of extremes; the far ends behind the marker `extreme`."""

import numpy as np
import pytest
from paths import script
from slow import slow

import casadi_galerkin as cg

EPS = float(np.finfo(float).eps)
ROUNDOFF = 1e-13  # of a path of O(1) whose problem is well conditioned; measured below 5e-14
extreme = pytest.mark.extreme
extremes = script("extremes")


@pytest.mark.parametrize("degree", [20, 60, pytest.param(100, marks=extreme)])
def test_degree_to_100_at_lobatto_points(degree):
    assert extremes.degree(degree) < ROUNDOFF


@pytest.mark.slow
def test_equispaced_points_lose_digits_from_degree_20_on():
    errors = [extremes.degree(m, cg.equispaced_points) for m in (20, 30)]
    assert ROUNDOFF < errors[0] < 1e-10
    assert errors[1] > 30 * errors[0]


@pytest.mark.slow
def test_equispaced_points_are_useless_at_degree_40():
    with pytest.raises(cg.ConvergenceError, match="no path was found"):
        extremes.degree(40, cg.equispaced_points)


@pytest.mark.parametrize("intervals", [10_000, pytest.param(1_000_000, marks=extreme)])
def test_many_intervals_of_degree_1_leave_only_the_discretization_error(intervals):
    # 0.11 h² is measured from 1e3 intervals on; at 1e6 that is as small as roundoff
    assert extremes.many_intervals(1, intervals) < 0.2 * (2 / intervals) ** 2 + ROUNDOFF


@pytest.mark.parametrize("intervals", [1000, pytest.param(100_000, marks=extreme)])
def test_many_intervals_of_degree_4_are_exact_to_roundoff(intervals):
    assert extremes.many_intervals(4, intervals) < ROUNDOFF


@pytest.mark.parametrize("masses", [10, 100, pytest.param(1000, marks=extreme)])
def test_ring_of_many_masses_moves_as_one(masses):
    assert extremes.ring(masses)[0] < ROUNDOFF


@pytest.mark.parametrize(("few", "many"), [(20, 200), pytest.param(100, 1000, marks=extreme)])
def test_graph_of_a_ring_grows_linearly(few, many):
    """The Hessian's nonzeros and the instructions at a point, not seconds."""
    import casadi as ca

    from casadi_galerkin.functional.pointwise import pointwise

    def size(d):
        x, v = ca.SX.sym("x", d), ca.SX.sym("v", d)
        stretch = x - ca.vertcat(x[1:], x[0])
        value = ca.sumsqr(v) / 2 - ca.sum1(stretch**2) / 2 - ca.sum1(stretch**4) / 4
        functions = pointwise(ca.Function("ring", [ca.SX.sym("t"), x, v], [value]), None)
        return np.array([functions.pattern.nnz(), functions.derivatives.n_instructions()])

    ratio = size(many) / size(few)
    assert np.all(ratio < 1.05 * many / few)


@pytest.mark.parametrize("duration", [70.0, 700.0, pytest.param(7000.0, marks=extreme)])
def test_horizon_of_growing_and_decaying_modes(duration):
    assert extremes.horizon(duration) < ROUNDOFF


@pytest.mark.parametrize(
    "epsilon", [1e-6, 1e-10, pytest.param(1e-8, marks=extreme), pytest.param(1e-12, marks=extreme)]
)
def test_layer_is_resolved_to_its_tolerance(epsilon):
    assert extremes.layer(epsilon, tol=1e-9) < 1e-9


@pytest.mark.parametrize("gap", [1e-6, -1e-6, 1e-10, -1e-10])
def test_conjugate_point_is_approached_to_the_accuracy_of_the_data(gap):
    error, index = extremes.conjugate(gap)
    assert error < 20 * EPS / abs(gap)  # the end and the duration are themselves rounded: some eps/gap
    assert index == (0 if gap > 0 else 1)


@pytest.mark.parametrize("gap", [0.0, 1e-12])
def test_conjugate_point_itself_is_named(gap):
    with pytest.raises(cg.ConjugatePointError):
        extremes.conjugate(gap)


@pytest.mark.parametrize(
    "units",
    [
        {"action": 1e-150},
        {"action": 1e150},
        {"length": 1e-12},
        {"length": 1e12},
        {"duration": 1e-12},
        {"duration": 1e12},
        {"action": 1e150, "length": 1e-12, "duration": 1e12},
    ],
    ids=str,
)
def test_units_change_neither_digits_nor_iterations(units):
    difference, same = extremes.rescaled(**units)
    assert difference < 10 * EPS
    assert same


@pytest.mark.parametrize("decades", [6, *slow(12), pytest.param(15, marks=extreme)])
def test_mesh_graded_over_decades(decades):
    error, momentum_error = extremes.graded(decades)
    assert error < ROUNDOFF
    assert momentum_error < ROUNDOFF


@pytest.mark.parametrize(("distance", "error"), [(1e-2, 1e-11), (1e-3, 1e-10), (1e-4, 1e-8)])
def test_near_collision(distance, error):
    # the angle at which the orbit leaves the pericenter has a condition of 1/distance^2.5 or so
    assert extremes.collision(distance) < error


@pytest.mark.parametrize("distance", [1e-6, *slow(1e-7)])
def test_nearer_collision_is_right_or_called_singular(distance):
    """The second variation is then near roundoff: which of the two it is depends on the last digits."""
    try:
        error = extremes.collision(distance)
    except cg.ConjugatePointError:
        return
    assert error < 1e-8  # as at 1e-4: Newton's steps end in noise of this size


@pytest.mark.parametrize("gap", [1e-2, 1e-4, 1e-6])
def test_bratu_up_to_its_fold(gap):
    error, index = extremes.bratu(gap)
    assert error < 1e-13 + 1e3 * EPS / gap  # λ is rounded; the path moves with 1/gap times that
    assert index == 0


@pytest.mark.parametrize("name", ["log", "root", "division", "speed limit"])
def test_line_search_backs_off_at_the_edge_of_the_domain(name):
    leaves, iterations, _, difference = extremes.edge(name)
    assert leaves, "the case must be one in which a full step leaves the domain"
    assert iterations < 40
    assert difference < 1e-10
