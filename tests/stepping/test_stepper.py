"""One step, or many: the global solution between the same ends, its Jacobian, stiffness, units, failures."""

import casadi as ca
import numpy as np
import pytest
from motions import MOTIONS, double_pendulum, kepler, pendulum, start_of
from slow import slow

import casadi_galerkin as cg

SAME = 1e-13  # two ways of solving the same equations, relative to the path's size


@pytest.mark.parametrize("scene", MOTIONS)
@pytest.mark.parametrize("degree", [4, *slow(8)])
def test_steps_are_the_global_solution_between_the_same_ends(scene, degree):
    problem, method = start_of(scene, 4), cg.Galerkin(degree)
    stepped = cg.solve(problem, method, intervals=4)
    ends = cg.BoundaryProblem(problem.lagrangian, problem.t_span, stepped.x[:, 0], stepped.x[:, -1])
    whole = cg.solve(ends, method, intervals=4, guess=stepped)
    for ours, theirs in ((stepped.x, whole.x), (stepped.momentum, whole.momentum)):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=SAME * np.max(np.abs(theirs)))
    assert stepped.action == pytest.approx(whole.action, rel=SAME, abs=SAME)
    np.testing.assert_allclose(
        stepped.polynomial.values, whole.polynomial.values, rtol=0, atol=SAME * np.max(np.abs(whole.x))
    )


@pytest.mark.parametrize("rule", [cg.gauss(4), cg.gauss(6), cg.lobatto(4), cg.lobatto(5), cg.radau(5)], ids=str)
def test_steps_are_the_global_solution_whatever_the_quadrature(rule):
    problem, method = start_of("double pendulum", 5), cg.Galerkin(4, quadrature=rule)
    stepped = cg.solve(problem, method, intervals=5)
    ends = cg.BoundaryProblem(problem.lagrangian, problem.t_span, stepped.x[:, 0], stepped.x[:, -1])
    whole = cg.solve(ends, method, intervals=5, guess=stepped)
    np.testing.assert_allclose(stepped.momentum, whole.momentum, rtol=0, atol=SAME * np.max(np.abs(whole.momentum)))


def test_control_points_do_not_move_the_steps():
    problem = start_of("kepler", 10)
    lobatto, chebyshev = (
        cg.solve(problem, cg.Galerkin(6, control_points=points), intervals=10)
        for points in (cg.lobatto_points(6), cg.chebyshev_points(6))
    )
    np.testing.assert_array_equal(lobatto.x, chebyshev.x)
    times = np.linspace(0, 1, 37)
    np.testing.assert_allclose(lobatto(times), chebyshev(times), rtol=0, atol=SAME)


@pytest.mark.parametrize("scene", ["double pendulum", "varying mass in time"])
def test_jacobian_of_a_step_is_its_derivative(scene):
    lagrangian, x, p, h = MOTIONS[scene]
    problem, start, d = start_of(scene, 1), np.array(x + p), len(x)
    jacobian = cg.geometry(cg.solve(problem, cg.Galerkin(3), intervals=1)).jacobians[0]

    def step(state):
        path = cg.solve(cg.InitialProblem(lagrangian, (0, h), state[:d], momentum=state[d:]), cg.Galerkin(3), 1)
        return np.concatenate((path.x[:, -1], path.momentum[:, -1]))

    difference = 1e-5
    columns = [(step(start + e) - step(start - e)) / (2 * difference) for e in difference * np.eye(2 * d)]
    np.testing.assert_allclose(jacobian, np.transpose(columns), rtol=0, atol=1e-7)  # the difference's own error


@pytest.mark.parametrize("intervals", [1, 2, 64, 65, 131])  # pieces of √N, the last one filled or not
def test_any_number_of_steps_is_the_same_as_one_after_the_other(intervals):
    mesh = np.cumsum(np.append(0, np.linspace(0.02, 0.06, intervals)))
    start = {"start": [2.0], "momentum": [0.3]}
    whole = cg.solve(cg.InitialProblem(pendulum, (0, mesh[-1]), **start), cg.Galerkin(3), mesh=mesh)
    half = (intervals + 1) // 2
    first = cg.solve(cg.InitialProblem(pendulum, (0, mesh[half]), **start), cg.Galerkin(3), mesh=mesh[: half + 1])
    np.testing.assert_array_equal(first.x, whole.x[:, : half + 1])
    if half < intervals:
        rest = cg.InitialProblem(pendulum, (mesh[half], mesh[-1]), first.x[:, -1], momentum=first.momentum[:, -1])
        second = cg.solve(rest, cg.Galerkin(3), mesh=mesh[half:])
        np.testing.assert_allclose(second.x, whole.x[:, half:], rtol=0, atol=SAME)
    assert whole.polynomial.values.shape == (1, 3 * intervals + 1)
    assert whole.polynomial.values[0, ::3].tolist() == whole.x[0].tolist()


