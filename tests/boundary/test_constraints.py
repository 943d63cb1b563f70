"""Holonomic constraints between two ends: the same paths as in angles, orders, multipliers, indices, refusals."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from constrained import MECHANISMS, on_circle, on_sphere, planar, spatial, uneven, unit_length
from rules import OF_DEGREE
from scenes import oscillator_problem, pendulum
from slow import slow

import casadi_galerkin as cg

JOINTS = 1e-11  # two discretizations of one path, both converged
HELD = 1e-13  # |g| at the joints
METHOD = cg.Galerkin(10)
ENDS = {  # duration, angles at both ends
    "pendulum": (1.5, [0.2], [1.3]),
    "spherical pendulum": (2.0, [1.0, 0.0], [1.3, 2.0]),
    "double pendulum": (0.5, [1.0, 1.2], [0.34, 0.675]),
}


def spatial_free(t, x, v):
    return ca.sumsqr(v) / 2


@cache
def angles_of(name):
    duration, first, last = ENDS[name]
    return cg.solve(cg.BoundaryProblem(MECHANISMS[name][0], (0, duration), first, last), METHOD, intervals=12)


def constrained_path(name, method=METHOD, intervals=12, solver=cg.newton):
    """The path in Cartesian coordinates from the guess that turns the angles evenly."""
    (_, cartesian, place, constraint), (duration, *ends) = MECHANISMS[name], ENDS[name]
    first, last = np.array(ends)
    problem = cg.BoundaryProblem(cartesian, (0, duration), place(first), place(last), constraint=constraint)
    guess = lambda t: place(first + (last - first) * t / duration)  # noqa: E731
    return cg.solve(problem, method, intervals=intervals, guess=guess, solver=solver)


@pytest.mark.parametrize("name", MECHANISMS)
def test_a_mechanism_in_cartesian_coordinates_is_that_in_angles(name):
    angles, path = angles_of(name), constrained_path(name)
    np.testing.assert_allclose(path.x, MECHANISMS[name][2](angles.x), rtol=0, atol=JOINTS)
    assert path.action == pytest.approx(angles.action, rel=1e-13)
    np.testing.assert_allclose(path.energy, angles.energy, rtol=1e-11)


@pytest.mark.parametrize("name", MECHANISMS)
@pytest.mark.parametrize("degree", [1, 3, *slow(10)])
def test_a_constraint_holds_at_all_nodes_and_velocities_are_tangent_at_the_joints_whatever_the_degree(name, degree):
    path, constraint = constrained_path(name, cg.Galerkin(degree)), MECHANISMS[name][3]
    off = [np.array(constraint(0, ca.DM(x))) for x in path.polynomial.values.T]
    assert np.max(np.abs(off)) <= HELD
    x = ca.SX.sym("x", len(path.x))
    slope = ca.Function("slope", [x], [ca.jacobian(constraint(0, x), x)])
    off = [np.array(slope(x)) @ v for x, v in zip(path.x.T, path.velocity.T, strict=True)]
    assert np.max(np.abs(off)) <= HELD


def test_a_spherical_pendulum_on_its_sphere_keeps_its_spin_at_any_degree():
    path = constrained_path("spherical pendulum", cg.Galerkin(2))
    spin = path.x[0] * path.momentum[1] - path.x[1] * path.momentum[0]
    np.testing.assert_allclose(spin, spin[0], rtol=1e-12)
    assert np.ptp(path.energy) > 1e-7  # while its energy has the error of the method


# orders


def uneven_in_angle(t, x, v):
    place, heading = ca.vertcat(ca.sin(x[0]), -ca.cos(x[0])), ca.vertcat(ca.cos(x[0]), ca.sin(x[0]))
    return uneven(t, place, heading * v[0])


MESHES = {  # duration and intervals that show the order: past the coarse meshes, and clear of roundoff
    1: (1.5, (24, 32, 48)),
    3: (1.5, (8, 10, 12)),
    5: (2.8, (5, 6, 7)),
}
PLATEAU = 1e-13
# lobatto(1) has no points; radau(5) shows 8.7 to 8.8 on meshes as coarse as order 9 needs
CASES = [(m, rule) for m in MESHES for rule in OF_DEGREE if (m, rule) not in ((1, "lobatto(m)"), (5, "radau(m)"))]


@pytest.fixture(scope="module")
def exact():
    """Angles and rates at the joints of a mesh, from a solve in angles that resolves them."""
    fine = {}

    def at(duration, joints):
        if duration not in fine:
            problem = cg.BoundaryProblem(uneven_in_angle, (0, duration), [0.2], [1.3])
            fine[duration] = cg.solve(problem, cg.Galerkin(16), intervals=12)
        return fine[duration](joints)[0], fine[duration](joints, 1)[0]

    return at


def error(method, duration, intervals, exact):
    problem = cg.BoundaryProblem(uneven, (0, duration), on_circle(0.2), on_circle(1.3), constraint=unit_length)
    path = cg.solve(problem, method, intervals=intervals, guess=lambda t: on_circle(0.2 + 1.1 * t / duration))
    angle, rate = exact(duration, path.t)
    heading = rate * np.array([np.cos(angle), np.sin(angle)])
    return np.sqrt(np.mean((path.x - on_circle(angle)) ** 2) + np.mean((path.velocity - heading) ** 2))


@pytest.mark.parametrize(("m", "rule"), [*CASES[:4], *slow(*CASES[4:])])
def test_order_at_the_joints_is_that_without_a_constraint(m, rule, exact):
    method, (duration, counts) = cg.Galerkin(m, quadrature=OF_DEGREE[rule](m)), MESHES[m]
    errors = [error(method, duration, count, exact) for count in counts]
    assert min(errors) > PLATEAU
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] == pytest.approx(method.order, abs=0.2)


@pytest.mark.parametrize("points", [cg.equispaced_points(4), cg.chebyshev_points(4)], ids=["equispaced", "chebyshev"])
def test_control_points_that_lose_the_order_are_refused(points):
    problem = cg.BoundaryProblem(planar, (0, 1), on_circle(0.2), on_circle(1.3), constraint=unit_length)
    with pytest.raises(ValueError, match=r"to keep order 2m, they must be the default, lobatto_points\(4\), got \[0"):
        cg.solve(problem, cg.Galerkin(4, control_points=points), intervals=4)


# multipliers


def test_the_multiplier_of_a_pendulum_is_the_tension_of_its_rod():
    """Half of it and towards the pivot, as g = |x|² - 1 grows by 2 along the rod."""
    angles, path = angles_of("pendulum"), constrained_path("pendulum")
    tension = angles.velocity[0] ** 2 + np.cos(angles.x[0])
    multipliers = path.multipliers(path.t)
    assert multipliers.shape == (1, 13)
    np.testing.assert_allclose(multipliers[0], -tension / 2, rtol=0, atol=JOINTS)


def test_multipliers_come_in_the_shape_of_the_times_asked_for():
    path = constrained_path("double pendulum")
    assert path.multipliers(0.2).shape == (2,)
    assert path.multipliers(np.full((3, 4), 0.2)).shape == (2, 3, 4)
    np.testing.assert_allclose(path.multipliers(path.t[3]), path.multipliers(path.t)[:, 3], rtol=0, atol=0)


@pytest.mark.slow
def test_multipliers_between_the_joints_have_order_m():
    exact = constrained_path("pendulum", cg.Galerkin(12))
    times, counts, errors = np.linspace(0.01, 1.49, 301), (10, 20, 40), []
    for count in counts:
        path = constrained_path("pendulum", cg.Galerkin(3), intervals=count)
        errors.append(np.sqrt(np.mean((path.multipliers(times) - exact.multipliers(times)) ** 2)))
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] == pytest.approx(3, abs=0.2)


def test_a_path_without_a_constraint_has_no_multipliers():
    path = cg.solve(oscillator_problem(), METHOD, intervals=2)
    with pytest.raises(ValueError, match="the problem has no constraint, so no multipliers"):
        path.multipliers(0.5)


# constraints that depend on time, on parameters; forces and free ends beside them


def test_a_pendulum_of_changing_length_is_that_in_its_angle():
    length = lambda t: 1 + 0.3 * ca.sin(2 * t)  # noqa: E731

    def in_angle(t, x, v):
        return (length(t) ** 2 * v[0] ** 2 + (0.6 * ca.cos(2 * t)) ** 2) / 2 + length(t) * ca.cos(x[0])

    place = lambda t, angle: (1 + 0.3 * np.sin(2 * t)) * on_circle(angle)  # noqa: E731
    angle = cg.solve(cg.BoundaryProblem(in_angle, (0, 1.5), [0.2], [1.1]), METHOD, intervals=12)
    problem = cg.BoundaryProblem(
        planar, (0, 1.5), place(0, 0.2), place(1.5, 1.1), constraint=lambda t, x: ca.norm_2(x) - length(t)
    )
    path = cg.solve(problem, METHOD, intervals=12, guess=lambda t: place(t, 0.2 + 0.6 * t))
    t, a, w = path.t, angle.x[0], angle.velocity[0]
    np.testing.assert_allclose(path.x, place(t, a), rtol=0, atol=JOINTS)
    pull = -1.2 * np.sin(2 * t) - (1 + 0.3 * np.sin(2 * t)) * w**2 - np.cos(a)  # r'' - r w² - cos a
    np.testing.assert_allclose(path.multipliers(t)[0], pull, rtol=0, atol=JOINTS)


def test_a_bead_on_a_turning_hoop_is_that_in_its_angle():
    rate = 1.7

    def in_angle(t, x, v):
        return (v[0] ** 2 + rate**2 * ca.sin(x[0]) ** 2) / 2 + ca.cos(x[0])

    def hoop(t, x):
        return ca.vertcat(ca.sumsqr(x) - 1, ca.cos(rate * t) * x[1] - ca.sin(rate * t) * x[0])

    place = lambda t, angle: on_sphere((angle, rate * t))  # noqa: E731
    angle = cg.solve(cg.BoundaryProblem(in_angle, (0, 1.5), [0.3], [1.2]), METHOD, intervals=12)
    problem = cg.BoundaryProblem(spatial, (0, 1.5), place(0, 0.3), place(1.5, 1.2), constraint=hoop)
    path = cg.solve(problem, METHOD, intervals=12, guess=lambda t: place(t, 0.3 + 0.6 * t))
    a, w = angle.x[0], angle.velocity[0]
    np.testing.assert_allclose(path.x, place(path.t, a), rtol=0, atol=JOINTS)
    # the hoop pushes sideways with the Coriolis force
    np.testing.assert_allclose(path.multipliers(path.t)[1], 2 * rate * w * np.cos(a), rtol=0, atol=JOINTS)


@pytest.mark.parametrize("coefficient", [0.3, -0.2])
def test_friction_on_a_constrained_path_is_that_in_the_angle(coefficient):
    friction = lambda t, x, v: -coefficient * v  # noqa: E731
    angle = cg.solve(cg.BoundaryProblem(pendulum, (0, 2), [0.2], [1.3], force=friction), METHOD, intervals=10)
    problem = cg.BoundaryProblem(planar, (0, 2), on_circle(0.2), on_circle(1.3), constraint=unit_length, force=friction)
    path = cg.solve(problem, METHOD, intervals=10, guess=lambda t: on_circle(0.2 + 0.55 * t))
    np.testing.assert_allclose(path.x, on_circle(angle.x[0]), rtol=0, atol=JOINTS)
    assert path.morse_index is None


def test_a_free_end_of_a_constrained_path_has_no_momentum_along_the_constraint():
    problem = cg.BoundaryProblem(planar, (0, 1), on_circle(1.2), [None, None], constraint=unit_length)
    path = cg.solve(problem, METHOD, intervals=6, guess=lambda t: on_circle(1.2 - t / 2))
    angle = cg.solve(cg.BoundaryProblem(pendulum, (0, 1), [1.2], [None]), METHOD, intervals=6)
    np.testing.assert_allclose(path.x, on_circle(angle.x[0]), rtol=0, atol=JOINTS)
    np.testing.assert_allclose(path.momentum[:, -1], 0, rtol=0, atol=HELD)


def on_cylinder(t, x):
    return x[0] ** 2 + x[1] ** 2 - 1


@pytest.mark.parametrize("solver", [cg.newton, *slow(cg.rootfinder, cg.ipopt, cg.minimizer)], ids=repr)
@pytest.mark.parametrize(("start", "end"), [([1, 0, 0.2], [0, 1, None]), ([1, 0, None], [0, 1, 0.2])])
def test_an_end_may_be_free_along_a_cylinder(start, end, solver):
    """The constraint depends on nothing that is free there: a quarter of the circle, at one height."""
    problem = cg.BoundaryProblem(spatial_free, (0, 1), start, end, constraint=on_cylinder)
    path = cg.solve(problem, METHOD, intervals=4, solver=solver)
    assert path.action == pytest.approx(np.pi**2 / 8, rel=1e-13)
    np.testing.assert_allclose(path.x[2], 0.2, rtol=0, atol=HELD)
    assert cg.solve(problem, tol=1e-8).action == pytest.approx(np.pi**2 / 8, rel=1e-8)


def test_a_joint_may_be_given_where_the_bob_beyond_it_is_free():
    angles, cartesian, place, constraint = MECHANISMS["double pendulum"]
    duration, first, last = ENDS["double pendulum"]
    given = [*place(np.array(last))[:2], None, None]
    path = cg.solve(
        cg.BoundaryProblem(cartesian, (0, duration), place(np.array(first)), given, constraint=constraint),
        METHOD,
        intervals=12,
        guess=lambda t: place(np.array(first) + (np.array(last) - first) * t / duration),
    )
    in_angles = cg.solve(cg.BoundaryProblem(angles, (0, duration), first, [last[0], None]), METHOD, intervals=12)
    np.testing.assert_allclose(path.x, place(in_angles.x), rtol=0, atol=JOINTS)


def test_a_periodic_constrained_path_is_that_in_the_angle():
    """A driven pendulum that answers with the period of its drive."""
    drive = lambda t: 0.3 * ca.cos(2 * t)  # noqa: E731
    angle = cg.solve(
        cg.BoundaryProblem(
            lambda t, x, v: pendulum(t, x, v) + drive(t) * ca.sin(x[0]), (0, np.pi), [None], periodic=True
        ),
        METHOD,
        intervals=6,
    )
    problem = cg.BoundaryProblem(
        lambda t, x, v: planar(t, x, v) + drive(t) * x[0],
        (0, np.pi),
        [None, None],
        periodic=True,
        constraint=unit_length,
    )
    path = cg.solve(problem, METHOD, intervals=6, guess=lambda t: on_circle(0.0))
    np.testing.assert_allclose(path.x, on_circle(angle.x[0]), rtol=0, atol=JOINTS)


def test_parameters_reach_a_constraint_and_change():
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: ca.sumsqr(v) / 2,
        (0, 1),
        [1.0, 0.0],
        [0.0, 1.0],
        parameters=[1.0],
        constraint=lambda t, x, p: ca.sumsqr(x) - p[0] ** 2,
    )
    transcription = cg.transcribe(problem, METHOD, 4)
    guess = lambda t: [3 * np.cos(np.pi * t / 2), 3 * np.sin(np.pi * t / 2)]  # noqa: E731
    path = transcription.solve(start=[3.0, 0.0], end=[0.0, 3.0], parameters=[3.0], guess=guess)
    assert path.action == pytest.approx((1.5 * np.pi) ** 2 / 2, rel=1e-12)  # a quarter of a great circle


def test_ends_that_leave_the_constraint_are_refused_in_a_repeated_solve():
    problem = cg.BoundaryProblem(planar, (0, 1), on_circle(0.2), on_circle(1.3), constraint=unit_length)
    with pytest.raises(ValueError, match=r"the constraint must be zero at the given end, x = \[1.0, 1.0\]: constraint"):
        cg.transcribe(problem, METHOD, 4).solve(end=[1.0, 1.0])


# paths in a plane of symmetry, where a component stays zero


@pytest.mark.parametrize("more", [{}, {"force": lambda t, x, v: -v / 3}, {"energy": 0.4}], ids=list)
def test_a_spherical_pendulum_in_a_plane_is_the_plane_one_and_stays_there_exactly(more):
    in_space, in_plane = (lambda a: np.array([np.sin(a), 0.0, -np.cos(a)])), on_circle
    paths = []
    for lagrangian, place in ((spatial, in_space), (planar, in_plane)):
        problem = cg.BoundaryProblem(lagrangian, (0, 1.5), place(0.2), place(1.3), constraint=unit_length, **more)
        guess = lambda t, place=place: place(0.2 + 1.1 * t / 1.5)  # noqa: E731
        paths.append(cg.solve(problem, METHOD, intervals=8, guess=guess))
    assert not np.any(paths[0].x[1])
    np.testing.assert_allclose(paths[0].x[::2], paths[1].x, rtol=0, atol=1e-14)


def test_a_constraint_on_a_component_that_stays_zero_is_harmless():
    problem = cg.BoundaryProblem(
        spatial,
        (0, 1.5),
        [np.sin(0.2), 0.0, -np.cos(0.2)],
        [np.sin(1.3), 0.0, -np.cos(1.3)],
        constraint=lambda t, x: [ca.sumsqr(x) - 1, x[1]],
    )
    guess = lambda t: np.array([np.sin(0.2 + 1.1 * t / 1.5), 0.0, -np.cos(0.2 + 1.1 * t / 1.5)])  # noqa: E731
    path = cg.solve(problem, METHOD, intervals=8, guess=guess)
    np.testing.assert_allclose(path.x[::2], constrained_path("pendulum")(path.t), rtol=0, atol=JOINTS)
    assert not np.any(path.x[1])


# index, many constraints, tolerances, solvers


@pytest.mark.parametrize("duration", [1.0, 4.0, 10.0])
def test_the_morse_index_on_a_constraint_is_that_in_the_angle(duration):
    """Small oscillations, which gain an index every half period."""
    angle = cg.solve(cg.BoundaryProblem(pendulum, (0, duration), [0.05], [0.1]), METHOD, intervals=12)
    problem = cg.BoundaryProblem(planar, (0, duration), on_circle(0.05), on_circle(0.1), constraint=unit_length)
    path = cg.solve(problem, METHOD, intervals=12, guess=lambda t: on_circle(angle(t)[0]))
    np.testing.assert_allclose(path.x, on_circle(angle.x[0]), rtol=0, atol=JOINTS)
    assert path.morse_index == angle.morse_index


@pytest.mark.slow
def test_fifty_coupled_rods_are_solved():
    """Pendulums side by side, each coupled to the next by a spring between their masses."""
    count = 50
    ends = 0.5 * np.cos(np.arange(count))

    def chained(t, x, v):
        return ca.sumsqr(v) / 2 - ca.sum1(x[1::2]) - ca.sumsqr(x[2:] - x[:-2]) / 2

    def in_angles(t, x, v):
        place = ca.horzcat(ca.sin(x), -ca.cos(x))
        return ca.sumsqr(v) / 2 - ca.sum1(place[:, 1]) - ca.sumsqr(place[1:, :] - place[:-1, :]) / 2

    place = lambda angles: on_circle(angles).T.ravel()  # noqa: E731
    problem = cg.BoundaryProblem(
        chained,
        (0, 1),
        place(0 * ends),
        place(ends),
        constraint=lambda t, x: x[0::2] ** 2 + x[1::2] ** 2 - 1,
    )
    path = cg.solve(problem, cg.Galerkin(6), intervals=5, guess=lambda t: place(ends * t))
    angles = cg.solve(cg.BoundaryProblem(in_angles, (0, 1), 0 * ends, ends), cg.Galerkin(6), intervals=8)
    np.testing.assert_allclose(path(0.5), place(angles(0.5)), rtol=0, atol=1e-9)
    assert np.max(np.abs(path.x[0::2] ** 2 + path.x[1::2] ** 2 - 1)) <= HELD


@pytest.mark.parametrize("tol", [1e-4, *slow(1e-10)])
@pytest.mark.parametrize("name", MECHANISMS)
def test_a_constrained_path_found_to_a_tolerance_meets_it(name, tol):
    (angular, cartesian, place, constraint), (duration, *ends) = MECHANISMS[name], ENDS[name]
    first, last = np.array(ends)
    problem = cg.BoundaryProblem(cartesian, (0, duration), place(first), place(last), constraint=constraint)
    path = cg.solve(problem, tol=tol, guess=lambda t: place(first + (last - first) * t / duration))
    exact = cg.solve(cg.BoundaryProblem(angular, (0, duration), first, last), cg.Galerkin(14), intervals=12)
    times = np.linspace(0, duration, 301)
    assert path.error_estimate <= tol
    assert np.max(np.abs(path(times) - place(exact(times)))) <= tol


@pytest.mark.slow
def test_a_sledge_on_a_frozen_lake_keeps_to_the_round_earth_up_to_the_rounding_of_its_radius():
    radius, gravity, duration, angle = 6.378e6, 9.81, 20.0, 2e-4  # in m and s
    place = lambda angle: radius * np.array([np.sin(angle), -2 * np.sin(angle / 2) ** 2])  # noqa: E731
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 - gravity * x[1],
        (0.0, duration),
        [0.0, 0.0],
        place(angle),
        constraint=lambda t, x: ca.sqrt(x[0] ** 2 + (x[1] + radius) ** 2) - radius,
    )
    path, rate = cg.solve(problem, tol=1e-6), np.sqrt(gravity / radius)
    angles = angle * np.sinh(rate * path.t) / np.sinh(rate * duration)  # as far as sin(angle) is angle
    np.testing.assert_allclose(path.x / path.sizes[:, None], place(angles) / path.sizes[:, None], rtol=0, atol=1e-6)


@pytest.mark.parametrize("solver", [cg.ipopt, *slow(cg.rootfinder, cg.minimizer)], ids=str)
@pytest.mark.parametrize("name", MECHANISMS)
def test_solvers_agree_on_a_constrained_path(name, solver):
    newton, other = (constrained_path(name, solver=each) for each in (cg.newton, solver))
    np.testing.assert_allclose(other.x, newton.x, rtol=0, atol=1e-13)
    assert other.action == pytest.approx(newton.action, rel=1e-13)


def test_an_end_meets_a_moving_constraint_up_to_the_rounding_of_its_time():
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2, (0, np.pi), [0, 0], [1, 0], constraint=lambda t, x: x[1] - ca.sin(t)
    )
    path = cg.solve(problem, tol=1e-10)
    np.testing.assert_allclose(path.x, [path.t / np.pi, np.sin(path.t)], rtol=0, atol=1e-10)
    assert path.action == pytest.approx((1 / np.pi + np.pi / 2) / 2, rel=1e-10)


# what does not fit


@pytest.mark.parametrize(
    ("changes", "kind", "message"),
    [
        (
            {"start": [0.0, -0.9]},
            ValueError,
            r"must be zero at the given start, x = \[0.0, -0.9\]: constraint\[0\] is -0.19, and only .* up to 2e-12",
        ),
        ({"end": [2.0, 0.0]}, ValueError, r"must be zero at the given end, x = \[2.0, 0.0\]: constraint\[0\] is 3"),
        (
            {"constraint": lambda t, x: [0]},
            ValueError,
            r"the constraint must depend on x, but constraint\[0\] does not",
        ),
        ({"constraint": lambda t, x: 1}, ValueError, r"the constraint must depend on x, but constraint\[0\] does not"),
        (
            {"constraint": lambda t, x: [ca.sumsqr(x) - 1, x[0]]},
            ValueError,
            r"a constraint must leave the path free to move: 2 values for 2 components",
        ),
        ({"constraint": lambda t, x, v: v[0]}, TypeError, r"constraint is called as constraint\(t, x\)"),
        (
            {"constraint": lambda t, x: x[3]},
            ValueError,
            "an index is out of range of so many components, t has 1, x has 2",
        ),
        ({"constraint": 1.0}, TypeError, r"constraint must be a callable of \(t, x\), got 1.0"),
        ({"constraint": lambda t, x: x.T}, ValueError, r"constraint must return a column vector, got shape \(1, 2\)"),
    ],
)
def test_a_constraint_that_does_not_fit_is_refused(changes, kind, message):
    stated = {"start": on_circle(0.2), "end": on_circle(1.3), "constraint": unit_length} | changes
    with pytest.raises(kind, match=message):
        cg.BoundaryProblem(planar, (0, 1), **stated)


@pytest.mark.parametrize("side", ["start", "end"])
def test_what_is_given_of_an_end_is_on_what_it_determines_of_the_constraint(side):
    stated = {"start": [1.0, 0.0, 0.0], "end": [0.0, 1.0, 0.0]} | {side: [0.0, 2.0, None]}
    with pytest.raises(ValueError, match=rf"zero at the given {side}, x = \[0.0, 2.0, None\]: constraint\[0\] is 3"):
        cg.BoundaryProblem(spatial, (0, 1), **stated, constraint=on_cylinder)


def test_an_end_that_leaves_too_little_free_for_its_constraints_is_refused():
    _, cartesian, place, constraint = MECHANISMS["double pendulum"]
    end = [None, *place(np.array([0.3, 0.6]))[1:]]
    with pytest.raises(ValueError, match="leaves 1 component free, on which 2 values of the constraint depend"):
        cg.BoundaryProblem(cartesian, (0, 1), place(np.array([1.0, 1.2])), end, constraint=constraint)


@pytest.mark.parametrize("unit", [1e-15, 1e15])
def test_constraints_of_any_units_are_not_redundant(unit):
    stated = {"start": [0.0, 0.0, -1.0], "end": [1.0, 0.0, 0.0]}
    problem = cg.BoundaryProblem(spatial, (0, 1), **stated, constraint=lambda t, x: [ca.sumsqr(x) - 1, unit * x[1]])
    assert problem.constraint.numel_out(0) == 2


def test_redundant_constraints_are_refused():
    with pytest.raises(
        ValueError, match=r"redundant at the given start, x = \[.*\]: their gradients, the rows of \[\["
    ):
        cg.BoundaryProblem(
            spatial,
            (0, 1),
            on_sphere((1.0, 0.0)),
            on_sphere((1.3, 2.0)),
            constraint=lambda t, x: [ca.sumsqr(x) - 1, ca.norm_2(x) - 1],
        )


def test_a_constraint_of_which_a_corner_of_the_end_is_singular_is_refused():
    with pytest.raises(ValueError, match="the constraints are redundant at the given end"):
        cg.BoundaryProblem(planar, (0, 1), [1.0, 1.0], [0.0, 0.0], constraint=lambda t, x: x[0] ** 2 - x[1] ** 2)


@pytest.mark.parametrize("how", [{"tol": 1e-8}, {"method": METHOD, "intervals": 6}], ids=str)
@pytest.mark.slow
def test_a_component_that_a_constraint_keeps_at_zero_is_zero_but_for_rounding(how):
    """A differential gear whose wheels turn against one another: its cage rests, but for their rounding."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 - ca.dot(x, x) / 2,
        (0, 1),
        [0.0, 0.0, 0.0],
        [1.0, -1.0, 0.0],
        constraint=lambda t, x: x[0] + x[1] - x[2],
    )
    path, times = cg.solve(problem, **how), np.linspace(0, 1, 101)
    wheel = np.sin(times) / np.sin(1)
    assert np.max(np.abs(path(times) - [wheel, -wheel, 0 * times])) < 1e-8
    assert np.max(np.abs(path.x[2])) < 1e-15


