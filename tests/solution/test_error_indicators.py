"""Error indicators of paths whose error estimate is fooled: kinks, steps, singularities; none against smooth paths."""

import operator
import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scenes import BY_NAME
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.solution.error_indicators import (
    FRACTIONS,
    LAGRANGIAN_MISFIT,
    energy_imbalance,
    error_indicators,
)

SMOOTH = ["short pendulum", "long pendulum, index 2", "Troesch 5", "boundary layer 0.0001", "damped oscillator"]


def free_fall_to_a_kink(t, x, v):
    return v[0] ** 2 / 2 - 10 * ca.fabs(x[0])


def end_of_fall(velocity):
    """Position at t = 2 from x = 1 on, where x'' = -10 sign x, by pieces."""
    x, v, left, side = 1.0, velocity, 2.0, 1.0
    while True:
        until_zero = (v * side + np.sqrt(v**2 + 20 * side * x)) / 10
        if until_zero >= left:
            return x + v * left - side * 5 * left**2
        x, v, left, side = 0.0, v - side * 10 * until_zero, left - until_zero, -side


@pytest.mark.parametrize("tol", [1e-6, *slow(1e-9, 1e-11)])
def test_a_kink_in_x_is_found_and_resolved(tol):
    """The estimate alone was 2.9e-15 at 1e-9, with a true error of 4e-5."""
    path = cg.solve(cg.BoundaryProblem(free_fall_to_a_kink, (0, 2), [1.0], [-0.5]), tol=tol)
    near = path.velocity[0, 0]
    exact = brentq(lambda velocity: end_of_fall(velocity) + 0.5, near - 0.1, near + 0.1, xtol=1e-15)
    assert abs(near - exact) <= 5 * tol * np.max(np.abs(path.velocity))


@pytest.mark.parametrize("tol", [1e-3, 1e-6, *slow(1e-10)])
@pytest.mark.parametrize("when", [1.1, *slow(1.49)])
def test_a_kink_in_time_is_resolved(when, tol):
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 + 50 * x[0] * ca.fmax(t - when, 0), (0, 2), [1.0], [-0.5]
    )
    path = cg.solve(problem, tol=tol)
    times = np.linspace(0, 2, 1001)
    pushed = 50 * np.maximum(times - when, 0) ** 3 / 6
    exact = 1 + pushed + times / 2 * (-1.5 - 50 * (2 - when) ** 3 / 6)
    assert np.max(np.abs(path(times)[0] - exact)) <= 5 * tol * np.max(np.abs(exact))


def stepped(when, **given):
    return cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - ca.if_else(t < when, 1, 3) * x[0] ** 2 / 2, (0, 2), [1.0], [-0.5], **given
    )


@pytest.mark.parametrize("tol", [1e-3, *slow(1e-8)])
@pytest.mark.parametrize("when", [1.1, *slow(1.7)])
def test_a_step_in_time_is_enclosed_by_an_interval_that_cannot_matter(when, tol):
    path, known = cg.solve(stepped(when), tol=tol), cg.solve(stepped(when, breakpoints=[when]), tol=1e-12)
    times = np.linspace(0, 2, 1001)
    assert np.max(np.abs(path(times) - known(times))) <= path.error_estimate * np.max(np.abs(known.x))
    assert path.error_estimate <= tol
    i = int(np.searchsorted(path.t, when))
    assert path.t[i] - path.t[i - 1] < tol


@pytest.mark.parametrize("when", [1.7, *slow(1.1)])
@pytest.mark.slow
def test_a_step_in_time_is_refused_with_its_time(when):
    with pytest.raises(cg.LimitReached, match=r"near t = .*breakpoint") as caught:
        cg.solve(stepped(when), tol=1e-12)
    assert float(re.search(r"near t = (\S+),? ", str(caught.value))[1].rstrip(".,")) == pytest.approx(when, abs=1e-9)


@pytest.mark.parametrize("tol", [1e-3, 1e-6])
def test_a_singularity_in_time_at_an_end_is_resolved(tol):
    """The brachistochrone by its height x(t), with t the depth: dx/dt is √(t / (2 r - t)), at first zero."""
    fall = cg.BoundaryProblem(lambda t, x, v: ca.sqrt((1 + v[0] ** 2) / t), (0, 1), [0.0], [np.pi / 2 - 1])
    path, angles = cg.solve(fall, tol=tol), np.linspace(0, np.pi / 2, 101)  # a cycloid of radius 1
    assert np.max(np.abs(path(1 - np.cos(angles))[0] - (angles - np.sin(angles)))) <= 2 * tol * (np.pi / 2 - 1)


