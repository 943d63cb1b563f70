"""Newton's method: iterations that end where they should, in any unit and at any size of the components."""

import casadi as ca
import numpy as np
import pytest
from scenes import BY_NAME, catenoid
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.calculus.roundoff import ZERO
from casadi_galerkin.solvers.newton import damped_newton


@pytest.mark.parametrize("degree", [1, 4, *slow(8)])
def test_a_component_that_vanishes_is_found_from_a_guess_where_it_does_not(degree):
    """Every Newton step takes 16 digits off what is left of it, which relative to itself never is at roundoff."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), [None], [None])
    path = cg.solve(problem, cg.Galerkin(degree), 4, guess=lambda t: [np.sin(t)])
    assert np.abs(path.polynomial.values).max() < ZERO
    assert path.solver == "Newton"


def test_one_component_does_not_end_the_iterations_of_another():
    """A first step that corrects a linear component by much says nothing about a nonlinear one."""

    def lagrangian(t, x, v):
        return ca.dot(v, v) / 2 - x[0] ** 2 / 2 + ca.exp(3 * x[1])

    tr = cg.transcribe(cg.BoundaryProblem(lagrangian, (0, 1), [1.0, 0.0], [2.0, 0.5]), cg.Galerkin(6), 20)
    path = tr.solve()
    s = np.linspace(0, np.pi, path.polynomial.values.shape[1])
    miss = np.array([0.28 * np.sin(s), 1e-3 * np.sin(2 * s)])
    again = tr.solve(guess=path.polynomial.values + miss)
    assert np.max(np.abs(again.polynomial.values - path.polynomial.values)) < 1e-14


def test_components_that_vanish_along_a_periodic_path_are_found_from_afar():
    """Newton's steps shrink them below the least number there is; they are then zero, whatever the last step's size."""

    def lagrangian(t, x, v):
        square = ca.dot(x, x)
        return ca.dot(v, v) / 2 * (1 + square) + 300 * square / 2 + ca.sumsqr(x**2) + 0.8 * ca.sin(2 * t) * x[0]

    free = [None] * 4
    problem = cg.BoundaryProblem(lagrangian, (0, 2 * np.pi), free, free, periodic=True)
    path = cg.solve(problem, cg.Galerkin(8), intervals=8, guess=lambda t: np.sin(t / 2 * np.arange(1, 5)))
    assert np.max(np.abs(path.x[1:])) < 1e-100
    assert path.morse_index == 0


def test_a_hessian_that_is_not_a_number_is_reported_without_a_warning():
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 + 100 * x[0] - 8 * ca.fabs(x[0]) ** 1.5, (0, 1), [0.0], [0.0]
    )
    with pytest.raises(cg.ConvergenceError, match="no path was found") as caught:
        cg.solve(problem, cg.Galerkin(4), intervals=4)
    assert not caught.value.residual <= 50


@pytest.mark.parametrize("half", [0.66, 0.6627])
def test_catenoid_just_below_its_critical_height_is_found(half):
    path = cg.solve(cg.BoundaryProblem(catenoid, (-half, half), [1.0], [1.0]), cg.Galerkin(8), intervals=16)
    c = float(path(0.0)[0])
    assert c * np.cosh(half / c) == pytest.approx(1, rel=1e-12)


def test_where_line_searches_end_free_steps_lead_on(capfd):
    """They begin again from the straight line, and none is longer than this line."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: (
            v[0] ** 2 + v[1] ** 2 / 2 + v[0] * v[1] * ca.cos(x[0] - x[1]) + 20 * ca.cos(x[0]) + 10 * ca.cos(x[1])
        ),
        (0.0, 1.5),
        [-1.0, 0.5],
        [1.5, -1.0],
    )
    transcription = cg.transcribe(problem, cg.Galerkin(4), 8)
    data = transcription.data(transcription.mesh)
    line = transcription.unknowns(transcription.guess_on_mesh(None, transcription.mesh).values.T, data)
    found = damped_newton(transcription.stationarity, line, data, verbose=2)
    numbers = [int(row.split()[0]) for row in capfd.readouterr().out.splitlines()]
    assert numbers.count(1) == 2
    assert found.iterations > numbers[-1]


