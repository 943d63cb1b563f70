"""Shooting: the same path as the global solve where it can, a failure with its measure where it cannot."""

import casadi as ca
import numpy as np
import pytest
from motions import kepler
from scenes import pendulum, saddle
from scipy.special import ellipk
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.stepping.shooting import MISS, _met
from casadi_galerkin.stepping.shooting_residual import Shooting, accumulated

SAME = 1e-12  # the same discrete equations solved in two ways; conditions below 100


def varying_mass(t, x, v):
    return (1 + x[0] ** 2 * ca.exp(-t)) * v[0] ** 2 / 2 - x[0] ** 4 / 4


def driven(t, x, v):
    return v[0] ** 2 / 2 - x[0] ** 2 + x[0] * ca.cos(t)


def plane(t, x, v):
    return ca.dot(v, v) / 2 + x[0] * v[1] - x[0] ** 2 - x[1] ** 4 / 4 + x[1] * ca.cos(t)


PROBLEMS = {
    "pendulum": cg.BoundaryProblem(pendulum, (0, 1), [0.0], [1.0]),
    "varying mass": cg.BoundaryProblem(varying_mass, (0, 2), [1.0], [-0.5]),
    "kepler": cg.BoundaryProblem(kepler, (0, 1.4), [1.0, 0.0], [0.1, 1.1]),
    "free end": cg.BoundaryProblem(saddle, (0, 1), [1.0], [None]),
    "free start": cg.BoundaryProblem(saddle, (0, 1), [None], [1.0]),
    "mixed ends": cg.BoundaryProblem(plane, (0, 1), [None, 1.0], [0.5, None]),
    "parameters": cg.BoundaryProblem(
        lambda t, x, v, p: p[0] * v[0] ** 2 / 2 + ca.cos(x[0]), (0, 1), [0.0], [1.0], parameters=[2.0]
    ),
    "periodic": cg.BoundaryProblem(driven, (0, 2 * np.pi), [None], periodic=True),
    "periodic through a point": cg.BoundaryProblem(driven, (0, 2), [0.3], periodic=True),
    "periodic plane through a line": cg.BoundaryProblem(plane, (0, 2), [0.1, None], periodic=True),
}


def test_breakpoints_are_joints_of_a_shot_path():
    def switched(t, x, v):
        return v[0] ** 2 / 2 - x[0] ** 2 / 2 + ca.if_else(t < 1.1, 0.0, 1.0) * x[0]

    problem = cg.BoundaryProblem(switched, (0, 2), [0.0], [1.0], breakpoints=[1.1])
    shot, whole = (way(problem, cg.Galerkin(3), 5) for way in (cg.shoot, cg.solve))
    np.testing.assert_array_equal(shot.t, whole.t)
    np.testing.assert_allclose(shot.x, whole.x, rtol=0, atol=SAME)


@pytest.mark.parametrize("name", PROBLEMS)
def test_shooting_finds_the_global_path(name):
    problem, method = PROBLEMS[name], cg.Galerkin(5)
    mesh = problem.t_span[1] * np.linspace(0, 1, 11) ** 1.3
    shot, whole = (way(problem, method, mesh=mesh) for way in (cg.shoot, cg.solve))
    for ours, theirs in ((shot.x, whole.x), (shot.momentum, whole.momentum)):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=SAME * np.max(np.abs(theirs)))
    assert shot.morse_index is None
    assert shot.iterations <= 20
    assert "single shooting" in str(shot)


