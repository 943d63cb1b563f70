"""Boundary problems solved: every case of the table, guesses, engines, repeated solves, scaling, honest failure."""

import casadi as ca
import numpy as np
import pytest
from scenes import BY_NAME, SCENES, TROESCH, bratu, catenoid, kepler, oscillator, pendulum

import casadi_galerkin as cg
from casadi_galerkin.boundary.transcription import Transcription
from casadi_galerkin.calculus.roundoff import ZERO
from casadi_galerkin.problems.legendre_transform import legendre_transform
from casadi_galerkin.problems.legendre_transform import velocities as velocities_of_momenta
from casadi_galerkin.solvers.solver import newton

CLOSED_FORM = 1e-13  # relative to the largest value along the path
# Measured roundoff where double precision does not allow 1e-13: condition numbers of the problems themselves.
CONDITION = {
    "oscillator 10.0": 3e-13,
    "Bratu 1.0 upper": 1e-12,
}
MOMENTUM = 50  # momenta lose a factor |x|/(h |v|) in the differences of positions


def solve(scene, **options):
    return cg.solve(scene.problem, cg.Galerkin(scene.degree), mesh=scene.joints, guess=scene.guess, **options)


def velocities(path):
    """At the ends, by the Legendre transform."""
    return path.velocity[:, 0], path.velocity[:, -1]


@pytest.fixture(scope="module")
def solved():
    return {scene.name: solve(scene) for scene in SCENES}


@pytest.mark.parametrize("scene", [s for s in SCENES if s.path], ids=lambda s: s.name)
def test_closed_form_is_reproduced_between_the_joints(scene, solved):
    t = ca.SX.sym("t")
    exact = ca.Function("exact", [t], [ca.vertcat(*scene.path(t))])
    times = np.sort(np.concatenate((scene.joints, np.random.default_rng(3).uniform(*scene.t_span, 200))))
    wanted = np.array(exact(times[None, :]))
    tolerance = CONDITION.get(scene.name, CLOSED_FORM)
    for got, values in zip(solved[scene.name](times), wanted, strict=True):
        np.testing.assert_allclose(got, values, rtol=0, atol=tolerance * max(1, np.max(np.abs(values))))


