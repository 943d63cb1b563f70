"""Guesses: of every kind, stretched and bent to the problem, or refused."""

import casadi as ca
import numpy as np
import pytest
from given import Series
from scenes import BY_NAME, oscillator, oscillator_problem, pendulum

import casadi_galerkin as cg
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.solution.guess import guess_values, meeting_ends

METHOD = cg.Galerkin(2)
TIME = ca.SX.sym("t")
sine = ca.Function("sine", [TIME], [ca.sin(TIME)])


@pytest.mark.parametrize(
    ("guess", "kind", "message"),
    [
        (
            np.zeros((1, 3)),
            ValueError,
            r"shape \(1, 5\) for values at the joints or \(1, 9\) at all nodes, got \(1, 3\)",
        ),
        (np.zeros(5), ValueError, r"the guess must have the shape \(1, 5\).* got \(5,\)"),
        (np.zeros((2, 5)), ValueError, r"the guess must have the shape \(1, 5\).* got \(2, 5\)"),
        (3.0, ValueError, r"the guess must have the shape .* got \(\)"),
        ("line", TypeError, "the guess must be real numbers, got 'line'"),
        (np.zeros((1, 5)) * 1j, TypeError, "the guess must be real numbers"),
        (np.full((1, 5), np.nan), ValueError, "the guess must be finite, got .nan. at t = 0$"),
        (lambda t: t, ValueError, r"the guess must return an array of shape \(1,\), got \(\)"),
        (lambda t: [t, t], ValueError, r"the guess must return an array of shape \(1,\), got \(2,\)"),
        (lambda t: [np.nan if t > 0.6 else t], ValueError, r"the guess must be finite, got \[nan\] at t = 0.625"),
        (lambda t: None, TypeError, "values of the guess must be real numbers, got None"),
        (lambda t: [1 / (t - 0.5)], ValueError, "the guess failed at t = 0.5: .*division by zero"),
        (lambda t: {"x": t}, TypeError, "values of the guess must be real numbers, got {'x': 0.0}"),
        (
            ([0, 1], [[0, 1, 2]]),
            ValueError,
            r"\(times, values\) with values of shape \(1, 2\) for 2 times, got \(1, 3\)",
        ),
        (([0, 1], [0, 1]), ValueError, r"\(times, values\) with values of shape \(1, 2\) for 2 times, got \(2,\)"),
        (
            ([1, 0], [[0, 1]]),
            ValueError,
            r"its times are no mesh: .* increase by more than roundoff, got t\[0\] = 1.0 and t\[1\] = 0.0",
        ),
        ((lambda t: [t], lambda t: [t]), TypeError, r"a pair as guess is \(times, values\), and its times are no mesh"),
        ([lambda t: [t], lambda t: [t]], TypeError, r"such as \(path, controls\), must be a tuple, got a list"),
        (([0, 1], [[0, np.nan]]), ValueError, "the guess must be finite"),
        ([[0, 0, 0, 0, True]], TypeError, r"the guess must be real numbers, got True at \[0, 4\]"),
        (np.ma.array([range(5)], mask=[[0, 0, 0, 1, 0]]), ValueError, r"no masked values, got one at \[0, 3\]"),
        (lambda: [0.0], TypeError, "takes 0 positional arguments but 1 was given"),
        (lambda t: ["a"], TypeError, "values of the guess must be real numbers, got"),
    ],
)
def test_a_guess_that_does_not_fit_is_refused(guess, kind, message):
    with pytest.raises(kind, match=message):
        cg.solve(oscillator_problem(), METHOD, intervals=4, guess=guess)


def test_a_path_of_other_components_is_refused_as_guess():
    planar = oscillator_problem(lagrangian=lambda t, x, v: ca.sumsqr(v), start=[0, 0], end=[1, 1])
    other = cg.solve(planar, METHOD, intervals=2)
    for guess in (other, other.polynomial):
        with pytest.raises(ValueError, match=r"the guess must be a path of 1 component, got 2"):
            cg.solve(oscillator_problem(), METHOD, intervals=2, guess=guess)


def test_periodic_guess_that_is_not_closed_counts_with_its_first_value():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2, (0, 1), [None], periodic=True)
    tr = cg.transcribe(problem, cg.Galerkin(2), 3)
    np.testing.assert_array_equal(tr.unknowns(np.arange(7.0)[:, None], tr.data(tr.mesh)), np.arange(6.0))


