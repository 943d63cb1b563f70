"""Constrained motion step by step: the same paths as in angles, orders, no drift, refusals."""

import casadi as ca
import numpy as np
import pytest
from constrained import MECHANISMS, on_circle, on_sphere, planar, spatial, spherical_pendulum, uneven, unit_length
from slow import slow

import casadi_galerkin as cg

JOINTS = 1e-11
HELD = 1e-13
STARTS = {  # angles and their rates
    "pendulum": ([1.0], [0.4]),
    "spherical pendulum": ([1.0, 0.0], [0.3, 0.8]),
    "double pendulum": ([1.0, 1.2], [0.5, -0.2]),
}


def motions(name, duration, **changes):
    """The problem in angles, and in Cartesian coordinates."""
    (angular, cartesian, place, constraint), (angles, rates) = MECHANISMS[name], STARTS[name]
    step = 1e-30  # complex steps have no cancellation
    turned = place(np.array(angles) + 1j * step * np.array(rates))
    cartesian_start = {"start": turned.real, "velocity": turned.imag / step}
    return (
        cg.InitialProblem(angular, (0, duration), angles, velocity=rates),
        cg.InitialProblem(cartesian, (0, duration), constraint=constraint, **cartesian_start, **changes),
    )


@pytest.mark.parametrize("name", STARTS)
def test_steps_in_cartesian_coordinates_are_those_in_angles(name):
    angles, path = (cg.solve(problem, cg.Galerkin(10), intervals=20) for problem in motions(name, 1.0))
    np.testing.assert_allclose(path.x, MECHANISMS[name][2](angles.x), rtol=0, atol=JOINTS)
    assert path.action == pytest.approx(angles.action, rel=1e-13)


@pytest.mark.parametrize("name", STARTS)
@pytest.mark.parametrize("degree", [1, 3])
def test_constraint_and_tangent_velocity_hold_whatever_the_degree(name, degree):
    path = cg.solve(motions(name, 1.0)[1], cg.Galerkin(degree), intervals=20)
    x = ca.SX.sym("x", len(path.x))
    value = MECHANISMS[name][3](0, x)
    both = ca.Function("both", [x], [value, ca.jacobian(value, x)])
    for place, velocity in zip(path.x.T, path.velocity.T, strict=True):
        held, slope = (np.array(a) for a in both(place))
        assert np.max(np.abs(held)) <= HELD
        assert np.max(np.abs(slope @ velocity)) <= 10 * HELD  # velocities of up to 5


@pytest.fixture(scope="module")
def finely_stepped():
    """A problem and its path."""
    start = {"start": on_circle(0.2), "velocity": 1.2 * np.array([np.cos(0.2), np.sin(0.2)])}
    problem = cg.InitialProblem(uneven, (0, 3), constraint=unit_length, **start)
    return problem, cg.solve(problem, cg.Galerkin(10), intervals=60)


@pytest.mark.parametrize("rule", [cg.gauss, lambda m: cg.lobatto(m + 1), cg.radau], ids=["gauss", "lobatto", "radau"])
@pytest.mark.parametrize(("degree", "counts"), [(3, (16, 20, 24)), *slow((1, (60, 80, 120)))])
def test_order_at_the_joints_is_that_without_a_constraint(finely_stepped, degree, counts, rule):
    method, (problem, exact), errors = cg.Galerkin(degree, quadrature=rule(degree)), finely_stepped, []
    for count in counts:
        path = cg.solve(problem, method, intervals=count)
        ends = [np.concatenate((each.x[:, -1], each.velocity[:, -1])) for each in (path, exact)]
        errors.append(np.max(np.abs(ends[0] - ends[1])))
    assert min(errors) > HELD
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] == pytest.approx(method.order, abs=0.2)


