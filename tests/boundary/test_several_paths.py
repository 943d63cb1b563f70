"""All stationary paths that are known are found without a guess, none twice, and none that the mesh invents."""

import time
from functools import partial

import casadi as ca
import numpy as np
import pytest
from scenes import bratu, bratu_theta, catenoid, oscillator_problem, pendulum
from scipy.integrate import solve_ivp
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.boundary import several_paths
from casadi_galerkin.boundary.several_paths import Search, resolved
from casadi_galerkin.solvers.curve import LoadedCurve
from casadi_galerkin.solvers.deadline import until

SOLVES = 100  # within which every path has to be found
LONG = cg.BoundaryProblem(pendulum, (0.0, 10.0), [0.0], [1.0])
WELL = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + (1 - x[0] ** 2) ** 2 / 4, (0.0, 10.0), [0.0], [0.0])
RADII = 2.0, 1.0  # of the torus


def torus(t, x, v):
    """Half the squared speed on a torus; x[0] is the angle round the tube, x[1] that round the axis."""
    around, tube = RADII
    return (tube**2 * v[0] ** 2 + (around + tube * ca.cos(x[0])) ** 2 * v[1] ** 2) / 2


def euler_characteristic(paths):
    """Σ (-1)^index, which is one for all critical points of an action on a contractible space of paths."""
    return sum((-1) ** path.morse_index for path in paths)


@pytest.fixture(scope="module")
def swings():
    return cg.paths(LONG, cg.Galerkin(10), 16)


@pytest.fixture(scope="module")
def geodesics():
    problem = cg.BoundaryProblem(torus, (0.0, 1.0), [0.3, 0.0], [-0.2, 4 * np.pi])
    return cg.paths(problem, cg.Galerkin(8), 20, count=13)


@pytest.mark.slow
def test_the_known_swings_of_the_pendulum_are_found(swings):
    """Computed by shooting in higher precision: velocity at the start, action and Morse index."""
    assert swings.solves <= SOLVES
    known = [
        (1.9995687170165, -3.918564307581, 0),
        (1.8318277309911, 7.313292826489, 1),
        (1.3287479250456, 8.853960793439, 2),
    ]
    for velocity, action, index in known:
        (path,) = [path for path in swings if abs(path.action - action) < 1e-8]
        np.testing.assert_allclose(path.velocity[0, 0], velocity, rtol=1e-10, atol=0)
        assert path.morse_index == index


@pytest.mark.slow
def test_the_swings_of_the_pendulum_are_all_and_no_others(swings):
    """Swings that arrive at 1, by integration of all velocities from -2.1 to 2.1: beyond, the pendulum only rotates."""
    near = np.logspace(-9, -2, 60)
    velocities = np.sort(np.concatenate([np.linspace(-2.1, 2.1, 401), 2 - near, 2 + near, -2 - near, -2 + near]))
    count = len(velocities)
    initial = np.concatenate((np.zeros(count), velocities))
    answer = solve_ivp(
        lambda t, y: np.concatenate((y[count:], -np.sin(y[:count]))), (0, 10), initial, "DOP853", rtol=1e-12, atol=1e-12
    )
    off = answer.y[:count, -1] - 1.0
    brackets = np.flatnonzero(off[:-1] * off[1:] < 0)
    found = np.sort([path.velocity[0, 0] for path in swings])
    assert np.searchsorted(velocities, found).tolist() == (brackets + 1).tolist()
    assert len(swings) == 5
    assert euler_characteristic(swings) == 1


@pytest.mark.parametrize("rate", [2.0, *slow(3.5)])
@pytest.mark.slow
def test_both_paths_of_bratu_are_found(rate):
    found = cg.paths(cg.BoundaryProblem(bratu(rate), (0, 1), [0.0], [0.0]), cg.Galerkin(8), 16)
    assert found.solves <= SOLVES
    assert [path.morse_index for path in found] == [0, 1]
    for path, upper in zip(found, (False, True), strict=True):
        height = 2 * np.log(np.cosh(bratu_theta(rate, upper) / 4))
        np.testing.assert_allclose(path(0.5), height, rtol=1e-10, atol=0)


