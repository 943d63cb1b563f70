"""A branch is followed to its target, or round its folds and back."""

import casadi as ca
import numpy as np
import pytest
from constrained import on_circle
from control_problems import double_integrator
from scenes import DAMPED, bratu_problem, bratu_theta, pendulum
from scipy.integrate import quad
from scipy.optimize import minimize_scalar
from scipy.special import ellipk, ellipkinc
from slow import slow

import casadi_galerkin as cg

FOLD = 3.513830719125162  # exact: λ = 8 / sinh²(θ/4) where θ/4 tanh(θ/4) = 1
DISCRETE = 1e-10  # relative; what degree 8 on ten intervals leaves of Bratu's paths


def height(rate, upper):
    return 2 * np.log(np.cosh(bratu_theta(rate, upper) / 4))


@pytest.fixture(scope="module")
def round_the_fold():
    return cg.continuation(bratu_problem(), [4.0], intervals=10)


def test_bratus_fold_is_located(round_the_fold):
    (fold,) = round_the_fold.folds
    np.testing.assert_allclose(fold.parameters, [FOLD], rtol=DISCRETE, atol=0)
    # at a fold the path is exact to the square root of the parameter's accuracy only
    np.testing.assert_allclose(fold.path(0.5), height(FOLD * (1 - 1e-15), upper=False), rtol=1e-6, atol=0)


@pytest.mark.slow
def test_the_walk_comes_back_on_the_upper_branch(round_the_fold):
    branch, (fold,) = round_the_fold, round_the_fold.folds
    assert not branch.reached
    np.testing.assert_array_equal(branch.parameters[[0, -1]], [[1.0], [1.0]])
    for k, (rate, path) in enumerate(zip(branch.parameters[:, 0], branch.trajectories, strict=True)):
        upper = k >= fold.after
        assert path.morse_index == int(upper)
        assert path.parameters == (rate,)
        np.testing.assert_allclose(path(0.5), height(rate, upper), rtol=1e3 * DISCRETE, atol=0)


def test_a_target_before_the_fold_is_reached():
    branch = cg.continuation(bratu_problem(), [3.5], cg.Galerkin(8), 10)
    assert branch.reached
    assert branch.folds == ()
    assert branch.parameters[-1, 0] == 3.5
    np.testing.assert_allclose(branch.trajectories[-1](0.5), height(3.5, upper=False), rtol=1e-9, atol=0)
    assert np.all(np.diff(branch.parameters[:, 0]) > 0)


def test_a_walk_may_begin_on_the_upper_branch_and_go_down_in_the_parameter():
    branch = cg.continuation(bratu_problem(2.0), [1.0], intervals=10, guess=lambda t: [12 * t * (1 - t)])
    assert branch.reached
    np.testing.assert_allclose(branch.trajectories[-1](0.5), height(1.0, upper=True), rtol=1e-7, atol=0)


def test_two_parameters_walk_on_a_line():
    def lagrangian(t, x, v, p):
        return p[0] * v[0] ** 2 / 2 + p[1] * x[0] ** 2 / 2

    problem = cg.BoundaryProblem(lagrangian, (0, 1), [0.0], [1.0], parameters=[1.0, 1.0])
    branch = cg.continuation(problem, [2.0, 8.0], intervals=8)
    np.testing.assert_allclose(branch.trajectories[-1](0.5), np.sinh(1) / np.sinh(2), rtol=1e-12, atol=0)
    np.testing.assert_allclose(branch.parameters[:, 1], 1 + 7 * (branch.parameters[:, 0] - 1), rtol=1e-14, atol=0)


def test_the_catenoid_breaks_at_its_critical_height():
    """Scaled to [-1, 1], the area of the film of half-distance h is x √(h² + x'²)."""
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: x[0] * ca.sqrt(p[0] ** 2 + v[0] ** 2), (-1, 1), [1.0], [1.0], parameters=[0.3]
    )
    branch = cg.continuation(problem, [1.0], intervals=10)
    np.testing.assert_allclose(branch.folds[0].parameters, [0.66274341934918], rtol=1e-10, atol=0)
    assert np.min(np.abs(np.diff(branch.parameters[:, 0]))) > 1e-6  # no path comes twice, that at the end neither


