"""Where a trajectory optimization begins: guesses of every kind, warm starts, what is refused."""

import pickle

import casadi as ca
import numpy as np
import pytest
from control_problems import NEAR, cart_pole, double_integrator, first_order, minimum_time, pendulum, plane
from slow import slow

import casadi_galerkin as cg
from casadi_galerkin.control.initial_guess import starting_point

SOLVED = 1e-8  # what IPOPT leaves of the optimality conditions, amplified by their conditioning


def at_first(program):
    """What a starting point needs beside the guess."""
    return program.problem, program.calculus


@pytest.mark.slow
def test_warm_start_from_a_coarser_answer_saves_iterations():
    coarse = cg.solve(cart_pole(), cg.Galerkin(4), intervals=20)
    cold = cg.solve(cart_pole(), cg.Galerkin(4), intervals=40)
    warm = cg.solve(cart_pole(), cg.Galerkin(4), intervals=40, guess=coarse)
    assert warm.cost == pytest.approx(cold.cost, abs=SOLVED)
    assert warm.iterations <= cold.iterations / 2


def test_warm_start_takes_duration_and_parameters():
    first = cg.solve(minimum_time(), cg.Galerkin(2), intervals=10)
    again = cg.transcribe(minimum_time(), cg.Galerkin(2), 10)
    (values,) = starting_point(again.graph, *at_first(again), first).values
    assert values["duration"][0] == pytest.approx(2, abs=SOLVED)


@pytest.mark.parametrize("guess", [lambda t: [t], np.linspace(0, 1, 6)[None, :], "path"])
def test_guess_may_be_a_callable_an_array_or_an_earlier_trajectory(guess):
    if isinstance(guess, str):
        free = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0])
        guess = cg.solve(free, cg.Galerkin(2), intervals=3)
    path = cg.solve(double_integrator(), cg.Galerkin(3), intervals=5, guess=guess)
    assert path.cost == pytest.approx(6, abs=1e-10)


def test_a_guess_of_the_controls_is_cut_where_the_problem_is_parted():
    parted = double_integrator(t_span=(0, 1), breakpoints=[0.4], duration_bounds=([0.4, 0.1], [0.4, 0.9]))
    program = cg.transcribe(parted, cg.Galerkin(2), 5)
    times = cg.ControlPath(program.mesh, program.method.element.points, np.zeros((1, 10)), np.array([0.5])).times
    wave = np.sin(7 * times)[None, :]
    for guess in (wave, lambda t: [np.sin(7 * t)]):
        values = starting_point(program.graph, *at_first(program), (None, guess)).values
        found = np.concatenate([value["controls"].ravel() for value in values])
        np.testing.assert_allclose(found, wave[0], rtol=0, atol=1e-15)


@pytest.mark.parametrize("size", [1e-5, *slow(0.1)])
@pytest.mark.parametrize("rule", [cg.gauss(2), cg.lobatto(2)], ids=["gauss", "lobatto"])
def test_a_component_that_vanishes_is_found_from_a_guess_where_it_does_not(rule, size):
    """What is left of its terms is the roundoff of those along the guess, and is not measured by itself."""
    problem = plane(t_span=(0.0, 1.0), running_cost=lambda t, x, v, u: ca.dot(u, u))
    path = cg.solve(problem, cg.Galerkin(2, quadrature=rule), 20, guess=lambda t: [t, size * np.sin(3 * t)])
    assert np.max(np.abs(path.x[1])) <= 1e-13 * size
    np.testing.assert_allclose(path.x[0], path.t**2 * (3 - 2 * path.t), rtol=0, atol=2e-3)  # of order 2


def test_guess_that_does_not_fit_is_refused():
    problem = double_integrator()
    two = cg.solve(
        double_integrator(
            controls=2, force=lambda t, x, v, u: u[0] + u[1], running_cost=lambda t, x, v, u: ca.sumsqr(u)
        ),
        cg.Galerkin(2),
        intervals=4,
    )
    with pytest.raises(ValueError, match=r"1 control, got 2"):
        cg.solve(problem, cg.Galerkin(2), intervals=4, guess=two)
    with pytest.raises(ValueError, match=r"the guess must be a path of 2 components, got 1"):
        cg.solve(cart_pole(), cg.Galerkin(2), intervals=4, guess=two)
    with pytest.raises(ValueError, match="shape"):
        cg.solve(problem, cg.Galerkin(2), intervals=4, guess=np.zeros((2, 5)))
    with pytest.raises(ValueError, match="guess must be finite"):
        cg.solve(problem, cg.Galerkin(2), intervals=4, guess=lambda t: [np.nan])