@pytest.mark.parametrize(("when", "tol"), [(0.4, 1e-3), (1.1, 1e-12), (1.7, 1e-12)])
@pytest.mark.parametrize("before", [operator.lt, operator.le])
def test_a_step_in_time_that_is_named_is_resolved(before, when, tol):
    def rate(t, y):
        return [y[1], -(1 if t < when else 3) * y[0]]

    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - ca.if_else(before(t, when), 1, 3) * x[0] ** 2 / 2,
        (0, 2),
        [1.0],
        [-0.5],
        breakpoints=[when],
    )
    path = cg.solve(problem, tol=tol)
    assert when in path.t
    y = np.array([1.0, path.velocity[0, 0]])
    for span in ((0.0, when - 1e-15), (when, 2.0)):
        y = solve_ivp(rate, span, y, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    assert abs(y[0] + 0.5) <= 10 * tol + 1e-11


@pytest.mark.parametrize(
    ("start", "end", "duration", "tol", "beside"),
    [
        (0.3, -0.7, 1.5, 1e-3, 0.0),
        *slow(
            (1.0, -2.0, 3.0, 1e-9, 0.0),
        ),
    ],
)
@pytest.mark.slow
def test_no_path_through_the_sun_is_returned(start, end, duration, tol, beside):
    """Of equal distances the energies on both sides agree, and the action converges like h^(1/3)."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 + 1 / ca.norm_2(x), (0, duration), [start + beside, 0.0], [end, 0.0]
    )
    line = np.array([problem.start, problem.end]).T
    with pytest.raises(cg.LimitReached, match="give a guess that leads around it"):
        cg.solve(problem, tol=tol, guess=(np.array([0.0, duration]), line))
    around = cg.solve(problem, tol=tol)  # without a guess, another path is searched for
    flown = solve_ivp(
        lambda t, y: [*y[2:], *(-y[:2] / np.hypot(*y[:2]) ** 3)],
        (0.0, duration),
        [*around.x[:, 0], *around.velocity[:, 0]],
        rtol=1e-12,
        atol=1e-14,
        dense_output=True,
    )
    times = np.linspace(0.0, duration, 200)
    assert np.max(np.abs(around(times) - flown.sol(times)[:2])) < 10 * tol


@pytest.mark.parametrize("degree", [1, 4, *slow(14)])
@pytest.mark.parametrize("power", [2 / 3, 1.0, 2.0])
def test_no_pole_hides_between_points(degree, power):
    """A pole is alike on every scale, so one interval tells what is missed on any mesh, wherever the pole is in it."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.fabs(x[0]) ** -power, (0, 1), [-0.5], [0.5])
    nodes = cg.Galerkin(degree).element.nodes
    for place in np.linspace(0.0, 1.0, 79):
        path = PiecewisePolynomial(np.array([0.0, 1.0]), nodes, (nodes - place)[None])
        assert error_indicators(problem, path, np.ones((1, 2)))[1] > LAGRANGIAN_MISFIT


@pytest.mark.parametrize("beside", [1e-12, *slow(2e-12)])
@pytest.mark.slow
def test_rounding_hides_no_miss_beside_a_softened_pole(beside):
    """With an estimate of 8e-11, a path was off by 7e-4: positions of 1e-6 were taken to be rounded like those of 1."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 + 1 / ca.sqrt(x[0] ** 2 + 1e-12), (0.0, 1.0), [0.5 + beside], [-0.5]
    )
    try:
        path = cg.solve(problem, tol=1e-9)
    except cg.LimitReached:
        return  # whether it is reached hangs on last digits
    assert path.velocity[0, 0] == pytest.approx(0.3432063025, abs=1e-8)  # by quadrature of the energy


@pytest.mark.parametrize(("duration", "tol"), [(1.0, 1e-4), *slow((2.0, 1e-9))])
@pytest.mark.slow
def test_no_path_over_a_pole_on_its_line_is_returned(duration, tol):
    """Nothing passes the pole of the attraction 1/x²; paths over it were returned, with estimates below these."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + 1 / ca.fabs(x[0]), (0, duration), [1.0], [-1.0])
    with pytest.raises(cg.ConvergenceError):
        cg.solve(problem, tol=tol, limits=cg.Limits(seconds=5))


@pytest.mark.parametrize("tol", [1e-6, *slow(1e-9)])
@pytest.mark.parametrize("name", SMOOTH)
def test_nothing_is_said_against_a_smooth_path(name, tol):
    scene = BY_NAME[name]
    path = cg.solve(scene.problem, tol=tol, guess=scene.guess)
    indicators = error_indicators(scene.problem, path.polynomial, path.momentum)
    assert all(np.max(one) < part * tol for one, part in zip(indicators, FRACTIONS.values(), strict=True))


def test_joints_are_compared_by_the_larger_of_their_scales():
    kept, floor = np.array([1.0, 1.0, 50.0, 1.2]), np.zeros(4)
    scale = np.array([1.0, 1.0, 1e6, 1.0])
    assert np.max(energy_imbalance(kept, scale, floor)) == pytest.approx(0.2)
    assert np.max(energy_imbalance(kept[:3], scale[:3], floor[:3])) == pytest.approx(4.9e-5)


def test_joints_whose_energies_are_rounded_tell_nothing():
    assert np.max(energy_imbalance(np.array([1.0, 7.0, 1.0]), np.ones(3), np.array([0.0, 7.0, 0.0]))) == 0.0


def test_an_energy_that_is_not_a_number_is_a_miss():
    assert np.all(np.isinf(energy_imbalance(np.array([1.0, np.nan, 1.0]), np.ones(3), np.zeros(3))))


@pytest.mark.slow
def test_the_balance_holds_with_friction_and_under_a_constraint_that_moves():
    """A force takes energy by its work, a constraint that moves gives some by its own."""

    def length(t):
        return 1 + 0.1 * t

    def pose(t, angle):
        return (length(t) * np.array([np.sin(angle), -np.cos(angle)])).tolist()

    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 - x[1],
        (0.0, 2.0),
        pose(0.0, 0.3),
        pose(2.0, 1.4),
        constraint=lambda t, x: ca.dot(x, x) - length(t) ** 2,
        force=lambda t, x, v: -0.2 * v,
    )
    path = cg.solve(problem, tol=1e-10, guess=lambda t: pose(t, 0.3 + 0.55 * t))
    assert len(path.t) < 20
    assert np.ptp(path.energy) > 0.1
    # the same in its angle, where the friction of the moving rod is a force of time
    angle = cg.BoundaryProblem(
        lambda t, x, v: (length(t) * v[0]) ** 2 / 2 + length(t) * ca.cos(x[0]),
        (0.0, 2.0),
        [0.3],
        [1.4],
        force=lambda t, x, v: -0.2 * length(t) ** 2 * v,
    )
    exact = cg.solve(angle, tol=1e-12)
    np.testing.assert_allclose(np.arctan2(path.x[0], -path.x[1]), exact(path.t)[0], rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [1e-6, 1e-7])