@pytest.mark.parametrize("scene", SCENES, ids=lambda s: s.name)
def test_known_numbers_and_morse_index(scene, solved):
    path = solved[scene.name]
    tolerance = max(scene.digits, CONDITION.get(scene.name, 0))
    assert path.morse_index == scene.index
    if scene.action is not None:
        assert path.action == pytest.approx(scene.action, rel=tolerance, abs=tolerance)
    size = np.max(np.abs(velocities(path)))
    for got, known in zip(velocities(path), scene.velocities, strict=True):
        if known is not None:
            np.testing.assert_allclose(got, known, rtol=0, atol=MOMENTUM * tolerance * size)
    for time, x in scene.values.items():
        np.testing.assert_allclose(path(time), x, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("scene", [s for s in SCENES if s.conserved], ids=lambda s: s.name)
def test_first_integral_is_the_same_at_all_joints(scene, solved):
    path, d = solved[scene.name], len(scene.start)
    t, x, v = ca.SX.sym("t"), ca.SX.sym("x", d), ca.SX.sym("v", d)
    integral = ca.Function("integral", [t, x, v], [scene.conserved(t, x, v)])
    values = np.array(integral(path.t[None, :], path.x, path.velocity)).ravel()
    energy = path.energy
    size = np.max(np.abs(values)) + np.max(np.sum(np.abs(path.momentum * path.velocity), axis=0))
    assert np.ptp(values) < 2e-12 * size
    if scene.conserved.__name__ == "<lambda>" and scene.name not in ("great circle", "brachistochrone"):
        np.testing.assert_allclose(energy, values, rtol=0, atol=1e-13 * size)


@pytest.mark.parametrize("scene", SCENES, ids=lambda s: s.name)
def test_answers_are_verified_and_reported(scene, solved):
    path = solved[scene.name]
    assert path.residual <= 50
    assert 1 <= path.iterations <= 100
    assert path.solver in ("Newton", "IPOPT, then Newton", "IPOPT on the action, then Newton")
    text = str(path)
    assert f"{path.action:.15g}" in text
    assert ("minimum" in text) == (scene.index == 0)
    assert (path.t.shape, path.x.shape) == ((len(scene.joints),), (len(scene.start), len(scene.joints)))


@pytest.mark.parametrize("scene", [s for s in SCENES if s.guess is None], ids=lambda s: s.name)
def test_newton_alone_solves_the_scene_from_the_straight_line(scene, solved):
    assert solved[scene.name].solver == "Newton"


@pytest.mark.parametrize("rate", list(TROESCH))
def test_troeschs_layers_are_resolved_at_both_ends(rate, solved):
    """Relative to each end's own velocity, which at λ = 50 are 1.5e-21 and 7.2e10."""
    got = np.concatenate(velocities(solved[f"Troesch {rate:g}"]))
    np.testing.assert_allclose(got, TROESCH[rate], rtol=5e-11, atol=0)


@pytest.mark.parametrize(("T", "index"), [(3.0, 0), (3.2, 1), (6.2, 1), (6.4, 2), (20.0, 6), (50.0, 15)])
def test_morse_index_of_the_oscillator_counts_the_conjugate_points(T, index):
    path = cg.solve(cg.BoundaryProblem(oscillator, (0, T), [0.0], [1.0]), cg.Galerkin(6), intervals=40)
    assert path.morse_index == index == int(T // np.pi)


@pytest.mark.parametrize("name", ["oscillator 7.0", "long pendulum, index 2", "Bratu 3.0 upper", "charged particle"])
def test_morse_index_is_the_inertia_of_the_dense_hessian(name):
    scene = BY_NAME[name]
    tr = cg.transcribe(scene.problem, cg.Galerkin(4), 16)
    path = tr.solve(guess=scene.guess)
    unknowns = path.polynomial.values.T[1:-1].ravel()
    hessian = np.array(ca.DM(tr.hessian(unknowns, scene.start, scene.end, tr.mesh)))
    assert np.count_nonzero(np.linalg.eigvalsh(hessian) < 0) == path.morse_index


def test_indefinite_kinetic_energy_has_no_morse_index():
    """L = v_0 v_1 - x_0 x_1: each component is an oscillator, the index grows without bound with the mesh."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] * v[1] - x[0] * x[1], (0, 1), [0, 0], [1, 2])
    path = cg.solve(problem, cg.Galerkin(8), intervals=4)
    np.testing.assert_allclose(path.x, np.outer([1, 2], np.sin(path.t) / np.sin(1)), rtol=0, atol=CLOSED_FORM)
    assert path.morse_index is None
    assert "no Morse index" in str(path)


@pytest.mark.parametrize(("coupling", "second"), [(0.0, -1.0), (2.0, 1.0)])
def test_kinetic_energy_indefinite_by_its_values_has_no_morse_index(coupling, second):
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 + coupling * v[0] * v[1] + second * v[1] ** 2 / 2, (0, 1), [0, 0], [1, 2]
    )
    path = cg.solve(problem, cg.Galerkin(2), intervals=5)
    assert path.morse_index is None
    assert "no Morse index" in str(path)


def test_velocities_are_found_where_the_slopes_of_the_path_are_beyond_the_lagrangians_domain():
    """A relativistic particle on few intervals: the derivative of the polynomial exceeds 1 at a joint."""
    problem = cg.BoundaryProblem(lambda t, x, v: -ca.sqrt(1 - v[0] ** 2) - 5 * x[0] ** 2, (0, 2), [0.0], [1.2])
    path = cg.solve(problem, cg.Galerkin(2), intervals=4)
    assert np.max(np.abs(path(path.t, 1))) > 1
    np.testing.assert_allclose(path.velocity, path.momentum / np.sqrt(1 + path.momentum**2), rtol=1e-14)
    assert np.isfinite(path.energy).all()


def test_a_velocity_that_does_not_exist_is_not_a_number():
    t, x, v = (ca.SX.sym(name) for name in "txv")
    lagrangian = ca.Function("L", [t, x, v], [ca.sqrt(1 + v**2)])  # momenta lie within ]-1, 1[
    momenta = np.array([[0.5, 2.0, -0.5]])
    found = velocities_of_momenta(
        legendre_transform(lagrangian), np.zeros(3), np.zeros((1, 3)), momenta, np.full((1, 3), 30.0)
    )
    np.testing.assert_allclose(found, [[1 / np.sqrt(3), np.nan, -1 / np.sqrt(3)]], rtol=1e-14)


# natural ends, periodic paths, parameters


def test_natural_end_has_zero_momentum():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] * v[0] + x[0] ** 4, (0, 0.5), [None], [1.0])
    path = cg.solve(problem, cg.Galerkin(6), intervals=8)
    assert abs(path.momentum[0, 0]) < 1e-13
    assert path.velocity[0, 0] == pytest.approx(path.x[0, 0], abs=1e-12)  # p = v - x


@pytest.mark.parametrize("intervals", [1, 2, 6])
def test_periodic_forcing_of_an_oscillator_has_its_exact_answer(intervals):
    """x'' = -2 x + cos t has the one periodic solution cos t."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 + x[0] * ca.cos(t), (0, 2 * np.pi), [None], periodic=True
    )
    path = cg.solve(problem, cg.Galerkin(24 if intervals < 3 else 14), intervals=intervals)
    t = np.linspace(0, 2 * np.pi, 101)
    np.testing.assert_allclose(path(t)[0], np.cos(t), rtol=0, atol=5 * CLOSED_FORM)
    assert path.x[0, 0] == path.x[0, -1]
    assert path.momentum[0, 0] == pytest.approx(path.momentum[0, -1], abs=1e-12)


def test_periodic_guess_that_is_not_closed_counts_with_its_first_value():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2, (0, 1), [None], periodic=True)
    tr = cg.transcribe(problem, cg.Galerkin(2), 3)
    np.testing.assert_array_equal(tr.unknowns(np.arange(7.0)[:, None]), np.arange(6.0))