@pytest.fixture(scope="module")
def swinging():
    """The pendulum's transcription, and its answer."""
    program = cg.transcribe(pendulum(3.0), cg.Galerkin(4), 10)
    return program, program.solve()


@pytest.mark.parametrize(
    "controls",
    [lambda t: [1.5 * np.sin(3 * t)], np.zeros((1, 40)), [[0.1] * 40], "path"],
    ids=["callable", "array", "list", "control path"],
)
@pytest.mark.parametrize("path", [lambda t: [np.pi * t / 3], np.linspace(0, np.pi, 11)[None, :], "trajectory"])
def test_guess_may_be_a_pair_of_path_and_controls(swinging, path, controls):
    program, known = swinging
    given = (known if isinstance(path, str) else path, known.control if isinstance(controls, str) else controls)
    assert program.solve(guess=given).cost == pytest.approx(known.cost, abs=SOLVED)


def test_controls_of_a_pair_are_where_the_solve_starts(swinging):
    program, known = swinging
    (chain,), (values,) = (
        program.numbering.chains,
        starting_point(program.graph, *at_first(program), (known, known.control)).values,
    )
    controls = known.control.values.reshape(1, 10, 4).transpose(1, 2, 0)
    np.testing.assert_allclose(values["controls"], controls, rtol=0, atol=1e-12)
    np.testing.assert_allclose(chain.path(values, program.mesh).values, known.polynomial.values, rtol=0, atol=1e-12)
    bounded = cg.transcribe(pendulum(3.0, control_bounds=(-1, 1)), cg.Galerkin(4), 10)
    (values,) = starting_point(bounded.graph, *at_first(bounded), (known, known.control)).values
    np.testing.assert_allclose(values["controls"], np.clip(controls, -1, 1), rtol=0, atol=1e-12)
    assert np.max(np.abs(values["controls"])) == 1


@pytest.mark.parametrize(
    ("guess", "kind", "message"),
    [
        ((lambda t: [t], np.zeros((1, 11))), ValueError, r"controls must have the shape \(1, 40\) .*, got \(1, 11\)"),
        ((lambda t: [t], lambda t: [t, t]), ValueError, r"guess of the controls must return an array of shape \(1,\)"),
        ((lambda t: [t], np.full((1, 40), np.nan)), ValueError, r"controls must be finite, got \[nan\] at t = 0.02"),
        ((lambda t: [t], "none"), TypeError, "the guess of the controls must be real numbers, got 'none'"),
        ((np.zeros((1, 7)), np.zeros((1, 40))), ValueError, r"the guess must have the shape \(1, 11\)"),
    ],
)
def test_a_pair_that_does_not_fit_is_refused(guess, kind, message):
    with pytest.raises(kind, match=message):
        cg.solve(pendulum(3.0), cg.Galerkin(4), 10, guess=guess)


def test_controls_begin_at_zero_only_where_that_is_inside_of_their_bounds():
    low, high = [-1, 0, -4, 0, 2, -np.inf], [1, 5, 0, np.inf, 3, np.inf]
    six = {"controls": 6, "force": lambda t, x, v, u: ca.sum1(u), "running_cost": lambda t, x, v, u: ca.sumsqr(u)}
    program = cg.transcribe(double_integrator(**six, control_bounds=(low, high)), cg.Galerkin(2), 3)
    begun = starting_point(program.graph, *at_first(program), None).values[0]["controls"]
    np.testing.assert_array_equal(begun, np.broadcast_to([0, 2.5, -2, 0, 2.5, 0], begun.shape))