def test_the_balance_allows_for_the_rounding_of_a_force_whose_terms_cancel(stiffness):
    """Terms of size 10 leave an acceleration times a mass of 1e-6: Cash's third test problem."""

    def force(t, x, v):
        drift, source = 2 + ca.cos(np.pi * t), (1 + stiffness * np.pi**2) * ca.cos(np.pi * t)
        return x - source - drift * (v + np.pi * ca.sin(np.pi * t))

    problem = cg.BoundaryProblem(lambda t, x, v: stiffness * v[0] ** 2 / 2, (-1.0, 1.0), [-1.0], [-1.0], force=force)
    path = cg.solve(problem, tol=1e-9)
    times = np.linspace(-1, 1, 101)
    np.testing.assert_allclose(path(times)[0], np.cos(np.pi * times), rtol=0, atol=1e-9)


@pytest.mark.parametrize(("far", "tol"), [(1e6, 1e-12), (1e9, 1e-9)])
def test_what_rounding_does_to_the_action_far_from_zero_is_no_doubt(far, tol):
    """A pendulum whose angle is counted from far away: its errors count relative to that."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0] - far), (0, 2), [far], [far + 1])
    near = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), (0, 2), [0.0], [1.0])
    path, expected = (cg.solve(each, tol=tol) for each in (problem, near))
    times = np.linspace(0, 2, 50)
    np.testing.assert_allclose(path(times) - far, expected(times), rtol=0, atol=far * tol)


@pytest.mark.parametrize(("begin", "tol"), [(-1e3, 1e-11), (1e5, 1e-9), (1e6, 1e-8), (1e6, 1e-11)])
def test_times_far_from_zero_do_not_unbalance_the_energy(begin, tol):
    """L is looked at a little inside of the ends, where it may step: by 1e-8 at t = 1e6, which its energy shows."""

    def lagrangian(t, x, v):
        since = t - begin
        return v[0] ** 2 / 2 - x[0] ** 2 / 2 + (since - 3 * ca.sin(2 * since)) * x[0]

    path = cg.solve(cg.BoundaryProblem(lagrangian, (begin, begin + 1), [0.0], [np.sin(2) + 1]), tol=tol)
    since = np.linspace(0, 1, 101)
    error = np.max(np.abs(path(begin + since)[0] - np.sin(2 * since) - since)) / (np.sin(2) + 1)
    assert error <= max(tol, 1e-15 * abs(begin))  # times are rounded
    assert len(path.t) <= 10


@pytest.mark.parametrize("intervals", [9, 10])
def test_a_step_in_x_at_a_joint_enters_the_estimate(intervals):
    """On ten intervals the path meets it at a joint, and both degrees agree to 1e-15."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - ca.if_else(x[0] > 0.5, 0.3, 0.0), (0.0, 1.0), [0.0], [1.0]
    )
    velocity = brentq(lambda v: 0.5 / v + 0.5 / np.sqrt(v**2 - 0.6) - 1, 0.8, 5)  # before it; the energy is kept
    path = cg.solve(problem, cg.Galerkin(4), intervals)
    assert path.estimate_error() >= abs(path(0.5 / velocity)[0] - 0.5)