@pytest.mark.slow
def test_thirteen_geodesics_join_two_points_of_a_torus(geodesics):
    assert len(geodesics) == 13
    assert geodesics.solves <= SOLVES
    assert euler_characteristic(geodesics) == 1
    around, tube = RADII
    for path in geodesics:
        width = around + tube * np.cos(path.x[0])
        clairaut = width**2 * path.velocity[1]
        length = np.sqrt((tube * path.velocity[0]) ** 2 + (width * path.velocity[1]) ** 2)
        np.testing.assert_allclose(clairaut, clairaut[0], rtol=1e-8, atol=0)
        np.testing.assert_allclose(length, np.sqrt(2 * path.action), rtol=1e-8, atol=0)
        assert path.residual <= 50
        assert path.error_estimate < 1e-6


@pytest.mark.parametrize("found", ["swings", *slow("geodesics")])
def test_paths_differ_and_are_ordered_by_action(found, request):
    found = request.getfixturevalue(found)
    assert np.all(np.diff([path.action for path in found]) > 0)
    for i, path in enumerate(found):
        for other in found[:i]:
            assert np.max(np.abs(path.x - other.x)) > 1e-2


@pytest.fixture(scope="module")
def hops():
    """Of the symmetric double well, from its top to its top."""
    return cg.paths(WELL, cg.Galerkin(6), 12)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_paths_and_another_the_same_set(hops, monkeypatch):
    again = cg.paths(WELL, cg.Galerkin(6), 12)
    monkeypatch.setattr(several_paths, "SEED", 1)
    other = cg.paths(WELL, cg.Galerkin(6), 12)
    for first, second in zip(hops, again, strict=True):
        np.testing.assert_array_equal(first.x, second.x)
    np.testing.assert_allclose([path.action for path in other], [path.action for path in hops], rtol=1e-9, atol=0)


@pytest.mark.slow
def test_of_paths_that_a_symmetry_takes_to_one_another_one_is_returned(hops):
    folded = cg.paths(WELL, cg.Galerkin(6), 12, symmetries=[np.negative])
    assert [path.morse_index for path in hops] == [0, 0, 1, 1, 2, 2, 3]
    assert [path.morse_index for path in folded] == [0, 1, 2, 3]
    np.testing.assert_allclose([path.action for path in folded], [path.action for path in hops][::2], rtol=1e-9, atol=0)


@pytest.mark.slow
def test_a_symmetry_may_take_all_paths_of_a_class_to_one():
    """With both ends free, a swing may be moved by any number of turns, turned round, and mirrored."""
    problem = cg.BoundaryProblem(pendulum, (0.0, 5.0), [None], [None])
    found = cg.paths(
        problem,
        cg.Galerkin(6),
        8,
        symmetries=[lambda x: x - 2 * np.pi * np.round((x[0, 0] - 0.1) / (2 * np.pi))],
    )
    places = [np.exp(1j * path.x[0]) for path in found]
    for i, place in enumerate(places):
        for other in places[:i]:
            assert np.max(np.abs(place - other)) > 1e-3
    assert [path.morse_index for path in found] == [0, 1, 1, 2]  # upright, two swings with half a period of 5, hanging


@pytest.mark.slow
def test_free_and_periodic_ends():
    free = cg.paths(cg.BoundaryProblem(pendulum, (0.0, 10.0), [1.0], [None]), cg.Galerkin(8), 16)
    assert len(free) == 7
    for path in free:
        np.testing.assert_allclose(path.momentum[0, -1], 0.0, rtol=0, atol=1e-10)
    shaken = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]) + 0.5 * x[0] * ca.cos(t), (0, 2 * np.pi), [None], periodic=True
    )
    for path in cg.paths(shaken, cg.Galerkin(8), 8, count=4):
        np.testing.assert_allclose(
            [path.x[0, 0], path.momentum[0, 0]], [path.x[0, -1], path.momentum[0, -1]], atol=1e-9
        )


@pytest.mark.slow
def test_zigzags_of_a_coarse_mesh_are_dropped(swings):
    coarse = cg.paths(LONG, cg.Galerkin(1), 12)
    assert coarse.unresolved > 0
    assert f"{coarse.unresolved} dropped that the mesh does not resolve" in repr(coarse)
    for path in coarse:
        assert min(np.max(np.abs(path.x - swing(path.t))) for swing in swings) < 0.3