@pytest.mark.parametrize("degree", [1, 4, 8])
def test_a_component_that_vanishes_is_found_from_a_guess_where_it_does_not(degree):
    """Every Newton step takes 16 digits off what is left of it, which relative to itself never is at roundoff."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), [None], [None])
    path = cg.solve(problem, cg.Galerkin(degree), 4, guess=lambda t: [np.sin(t)])
    assert np.abs(path.polynomial.values).max() < ZERO
    assert path.solver == "Newton"


def test_periodic_path_through_a_fixed_point_has_a_kink_in_momentum_there():
    """With x(0) = x(T) = 1 given, the momenta need not agree: x = cosh(t - T/2)/cosh(T/2)."""
    problem = cg.BoundaryProblem(lambda t, x, v: (v[0] ** 2 + x[0] ** 2) / 2, (0, 2.0), [1.0], periodic=True)
    path = cg.solve(problem, cg.Galerkin(10), intervals=4)
    np.testing.assert_allclose(path.x[0], np.cosh(path.t - 1) / np.cosh(1), rtol=CLOSED_FORM)
    np.testing.assert_allclose(path.momentum[0, [0, -1]], [-np.tanh(1), np.tanh(1)], rtol=1e-12)


@pytest.mark.parametrize("solver", [cg.newton, cg.rootfinder, cg.ipopt])
def test_the_one_periodic_path_is_found_although_the_hessian_is_singular_at_the_guess(solver):
    """x'' = x³ - cos³t - cos t and y'' = -2 y + cos t have one periodic path, x = y = cos t, a saddle.

    At 0, where the search begins, the Hessian by x is that of a free periodic particle, which may stand anywhere.
    """
    problem = cg.BoundaryProblem(
        lambda t, x, v: (
            ca.dot(v, v) / 2 + x[0] ** 4 / 4 - x[1] ** 2 - (ca.cos(t) ** 3 + ca.cos(t)) * x[0] + ca.cos(t) * x[1]
        ),
        (0, 2 * np.pi),
        [None, None],
        periodic=True,
    )
    tr = cg.transcribe(problem, cg.Galerkin(16), 8)
    zero = np.zeros(tr.gradient.size1_in(0))
    hessian = np.array(ca.DM(tr.hessian(zero, [], [], tr.mesh)))
    sizes = np.abs(np.linalg.eigvalsh(hessian))
    assert np.min(sizes) < 1e-14 * np.max(sizes)  # the first step of Newton's method leads nowhere
    path = tr.solve(solver=solver)
    t = np.linspace(0, 2 * np.pi, 101)
    np.testing.assert_allclose(path(t), np.stack((np.cos(t), np.cos(t))), rtol=0, atol=CLOSED_FORM)
    assert path.morse_index == 3  # y = 1, cos t and sin t lower the action, whatever x does


def spring(t, x, v, p):
    return v[0] ** 2 / 2 - p[0] ** 2 * x[0] ** 2 / 2 + p[1] * x[0]


def test_parameters_enter_and_change():
    problem = cg.BoundaryProblem(spring, (0, 1), [0.0], [1.0], parameters=[2.0, 0.0])
    tr = cg.transcribe(problem, cg.Galerkin(10), 6)
    for rate, force in ((2.0, 0.0), (1.3, 4.0)):
        path = tr.solve(parameters=[rate, force])
        shift = force / rate**2
        t = path.t
        exact = shift * (1 - np.cos(rate * t)) + (1 - shift * (1 - np.cos(rate))) * np.sin(rate * t) / np.sin(rate)
        np.testing.assert_allclose(path.x[0], exact, rtol=0, atol=CLOSED_FORM)
        assert path.parameters == (rate, force)
        np.testing.assert_allclose(path.energy, path.energy[0], rtol=1e-12)
    np.testing.assert_array_equal(tr.solve().x, tr.solve(parameters=[2.0, 0.0]).x)


# repeated solves, guesses, engines


def test_a_path_knows_the_problem_it_solves():
    problem = cg.BoundaryProblem(spring, (0, 1), [0.0], [None], parameters=[2.0, 0.0])
    path = cg.transcribe(problem, cg.Galerkin(4), 3).solve([0.5], [None], [1.5, 0.1], mesh=[1.0, 1.2, 1.5, 2.0])
    asked = (path.problem.t_span, path.problem.start, path.problem.end, path.problem.parameters)
    assert asked == ((1.0, 2.0), (0.5,), (None,), (1.5, 0.1))
    again = cg.solve(path.problem, cg.Galerkin(4), mesh=path.t)
    np.testing.assert_array_equal(again.x, path.x)
    assert path.lagrangian is problem.lagrangian
    assert (problem.start, problem.parameters) == ((0.0,), (2.0, 0.0))


def test_repeated_solves_equal_fresh_ones():
    tr = cg.transcribe(cg.BoundaryProblem(spring, (0, 1), [0.0], [1.0], [2.0, 0.0]), cg.Galerkin(5), 6)
    graded = np.linspace(0, 1, 7) ** 1.5
    later = np.linspace(2.0, 2.8, 7)
    variations = [
        {"start": [0.3], "end": [-2.0]},
        {"parameters": [1.0, 5.0]},
        {"mesh": graded},
        {"mesh": later, "start": [1.0]},
        {},
    ]
    for change in variations:
        mesh = change.get("mesh", np.linspace(0, 1, 7))
        problem = cg.BoundaryProblem(
            spring,
            (mesh[0], mesh[-1]),
            change.get("start", [0.0]),
            change.get("end", [1.0]),
            change.get("parameters", [2.0, 0.0]),
        )
        again, fresh = tr.solve(**change), cg.solve(problem, cg.Galerkin(5), mesh=mesh)
        np.testing.assert_array_equal(again.polynomial.values, fresh.polynomial.values)
        np.testing.assert_array_equal(again.momentum, fresh.momentum)
        np.testing.assert_array_equal(again.t, fresh.t)
        assert (again.action, again.iterations, again.morse_index) == (fresh.action, fresh.iterations, 0)


def test_a_problem_is_not_changed_by_solving_it():
    scene = BY_NAME["short pendulum"]
    tr = cg.transcribe(scene.problem, cg.Galerkin(4), 5)
    first = tr.solve()
    tr.solve(start=[0.5], end=[2.0])
    np.testing.assert_array_equal(tr.solve().polynomial.values, first.polynomial.values)


def test_guesses_of_every_kind_lead_to_the_path_they_are_near():
    scene = BY_NAME["long pendulum, index 1"]
    tr = cg.transcribe(scene.problem, cg.Galerkin(6), 30)
    wanted = tr.solve(guess=scene.guess)
    assert wanted.morse_index == 1
    coarse = cg.solve(scene.problem, cg.Galerkin(3), intervals=25, guess=scene.guess)
    joints = np.stack([scene.guess(t) for t in wanted.t], axis=1)
    nodes = np.stack([scene.guess(t) for t in cg.DiscreteCalculus(tr.method, tr.mesh).node_times], axis=1)
    guesses = [joints, joints.tolist(), nodes, wanted, wanted.polynomial, coarse, lambda t: np.array(scene.guess(t))]
    for guess in guesses:
        path = tr.solve(guess=guess)
        assert path.action == pytest.approx(wanted.action, rel=1e-13)
        np.testing.assert_allclose(path.x, wanted.x, rtol=0, atol=1e-12)
    assert tr.solve(guess=wanted).iterations == 1


def test_a_guess_on_another_time_span_is_stretched():
    short = cg.solve(cg.BoundaryProblem(pendulum, (0, 9.9), [0.0], [1.0]), cg.Galerkin(6), intervals=30)
    path = cg.solve(cg.BoundaryProblem(pendulum, (0, 10.0), [0.0], [1.0]), cg.Galerkin(6), intervals=30, guess=short)
    assert path.morse_index == short.morse_index
    assert path.action == pytest.approx(short.action, rel=0.05)


def test_a_guess_that_misses_the_ends_is_bent_to_them():
    problem = cg.BoundaryProblem(oscillator, (0, 1), [0.0], [1.0])
    path = cg.solve(problem, cg.Galerkin(8), intervals=4, guess=lambda t: [7.0 + 3 * t])
    assert path.x[0, 0] == 0
    assert path.x[0, -1] == 1


@pytest.mark.parametrize("name", ["short pendulum", "Bratu 3.0 lower", "catenoid, index 0", "natural end", "Lambert"])
def test_three_engines_agree(name, solved):
    scene = BY_NAME[name]
    for engine, report in ((cg.ipopt, "IPOPT, then Newton"), (cg.minimizer, "IPOPT on the action, then Newton")):
        path = solve(scene, solver=engine)
        assert path.solver == report
        size = np.max(np.abs(path.x))
        np.testing.assert_allclose(
            path.polynomial.values, solved[name].polynomial.values, rtol=0, atol=CLOSED_FORM * size
        )


def test_the_minimizer_finds_the_minimum_where_newton_finds_a_saddle():
    problem = BY_NAME["long pendulum, index 0"].problem
    newton = cg.solve(problem, cg.Galerkin(8), intervals=30)
    least = cg.solve(problem, cg.Galerkin(8), intervals=30, solver=cg.minimizer)
    assert newton.morse_index > 0
    assert least.morse_index == 0
    assert least.action == pytest.approx(-3.918564307581, abs=1e-9)


def test_minimising_past_the_conjugate_point_fails_while_the_path_exists():
    problem = cg.BoundaryProblem(oscillator, (0, 4.0), [0.0], [1.0])
    with pytest.raises(cg.ConvergenceError, match=r"no minimum \(Morse index 1\)|IPOPT on the action stopped with"):
        cg.solve(problem, cg.Galerkin(4), intervals=10, solver=cg.minimizer)
    assert cg.solve(problem, cg.Galerkin(4), intervals=10).morse_index == 1


@pytest.mark.parametrize(("T", "end"), [(10, 3.0), (15, 6.0), (20, 10.0), (50, 3.0)])
def test_large_swings_are_rescued_and_the_report_says_so(T, end):
    path = cg.solve(cg.BoundaryProblem(pendulum, (0, T), [0.0], [end]), cg.Galerkin(4), intervals=4 * T)
    assert path.solver == "IPOPT on the action, then Newton"
    assert path.morse_index == 0
    assert path.residual <= 50


def test_one_component_does_not_end_the_iterations_of_another():
    """A first step that corrects a linear component by much says nothing about a nonlinear one."""

    def lagrangian(t, x, v):
        return ca.dot(v, v) / 2 - x[0] ** 2 / 2 + ca.exp(3 * x[1])

    tr = cg.transcribe(cg.BoundaryProblem(lagrangian, (0, 1), [1.0, 0.0], [2.0, 0.5]), cg.Galerkin(6), 20)
    path = tr.solve()
    s = np.linspace(0, np.pi, path.polynomial.values.shape[1])
    miss = np.array([0.28 * np.sin(s), 1e-3 * np.sin(2 * s)])
    again = tr.solve(guess=path.polynomial.values + miss)
    assert np.max(np.abs(again.polynomial.values - path.polynomial.values)) < 1e-14


def test_components_that_vanish_along_a_periodic_path_are_found_from_afar():
    """Newton's steps shrink them below the least number there is; they are then zero, whatever the last step's size."""

    def lagrangian(t, x, v):
        square = ca.dot(x, x)
        return ca.dot(v, v) / 2 * (1 + square) + 300 * square / 2 + ca.sumsqr(x**2) + 0.8 * ca.sin(2 * t) * x[0]

    free = [None] * 4
    problem = cg.BoundaryProblem(lagrangian, (0, 2 * np.pi), free, free, periodic=True)
    path = cg.solve(problem, cg.Galerkin(8), intervals=8, guess=lambda t: np.sin(t / 2 * np.arange(1, 5)))
    assert np.max(np.abs(path.x[1:])) < 1e-100
    assert path.morse_index == 0


# conjugate points and problems without a path


@pytest.mark.parametrize("intervals", [5, 20])
@pytest.mark.parametrize("degree", [6, 8, 12])
def test_conjugate_ends_are_named(degree, intervals):
    """At T = π, to within a discretisation error that is at roundoff."""
    with pytest.raises(cg.ConjugatePointError, match="conjugate points") as caught:
        cg.solve(cg.BoundaryProblem(oscillator, (0, np.pi), [0.0], [1.0]), cg.Galerkin(degree), intervals=intervals)
    assert caught.value.path is not None


@pytest.mark.parametrize("offset", [-1e-6, 1e-6])
@pytest.mark.parametrize(("degree", "intervals"), [(4, 50), (6, 10), (8, 5), (8, 50), (12, 5)])
def test_nearly_conjugate_ends_are_solved(degree, intervals, offset):
    T = np.pi + offset
    path = cg.solve(cg.BoundaryProblem(oscillator, (0, T), [0.0], [1.0]), cg.Galerkin(degree), intervals=intervals)
    assert path.morse_index == (offset > 0)
    assert path.momentum[0, 0] == pytest.approx(1 / np.sin(T), rel=1e-5)
    assert path.solver == "Newton"


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("intervals", [4, 8])
def test_coarse_methods_are_singular_at_a_conjugate_point_of_their_own(degree, intervals):
    """It is found by bisection of the Morse index, and lies as far from π as the method's order says."""

    def index(T):
        tr = cg.transcribe(cg.BoundaryProblem(oscillator, (0, T), [0.0], [1.0]), cg.Galerkin(degree), intervals)
        size = tr.hessian.size1_in(0)
        hessian = np.array(ca.DM(tr.hessian(np.zeros(size), [0.0], [1.0], tr.mesh)))
        return np.count_nonzero(np.linalg.eigvalsh(hessian) < 0)

    low, high = 2.8, 3.6
    assert (index(low), index(high)) == (0, 1)
    while high - low > 1e-15 * high and low < (low + high) / 2 < high:
        middle = (low + high) / 2
        low, high = (middle, high) if index(middle) == 0 else (low, middle)
    h = np.pi / intervals
    assert abs(low - np.pi) <= h ** (2 * degree) + 1e-12
    with pytest.raises(cg.ConjugatePointError):
        cg.solve(cg.BoundaryProblem(oscillator, (0, low), [0.0], [1.0]), cg.Galerkin(degree), intervals=intervals)