def test_verbose_prints_iterations_and_summary(capfd):
    path = BY_NAME["short pendulum"].solve(verbose=2)
    out = capfd.readouterr().out
    assert out.count("damping") == path.iterations
    assert "Trajectory of 1 component" in out


def scaled(action, length, time):
    """The pendulum of ten seconds in other units: same iterations and digits in whatever units."""

    def lagrangian(t, x, v):
        return action * ((v[0] * time / length) ** 2 / 2 + ca.cos(x[0] / length))

    return cg.solve(cg.BoundaryProblem(lagrangian, (0, 10 * time), [0.0], [length]), cg.Galerkin(4), intervals=40)


@pytest.mark.parametrize(
    ("action", "length", "time"),
    [(1e-150, 1, 1), (1e150, 1, 1), (1, 1e-12, 1), (1, 1e12, 1), (1, 1, 1e-12), (1, 1, 1e12), (1e-40, 1e12, 1e-12)],
)
def test_units_change_neither_iterations_nor_digits(action, length, time):
    here, there = scaled(1, 1, 1), scaled(action, length, time)
    assert there.iterations == here.iterations
    assert there.morse_index == here.morse_index
    np.testing.assert_allclose(there.x / length, here.x, rtol=0, atol=1e-14)
    assert there.action / (action * time) == pytest.approx(here.action, rel=1e-14)
    momentum = action * time / length
    np.testing.assert_allclose(there.momentum / momentum, here.momentum, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("action", "length", "time"), [(2.0**-500, 1, 1), (1, 2.0**40, 1), (1, 1, 2.0**-40)])
def test_units_that_are_powers_of_two_change_no_bit(action, length, time):
    here, there = scaled(1, 1, 1), scaled(action, length, time)
    np.testing.assert_array_equal(there.x / length, here.x)
    np.testing.assert_array_equal(there.momentum * length / (action * time), here.momentum)


def test_components_of_very_different_size_are_solved_together():
    def lagrangian(t, x, v):
        return (v[0] ** 2 - x[0] ** 2) / 2 + ((v[1] / 1e12) ** 2 - (x[1] / 1e12) ** 2) * 1e-20 / 2

    path = cg.solve(cg.BoundaryProblem(lagrangian, (0, 1), [0, 0], [1e-12, 1e12]), cg.Galerkin(8), intervals=8)
    np.testing.assert_allclose(path.x, np.outer([1e-12, 1e12], np.sin(path.t) / np.sin(1)), rtol=1e-13, atol=0)


@pytest.mark.slow
def test_ends_that_are_conjugate_fail_without_a_warning():
    """The end is the start turned by the oscillator's own phase: the direction of smallest curvature is of any size."""
    c, s = np.cos(np.pi / 3), np.sin(np.pi / 3)
    turned = cg.BoundaryProblem(
        lambda t, x, v: (ca.sumsqr(v) - ca.sumsqr(x)) / 2 - x[0] * ca.cos(3 * t) - x[1] * ca.sin(3 * t),
        (0.0, np.pi / 3),
        [None, None],
        [None, None],
        end_conditions=lambda a, b: b - ca.vertcat(c * a[0] - s * a[1], s * a[0] + c * a[1]),
    )
    with pytest.raises(cg.ConvergenceError):
        cg.solve(turned, cg.Galerkin(6), 8)


@pytest.mark.parametrize(("half_periods", "after", "said"), [(1, -1e-9, "roundoff floor"), (3, 1e-13, "conjugate")])
@pytest.mark.slow
def test_steps_that_are_roundoff_next_to_a_conjugate_point_end_the_iterations(half_periods, after, said):
    """They are as long as eps over the second variation, and do not shrink."""
    end = half_periods * np.pi + after
    oscillator = cg.BoundaryProblem(lambda t, x, v: (v[0] ** 2 - x[0] ** 2) / 2, (0, end), [0.0], [np.sin(end)])
    with pytest.raises(cg.ConvergenceError, match=said) as caught:
        cg.solve(oscillator, tol=1e-9)
    assert caught.value.iterations < 40


