"""What a failed solve had come to can be looked at: joints, positions, a call and a plot."""

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator
from scenes import bratu, kepler

import casadi_galerkin as cg

UNSOLVABLE = cg.BoundaryProblem(bratu(10.0), (0, 1), [0.0], [0.0])
FAILURES = {
    "newton": lambda: cg.solve(UNSOLVABLE, cg.Galerkin(4), 6),
    "rootfinder": lambda: cg.solve(UNSOLVABLE, cg.Galerkin(4), 6, solver=cg.rootfinder),
    "ipopt": lambda: cg.solve(UNSOLVABLE, cg.Galerkin(4), 6, solver=cg.ipopt),
    "minimizer": lambda: cg.solve(UNSOLVABLE, cg.Galerkin(4), 6, solver=cg.minimizer),
    "refinement": lambda: cg.solve(
        cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.exp(ca.exp(x[0])), (0, 1), [2.4], [13.4]), tol=1e-6
    ),
    "conjugate ends": lambda: cg.solve(
        cg.BoundaryProblem(lambda t, x, v: (v[0] ** 2 - x[0] ** 2) / 2, (0, np.pi), [0.0], [0.0]), cg.Galerkin(9), 9
    ),
    "steps": lambda: cg.solve(
        cg.InitialProblem(kepler(1.0), (0, 2), [1.0, 0.0], velocity=[0.0, 0.0]), cg.Galerkin(4), 200
    ),
    "shooting": lambda: cg.shoot(
        cg.BoundaryProblem(lambda t, x, v: (v[0] ** 2 + x[0] ** 2) / 2, (0, 200), [1.0], [1.0]), cg.Galerkin(4), 400
    ),
    "control": lambda: cg.solve(
        double_integrator(control_bounds=(-1.0, 1.0)), cg.Galerkin(3), 8
    ),  # a force of 4 would do it
}


@pytest.fixture(scope="module", params=FAILURES)
def error(request):
    with pytest.raises(cg.ConvergenceError) as caught:
        FAILURES[request.param]()
    return caught.value


def test_the_path_of_an_error_has_joints_and_positions_and_can_be_called(error):
    path = error.path
    assert np.all(np.diff(path.t) > 0)
    times = np.linspace(path.t[0], path.t[-1], 50)
    assert path(times).shape == path(times, 1).shape == (len(path.x), 50)
    np.testing.assert_allclose(path(path.t), path.x, rtol=1e-13, atol=1e-13)


@pytest.mark.usefixtures("headless")
def test_the_path_of_an_error_can_be_plotted(error):
    axes = error.path.plot(labels=[f"part {i}" for i in range(len(error.path.x))], time="t in s")
    assert axes.get_lines()
    if len(error.path.t) <= 100:
        np.testing.assert_array_equal(axes.get_lines()[1].get_xdata(), error.path.t)


def test_the_path_of_an_error_is_no_trajectory_unless_it_solves_its_own_mesh(error):
    """So nobody takes its action for that of an answer."""
    assert not isinstance(error.path, cg.Trajectory) or isinstance(error, cg.LimitReached)
    assert not hasattr(error.path, "action")


@pytest.mark.usefixtures("headless")
def test_a_picture_of_what_is_no_answer_says_so():
    with pytest.raises(cg.ConvergenceError) as caught:
        FAILURES["newton"]()
    assert caught.value.path.plot().get_title() == "A path of degree 4 on 6 intervals, not an answer"
    assert repr(caught.value.path).endswith("not an answer")
