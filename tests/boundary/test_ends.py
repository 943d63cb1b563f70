"""Ends: given velocities and momenta, springs, curves, copies of the start, each against a closed form or an integral.

Free particles and an oscillator have paths that are known for any two conditions at the ends.
"""

import casadi as ca
import numpy as np
import pytest
from motions import double_pendulum, kepler
from scenes import free_particle, oscillator
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize_scalar

import casadi_galerkin as cg

CLOSED_FORM = 1e-12  # of values of size 1
TRANSVERSAL = 1e-11
METHOD = cg.Galerkin(10)
SWUNG = [0.34020240315987093, 0.67472456539636882]  # a double pendulum 0.5 s after rest at (1, 1.2), computed
SWINGING = [-1.7298716095965868, -2.9142006209385097]  # its velocity then


def rotation(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def ended(lagrangian=oscillator, t_span=(0.0, 1.0), start=(None,), end=(None,), **ends):
    return cg.BoundaryProblem(lagrangian, t_span, start, end, **ends)


@pytest.mark.parametrize(
    ("ends", "cosine", "sine"),
    [
        # x = a cos t + b sin t, v = p
        ({"start_velocity": [0.7], "end": [2.0]}, (2 - 0.7 * np.sin(1)) / np.cos(1), 0.7),
        ({"start_momentum": [0.7], "end": [2.0]}, (2 - 0.7 * np.sin(1)) / np.cos(1), 0.7),
        ({"start": [1.0], "end_velocity": [-0.3]}, 1.0, (-0.3 + np.sin(1)) / np.cos(1)),
        ({"start": [1.0], "end_momentum": [-0.3]}, 1.0, (-0.3 + np.sin(1)) / np.cos(1)),
        ({"start_velocity": [0.7], "end_momentum": [-0.3]}, (0.7 * np.cos(1) + 0.3) / np.sin(1), 0.7),
        ({"start_momentum": [0.7], "end_velocity": [-0.3]}, (0.7 * np.cos(1) + 0.3) / np.sin(1), 0.7),
    ],
    ids=lambda value: " and ".join(value) if isinstance(value, dict) else "",
)
def test_a_given_velocity_or_momentum_takes_the_place_of_a_position(ends, cosine, sine):
    path = cg.solve(ended(**ends), METHOD, intervals=4)
    exact = cosine * np.cos(path.t) + sine * np.sin(path.t)
    np.testing.assert_allclose(path.x[0], exact, rtol=0, atol=CLOSED_FORM)


@pytest.mark.parametrize("name", ["start_momentum", "end_momentum", "start_velocity", "end_velocity"])
def test_a_given_zero_is_the_natural_condition(name):
    ends = {"start": [1.0]} if name.startswith("end") else {"end": [1.0]}
    given, natural = (cg.solve(ended(**ends, **more), METHOD, intervals=3) for more in ({name: [0.0]}, {}))
    np.testing.assert_allclose(given.x, natural.x, rtol=0, atol=1e-15)


def test_the_action_of_a_path_with_a_given_momentum_is_its_own():
    """Without p·x of the end: on shell, S = (x_N p_N - x_0 p_0)/2."""
    path = cg.solve(ended(start=[1.0], end_momentum=[-0.3]), METHOD, intervals=4)
    products = path.x[0] * path.momentum[0]
    assert path.action == pytest.approx((products[-1] - products[0]) / 2, abs=CLOSED_FORM)


def test_a_given_velocity_of_a_nonlinear_momentum_is_met():
    """p = v + v³/3, so that the row at the end is not that of the action."""
    problem = ended(lambda t, x, v: v[0] ** 2 / 2 + v[0] ** 4 / 12 + ca.cos(x[0]), start=[0.2], end_velocity=[1.3])
    path = cg.solve(problem, METHOD, intervals=6)
    assert path.velocity[0, -1] == pytest.approx(1.3, abs=CLOSED_FORM)
    assert path.momentum[0, -1] == pytest.approx(1.3 + 1.3**3 / 3, abs=CLOSED_FORM)


@pytest.mark.parametrize("solver", [cg.newton, cg.rootfinder, cg.ipopt])
def test_a_given_velocity_whose_momentum_depends_on_a_given_position_alone_is_met(solver):
    """A charge on a circle: the term of the ends adds nothing to the Hessian."""
    charge = ended(
        lambda t, x, v: ca.sumsqr(v) / 2 + (x[0] * v[1] - x[1] * v[0]) / 2,
        start=[0.0, 0.0],
        end=[None, np.cos(1) - 1],
        end_velocity=[np.cos(1), None],
    )
    path = cg.solve(charge, METHOD, intervals=4, solver=solver)
    np.testing.assert_allclose(path.x, [np.sin(path.t), np.cos(path.t) - 1], rtol=0, atol=CLOSED_FORM)


def test_given_ends_change_from_solve_to_solve():
    transcription = cg.transcribe(ended(start_velocity=[0.7], end_momentum=[-0.3]), METHOD, 4)
    for v, p in ((0.7, -0.3), (0.1, 2.0)):
        path = transcription.solve(start_velocity=[v], end_momentum=[p])
        exact = (v * np.cos(1) - p) / np.sin(1) * np.cos(path.t) + v * np.sin(path.t)
        np.testing.assert_allclose(path.x[0], exact, rtol=0, atol=CLOSED_FORM)
        assert (path.problem.start_velocity, path.problem.end_momentum) == ((v,), (p,))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"end_velocity": [1.0]}, r"end_velocity must have None where the problem has it, \(None,\), got \(1.0,\)"),
        ({"start_velocity": [None]}, r"start_velocity must have None where the problem has it, \(0.7,\)"),
        ({"start_velocity": [0.0, 1.0]}, r"start_velocity must have 1 component, got 2"),
        ({"energy": 1.0}, "the problem has no energy, got energy=1.0"),
    ],
)
def test_another_kind_of_end_cannot_be_given_later(changes, message):
    transcription = cg.transcribe(ended(start_velocity=[0.7], end=[1.0]), METHOD, 2)
    with pytest.raises(ValueError, match=message):
        transcription.solve(**changes)