def named(problem, degree, intervals, guess=None):
    """Whether a problem that must not be solved is refused as singular, and not merely as unsolved."""
    with pytest.raises(cg.ConvergenceError) as caught:
        cg.solve(problem, cg.Galerkin(degree), intervals=intervals, guess=guess)
    return isinstance(caught.value, cg.ConjugatePointError)


# Steps along a family are roundoff that does not shrink.  Which of the cases are named hangs on its last digits: with
# CasADi 3.8.0 and 3.8.2 it is not the same ones.


def test_a_family_of_paths_is_refused_and_mostly_named_whatever_else_moves_and_in_whatever_unit():
    """One component swings half a period."""
    cases = [(4, 40, 1e-6, 1e12), (8, 10, 1e-4, 1e8), (4, 40, 1e4, 1.0), (4, 40, 1e9, 1.0), (4, 40, 1.0, 1e-7)]

    def problem(scale, mass):
        return cg.BoundaryProblem(
            lambda t, x, v: v[0] ** 2 / 2 + mass * (v[1] ** 2 - x[1] ** 2) / 2,
            (0, np.pi),
            [1.0, 0.5 * scale],
            [2.0, -0.5 * scale],
        )

    answers = [named(problem(scale, mass), degree, intervals) for degree, intervals, scale, mass in cases]
    assert np.count_nonzero(answers) > len(cases) / 2