@pytest.mark.slow
def test_ten_thousand_steps_leave_the_constraint_no_farther_than_a_hundred():
    problem = cg.InitialProblem(planar, (0, 1000.0), [1.0, 0.0], velocity=[0.0, 0.3], constraint=unit_length)
    path = cg.solve(problem, cg.Galerkin(3), intervals=10_000)
    off = np.abs(np.sum(path.x**2, axis=0) - 1)
    slipping = np.abs(np.sum(path.x * path.velocity, axis=0))
    assert max(np.max(off), np.max(slipping)) <= HELD
    assert np.max(off[-100:]) <= 4 * np.finfo(float).eps
    thirds = [np.mean(part) for part in np.array_split(path.energy, 3)]
    assert np.ptp(thirds) < 0.01 * np.ptp(path.energy)  # it oscillates with the error of the method, and has no drift


@pytest.mark.parametrize("degree", [1, 2, 4])
def test_steps_are_those_of_the_global_solve_between_the_same_ends(degree):
    path = cg.solve(motions("spherical pendulum", 1.0)[1], cg.Galerkin(degree), intervals=8)
    ends = {"start": path.x[:, 0], "end": path.x[:, -1], "constraint": unit_length}
    whole = cg.solve(cg.BoundaryProblem(spatial, (0, 1), **ends), cg.Galerkin(degree), intervals=8, guess=path)
    np.testing.assert_allclose(whole.polynomial.values, path.polynomial.values, rtol=0, atol=1e-13)
    np.testing.assert_allclose(whole.momentum, path.momentum, rtol=0, atol=1e-12)


def test_friction_on_a_sphere_takes_the_energy_that_it_takes_in_angles():
    """A force -c v in space has the generalized forces -c (θ', sin² θ φ')."""
    angular = cg.InitialProblem(
        spherical_pendulum,
        (0, 1),
        [1.0, 0.0],
        velocity=[0.3, 0.8],
        force=lambda t, x, v: [-v[0] / 5, -(ca.sin(x[0]) ** 2) * v[1] / 5],
    )
    cartesian = motions("spherical pendulum", 1.0, force=lambda t, x, v: -v / 5)[1]
    angles, path = (cg.solve(problem, cg.Galerkin(8), intervals=10) for problem in (angular, cartesian))
    np.testing.assert_allclose(path.x, on_sphere(angles.x), rtol=0, atol=JOINTS)
    np.testing.assert_allclose(path.energy, angles.energy, rtol=1e-12)


def test_a_pendulum_of_growing_length_is_that_in_its_angle():
    length = lambda t: 1 + t / 5  # noqa: E731
    angular = cg.InitialProblem(
        lambda t, x, v: (length(t) ** 2 * v[0] ** 2 + 0.04) / 2 + length(t) * ca.cos(x[0]),
        (0, 2),
        [1.0],
        velocity=[0.0],
    )
    cartesian = cg.InitialProblem(
        planar, (0, 2), on_circle(1.0), velocity=on_circle(1.0) / 5, constraint=lambda t, x: ca.norm_2(x) - length(t)
    )
    angle, path = (cg.solve(problem, cg.Galerkin(8), intervals=16) for problem in (angular, cartesian))
    np.testing.assert_allclose(path.x, length(path.t) * on_circle(angle.x[0]), rtol=0, atol=JOINTS)


def test_multipliers_of_steps_are_the_tension_of_the_rod():
    angle, path = (cg.solve(problem, cg.Galerkin(8), intervals=20) for problem in motions("pendulum", 2.0))
    tension = angle.velocity[0] ** 2 + np.cos(angle.x[0])
    np.testing.assert_allclose(path.multipliers(path.t)[0], -tension / 2, rtol=0, atol=JOINTS)


def test_multipliers_are_found_at_any_times_of_the_path():
    path = cg.solve(motions("double pendulum", 1.0)[1], cg.Galerkin(4), 10)
    assert path.multipliers(0.3).shape == (2,)
    assert path.multipliers([[0.1, 0.2, 0.3]]).shape == (2, 1, 3)
    assert path.multipliers([]).shape == (2, 0)
    with pytest.raises(TypeError, match="times must be real numbers, got 'a'"):
        path.multipliers("a")


