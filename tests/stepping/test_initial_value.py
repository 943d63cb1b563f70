"""The step (x, p) -> (x, p): its digits, its identity with the global solve, its geometry, its failures."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from motions import double_pendulum, oscillator, pendulum, quartic, start_of, varying_mass
from scenes import damped

import casadi_galerkin as cg

DIGITS = 1e-14  # values of size 0.4 after 10 steps, computed in 40 digits
SAME = 1e-13  # two ways of solving the same equations, relative to the path's size


@pytest.mark.parametrize(
    ("degree", "rule", "x", "p"),
    [
        (1, cg.gauss(1), 0.380217910910750734, -0.229602199709262823),
        (1, cg.lobatto(2), 0.38007441719324611, -0.229577337838984325),
        (2, cg.gauss(2), 0.380122306510488049, -0.22968133586901067),
        (2, cg.lobatto(3), 0.380122296543756508, -0.229681354091516684),
        (2, cg.gauss(3), 0.380122302524294009, -0.22968134315710153),
        (3, cg.gauss(3), 0.380122298538099843, -0.229681342466156464),
        (3, cg.gauss(4), 0.380122298537957462, -0.229681342466131785),
        (4, cg.gauss(4), 0.380122298537815081, -0.229681342466392105),
    ],
)
def test_ten_steps_of_the_oscillator_have_the_digits_of_forty_digit_arithmetic(degree, rule, x, p):
    problem = cg.InitialProblem(oscillator, (0, 1), [0.5], momentum=[0.0])
    path = cg.solve(problem, cg.Galerkin(degree, quadrature=rule), intervals=10)
    np.testing.assert_allclose([path.x[0, -1], path.momentum[0, -1]], [x, p], rtol=0, atol=DIGITS)


@pytest.mark.parametrize(
    ("lagrangian", "x", "p", "end"),
    [
        # the last two computed with mpmath's odefun in 25 digits
        (pendulum, 2.0, 0.3, (1.850957244040061, -0.607678436622756)),
        (varying_mass, 0.7, 0.4, (0.597334565142283213, -0.634766445117863741)),
        (quartic, 0.7, 0.4, (0.748810909555127803, -0.304621859633547761)),
    ],
)
def test_steps_reach_the_exact_motion_of_nonlinear_problems(lagrangian, x, p, end):
    path = cg.solve(cg.InitialProblem(lagrangian, (0, 1), [x], momentum=[p]), cg.Galerkin(8), intervals=12)
    np.testing.assert_allclose([path.x[0, -1], path.momentum[0, -1]], end, rtol=0, atol=5e-15)


def test_double_pendulum_reaches_its_reference_with_its_action():
    problem = cg.InitialProblem(double_pendulum, (0, 0.5), [1.0, 1.2], velocity=[0.0, 0.0])
    path = cg.solve(problem, cg.Galerkin(8), intervals=12)
    np.testing.assert_allclose(path.x[:, -1], [0.34020240315987093, 0.67472456539636882], rtol=0, atol=DIGITS)
    np.testing.assert_allclose(path.velocity[:, -1], [-1.7298716095965868, -2.9142006209385097], rtol=0, atol=1e-13)
    assert path.action == pytest.approx(11.748350447614505, rel=1e-14)


@pytest.mark.parametrize("units", [(4e-8, 6e2), (1e8, 1e-8), (1e-6, 1e6)])
@pytest.mark.slow
def test_steps_and_their_jacobians_are_the_same_whatever_the_units_of_the_components(units):
    """Rows of the equations are then of sizes as unlike as the units."""

    def orbit(units):
        sizes = ca.DM(units)

        def gravity(t, x, v):
            return ca.sumsqr(v / sizes) / 2 + 1 / ca.norm_2(x / sizes)

        start = cg.InitialProblem(gravity, (0, 2), [units[0], 0], velocity=[-0.3 * units[0], 0.9 * units[1]])
        return cg.solve(start, cg.Galerkin(12), intervals=10)

    path, other = orbit((1.0, 1.0)), orbit(units)
    np.testing.assert_allclose(other.x.T / units, path.x.T, rtol=0, atol=1e-13)
    of_states = np.concatenate((units, 1 / np.array(units)))
    jacobians = cg.geometry(other).jacobians / of_states[:, None] * of_states
    np.testing.assert_allclose(jacobians, cg.geometry(path).jacobians, rtol=0, atol=1e-12)


@pytest.mark.parametrize("degree", [3, 5, 7])
@pytest.mark.slow
def test_steps_are_solved_by_rules_with_negative_weights(degree):
    """The rule of 19 equal steps by Newton and Cotes: terms cancel, and are rounded by their sizes."""
    points = np.linspace(0, 1, 19)
    weights = np.linalg.solve(np.polynomial.legendre.legvander(2 * points - 1, 18).T, np.eye(19)[0])
    assert np.min(weights) < -10
    method = cg.Galerkin(degree, quadrature=cg.Quadrature(points, weights))
    for position in (0.1, 0.3, 0.5, 0.8):
        problem = cg.InitialProblem(oscillator, (0, 10), [position], velocity=[0.3])
        assert cg.solve(problem, method, intervals=40).residual < 5


# degree, rule, order, intervals that show it above roundoff
ORDERS = [
    (1, cg.gauss(1), 2, [64, 128, 256]),
    (1, cg.lobatto(2), 2, [64, 128, 256]),
    (2, cg.gauss(2), 4, [64, 128, 256]),
    (2, cg.gauss(3), 4, [64, 128, 256]),
    (2, cg.lobatto(2), 2, [64, 128, 256]),
    (2, cg.lobatto(3), 4, [64, 128, 256]),
    (3, cg.gauss(3), 6, [40, 60, 90]),
    (3, cg.lobatto(3), 4, [40, 60, 90]),
]
HIGH_ORDERS = [
    (pendulum, 3, cg.radau(3), 5, [40, 60, 90]),
    (pendulum, 4, cg.gauss(4), 8, [20, 28, 40]),
    (varying_mass, 4, cg.gauss(4), 8, [28, 40, 56]),
]


@cache
def exact_motion(lagrangian):
    problem = cg.InitialProblem(lagrangian, (0, 6), [0.7], momentum=[0.9])
    return problem, cg.solve(problem, cg.Galerkin(10), intervals=60)


@pytest.mark.parametrize(
    ("lagrangian", "degree", "rule", "order", "counts"),
    [(lagrangian, *case) for lagrangian in (varying_mass, quartic) for case in ORDERS] + HIGH_ORDERS,
)
def test_order_at_the_joints_is_that_of_the_global_solve(lagrangian, degree, rule, order, counts):
    (problem, exact), errors = exact_motion(lagrangian), []
    for count in counts:
        path = cg.solve(problem, cg.Galerkin(degree, quadrature=rule), intervals=count)
        ends = [np.concatenate((each.x[:, -1], each.momentum[:, -1])) for each in (path, exact)]
        errors.append(np.max(np.abs(ends[0] - ends[1])))
    assert min(errors) > 2e-13  # a hundred times roundoff
    assert cg.Galerkin(degree, quadrature=rule).order == order
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] == pytest.approx(order, abs=0.2)


def test_a_force_that_is_a_gradient_acts_like_its_potential():
    free = cg.InitialProblem(
        lambda t, x, v: v[0] ** 2 / 2, (0, 5), [2.0], momentum=[0.3], force=lambda t, x, v: [-ca.sin(x[0])]
    )
    bound = cg.InitialProblem(pendulum, (0, 5), [2.0], momentum=[0.3])
    forced, conservative = (cg.solve(problem, cg.Galerkin(4), intervals=25) for problem in (free, bound))
    np.testing.assert_allclose(forced.x, conservative.x, rtol=0, atol=SAME)
    np.testing.assert_allclose(forced.momentum, conservative.momentum, rtol=0, atol=SAME)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_dissipative_force_keeps_the_order(degree):
    problem = cg.InitialProblem(
        pendulum, (0, 2), [2.0], momentum=[0.3], force=lambda t, x, v: -0.3 * v * ca.fabs(1 + v**2) + ca.sin(t)
    )
    exact = cg.solve(problem, cg.Galerkin(10), intervals=40)
    counts = [16, 32, 64]
    errors = [abs(cg.solve(problem, cg.Galerkin(degree), n).x[0, -1] - exact.x[0, -1]) for n in counts]
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] == pytest.approx(2 * degree, abs=0.2)


def test_a_lagrangian_that_depends_on_time_reaches_its_exact_end():
    problem = cg.InitialProblem(damped, (0, 1), [1.0], velocity=[0.62075482816197670])
    path = cg.solve(problem, cg.Galerkin(8), intervals=8)
    assert path.x[0, -1] == pytest.approx(0, abs=2e-15)
    assert path(0.5)[0] == pytest.approx(0.80683882876568644, abs=2e-15)


def test_momentum_and_velocity_start_the_same_path_when_momentum_is_nonlinear_in_velocity():
    v = 1.3
    momentum, velocity = (
        cg.solve(cg.InitialProblem(quartic, (0, 1), [0.7], **start), cg.Galerkin(4), intervals=5)
        for start in ({"momentum": [v + v**3 / 3]}, {"velocity": [v]})
    )
    assert velocity.momentum[0, 0] == v + v**3 / 3
    np.testing.assert_allclose(momentum.x, velocity.x, rtol=0, atol=DIGITS)


def test_a_relativistic_start_finds_its_velocity_below_that_of_light():
    def relativistic(t, x, v):
        return -ca.sqrt(1 - v[0] ** 2) - x[0] ** 2 / 2

    problem = cg.InitialProblem(relativistic, (0, 10), [0.5], momentum=[30.0])
    path = cg.solve(problem, cg.Galerkin(6), intervals=100)
    energy = np.sqrt(1 + path.momentum[0] ** 2) + path.x[0] ** 2 / 2
    np.testing.assert_allclose(energy, energy[0], rtol=1e-10)
    assert path.residual < 10


def test_parameters_reach_lagrangian_and_force():
    problem = cg.InitialProblem(
        lambda t, x, v, p: p[0] * v[0] ** 2 / 2 - p[1] * x[0] ** 2 / 2,
        (0, 1),
        [0.5],
        velocity=[0.0],
        parameters=[2.0, 1.0],
        force=lambda t, x, v, p: p[0] * ca.sin(t) - p[1] * v,
    )
    fixed = cg.InitialProblem(
        lambda t, x, v: v[0] ** 2 - x[0] ** 2 / 2,
        (0, 1),
        [0.5],
        velocity=[0.0],
        force=lambda t, x, v: 2 * ca.sin(t) - v,
    )
    ours, theirs = (cg.solve(each, cg.Galerkin(3), intervals=4) for each in (problem, fixed))
    np.testing.assert_allclose(ours.x, theirs.x, rtol=0, atol=DIGITS)
    np.testing.assert_allclose(ours.energy, theirs.energy, rtol=0, atol=DIGITS)


def test_a_trajectory_of_steps_has_no_morse_index_and_says_what_it_is(capsys):
    path = cg.solve(start_of("pendulum", 5), cg.Galerkin(3), intervals=5, verbose=1)
    assert path.morse_index is None
    assert path.residual < 10
    assert "no Morse index" in capsys.readouterr().out


@pytest.mark.parametrize("start", [{"momentum": [1.0, 2.0]}, {"velocity": [1.0, 2.0]}])
def test_a_degenerate_lagrangian_is_refused_before_any_step(start):
    with pytest.raises(ValueError, match=r"degenerate: its mass matrix .* is singular at the start"):
        cg.InitialProblem(lambda t, x, v: (v[0] + v[1]) ** 2 / 2 - x[0] ** 2, (0, 1), [0.5, 1.0], **start)


def test_a_start_outside_the_domain_of_the_lagrangian_is_refused():
    with pytest.raises(ValueError, match=r"the lagrangian is not a number at the start, x = \(-1\.0,\), v = \[1\.0\]"):
        cg.InitialProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.log(x[0]), (0, 1), [-1.0], velocity=[1.0])


def test_a_momentum_that_no_velocity_has_is_refused():
    with pytest.raises(ValueError, match=r"degenerate|no velocity was found"):
        cg.InitialProblem(lambda t, x, v: ca.sqrt(1 + v[0] ** 2), (0, 1), [0.5], momentum=[1.5])


def test_rest_without_a_regular_mass_is_refused():
    with pytest.raises(ValueError, match=r"degenerate: .* singular at the start, x = \[0\.\], v = \[0\.\]"):
        cg.InitialProblem(lambda t, x, v: v[0] ** 4 / 4 - x[0], (0, 1), [0.0], momentum=[0.0])


@pytest.mark.parametrize("beside", [1e-12, 1e-9, 1e-6, 1e-3])
@pytest.mark.parametrize("intervals", [7, 40])
def test_a_small_component_is_stepped_where_terms_of_others_cancel(intervals, beside):
    """The derivatives of L by it are differences of sines, and floors of their terms alone refused such steps."""

    def path(lagrangian):
        problem = cg.InitialProblem(lagrangian, (0, 1), [1.0, 0.0], velocity=[-0.8, beside])
        return cg.solve(problem, cg.Galerkin(4), intervals)

    found = path(lambda t, x, v: ca.sumsqr(v) / 2 - ca.cos(x[0] + x[1]) - ca.cos(x[0] - x[1]))
    exact = path(lambda t, x, v: ca.sumsqr(v) / 2 - 2 * ca.cos(x[0]) * ca.cos(x[1]))
    assert np.max(np.abs(found.x - exact.x)[1]) <= 1e-14  # some roundings of the sines


def swaying(t, x, v):
    return v[0] ** 2 / 2 - x[0] ** 2 / 2


@pytest.mark.parametrize("tol", [1e-3, 1e-6, 1e-9])
def test_with_a_tolerance_equal_steps_are_halved_until_the_error_is_that_small(tol):
    path = cg.solve(cg.InitialProblem(swaying, (0, 20), [1.0], velocity=[0.0]), tol=tol)
    assert np.max(np.abs(path.x[0] - np.cos(path.t))) <= path.error_estimate <= tol
    assert np.ptp(np.diff(path.t)) < 1e-12
    assert path.method == cg.solve(cg.BoundaryProblem(swaying, (0, 1), [1.0], [0.0]), tol=tol).method


@pytest.mark.slow
def test_steps_begin_with_the_intervals_or_the_mesh_that_is_given():
    problem = cg.InitialProblem(swaying, (0, 1), [1.0], velocity=[0.0])
    assert len(cg.solve(problem, tol=1e-6, intervals=24).t) == 25
    graded = np.array([0.0, 0.1, 0.4, 1.0])
    assert set(graded) <= set(cg.solve(problem, cg.Galerkin(1), tol=1e-3, mesh=graded).t)


def test_a_tolerance_that_steps_do_not_reach_is_an_error_with_the_best_path():
    problem = cg.InitialProblem(swaying, (0, 20), [1.0], velocity=[0.0])
    with pytest.raises(
        cg.LimitReached,
        match=r"tolerance 1e-09 was not reached within 50 intervals .* error of .* least resolved near t = ",
    ) as few:
        cg.solve(problem, cg.Galerkin(1), tol=1e-9, limits=cg.Limits(intervals=50))
    assert 1e-9 < few.value.path.error_estimate < 1
    with pytest.raises(cg.LimitReached, match="seconds: no path"):
        cg.solve(problem, tol=1e-9, limits=cg.Limits(seconds=1e-300))