def test_the_zero_path_is_walked():
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 + p[0] * (1 - t) * ca.cos(x[0]), (0, 1), [0.0], [None], parameters=[5.0]
    )
    branch = cg.continuation(problem, [9.0], mesh=[0.0, 0.2, 0.5, 0.8, 1.0])
    assert branch.reached
    assert all(np.all(path.x == 0.0) for path in branch.trajectories)


@pytest.mark.usefixtures("headless")
@pytest.mark.slow
def test_a_new_picture_is_labeled_by_the_parameter(round_the_fold):
    axes = round_the_fold.plot(lambda path: path(0.5)[0])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("p[0]", "height")
    axes.set(xlabel="λ")
    assert round_the_fold.plot(lambda path: path(0.5)[0], axes).get_xlabel() == "λ"
    named = round_the_fold.plot(labels=("load", "size"))
    assert (named.get_xlabel(), named.get_ylabel()) == ("load", "size")
    with pytest.raises(ValueError, match="labels of the diagram must be 2 names, one per component, got 'load'"):
        round_the_fold.plot(labels="load")


@pytest.mark.usefixtures("headless")
@pytest.mark.slow
def test_a_branch_without_a_height_is_drawn_by_the_root_mean_square_of_its_paths(round_the_fold):
    axes = round_the_fold.plot()
    assert axes.get_ylabel() == "root mean square of x"
    drawn = max(line.get_xydata()[:, 1].max() for line in axes.lines if "Morse" in line.get_label())
    times = np.linspace(0, 1, 20001)
    sizes = [np.sqrt(np.mean(path(times)[0] ** 2)) for path in round_the_fold.trajectories]
    assert drawn == pytest.approx(max(sizes), rel=1e-4)


def test_a_branch_is_summarized(round_the_fold):
    lines = str(round_the_fold).splitlines()
    assert lines[0].startswith(f"Branch of {len(round_the_fold.trajectories)} paths from [1.] to [1.]")
    assert lines[1].startswith("  fold at [3.513830")


def test_bad_input_is_refused():
    problem = bratu_problem()
    plain = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0])
    with pytest.raises(ValueError, match="continuation changes the parameters of a problem, and this one has none"):
        cg.continuation(plain, [1.0], intervals=4)
    with pytest.raises(ValueError, match="the target must differ"):
        cg.continuation(problem, [1.0], intervals=4)
    massless = cg.BoundaryProblem(
        lambda t, x, v, p: (p[0] * v[0] ** 2 + x[0] ** 2) / 2, (0, 1), [1.0], [1.0], parameters=[1.0]
    )
    with pytest.raises(ValueError, match="the lagrangian is degenerate: its mass matrix"):
        cg.continuation(massless, [0.0], intervals=4)
    with pytest.raises(ValueError, match=r"target must have 1 component, got 2"):
        cg.continuation(problem, [1.0, 2.0], intervals=4)
    with pytest.raises(ValueError, match="give either intervals or mesh"):
        cg.continuation(problem, [2.0])


def towards(radius):
    """A free particle to a circle whose radius is the parameter."""
    return cg.BoundaryProblem(
        lambda t, x, v, p: ca.sumsqr(v) / 2,
        (0, 1),
        [3.0, 4.0],
        [None, None],
        parameters=[radius],
        end_conditions=lambda x0, x1, p: ca.sumsqr(x1) - p[0] ** 2,
    )


def test_a_parameter_of_the_end_conditions_alone_is_walked():
    branch = cg.continuation(towards(1.0), [2.0], intervals=3)
    for radius, path in zip(branch.parameters[:, 0], branch.trajectories, strict=True):
        np.testing.assert_allclose(path.x[:, -1], [0.6 * radius, 0.8 * radius], rtol=0, atol=1e-12)