def test_of_a_momentum_the_part_along_the_constraint_counts():
    starts = ({"momentum": [0.7, 0.0]}, {"momentum": [0.7, -3.0]}, {"velocity": [0.7, 0.0]})
    first, *others = (
        cg.solve(
            cg.InitialProblem(planar, (0, 1), [0.0, -1.0], constraint=unit_length, **start), cg.Galerkin(4), intervals=5
        )
        for start in starts
    )
    for other in others:
        np.testing.assert_allclose(other.x, first.x, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("constraint", "duration", "start", "velocity"),
    [
        (lambda t, x: x[1] - ca.sin(t), (0, 4 * np.pi), [0, 0], [0.3, 1]),
        (lambda t, x: x[1] - ca.cos(t), (np.pi, 4 * np.pi), [0.3 * np.pi, -1], [0.3, 0]),
    ],
    ids=["through zero", "from a turning point"],
)
def test_a_moving_constraint_is_met_up_to_the_rounding_of_the_time(constraint, duration, start, velocity):
    problem = cg.InitialProblem(
        lambda t, x, v: ca.sumsqr(v) / 2, duration, start, velocity=velocity, constraint=constraint
    )
    path = cg.solve(problem, cg.Galerkin(6), intervals=24)
    np.testing.assert_allclose(path.x[0], 0.3 * path.t, rtol=0, atol=JOINTS)
    off = [float(constraint(t, ca.DM(x))) for t, x in zip(path.t, path.x.T, strict=True)]
    np.testing.assert_allclose(off, 0, rtol=0, atol=HELD)


@pytest.mark.parametrize(
    ("position", "velocity"),
    [([np.sin(np.pi), 1.0], [0.7, 0.0]), ([1.0, 0.0], [1e-16, 0.7]), ([0.0, -1.0], [1e-16, -1e-16])],
    ids=["of the position", "of a velocity", "at rest"],
)
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_a_velocity_is_tangent_up_to_rounding(position, velocity, unit):
    def given(rounding):
        x, v = (np.where(np.abs(a) < 1e-15, rounding * np.array(a), a) * unit for a in (position, velocity))
        return cg.InitialProblem(planar, (0, 1), x, velocity=v, constraint=lambda t, x: ca.sumsqr(x) - unit**2)

    assert given(1.0).velocity == tuple(unit * np.array(velocity))
    with pytest.raises(ValueError, match="velocity must be tangent"):
        given(1e6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"start": [0.0, -2.0]},
            r"the constraint must be zero at the given start, x = \[0.0, -2.0\]: constraint\[0\] is 3",
        ),
        (
            {"velocity": [0.7, 0.1]},
            r"velocity must be tangent to the constraint at .* got \[0.7, 0.1\]: the rate of constraint\[0\] is -0.2",
        ),
        (
            {"constraint": lambda t, x: [ca.sumsqr(x) - 1, x[0]]},
            r"must leave the path free to move: 2 values for 2 components",
        ),
    ],
)
def test_a_start_off_the_constraint_is_refused(changes, message):
    stated = {"start": [0.0, -1.0], "velocity": [0.7, 0.0], "constraint": unit_length} | changes
    with pytest.raises(ValueError, match=message):
        cg.solve(cg.InitialProblem(planar, (0, 1), **stated), cg.Galerkin(3), intervals=4)


def test_control_points_that_lose_the_order_are_refused():
    problem = cg.InitialProblem(planar, (0, 1), [0.0, -1.0], velocity=[0.7, 0.0], constraint=unit_length)
    with pytest.raises(ValueError, match="a constraint is held at the control points; to keep order 2m, they must be"):
        cg.solve(problem, cg.Galerkin(3, control_points=cg.equispaced_points(4)[:2]), intervals=4)


@pytest.mark.parametrize("unit", [1e-9, *slow(1e9)])
@pytest.mark.parametrize("degree", [3, *slow(10)])
@pytest.mark.parametrize(
    ("start", "velocity"),
    [([0.6, 0.0, -0.8], [0.0, 0.0, 0.0]), ([0.0, 0.0, -1.0], [0.0, 1.0, 0.0]), ([0.0, 0.0, -1.0], [0.0, 0.0, 0.0])],
    ids=["from rest", "through the bottom", "at rest"],
)
def test_a_component_that_rests_stays_at_rest(start, velocity, degree, unit):
    """A spherical pendulum that swings in a coordinate plane, or hangs: not even rounding of the others moves it."""
    problem = cg.InitialProblem(
        lambda t, x, v: ca.sumsqr(v) / 2 - unit * x[2],
        (0, 1),
        [unit * a for a in start],
        velocity=[unit * a for a in velocity],
        constraint=lambda t, x: ca.sumsqr(x / unit) - 1,
    )
    path = cg.solve(problem, cg.Galerkin(degree), 20)
    resting = [i for i in range(2) if start[i] == velocity[i] == 0]
    assert not np.any(path.x[resting])
    assert not np.any(path.momentum[resting])
    np.testing.assert_allclose(np.sum(path.x**2, axis=0), unit**2, rtol=1e-14)
    assert np.ptp(path.energy) < 1e-2 * unit**2


