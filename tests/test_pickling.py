"""What is sent to other processes comes back the same: problems with their lambdas, methods, paths, errors."""

import pickle
import subprocess
import sys

import casadi as ca
import numpy as np
import pytest
from constrained import on_circle, planar, unit_length
from control_problems import everything
from scenes import pendulum

import casadi_galerkin as cg


def test_problem_and_answer_survive_pickling():
    problem = pickle.loads(pickle.dumps(everything()))
    path = cg.solve(problem, cg.Galerkin(3), intervals=4)
    again = pickle.loads(pickle.dumps(path))
    assert again.cost == path.cost
    np.testing.assert_array_equal(again.costate.values, path.costate.values)
    np.testing.assert_array_equal(again.control(0.7), path.control(0.7))
    np.testing.assert_array_equal(again.dynamics_defect, path.dynamics_defect)


def there_and_back(value):
    return pickle.loads(pickle.dumps(value))


def swing(parameters=(0.9, 0.5)):
    return cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 + p[0] * ca.cos(x[0]) + p[1] * t * x[0],
        (0.0, 2.0),
        [0.1],
        [1.0],
        parameters=parameters,
    )


@pytest.mark.parametrize(
    "problem",
    [
        swing(),
        cg.BoundaryProblem(lambda t, x, v: ca.dot(v, v) / 2 + x[0] * v[1], (0.0, 1.0), [0.0, None], [None, 1.0]),
        cg.BoundaryProblem(
            lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 9 + ca.sin(t) * x[0], (0, 6.5), [None], periodic=True
        ),
    ],
    ids=["parameters", "free ends", "periodic"],
)
def test_a_problem_made_of_a_lambda_is_solved_to_the_same_bits(problem):
    copy = there_and_back(problem)
    for name in ("t_span", "start", "end", "parameters", "periodic", "dimension"):
        assert getattr(copy, name) == getattr(problem, name)
    method = cg.Galerkin(4)
    ours, theirs = (cg.solve(each, method, 8) for each in (problem, copy))
    np.testing.assert_array_equal(theirs.polynomial.values, ours.polynomial.values)
    np.testing.assert_array_equal(theirs.momentum, ours.momentum)
    assert theirs.action == ours.action


def orbit():
    return cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2 + 1 / ca.norm_2(x), (0, np.pi), [0.9, 0.0], [None, 0.0], energy=-0.5
    )


def half_turn(t):
    return [np.cos(t) - 0.1, np.sin(t)]


MECHANICS = {
    "force": (cg.BoundaryProblem(pendulum, (0, 1), [0.2], [1.3], force=lambda t, x, v: -v), None),
    "constraint": (
        cg.BoundaryProblem(planar, (0, 1), on_circle(0.2), on_circle(1.3), constraint=unit_length),
        lambda t: on_circle(0.2 + 1.1 * t),
    ),
    "ends": (
        cg.BoundaryProblem(
            pendulum, (0, 1), [None], [None], start_velocity=[0.5], end_conditions=lambda x0, x1: x1[0] - 1
        ),
        None,
    ),
    "energy": (orbit(), half_turn),
}


@pytest.mark.parametrize("name", MECHANICS)
def test_problems_of_mechanics_and_their_answers_survive_pickling(name):
    problem, guess = MECHANICS[name]
    copy = there_and_back(problem)
    assert repr(copy) == repr(problem)
    path, again = (cg.solve(each, cg.Galerkin(6), 8, guess=guess) for each in (problem, copy))
    kept = there_and_back(path)
    for other in (again, kept):
        np.testing.assert_array_equal(other.x, path.x)
        np.testing.assert_array_equal(other.momentum, path.momentum)
        np.testing.assert_array_equal(other.t, path.t)
        assert other.morse_index == path.morse_index
    assert kept.problem.t_span == path.problem.t_span
    if problem.constraint is not None:
        np.testing.assert_array_equal(kept.multipliers(0.3), path.multipliers(0.3))


@pytest.mark.parametrize(
    ("problem", "how"),
    [
        (swing(), {"method": cg.Galerkin(4), "intervals": 8}),
        (swing(), {"tol": 1e-8}),
        (everything(), {"method": cg.Galerkin(3), "intervals": 4}),
    ],
    ids=["mesh", "tolerance", "control"],
)
def test_a_transcription_is_built_again_and_solves_to_the_same_bits(problem, how):
    transcription = cg.transcribe(problem, **how)
    values = transcription.solve().polynomial.values
    np.testing.assert_array_equal(there_and_back(transcription).solve().polynomial.values, values)


def test_another_process_needs_no_source_of_the_lambda(tmp_path):
    (tmp_path / "problem").write_bytes(pickle.dumps((swing(), cg.Galerkin(4))))
    code = (
        "import pickle, sys, casadi_galerkin as cg\n"
        "problem, method = pickle.load(open(sys.argv[1], 'rb'))\n"
        "print(cg.solve(problem, method, 8).action.hex())"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "problem")], capture_output=True, text=True, check=True
    )
    assert float.fromhex(run.stdout) == cg.solve(swing(), cg.Galerkin(4), 8).action