def test_a_curved_family_of_paths_is_refused_and_mostly_named():
    """Circular orbits of one period: each step along the family leaves it by the step's square."""
    w, cases = 2 * np.pi / 5, [(8, 100), (4, 100), (12, 10)]

    def orbit(t):
        return [w * np.cos(w * t), w * np.sin(w * t)]

    free = [None, None]
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 - ca.dot(x, x) ** 2 / 4, (0, 5), free, free, periodic=True
    )
    assert np.count_nonzero([named(problem, *case, orbit) for case in cases]) > len(cases) / 2


def test_a_hessian_that_is_not_a_number_is_reported_without_a_warning():
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 + 100 * x[0] - 8 * ca.fabs(x[0]) ** 1.5, (0, 1), [0.0], [0.0]
    )
    with pytest.raises(cg.ConvergenceError, match="no path was found") as caught:
        cg.solve(problem, cg.Galerkin(4), intervals=4)
    assert not caught.value.residual <= 50


def test_a_single_unknown_with_a_vanishing_second_derivative_is_named():
    problem = cg.BoundaryProblem(oscillator, (0, 2 * np.sqrt(2)), [0.5], [-0.5])
    with pytest.raises(cg.ConjugatePointError):
        cg.solve(problem, cg.Galerkin(1, quadrature=cg.trapezoid()), intervals=2)