@pytest.mark.parametrize("frequency", [1.0, 1e8, *slow(1e4)])
def test_steps_of_any_stiffness_are_stable(frequency):
    problem = cg.InitialProblem(
        lambda t, x, v: v[0] ** 2 / 2 - frequency**2 * x[0] ** 2 / 2, (0, 100), [1.0], velocity=[0.0]
    )
    path = cg.solve(problem, cg.Galerkin(4), intervals=100)
    energy = (path.momentum[0] ** 2 + frequency**2 * path.x[0] ** 2) / frequency**2
    np.testing.assert_allclose(energy, 1, rtol=1e-10)  # Gauss methods conserve quadratic invariants


@pytest.mark.slow
def test_large_steps_of_a_chaotic_motion_are_solved():
    # predictions of a higher degree led some of these steps to other solutions, and then to none
    problem = cg.InitialProblem(double_pendulum, (0, 20), [2.0, 2.5], velocity=[0.0, 0.0])
    for degree, intervals, error in ((4, 250, 1.0), (6, 200, 0.1), (8, 200, 1e-2)):
        path = cg.solve(problem, cg.Galerkin(degree), intervals)
        assert np.ptp(path.energy) < error


def test_steps_far_too_large_fail_instead_of_ending_in_zeros():
    # CasADi abandons an evaluation at a matrix that its QR calls singular, and leaves zeros behind
    problem = cg.InitialProblem(double_pendulum, (0, 40), [2.0, 2.5], velocity=[0.0, 0.0])
    with pytest.raises(cg.ConvergenceError, match=r"of 100, from t = .* was not solved"):
        cg.solve(problem, cg.Galerkin(6), intervals=100)


@pytest.mark.parametrize("scale", [1e-12, 1e12])
def test_units_do_not_matter(scale):
    unit = cg.solve(cg.InitialProblem(kepler, (0, 3), [0.4, 0.0], velocity=[0.0, 2.0]), cg.Galerkin(5), 30)
    scaled = cg.InitialProblem(
        lambda t, x, v: ca.dot(v, v) / 2 + scale**3 / ca.norm_2(x), (0, 3), [0.4 * scale, 0], velocity=[0, 2 * scale]
    )
    np.testing.assert_allclose(cg.solve(scaled, cg.Galerkin(5), 30).x / scale, unit.x, rtol=0, atol=SAME)


@pytest.mark.slow
def test_high_degrees_step_to_roundoff():
    problem = cg.InitialProblem(pendulum, (0, 10), [2.0], velocity=[0.3])
    high = cg.solve(problem, cg.Galerkin(40), intervals=4)
    low = cg.solve(problem, cg.Galerkin(8), intervals=100)
    np.testing.assert_allclose(high.x, low.x[:, ::25], rtol=0, atol=2e-13)  # 10 units of time magnify rounding


def test_a_body_at_rest_in_equilibrium_stays_there():
    path = cg.solve(cg.InitialProblem(pendulum, (0, 10), [0.0], velocity=[0.0]), cg.Galerkin(3), intervals=10)
    assert not path.x.any()


def test_a_collision_names_the_step_and_its_time_and_keeps_the_path_before_it():
    problem = cg.InitialProblem(kepler, (0, 2), [1.0, 0.0], velocity=[0.0, 0.0])  # falls in at t = π / √8 = 1.11
    with pytest.raises(cg.ConvergenceError, match=r"step 112 of 200, from t = 1.11 to 1.12, was not solved") as caught:
        cg.solve(problem, cg.Galerkin(4), intervals=200)
    assert caught.value.path.t[-1] == pytest.approx(1.11)
    assert not caught.value.residual <= 50


def test_a_start_on_the_singularity_fails_in_its_first_step():
    problem = cg.InitialProblem(kepler, (0, 2), [0.0, 0.0], velocity=[1.0, 0.0])
    with pytest.raises(cg.ConvergenceError, match=r"step 1 of 5, from t = 0 to 0\.4") as caught:
        cg.solve(problem, cg.Galerkin(4), intervals=5)
    assert caught.value.path is None


def test_a_mass_matrix_of_mixed_units_is_not_taken_for_singular():
    problem = cg.InitialProblem(
        lambda t, x, v: 1e12 * v[0] ** 2 + 1e-12 * v[1] ** 2, (0, 1), [0.0, 0.0], velocity=[1, 2]
    )
    path = cg.solve(problem, cg.Galerkin(2), intervals=3)
    np.testing.assert_allclose(path.x[:, -1], [1, 2], rtol=1e-14)