@pytest.mark.parametrize(
    "method",
    [
        cg.Galerkin(1, quadrature=cg.trapezoid()),
        cg.Galerkin(5),
        cg.Galerkin(4, cg.chebyshev_points(4), cg.lobatto(6)),
        cg.Galerkin(2, quadrature=cg.Quadrature([0.1, 0.9], [0.5, 0.5])),
    ],
)
@pytest.mark.parametrize("used", [False, True])
def test_a_method_is_equal_to_its_copy(method, used):
    if used:
        method.element  # noqa: B018  cached from here on
    copy = there_and_back(method)
    assert copy == method
    assert hash(copy) == hash(method)
    np.testing.assert_array_equal(copy.element.slopes, method.element.slopes)


@pytest.mark.parametrize("used", [False, True])
def test_a_path_keeps_everything(used):
    path = cg.solve(swing(), tol=1e-8)
    if used:
        path.velocity, path.energy  # noqa: B018  cached from here on
    copy = there_and_back(path)
    for name in ("t", "x", "momentum", "velocity", "energy"):
        np.testing.assert_array_equal(getattr(copy, name), getattr(path, name))
    for name in ("action", "morse_index", "iterations", "residual", "solver", "method", "parameters", "error_estimate"):
        assert getattr(copy, name) == getattr(path, name)
    times = np.linspace(0, 2, 31)
    for order in (0, 1, 2):
        np.testing.assert_array_equal(copy(times, order), path(times, order))
    assert str(copy) == str(path)
    np.testing.assert_array_equal(cg.sensitivity(copy).x["end"], cg.sensitivity(path).x["end"])


def test_a_copy_of_a_path_is_a_guess():
    path = cg.solve(swing(), cg.Galerkin(4), 8)
    again = cg.solve(there_and_back(path.problem), cg.Galerkin(4), 8, guess=there_and_back(path))
    np.testing.assert_allclose(again.x, path.x, rtol=1e-14, atol=1e-14)


def test_a_copy_of_a_transcription_to_a_tolerance_has_its_mesh_and_follows_its_paths():
    transcription = cg.transcribe(swing(), cg.Galerkin(6), 5, tol=1e-8)
    first = transcription.solve()
    copy = there_and_back(transcription)
    assert str(copy) == str(transcription)
    again = copy.solve(end=[1.1], guess=there_and_back(first))
    np.testing.assert_allclose(again.x, transcription.solve(end=[1.1], guess=first).x, rtol=1e-12, atol=1e-12)


def failure(build):
    with pytest.raises(cg.ConvergenceError) as caught:
        build()
    return caught.value


@pytest.mark.parametrize(
    "build",
    [
        lambda: cg.solve(
            cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 4 * ca.exp(x[0]), (0, 1), [0.0], [0.0]),
            cg.Galerkin(4),
            8,
        ),
        lambda: cg.solve(
            cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, np.pi), [0.0], [0.0]),
            cg.Galerkin(9),
            9,
        ),
        lambda: cg.solve(swing(), cg.Galerkin(2), tol=1e-12, limits=cg.Limits(levels=1)),
    ],
    ids=["no path", "conjugate", "limit"],
)
def test_an_error_keeps_its_reason_and_the_attached_path(build):
    error = failure(build)
    copy = there_and_back(error)
    assert type(copy) is type(error)
    assert str(copy) == str(error)
    assert (copy.residual, copy.iterations) == (error.residual, error.iterations)
    assert error.path is not None
    np.testing.assert_array_equal(copy.path.polynomial.values, error.path.polynomial.values)
    np.testing.assert_array_equal(copy.path.t, error.path.t)


def test_a_sweep_with_failures_keeps_both_kinds():
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * ca.exp(x[0]), (0, 1), [0.0], [0.0], parameters=[1.0]
    )
    sweep = cg.sweep(problem, [{}, {"parameters": [9.0]}], cg.Galerkin(4), 6)
    copy = there_and_back(sweep)
    np.testing.assert_array_equal(copy.action, sweep.action)
    assert str(copy) == str(sweep)


def test_a_solution_function_is_pickled_with_its_derivatives():
    path = cg.solve(swing(), cg.Galerkin(4), 8)
    f = cg.solution_function(swing(), cg.Galerkin(4), 8)
    given = {"start": [0.1], "end": [1.0], "parameters": [0.9, 0.5], "guess": path.polynomial.values}
    for one, other in ((f, there_and_back(f)), (f.jacobian(), there_and_back(f).jacobian())):
        for name, value in one(**given).items():
            np.testing.assert_array_equal(np.array(other(**given)[name]), np.array(value))