@pytest.mark.parametrize("miss", [0.0, 1e-9, 3e-9])
def test_a_hessian_that_is_singular_on_the_path_but_not_beside_it_is_named(miss):
    """The difference of the components is zero on the path; its Hessian is singular for one stiffness, by bisection."""

    def lagrangian(t, u, v, p):
        x, y = (u[0] + u[1]) / 2, (u[0] - u[1]) / 2
        return (v[0] ** 2 + v[1] ** 2) / 4 - x**4 / 4 - p[0] * x**2 * y**2 / 2

    problem = cg.BoundaryProblem(lagrangian, (0, 1), [0.5, 0.5], [1.0, 1.0], parameters=[0.0])
    tr = cg.transcribe(problem, cg.Galerkin(3), 1)
    values = tr.solve().polynomial.values
    unknowns = tr.unknowns(values.T)

    def positive(stiffness):
        hessian = np.array(ca.DM(tr.hessian(unknowns, *tr.data(tr.mesh, parameters=[stiffness]))))
        return np.linalg.eigvalsh(hessian[::2, ::2] - hessian[::2, 1::2])[0] > 0

    low, high = 5.0, 30.0
    assert positive(low)
    assert not positive(high)
    while low < (low + high) / 2 < high:
        middle = (low + high) / 2
        low, high = (middle, high) if positive(middle) else (low, middle)
    with pytest.raises(cg.ConjugatePointError):
        tr.solve(parameters=[low], guess=values + miss * np.array([0, 1, 1, 0]))


def test_a_component_that_a_symmetry_leaves_free_is_named():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [None], [None])
    with pytest.raises(cg.ConjugatePointError, match=r"family of paths|symmetry leaves"):
        cg.solve(problem, cg.Galerkin(3), intervals=4)