# springs and other costs of the ends


@pytest.mark.parametrize(("stiffness", "duration"), [(3.0, 2.0), (1e-3, 1.0), (1e6, 5.0)])
def test_a_spring_at_the_end_of_a_free_particle_has_its_closed_form(stiffness, duration):
    problem = ended(free_particle, (0, duration), start=[1.0], end_action=lambda x0, x1: stiffness * x1[0] ** 2 / 2)
    path, fall = cg.solve(problem, cg.Galerkin(2), intervals=4), stiffness / (1 + stiffness * duration)
    np.testing.assert_allclose(path.x[0], 1 - fall * path.t, rtol=0, atol=CLOSED_FORM)
    assert path.action == pytest.approx(fall / 2, rel=CLOSED_FORM)  # of path and spring together


def test_springs_at_both_ends_are_robin_conditions():
    """p_0 = ∂φ/∂x_0 and p_N = -∂φ/∂x_N, so that a and b of a cos t + b sin t solve two linear equations."""
    problem = ended(end_action=lambda x0, x1: (x0[0] - 1) ** 2 + 3 * (x1[0] + 2) ** 2 / 2)
    path, c, s = cg.solve(problem, METHOD, intervals=4), np.cos(1), np.sin(1)
    a, b = np.linalg.solve([[-2, 1], [3 * c - s, 3 * s + c]], [-2, -6])
    np.testing.assert_allclose(path.x[0], a * np.cos(path.t) + b * np.sin(path.t), rtol=0, atol=CLOSED_FORM)


def test_an_action_of_both_ends_couples_them():
    """A spring between the ends of a free particle's way: x_N - x_0 = v T, p_0 = p_N = -k (x_N - x_0 - 1)."""
    problem = ended(
        free_particle, (0, 2), [None, 0.0], [0.5, None], end_action=lambda x0, x1: 2 * ca.sumsqr(x1 - x0 - 1)
    )
    path = cg.solve(problem, cg.Galerkin(2), intervals=3)
    np.testing.assert_allclose(path.velocity, np.full((2, 4), 4 / 9), rtol=0, atol=CLOSED_FORM)


# ends on curves


def test_a_free_particle_goes_to_the_nearest_point_of_a_circle():
    problem = ended(free_particle, start=[3.0, 4.0], end=[None, None], end_conditions=lambda x0, x1: ca.sumsqr(x1) - 1)
    path = cg.solve(problem, cg.Galerkin(2), intervals=3)
    np.testing.assert_allclose(path.x[:, -1], [0.6, 0.8], rtol=0, atol=CLOSED_FORM)
    assert path.action == pytest.approx(8.0, rel=CLOSED_FORM)
    assert path.morse_index == 0


