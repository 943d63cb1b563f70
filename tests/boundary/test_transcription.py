"""A transcription is built once and solved often: natural and periodic ends, parameters, meshes, its matrix."""

import casadi as ca
import numpy as np
import pytest
from scenes import BY_NAME, oscillator_problem
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.boundary.transcription import Transcription

METHOD = cg.Galerkin(2)


@pytest.mark.parametrize(
    ("changes", "kind", "message"),
    [
        ({"start": [0.0, 1.0]}, ValueError, r"start must have 1 component, got 2"),
        ({"start": [None]}, ValueError, r"start must have None where the problem has it, \(0.0,\), got \(None,\)"),
        ({"end": [np.nan]}, ValueError, r"end\[0\] must be finite, got nan"),
        ({"end": ["1"]}, TypeError, r"end\[0\] must be a number, got '1'"),
        ({"parameters": [1.0]}, ValueError, r"the problem has no parameters, got parameters=\[1.0\]"),
        ({"mesh": [0, 0.5, 1]}, ValueError, "this transcription has 4 intervals, got a mesh of 2"),
        ({"mesh": [0, 0.6, 0.5, 0.7, 1]}, ValueError, "the joints of a mesh must be finite and increase"),
        ({"solver": "ipopt"}, TypeError, r"solver must be cg.newton, .* or cg.minimizer, got 'ipopt'"),
        ({"solver": None}, TypeError, "solver must be cg.newton, .* got None"),
        ({"solver": lambda *_: 1}, TypeError, "solver must return a Solution, .* has returned 1; take cg.newton"),
        ({"finish": [1.0]}, ValueError, "what can be varied is start, .*, energy, got finish"),
    ],
)
def test_a_repeated_solve_with_input_that_does_not_fit_is_refused(changes, kind, message):
    tr = cg.transcribe(oscillator_problem(), METHOD, 4)
    with pytest.raises(kind, match=message):
        tr.solve(**changes)


def test_a_free_component_cannot_be_given_later():
    tr = cg.transcribe(oscillator_problem(end=[None]), METHOD, 2)
    with pytest.raises(ValueError, match=r"end must have None where the problem has it, \(None,\), got \(1.0,\)"):
        tr.solve(end=[1.0])


CLOSED_FORM = 1e-13  # relative to the largest value along the path


def test_natural_end_has_zero_momentum():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] * v[0] + x[0] ** 4, (0, 0.5), [None], [1.0])
    path = cg.solve(problem, cg.Galerkin(6), intervals=8)
    assert abs(path.momentum[0, 0]) < 1e-13
    assert path.velocity[0, 0] == pytest.approx(path.x[0, 0], abs=1e-12)  # p = v - x


