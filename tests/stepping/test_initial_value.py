"""The step (x, p) -> (x, p): its digits, its identity with the global solve, its geometry, its failures."""

import casadi as ca
import numpy as np
import pytest

import casadi_galerkin as cg
from casadi_galerkin.stepping.stepper import PIECE

DIGITS = 1e-14  # values of size 0.4 after 10 steps, computed in 40 digits
SAME = 1e-13  # two ways of solving the same equations, relative to the path's size
GRAVITY = 9.81


def oscillator(t, x, v):
    return v[0] ** 2 / 2 - x[0] ** 2 / 4


def pendulum(t, x, v):
    return v[0] ** 2 / 2 + ca.cos(x[0])


def varying_mass(t, x, v):
    return (1 + x[0] ** 2) * v[0] ** 2 / 2 - x[0] ** 2 / 2 - x[0] ** 4 / 4


def quartic(t, x, v):
    return v[0] ** 2 / 2 + v[0] ** 4 / 12 + ca.cos(x[0])


def kepler(t, x, v):
    return ca.dot(v, v) / 2 + 1 / ca.norm_2(x)


def double_pendulum(t, x, v):
    kinetic = v[0] ** 2 + v[1] ** 2 / 2 + v[0] * v[1] * ca.cos(x[0] - x[1])
    return kinetic + GRAVITY * (2 * ca.cos(x[0]) + ca.cos(x[1]))


def damped(t, x, v):
    return ca.exp(t / 2) * (v[0] ** 2 - 4 * x[0] ** 2) / 2


# Lagrangian, start, momentum at the start, a time step that resolves it
SCENES = {
    "pendulum": (pendulum, [2.0], [0.3], 0.2),
    "kepler": (kepler, [0.4, 0.0], [0.0, 2.0], 0.1),
    "double pendulum": (double_pendulum, [1.0, 1.2], [0.5, -0.2], 0.05),
    "varying mass in time": (lambda t, x, v: (2 + ca.sin(t)) * varying_mass(t, x, v) / 2, [0.7], [0.4], 0.2),
}


def start_of(scene, intervals):
    lagrangian, x, p, h = SCENES[scene]
    return cg.InitialProblem(lagrangian, (0, h * intervals), x, momentum=p)


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


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("degree", range(1, 9))
def test_steps_are_the_global_solution_between_the_same_ends(scene, degree):
    problem, method = start_of(scene, 4), cg.Galerkin(degree)
    stepped = cg.solve(problem, method, intervals=4)
    ends = cg.BoundaryProblem(problem.lagrangian, problem.t_span, stepped.x[:, 0], stepped.x[:, -1])
    whole = cg.solve(ends, method, intervals=4, guess=stepped)
    for ours, theirs in ((stepped.x, whole.x), (stepped.momentum, whole.momentum)):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=SAME * np.max(np.abs(theirs)))
    assert stepped.action == pytest.approx(whole.action, rel=SAME, abs=SAME)
    np.testing.assert_allclose(
        stepped.polynomial.values, whole.polynomial.values, rtol=0, atol=SAME * np.max(np.abs(whole.x))
    )


@pytest.mark.parametrize("rule", [cg.gauss(4), cg.gauss(6), cg.lobatto(4), cg.lobatto(5), cg.radau(5)], ids=str)
def test_steps_are_the_global_solution_whatever_the_quadrature(rule):
    problem, method = start_of("double pendulum", 5), cg.Galerkin(4, quadrature=rule)
    stepped = cg.solve(problem, method, intervals=5)
    ends = cg.BoundaryProblem(problem.lagrangian, problem.t_span, stepped.x[:, 0], stepped.x[:, -1])
    whole = cg.solve(ends, method, intervals=5, guess=stepped)
    np.testing.assert_allclose(stepped.momentum, whole.momentum, rtol=0, atol=SAME * np.max(np.abs(whole.momentum)))