@pytest.mark.parametrize(("degree", "intervals"), [(5, 26), (7, 16), (8, 20), (10, 10), (12, 12), (12, 26)])
def test_a_free_component_that_enters_by_its_velocity_alone_is_named(degree, intervals):
    """The smallest pivot is roundoff and no terms of the second variation cancel, so neither shows a family."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: (2 + ca.cos(x[1])) * v[0] ** 2 / 2 + v[1] ** 2 / 2, (0, 1), [None, 0.3], [None, 0.5]
    )
    with pytest.raises(cg.ConjugatePointError):
        cg.solve(problem, cg.Galerkin(degree), intervals, guess=lambda t: [0.4, 0.3 + 0.1 * t], solver=newton)


@pytest.mark.parametrize("rate", [3.52, 4.0, 10.0])
def test_bratu_above_its_critical_value_fails_with_time_and_advice(rate):
    problem = cg.BoundaryProblem(bratu(rate), (0, 1), [0.0], [0.0])
    with pytest.raises(cg.ConvergenceError, match=r"no path was found.*t = [\d.]+.*Try a guess nearer") as caught:
        cg.solve(problem, cg.Galerkin(6), intervals=10)
    error = caught.value
    assert not isinstance(error, cg.ConjugatePointError)
    assert "Newton's method: " in str(error)
    assert "IPOPT on the action stopped with" in str(error)
    assert "there may be no path" in str(error)
    assert error.path.polynomial.values.shape == (1, 61)
    assert error.residual > 50
    assert error.iterations > 0


@pytest.mark.parametrize("half", [0.67, 0.8, 1.5])
def test_catenoid_above_its_critical_height_fails(half):
    problem = cg.BoundaryProblem(catenoid, (-half, half), [1.0], [1.0])
    with pytest.raises(cg.ConvergenceError, match="no path was found") as caught:
        cg.solve(problem, cg.Galerkin(6), intervals=10)
    assert not isinstance(caught.value, cg.ConjugatePointError)


@pytest.mark.parametrize("half", [0.66, 0.6627])
def test_catenoid_just_below_its_critical_height_is_found(half):
    path = cg.solve(cg.BoundaryProblem(catenoid, (-half, half), [1.0], [1.0]), cg.Galerkin(8), intervals=16)
    c = float(path(0.0)[0])
    assert c * np.cosh(half / c) == pytest.approx(1, rel=1e-12)


def test_a_lagrangian_not_finite_at_the_guess_is_named_with_its_time():
    problem = cg.BoundaryProblem(kepler(1.0), (0, 1), [1.0, 0.0], [-1.0, 0.0])
    with pytest.raises(cg.ConvergenceError, match=r"not finite at the guess.*t = 0\.5"):
        cg.solve(problem, cg.Galerkin(2, quadrature=cg.lobatto(3)), intervals=2)


@pytest.mark.parametrize("engine", [cg.newton, cg.rootfinder, cg.ipopt, cg.minimizer])
def test_every_engine_names_a_guess_outside_the_lagrangians_domain(engine):
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - ca.sqrt(x[0] - t), (0, 1), [1.0], [0.5])
    with pytest.raises(cg.ConvergenceError, match=r"not finite at t = 0\.[67].*where x = .* and v = "):
        cg.solve(problem, cg.Galerkin(4), intervals=5, solver=engine)


def test_a_path_on_which_the_action_is_not_finite_is_not_returned():
    """The derivative of log(x - t) continues to x < t, where the logarithm itself does not exist."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - ca.log(x[0] - t), (0, 1), [1.0], [0.5])
    with pytest.raises(cg.ConvergenceError, match=r"the Lagrangian is not finite at t = 0\.\d+, where x = "):
        cg.solve(problem, cg.Galerkin(4), intervals=5)


def test_failure_prints_nothing(capfd):
    with pytest.raises(cg.ConvergenceError):
        cg.solve(cg.BoundaryProblem(catenoid, (-1, 1), [1.0], [1.0]), cg.Galerkin(4), intervals=5)
    out, err = capfd.readouterr()
    assert (out, err) == ("", "")


def test_verbose_prints_iterations_and_summary(capfd):
    path = solve(BY_NAME["short pendulum"], verbose=2)
    out = capfd.readouterr().out
    assert out.count("damping") == path.iterations
    assert "Trajectory of 1 component" in out


# scaling


def scaled(action, length, time):
    """The pendulum of ten seconds in other units: same iterations and digits in whatever units."""

    def lagrangian(t, x, v):
        return action * ((v[0] * time / length) ** 2 / 2 + ca.cos(x[0] / length))

    return cg.solve(cg.BoundaryProblem(lagrangian, (0, 10 * time), [0.0], [length]), cg.Galerkin(4), intervals=40)


@pytest.mark.parametrize(
    ("action", "length", "time"),
    [(1e-150, 1, 1), (1e150, 1, 1), (1, 1e-12, 1), (1, 1e12, 1), (1, 1, 1e-12), (1, 1, 1e12), (1e-40, 1e12, 1e-12)],
)
def test_units_change_neither_iterations_nor_digits(action, length, time):
    here, there = scaled(1, 1, 1), scaled(action, length, time)
    assert there.iterations == here.iterations
    assert there.morse_index == here.morse_index
    np.testing.assert_allclose(there.x / length, here.x, rtol=0, atol=1e-14)
    assert there.action / (action * time) == pytest.approx(here.action, rel=1e-14)
    momentum = action * time / length
    np.testing.assert_allclose(there.momentum / momentum, here.momentum, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("action", "length", "time"), [(2.0**-500, 1, 1), (1, 2.0**40, 1), (1, 1, 2.0**-40)])
def test_units_that_are_powers_of_two_change_no_bit(action, length, time):
    here, there = scaled(1, 1, 1), scaled(action, length, time)
    np.testing.assert_array_equal(there.x / length, here.x)
    np.testing.assert_array_equal(there.momentum * length / (action * time), here.momentum)


