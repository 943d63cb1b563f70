"""Built once with a tolerance: every answer keeps it, on the first mesh or, where that does not serve, on another."""

import casadi as ca
import numpy as np
import pytest
from scenes import BY_NAME, bratu_theta, pendulum
from scenes import bratu_problem as bratu
from slow import slow

import casadi_galerkin as cg

TOL = 1e-8


def bratu_error(path, rate, upper=False):
    theta, t = bratu_theta(rate, upper), np.linspace(0, 1, 300)
    exact = -2 * np.log(np.cosh((t - 0.5) * theta / 2) / np.cosh(theta / 4))
    return np.max(np.abs(path(t)[0] - exact)) / np.max(exact)


def layer():
    return cg.BoundaryProblem(
        lambda t, x, v, p: p[0] * v[0] ** 2 / 2 + x[0] ** 2 / 2, (0.0, 1.0), [1.0], [0.0], parameters=[0.1]
    )


def upper(t):
    return [20 * t * (1 - t)]


def test_every_answer_keeps_the_tolerance_on_one_graph():
    transcription = cg.transcribe(bratu(), tol=TOL)
    first = transcription.solve()
    for rate in (0.5, 1.0, 2.0):
        path = transcription.solve(parameters=[rate])
        assert path.error_estimate <= TOL
        assert bratu_error(path, rate) <= TOL
        np.testing.assert_array_equal(path.t, first.t)
        assert path.parameters == (rate,)
        assert path.build_seconds == first.build_seconds > 0


def test_the_mesh_is_adapted_where_it_no_longer_serves():
    transcription = cg.transcribe(layer(), tol=TOL)
    mild, sharp = transcription.solve(), transcription.solve(parameters=[1e-6])
    assert np.min(np.diff(sharp.t)) < 0.1 * np.min(np.diff(mild.t))
    t = np.linspace(0, 1, 2001)
    np.testing.assert_allclose(sharp(t)[0], np.exp(-t / 1e-3), rtol=0, atol=TOL)
    again = transcription.solve(parameters=[0.11])
    np.testing.assert_array_equal(again.t, mild.t)  # the first mesh is kept, not the last
    assert np.array_equal(transcription.solve(parameters=[1.1e-6], guess=sharp).t, sharp.t)  # or that of the guess


def test_a_path_is_followed_on_its_branch():
    transcription = cg.transcribe(bratu(), tol=TOL)
    path = transcription.solve(guess=upper)
    for rate in (0.5, 3.0, 1.0):
        path = transcription.solve(parameters=[rate], guess=path)
        assert path.morse_index == 1
        assert bratu_error(path, rate, upper=True) <= TOL
    assert transcription.solve().morse_index == 0  # from the straight line


def test_times_ends_and_momenta_may_be_others():
    problem = cg.BoundaryProblem(pendulum, (0.0, 1.2), [0.0], [None], end_momentum=[0.5], breakpoints=[0.7])
    transcription = cg.transcribe(problem, tol=TOL)
    transcription.solve()
    path = transcription.solve(start=[0.1], end_momentum=[0.3], t_span=(0.25, 3.0))
    assert (path.t[0], path.t[-1]) == (0.25, 3.0)
    assert 0.7 in path.t
    assert path.x[0, 0] == 0.1
    np.testing.assert_allclose(path.momentum[0, -1], 0.3, rtol=1e-8)
    alone = cg.solve(path.problem, tol=TOL)
    np.testing.assert_allclose(path(0.7), alone(0.7), rtol=10 * TOL)


@pytest.mark.parametrize("span", [(5, 8), *slow([2, 3])])
@pytest.mark.slow
def test_a_guess_of_another_problem_need_not_have_its_breakpoints(span):
    kinked = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - ca.fabs(t - 1) * x[0] ** 2, (0, 3), [1.0], [1.0], breakpoints=[1.0]
    )
    guess = cg.solve(cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 - x[0] ** 2, span, [1.0], [1.0]), tol=TOL)
    path = cg.transcribe(kinked, tol=TOL).solve(guess=guess)
    assert 1.0 in path.t
    assert path.action == pytest.approx(cg.solve(kinked, tol=TOL).action, rel=TOL)


def test_of_a_given_energy_the_duration_follows():
    orbit = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 + 1 / ca.norm_2(x), (0.0, 1.5), [1.0, 0.0], [0.0, 1.0], energy=-0.5
    )
    transcription = cg.transcribe(orbit, tol=TOL)
    circle = transcription.solve(guess=lambda t: [np.cos(t), np.sin(t)])
    np.testing.assert_allclose(circle.t[-1], np.pi / 2, rtol=1e-7)
    faster = transcription.solve(energy=-0.45, guess=circle)
    assert faster.error_estimate <= TOL
    np.testing.assert_allclose(faster.energy, -0.45, rtol=1e-7)
    assert faster.iterations <= 8


