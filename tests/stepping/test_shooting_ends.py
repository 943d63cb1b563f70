"""Every kind of ends, shot: the discrete path of the global solve, and that of the closed form."""

import casadi as ca
import numpy as np
import pytest
from constrained import on_circle, planar, unit_length
from scenes import free_particle, oscillator, pendulum, saddle
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.stepping.shooting import _met
from casadi_galerkin.stepping.shooting_residual import Shooting

METHOD, INTERVALS = cg.Galerkin(8), 8
SAME = 1e-12  # the same discrete equations solved in two ways; conditions below 100
CLOSED = 1e-12
IN_ANGLES = 1e-11


def coupled(t, x, v):
    return ca.sumsqr(v) / 2 + v[0] * v[1] / 3


def off_center(t, x, v):
    return ca.sumsqr(v) / 2 - (x[0] - 1) ** 2 / 2 - x[1] ** 2 / 2


def harmonic(start, end):
    """Oscillation that meets two equations, a x + b p = c, given as (a, b, c)."""
    turns = np.array([[np.cos(1), np.sin(1)], [-np.sin(1), np.cos(1)]])
    matrix = [np.array(start[:2]), np.array(end[:2]) @ turns]
    x, p = np.linalg.solve(matrix, [start[2], end[2]])
    return lambda t: [x * np.cos(t) + p * np.sin(t)]


def damped_robin(t):
    """The motion x'' = -x - 0.6 x' from 1 to p = -4 x at t = 1."""
    slow = np.sqrt(1 - 0.3**2)

    def at(t, b):
        x = np.exp(-0.3 * t) * (np.cos(slow * t) + b * np.sin(slow * t))
        v = -0.3 * x + np.exp(-0.3 * t) * slow * (b * np.cos(slow * t) - np.sin(slow * t))
        return x, v

    zero, one = (at(1.0, b)[1] + 4 * at(1.0, b)[0] for b in (0.0, 1.0))
    return [at(t, zero / (zero - one))[0]]


def turned(t):
    """The oscillation about (1, 0) whose last state, but for a shift of the position, is the first one turned."""
    turn, wave, unit = np.array([[0.0, -1.0], [1.0, 0.0]]), (np.cos(1), np.sin(1)), np.eye(2)
    center = np.array([1.0, 0.0])
    matrix = np.block([[wave[0] * unit - turn, wave[1] * unit], [-wave[1] * unit, wave[0] * unit - turn]])
    shift = np.array([0.2, 0.0]) + turn @ center - center
    a, b = np.split(np.linalg.solve(matrix, np.concatenate((shift, np.zeros(2)))), 2)
    return center[:, None] + np.outer(a, np.cos(t)) + np.outer(b, np.sin(t))


KINDS = {
    "start velocity": (
        cg.BoundaryProblem(oscillator, (0, 1), [None], [1.0], start_velocity=[0.5]),
        harmonic((0, 1, 0.5), (1, 0, 1.0)),
    ),
    "end velocity": (
        cg.BoundaryProblem(oscillator, (0, 1), [0.3], [None], end_velocity=[0.5]),
        harmonic((1, 0, 0.3), (0, 1, 0.5)),
    ),
    "end momentum": (
        cg.BoundaryProblem(oscillator, (0, 1), [0.3], [None], end_momentum=[0.5]),
        harmonic((1, 0, 0.3), (0, 1, 0.5)),
    ),
    "velocities that share a mass": (
        cg.BoundaryProblem(coupled, (0, 1), [None, None], [1.0, 0.5], start_velocity=[0.3, 0.4]),
        lambda t: [0.7 + 0.3 * t, 0.1 + 0.4 * t],
    ),
    "spring": (
        cg.BoundaryProblem(oscillator, (0, 1), [1.0], [None], end_action=lambda x0, x1: 2 * x1[0] ** 2),
        harmonic((1, 0, 1.0), (4, 1, 0.0)),
    ),
    "spring of given stiffness, and friction": (
        cg.BoundaryProblem(
            lambda t, x, v, p: oscillator(t, x, v),
            (0, 1),
            [1.0],
            [None],
            end_action=lambda x0, x1, p: p[0] * x1[0] ** 2,
            force=lambda t, x, v, p: -p[1] * v,
            parameters=[2.0, 0.6],
        ),
        damped_robin,
    ),
    "spring between the ends": (
        cg.BoundaryProblem(
            free_particle, (0, 1), [None], [None], end_action=lambda x0, x1: (x1[0] - x0[0] - 1) ** 2 + (x0[0] - 2) ** 2
        ),
        lambda t: [2 + 2 / 3 * t],
    ),
    "shortest way to a circle": (
        cg.BoundaryProblem(
            free_particle,
            (0, 1),
            [0.0, 0.0],
            [None, None],
            end_conditions=lambda x0, x1: (x1[0] - 3) ** 2 + (x1[1] - 4) ** 2 - 4,
        ),
        lambda t: [3 / 5 * 3 * t, 4 / 5 * 3 * t],
    ),
    "end is the start turned and shifted": (
        cg.BoundaryProblem(
            off_center,
            (0, 1),
            [None, None],
            [None, None],
            end_conditions=lambda x0, x1: ca.vertcat(x1[0] + x0[1] - 0.2, x1[1] - x0[0]),
        ),
        turned,
    ),
    "on the circle, up to a momentum": (  # its normal part counts nothing
        cg.BoundaryProblem(
            free_particle,
            (0, 1),
            on_circle(0.7).tolist(),
            [None, None],
            end_momentum=(0.8 * on_circle(1.5 + np.pi / 2) + 5 * on_circle(1.5)).tolist(),
            constraint=unit_length,
        ),
        lambda t: on_circle(0.7 + 0.8 * t),
    ),
    "on the circle, up to a line": (
        cg.BoundaryProblem(
            free_particle,
            (0, 1),
            on_circle(0.7).tolist(),
            [None, None],
            end_conditions=lambda x0, x1: x1[0] + np.tan(1.5) * x1[1],
            constraint=unit_length,
        ),
        lambda t: on_circle(0.7 + 0.8 * t),
    ),
}