def test_the_friction_of_a_forced_path_is_walked():
    branch = cg.continuation(DAMPED, [0.5], cg.Galerkin(10), 8)
    assert branch.reached
    assert branch.trajectories[-1](1.0)[0] == pytest.approx(-1.767917533169265, abs=1e-12)


@pytest.mark.slow
def test_the_gravity_of_a_constrained_path_is_walked():
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: ca.sumsqr(v) / 2 - p[0] * x[1],
        (0, 1.5),
        on_circle(0.2),
        on_circle(1.3),
        parameters=[0.0],
        constraint=lambda t, x, p: ca.sumsqr(x) - 1,
    )
    branch = cg.continuation(problem, [1.0], cg.Galerkin(10), 8, guess=lambda t: on_circle(0.2 + 1.1 * t / 1.5))
    angle = cg.solve(cg.BoundaryProblem(pendulum, (0, 1.5), [0.2], [1.3]), cg.Galerkin(10), 8)
    np.testing.assert_allclose(branch.trajectories[-1].x, on_circle(angle.x[0]), rtol=0, atol=1e-12)


@pytest.mark.slow
def test_the_attraction_of_an_orbit_of_given_energy_is_walked():
    """The axis is μ/(-2E), the period 2π √(axis³/μ): half a turn from pericenter 0.7 takes π μ/(-2E)^(3/2)."""
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: ca.sumsqr(v) / 2 + p[0] / ca.norm_2(x),
        (0, 3),
        [0.7, 0.0],
        [None, 0.0],
        parameters=[1.0],
        energy=-0.5,
    )
    guess = lambda t: [np.cos(np.pi * t / 3) - 0.3, 0.95 * np.sin(np.pi * t / 3)]  # noqa: E731
    branch = cg.continuation(problem, [1.2], cg.Galerkin(10), 12, guess=guess)
    for (mu,), path in zip(branch.parameters, branch.trajectories, strict=True):
        assert path.t[-1] == pytest.approx(np.pi * mu, rel=1e-11)
        assert path.problem.t_span == (path.t[0], path.t[-1])


@pytest.mark.parametrize("problem", [double_integrator(), 3], ids=["ControlProblem", "int"])
def test_only_boundary_problems_are_continued(problem):
    with pytest.raises(TypeError, match=f"problem must be a BoundaryProblem, got {type(problem).__name__}"):
        cg.continuation(problem, [1.2])


def test_the_free_phase_of_a_periodic_path_is_refused():
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * x[0] ** 2 / 2,
        (0, 6),
        [None],
        parameters=[1.0],
        periodic=True,
        energy=1.0,
    )
    with pytest.raises(ValueError, match="continuation takes no periodic problem of given energy"):
        cg.continuation(problem, [1.2], cg.Galerkin(6), 8, guess=lambda t: [np.sin(t)])


@pytest.mark.parametrize("imperfection", [1e-3, *slow(1e-5)])
def test_a_sharp_fold_is_exact(imperfection):
    """On the other side, the rod is bent by x = -2 asin(k sn(√p t)), whose least load is that at the fold."""

    def load(k):
        return (2 * ellipk(k**2) + ellipkinc(np.arcsin(np.sin(imperfection / 2) / k), k**2)) ** 2

    rod = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 + p[0] * ca.cos(x[0]), (0, 1), [0.0], [imperfection], parameters=[15.0]
    )
    branch = cg.continuation(rod, [5.0], intervals=10, guess=lambda t: [-1.8 * np.sin(np.pi * t)])
    least = minimize_scalar(load, bounds=(imperfection, 0.9), method="bounded", options={"xatol": 1e-12}).fun
    np.testing.assert_allclose(branch.folds[0].parameters, [least], rtol=1e-12, atol=0)


@pytest.mark.slow
def test_a_first_step_that_lands_on_a_conjugate_point_is_shortened():
    """That of a path at rest is a twentieth of the way; from (kπ)² on it is a saddle of Morse index k."""
    target = 9 + 20 * (np.pi**2 - 9)
    rest = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * x[0] ** 2 / 2, (0, 1), [0.0], [0.0], parameters=[9.0]
    )
    branch = cg.continuation(rest, [target], intervals=10)
    assert branch.reached
    assert [path.morse_index for path in branch.trajectories] == [int(p > np.pi**2) for p in branch.parameters[:, 0]]