def test_guesses_of_every_kind_lead_to_the_path_they_are_near():
    scene = BY_NAME["long pendulum, index 1"]
    tr = cg.transcribe(scene.problem, cg.Galerkin(6), 30)
    wanted = tr.solve(guess=scene.guess)
    assert wanted.morse_index == 1
    coarse = cg.solve(scene.problem, cg.Galerkin(3), intervals=25, guess=scene.guess)
    joints = np.stack([scene.guess(t) for t in wanted.t], axis=1)
    nodes = np.stack([scene.guess(t) for t in cg.DiscreteCalculus(tr.method, tr.mesh).node_times], axis=1)
    guesses = [joints, joints.tolist(), nodes, wanted, wanted.polynomial, coarse, lambda t: np.array(scene.guess(t))]
    for guess in guesses:
        path = tr.solve(guess=guess)
        assert path.action == pytest.approx(wanted.action, rel=1e-13)
        np.testing.assert_allclose(path.x, wanted.x, rtol=0, atol=1e-12)
    assert tr.solve(guess=wanted).iterations == 1


def test_a_pair_of_times_and_values_is_joined_by_lines_on_any_mesh():
    times, values = [0.0, 0.3, 1.0], [[0.0, 2.0, 1.0], [1.0, 1.0, 0.0]]
    calculus = cg.DiscreteCalculus(METHOD, [0.0, 0.4, 0.5, 1.0])
    expected = [np.interp(calculus.node_times, times, row) for row in values]
    np.testing.assert_allclose(guess_values((times, values), calculus, 2), expected, rtol=0, atol=1e-15)
    later = cg.DiscreteCalculus(METHOD, [5.0, 5.8, 6.0, 7.0])  # the same on other times
    np.testing.assert_allclose(guess_values((times, np.array(values)), later, 2), expected, rtol=0, atol=1e-14)


def test_corners_of_a_guess_are_not_resolved():
    problem = cg.BoundaryProblem(pendulum, (0, 1), [0.0], [1.0])
    times, values = np.linspace(0, 1, 8), np.array([0.0, 0.3, 0.2, 0.5, 0.6, 0.5, 0.9, 1.0])
    guesses = [None, (times, values[None]), lambda t: [np.interp(t, times, values)]]
    paths = [cg.solve(problem, tol=1e-6, guess=guess) for guess in guesses]
    assert len({len(path.t) for path in paths}) == 1


def test_a_guess_on_another_time_span_is_stretched():
    short = cg.solve(cg.BoundaryProblem(pendulum, (0, 9.9), [0.0], [1.0]), cg.Galerkin(6), intervals=30)
    path = cg.solve(cg.BoundaryProblem(pendulum, (0, 10.0), [0.0], [1.0]), cg.Galerkin(6), intervals=30, guess=short)
    assert path.morse_index == short.morse_index
    assert path.action == pytest.approx(short.action, rel=0.05)


def test_a_guess_that_misses_the_ends_is_bent_to_them():
    problem = cg.BoundaryProblem(oscillator, (0, 1), [0.0], [1.0])
    path = cg.solve(problem, cg.Galerkin(8), intervals=4, guess=lambda t: [7.0 + 3 * t])
    assert path.x[0, 0] == 0
    assert path.x[0, -1] == 1


def test_a_guess_that_is_free_at_one_end_moves_as_a_whole():
    bent = meeting_ends(np.array([[7.0], [9.0], [8.0]]), np.array([0.0, 0.5, 1.0]), np.array([[np.nan], [1.0]]))
    assert bent.tolist() == [[0.0], [2.0], [1.0]]


@pytest.mark.parametrize("guess", [sine, lambda t: ca.vertcat(ca.sin(t)), lambda t: Series({7: float(np.sin(t))})])
def test_a_callable_guess_returns_its_values_in_any_form(guess):
    calculus = cg.DiscreteCalculus(METHOD, [0.0, 0.5, 1.0])
    np.testing.assert_allclose(guess_values(guess, calculus, 1), [np.sin(calculus.node_times)], rtol=1e-15)


def test_a_path_as_guess_keeps_its_values_on_its_own_mesh_and_its_jumps_on_that_of_another_degree():
    mesh = np.array([0.2, 0.6, 2.9])
    values = np.array([[0.0, 0.2, 0.3, -2.0, 0.1]])
    path = PiecewisePolynomial(mesh, np.array([0.0, 0.5, 1.0]), values, np.array([[1.0, 0.1]]))
    np.testing.assert_array_equal(guess_values(path, cg.DiscreteCalculus(cg.Galerkin(2), mesh), 1), values)
    for degree in range(3, 12):
        finer = cg.DiscreteCalculus(cg.Galerkin(degree), mesh)
        assert guess_values(path, finer, 1)[0, degree] == 0.3