EDGES = {  # Lagrangians that step in x, whose derivative is zero everywhere
    "potential": lambda t, x, v: v[0] ** 2 / 2 - 0.3 * (x[0] > 0.3),
    "floor": lambda t, x, v: v[0] ** 2 / 2 - 0.3 * ca.floor(2 * x[0] + 0.4),
    "moving": lambda t, x, v: v[0] ** 2 / 2 - 0.3 * (x[0] > 0.3 + 0.1 * t),
    "coming": lambda t, x, v: v[0] ** 2 / 2 - 0.3 * (x[0] > 0.8 - 0.7 * t),
    "mass": lambda t, x, v: (1 + (x[0] > 0.3)) * v[0] ** 2 / 2,
    "field": lambda t, x, v: ca.sumsqr(v) / 2 + 0.5 * (x[0] > 0.4) * v[1],
}


@pytest.mark.parametrize(("name", "tol"), [(name, 1e-3 if k % 2 else 1e-6) for k, name in enumerate(EDGES)])
@pytest.mark.slow
def test_a_path_over_an_edge_is_refused(name, tol):
    """The impulse at the edge is in no equation: the energies on both sides, or the momenta along it, did not agree."""
    d = 2 if name == "field" else 1
    problem = cg.BoundaryProblem(EDGES[name], (0.0, 1.0), [0.0] * d, [1.0, 0.5][:d])
    with pytest.raises(cg.ConvergenceError, match=r"balance of energy.*smooth a step in x|the mesh does not resolve"):
        cg.solve(problem, tol=tol)


@pytest.mark.parametrize("intervals", [10, 100])
def test_an_edge_is_no_pole(intervals):
    """Its misfit falls with the intervals, so that no other path is looked for; its energies still disagree."""
    path = cg.solve(cg.BoundaryProblem(EDGES["potential"], (0.0, 1.0), [0.0], [1.0]), cg.Galerkin(4), intervals)
    balance, misfit, _ = error_indicators(path.motion, path.polynomial, path.momentum)
    assert np.max(misfit) < 5 / intervals
    assert np.max(balance) > 0.1


@pytest.mark.parametrize("intervals", [10, 100])
def test_the_error_over_an_edge_is_the_same_on_any_mesh(intervals):
    step = cg.InitialProblem(EDGES["potential"], (0.0, 1.0), [0.0], velocity=[1.0])
    assert cg.solve(step, cg.Galerkin(4), intervals).estimate_error() > 0.1