@pytest.mark.parametrize("imperfection", [1e-2, *slow(1e-6)])
def test_a_branch_grows_far_beyond_the_size_of_its_first_path(imperfection):
    """Past an imperfect bifurcation, that of a rod under its load, the path is up to a million times as large."""
    rod = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 + p[0] * ca.cos(x[0]), (0, 1), [0.0], [imperfection], parameters=[1.0]
    )
    branch = cg.continuation(rod, [20.0], intervals=10)
    bent = rod.varied({"parameters": [20.0]})
    direct = cg.solve(bent, cg.Galerkin(8), 10, guess=lambda t: [2.2 * np.sin(np.pi * t)])
    assert branch.reached
    assert branch.trajectories[-1].morse_index == direct.morse_index == 0
    np.testing.assert_allclose(branch.trajectories[-1](0.5), direct(0.5), rtol=1e-9, atol=0)
    assert len(branch.trajectories) < 200


@pytest.mark.parametrize(("first", "target"), [(0.3, 0.1), *slow((1e-6, 1e6))])
def test_a_branch_ends_at_its_target_to_the_last_digit(first, target):
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 + x[0] ** 4 / 4 + p[0] * x[0] + p[1],
        (0, 1),
        [0.0],
        [0.0],
        parameters=[first, 0.1],
    )
    branch = cg.continuation(problem, [target, 0.1], intervals=20)
    assert branch.parameters[-1].tolist() == [target, 0.1]
    assert set(branch.parameters[:, 1]) == {0.1}


def test_a_branch_that_shrinks_to_nothing_is_followed_to_its_end():
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 + x[0] ** 4 / 4 + p[0] * x[0], (0, 1), [0.0], [0.0], parameters=[1.0]
    )
    branch = cg.continuation(problem, [0.0], intervals=10)
    assert branch.reached
    assert np.max(np.abs(branch.trajectories[-1].x)) < 1e-150
    assert len(branch.trajectories) < 40


def test_a_branch_along_an_axis_of_symmetry_is_followed():
    """The pulls of three anchors across the axis cancel up to rounding, which keeps no path exactly on it."""
    angles = np.pi / 2 + 2 * np.pi * np.arange(3) / 3

    def plane(t, x, v, p):
        return ca.sumsqr(v) / 2 - p[0] * sum(ca.exp(np.cos(a) * x[0] + np.sin(a) * x[1]) for a in angles)

    def line(t, x, v, p):
        return v[0] ** 2 / 2 - p[0] * sum(ca.exp(np.sin(a) * x[0]) for a in angles)

    in_plane = cg.BoundaryProblem(plane, (0, 1), [0.0, 0.0], [0.0, 1.0], parameters=[0.1])
    on_line = cg.BoundaryProblem(line, (0, 1), [0.0], [1.0], parameters=[0.1])
    path, exact = (cg.continuation(each, [1.0], intervals=10).trajectories[-1] for each in (in_plane, on_line))
    np.testing.assert_allclose(path.x[1], exact.x[0], rtol=1e-12, atol=1e-13)
    assert np.max(np.abs(path.x[0])) < 1e-14


@pytest.mark.parametrize("unit", [1e-9, *slow(1e9)])
def test_a_branch_that_begins_at_a_path_that_is_zero_finds_its_fold_in_any_unit(unit):
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - unit**2 * (ca.exp(x[0] / unit) - (1 - p[0]) * x[0] / unit),
        (0, 1),
        [0.0],
        [0.0],
        parameters=[0.0],
    )
    branch = cg.continuation(problem, [20.0], intervals=10)
    (fold,) = branch.folds
    assert not branch.reached
    # by shooting from the middle of the path with DOP853
    assert fold.parameters[0] == pytest.approx(12.422831986387, rel=1e-9)