def test_a_constraint_is_kept_from_path_to_path():
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2 - x[1],
        (0.0, 1.0),
        [0.0, -1.0],
        [1.0, 0.0],
        constraint=lambda t, x: ca.sumsqr(x) - 1,
    )
    transcription = cg.transcribe(problem, tol=1e-6)
    first = transcription.solve(guess=lambda t: [np.sin(t * np.pi / 2), -np.cos(t * np.pi / 2)])
    end = [float(np.sin(1.7)), -float(np.cos(1.7))]
    path = transcription.solve(end=end, guess=first)
    swing = cg.solve(cg.BoundaryProblem(pendulum, (0.0, 1.0), [0.0], [1.7]), tol=1e-9)
    np.testing.assert_allclose(np.arctan2(path.x[0], -path.x[1]), swing(path.t)[0], atol=1e-5)


def test_what_is_no_solver_is_refused_every_time():
    transcription = cg.transcribe(bratu(), tol=TOL)
    for _ in range(2):
        with pytest.raises(TypeError, match=r"solver must be cg.newton, .* got 'newton'"):
            transcription.solve(solver="newton")
        transcription.solve()


def test_another_solver_is_asked_every_time():
    scene = BY_NAME["long pendulum, index 1"]
    transcription = cg.transcribe(scene.problem, tol=1e-6)
    saddle = transcription.solve(guess=scene.guess)
    assert transcription.solve(guess=saddle, end=[1.01]).morse_index == saddle.morse_index == 1
    assert transcription.solve(guess=saddle, end=[1.01], solver=cg.minimizer).morse_index == 0


def test_a_path_of_a_higher_degree_is_a_guess():
    fine = cg.solve(bratu(), tol=1e-12)
    path = cg.transcribe(bratu(), tol=1e-6).solve(parameters=[1.5], guess=fine)
    assert path.method.degree == 8 < fine.method.degree
    assert path.error_estimate <= 1e-6


def test_limits_stop_it():
    transcription = cg.transcribe(layer(), tol=1e-9, limits=cg.Limits(intervals=8))
    transcription.solve()
    with pytest.raises(cg.LimitReached, match="the mesh would need"):
        transcription.solve(parameters=[1e-8])


def test_it_says_what_mesh_is_kept(capsys):
    transcription = cg.transcribe(bratu(), tol=1e-6)
    words = "AdaptiveTranscription of a BoundaryProblem of 1 component, tol=1e-06"
    assert repr(transcription) == f"{words}: nothing solved yet"
    transcription.solve(verbose=1)
    assert repr(transcription).endswith(": first path of degree 8 on 8 intervals")
    assert "Level  Degree  Intervals" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: cg.transcribe(bratu(), tol=2.0), ValueError, "tol must be a number between 0 and 1, got 2.0"),
        (lambda: cg.transcribe(bratu()), TypeError, "method must be a Galerkin.* or give tol instead"),
        (lambda: cg.transcribe(bratu(), cg.Galerkin(4), 4, limits=cg.Limits()), ValueError, "give tol with them"),
        (
            lambda: cg.transcribe(bratu(), tol=1e-3).solve(velocity=[1.0]),
            ValueError,
            "what can be varied is .* got velocity",
        ),
        (lambda: cg.transcribe(bratu(), tol=1e-3).solve(t_span=(1, 0)), ValueError, "t_span must increase"),
        (lambda: cg.transcribe(bratu(), tol=1e-3).solve(energy=1.0), ValueError, "the problem has no energy"),
    ],
)
def test_what_does_not_fit_is_refused(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_parameters_that_leave_no_mass_are_refused():
    """At p = 1 only x[0] + x[1] has a mass."""
    pair = cg.BoundaryProblem(
        lambda t, x, v, p: p[0] * ca.sumsqr(v) / 2 + v[0] * v[1] - ca.sumsqr(x) / 2,
        (0, 1),
        [0.0, 0.2],
        [1.0, 0.5],
        parameters=[2.0],
    )
    transcription = cg.transcribe(pair, tol=TOL, limits=cg.Limits(levels=3))
    expected = transcription.solve().action
    with pytest.raises(ValueError, match="the lagrangian is degenerate"):
        transcription.solve(parameters=[1.0])
    assert transcription.solve().action == expected