@pytest.mark.parametrize("duration", [4.0, *slow(8.0)])
@pytest.mark.slow
def test_where_the_straight_line_leads_to_nothing_its_load_does(duration):
    """A spring that pulls with the cube of its length; every path is a swing from its own velocity at the start."""
    spring = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 4 / 4, (0, duration), [0.0], [2.0])
    found = cg.paths(spring, cg.Galerkin(8), int(3 * duration), count=4)
    assert len({path.morse_index for path in found}) > 1
    assert any(path.solver == "Newton, the load of the guess taken away" for path in found)
    for path in found:
        state = [0.0, path.velocity[0, 0]]
        swing = solve_ivp(lambda t, y: [y[1], -(y[0] ** 3)], (0, duration), state, rtol=1e-10, atol=1e-12)
        growth = abs(state[1]) * duration  # of a change of the velocity, at most so many lengths of the path
        assert abs(swing.y[0, -1] - 2.0) < 10 * growth * path.error_estimate * np.max(np.abs(path.x)) + 1e-6


@pytest.mark.slow
def test_where_the_mesh_resolves_nothing_that_is_said():
    with pytest.raises(
        cg.ConvergenceError,
        match=r"no path was found in \d+ solves, but \d+ critical points of the .* may be no path .* cg\.sweep or",
    ):
        cg.paths(LONG, cg.Galerkin(1), 3)