def test_a_fold_is_exact_where_the_target_is_far():
    branch = cg.continuation(bratu_problem(), [1e6], intervals=10)
    assert branch.folds[0].parameters[0] == pytest.approx(FOLD, rel=1e-13)


@pytest.mark.slow
def test_a_branch_whose_paths_grow_without_bound_is_left_with_its_last_path():
    """The upper branch of Bratu's problem goes to infinity where the parameter goes to zero, where it began."""
    with pytest.raises(cg.ConvergenceError, match="grow without bound") as raised:
        cg.continuation(bratu_problem(0.0), [4.0], intervals=40)
    assert raised.value.path.x.max() > 100


def s_curve(p, origin=0.0):
    """A force that is switched on at a height of 1: weak and strong paths, and a third one between two folds."""

    def energy(x):
        return ca.log(1 + ca.exp(8 * (x - 1))) / 8 + 0.05 * x

    return cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * energy(x[0] - origin), (0, 1), [origin], [origin], parameters=[p]
    )


def folds_of_s_curve():
    """Both folds, from the energy integral: √(p/2) = ∫ dx / √(V(m) - V(x)) from 0 to the middle m."""

    def energy(x):
        return np.logaddexp(0, 8 * (x - 1)) / 8 + 0.05 * x

    def parameter(m):
        return 2 * quad(lambda s: 2 * m * s / np.sqrt(energy(m) - energy(m * (1 - s * s))), 0, 1, epsabs=1e-12)[0] ** 2

    first = minimize_scalar(lambda m: -parameter(m), bounds=(0.3, 0.9), method="bounded", options={"xatol": 1e-9})
    second = minimize_scalar(parameter, bounds=(1.1, 2.2), method="bounded", options={"xatol": 1e-9})
    return -first.fun, second.fun


@pytest.mark.parametrize("origin", [100.0, *slow(0.0)])
@pytest.mark.parametrize("ends", [(1.0, 200.0), *slow([200.0, 1.0])])
@pytest.mark.slow
def test_a_branch_is_not_left_for_another_sheet_of_an_s_curve(ends, origin):
    """The folds are at heights of 0.6 and 1.5, and the last path is 26 high."""
    branch = cg.continuation(s_curve(ends[0], origin), [ends[1]], intervals=20)
    assert branch.reached
    found = sorted(float(fold.parameters[0]) for fold in branch.folds)
    np.testing.assert_allclose(found, sorted(folds_of_s_curve()), rtol=1e-6)
    assert [path.morse_index for path in branch.trajectories][:: len(branch.trajectories) - 1] == [0, 0]


@pytest.mark.slow
def test_a_branch_that_turns_back_ends_where_it_began_even_near_zero():
    """Where the parameter is near zero the other path is far: there the parameters must not leave their line."""
    hardening = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - x[0] ** 2 / 2 - p[0] * x[0] ** 4 / 4,
        (0, 3),
        [0.0],
        [1.0],
        parameters=[0.002],
    )
    near, far = (cg.continuation(hardening, [target], intervals=16) for target in (10.0, 200.0))
    for branch in (near, far):
        assert branch.parameters[[0, -1]].tolist() == [[0.002], [0.002]]
        assert np.all(branch.parameters >= 0.002)
    np.testing.assert_allclose(far.trajectories[-1].x, near.trajectories[-1].x, rtol=0, atol=1e-9)


@pytest.mark.parametrize("height", [lambda path: path(0.5), lambda path: path(0.5)[0] / 0.0, lambda path: None])
def test_a_height_that_is_no_number_is_refused(round_the_fold, height):
    with np.errstate(divide="ignore"), pytest.raises(ValueError, match="what height returns must be a finite number"):
        round_the_fold.plot(height)
    with pytest.raises(TypeError, match="height must be a callable Path -> number, got 3"):
        round_the_fold.plot(3)