def test_the_way_to_the_farthest_point_of_a_circle_is_a_saddle():
    problem = ended(free_particle, start=[3.0, 4.0], end=[None, None], end_conditions=lambda x0, x1: ca.sumsqr(x1) - 1)
    path = cg.solve(problem, cg.Galerkin(2), intervals=3, guess=lambda t: [3 - 3.6 * t, 4 - 4.8 * t])
    np.testing.assert_allclose(path.x[:, -1], [-0.6, -0.8], rtol=0, atol=CLOSED_FORM)
    assert path.morse_index == 1


def to_a_ridge():
    return cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2 - ca.sumsqr(x) / 2,
        (0, 1),
        start=[1.5, -0.5],
        end=[None, None],
        end_conditions=lambda x0, x1: x1[1] - x1[0] ** 2 - 1,
    )


def test_an_end_on_a_curve_arrives_across_it_where_the_action_is_least():
    """An oscillator from a point to the parabola y = x² + 1: the action by the end is a function of one number."""
    path = cg.solve(to_a_ridge(), METHOD, intervals=4)
    x, y = path.x[:, -1]
    c, s = np.cos(1), np.sin(1)

    def slope(x):  # of ((|a|² + |b|²) c - 2 a·b)/(2 s) along b = (x, x² + 1)
        return (c * x - 1.5 + 2 * x * (c * (x**2 + 1) + 0.5)) / s

    assert x == pytest.approx(brentq(slope, 0, 1, xtol=1e-15), abs=CLOSED_FORM)
    assert abs(path.momentum[:, -1] @ [1, 2 * x]) <= TRANSVERSAL
    assert y == pytest.approx(x**2 + 1, abs=1e-15)


def test_the_shortest_way_between_two_ellipses_is_across_both():
    problem = cg.BoundaryProblem(
        free_particle,
        (0, 1),
        start=[None, None],
        end=[None, None],
        end_conditions=lambda x0, x1: [x0[0] ** 2 / 4 + x0[1] ** 2 - 1, (x1[0] - 4) ** 2 + (x1[1] - 3) ** 2 / 4 - 1],
    )
    path = cg.solve(problem, cg.Galerkin(2), intervals=2, guess=lambda t: [1 + 2 * t, 1 + t])
    (a, b), (c, d) = path.x[:, [0, -1]].T
    assert path.momentum[:, 0] @ [-b * 4, a] == pytest.approx(0, abs=TRANSVERSAL)
    assert path.momentum[:, -1] @ [-(d - 3) / 4, c - 4] == pytest.approx(0, abs=TRANSVERSAL)
    at = lambda u: np.array([2 * np.cos(u), np.sin(u)])  # noqa: E731
    other = lambda u: np.array([4 + np.cos(u), 3 + 2 * np.sin(u)])  # noqa: E731
    nearest = lambda u: minimize_scalar(lambda w: np.sum((at(u) - other(w)) ** 2), (3.5, 4.5), tol=1e-12).fun  # noqa: E731
    assert 2 * path.action == pytest.approx(minimize_scalar(nearest, (0.2, 0.9), tol=1e-12).fun, rel=CLOSED_FORM)


def test_a_brachistochrone_to_a_slope_arrives_at_right_angles_in_the_time_of_its_cycloid():
    """Time is the length ∫ |dx|/√(2 y) with y downwards; cycloid x = θ - sin θ, y = 1 - cos θ from θ = 1/2 to 2."""
    place = lambda u: np.array([u - np.sin(u), 1 - np.cos(u)])  # noqa: E731
    heading = place(2.0), np.array([1 - np.cos(2.0), np.sin(2.0)])
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / (4 * x[1]),  # half the squared speed of passing: S = time²/2
        (0, 1),
        start=place(0.5),
        end=[None, None],
        end_conditions=lambda x0, x1: ca.dot(ca.DM(heading[1]), x1 - ca.DM(heading[0])),
    )
    first, last = place(0.5), place(2.0)
    path = cg.solve(problem, cg.Galerkin(12), intervals=10, guess=lambda t: first + t * (last - first))
    np.testing.assert_allclose(path.x[:, -1], last, rtol=0, atol=CLOSED_FORM)
    assert np.sqrt(2 * path.action) == pytest.approx(1.5, rel=CLOSED_FORM)
    along = np.array([heading[1][1], -heading[1][0]])
    assert abs(path.momentum[:, -1] @ along) <= TRANSVERSAL