@pytest.mark.slow
def test_members_of_a_family_are_counted_and_not_returned():
    """Any swing of a pendulum with this period may begin at any phase."""
    found = cg.paths(cg.BoundaryProblem(pendulum, (0, 7), [None], periodic=True), cg.Galerkin(8), 8)
    assert found.singular > 0
    assert f"{found.singular} dropped with a singular Hessian: a family of paths" in repr(found)
    for path in found:  # at rest, hanging or upright
        np.testing.assert_allclose(path.momentum, 0.0, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_conjugate_ends_are_an_error():
    problem = oscillator_problem(t_span=(0.0, np.pi), end=[0.0])
    with pytest.raises(
        cg.ConjugatePointError, match="no path was found in 20 solves; from the straight line, the second v"
    ):
        cg.paths(problem, cg.Galerkin(6), 10)


@pytest.mark.slow
def test_without_a_path_the_search_says_how_often_it_tried():
    problem = cg.BoundaryProblem(bratu(4.0), (0, 1), [0.0], [0.0])
    with pytest.raises(
        cg.ConvergenceError, match="no path was found in 20 solves; from the straight line, no path was"
    ) as caught:
        cg.paths(problem, cg.Galerkin(8), 10)
    assert caught.value.path is not None


def test_a_search_ends_when_the_time_is_up():
    problem = cg.BoundaryProblem(bratu(4.0), (0, 1), [0.0], [0.0])
    transcription = cg.transcribe(problem, cg.Galerkin(8), 10)
    search = Search(transcription, transcription.mesh, partial(resolved, transcription))
    with until(time.perf_counter()), pytest.raises(cg.ConvergenceError, match="no path was found in 1 solve; from"):
        search.run(1)


@pytest.mark.slow
def test_the_search_ends_at_the_count_or_when_nothing_new_is_found(swings):
    assert repr(swings).splitlines()[0].endswith("stopped after 20 solves without a new one")
    few = cg.paths(LONG, cg.Galerkin(8), 12, count=2)
    assert len(few) == 2
    assert repr(few).splitlines()[0] == f"Paths: 2 stationary paths in {few.solves} solves; stopped at count=2"
    single = cg.paths(oscillator_problem(), cg.Galerkin(4), 4)
    assert (len(single), single.solves) == (1, 21)
    assert repr(single).startswith("Paths: 1 stationary path in 21 solves")


@pytest.mark.slow
def test_a_table_shows_the_first_paths(geodesics):
    lines = repr(geodesics).splitlines()
    assert len(lines) == 8
    assert lines[1].split()[:5] == ["action", "146.795342683", "Morse", "index", "0"]
    assert lines[-1] == "  ... 7 more"


@pytest.mark.usefixtures("headless")
@pytest.mark.slow
def test_one_picture_shows_all(swings, geodesics):
    axes = swings.plot(labels="angle in rad", time="t in s")
    assert (len(axes.lines), axes.get_ylabel(), axes.get_xlabel()) == (5, "angle in rad", "t in s")
    assert axes.get_legend().get_texts()[0].get_text() == "action -3.91856, Morse index 0"
    for line, path in zip(axes.lines, swings, strict=True):
        np.testing.assert_array_equal(line.get_ydata()[[0, -1]], path.x[0, [0, -1]])
    assert geodesics.plot(component=1).get_legend() is None  # more than there are colors
    with pytest.raises(ValueError, match="component must be a whole number from 0 to 1, got 2"):
        geodesics.plot(component=2)
    assert geodesics.plot(1, labels=["φ"]).get_ylabel() == "φ"
    with pytest.raises(ValueError, match=r"labels of x must be 1 name, one per component, got \['λ', 'φ'\]"):
        geodesics.plot(labels=["λ", "φ"])


@pytest.mark.parametrize("load", [1.0, *slow(1e9)])
def test_a_load_leads_from_one_catenoid_to_the_other_and_back(load):
    transcription = cg.transcribe(cg.BoundaryProblem(catenoid, (-0.5, 0.5), [1.0], [1.0]), cg.Galerkin(8), 8)
    wide = transcription.critical_point()
    narrow = transcription.critical_point(guess=lambda t: [0.235 * np.cosh(t / 0.235)])
    unknowns, data = wide.solution.unknowns, wide.solution.data
    ones = np.ones(len(unknowns))
    curve = LoadedCurve(transcription.stationarity, data, np.append(unknowns, 0.0), ones, load * ones)
    ends = [list(curve.unloaded_points(side)) for side in (1.0, -1.0)]
    met = [guess for crossings in ends for guess in crossings[:1]]
    assert min(np.max(np.abs(guess - narrow.solution.unknowns)) for guess in met) < 0.1


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"count": 0}, ValueError, "count must be at least 1, got 0"),
        ({"count": 2.0}, TypeError, r"count must be a whole number, got 2\.0"),
        (
            {"symmetries": np.negative},
            TypeError,
            "symmetries must be a sequence of callables of node values, got <ufunc",
        ),
        ({"symmetries": None}, TypeError, "symmetries must be a sequence of callables of node values, got None"),
        ({"symmetries": iter([np.negative])}, TypeError, "symmetries must be a sequence of callables of node values"),
        ({"symmetries": [1.0]}, TypeError, r"symmetries\[0\] must be a callable of node values, got 1\.0"),
        ({"symmetries": [np.max]}, ValueError, r"symmetries\[0\] must return an array of shape \(1, 9\), got \(\)"),
        ({"method": 4}, TypeError, r"method must be a Galerkin, such as Galerkin\(degree=4\), got 4"),
        ({"intervals": None}, ValueError, "give either intervals or mesh"),
        ({"intervals": None, "method": None}, ValueError, "give either intervals or mesh"),
    ],
)
def test_bad_input_is_refused(given, error, message):
    with pytest.raises(error, match=message):
        cg.paths(LONG, **{"method": cg.Galerkin(4), "intervals": 2, **given})


@pytest.mark.parametrize(
    ("image", "error", "message"),
    [
        (lambda x: x[:, 1:], ValueError, r"symmetries\[0\] must return an array of shape \(1, 73\), got \(1, 72\)"),
        (lambda x: None, TypeError, r"what symmetries\[0\] returns must be real numbers, got None"),
        (lambda x: np.full_like(x, np.nan), ValueError, r"symmetries\[0\] must return finite numbers, got "),
    ],
    ids=["shape", "nothing", "not finite"],
)
def test_a_symmetry_is_checked_for_every_path(image, error, message):
    asked = []

    def symmetry(values):
        asked.append(values)
        return -values if len(asked) == 1 else image(values)

    with pytest.raises(error, match=message):
        cg.paths(WELL, cg.Galerkin(6), 12, symmetries=[symmetry])