@pytest.mark.parametrize("kind", [*list(KINDS)[::3], *slow(*(kind for k, kind in enumerate(KINDS) if k % 3))])
def test_every_kind_of_ends_is_shot(kind):
    problem, closed = KINDS[kind]
    whole, shot = (way(problem, METHOD, INTERVALS) for way in (cg.solve, cg.shoot))
    for ours, theirs in ((shot.x, whole.x), (shot.momentum, whole.momentum), (shot.action, whole.action)):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=SAME * max(1.0, np.max(np.abs(theirs))))
    np.testing.assert_allclose(shot.x, closed(shot.t), rtol=0, atol=CLOSED)
    assert shot.residual <= 50
    assert "single shooting" in shot.solver
    again = cg.shoot(problem, METHOD, INTERVALS, guess=whole)
    np.testing.assert_allclose(again.x, whole.x, rtol=0, atol=SAME)
    assert again.iterations <= 2  # only multipliers are left to find


START, END = on_circle(0.7).tolist(), on_circle(-0.4).tolist()
ANGLES = {
    "natural end": ({"start": [0.7], "end": [None]}, {"start": START, "end": [None, None]}),
    "natural start": ({"start": [None], "end": [0.7]}, {"start": [None, None], "end": START}),
    "end of one coordinate": ({"start": [0.7], "end": [-0.4]}, {"start": START, "end": [END[0], None]}),
    "start of one coordinate": ({"start": [-0.4], "end": [0.7]}, {"start": [END[0], None], "end": START}),
    "spring": (
        {"start": [0.7], "end": [None], "end_action": lambda x0, x1: 2 * ca.sin(x1[0]) ** 2},
        {"start": START, "end": [None, None], "end_action": lambda x0, x1: 2 * x1[0] ** 2},
    ),
    "end mirrored": (
        {"start": [None], "end": [None], "end_conditions": lambda x0, x1: x0[0] + x1[0] - 0.6},
        {
            "start": [None, None],
            "end": [None, None],
            "end_conditions": lambda x0, x1: (x0[0] * x1[1] + x1[0] * x0[1]) + np.sin(0.6),
        },
    ),
    "driven and periodic": (
        {"start": [None], "periodic": True, "force": lambda t, x, v: ca.cos(2 * np.pi * t)},
        {
            "start": [None, None],
            "periodic": True,
            "force": lambda t, x, v: ca.cos(2 * np.pi * t) * ca.vertcat(-x[1], x[0]),
        },
    ),
    "driven and periodic through a point": (
        {"start": [0.7], "periodic": True, "force": lambda t, x, v: ca.cos(2 * np.pi * t)},
        {
            "start": START,
            "periodic": True,
            "force": lambda t, x, v: ca.cos(2 * np.pi * t) * ca.vertcat(-x[1], x[0]),
        },
    ),
}