def test_control_points_do_not_move_the_steps():
    problem = start_of("kepler", 10)
    lobatto, chebyshev = (
        cg.solve(problem, cg.Galerkin(6, control_points=points), intervals=10)
        for points in (cg.lobatto_points(6), cg.chebyshev_points(6))
    )
    np.testing.assert_array_equal(lobatto.x, chebyshev.x)
    times = np.linspace(0, 1, 37)
    np.testing.assert_allclose(lobatto(times), chebyshev(times), rtol=0, atol=SAME)


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


@pytest.mark.parametrize(
    ("lagrangian", "degree", "rule", "order", "counts"),
    [(lagrangian, *case) for lagrangian in (pendulum, varying_mass, quartic) for case in ORDERS] + HIGH_ORDERS,
)
def test_order_at_the_joints_is_that_of_the_global_solve(lagrangian, degree, rule, order, counts):
    problem = cg.InitialProblem(lagrangian, (0, 6), [0.7], momentum=[0.9])
    exact = cg.solve(problem, cg.Galerkin(10), intervals=60)
    errors = []
    for count in counts:
        path = cg.solve(problem, cg.Galerkin(degree, quadrature=rule), intervals=count)
        ends = [np.concatenate((each.x[:, -1], each.momentum[:, -1])) for each in (path, exact)]
        errors.append(np.max(np.abs(ends[0] - ends[1])))
    assert min(errors) > 2e-13  # a hundred times roundoff
    assert cg.Galerkin(degree, quadrature=rule).order == order
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] == pytest.approx(order, abs=0.2)


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("method", [cg.Galerkin(1), cg.Galerkin(4), cg.Galerkin(4, quadrature=cg.lobatto(4))], ids=str)
def test_steps_are_symplectic(scene, method):
    problem = start_of(scene, 30)
    measured = cg.geometry(cg.solve(problem, method, intervals=30))
    assert np.max(measured.symplecticity_defects) <= 1e-12
    np.testing.assert_allclose(measured.determinants, 1, rtol=0, atol=1e-12)


@pytest.mark.parametrize("scene", SCENES)
def test_jacobian_of_a_step_is_its_derivative(scene):
    lagrangian, x, p, h = SCENES[scene]
    problem, start, d = start_of(scene, 1), np.array(x + p), len(x)
    jacobian = cg.geometry(cg.solve(problem, cg.Galerkin(3), intervals=1)).jacobians[0]

    def step(state):
        path = cg.solve(cg.InitialProblem(lagrangian, (0, h), state[:d], momentum=state[d:]), cg.Galerkin(3), 1)
        return np.concatenate((path.x[:, -1], path.momentum[:, -1]))

    difference = 1e-5
    columns = [(step(start + e) - step(start - e)) / (2 * difference) for e in difference * np.eye(2 * d)]
    np.testing.assert_allclose(jacobian, np.transpose(columns), rtol=0, atol=1e-7)  # the difference's own error


@pytest.mark.parametrize("scene", ["pendulum", "kepler", "double pendulum"])
def test_steps_of_a_reversible_lagrangian_run_back_to_their_start(scene):
    lagrangian, x, p, h = SCENES[scene]
    mesh = np.concatenate(([0], np.cumsum(h * np.linspace(0.5, 1.5, 40))))
    problem = cg.InitialProblem(lagrangian, (0, mesh[-1]), x, momentum=p)
    there = cg.solve(problem, cg.Galerkin(5), mesh=mesh)
    problem = cg.InitialProblem(lagrangian, (0, mesh[-1]), there.x[:, -1], momentum=-there.momentum[:, -1])
    back = cg.solve(problem, cg.Galerkin(5), mesh=np.clip((mesh[-1] - mesh)[::-1], 0, mesh[-1]))
    growth = 1e3  # of rounding along 40 steps there and back, measured 10 to 100
    np.testing.assert_allclose(back.x[:, ::-1], there.x, rtol=0, atol=growth * 2.3e-16 * np.max(np.abs(there.x)))