def test_a_search_that_ends_at_a_singular_hessian_fails_without_a_warning():
    """The next damping is not forecast from a step that does not exist."""
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: ca.dot(v, v) / 2 - (x[1] - 1 - ca.sin(p[0] * (x[0] - 1)) / p[0]) ** 2 * 5,
        (0.0, 1.0),
        [None, None],
        [None, None],
        parameters=[1.0],
    )
    transcription = cg.transcribe(problem, cg.Galerkin(1), 1)
    for angle in np.linspace(0.05, 5, 10):
        near = [1 + np.cos(angle), 1 + np.sin(np.cos(angle)) + 0.01]
        with pytest.raises(cg.ConvergenceError):
            transcription.solve(guess=lambda t, near=near: near)


HOW = [{"method": cg.Galerkin(4), "intervals": 5}, {"tol": 1e-9}]


@pytest.mark.parametrize("how", HOW, ids=["mesh", "tol"])
@pytest.mark.parametrize(("magnetic", "electric"), [(0.3, 0.21), *slow((2.1, 0.9))])
def test_a_component_whose_forces_cancel_is_zero(magnetic, electric, how):
    """A velocity filter: the line through crossed fields is straight, and rounding is all that is beside it."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 + magnetic * x[0] * v[1] + electric * x[1],
        (0.0, 2.0),
        [0.0, 0.0],
        [2 * electric / magnetic, 0.0],
    )
    path = cg.solve(problem, **how)
    np.testing.assert_allclose(path.x, [electric / magnetic * path.t, 0 * path.t], rtol=1e-14, atol=0)
    assert path.morse_index == 0


@pytest.mark.parametrize("how", HOW, ids=["mesh", "tol"])
@pytest.mark.parametrize(("mass", "stiffness"), [(1.7, 11.0), *slow((2.3, 110.0))])
def test_rest_at_the_origin_is_found_where_constants_cancel(mass, stiffness, how):
    """A weight on a spring, x counted from where it hangs: nothing but rounding is left of both forces.

    It hangs from a cart that rolls sideways on a spring of its own.
    """

    def lagrangian(t, x, v):
        springs = stiffness * (x[0] + mass * 9.81 / stiffness) ** 2 / 2 + 3 * x[1] ** 2
        return mass * ca.sumsqr(v) / 2 - springs + mass * 9.81 * x[0]

    path = cg.solve(cg.BoundaryProblem(lagrangian, (0.0, 1.0), [0.0, 0.2], [0.0, 1.0]), **how)
    np.testing.assert_allclose(path.x[0], 0.0, rtol=0, atol=1e-15)
    assert path.morse_index == np.sum(np.floor(np.sqrt([stiffness / mass, 6 / mass]) / np.pi))


@pytest.mark.parametrize(
    ("place", "pull"), [(0.34851028435304277, 9.469327236237842), (0.2578, 3.7704), (0.0566, 10.655)]
)
@pytest.mark.slow
def test_a_kink_is_not_taken_for_rounding(place, pull):
    """Its Hessian is the same on both sides, as it is where terms cancel: all was set to zero, with the ends."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - pull * ca.fabs(x[0] - place), (0.0, 2.0), [1.0], [-0.5]
    )
    path = cg.solve(problem, tol=1e-5)
    assert (path(0.0)[0], path(2.0)[0]) == (1.0, -0.5)
    assert len(path.t) < 1000


@pytest.mark.parametrize("how", [HOW[0], {"tol": 1e-4}], ids=["mesh", "tol"])
@pytest.mark.parametrize(("duration", "end"), [(2.0, None), *slow((1.5, 0.0))])
def test_a_kink_at_zero_does_not_hold_what_is_pulled_away(duration, end, how):
    """Where a zero was rounded as a number of size one, the whole kink counted as rounding."""

    def pulled(size):
        return lambda t, x, v: v[0] ** 2 / 2 - size(x[0]) + 2.5 * ca.sin(2 * np.pi * t / duration + 0.4) * x[0]

    sharp = cg.solve(cg.BoundaryProblem(pulled(ca.fabs), (0.0, duration), [0.0], [end]), **how)
    rounded = cg.BoundaryProblem(pulled(lambda x: ca.sqrt(x**2 + 1e-6)), (0.0, duration), [0.0], [end])
    smooth = cg.solve(rounded, tol=1e-6, guess=sharp)
    times = np.linspace(0, duration, 50)
    np.testing.assert_allclose(sharp(times), smooth(times), rtol=0, atol=0.05 * np.max(np.abs(smooth.x)))