@pytest.mark.slow
def test_thrusters_that_only_push_begin_between_their_bounds():
    """From zero, the quadrotor finds nothing on 150 intervals within 1000 iterations."""
    mass, inertia, arm, weight = 0.5, 0.004, 0.15, 0.5 * 9.81
    quadrotor = cg.ControlProblem(
        lambda t, x, v: mass * (v[0] ** 2 + v[1] ** 2) / 2 + inertia * v[2] ** 2 / 2 - weight * x[1],
        (0.0, 4.0),
        start=[0, 1, 0],
        end=[6, 1, 0],
        start_velocity=[0, 0, 0],
        end_velocity=[0, 0, 0],
        force=lambda t, x, v, u: [-(u[0] + u[1]) * ca.sin(x[2]), (u[0] + u[1]) * ca.cos(x[2]), arm * (u[1] - u[0])],
        running_cost=lambda t, x, v, u: ca.sumsqr(u - weight / 2),
        controls=2,
        control_bounds=(0, 5),
        position_bounds=([-1, 0, -1.2], [8, 5, 1.2]),
        waypoints=[(1.0, [2, 2.5, None]), (2.0, [4, 0.5, None]), (3.0, [(4.9, 5.1), (1.9, 2.1), None])],
    )
    path = cg.solve(quadrotor, cg.Galerkin(4), intervals=150)
    assert path.iterations < 100
    assert path.cost == pytest.approx(9.8106, abs=1e-3)


@pytest.mark.slow
def test_an_epidemic_begins_without_vaccinations():
    """From half of the most, susceptible and infected leave all bounds on a coarse mesh, and cost less than nothing."""
    spread, cured = 1.892, 0.567
    task = first_order(
        t_span=(0.0, 22.3),
        start=[0.99, 0.01],
        end=[None] * 2,
        start_velocity=[None] * 2,
        end_velocity=[None] * 2,
        rates=lambda t, x, v, u: [
            -spread * x[0] * x[1] - u[0] * x[0],
            spread * x[0] * x[1] - cured * x[1],
        ],
        running_cost=lambda t, x, v, u: x[1] + 0.4975 * u[0] ** 2,
        control_bounds=(0.0, 0.6834),
    )
    path = cg.solve(task, tol=1e-5)
    assert path.cost == pytest.approx(0.483524, abs=1e-6)
    assert len(path.t) <= 20


@pytest.mark.parametrize("name", NEAR)
def test_an_earlier_answer_starts_warm_and_saves_iterations(name):
    problem, method, changes = NEAR[name]
    program = cg.transcribe(problem(), method, 12)
    known = program.solve()
    by_path = program.solve(**changes, guess=(known, lambda t: known.control(t)))
    warm = program.solve(**changes, guess=known)
    assert warm.cost == pytest.approx(by_path.cost, rel=1e-10)
    np.testing.assert_allclose(warm.x, by_path.x, rtol=0, atol=SOLVED)
    np.testing.assert_allclose(warm.costate.values, by_path.costate.values, rtol=1e-6, atol=1e-6)
    assert warm.iterations <= 0.75 * by_path.iterations
    assert program.solve(guess=known).iterations <= 4  # so many acceptable ones end it


def test_a_warm_start_does_not_depend_on_who_found_the_answer():
    """The multipliers are those of the undivided equations, whatever another transcription divides them by."""
    near, far = (cg.transcribe(pendulum(3.0, end=[end]), cg.Galerkin(4), 10) for end in (np.pi, 300.0))
    assert far.solve(end=[np.pi], guess=near.solve()).iterations <= 1


@pytest.mark.slow
def test_another_layout_starts_from_the_path_alone(swinging):
    same, known = swinging
    meshes = {"mesh": 3 * np.linspace(0, 1, 11) ** 1.3}, {"mesh": np.linspace(0, 3, 12)}
    for method, mesh in ((cg.Galerkin(5), {"intervals": 10}), *((cg.Galerkin(4), mesh) for mesh in meshes)):
        program = cg.transcribe(pendulum(3.0), method, **mesh)
        assert not starting_point(program.graph, *at_first(program), known).duals
        assert program.solve(guess=known).cost == pytest.approx(known.cost, rel=1e-3)
    later = cg.DiscreteCalculus(cg.Galerkin(4), np.linspace(7, 9, 11))
    assert starting_point(same.graph, same.problem.varied({}, (7.0, 9.0)), later, known).duals