@pytest.mark.parametrize("kind", [*list(ANGLES)[::4], *slow(*(kind for k, kind in enumerate(ANGLES) if k % 4))])
@pytest.mark.slow
def test_under_a_constraint_ends_are_those_in_angles(kind):
    in_angles, cartesian = ANGLES[kind]
    angles = cg.solve(cg.BoundaryProblem(pendulum, (0, 1), **in_angles), METHOD, INTERVALS)
    problem = cg.BoundaryProblem(planar, (0, 1), constraint=unit_length, **cartesian)
    coarse = cg.solve(problem, cg.Galerkin(2), 5, guess=lambda t: on_circle(angles(t)[0] + 0.05))
    whole = cg.solve(problem, METHOD, INTERVALS, guess=coarse)
    shot = cg.shoot(problem, METHOD, INTERVALS, guess=coarse)
    for ours, theirs in ((shot.x, whole.x), (shot.momentum, whole.momentum)):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=SAME)
    np.testing.assert_allclose(shot.x, on_circle(angles.x[0]), rtol=0, atol=IN_ANGLES)
    assert shot.iterations <= 3  # multipliers that are zero do not hold it up


def test_momenta_under_a_constraint_have_tangent_velocities():
    """Masses that differ part the tangents from their momenta."""

    def unequal(t, x, v):
        return v[0] ** 2 / 2 + 2 * v[1] ** 2 - x[1]

    problem = cg.BoundaryProblem(unequal, (0, 1), START, END, constraint=unit_length)
    shot = cg.shoot(problem, METHOD, INTERVALS)
    np.testing.assert_allclose(shot.momentum, cg.solve(problem, METHOD, INTERVALS).momentum, rtol=0, atol=SAME)
    np.testing.assert_allclose(np.sum(shot.x * shot.momentum / [[1.0], [4.0]], axis=0), 0, rtol=0, atol=SAME)


def test_a_multiplier_that_is_off_is_a_miss():
    problem, _ = KINDS["shortest way to a circle"]
    shooting = Shooting(problem, METHOD, np.linspace(0, 1, INTERVALS + 1))
    path = cg.shoot(problem, METHOD, INTERVALS)
    multiplier = -path.momentum[0, -1] / (2 * (path.x[0, -1] - 3))
    start = np.concatenate((path.x[:, 0], path.momentum[:, 0], [multiplier]))
    assert _met(shooting.shoot(start, path.velocity[:, 0]), 3).residual < 50
    with pytest.raises(cg.ConvergenceError, match="the end is missed by"):
        _met(shooting.shoot(start + 1e-9 * np.eye(5)[4], path.velocity[:, 0]), 3)


def test_growth_fails_any_ends():
    problem = cg.BoundaryProblem(saddle, (0, 40), [1.0], [None], end_action=lambda x0, x1: 2 * (x1[0] - 1) ** 2)
    with pytest.raises(cg.ConvergenceError, match=r"the end is missed by .* grows up to 1.2e\+17 times"):
        cg.shoot(problem, METHOD, 80)


def test_ends_that_leave_the_start_open_are_conjugate():
    problem = cg.BoundaryProblem(
        free_particle, (0, 1), [None, 0.0], [None, 1.0], end_conditions=lambda x0, x1: x1[0] - x0[0] - 1
    )
    with pytest.raises(cg.ConjugatePointError, match="the end does not depend on the start"):
        cg.shoot(problem, METHOD, INTERVALS)


def shot_along_the_circle(speed):
    """A free particle on the circle, shot a quarter of a turn from a guess of that speed; and the end asked for."""

    def free(t, x, v):
        return ca.sumsqr(v) / 2

    start, end = [1.0, 0.0], np.array([0.0, 1.0])
    begun = cg.InitialProblem(free, (0, 1), start, velocity=[0.0, speed], constraint=unit_length)
    wanted = cg.BoundaryProblem(free, (0, 1), start, end, constraint=unit_length)
    return cg.shoot(wanted, METHOD, INTERVALS, guess=cg.solve(begun, METHOD, INTERVALS)), end


@pytest.mark.parametrize("speed", [1.0, *slow(4.2)])
@pytest.mark.slow
def test_newtons_method_leads_away_from_the_antipode(speed):
    path, end = shot_along_the_circle(speed)
    np.testing.assert_allclose(path.x[:, -1], end, rtol=0, atol=CLOSED)


@pytest.mark.parametrize("speed", [-np.pi / 2, 1.5 * np.pi])
def test_a_normal_of_the_constraint_does_not_end_at_its_other_point(speed):
    other = r"another point of the constraint, x = .* by up to 2\.0e\+00 of a component's size"
    with pytest.raises(cg.ConvergenceError, match=other) as found:
        shot_along_the_circle(speed)
    np.testing.assert_allclose(found.value.path(1.0), [0.0, -1.0], rtol=0, atol=CLOSED)