def test_lamberts_problem_in_kilometers_and_seconds():
    # D. A. Vallado, "Fundamentals of Astrodynamics and Applications", 4th edition, example 5.7
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 + 398600.4418 / ca.norm_2(x),
        (0, 4560),
        [15945.34, 0, 0],
        [12214.83899, 10249.46731, 0],
    )
    path = cg.shoot(problem, cg.Galerkin(8), intervals=20)
    np.testing.assert_allclose(path.velocity[:, 0], [2.058913, 2.915965, 0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(path.velocity[:, -1], [-3.451565, 0.910315, 0], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_a_guess_chooses_among_several_paths():
    problem = cg.BoundaryProblem(pendulum, (0, 10), [0.0], [1.0])
    for start in (1.9995687170165, 1.8318277309911, 1.3287479250456):
        guess = cg.solve(cg.InitialProblem(pendulum, (0, 10), [0.0], velocity=[start + 1e-7]), cg.Galerkin(6), 40)
        path = cg.shoot(problem, cg.Galerkin(6), 40, guess=guess)
        assert path.momentum[0, 0] == pytest.approx(start, abs=2e-11)  # the digits known, and the mesh's error
        assert "guess" not in path.solver


def test_products_of_jacobians_are_the_derivative_of_the_whole_path():
    method, mesh, difference = cg.Galerkin(3), np.linspace(0, 2, 8), 1e-5

    def states(x, p):
        path = cg.solve(cg.InitialProblem(pendulum, (0, 2), [x], momentum=[p]), method, mesh=mesh)
        return np.concatenate((path.x, path.momentum))

    problem = cg.InitialProblem(pendulum, (0, 2), [0.5], momentum=[1.0])
    product = accumulated(cg.geometry(cg.solve(problem, method, mesh=mesh)).jacobians)
    by_x = (states(0.5 + difference, 1.0) - states(0.5 - difference, 1.0)) / (2 * difference)
    by_p = (states(0.5, 1.0 + difference) - states(0.5, 1.0 - difference)) / (2 * difference)
    np.testing.assert_allclose(product[:, :, 0].T, by_x, rtol=0, atol=1e-8)
    np.testing.assert_allclose(product[:, :, 1].T, by_p, rtol=0, atol=1e-8)


def test_a_saddle_costs_the_digits_that_its_growth_says():
    problem = cg.BoundaryProblem(saddle, (0, 16), [1.0], [1.0])
    path = cg.shoot(problem, cg.Galerkin(8), intervals=32)
    error = np.max(np.abs(path.x[0] - np.cosh(path.t - 8) / np.cosh(8)))
    assert 1e-14 < error < np.exp(16) * 2.3e-16  # e^16 eps = 2e-9


@pytest.mark.parametrize("horizon", [10, *slow(17)])
def test_residual_holds_the_miss_over_what_rounding_becomes_at_the_end(horizon):
    """Rounding x_i by eps moves the end by eps cosh(T - t_i), p_i by eps sinh(T - t_i)."""
    problem = cg.BoundaryProblem(saddle, (0, horizon), [1.0], [1.0])
    path = cg.shoot(problem, cg.Galerkin(8), intervals=2 * horizon)
    start = np.array([1.0, path.momentum[0, 0] + 1e-3])
    shot = Shooting(problem, path.method, path.t).shoot(start, path.velocity[:, 0])
    for x, p, residual in ((path.x, path.momentum, path.residual), (shot.roll.x, shot.roll.p, shot.residual)):
        left = horizon - path.t
        carried = np.cosh(left) @ np.abs(x[0]) + np.sinh(left) @ np.abs(p[0])
        ratio = abs(x[0, -1] - 1.0) / (EPS * carried)
        assert residual == pytest.approx(ratio, rel=1e-6) if residual > 1 else residual >= ratio * (1 - 1e-6)
    assert path.residual < 1 < shot.residual


@pytest.mark.parametrize("intervals", [40, *slow(1000)])
def test_residual_does_not_grow_with_the_number_of_steps(intervals):
    assert cg.shoot(cg.BoundaryProblem(pendulum, (0, 10), [0.0], [1.0]), cg.Galerkin(4), intervals).residual < 1.0


def test_a_miss_above_its_roundoff_floor_is_refused():
    shooting = Shooting(PROBLEMS["pendulum"], cg.Galerkin(5), np.linspace(0, 1, 11))
    path = cg.shoot(PROBLEMS["pendulum"], cg.Galerkin(5), 10)
    shot = shooting.shoot(np.array([path.x[0, 0], path.momentum[0, 0] + 1e-10]), np.ones(1))
    assert np.max(np.abs(shot.miss)) < MISS
    with pytest.raises(
        cg.ConvergenceError, match=r"the end is missed by .* of the path's size .* its rounding alone"
    ) as caught:
        _met(shot, 3)
    assert caught.value.residual == shot.residual > 1e4


def test_rates_of_growth_that_rounding_parts_are_no_conjugate_ends():
    """Both ends of the path then depend on the faster direction alone, as far as doubles tell."""

    def two_rates(t, x, v):
        return ca.sumsqr(v) / 2 + 9 * (x[0] + x[1] / 3) ** 2 / 2 + (x[1] - x[0] / 3) ** 2 / 2

    problem = cg.BoundaryProblem(two_rates, (0, 18), [1.0, 1.0], [1.0, 0.5])
    with pytest.raises(cg.ConvergenceError, match="rounding hides how the end depends on the start") as caught:
        cg.shoot(problem, cg.Galerkin(4), 80)
    assert not isinstance(caught.value, cg.ConjugatePointError)


@pytest.mark.parametrize("degree", [4, 8])
def test_newtons_method_goes_on_to_the_rounding_of_start_and_end(degree):
    """Up to the rounding of all joints a path is accepted, but it can be ten times better."""
    problem = cg.BoundaryProblem(pendulum, (0, 10), [0.0], [1.0])
    coarse = cg.solve(problem, cg.Galerkin(3), 12, guess=lambda t: [t / 10 + 3 * np.sin(np.pi * t / 10)])
    whole, shot = (way(problem, cg.Galerkin(degree), 80, guess=coarse) for way in (cg.solve, cg.shoot))
    np.testing.assert_allclose(shot.x, whole.x, rtol=0, atol=2e-12)


@pytest.mark.parametrize("horizon", [200, *slow(700)])
def test_a_failure_tells_the_growth_and_holds_the_last_path_and_its_residual(horizon):
    problem = cg.BoundaryProblem(saddle, (0, horizon), [1.0], [1.0])
    growth = f"{np.cosh(horizon):.1e}".replace("+", r"\+")
    with pytest.raises(cg.ConvergenceError, match=rf"the end is missed by .* grows up to {growth} times") as caught:
        cg.shoot(problem, cg.Galerkin(8), intervals=2 * horizon)
    path = caught.value.path
    assert path(0.0) == 1.0
    assert abs(path(horizon) - 1.0) > MISS
    assert caught.value.residual < 1.0  # at roundoff, and yet far from the end
    assert caught.value.iterations > 0


@pytest.mark.parametrize(
    ("duration", "ends", "spring"), [(np.pi, [0.0], 1.0), (1.0, [None], 0.0)], ids=["conjugate points", "free at rest"]
)
def test_one_of_a_family_of_paths_is_refused_though_the_first_meets_the_end(duration, ends, spring):
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - spring * x[0] ** 2 / 2, (0, duration), ends, ends)
    for way in (cg.solve, cg.shoot):
        with pytest.raises(cg.ConjugatePointError, match="a family of paths"):
            way(problem, cg.Galerkin(8), 20)


@pytest.mark.parametrize("intervals", [3, *slow(8)])
@pytest.mark.parametrize("degree", [2, *slow(8)])
def test_a_weight_on_a_spring_with_free_ends_hangs_at_rest(degree, intervals):
    """Spring and weight cancel, and the momentum that the end is judged by is their rounding."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - 30 * (x[0] - 0.3) ** 2 - 9.81 * x[0], (0, 1), [None], [None]
    )
    path = cg.shoot(problem, cg.Galerkin(degree), intervals)
    np.testing.assert_allclose(path.x, 0.3 - 9.81 / 60, rtol=1e-14)
    assert np.max(np.abs(path.momentum)) < 1e-14


def test_a_conjugate_point_is_named():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, np.pi), [0.0], [1.0])
    with pytest.raises(cg.ConjugatePointError, match="conjugate points") as caught:
        cg.shoot(problem, cg.Galerkin(8), intervals=12)
    assert caught.value.path(0.0) == 0.0
    assert caught.value.residual > 1e4  # the end, which is 1, is missed by 1


def test_a_problem_without_a_path_fails():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 5 * ca.exp(x[0]), (0, 1), [0.0], [0.0])  # Bratu, λ = 5
    with pytest.raises(cg.ConvergenceError, match=r"shooting failed|conjugate"):
        cg.shoot(problem, cg.Galerkin(4), intervals=10)


def test_a_first_path_that_collides_fails():
    problem = cg.BoundaryProblem(kepler, (0, 2), [1.0, 0.0], [-1.0, 0.0])
    with pytest.raises(cg.ConvergenceError, match=r"^step \d of 10, from t = .* another start") as caught:
        cg.shoot(problem, cg.Galerkin(4), intervals=10)
    assert 0 < caught.value.path.t[-1] < 2  # how far it got


def test_bad_input_is_named():
    problem = PROBLEMS["pendulum"]
    with pytest.raises(TypeError, match="problem must be a BoundaryProblem, got InitialProblem"):
        cg.shoot(cg.InitialProblem(pendulum, (0, 1), [0.0], momentum=[1.0]), cg.Galerkin(3), 5)
    with pytest.raises(TypeError, match="method must be a Galerkin"):
        cg.shoot(problem, 3, 5)
    with pytest.raises(ValueError, match="give either intervals or mesh"):
        cg.shoot(problem, cg.Galerkin(3))
    with pytest.raises(TypeError, match=r"guess must be a Trajectory of 1 component"):
        cg.shoot(problem, cg.Galerkin(3), 5, guess=[1.0])


@pytest.mark.parametrize("intervals", [7, *slow(40)])
@pytest.mark.parametrize("beside", [1e-6, *slow(1e-3)])
def test_a_start_beside_a_straight_path_comes_to_it(beside, intervals):
    """What rounding left of the momentum beside it counted by its own size: conjugate ends, or no convergence."""

    def lagrangian(t, x, v):
        return ca.sumsqr(v) / 2 + 1 / ca.norm_2(x)

    problem = cg.BoundaryProblem(lagrangian, (0, 1), [1.0, 0.0], [1.5, 0.0])
    straight = cg.solve(problem, cg.Galerkin(4), intervals)
    start = cg.InitialProblem(lagrangian, (0, 1), [1.0, 0.0], velocity=[straight(0, 1)[0], beside])
    path = cg.shoot(problem, cg.Galerkin(4), intervals, guess=cg.solve(start, cg.Galerkin(4), intervals))
    np.testing.assert_allclose(path.x, straight.x, rtol=0, atol=1e-13)


@pytest.mark.parametrize("before", [1e-2, *slow(1e-4)])
def test_the_estimate_counts_the_error_of_the_start_that_grows_towards_a_conjugate_point(before):
    duration = np.pi - before
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, duration), [0.0], [1.0])
    path = cg.shoot(problem, cg.Galerkin(2), intervals=10)
    times = np.linspace(0, duration, 500)
    error = np.max(np.abs(path(times)[0] * np.sin(duration) - np.sin(times)))
    assert 0.9 * error < path.estimate_error() < 2 * error
    assert path.error_estimate == pytest.approx(cg.solve(problem, path.method, 10).estimate_error(), rel=1e-3)


@pytest.mark.slow
def test_the_estimate_counts_the_error_of_a_duration_of_given_energy():
    """One turn over the upright position, where the pendulum is so slow that the duration depends on all digits."""
    energy, steps = 1 + 1e-5, (cg.Galerkin(4), 16)
    part = 2 / (energy + 1)
    duration = 2 * np.sqrt(part) * ellipk(part)
    turn = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), (0, duration), [0.0], [2 * np.pi], energy=energy
    )
    path = cg.shoot(turn, *steps, guess=cg.solve(turn, *steps))
    error = abs(path.t[-1] / duration - 1)
    assert error > 1e-2
    assert 0.9 * error < path.estimate_error() < 10 * error


@pytest.mark.parametrize("duration", [16, 18])
def test_the_estimate_counts_by_how_much_the_end_is_missed(duration):
    """An inverted pendulum, on which rounding grows as e^t: a shot of a higher degree is moved by the same rounding."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - ca.cos(x[0]), (0, duration), [0.5], [0.3])
    true = cg.solve(problem, tol=1e-12)
    path, times = cg.shoot(problem, cg.Galerkin(8), 4 * duration, guess=true), np.linspace(0, duration, 500)
    error = np.max(np.abs(path(times) - true(times))) / 0.5
    assert error <= 1.2 * path.estimate_error() < 1e-7


def test_a_shot_that_does_not_converge_is_not_blamed_on_rounding():
    """No path joins these ends."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 20 * ca.exp(x[0]), (0, 1), [0.0], [0.0])
    with pytest.raises(cg.ConvergenceError, match=r"the end is missed by .* guess with a better") as caught:
        cg.shoot(problem, cg.Galerkin(4), 10)
    assert "double" not in str(caught.value)


@pytest.mark.slow
def test_shooting_to_a_tolerance_halves_its_steps():
    fall = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), (0, 4), [0.0], [1.0])
    path, exact = cg.shoot(fall, tol=1e-6), cg.solve(fall, tol=1e-10)
    assert path.error_estimate <= 1e-6
    assert np.max(np.abs(path(exact.t) - exact.x)) <= 1e-6 * np.max(np.abs(exact.x))
    assert cg.shoot(fall, intervals=8).method == cg.Galerkin(8)
    with pytest.raises(ValueError, match="tol must be a number between 0 and 1, got 2"):
        cg.shoot(fall, tol=2)