@pytest.mark.parametrize("how", HOW, ids=["mesh", "tol"])
@pytest.mark.parametrize("drift", [1e-15, 1e-9])
def test_a_weight_that_hangs_beside_the_origin_is_not_taken_for_one_at_rest(drift, how):
    """Its spring is as much longer as the swing beside it is wide, which takes a few iterations."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2 - 3 * (x[0] - drift) ** 2 + drift**2 * ca.cos(3 * x[1] / drift),
        (0.0, 1.0),
        [0.0, 0.1 * drift],
        [0.0, 0.9 * drift],
    )
    path = cg.solve(problem, **how)
    exact = drift * (1 - 1 / np.cos(np.sqrt(6) / 2))
    assert path(0.5)[0] == pytest.approx(exact, rel=1e-4)


@pytest.mark.parametrize("how", HOW, ids=["mesh", "tol"])
@pytest.mark.parametrize("place", [0.0, 0.7])
def test_rest_in_a_magnetic_field_is_found(place, how):
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 + 0.3 * ca.sin(x[0]) * v[1] - ((x[0] - place) ** 2 + x[1] ** 2) / 2,
        (0.0, 2.0),
        [None, None],
        periodic=True,
    )
    path = cg.solve(problem, **how)
    np.testing.assert_allclose(path.x, np.array([[place], [0.0]]) + 0 * path.t, rtol=1e-14, atol=1e-300)


@pytest.mark.parametrize("how", HOW, ids=["mesh", "tol"])
@pytest.mark.parametrize("count", [4, *slow(6)])
def test_a_ring_of_masses_breathes_from_ends_of_cosines_and_sines(count, how):
    """Some of these are rounding alone, like sin(π); the pulls of two neighbors cancel across them."""
    angles = 2 * np.pi * np.arange(count) / count
    circle = np.array([*np.cos(angles), *np.sin(angles)])
    pull = 2 * np.sin(np.pi / count)  # a side of the ring over its radius

    def ring(t, x, v):
        places = [ca.vertcat(x[i], x[count + i]) for i in range(count)]
        sides = [ca.norm_2(places[i] - places[i - 1]) for i in range(count)]
        return ca.dot(v, v) / 2 - sum((side - 1) ** 2 for side in sides) / 2

    def radius(t, x, v):
        return count * (v[0] ** 2 - (pull * x[0] - 1) ** 2) / 2

    path = cg.solve(cg.BoundaryProblem(ring, (0, 0.7), circle, 1.3 * circle), **how)
    exact = cg.solve(cg.BoundaryProblem(radius, (0, 0.7), [1.0], [1.3]), tol=1e-12)
    np.testing.assert_allclose(path.x, circle[:, None] * exact(path.t), rtol=0, atol=1e-9)
    assert path.morse_index == exact.morse_index


@pytest.mark.parametrize("tol", [1e-3, *slow(1e-9)])
@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("rest", [None, 0.5])
@pytest.mark.parametrize("unit", [1e-9, *slow(1.0)])
def test_a_path_along_an_axis_of_symmetry_is_found(unit, rest, friction, tol):
    """The pulls of three anchors cancel across the axis within the derivatives of L, which tell nothing of their size.

    The anchors attract by a softened gravity, or hold springs of some length at rest; sideways is in another unit.
    """
    angles = 2 * np.pi * np.arange(3) / 3

    def potential(along, across):
        squares = [(along - np.cos(a)) ** 2 + (across - np.sin(a)) ** 2 for a in angles]
        if rest is None:
            return -sum(1 / ca.sqrt(0.3 + square) for square in squares)
        return sum((ca.sqrt(square) - rest) ** 2 for square in squares)

    def plane(t, x, v):
        return (v[0] ** 2 + (v[1] / unit) ** 2) / 2 - potential(x[0], x[1] / unit)

    def line(t, x, v):
        return v[0] ** 2 / 2 - potential(x[0], 0.0)

    def drag(t, x, v):
        return -friction * ca.vertcat(v[0], *([v[1] / unit**2] if v.numel() > 1 else []))

    force = drag if friction else None
    exact = cg.solve(cg.BoundaryProblem(line, (0, 2), [0.1], [0.3], force=force), tol=1e-11)
    path = cg.solve(cg.BoundaryProblem(plane, (0, 2), [0.1, 0.0], [0.3, 0.0], force=force), tol=tol)
    times = np.linspace(0, 2, 50)
    assert np.max(np.abs(path(times)[0] - exact(times)[0])) <= tol * np.max(exact.x)
    assert np.max(np.abs(path(times)[1])) <= 1e-14 * unit


SYMMETRIC = {  # L, and how many components besides the first are zero by symmetry
    "uncoupled": (lambda t, x, v: ca.sumsqr(v) / 2 - ca.cos(x[0]) - x[1] ** 2 / 2, 1),
    "central": (lambda t, x, v: ca.sumsqr(v) / 2 + 1 / ca.norm_2(x), 1),
    "angles": (lambda t, x, v: (v[0] ** 2 + ca.sin(x[0]) ** 2 * v[1] ** 2) / 2 - ca.cos(x[0]), 1),
    "cosines": (lambda t, x, v: ca.sumsqr(v) / 2 - ca.cos(x[0] + x[1]) - ca.cos(x[0] - x[1]), 1),
    "quartic": (lambda t, x, v: ca.sumsqr(v) / 2 - (x[0] + x[1]) ** 4 / 4 - (x[0] - x[1]) ** 4 / 4, 1),
    "three": (
        lambda t, x, v: ca.sumsqr(v) / 2 - ca.cos(x[0] + x[1] - x[2]) - ca.cos(x[0] - x[1] + x[2]) - ca.sumsqr(x),
        2,
    ),
}


@pytest.mark.parametrize("how", [HOW[0], *slow(HOW[1])], ids=["mesh", "tol"])
@pytest.mark.parametrize("beside", [1e-3, *slow(0.3)])
@pytest.mark.parametrize("name", SYMMETRIC)
def test_a_component_is_exactly_zero_where_its_guess_is_not(name, beside, how):
    """What rounding left of it counted by its own size: 200 iterations, no path, or another one far away."""
    lagrangian, zeros = SYMMETRIC[name]
    problem = cg.BoundaryProblem(lagrangian, (0, 1), [1.0] + [0.0] * zeros, [0.5] + [0.0] * zeros)
    path = cg.solve(problem, guess=lambda t: [1 - t / 2] + [beside * np.sin(np.pi * t)] * zeros, **how)
    straight = cg.solve(problem, **how)
    assert not np.any(path.x[1:])
    assert path.iterations <= 25
    np.testing.assert_allclose(path(np.linspace(0, 1, 9)), straight(np.linspace(0, 1, 9)), rtol=1e-9, atol=0)


@pytest.mark.parametrize("tol", [1e-6, *slow(1e-10)])
@pytest.mark.parametrize("beside", [1e-6, *slow(1e-9)])
def test_a_small_component_is_as_accurate_as_its_estimate_where_terms_of_others_cancel(beside, tol):
    """The derivatives of L by it are differences of sines: their rounding hides some of its digits."""
    ends = [1.0, beside], [0.5, 1.3 * beside]
    problem = cg.BoundaryProblem(SYMMETRIC["cosines"][0], (0, 1), *ends)
    if tol < 1e-16 / beside:
        with pytest.raises(cg.LimitReached, match="is the roundoff floor here"):
            cg.solve(problem, tol=tol)
        return
    path, times = cg.solve(problem, tol=tol), np.linspace(0, 1, 101)
    products = cg.BoundaryProblem(lambda t, x, v: ca.sumsqr(v) / 2 - 2 * ca.cos(x[0]) * ca.cos(x[1]), (0, 1), *ends)
    exact = cg.solve(products, cg.Galerkin(14), 8)
    error = np.max(np.abs(path(times) - exact(times)), axis=1) / np.max(np.abs(exact(times)), axis=1)
    assert np.max(error) <= 2 * path.error_estimate  # rounding is estimated to a factor
    assert path.error_estimate <= tol


@pytest.mark.parametrize(("force", "size"), [(1e-17, 0.0), (1e-13, -1e-13 / 8)])
def test_a_component_that_is_not_above_the_rounding_of_the_others_is_zero(force, size):
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2 - ca.cos(x[0]) + force * x[1], (0, 1), [1.0, 0.0], [0.5, 0.0]
    )
    path = cg.solve(problem, cg.Galerkin(4), 5, guess=lambda t: [1 - t / 2, 0.3 * t * (1 - t)])
    np.testing.assert_allclose(path(0.5)[1], size, rtol=1e-12)