def test_angular_momentum_does_not_drift_in_1e5_steps_of_kepler_and_energy_stays_in_its_band():
    problem = cg.InitialProblem(kepler, (0, 2000 * np.pi), [0.4, 0.0], velocity=[0.0, 2.0])
    path = cg.solve(problem, cg.Galerkin(4), intervals=100_000)
    (x, y), (px, py) = path.x, path.momentum
    assert np.max(np.abs(x * py - y * px - 0.8)) <= 1e-12
    energy = (px**2 + py**2) / 2 - 1 / np.hypot(x, y) + 0.5
    bands = np.max(np.abs(energy[1:].reshape(10, -1)), axis=1)  # of every 100 revolutions
    assert bands[0] < 1e-10
    np.testing.assert_allclose(bands, bands[0], rtol=0, atol=1e-12)


def test_linear_momentum_of_a_free_system_stays_within_a_random_walk_of_roundoff():
    def springs(t, x, v):
        return ca.dot(v, v) / 2 - (x[0] - x[1]) ** 2 / 2 - (x[1] - x[2]) ** 4 / 4

    problem = cg.InitialProblem(springs, (0, 2000), [0.0, 1.0, 3.0], velocity=[1.0, 0.0, -0.3])
    path = cg.solve(problem, cg.Galerkin(3), intervals=20_000)
    total = path.momentum.sum(axis=0)
    assert np.max(np.abs(total - total[0])) <= 2e-16 * np.sqrt(20_000) * 10


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


def test_friction_shrinks_every_step_by_the_same_factor():
    problem = cg.InitialProblem(oscillator, (0, 3), [1.0], momentum=[0.0], force=lambda t, x, v: -0.4 * v)
    measured = cg.geometry(cg.solve(problem, cg.Galerkin(6), intervals=10))
    np.testing.assert_allclose(measured.determinants, np.exp(-0.4 * 0.3), rtol=1e-13)


def test_a_lagrangian_that_depends_on_time_reaches_its_exact_end():
    problem = cg.InitialProblem(damped, (0, 1), [1.0], velocity=[0.62075482816197670])
    path = cg.solve(problem, cg.Galerkin(8), intervals=8)
    assert path.x[0, -1] == pytest.approx(0, abs=2e-15)
    assert path(0.5)[0] == pytest.approx(0.80683882876568644, abs=2e-15)


@pytest.mark.parametrize("intervals", [1, 2, PIECE, PIECE + 1, 2 * PIECE + 3])
def test_any_number_of_steps_is_the_same_as_one_after_the_other(intervals):
    mesh = np.cumsum(np.append(0, np.linspace(0.02, 0.06, intervals)))
    whole = cg.solve(cg.InitialProblem(pendulum, (0, mesh[-1]), [2.0], [0.3]), cg.Galerkin(3), mesh=mesh)
    half = (intervals + 1) // 2
    first = cg.solve(cg.InitialProblem(pendulum, (0, mesh[half]), [2.0], [0.3]), cg.Galerkin(3), mesh=mesh[: half + 1])
    np.testing.assert_array_equal(first.x, whole.x[:, : half + 1])
    if half < intervals:
        rest = cg.InitialProblem(pendulum, (mesh[half], mesh[-1]), first.x[:, -1], first.momentum[:, -1])
        second = cg.solve(rest, cg.Galerkin(3), mesh=mesh[half:])
        np.testing.assert_allclose(second.x, whole.x[:, half:], rtol=0, atol=SAME)
    assert whole.polynomial.values.shape == (1, 3 * intervals + 1)
    assert whole.polynomial.values[0, ::3].tolist() == whole.x[0].tolist()


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


@pytest.mark.parametrize("frequency", [1e-8, 1.0, 1e4, 1e8])
def test_steps_of_any_stiffness_are_stable(frequency):
    problem = cg.InitialProblem(
        lambda t, x, v: v[0] ** 2 / 2 - frequency**2 * x[0] ** 2 / 2, (0, 100), [1.0], velocity=[0.0]
    )
    path = cg.solve(problem, cg.Galerkin(4), intervals=100)
    energy = (path.momentum[0] ** 2 + frequency**2 * path.x[0] ** 2) / frequency**2
    np.testing.assert_allclose(energy, 1, rtol=1e-10)  # Gauss methods conserve quadratic invariants