@pytest.mark.parametrize("degree", [6, 8])
@pytest.mark.slow
def test_a_component_held_at_zero_stays_zero(degree):
    """A free particle on the line x_1 = 0: its path is as good as on any other line, and can be shot."""

    def kinetic(t, x, v):
        return ca.sumsqr(v) / 2

    def on_line(t, x):
        return x[1]

    start = cg.InitialProblem(kinetic, (0, 1), [-1.0, 0.0], velocity=[2.0, 0.0], constraint=on_line)
    ends = cg.BoundaryProblem(kinetic, (0, 1), [-1.0, 0.0], [1.0, 0.0], constraint=on_line)
    for path in (cg.solve(start, cg.Galerkin(degree), 8), cg.shoot(ends, cg.Galerkin(degree), 8)):
        assert not np.any(path.polynomial.values[1])
        assert not np.any(path.momentum[1])
        assert path.action == pytest.approx(2.0, rel=1e-14)
        assert path.estimate_error() < 1e-14


def coupled(t, x, v):
    return ca.sumsqr(v) + v[0] * v[1] - ca.cos(x[0] - x[1]) - 3 * x[1]


@pytest.mark.parametrize("degree", [3, *slow(6)])
@pytest.mark.parametrize(("lagrangian", "speed"), [(planar, 0.0), (planar, 1e-12), (planar, 1.0), (coupled, 1.0)])
def test_forces_do_not_move_what_is_held_at_zero(lagrangian, speed, degree):
    """A mass slides on the line x_1 = 0, which holds its weight."""
    problem = cg.InitialProblem(lagrangian, (0, 1), [0, 0], velocity=[speed, 0], constraint=lambda t, x: x[1])
    path = cg.solve(problem, cg.Galerkin(degree), 8)
    assert not np.any(path.polynomial.values[1])
    assert path.x[0, -1] == pytest.approx(speed, rel=0.2, abs=0)
    assert path.estimate_error() < 1e-6


@pytest.mark.parametrize("degree", [3, *slow(8)])
@pytest.mark.parametrize("side", [-1.0, 1.0], ids=["hanging", "upright"])
def test_the_steps_of_a_pendulum_at_rest_are_symplectic(side, degree):
    problem = cg.InitialProblem(planar, (0, 2), [0.0, side], velocity=[0.0, 0.0], constraint=unit_length)
    path = cg.solve(problem, cg.Galerkin(degree), 8)
    assert not np.any(path.momentum)
    assert np.max(cg.geometry(path).symplecticity_defects) < 1e-14


@pytest.mark.parametrize("step", [1e-3, 1e-9, 1e-18])
def test_a_component_that_leaves_its_rest_is_not_taken_for_rounding(step):
    """A pendulum falls from its side, however short the steps are."""
    problem = cg.InitialProblem(planar, (0, 8 * step), [1.0, 0.0], velocity=[0.0, 0.0], constraint=unit_length)
    path = cg.solve(problem, cg.Galerkin(4), 8)
    force = float(planar(0.0, ca.DM([0, 1]), ca.DM([0, 0])))
    assert path.momentum[1, -1] == pytest.approx(force * 8 * step, rel=1e-3)
    assert path.x[1, -1] == pytest.approx(force * (8 * step) ** 2 / 2, rel=1e-3, abs=0)