@pytest.mark.parametrize("tol", [1e-3, 1e-9])
@pytest.mark.slow
def test_a_pivot_that_turns_at_a_named_time_takes_no_energy_unseen(tol):
    """Its velocity jumps, and so does that of the rod, at a breakpoint; the same in the angle of the rod."""

    def at(t, angle):
        return [0.2 * abs(t - 0.5) + np.sin(angle), -np.cos(angle)]

    rod = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 - 9.81 * x[1],
        (0.0, 1.0),
        at(0, -0.5),
        at(1, 0.7),
        constraint=lambda t, x: (x[0] - 0.2 * ca.fabs(t - 0.5)) ** 2 + x[1] ** 2 - 1,
        breakpoints=[0.5],
    )
    angle = cg.BoundaryProblem(
        lambda t, q, v: (
            ((0.2 * ca.sign(t - 0.5) + ca.cos(q[0]) * v[0]) ** 2 + (ca.sin(q[0]) * v[0]) ** 2) / 2 + 9.81 * ca.cos(q[0])
        ),
        (0.0, 1.0),
        [-0.5],
        [0.7],
        breakpoints=[0.5],
    )
    path = cg.solve(rod, tol=tol, guess=lambda t: at(t, -0.5 + 1.2 * t))
    assert path.action == pytest.approx(cg.solve(angle, tol=1e-11).action, rel=tol)