def test_large_steps_of_a_chaotic_motion_are_solved():
    # predictions of a higher degree led some of these steps to other solutions, and then to none
    problem = cg.InitialProblem(double_pendulum, (0, 20), [2.0, 2.5], velocity=[0.0, 0.0])
    for degree, intervals, error in ((4, 250, 1.0), (6, 200, 0.1), (8, 200, 1e-2)):
        path = cg.solve(problem, cg.Galerkin(degree), intervals)
        assert np.ptp(path.energy) < error


def test_steps_far_too_large_fail_instead_of_ending_in_zeros():
    # CasADi abandons an evaluation at a matrix that its QR calls singular, and leaves zeros behind
    problem = cg.InitialProblem(double_pendulum, (0, 40), [2.0, 2.5], velocity=[0.0, 0.0])
    with pytest.raises(cg.ConvergenceError, match=r"of 100, from t = .* was not solved"):
        cg.solve(problem, cg.Galerkin(6), intervals=100)


@pytest.mark.parametrize("scale", [1e-12, 1e12])
def test_units_do_not_matter(scale):
    unit = cg.solve(cg.InitialProblem(kepler, (0, 3), [0.4, 0.0], velocity=[0.0, 2.0]), cg.Galerkin(5), 30)
    scaled = cg.InitialProblem(
        lambda t, x, v: ca.dot(v, v) / 2 + scale**3 / ca.norm_2(x), (0, 3), [0.4 * scale, 0], velocity=[0, 2 * scale]
    )
    np.testing.assert_allclose(cg.solve(scaled, cg.Galerkin(5), 30).x / scale, unit.x, rtol=0, atol=SAME)


@pytest.mark.parametrize("degree", [20, 40])
def test_high_degrees_step_to_roundoff(degree):
    problem = cg.InitialProblem(pendulum, (0, 10), [2.0], velocity=[0.3])
    high = cg.solve(problem, cg.Galerkin(degree), intervals=4)
    low = cg.solve(problem, cg.Galerkin(8), intervals=100)
    np.testing.assert_allclose(high.x, low.x[:, ::25], rtol=0, atol=2e-13)  # 10 units of time magnify rounding


def test_a_body_at_rest_in_equilibrium_stays_there():
    path = cg.solve(cg.InitialProblem(pendulum, (0, 10), [0.0], velocity=[0.0]), cg.Galerkin(3), intervals=10)
    assert not path.x.any()


def test_a_trajectory_of_steps_has_no_morse_index_and_says_what_it_is(capsys):
    path = cg.solve(start_of("pendulum", 5), cg.Galerkin(3), intervals=5, verbose=1)
    assert path.morse_index is None
    assert path.residual < 10
    assert "no Morse index" in capsys.readouterr().out


def test_a_collision_names_the_step_and_its_time_and_keeps_the_path_before_it():
    problem = cg.InitialProblem(kepler, (0, 2), [1.0, 0.0], velocity=[0.0, 0.0])  # falls in at t = π / √8 = 1.11
    with pytest.raises(cg.ConvergenceError, match=r"step 56 of 100, from t = 1.1 to 1.12, was not solved") as caught:
        cg.solve(problem, cg.Galerkin(4), intervals=100)
    assert caught.value.path.t[-1] == pytest.approx(1.1)
    assert not caught.value.residual <= 50