def test_only_boundary_problems_have_several_paths():
    falling = cg.InitialProblem(pendulum, (0.0, 1.0), [0.0], velocity=[1.0])
    with pytest.raises(TypeError, match="problem must be a BoundaryProblem, got InitialProblem"):
        cg.paths(falling, cg.Galerkin(4), 4)


@pytest.mark.slow
def test_all_four_normals_from_a_point_inside_an_ellipse_are_found():
    """Apollonius: from inside its evolute, four straight lines meet an ellipse at right angles."""
    point, axes = np.array([0.3, 0.1]), np.array([2.0, 1.0])
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2,
        (0.0, 1.0),
        point.tolist(),
        [None, None],
        end_conditions=lambda x0, x1: (x1[0] / 2) ** 2 + x1[1] ** 2 - 1,
    )
    found = cg.paths(problem, cg.Galerkin(2), 4)
    ends = np.array([path.x[:, -1] for path in found])
    # the foot is the point stretched by a² / (a² + λ), for the real roots λ of a quartic
    factors = [np.poly1d([1.0, square]) ** 2 for square in axes**2]
    quartic = factors[0] * factors[1]
    for other, square, x in zip(factors[::-1], axes**2, point, strict=True):
        quartic = quartic - square * x**2 * other
    roots = np.real(quartic.roots[np.isreal(quartic.roots)])
    feet = point * axes**2 / (axes**2 + roots[:, None])
    assert len(found) == len(feet) == 4
    np.testing.assert_allclose(ends[np.argsort(ends[:, 0])], feet[np.argsort(feet[:, 0])], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_paths_on_a_circle_in_the_plane_are_those_in_its_angle(swings):
    """Up to whole turns: in the plane a swing that goes round and one that does not have the same ends."""

    def pose(angle):
        return [float(np.sin(angle)), float(-np.cos(angle))]

    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 - x[1],
        LONG.t_span,
        pose(0.0),
        pose(1.0),
        constraint=lambda t, x: ca.dot(x, x) - 1,
    )
    found = cg.paths(problem, cg.Galerkin(8), 16, count=4)
    assert len(found) >= 2
    for path in found:
        angles = np.unwrap(np.arctan2(path.x[0], -path.x[1]))
        if abs(angles[-1] - 1.0) < 1.0:  # no turn more: one of the swings
            assert min(abs(path.action - swing.action) for swing in swings) < 1e-7
            assert path.morse_index in [swing.morse_index for swing in swings]


def test_a_periodic_problem_of_given_energy_needs_a_guess():
    problem = cg.BoundaryProblem(pendulum, (0.0, 7.0), [None], periodic=True, energy=-0.5)
    with pytest.raises(ValueError, match="paths takes no periodic problem of given energy"):
        cg.paths(problem, cg.Galerkin(4), 10)


@pytest.mark.parametrize("energy", [None, 0.5])
def test_where_nothing_can_be_loaded_the_path_is_found(energy):
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0], energy=energy)
    (path,) = cg.paths(problem, cg.Galerkin(1), 1)
    np.testing.assert_allclose(path.t, [0.0, 1.0], rtol=0, atol=1e-14)


@pytest.fixture(scope="module")
def throws():
    """The flat throw and the high one of the same energy, which last differently."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2 - 9.81 * x[1], (0.0, 0.5), [0.0, 0.0], [1.0, 0.0], energy=10.0
    )
    return cg.paths(problem, cg.Galerkin(4), 6, count=2)


def test_paths_of_given_energy_say_when_they_end(throws):
    durations = [path.t[-1] for path in throws]
    np.testing.assert_allclose(np.sort(durations), [0.23115958593, 0.88196038917], rtol=1e-10)
    assert [path.problem.t_span for path in throws] == [(0.0, duration) for duration in durations]


def test_paths_of_given_energy_are_drawn_up_to_their_own_ends(throws):
    for path, line in zip(throws, throws.plot().lines, strict=True):
        assert line.get_xdata()[-1] == path.t[-1]
        np.testing.assert_array_equal(line.get_ydata(), path(line.get_xdata())[0])


def test_without_a_method_the_degree_is_eight():
    assert {path.method for path in cg.paths(LONG, intervals=12, count=1)} == {cg.Galerkin(8)}