@pytest.mark.slow
def test_over_a_kink_in_x_there_is_no_second_variation():
    """The path of a constant pull to the origin turns round there: its Hessian said minimum, but the index is one."""

    def swing(t):
        return np.where(t < np.sqrt(2), 1 - t**2 / 2, (t - np.sqrt(8)) ** 2 / 2 - 1)

    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - ca.fabs(x[0]), (0.0, 2.0), [1.0], [float(swing(2.0))])
    path = cg.solve(problem, tol=1e-4)
    np.testing.assert_allclose(path.x[0], swing(path.t), rtol=0, atol=1e-4)
    assert path.morse_index is None
    assert path.regularity is None
    assert "no Morse index" in repr(path)
    with pytest.raises(ValueError, match=r"sensitivity takes paths along which .* got one .* near t = 1\.4"):
        cg.sensitivity(path)
    with pytest.raises(ValueError, match=r"solution_function takes paths along which"):
        cg.solution_function(problem, cg.Galerkin(6), mesh=path.t, guess=path)
    within = cg.solve(replace(problem, t_span=(0.0, 1.0), end=[0.5]), tol=1e-4)
    assert within.morse_index == 0
    assert cg.sensitivity(within).x["end"][0, -1, 0] == 1


@pytest.mark.parametrize("named", [(), (np.arctan2(0.7, 1.1),)])
@pytest.mark.slow
def test_over_a_step_of_dry_friction_there_are_no_derivatives(named):
    """Where a spring with dry friction turns round, also where that time is a breakpoint: they were off by 14 %."""
    turn, swing = np.arctan2(0.7, 1.1), np.hypot(0.7, 1.1)  # x'' = -x - sign(x')/10 from x = 1, x' = 0.7
    end = 0.1 + (swing - 0.2) * np.cos(2.0 - turn)

    def by_velocity(t):
        """The derivative of x(t), after the turn, by the velocity at the start."""
        return (0.7 * np.cos(t - turn) + 1.1 * (1 - 0.2 / swing) * np.sin(t - turn)) / swing

    def stated(friction):
        action = (lambda t, x, v: (v[0] ** 2 - x[0] ** 2) / 2), (0.0, 2.0), [1.0], [end]
        return cg.BoundaryProblem(*action, force=lambda t, x, v: -friction(v) / 10, breakpoints=named)

    path = cg.solve(stated(ca.sign), tol=1e-6)
    assert path(0.0, 1)[0] == pytest.approx(0.7, abs=1e-6)
    assert path.regularity is None
    with pytest.raises(ValueError, match=r"sensitivity takes paths along which .* continuous in x and v"):
        cg.sensitivity(path)
    smooth = cg.sensitivity(cg.solve(stated(lambda v: ca.tanh(1e3 * v)), tol=1e-6))
    late = smooth.t > 1.0
    np.testing.assert_allclose(smooth.x["end"][0, late, 0], by_velocity(smooth.t[late]) / by_velocity(2.0), rtol=1e-3)


@pytest.mark.parametrize("how", [{"method": cg.Galerkin(4), "intervals": 8}, {"tol": 1e-8}])
def test_rounding_of_a_coordinate_that_does_not_matter_is_no_kink(how):
    """In polar coordinates the derivative of L by the angle is the rounding of what cancels."""

    def kepler(t, x, v):
        place = ca.vertcat(x[0] * ca.cos(x[1]), x[0] * ca.sin(x[1]))
        return ca.sumsqr(ca.jtimes(place, x, v)) / 2 + 1 / x[0]

    path = cg.solve(cg.BoundaryProblem(kepler, (0.0, 2.0), [1.0, 0.0], [1.2, 1.5]), **how)
    assert path.morse_index == 0
    assert path.regularity > 0.1
    assert np.all(np.isfinite(cg.sensitivity(path).x["end"]))


@pytest.mark.parametrize("tol", [1e-3, 1e-9, 1e-12])
@pytest.mark.parametrize("ends", [{"start": [0.7], "end": [0.7]}, {"start": [None], "periodic": True}])
def test_rest_where_the_lagrangian_vanishes_is_a_path(tol, ends):
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - (x[0] - 0.7) ** 2 / 2, (0.0, 2.0), **ends)
    path = cg.solve(problem, tol=tol)
    np.testing.assert_allclose(path.x, 0.7, rtol=1e-15)
    assert path.error_estimate <= tol


def test_a_pendulum_on_a_rod_that_hangs_still_is_a_path():
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 - x[1] - 1,
        (0.0, 2.0),
        [0.0, -1.0],
        [0.0, -1.0],
        constraint=lambda t, x: ca.dot(x, x) - 1,
    )
    np.testing.assert_allclose(cg.solve(problem, tol=1e-9)([0.0, 0.3, 2.0]), [[0.0] * 3, [-1.0] * 3], atol=1e-15)