# ends that are copies of the start, or at a distance


def test_an_end_that_is_the_turned_start_closes_a_circle_in_a_turning_frame():
    """A Kepler orbit whose end is its start turned by 1 rad in unit time is the circle of radius 1."""
    turn = rotation(1.0)
    problem = cg.BoundaryProblem(
        kepler, (0, 1), [None, 0.0], [None, None], end_conditions=lambda x0, x1: x1 - ca.DM(turn) @ x0
    )
    path = cg.solve(problem, METHOD, intervals=6, guess=lambda t: [1.1 * np.cos(t), 0.9 * np.sin(t)])
    np.testing.assert_allclose(path.x, [np.cos(path.t), np.sin(path.t)], rtol=0, atol=CLOSED_FORM)
    np.testing.assert_allclose(path.momentum[:, -1], turn @ path.momentum[:, 0], rtol=0, atol=TRANSVERSAL)


def test_an_end_that_is_the_mirrored_start_is_half_of_a_periodic_path():
    """x(T) = -x(0) with p(T) = -p(0): x'' = -2 x + cos t has the one such path cos t on [0, π]."""
    problem = ended(
        lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 + x[0] * ca.cos(t),
        (0, np.pi),
        end_conditions=lambda x0, x1: x0 + x1,
    )
    path = cg.solve(problem, METHOD, intervals=4)
    np.testing.assert_allclose(path.x[0], np.cos(path.t), rtol=0, atol=CLOSED_FORM)
    assert path.momentum[0, -1] == pytest.approx(-path.momentum[0, 0], abs=TRANSVERSAL)


def test_two_free_particles_that_end_at_a_distance_meet_each_other_half_way():
    problem = cg.BoundaryProblem(
        free_particle,
        (0, 1),
        start=[0.0, 0.0, 3.0, 4.0],
        end=[None] * 4,
        end_conditions=lambda x0, x1: ca.sumsqr(x1[:2] - x1[2:]) - 1,
    )
    path = cg.solve(problem, cg.Galerkin(2), intervals=3, guess=lambda t: [t, t, 3 - t, 4 - t])
    np.testing.assert_allclose(path.x[:, -1], [1.2, 1.6, 1.8, 2.4], rtol=0, atol=CLOSED_FORM)
    assert path.action == pytest.approx(4.0, rel=CLOSED_FORM)


@pytest.mark.parametrize("value", [1.0, -0.4])
def test_a_condition_that_fixes_a_component_is_that_component_given(value):
    problem = ended(start=[0.3], end_conditions=lambda x0, x1: x1[0] - value)
    given, held = (cg.solve(each, METHOD, intervals=4) for each in (ended(start=[0.3], end=[value]), problem))
    np.testing.assert_allclose(held.x, given.x, rtol=0, atol=1e-15)
    np.testing.assert_allclose(held.momentum, given.momentum, rtol=0, atol=CLOSED_FORM)
    assert held.morse_index == given.morse_index


@pytest.mark.parametrize("duration", [2.0, 4.0, 7.0])
def test_the_morse_index_counts_only_variations_that_meet_the_conditions(duration):
    """An oscillator held at its end has floor(T/π) negative directions, however the end is held."""
    problem = ended(t_span=(0, duration), start=[0.3], end_conditions=lambda x0, x1: x1[0] - 1)
    assert cg.solve(problem, METHOD, intervals=8).morse_index == int(duration / np.pi)


def test_parameters_reach_end_action_and_end_conditions():
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: ca.sumsqr(v) / 2,
        (0, 1),
        [3.0, 4.0],
        [None, None],
        parameters=[1.0, 0.0],
        end_action=lambda x0, x1, p: p[1] * ca.sumsqr(x1 - x0) / 2,
        end_conditions=lambda x0, x1, p: ca.sumsqr(x1) - p[0] ** 2,
    )
    transcription = cg.transcribe(problem, cg.Galerkin(2), 3)
    path = transcription.solve(parameters=[2.0, 3.0])
    np.testing.assert_allclose(path.x[:, -1], [1.2, 1.6], rtol=0, atol=CLOSED_FORM)
    assert path.action == pytest.approx(9 / 2 + 3 * 9 / 2, rel=CLOSED_FORM)


# velocities that share a mass matrix