def test_a_start_on_the_singularity_fails_in_its_first_step():
    problem = cg.InitialProblem(kepler, (0, 2), [0.0, 0.0], velocity=[1.0, 0.0])
    with pytest.raises(cg.ConvergenceError, match=r"step 1 of 5, from t = 0 to 0\.4") as caught:
        cg.solve(problem, cg.Galerkin(4), intervals=5)
    assert caught.value.path is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({}, "give either momentum or velocity, got momentum=None and velocity=None"),
        ({"momentum": [1.0], "velocity": [1.0]}, r"got momentum=\[1.0\] and velocity=\[1.0\]"),
        ({"momentum": [1.0, 2.0]}, r"momentum must have 1 component\(s\), got 2"),
        ({"velocity": [1.0, 2.0]}, r"velocity must have 1 component\(s\), got 2"),
        ({"momentum": [None]}, "momentum must be all numbers"),
        ({"position": [np.nan], "momentum": [1.0]}, r"position\[0\] must be finite"),
        ({"momentum": [1.0], "t_span": (1, 0)}, "t_span must increase"),
        ({"momentum": [1.0], "force": lambda t, x, v: [1, 2]}, "force must return a vector of length 1, got shape"),
        (
            {"momentum": [1.0], "force": lambda t, x, v: ca.vertcat(v, v)},
            "force must return a vector of length 1, got shape",
        ),
    ],
)
def test_bad_input_is_named(changes, message):
    given = {"lagrangian": pendulum, "t_span": (0, 1), "position": [1.0]} | changes
    with pytest.raises(ValueError, match=message):
        cg.InitialProblem(**given)


def test_a_force_of_the_wrong_length_is_named():
    with pytest.raises(ValueError, match=r"force must return a vector of length 2, got shape \(1, 1\)"):
        cg.InitialProblem(kepler, (0, 1), [1.0, 0], velocity=[0, 1.0], force=lambda t, x, v: [1])


def test_a_force_that_is_no_callable_is_named():
    with pytest.raises(TypeError, match="force must be a callable"):
        cg.InitialProblem(pendulum, (0, 1), [1.0], velocity=[0.0], force=3.0)


@pytest.mark.parametrize("start", [{"momentum": [1.0, 2.0]}, {"velocity": [1.0, 2.0]}])
def test_a_degenerate_lagrangian_is_refused_before_any_step(start):
    problem = cg.InitialProblem(lambda t, x, v: (v[0] + v[1]) ** 2 / 2 - x[0] ** 2, (0, 1), [0.5, 1.0], **start)
    with pytest.raises(ValueError, match=r"degenerate: its mass matrix .* is singular at the start"):
        cg.solve(problem, cg.Galerkin(3), intervals=5)


def test_a_mass_matrix_of_mixed_units_is_not_taken_for_singular():
    problem = cg.InitialProblem(
        lambda t, x, v: 1e12 * v[0] ** 2 + 1e-12 * v[1] ** 2, (0, 1), [0.0, 0.0], velocity=[1, 2]
    )
    path = cg.solve(problem, cg.Galerkin(2), intervals=3)
    np.testing.assert_allclose(path.x[:, -1], [1, 2], rtol=1e-14)


def test_a_momentum_that_no_velocity_has_is_refused():
    problem = cg.InitialProblem(lambda t, x, v: ca.sqrt(1 + v[0] ** 2), (0, 1), [0.5], momentum=[1.5])
    with pytest.raises(ValueError, match=r"degenerate|no velocity was found"):
        cg.solve(problem, cg.Galerkin(3), intervals=5)


def test_an_initial_problem_takes_a_method_and_no_guess_solver_or_tolerance():
    problem = start_of("pendulum", 5)
    for option in ({"guess": lambda t: [0.0]}, {"solver": cg.ipopt}, {"tol": 1e-6}):
        with pytest.raises(ValueError, match="takes no tol, limits, guess or solver"):
            cg.solve(problem, cg.Galerkin(3), intervals=5, **option)
    with pytest.raises(TypeError, match="method must be a Galerkin"):
        cg.solve(problem, 3, intervals=5)
    with pytest.raises(ValueError, match="got no method"):
        cg.solve(problem, intervals=5)
    with pytest.raises(ValueError, match="give either intervals or mesh"):
        cg.solve(problem, cg.Galerkin(3))
