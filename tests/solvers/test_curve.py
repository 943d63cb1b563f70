"""A curve of critical points is followed in any of the data: an end, a duration, an energy, a load."""

import casadi as ca
import numpy as np
import pytest

import casadi_galerkin as cg
from casadi_galerkin.solvers.curve import Curve, Point


def oscillator(duration=1.0, end=1.0):
    return cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0.0, duration), [0.0], [end])


def throw(energy):
    return cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2 - 9.81 * x[1], (0.0, 0.3), [0.0, 0.0], [1.0, 0.0], energy=energy
    )


def followed(problem, target):
    """Unknowns of the path of the target, along the curve from the path of the problem; and the graph."""
    graph = cg.transcribe(problem, cg.Galerkin(8), 6)
    last = graph.for_problem(target)
    joints = np.linspace(*target.t_span, 7)
    curve = Curve(graph.stationarity, graph.data(graph.mesh), last.data(joints))
    z = np.append(graph.critical_point().solution.unknowns, 0.0)
    curve.weights = np.ones(len(z))
    forward = np.append(np.zeros(len(z) - 1), 1.0)
    for point in curve.walk(Point(z, curve.tangent(z, forward))):
        if point.z[-1] >= 1:
            break
    curve.tolerance = 1e-12
    end = curve.corrected(np.append(point.z[:-1], 1.0), forward, np.inf)
    return last.emb(end[:-1], curve.data(1.0))


def test_the_end_is_moved():
    path = followed(oscillator(), oscillator(end=3.0))
    np.testing.assert_allclose(path(0.5), 3 * np.sin(0.5) / np.sin(1.0), rtol=1e-12)


def test_the_duration_grows():
    path = followed(oscillator(), oscillator(duration=2.5))
    np.testing.assert_allclose(path(1.0), np.sin(1.0) / np.sin(2.5), rtol=1e-9)


def test_the_energy_grows_and_the_duration_with_it_falls():
    path = followed(throw(6.0), throw(12.0))
    speed = np.sqrt(2 * 12.0)
    angle = np.arcsin(9.81 / speed**2) / 2
    assert path.mesh[-1] == pytest.approx(1 / (speed * np.cos(angle)), rel=1e-10)


def test_data_are_exact_at_both_ends_and_where_they_do_not_change():
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * x[0] - p[1] * x[0] ** 2, (0, 1), [0.0], [0.3], parameters=[0.1, 0.7]
    )
    graph = cg.transcribe(problem, cg.Galerkin(2), 2)
    target = graph.for_problem(problem.varied({"parameters": [1e6 / 3, 0.7]}))
    curve = Curve(graph.stationarity, graph.data(graph.mesh), target.data(graph.mesh))
    assert curve.data(0.0)[3].tolist() == [0.1, 0.7]
    assert curve.data(1.0)[3].tolist() == [1e6 / 3, 0.7]
    for s in (0.3, 0.77):
        assert curve.data(s)[3][1] == 0.7
        assert curve.data(s)[1].tolist() == [0.3]