def test_an_answer_with_other_ends_given_starts_warm(swinging):
    (_, known), freed = swinging, pendulum(3.0, end_velocity=[None])
    program = cg.transcribe(freed, cg.Galerkin(4), 10)
    assert starting_point(program.graph, *at_first(program), known).duals
    assert program.solve(guess=known).cost == pytest.approx(program.solve().cost, abs=SOLVED)


def test_a_warm_start_survives_pickling():
    program = cg.transcribe(minimum_time(), cg.Galerkin(3), 10)
    known = program.solve()
    ours, theirs = (program.solve(start=[0.1], guess=path) for path in (known, pickle.loads(pickle.dumps(known))))
    np.testing.assert_array_equal(theirs.polynomial.values, ours.polynomial.values)
    assert theirs.iterations == ours.iterations


@pytest.mark.parametrize("solver", [cg.ipopt, cg.fatrop], ids=str)
@pytest.mark.parametrize("size", [1e6, *slow(1e15)])
def test_a_guess_far_from_any_answer_neither_scales_nor_measures_the_equations(size, solver):
    """Measured along the guess, a path that missed its equations altogether passed, with a cost of 1e-48."""
    for guess in (lambda t: [t + size * np.sin(37 * t)], (lambda t: [t], lambda t: [size * np.cos(9 * t)])):
        path = cg.solve(double_integrator(), cg.Galerkin(3), 8, guess=guess, solver=solver)
        assert path.cost == pytest.approx(6, rel=1e-7)  # what fatrop leaves


@pytest.mark.parametrize("guess", [None, lambda t: [np.sin(np.pi * t), t]], ids=["line", "guess"])
@pytest.mark.parametrize("rounding", [1.2e-16, *slow(-1e-30)])
def test_a_component_that_the_straight_line_moves_by_rounding_is_not_measured_by_that(rounding, guess):
    def problem(end):
        return double_integrator(
            lagrangian=lambda t, x, v: ca.dot(v, v) / 2 - ca.cos(x[0]),
            start=[0.0, 0.0],
            end=[end, 1.0],
            start_velocity=[0.0, 0.0],
            end_velocity=[0.0, 0.0],
            force=lambda t, x, v, u: [u[0] * ca.cos(x[0]), u[1]],
            running_cost=lambda t, x, v, u: ca.dot(u, u) / 2 + 100 * (x[0] - ca.sin(np.pi * t)) ** 2,
            controls=2,
        )

    path, there = (cg.solve(problem(end), cg.Galerkin(4), 10, guess=guess) for end in (rounding, 0.0))
    assert path.cost == pytest.approx(there.cost, rel=SOLVED)
    assert path.solver == "IPOPT (Solve Succeeded)"


def test_a_single_component_that_comes_back_but_for_rounding_is_measured_along_its_guess():
    def there_and_back(end):
        cost = {"running_cost": lambda t, x, v, u: u[0] ** 2 / 2 + 100 * (x[0] - ca.sin(np.pi * t)) ** 2}
        return double_integrator(lagrangian=lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), end=[end], **cost)

    path, there = (
        cg.solve(there_and_back(end), cg.Galerkin(4), 10, guess=lambda t: [np.sin(np.pi * t)]) for end in (1e-16, 0.0)
    )
    assert path.cost == pytest.approx(there.cost, rel=SOLVED)
    assert path.solver == "IPOPT (Solve Succeeded)"


@pytest.mark.parametrize("solver", [cg.ipopt, cg.sqp, cg.fatrop], ids=str)
def test_what_is_not_finite_in_a_warm_start_is_named(solver):
    problem = double_integrator(
        lagrangian=lambda t, x, v, p: v[0] ** 2 / 2,
        force=lambda t, x, v, u, p: u,
        running_cost=lambda t, x, v, u, p: ca.sqrt(p[0]) * u[0] ** 2,
        parameters=[1.0],
    )
    program = cg.transcribe(problem, cg.Galerkin(3), 4)
    known = program.solve()
    with pytest.raises(ValueError, match="running_cost is not finite at the guess"):
        program.solve(parameters=[-1.0], guess=known, solver=solver)
