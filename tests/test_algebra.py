"""The stages of Newton's method against NumPy on the Functions of the graph."""

import casadi as ca
import numpy as np
import pytest

import casadi_galerkin as cg

CLOSE = 1e-11  # relative; steps with Hessians of condition 1e3


def coupled(t, x, v):
    return ca.dot(v, v) / 2 + v[0] * v[1] * ca.cos(x[0] - x[1]) / 3 + ca.sin(x[0]) * x[1] - t * x[0]


def indefinite(t, x, v):
    """LDLᵀ without pivoting cannot factorise its Hessian."""
    return v[0] * v[1] + ca.sin(x[0]) * x[1]


PROBLEMS = {
    "LDL": (coupled, [0.3, -0.2], [1.0, 5.0]),
    "QR": (indefinite, [0.3, -0.2], [1.0, 5.0]),
    "free ends": (coupled, [None, -0.2], [1.0, None]),
}


def point(name):
    """A system, a point away from any solution, its data, gradient, Hessian and the sizes of both components."""
    lagrangian, start, end = PROBLEMS[name]
    transcription = cg.transcribe(cg.BoundaryProblem(lagrangian, (0.0, 2.0), start, end), cg.Galerkin(3), 4)
    data = transcription.data(transcription.mesh)
    line = transcription.unknowns(transcription.drawn(None, transcription.mesh).values.T)
    unknowns = line + 0.1 * np.random.default_rng(5).standard_normal(len(line))
    gradient, hessian = (np.array(f(unknowns, *data)) for f in (transcription.gradient, transcription.hessian))
    return transcription, unknowns, data, gradient.ravel(), hessian


def sizes_of(transcription, unknowns, data, step=0.0):
    """Largest size of the component of each unknown, along the path and in a step."""
    nodes = np.abs(transcription.values(unknowns, data)).max(axis=0)
    steps = np.abs(transcription.change(step * np.ones(transcription.layout.free))).max(axis=1)
    return np.maximum(nodes, steps)[transcription.layout.component[: transcription.layout.free]]


@pytest.mark.parametrize("name", PROBLEMS)
def test_newton_step_and_its_measures(name):
    transcription, unknowns, data, gradient, hessian = point(name)
    _, step, sizes, norm = transcription.system.iterate(unknowns, data)
    expected = -np.linalg.solve(hessian, gradient)
    got = transcription.system.algebra.gradient
    np.testing.assert_allclose(got, gradient, rtol=0, atol=CLOSE * np.max(np.abs(gradient)))
    np.testing.assert_allclose(step, expected, rtol=0, atol=CLOSE * np.max(np.abs(expected)))
    np.testing.assert_allclose(sizes, sizes_of(transcription, unknowns, data, step), rtol=CLOSE)
    assert norm == pytest.approx(np.max(np.abs(step) / sizes), rel=CLOSE)


@pytest.mark.parametrize("name", PROBLEMS)
def test_search_takes_the_gradient_ahead_and_the_matrix_behind(name):
    transcription, unknowns, data, _, hessian = point(name)
    system, damping = transcription.system, 0.25
    _, step, sizes, _ = system.iterate(unknowns, data)
    ahead = unknowns + damping * step
    simplified, length, bend = system.search(ahead, data, step, sizes, damping)
    expected = -np.linalg.solve(hessian, np.array(transcription.gradient(ahead, *data)).ravel())
    np.testing.assert_allclose(simplified, expected, rtol=0, atol=CLOSE * np.max(np.abs(step)))
    assert length == pytest.approx(np.max(np.abs(expected) / sizes), rel=1e-9)
    assert bend == pytest.approx(np.max(np.abs(expected - (1 - damping) * step) / sizes), rel=1e-9)


@pytest.mark.parametrize("name", PROBLEMS)
def test_judgement_is_made_with_the_hessian_where_it_is_made(name):
    transcription, unknowns, data, gradient, hessian = point(name)
    system = transcription.system
    before = unknowns + 1e-3
    system.iterate(before, data)
    action, momentum, residual, regularity, got, floor = system.evaluate("judged", unknowns, data)
    summary = [np.array(value).ravel(order="F") for value in transcription.summary(unknowns, *data)]
    np.testing.assert_allclose(np.concatenate((action, momentum)), np.concatenate(summary[:2]), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(got, gradient, rtol=0, atol=CLOSE * np.max(np.abs(gradient)))
    scale = sizes_of(transcription, unknowns, data)
    eps = np.finfo(float).eps
    np.testing.assert_allclose(floor, eps * (summary[3] + np.abs(hessian) @ scale), rtol=1e-9)
    assert residual[0] == pytest.approx(np.max(np.abs(got) / floor), rel=1e-12)
    probe = np.cos(1.0 + np.arange(len(unknowns))) / sizes_of(transcription, before, data)
    soft = np.linalg.solve(np.array(transcription.hessian(before, *data)), probe)
    soft /= np.max(np.abs(soft) / scale)
    expected = abs(soft @ hessian @ soft) / (scale @ np.abs(hessian) @ scale)
    assert regularity[0] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_end_of_a_step_is_judged_with_the_hessian_of_the_iterate(name):
    transcription, unknowns, data, _, _ = point(name)
    system = transcription.system
    _, step, sizes, _ = system.iterate(unknowns, data)
    hessian, soft = np.array(transcription.hessian(unknowns, *data)), system.algebra.workspace.arrays["soft"].copy()
    before = system.search(unknowns + step, data, step, sizes, 1.0)
    _, _, residual, regularity = system.judge(unknowns + step, data)
    after = system.search(unknowns + step, data, step, sizes, 1.0)
    np.testing.assert_array_equal(before[0], after[0])
    summary = [np.array(value).ravel(order="F") for value in transcription.summary(unknowns + step, *data)]
    scale = sizes_of(transcription, unknowns + step, data)
    floor = np.finfo(float).eps * (summary[3] + np.abs(hessian) @ scale)
    assert residual == pytest.approx(np.max(np.abs(summary[2]) / floor), rel=1e-9)
    soft /= np.max(np.abs(soft) / scale)
    expected = abs(soft @ hessian @ soft) / (scale @ np.abs(hessian) @ scale)
    assert regularity == pytest.approx(expected, rel=1e-6)


def test_a_gradient_that_is_not_finite_gives_no_measure():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.sqrt(x[0]), (0.0, 1.0), [1.0], [2.0])
    transcription = cg.transcribe(problem, cg.Galerkin(2), 3)
    data, unknowns = transcription.data(transcription.mesh), np.full(transcription.layout.free, -1.0)
    assert np.isnan(transcription.system.iterate(unknowns, data).norm)
    inside = np.full(transcription.layout.free, 1.5)
    _, step, sizes, _ = transcription.system.iterate(inside, data)
    assert np.isnan(transcription.system.search(unknowns, data, step, sizes, 1.0)[1:]).all()