@pytest.mark.parametrize("degree", [4, *slow(8)])
@pytest.mark.parametrize("side", [-1.0, 1.0], ids=["hanging", "upright"])
def test_a_pendulum_at_rest_with_a_free_end_is_shot(side, degree):
    """The momentum of the end is rounding of the impulses that hold the weight."""
    problem = cg.BoundaryProblem(planar, (0, 1), [0.0, side], [None, None], constraint=unit_length)
    path = cg.shoot(problem, cg.Galerkin(degree), 8)
    np.testing.assert_allclose(path.x, [[0.0] * 9, [side] * 9], rtol=1e-14)
    assert path.action == pytest.approx(cg.solve(problem, cg.Galerkin(degree), 8).action, rel=1e-14)


@pytest.mark.parametrize(
    ("start", "end", "climbs"),
    [
        ([1, 0, 0.2], [0, 1, None], 0.0),
        ([1, 0, None], [0, 1, 0.2], 0.0),
        ([1, 0, 0.0], [0, 1, 0.5], 0.5),
        ([1, 0, 0.0], [None, None, 0.5], 0.5),
        ([None, None, 0.0], [0, 1, 0.5], 0.5),
    ],
)
def test_any_part_of_an_end_on_a_cylinder_may_be_given_to_shooting(start, end, climbs):
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2, (0, 1), start, end, constraint=lambda t, x: x[0] ** 2 + x[1] ** 2 - 1
    )
    turns = None not in (*start[:2], *end[:2])
    path = cg.shoot(problem, cg.Galerkin(8), intervals=4)
    assert path.action == pytest.approx((turns * np.pi**2 / 4 + climbs**2) / 2, rel=1e-12, abs=1e-12)


def chain_of_two(t, x):
    return [ca.sumsqr(x[:3]) - 1, ca.sumsqr(x[3:] - x[:3]) - 1]


STARTS_WITH_RESTING_COMPONENTS = {  # position, velocity, constraint
    "a pendulum from rest": ([1.0, 0.0, 0.0], [0.0] * 3, unit_length),
    "a chain from rest": ([1.0, 0.0, 0.0, 2.0, 0.0, 0.0], [0.0] * 6, chain_of_two),
    "a chain pushed aside": ([1.0, 0.0, 0.0, 1.0, 0.0, 1.0], [0.0, 0.1, 0.0, 0.0, 0.3, 0.0], chain_of_two),
}


@pytest.mark.parametrize("degree", [4, *slow(1)])
@pytest.mark.parametrize("step", [1e-2, *slow(1e-4)])
@pytest.mark.parametrize("name", STARTS_WITH_RESTING_COMPONENTS)
def test_steps_of_any_length_leave_a_rest(name, step, degree):
    """The first Newton steps say little of the next ones: they are as large as what moves, or as what does not."""
    position, velocity, constraint = STARTS_WITH_RESTING_COMPONENTS[name]

    def falling(t, x, v):
        return ca.dot(v, v) / 2 - 9.81 * ca.sum1(x[2::3])

    problem = cg.InitialProblem(falling, (0, 50 * step), position, velocity=velocity, constraint=constraint)
    path = cg.solve(problem, cg.Galerkin(degree), 50)
    assert np.max(np.abs(np.array(constraint(0.0, ca.DM(path.x[:, -1]))).ravel())) <= HELD
    assert path.iterations <= 6 * 50


@pytest.mark.slow
def test_steps_that_leave_their_constraint_between_the_nodes_are_refused():
    """All nodes are held, and between them the rod is up to a fifth too short."""
    message = "leaves its constraint between the nodes"
    swing = cg.InitialProblem(planar, (0, 6), [0.0, -1.0], velocity=[1.0, 0.0], constraint=unit_length)
    lift = cg.BoundaryProblem(planar, (0, 2), [0.0, -1.0], on_circle(1.5), constraint=unit_length)
    for found in (cg.shoot, cg.solve):
        with pytest.raises(cg.ConvergenceError, match=message):
            found(lift, cg.Galerkin(1), 2)
    for path in (cg.solve(swing, cg.Galerkin(4), 12), cg.shoot(lift, cg.Galerkin(4), 6)):
        assert np.max(np.abs(np.sum(path(np.linspace(*path.t[[0, -1]], 99)) ** 2, axis=0) - 1)) < 1e-2