@pytest.mark.slow
def test_a_branch_that_meets_its_mirror_image_turns_where_another_one_crosses():
    """Half a period later a path is its mirror image; both meet where the Morse index of the symmetric path changes."""
    duffing = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - x[0] ** 4 / 4 + x[0] ** 2 / 2 + p[0] * x[0] * ca.cos(t),
        (0, 2 * np.pi),
        [None],
        [None],
        parameters=[0.3],
        periodic=True,
    )
    path = cg.paths(duffing, cg.Galerkin(8), 20, 6)[1]
    branch = cg.continuation(duffing, [2.0], cg.Galerkin(8), 20, guess=path)
    (fold,) = branch.folds
    half = np.roll(path.x[:, :-1], 10, axis=1)
    np.testing.assert_allclose(branch.trajectories[-1].x[:, :-1], -half, rtol=0, atol=1e-9)
    for share, index in ((-1e-6, 0), (1e-6, 1)):
        beside = duffing.varied({"parameters": [fold.parameters[0] * (1 + share)]})
        symmetric = cg.solve(beside, cg.Galerkin(8), 20, guess=lambda t: [-0.8 * np.cos(t)])
        assert symmetric.morse_index == index


def two_folds(beyond, origin):
    """Constant paths along p = 16 y⁵ - 20 y³ + 5.3 y, from `beyond` the fold at y = -0.31981588, with y = x there."""
    first = -0.31981588 + beyond

    def force(y):
        return 16 * y**5 - 20 * y**3 + 5.3 * y

    def lagrangian(t, x, v, p):
        y = x[0] + first - origin
        return v[0] ** 2 / 2 + (16 * y**6 / 6 - 5 * y**4 + 5.3 * y**2 / 2 - p[0] * x[0]) / 10

    return cg.BoundaryProblem(lagrangian, (0, 1), [None], [None], parameters=[force(first)])


@pytest.mark.parametrize("origin", [5.0, *slow(0.0)])
@pytest.mark.parametrize("beyond", [1e-2, *slow(1e-3)])
def test_a_branch_that_begins_beside_a_fold_finds_the_next_ones(beyond, origin):
    """The first rate is far too large there, and where x is zero there is no size to compare it with."""
    branch = cg.continuation(two_folds(beyond, origin), [3.0], cg.Galerkin(2), 2, guess=lambda t: [origin])
    folds = [fold.parameters[0] for fold in branch.folds]
    y = np.sqrt((60 - np.sqrt(3600 - 4 * 80 * 5.3)) / 160), np.sqrt((60 + np.sqrt(3600 - 4 * 80 * 5.3)) / 160)
    expected = [16 * a**5 - 20 * a**3 + 5.3 * a for a in y]
    np.testing.assert_allclose(folds, expected, rtol=1e-9)


@pytest.mark.parametrize("target", [2.0, *slow(400.0)])
def test_a_branch_whose_first_rate_is_zero_is_followed(target):
    """The parameter enters squared: x = sinh(p t)/sinh p."""
    tunnel = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 + (p[0] * x[0]) ** 2 / 2, (0, 1), [0.0], [1.0], parameters=[0.0]
    )
    branch = cg.continuation(tunnel, [target], cg.Galerkin(8), intervals=60)
    assert branch.reached
    assert len(branch.trajectories) < 150


@pytest.mark.parametrize("beside", [0.002, *slow(1e-4)])
@pytest.mark.parametrize("bent", [1.0, *slow(-1.0)])
def test_a_branch_is_not_left_where_two_nearly_cross(bent, beside):
    """A rod under less and less pressure, one end a little aside: bent to that side, it straightens without a fold.

    Bent to the other side it snaps, and leads back as a saddle.  The two curves come as near as the end is aside, and
    were taken for one.
    """
    problem = cg.BoundaryProblem(
        lambda s, x, v, p: v[0] ** 2 / 2 + p[0] * ca.cos(x[0]), (0.0, 1.0), [0.0], [beside], parameters=[20.0]
    )
    branch = cg.continuation(
        problem, [5.0], intervals=12, guess=lambda s: [bent * 1.5 * np.sin(np.pi * s) + beside * s]
    )
    assert (branch.reached, len(branch.folds)) == ((True, 0) if bent > 0 else (False, 1))
    assert branch.trajectories[-1].morse_index == (0 if bent > 0 else 1)
    assert np.sign(branch.trajectories[-1](0.5)[0]) == bent