@pytest.mark.parametrize("intervals", [1, 2, 6])
def test_periodic_forcing_of_an_oscillator_has_its_exact_answer(intervals):
    """x'' = -2 x + cos t has the one periodic solution cos t."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 + x[0] * ca.cos(t), (0, 2 * np.pi), [None], periodic=True
    )
    path = cg.solve(problem, cg.Galerkin(24 if intervals < 3 else 14), intervals=intervals)
    t = np.linspace(0, 2 * np.pi, 101)
    np.testing.assert_allclose(path(t)[0], np.cos(t), rtol=0, atol=5 * CLOSED_FORM)
    assert path.x[0, 0] == path.x[0, -1]
    assert path.momentum[0, 0] == pytest.approx(path.momentum[0, -1], abs=1e-12)


def test_periodic_path_through_a_fixed_point_has_a_kink_in_momentum_there():
    """With x(0) = x(T) = 1 given, the momenta need not agree: x = cosh(t - T/2)/cosh(T/2)."""
    problem = cg.BoundaryProblem(lambda t, x, v: (v[0] ** 2 + x[0] ** 2) / 2, (0, 2.0), [1.0], periodic=True)
    path = cg.solve(problem, cg.Galerkin(10), intervals=4)
    np.testing.assert_allclose(path.x[0], np.cosh(path.t - 1) / np.cosh(1), rtol=CLOSED_FORM)
    np.testing.assert_allclose(path.momentum[0, [0, -1]], [-np.tanh(1), np.tanh(1)], rtol=1e-12)


def spring(t, x, v, p):
    return v[0] ** 2 / 2 - p[0] ** 2 * x[0] ** 2 / 2 + p[1] * x[0]


def test_parameters_enter_and_change():
    problem = cg.BoundaryProblem(spring, (0, 1), [0.0], [1.0], parameters=[2.0, 0.0])
    tr = cg.transcribe(problem, cg.Galerkin(10), 6)
    for rate, force in ((2.0, 0.0), (1.3, 4.0)):
        path = tr.solve(parameters=[rate, force])
        shift = force / rate**2
        t = path.t
        exact = shift * (1 - np.cos(rate * t)) + (1 - shift * (1 - np.cos(rate))) * np.sin(rate * t) / np.sin(rate)
        np.testing.assert_allclose(path.x[0], exact, rtol=0, atol=CLOSED_FORM)
        assert path.parameters == (rate, force)
        np.testing.assert_allclose(path.energy, path.energy[0], rtol=1e-12)
    np.testing.assert_array_equal(tr.solve().x, tr.solve(parameters=[2.0, 0.0]).x)


def test_a_path_knows_the_problem_it_solves():
    problem = cg.BoundaryProblem(spring, (0, 1), [0.0], [None], parameters=[2.0, 0.0])
    path = cg.transcribe(problem, cg.Galerkin(4), 3).solve(
        [0.5], [None], parameters=[1.5, 0.1], mesh=[1.0, 1.2, 1.5, 2.0]
    )
    asked = (path.problem.t_span, path.problem.start, path.problem.end, path.problem.parameters)
    assert asked == ((1.0, 2.0), (0.5,), (None,), (1.5, 0.1))
    again = cg.solve(path.problem, cg.Galerkin(4), mesh=path.t)
    np.testing.assert_array_equal(again.x, path.x)
    assert (problem.start, problem.parameters) == ((0.0,), (2.0, 0.0))


def test_repeated_solves_equal_fresh_ones():
    tr = cg.transcribe(cg.BoundaryProblem(spring, (0, 1), [0.0], [1.0], parameters=[2.0, 0.0]), cg.Galerkin(5), 6)
    graded = np.linspace(0, 1, 7) ** 1.5
    later = np.linspace(2.0, 2.8, 7)
    variations = [
        {"start": [0.3], "end": [-2.0]},
        {"parameters": [1.0, 5.0]},
        {"mesh": graded},
        {"mesh": later, "start": [1.0]},
        {},
    ]
    for change in variations:
        mesh = change.get("mesh", np.linspace(0, 1, 7))
        problem = cg.BoundaryProblem(
            spring,
            (mesh[0], mesh[-1]),
            change.get("start", [0.0]),
            change.get("end", [1.0]),
            parameters=change.get("parameters", [2.0, 0.0]),
        )
        again, fresh = tr.solve(**change), cg.solve(problem, cg.Galerkin(5), mesh=mesh)
        np.testing.assert_array_equal(again.polynomial.values, fresh.polynomial.values)
        np.testing.assert_array_equal(again.momentum, fresh.momentum)
        np.testing.assert_array_equal(again.t, fresh.t)
        assert (again.action, again.iterations, again.morse_index) == (fresh.action, fresh.iterations, 0)


@pytest.mark.parametrize("degree", [30, *slow(60)])
def test_one_interval_of_high_degree_solves_too(degree):
    path = cg.solve(BY_NAME["short pendulum"].problem, cg.Galerkin(degree), intervals=1)
    assert path.action == pytest.approx(1.3310039926528, abs=1e-13)
    np.testing.assert_allclose(path(0.5), 0.5643038922354, rtol=0, atol=2e-13)


def test_one_chord_between_given_ends_has_nothing_free_but_perhaps_its_duration():
    def fall(t, x, v):
        return ca.sumsqr(v) / 2 - 10 * x[-1]

    timed = cg.solve(cg.BoundaryProblem(fall, (0, 2), [0], [1], energy=18.0), cg.Galerkin(1), intervals=1)
    assert timed.t[-1] == pytest.approx(1 / np.sqrt(2 * (18 - 10 / 2)), rel=1e-14)  # by the midpoint rule
    ends = [0, -1], [np.sin(0.5), -np.cos(0.5)]
    held = cg.BoundaryProblem(fall, (0, 0.5), *ends, constraint=lambda t, x: ca.sumsqr(x) - 1)
    path, shot = (solve(held, cg.Galerkin(1), intervals=1) for solve in (cg.solve, cg.shoot))
    assert path.action == pytest.approx(np.sum(np.diff(ends, axis=0) ** 2) - 0.5 * 10 * np.mean(ends, axis=0)[1])
    np.testing.assert_allclose(path.momentum, shot.momentum, rtol=0, atol=1e-13)


@pytest.mark.slow
def test_fifty_thousand_intervals_keep_the_error_floor():
    path = cg.solve(BY_NAME["short pendulum"].problem, cg.Galerkin(2), intervals=50_000)
    assert path(0.5)[0] == pytest.approx(0.5643038922354, abs=1e-12)  # given to 13 decimals
    assert path.action == pytest.approx(1.3310039926528, abs=1e-12)
    assert path.momentum[0, 0] == pytest.approx(1.1762198416929, abs=1e-10)  # differences over h = 2e-5
    assert path.iterations <= 4


def test_transcription_is_public():
    assert isinstance(cg.transcribe(BY_NAME["Lambert"].problem, cg.Galerkin(2), 3), Transcription)
    assert Transcription is cg.Transcription


@pytest.mark.usefixtures("headless")
def test_pattern_shows_every_nonzero_of_the_hessian():
    transcription = cg.transcribe(BY_NAME["uniform gravity"].problem, cg.Galerkin(3), 5)
    axes = transcription.plot_hessian()
    size = transcription.numbering.free
    shown = np.zeros((size, size), dtype=bool)
    columns, rows = axes.get_lines()[0].get_xydata().T.astype(int)
    shown[rows, columns] = True
    sparsity = transcription.hessian.sparsity_out(0)
    np.testing.assert_array_equal(shown, np.array(ca.DM(sparsity, 1).full(), dtype=bool))
    assert axes.get_ylim()[0] > axes.get_ylim()[1], "row 0 is on top"
    assert f"{sparsity.nnz()} nonzeros" in axes.get_title()


@pytest.mark.usefixtures("headless")
def test_the_pattern_without_unknowns_is_empty():
    transcription = cg.transcribe(BY_NAME["uniform gravity"].problem, cg.Galerkin(1), 1)
    assert transcription.plot_hessian().get_title() == "0 nonzeros, 0 % of 0 × 0"
    assert "on 1 interval: 0 unknowns" in repr(transcription)


DEGENERATE = {
    "one direction": lambda t, x, v: (v[0] + v[1]) ** 2 / 2 - ca.dot(x, x) / 2,
    "linear in v": lambda t, x, v: (x[0] * v[1] - x[1] * v[0]) / 2 - ca.dot(x, x) / 2,
    "of degree one": lambda t, x, v: ca.sqrt(v[0] ** 2 + ca.sin(1 + x[0]) ** 2 * v[1] ** 2),
    "small units": lambda t, x, v: 1e-20 * (v[0] + 1e12 * v[1]) ** 2 / 2 - x[0] ** 2 / 2,
}


@pytest.mark.parametrize("end", [[1.0, 0.2], [1.0, 1.0], [1.0, None]])
@pytest.mark.parametrize("name", DEGENERATE)
def test_a_degenerate_lagrangian_is_refused_when_it_is_stated(name, end):
    """It has no path between most ends; a zigzag that followed the mesh was returned, of Morse index 26, 35, 71."""
    with pytest.raises(ValueError, match=r"degenerate: its mass matrix .* is singular wherever it was tried"):
        cg.BoundaryProblem(DEGENERATE[name], (0, 1), [0.0, 0.0], end)


def test_a_mass_that_vanishes_at_single_points_is_no_degenerate_lagrangian():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 4 / 4 + x[0] ** 2 / 2, (0, 1), [0.0], [1.0])
    path = cg.solve(problem, cg.Galerkin(6), intervals=8)
    np.testing.assert_allclose(path.energy, path.energy[0], rtol=1e-6, atol=0)
