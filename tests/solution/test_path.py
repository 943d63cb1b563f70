"""A path is a function of time: its position, and with an order its derivatives, whatever it is the answer of."""

import numpy as np
import pytest
from control_problems import double_integrator, pendulum_in_three
from scenes import BY_NAME, bratu, pendulum

import casadi_galerkin as cg

EXACT = 1e-13  # of closed forms of size 1 to 10 that polynomials of the degree hold
STEP = 1e-5  # differences of second order are good to its square times the third derivative, some 1e-9


def failed():
    with pytest.raises(cg.ConvergenceError) as caught:
        cg.solve(cg.BoundaryProblem(bratu(10.0), (0, 1), [0.0], [0.0]), cg.Galerkin(4), 6)
    return caught.value.path


PATHS = {
    "boundary": lambda: BY_NAME["great circle"].solve(),
    "to a tolerance": lambda: cg.solve(BY_NAME["short pendulum"].problem, tol=1e-8),
    "steps": lambda: cg.solve(cg.InitialProblem(pendulum, (0, 2), [0.1], velocity=[1.0]), cg.Galerkin(5), 8),
    "control": lambda: cg.solve(pendulum_in_three(), cg.Galerkin(4), 10),
    "failed": failed,
}


@pytest.fixture(scope="module", params=PATHS)
def path(request):
    return PATHS[request.param]()


def test_a_path_takes_times_of_any_shape(path):
    d = len(path.x)
    middle = (path.t[0] + path.t[-1]) / 2
    for order in (0, 1):
        assert path(middle, order).shape == (d,)
        assert path([middle], order).shape == (d, 1)
        assert path(np.full((3, 2), middle), order).shape == (d, 3, 2)
        np.testing.assert_allclose(path(np.full((3, 2), middle), order)[:, 2, 1], path(middle, order), rtol=EXACT)


def test_a_path_passes_its_joints(path):
    size = np.max(np.abs(path.x))
    np.testing.assert_allclose(path(path.t), path.x, rtol=0, atol=EXACT * max(1, size))
    assert path.x.shape == (len(path.x), len(path.t))


def test_the_first_derivative_is_the_slope_of_the_path(path):
    steps = np.diff(path.t)
    inside = path.t[:-1] + 0.4 * steps
    h = STEP * steps
    slope = (path(inside + h) - path(inside - h)) / (2 * h)
    np.testing.assert_allclose(path(inside, 1), slope, rtol=0, atol=1e-6 * np.max(np.abs(slope)))


def test_derivatives_of_a_parabola_are_exact():
    path = BY_NAME["uniform gravity"].solve()
    times = np.linspace(0, 2, 21)
    np.testing.assert_allclose(path(times)[1], 10.31 * times - 9.81 * times**2 / 2, rtol=0, atol=EXACT)
    np.testing.assert_allclose(path(times, 1)[1], 10.31 - 9.81 * times, rtol=0, atol=10 * EXACT)
    np.testing.assert_allclose(path(times, 2)[1], -9.81, rtol=0, atol=100 * EXACT)


def test_the_velocity_of_least_effort_is_a_parabola():
    path = cg.solve(double_integrator(), cg.Galerkin(3), 4)
    times = np.linspace(0, 1, 21)
    np.testing.assert_allclose(path(times, 1)[0], 6 * times * (1 - times), rtol=0, atol=1e-8)  # IPOPT's tolerance


@pytest.mark.parametrize("order", [0, 1])
def test_times_outside_a_path_are_refused(path, order):
    for time in (path.t[0] - 0.1, path.t[-1] + 0.1, np.nan):
        with pytest.raises(ValueError, match="times must lie within"):
            path(time, order)


def test_no_array_of_a_path_changes_it(path):
    arrays = [path.t, path.x, path.polynomial.values]
    arrays += [getattr(path, name) for name in ("velocity", "energy") if hasattr(path, name)]
    arrays += [path.control.values, path.control.mesh, path.costate.values] if hasattr(path, "control") else []
    arrays += [value for value in vars(path).values() if isinstance(value, np.ndarray)]
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array *= 2.0


ANSWERS = "Trajectory ControlTrajectory Sensitivity Geometry Fold Branch Paths Comparison Sweep Row Trade"


@pytest.mark.parametrize("name", ANSWERS.split())
def test_an_answer_is_equal_to_itself_alone_and_can_be_a_key(name):
    """It holds arrays, of which NumPy tells no hash and not whether they are equal."""
    kind = getattr(cg, name)
    assert (kind.__eq__, kind.__hash__) == (object.__eq__, object.__hash__)