def test_given_velocities_of_a_double_pendulum_lead_to_where_it_swings():
    problem = cg.BoundaryProblem(double_pendulum, (0, 0.5), [None, None], SWUNG, start_velocity=[0.0, 0.0])
    assert missed(cg.solve(problem, METHOD, intervals=10)) <= CLOSED_FORM


def missed(path):
    """How far a path is from the swing, in angles and velocities at both ends."""
    expected = np.array([1.0, 1.2]), np.zeros(2), np.array(SWUNG), np.array(SWINGING)
    found = path.x[:, 0], path.velocity[:, 0], path.x[:, -1], path.velocity[:, -1]
    return max(np.max(np.abs(a - b)) for a, b in zip(found, expected, strict=True))


@pytest.mark.parametrize("end", ["start", "end"])
def test_a_given_velocity_whose_momentum_depends_on_one_that_is_not_given_is_refused(end):
    """The first of three masses is coupled to the second alone, and that one to the third."""
    mass = ca.DM([[2.0, 1.0, 0.0], [1.0, 3.0, 1.0], [0.0, 1.0, 2.0]])
    with pytest.raises(
        ValueError, match=rf"{end}_velocity\[0\] is given, and .* component 1.* or {end}_momentum, or state"
    ):
        ended(
            lambda t, x, v: ca.bilin(mass, v, v) / 2,
            **{"start": [0.0] * 3, "end": [0.0] * 3, end: [None, 0.0, 0.0], f"{end}_velocity": [0.7, None, None]},
        )


# tolerances, solvers


def to_a_parabola():
    return cg.BoundaryProblem(
        kepler,
        (0, 2),
        start=[1.0, 0.0],
        end=[None, None],
        end_conditions=lambda x0, x1: x1[1] - 1 - x1[0] ** 2 / 4,
        end_action=lambda x0, x1: x1[0] / 5,
    )


@pytest.mark.parametrize("tol", [1e-4, 1e-10])
def test_a_path_to_a_curve_found_to_a_tolerance_meets_it(tol):
    path = cg.solve(to_a_parabola(), tol=tol)
    exact = cg.solve(to_a_parabola(), cg.Galerkin(14), intervals=16, guess=path)
    times = np.linspace(0, 2, 301)
    assert path.error_estimate <= tol
    assert np.max(np.abs(path(times) - exact(times))) <= tol * np.max(np.abs(exact.x))


@pytest.mark.parametrize("solver", [cg.rootfinder, cg.ipopt, cg.minimizer], ids=str)
def test_solvers_agree_on_a_path_to_a_curve(solver):
    newton, other = (cg.solve(to_a_ridge(), METHOD, intervals=4, solver=each) for each in (cg.newton, solver))
    np.testing.assert_allclose(other.x, newton.x, rtol=0, atol=1e-13)
    assert other.action == pytest.approx(newton.action, rel=1e-13)


@pytest.mark.parametrize("solver", [cg.rootfinder, cg.ipopt], ids=str)
def test_solvers_agree_on_given_velocities(solver):
    problem = cg.BoundaryProblem(double_pendulum, (0, 0.2), [0.1, 0.3], [None, None], end_velocity=[0.2, 0.5])
    newton, other = (cg.solve(problem, METHOD, intervals=4, solver=each) for each in (cg.newton, solver))
    np.testing.assert_allclose(other.x, newton.x, rtol=0, atol=1e-13)