def test_components_of_very_different_size_are_solved_together():
    def lagrangian(t, x, v):
        return (v[0] ** 2 - x[0] ** 2) / 2 + ((v[1] / 1e12) ** 2 - (x[1] / 1e12) ** 2) * 1e-20 / 2

    path = cg.solve(cg.BoundaryProblem(lagrangian, (0, 1), [0, 0], [1e-12, 1e12]), cg.Galerkin(8), intervals=8)
    np.testing.assert_allclose(path.x, np.outer([1e-12, 1e12], np.sin(path.t) / np.sin(1)), rtol=1e-13, atol=0)


@pytest.mark.parametrize("degree", [30, 60])
def test_one_interval_of_high_degree_solves_too(degree):
    path = cg.solve(BY_NAME["short pendulum"].problem, cg.Galerkin(degree), intervals=1)
    assert path.action == pytest.approx(1.3310039926528, abs=1e-13)
    np.testing.assert_allclose(path(0.5), 0.5643038922354, rtol=0, atol=2e-13)


@pytest.mark.parametrize("engine", [cg.newton, cg.rootfinder, cg.ipopt, cg.minimizer])
def test_one_interval_of_degree_one_between_fixed_ends_has_nothing_to_solve(engine):
    path = cg.solve(cg.BoundaryProblem(oscillator, (0, 1), [0.0], [1.0]), cg.Galerkin(1), intervals=1, solver=engine)
    assert path.action == 0.375  # (1² - (1/2)²)/2
    np.testing.assert_array_equal(path.momentum, [[1.25, 0.75]])  # p_0 = -∂S/∂x_0 = 1 + x̄/2, p_1 = 1 - x̄/2
    assert path.morse_index == 0


def test_fifty_thousand_intervals_keep_the_error_floor():
    path = cg.solve(BY_NAME["short pendulum"].problem, cg.Galerkin(2), intervals=50_000)
    assert path(0.5)[0] == pytest.approx(0.5643038922354, abs=1e-12)  # given to 13 decimals
    assert path.action == pytest.approx(1.3310039926528, abs=1e-12)
    assert path.momentum[0, 0] == pytest.approx(1.1762198416929, abs=1e-10)  # differences over h = 2e-5
    assert path.iterations <= 4


def test_transcription_is_public():
    assert isinstance(cg.transcribe(BY_NAME["Lambert"].problem, cg.Galerkin(2), 3), Transcription)
    assert Transcription is cg.Transcription


def test_a_family_of_paths_far_from_the_origin_is_named():
    """Rotations about (100, 70): a step that is short against x changes the Hessian by much more than its part of x."""

    def lagrangian(t, x, v):
        y = x - ca.DM([100.0, 70.0])
        return ca.dot(v, v) / 2 - (ca.dot(y, y) - 1) ** 2

    problem = cg.BoundaryProblem(lagrangian, (0.0, 1.0), [None, None], [None, None])
    transcription = cg.transcribe(problem, cg.Galerkin(1), 1)
    for angle in np.linspace(0.05, 6, 50):
        near = [100 + 1.1 * np.cos(angle), 70 + 1.1 * np.sin(angle)]
        with pytest.raises(cg.ConjugatePointError):
            transcription.solve(guess=lambda t, near=near: near)


def test_a_search_that_ends_at_a_singular_hessian_fails_without_a_warning():
    """The next damping is not forecast from a step that does not exist."""
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: ca.dot(v, v) / 2 - (x[1] - 1 - ca.sin(p[0] * (x[0] - 1)) / p[0]) ** 2 * 5,
        (0.0, 1.0),
        [None, None],
        [None, None],
        parameters=[1.0],
    )
    transcription = cg.transcribe(problem, cg.Galerkin(1), 1)
    for angle in np.linspace(0.05, 6, 10):
        near = [1 + np.cos(angle), 1 + np.sin(np.cos(angle)) + 0.01]
        with pytest.raises(cg.ConvergenceError):
            transcription.solve(guess=lambda t, near=near: near)


@pytest.mark.parametrize("solver", [cg.ipopt, cg.minimizer])
@pytest.mark.parametrize(("action", "length", "time"), [(1e-74, 1e6, 1e-3), (1e50, 1e-8, 1e7)])
def test_ipopt_finds_the_same_path_in_any_units(solver, action, length, time):
    """A long swing from a straight line."""

    def swing(action, length, time):
        def lagrangian(t, x, v):
            angle = x[0] / length
            return action * ((v[0] * time / length) ** 2 / 2 + 1.5 * ca.cos(angle) + 0.3 * ca.sin(t / time) * angle)

        problem = cg.BoundaryProblem(lagrangian, (0.0, 17.0 * time), [0.0], [-5.0 * length])
        return cg.solve(problem, cg.Galerkin(4), 20, solver=solver)

    expected, path = swing(1.0, 1.0, 1.0), swing(action, length, time)
    assert (path.solver, path.iterations) == (expected.solver, expected.iterations)
    np.testing.assert_allclose(path.x / length, expected.x, rtol=0, atol=1e-9)
    assert path.action / action / time == pytest.approx(expected.action, rel=1e-9)