@pytest.mark.parametrize("tol", [1e-3, *slow(1e-8)])
@pytest.mark.parametrize("when", [1.528372, *slow(*np.random.default_rng(1).uniform(0.3, 2.7, 4).round(6)[1:])])
def test_a_jump_of_a_force_in_time_is_resolved(when, tol):
    """Both degrees have points on the same sides of it: with an estimate of 1.9e-14, a path was off by 2.4e-2."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2,
        (0.0, 3.0),
        [0.0],
        [1.0],
        force=lambda t, x, v: ca.if_else(t > when, 1.0, 0.0),
    )

    def pushed(times):
        return 1 - np.cos(np.maximum(times - when, 0.0))

    times = np.linspace(0.0, 3.0, 1001)
    exact = (1 - pushed(3.0)) / np.sin(3.0) * np.sin(times) + pushed(times)
    path = cg.solve(problem, tol=tol)
    error = np.max(np.abs(path(times)[0] - exact)) / np.max(np.abs(exact))
    assert error <= min(tol, 3 * path.error_estimate)


@pytest.mark.parametrize("tol", [1e-3, *slow(1e-6)])
@pytest.mark.slow
def test_dry_friction_is_resolved_where_the_motion_turns(tol):
    rubbed, speed, duration = 0.3, 1.3, 2.6
    size, phase = np.hypot(rubbed, speed), np.arctan2(rubbed, speed)
    turns = np.pi / 2 - phase

    def exact(t):
        back = rubbed + (size - 2 * rubbed) * np.cos(t - turns)
        return np.where(t < turns, size * np.sin(t + phase) - rubbed, back)

    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2,
        (0.0, duration),
        [0.0],
        [float(exact(duration))],
        force=lambda t, x, v: -rubbed * ca.sign(v),
    )
    path, times = cg.solve(problem, tol=tol, guess=lambda t: [float(exact(t))]), np.linspace(0.0, duration, 1001)
    error = np.max(np.abs(path(times)[0] - exact(times))) / np.max(exact(times))
    assert error <= min(tol, 3 * path.error_estimate)


@pytest.mark.parametrize("unit", [1.0, 1e10])
def test_a_coarse_path_keeps_the_balance_of_energy_in_any_unit_of_one_component(unit):
    """Counted in a large unit, a component has a mass that is small beside that of another, and energy all the same."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: (v[0] ** 2 + (unit * v[1]) ** 2 - x[0] ** 2 - 9 * (unit * x[1]) ** 2) / 2,
        (0, 2),
        [0.1, 0.0],
        [0.2, 1 / unit],
    )
    path = cg.solve(problem, cg.Galerkin(3), 6)
    assert np.max(error_indicators(problem, path.polynomial, path.momentum)[0]) < 1e-12


@pytest.mark.parametrize("tol", [1e-9, 1e-11])
def test_a_body_at_rest_is_moved_by_no_jump_of_the_rounding_of_its_friction(tol):
    """Its momenta and its friction are only roundoff: relative to these, 273 intervals were taken at 1e-9."""
    hanging = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 - 9.81 * x[1] - 0.7 * x[0],
        (0, 1.35),
        [None, None],
        [None, None],
        force=lambda t, x, v: -ca.DM([[0.31, 0.17], [-0.11, 0.23]]) @ v,
        constraint=lambda t, x: ca.dot(x, x) - 1.7,
    )
    path = cg.solve(hanging, tol=tol, guess=lambda t: [-0.1, -1.3])
    assert len(path.t) <= 10
    down = np.sqrt(1.7) * np.array([-0.7, -9.81]) / np.hypot(0.7, 9.81)
    np.testing.assert_allclose(path.x, np.tile(down, (len(path.t), 1)).T, rtol=0, atol=1e-14)


@pytest.mark.parametrize(("start", "jump"), [(0.3, 0.8103912536527746), (1.0, 2.3), (-3.0, -1.3)])
def test_a_named_jump_may_be_where_its_time_is_rounded_to(start, jump):
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2 + ca.if_else(t - start < jump - start, 0.0, 1.0) * x[0],
        (start, start + 2),
        [0.0],
        [1.0],
        breakpoints=[jump],
    )
    path = cg.solve(problem, tol=1e-9)
    late = 2 - (jump - start)  # time under the constant force, which adds 1 - cos to the free oscillation
    speed = (1 - (1 - np.cos(late))) / np.sin(2)
    assert path.velocity[0, 0] == pytest.approx(speed, rel=1e-8)