def test_the_path_to_a_parabola_is_that_of_its_first_velocity():
    path = cg.solve(to_a_parabola(), METHOD, intervals=8)
    rate = lambda t, y: [*y[2:], *(-y[:2] / np.hypot(*y[:2]) ** 3)]  # noqa: E731
    end = solve_ivp(rate, (0, 2), [1, 0, *path.velocity[:, 0]], "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    np.testing.assert_allclose(end, [*path.x[:, -1], *path.velocity[:, -1]], rtol=0, atol=1e-11)
    across = path.momentum[:, -1] + [0.2, 0]
    assert abs(across @ [1, path.x[0, -1] / 2]) <= TRANSVERSAL


@pytest.mark.parametrize(
    "end",
    [{"end_velocity": [0.7]}, {"end_momentum": [0.7]}, {"end_action": lambda x0, x1: x1[0] ** 3}],
    ids=lambda end: next(iter(end)),
)
def test_what_a_minimizer_lowers_has_the_equations_as_its_gradient(end):
    problem = cg.BoundaryProblem(lambda t, x, v: (1 + t) * v[0] ** 2 / 2 + ca.cos(x[0]), (0, 2), [0.3], [None], **end)
    transcription = cg.transcribe(problem, cg.Galerkin(3), 4)
    unknowns = np.linspace(0.5, 1.5, transcription.numbering.free)
    data = [ca.DM(each) for each in transcription.data(transcription.mesh)]
    given = ca.MX.sym("unknowns", len(unknowns))
    slope = ca.Function("slope", [given], [ca.gradient(transcription.action(given, *data), given)])
    np.testing.assert_allclose(slope(unknowns), transcription.gradient(unknowns, *data), rtol=0, atol=1e-13)
    least = transcription.solve(solver=cg.minimizer)
    exact = cg.solve(cg.BoundaryProblem(problem.lagrangian, (0, 2), [0.3], least.x[:, -1]), cg.Galerkin(3), 4)
    assert least.action == pytest.approx(exact.action + (least.x[0, -1] ** 3 if "end_action" in end else 0), rel=1e-12)


@pytest.mark.parametrize(
    ("ends", "expected"),
    [
        # a branch in x[0] of what depends on x[1]: the second derivatives have no symmetric pattern
        ({"end_conditions": lambda x0, x1: ca.if_else(x1[0] > 0, x1[1] - 1, x1[1] - 2)}, [-1.0, 2.0]),
        ({"end_action": lambda x0, x1: -(x1[0] ** 2) - ca.if_else(x1[0] > 0, 1, 2) * x1[1] ** 2}, [1.0, 0.0]),
    ],
    ids=["condition", "action"],
)
def test_ends_may_branch_in_a_component(ends, expected):
    problem = ended(lambda t, x, v: ca.sumsqr(v) / 2, start=[-1.0, 0.0], end=[None, None], **ends)
    path = cg.solve(problem, METHOD, 3)
    np.testing.assert_allclose(path.x[:, -1], expected, rtol=0, atol=CLOSED_FORM)


@pytest.mark.parametrize("beside", [0.0, 1e-9, 1e-6])
def test_a_spring_at_a_free_end_whose_terms_cancel_is_solved(beside):
    """Given ends are rounded as unknowns are: what a spring adds up of them is no better than their digits."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 - ca.dot(x, x) / 2,
        (0, 1),
        [0.0, 0.0, 0.0],
        [0.1, beside - 0.3, None],
        end_action=lambda first, last: 5 * (last[2] - 3 * last[0] - last[1]) ** 2,
    )
    path, times = cg.solve(problem, tol=1e-6), np.linspace(0, 1, 101)
    pulled = 10 * beside / (np.cos(1) + 10 * np.sin(1))
    assert np.max(np.abs(path(times)[2] - pulled * np.sin(times))) < 1e-15 + 1e-6 * beside


def test_a_height_over_the_round_earth_is_met_up_to_the_rounding_of_its_radius():
    radius, away, height = 6.378e6, 353.0, -48.8  # in m
    falling = lambda t, x, v: ca.dot(v, v) / 2 - 9.81 * x[1]  # noqa: E731
    over_ground = lambda start, end: ca.sqrt(end[0] ** 2 + (end[1] + radius) ** 2) - radius - height  # noqa: E731
    problem = ended(falling, (0.0, 6.16), [0.0, 0.0], [away, None], end_conditions=over_ground)
    power = height * (2 * radius + height) - away**2  # of the end: y² + 2 y radius
    path = cg.solve(problem, tol=1e-9)
    assert path.x[1, -1] == pytest.approx(power / (radius + np.sqrt(radius**2 + power)), rel=path.error_estimate * 5)
    with pytest.raises(cg.LimitReached, match="roundoff floor"):
        cg.solve(problem, tol=1e-13)


@pytest.mark.parametrize("singular", [ca.sqrt, ca.norm_2, lambda p: ca.fabs(p) ** 1.5, lambda p: ca.asin(1 - p)])
def test_a_condition_may_have_a_singular_term_of_a_parameter(singular):
    """The rounding of sqrt(p) at p = 0 has no size."""
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2,
        (0, 1),
        [0.0],
        [None],
        end_conditions=lambda first, last, p: last[0] - 1 - singular(p[0]),
        parameters=[0.0],
    )
    path = cg.solve(problem, tol=1e-9)
    assert path(1.0)[0] == pytest.approx(1 + float(singular(ca.DM(0.0))), rel=1e-14)