@pytest.mark.parametrize(("method", "intervals"), [(cg.Galerkin(4), 12), *slow((cg.Galerkin(8), 16))])
def test_swings_shrink_to_rest_where_they_meet_their_mirror_images(method, intervals):
    """The energy of rest is -1; there the corrector fails, and the fold lies between points on both sides."""
    turn = np.pi / 2
    pendulum_of_energy = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 + ca.cos(x[0]) + p[0],
        (0, 7.4),
        [0.0],
        periodic=True,
        energy=0.0,
        parameters=[0.0],
    )
    branch = cg.continuation(
        pendulum_of_energy, [-3.0], method, intervals, guess=lambda t: [turn * np.sin(2 * np.pi * t / 7.4)]
    )
    (fold,) = branch.folds
    assert fold.parameters[0] == pytest.approx(-1, abs=1e-6)


@pytest.mark.slow
def test_a_branch_ends_where_the_mesh_does_not_resolve_its_paths():
    """Bratu's problem in a ball, whose paths are steeper and steeper at the center.

    The next fold is at 2.1085411, and what the mesh has in its place is at 2.839.
    """
    ball = cg.BoundaryProblem(
        lambda t, x, v, p: t**2 * (v[0] ** 2 / 2 - p[0] * ca.exp(x[0])), (0, 1), [None], [0.0], parameters=[0.1]
    )
    branch = cg.continuation(ball, [5.0], intervals=10)
    folds = [fold.parameters[0] for fold in branch.folds]
    np.testing.assert_allclose(folds, [3.32199212, 1.66415619], rtol=1e-7)  # by DOP853 from the center
    assert not branch.reached
    assert "the next one, at [1.7" in branch.stopped
    assert "take more intervals" in str(branch)
    assert max(path.estimate_error() for path in branch.trajectories) < 0.1  # beyond, it grew to 150


def test_a_branch_does_not_begin_at_a_path_that_the_mesh_does_not_resolve():
    layers = cg.BoundaryProblem(
        lambda t, x, v, p: p[0] * v[0] ** 2 / 2 + x[0] ** 2 / 2, (0, 1), [1.0], [1.0], parameters=[1e-4]
    )
    with pytest.raises(cg.ConvergenceError, match="the first path of the branch is NOT RESOLVED: about 5e-02 of x"):
        cg.continuation(layers, [1.0], intervals=4)


@pytest.mark.parametrize("force", [ca.sqrt, lambda p: ca.exp(-1 / p)])
def test_a_branch_that_begins_where_it_has_no_rate_is_refused(force):
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - force(p[0]) * x[0], (0, 1), [0.0], [1.0], parameters=[0.0]
    )
    with pytest.raises(cg.ConvergenceError, match=r"changes there at a rate that is not finite. Begin at other"):
        cg.continuation(problem, [1.0], cg.Galerkin(4), intervals=4)


@pytest.mark.parametrize(("depth", "where", "waves"), [(1.11e-5, 0.879, 3.257), *slow((1.41e-3, 1.2, 2.19))])
@pytest.mark.slow
def test_a_branch_ends_before_a_fold_that_lies_just_beyond_its_end(depth, where, waves):
    """Back at p = 0 there is one rest position on either side of that fold."""
    before = where - np.sqrt(depth)

    def lagrangian(t, x, v, p):
        height = x[0] ** 4 / 4 - 2 * where * x[0] ** 3 / 3 + (where**2 - depth) * x[0] ** 2 / 2 - p[0] * x[0]
        return ca.sumsqr(v) / 2 - height - (x[1] - 3 * ca.sin(waves * x[0])) ** 2 / 2

    problem = cg.BoundaryProblem(lagrangian, (0, 1), [None, None], [None, None], parameters=[0.0])
    branch = cg.continuation(problem, [1.0], cg.Galerkin(2), 2)
    assert not branch.reached
    assert len(branch.folds) == 1
    assert branch.trajectories[-1](0.5)[0] == pytest.approx(before, abs=1e-9)
