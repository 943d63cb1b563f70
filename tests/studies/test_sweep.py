"""Many solves: the same answers in the same order whoever solves them, failures kept, bad input refused."""

import operator
import os
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from importlib import import_module
from multiprocessing import get_context

import casadi as ca
import numpy as np
import pytest
from callbacks import pendulum_with_callback
from control_problems import double_integrator
from motions import henon_heiles, kepler
from scenes import BY_NAME, DAMPED, bratu_problem
from sent_guesses import arched, deadly, dividing, pushed, unbuildable, unpicklable
from slow import slow

import casadi_galerkin as cg

METHOD, INTERVALS = cg.Galerkin(degree=4), 6
PARALLEL = import_module("casadi_galerkin.studies.parallel")


def interrupted(t):
    raise KeyboardInterrupt


RATES = [0.5, 4.0, 1.0, 3.0, 10.0, 2.0, 0.1]
FAILING = [1, 4]
VARIATIONS = [{"parameters": [rate]} for rate in RATES]


@pytest.fixture(scope="module")
def serial():
    return cg.sweep(bratu_problem(), VARIATIONS, METHOD, INTERVALS)


@pytest.fixture(scope="module")
def pool():
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as processes:
        yield processes


class Recorder(Executor):
    """Runs what it is given here, backwards, and keeps it."""

    def __init__(self):
        self.given = []

    def map(self, fn, *iterables, **_):
        self.given += zip(*iterables, strict=True)
        return reversed([fn(*given) for given in reversed(list(zip(*iterables, strict=True)))])


def identical(one, other):
    """Two sweeps with bitwise the same answers and the same reasons."""
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        assert type(a) is type(b)
        if isinstance(a, cg.Trajectory):
            np.testing.assert_array_equal(a.polynomial.values, b.polynomial.values)
            assert (a.action, a.problem.start, a.problem.parameters) == (
                b.action,
                b.problem.start,
                b.problem.parameters,
            )
        else:
            assert str(a) == str(b)


@pytest.mark.slow
def test_answers_are_those_of_single_solves_in_order(serial):
    for rate, answer in zip(RATES, serial, strict=True):
        problem = bratu_problem().varied({"parameters": [rate]}, (0.0, 1.0))
        if rate > 3.51:
            with pytest.raises(cg.ConvergenceError):
                cg.solve(problem, METHOD, INTERVALS)
            assert isinstance(answer, cg.ConvergenceError)
        else:
            assert answer.parameters == (rate,)
            np.testing.assert_array_equal(answer.x, cg.solve(problem, METHOD, INTERVALS).x)


def test_failures_are_kept_with_their_reason_and_best_iterate(serial):
    assert list(serial.failures) == FAILING
    for number, error in serial.failures.items():
        assert error is serial[number]
        assert "no path was found" in str(error)
        assert error.path is not None
        assert error.__traceback__ is None
        assert error.__context__ is None


def test_arrays_have_nan_where_there_is_no_answer(serial):
    assert serial.x.shape == serial.momentum.shape == (len(RATES), 1, INTERVALS + 1)
    assert serial.t.shape == (len(RATES), INTERVALS + 1)
    for array in (serial.t, serial.x, serial.momentum, serial.action):
        missing = np.isnan(array.reshape(len(RATES), -1))
        assert np.flatnonzero(missing.all(axis=1)).tolist() == np.flatnonzero(missing.any(axis=1)).tolist() == FAILING
    np.testing.assert_array_equal(serial.x[2], serial[2].x)
    assert serial.action[2] == serial[2].action


def test_summary_counts_and_gives_the_first_reason(serial):
    assert str(serial).startswith(
        "Sweep of 7 variations, 5 solved\n  variation 1 is the first without an answer: no path"
    )
    assert str(cg.sweep(bratu_problem(), VARIATIONS[:1], METHOD, INTERVALS)) == "Sweep of 1 variation, 1 solved"


def test_every_field_can_be_varied():
    def lagrangian(t, x, v, p):
        return v[0] ** 2 / 2 - p[0] * x[0]

    problem = cg.BoundaryProblem(lagrangian, (0.0, 1.0), [0.0], [0.0], parameters=[0.0])
    variation = {"start": [1.0], "end": [3.0], "parameters": [2.0], "t_span": (1.0, 3.0), "guess": np.zeros((1, 7))}
    (path,) = cg.sweep(problem, [variation], METHOD, INTERVALS)
    s = path.t - 1
    np.testing.assert_allclose(path.x[0], 1 + 3 * s - s**2, rtol=1e-13)  # gravity 2, and 3 after two seconds
    assert path.problem.t_span == (1.0, 3.0)


def test_guess_of_a_variation_is_its_own():
    low, high = cg.sweep(bratu_problem(), [{}, {"guess": arched}], METHOD, INTERVALS)
    assert (low.morse_index, high.morse_index) == (0, 1)


@pytest.mark.slow
def test_with_a_tolerance_every_path_keeps_it():
    sweep = cg.sweep(bratu_problem(), [{"parameters": [0.01]}, {"parameters": [3.5]}, {"parameters": [9.0]}], tol=1e-8)
    assert sweep[0].error_estimate <= 1e-8
    assert sweep[1].error_estimate <= 1e-8
    assert list(sweep.failures) == [2]
    assert "no path was found" in str(sweep[2])


def test_paths_on_different_meshes_make_no_array():
    def lagrangian(t, x, v, p):
        return p[0] * v[0] ** 2 / 2 + x[0] ** 2 / 2

    layers = cg.BoundaryProblem(lagrangian, (0.0, 1.0), [1.0], [0.0], parameters=[0.1])
    sweep = cg.sweep(layers, [{"parameters": [width]} for width in (0.1, 1e-8)], tol=1e-6)
    assert len(sweep[0].t) != len(sweep[1].t)
    with pytest.raises(ValueError, match="different meshes"):
        operator.attrgetter("x")(sweep)


def lambert(count, seed=None):
    """From one place to others round the sun, in order or not; from straight lines half of them go the other way."""
    angles = np.linspace(2.0, 4.0, count)
    angles = angles if seed is None else np.random.default_rng(seed).permutation(angles)
    ends = [{"end": [1.3 * float(np.cos(a)), 1.3 * float(np.sin(a))]} for a in angles]
    return cg.BoundaryProblem(kepler, (0.0, 3.0), [1.0, 0.0], ends[0]["end"]), ends


@pytest.mark.parametrize("seed", [None, 0])
@pytest.mark.slow
def test_with_a_tolerance_neighbors_are_on_one_branch(seed, pool):
    problem, ends = lambert(21, seed)
    ends[0]["guess"] = lambert_guess(ends[0]["end"])
    sweep = cg.sweep(problem, ends, tol=1e-7)
    assert not sweep.failures
    assert not sweep.jumps
    turned = [path.x[0, 0] * path.momentum[1, 0] - path.x[1, 0] * path.momentum[0, 0] for path in sweep]
    assert min(turned) > 0
    identical(cg.sweep(problem, ends, tol=1e-7, executor=pool), sweep)


@pytest.mark.slow
def test_a_variation_to_which_its_neighbor_does_not_lead_is_solved_from_the_straight_line():
    problem = cg.BoundaryProblem(henon_heiles, (0.0, 2.0), [0.0, 0.1], [0.2, 0.3])
    assert not cg.sweep(problem, [{}, {"t_span": (0.0, 7.0), "end": [0.5, 0.5]}], tol=1e-4).failures


def lambert_guess(end):
    """A pair (times, values): an arc against the clock."""
    angle = np.linspace(0, np.arctan2(end[1], end[0]) % (2 * np.pi), 9)
    return np.linspace(0, 3, 9), np.linspace(1, 1.3, 9) * np.array([np.cos(angle), np.sin(angle)])


def test_variations_on_another_branch_are_told():
    rates = [{"parameters": [rate]} for rate in np.linspace(0.8, 1.2, 9)]
    rates[5]["guess"] = arched
    sweep = cg.sweep(bratu_problem(), rates, METHOD, INTERVALS)
    assert [path.morse_index for path in sweep] == [0, 0, 0, 0, 0, 1, 0, 0, 0]
    assert sweep.jumps == {5: 4, 6: 5}
    assert str(sweep) == (
        "Sweep of 9 variations, 9 solved\n  seem on another branch than their neighbors: 2, first 5 beside 4"
    )


@pytest.mark.parametrize("step", [0.1, *slow(5.0)])
@pytest.mark.slow
def test_another_branch_is_told_where_the_action_changes_much_along_both(step):
    """The potential is counted from another zero, which changes all actions alike."""
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 + ca.cos(x[0]) + p[0], (0.0, 10.0), [0.0], [1.0], parameters=[0.0]
    )
    found = [path for path in cg.paths(problem, cg.Galerkin(8), 20) if path.morse_index == 0][:2]
    assert abs(found[0].action - found[1].action) > 1
    variations = [{"parameters": [step * k], "guess": found[k >= 3]} for k in range(6)]
    assert list(cg.sweep(problem, variations, cg.Galerkin(8), 20).jumps) == [3]


@pytest.mark.slow
def test_the_other_way_round_the_sun_is_another_branch_of_the_same_index():
    problem, ends = lambert(8)
    for end in ends:
        end["guess"] = lambert_guess(end["end"])
    times, arc = lambert_guess([1.3 * float(np.cos(2 * np.pi - 2.286)), 1.3 * float(np.sin(2 * np.pi - 2.286))])
    ends[1]["guess"] = times, arc * np.array([[1.0], [-1.0]])
    sweep = cg.sweep(problem, ends, METHOD, 20)
    assert {path.morse_index for path in sweep} == {0}
    assert sweep.jumps == {1: 0, 2: 1}


@pytest.mark.slow
def test_the_long_way_round_a_sphere_is_another_branch():
    """Its Morse index is 1 in space; under a constraint that alone is compared."""

    def arc(angle):
        return lambda t: [np.cos(angle * t), np.sin(angle * t), 0.0]

    angles = [1.0, 1.1, 1.2 - 2 * np.pi, 1.3]
    ends = [{"end": arc(angle)(1.0), "guess": arc(angle)} for angle in angles]
    sphere = cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2,
        (0.0, 1.0),
        arc(1.0)(0.0),
        arc(1.0)(1.0),
        constraint=lambda t, x: ca.sumsqr(x) - 1,
    )
    sweep = cg.sweep(sphere, ends, METHOD, INTERVALS)
    assert [path.morse_index for path in sweep] == [0, 0, 1, 0]
    assert sweep.jumps == {2: 1, 3: 2}


@pytest.mark.slow
def test_paths_on_neighboring_circles_are_on_one_branch():
    """The action changes by the constraint, which says more than the slopes of the Lagrangian alone."""

    def arc(radius):
        return lambda t: [radius * np.cos(t), radius * np.sin(t)]

    circle = cg.BoundaryProblem(
        lambda t, x, v, p: ca.sumsqr(v) / 2,
        (0.0, 1.0),
        arc(1.0)(0.0),
        arc(1.0)(1.0),
        parameters=[1.0],
        constraint=lambda t, x, p: ca.sumsqr(x) - p[0] ** 2,
    )
    radii = [
        {"parameters": [r], "start": arc(r)(0.0), "end": arc(r)(1.0), "guess": arc(r)} for r in (1.0, 1.1, 1.2, 1.3)
    ]
    assert not cg.sweep(circle, radii, METHOD, INTERVALS).jumps


def test_a_path_that_is_found_twice_is_on_one_branch():
    again = [{"guess": lambda t, c=c: [c * t * (1 - t)]} for c in (0.0, 0.1, 0.2, 0.3)]
    assert not cg.sweep(bratu_problem(), again, METHOD, INTERVALS).jumps


def test_paths_of_neighboring_durations_are_on_one_branch():
    spans = [{"t_span": span} for span in [(0.0, 1.5), (0.1, 1.5), (0.1, 1.7), (0.0, 1.9)]]
    assert not cg.sweep(BY_NAME["short pendulum"].problem, spans, METHOD, INTERVALS).jumps


def test_jumps_are_told_of_boundary_problems():
    for bounds in ((-20, 20), (-1e-3, 1e-3)):  # the latter allow no path
        sweep = cg.sweep(double_integrator(control_bounds=bounds), [{}], METHOD, INTERVALS)
        assert len(sweep.failures) == (bounds[1] < 1)
        with pytest.raises(ValueError, match="boundary problems only"):
            operator.attrgetter("jumps")(sweep)
    assert cg.sweep(bratu_problem(), [], METHOD, INTERVALS).jumps == {}


def test_a_guess_that_raises_is_one_failure():
    sweep = cg.sweep(bratu_problem(), [{}, {"guess": dividing}, {}], METHOD, INTERVALS)
    assert list(sweep.failures) == [1]
    assert "division by zero" in str(sweep[1])
    assert (sweep[1].__traceback__, sweep[1].__cause__, sweep[1].__context__) == (None, None, None)
    assert f"variation 1 is the first without an answer: {type(sweep[1]).__name__}: " in str(sweep)


def test_an_interrupt_returns_what_there_is(serial):
    variations = [*VARIATIONS[:2], {"guess": interrupted}, *VARIATIONS[2:]]
    sweep = cg.sweep(bratu_problem(), variations, METHOD, INTERVALS)
    identical(sweep[:2], serial[:2])
    for answer in sweep[2:]:
        assert isinstance(answer, cg.CutShort)
        assert str(answer) == "the sweep was interrupted before this variation was solved"
    assert str(sweep).startswith("Sweep of 8 variations, 1 solved, 6 cut short\n")


def test_an_interrupt_that_casadi_makes_another_error_of_ends_the_sweep(monkeypatch):
    """CasADi's own Python code, which its C++ calls, makes a SystemError of an interrupt."""

    def interrupted_solve(*_, **__):
        raise SystemError("returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr("casadi_galerkin.boundary.transcription.Transcription.solve", interrupted_solve)
    sweep = cg.sweep(bratu_problem(), VARIATIONS, METHOD, INTERVALS)
    assert {type(answer) for answer in sweep} == {cg.CutShort}


def test_nothing_to_vary_is_an_empty_sweep():
    assert len(cg.sweep(bratu_problem(), [], METHOD, INTERVALS)) == 0
    assert len(cg.sweep(bratu_problem(), [], tol=1e-6)) == 0


def test_without_any_answer_there_are_no_arrays():
    sweep = cg.sweep(bratu_problem(), [{"parameters": [9.0]}], METHOD, INTERVALS)
    with pytest.raises(ValueError, match="no variation has an answer"):
        operator.attrgetter("action")(sweep)


# control problems


PUSHES = [
    {"end": [2.0]},
    {"end_velocity": [1.5]},
    {"t_span": (1.0, 3.0)},
    {"guess": (arched, pushed)},
    {"start": [9.0]},
]


def test_paths_of_boundary_problems_have_no_cost(serial):
    with pytest.raises(ValueError, match="only control problems have a cost"):
        _ = serial.cost


@pytest.mark.slow
def test_a_control_problem_is_swept(pool):
    problem = double_integrator(position_bounds=(-1, 9))  # ∫u²/2 = (6 (s - v)² + 6 (s - v) v + 2 v²)/T³, s the way in T
    sweep = cg.sweep(problem, PUSHES, METHOD, INTERVALS)
    np.testing.assert_allclose(sweep.cost, [24.0, 1.5, 0.75, 6.0, 6 * 64.0], rtol=1e-10, atol=0)
    assert sweep[2].problem.t_span == (1.0, 3.0)
    assert [path.problem.end for path in sweep][:2] == [(2.0,), (1.0,)]
    identical(cg.sweep(problem, PUSHES, METHOD, INTERVALS, executor=pool), sweep)
    np.testing.assert_allclose(cg.sweep(problem, PUSHES[:2], tol=1e-6).cost, sweep.cost[:2], rtol=1e-6, atol=0)


@pytest.mark.slow
def test_with_a_tolerance_controls_start_from_their_neighbors_too():
    pushes = [{"end": [float(end)]} for end in np.linspace(1.0, 2.0, 8)]
    problem = double_integrator(control_bounds=(-11.0, 11.0))  # acts from an end of 11 / 6 on
    alone, beside = (cg.solve(problem.varied(push), tol=1e-6) for push in pushes), cg.sweep(problem, pushes, tol=1e-6)
    for path, own in zip(beside, alone, strict=True):
        assert path.error_estimate <= 1e-6
        assert path.cost == pytest.approx(own.cost, rel=2e-6)


def test_breakpoints_of_a_control_problem_are_joints_whatever_the_time_span():
    sweep = cg.sweep(double_integrator(breakpoints=[0.3]), [{}, {"t_span": (0.0, 2.0)}], METHOD, INTERVALS)
    np.testing.assert_allclose(sweep.cost, [6.0, 0.75], rtol=1e-10, atol=0)
    assert np.all(np.any(sweep.t == 0.3, axis=1))
    with pytest.raises(ValueError, match=r"variation 0: breakpoints must increase inside of \(0.0, 0.2\)"):
        cg.sweep(double_integrator(breakpoints=[0.3]), [{"t_span": (0.0, 0.2)}], METHOD, INTERVALS)


def test_a_failure_of_a_control_problem_is_kept():
    sweep = cg.sweep(double_integrator(control_bounds=(-7, 7)), [{}, {"end": [2.0]}], METHOD, INTERVALS)
    assert list(sweep.failures) == [1]
    assert "Infeasible" in str(sweep[1])


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (([{"energy": 1.0}], METHOD, INTERVALS), ValueError, "variation 0: the problem has no energy, got energy=1.0"),
        (
            ([{"u": 1.0}], METHOD, INTERVALS),
            ValueError,
            "is start, end, parameters, start_velocity, end_velocity, t_span, guess$",
        ),
        (([{"end": [None]}], METHOD, INTERVALS), ValueError, "variation 0: end must have None where the problem has"),
        (([{"start": [2.0]}], METHOD, INTERVALS), ValueError, r"variation 0: start\[0\] = 2.0 lies outside"),
        (([{}], METHOD), ValueError, "give a method and intervals, or tol"),
    ],
)
def test_a_variation_that_does_not_fit_a_control_problem_is_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        cg.sweep(double_integrator(position_bounds=(-1, 1.5)), *arguments)
    with pytest.raises(TypeError, match="method must be a Galerkin"):
        cg.sweep(double_integrator(), [{}], 4, tol=1e-3)
    with pytest.raises(ValueError, match="tol must be a number between 0 and 1, got 2"):
        cg.sweep(double_integrator(), [{}], tol=2)


def test_a_problem_with_a_function_of_this_process_is_solved_here_and_refused_for_other_processes(pool):
    problem, ends = pendulum_with_callback(), [{"end": [0.5]}, {"end": [0.6]}]
    assert not cg.sweep(problem, ends, METHOD, INTERVALS).failures
    with pytest.raises(TypeError, match=r"cannot be pickled, .* such as a casadi\.Callback"):
        cg.sweep(problem, ends, METHOD, INTERVALS, executor=pool)


# executors


def test_a_process_pool_gives_the_same_in_the_same_order(pool, serial):
    identical(cg.sweep(bratu_problem(), VARIATIONS, METHOD, INTERVALS, executor=pool), serial)


def test_a_process_pool_takes_ends_spans_guesses_and_tolerances(pool):
    variations = [
        {"end": np.array([0.5]), "t_span": (0.0, 0.9), "guess": arched},
        {"guess": np.full((1, INTERVALS + 1), 0.1)},
        {"guess": cg.solve(bratu_problem(), METHOD, INTERVALS)},
    ]
    here = cg.sweep(bratu_problem(), variations, METHOD, INTERVALS)
    identical(cg.sweep(bratu_problem(), variations, METHOD, INTERVALS, executor=pool), here)
    here = cg.sweep(bratu_problem(), variations, tol=1e-6)
    identical(cg.sweep(bratu_problem(), variations, tol=1e-6, executor=pool), here)


@pytest.mark.parametrize("count", [1, 65, *slow(3300)])
def test_chunks_hold_everything_once_whatever_the_order_in_which_they_are_solved(count, monkeypatch):
    monkeypatch.setattr(PARALLEL, "_unpickled", lambda _: lambda variation, known: variation["parameters"][0])
    executor = Recorder()
    variations = [{"parameters": [float(i)]} for i in range(count)]
    answers = cg.sweep(bratu_problem(), variations, METHOD, INTERVALS, executor=executor)
    assert list(answers) == list(range(count))
    assert count <= len(executor.given) ** 2 <= 4 * count


def test_a_worker_builds_one_graph_for_all_its_chunks(monkeypatch):
    built, transcribe = [], PARALLEL.transcribe
    monkeypatch.setattr(PARALLEL, "transcribe", lambda *given: built.append(1) or transcribe(*given))
    PARALLEL._unpickled.cache_clear()
    cg.sweep(bratu_problem(), VARIATIONS[:1] * 5, METHOD, INTERVALS, executor=Recorder())
    assert len(built) == 2  # one here, to refuse bad input early, and one by the worker


class Inline(Executor):
    """Works here at once; what `fails` says of a chunk's rates is raised, as by a cluster that lives on."""

    def __init__(self, fails):
        self.fails, self.given = fails, []

    def submit(self, fn, /, chunk):
        self.given.append([variation["parameters"][0] for variation in chunk[0]])
        future, error = Future(), self.fails(self.given[-1])
        if error is None:
            future.set_result(fn(chunk))
        else:
            future.set_exception(error)
        return future


@pytest.mark.slow
def test_what_a_dead_worker_leaves_stays_on_the_branch_of_its_neighbors():
    """From the straight line, some of these swings of a pendulum end on other branches."""
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 + p[0] * ca.cos(x[0]), (0, 6), [0.5], [1.0], parameters=[0.1]
    )
    variations = [{"parameters": [rate]} for rate in np.linspace(0.1, 3.0, 30).tolist()]
    here, center = cg.sweep(problem, variations, tol=1e-7), 12
    variations[center] = variations[center] | {"guess": deadly}
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        sweep = cg.sweep(problem, variations, tol=1e-7, executor=pool)
    assert list(sweep.failures) == [center]
    assert isinstance(sweep[center], cg.CutShort)
    assert str(sweep[center]).startswith("the worker that solved this variation failed, BrokenProcessPool: ")
    others = [i for i in range(30) if i != center]
    np.testing.assert_allclose(sweep.action[others], here.action[others], rtol=1e-6)


@pytest.mark.slow
def test_a_pool_whose_workers_cannot_start_is_replaced():
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=os._exit, initargs=(1,)) as pool:
        assert not cg.sweep(bratu_problem(), [{}, {}], METHOD, INTERVALS, executor=pool).failures


def test_a_chunk_that_is_lost_is_solved_again_one_by_one(monkeypatch, serial):
    """By a process that is started again when it fails."""
    too_large, started = MemoryError("too large"), []

    def process(*given):
        started.append(Inline(lambda rates: too_large if RATES[1] in rates else None))
        return started[-1]

    monkeypatch.setattr(PARALLEL, "ProcessPoolExecutor", process)
    executor = Inline(lambda rates: too_large if RATES[1] in rates else None)
    sweep = cg.sweep(bratu_problem(), VARIATIONS, METHOD, INTERVALS, executor=executor)
    assert isinstance(sweep[1], cg.CutShort)
    assert str(sweep[1]) == "the worker that solved this variation failed, MemoryError: too large"
    identical([sweep[0], *sweep[2:]], [serial[0], *serial[2:]])
    singly = [[rate] for chunk in executor.given for rate in chunk]
    assert [one.given for one in started] == [singly[:2], singly[2:]]


def test_a_pool_that_breaks_while_it_is_given_chunks_loses_none(monkeypatch, serial):
    class Breaking(Inline):
        def submit(self, fn, /, chunk):
            if len(self.given) == 3:
                raise BrokenProcessPool("a child was killed")
            return super().submit(fn, chunk)

    monkeypatch.setattr(PARALLEL, "ProcessPoolExecutor", lambda *given: Inline(lambda rates: None))
    executor = Breaking(lambda rates: None)
    identical(cg.sweep(bratu_problem(), VARIATIONS, METHOD, INTERVALS, executor=executor), serial)
    assert len(executor.given) == 3


def test_an_interrupted_worker_ends_the_sweep_which_returns_what_there_is(serial):
    executor = Inline(lambda rates: KeyboardInterrupt() if rates == RATES[2:4] else None)
    sweep = cg.sweep(bratu_problem(), VARIATIONS, METHOD, INTERVALS, executor=executor)
    for answer in sweep[2:]:
        assert isinstance(answer, cg.CutShort)
        assert str(answer) == "the sweep was interrupted before this variation was solved"
    identical(sweep[:2], serial[:2])


def test_an_exception_that_cannot_be_pickled_is_one_failure(pool):
    variations = [{}, {"guess": unpicklable}, {"guess": unbuildable}, {}, {}]
    sweep = cg.sweep(bratu_problem(), variations, METHOD, INTERVALS, executor=pool)
    assert list(sweep.failures) == [1, 2]
    assert "the table is open" in str(sweep[1])
    assert "the table is closed" in str(sweep[2])


@pytest.mark.parametrize("guess", [lambda t: [0.0], (np.zeros(2), lambda t: [0.0])], ids=["callable", "pair"])
def test_a_guess_that_cannot_be_pickled_is_refused_before_any_solve(guess, monkeypatch):
    message = r"the guess of variation 1 cannot be pickled, as it must for other processes: give an array or a module's"
    with pytest.raises(TypeError, match=message):
        cg.sweep(bratu_problem(), [{}, {"guess": guess}], METHOD, INTERVALS, executor=Inline(pytest.fail))


def test_an_executor_that_was_shut_down_is_refused():
    pool = ProcessPoolExecutor(1)
    pool.shutdown()
    with pytest.raises(RuntimeError, match="after shutdown"):
        cg.sweep(bratu_problem(), VARIATIONS, METHOD, INTERVALS, executor=pool)


@pytest.mark.slow
def test_dasks_local_cluster_gives_the_same(serial):
    distributed = pytest.importorskip("distributed")
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=2, processes=True, dashboard_address="localhost:0", silence_logs=50
    )
    with cluster, distributed.Client(cluster) as client:
        identical(cg.sweep(bratu_problem(), VARIATIONS, METHOD, INTERVALS, executor=client.get_executor()), serial)


def test_threads_are_refused():
    with ThreadPoolExecutor(2) as threads, pytest.raises(TypeError, match=r"of processes, .* got .*ThreadPoolExecutor"):
        cg.sweep(bratu_problem(), VARIATIONS, METHOD, INTERVALS, executor=threads)


# what is refused, before anything is solved


@pytest.mark.parametrize("executor", ["x", 2, ProcessPoolExecutor])
def test_what_is_no_executor_is_refused(executor):
    with pytest.raises(TypeError, match=r"a concurrent\.futures\.Executor of processes, .*, got .*(x|2|Process)"):
        cg.sweep(bratu_problem(), VARIATIONS, METHOD, INTERVALS, executor=executor)


@pytest.mark.parametrize("variations", [None, 3, "end", {"end": [1.0]}])
def test_variations_are_a_sequence(variations):
    with pytest.raises(TypeError, match=r"variations must be a sequence of dicts, got .*(None|3|end)"):
        cg.sweep(bratu_problem(), variations, METHOD, INTERVALS)


@pytest.mark.parametrize("variation", [None, 1.0, "end", [1.0]])
def test_a_variation_is_a_dict(variation):
    with pytest.raises(TypeError, match=r"variation 1 must be a dict of start, .*, guess, got .*(None|1\.0|end)"):
        cg.sweep(bratu_problem(), [{}, variation], METHOD, INTERVALS)


@pytest.mark.parametrize(
    ("variation", "error", "message"),
    [
        (
            {"ends": [1.0]},
            ValueError,
            "variation 1 has 'ends'; what can be varied is start, end, parameters, start_v",
        ),
        ({"periodic": True}, ValueError, "variation 1 has 'periodic'"),
        ({"end": [1.0, 2.0]}, ValueError, r"variation 1: end must have 1 component, got 2"),
        ({"start": [None]}, ValueError, "variation 1: start must have None where the problem has it"),
        ({"end": "1.0"}, TypeError, "variation 1: end must be a sequence"),
        ({"t_span": (1.0, 0.0)}, ValueError, "variation 1: t_span must increase"),
        ({"parameters": [1.0, 2.0]}, ValueError, "variation 1: parameters must have 1"),
    ],
)
def test_a_variation_that_does_not_fit_is_named_before_any_solve(variation, error, message, monkeypatch):
    monkeypatch.setattr(PARALLEL, "transcribe", lambda *given: pytest.fail("built before the input was checked"))
    with pytest.raises(error, match=message):
        cg.sweep(bratu_problem(), [{}, variation], METHOD, INTERVALS)


def test_parameters_of_a_problem_without_any_are_refused():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0.0, 1.0), [0.0], [1.0])
    with pytest.raises(ValueError, match="variation 0: the problem has no parameters"):
        cg.sweep(problem, [{"parameters": [1.0]}], METHOD, INTERVALS)


@pytest.mark.parametrize("workers", [False, True])
@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"tol": 2}, ValueError, "tol must be a number between 0 and 1, got 2"),
        ({"tol": 1e-3, "intervals": -4}, ValueError, "intervals must be at least 1, got -4"),
        ({"tol": 1e-3, "intervals": 4.0}, TypeError, "intervals must be a whole number, got 4.0"),
        ({"tol": 1e-3, "method": 4}, TypeError, "method must be a Galerkin, .*, got 4"),
    ],
)
def test_a_refinement_that_does_not_fit_is_refused_before_any_solve(arguments, error, message, workers):
    with pytest.raises(error, match=message):
        cg.sweep(bratu_problem(), [{}], executor=Recorder() if workers else None, **arguments)


def test_a_problem_is_asked_for():
    with pytest.raises(TypeError, match="must be a BoundaryProblem or ControlProblem, got str"):
        cg.sweep("bratu", VARIATIONS, METHOD, INTERVALS)


@pytest.mark.parametrize(
    ("guess", "kind", "message"),
    [
        ([[np.nan] * (INTERVALS + 1)], ValueError, "the guess must be finite"),
        ("path", TypeError, "the guess must be real numbers, got 'path'"),
    ],
)
def test_a_bad_guess_is_kept_as_the_failure_of_its_variation(guess, kind, message):
    sweep = cg.sweep(bratu_problem(), [{"guess": guess}, {}], METHOD, INTERVALS)
    assert isinstance(sweep[0], kind)
    assert message in str(sweep[0])
    assert isinstance(sweep[1], cg.Trajectory)


@pytest.mark.parametrize(
    ("ends", "variations", "exact"),
    [
        ({"end": [None], "end_velocity": [0.0]}, [{"end_velocity": [v]} for v in (-1.0, 0.5)], [-1.0, 0.5]),
        ({"end": [None], "end_momentum": [0.0]}, [{"end_momentum": [v]} for v in (-1.0, 0.5)], [-1.0, 0.5]),
    ],
    ids=["velocity", "momentum"],
)
def test_given_ends_of_any_kind_are_varied(ends, variations, exact):
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], **ends)
    sweep = cg.sweep(problem, variations, cg.Galerkin(2), 3)
    np.testing.assert_allclose(sweep.x[:, 0, -1], exact, rtol=0, atol=1e-14)


@pytest.mark.parametrize("kind", ["start_velocity", "start_momentum"])
def test_paths_of_neighboring_rates_at_an_end_are_on_one_branch(kind):
    problem = cg.BoundaryProblem(BY_NAME["short pendulum"].problem.lagrangian, (0, 1.5), [None], [1.0], **{kind: [0.3]})
    sweep = cg.sweep(problem, [{kind: [rate]} for rate in (0.3, 0.5, 0.7, 0.9)], METHOD, INTERVALS)
    assert not sweep.jumps


@pytest.mark.slow
def test_the_friction_of_a_force_is_varied():
    """x'' + c x' + 4 x = 0 between 1 and 1/2 in two units of time."""
    rates = [0.0, 0.5, 1.0]
    sweep = cg.sweep(DAMPED, [{"parameters": [c]} for c in rates], cg.Galerkin(10), 8)
    assert not sweep.jumps
    for c, x in zip(rates, sweep.x[:, 0, 4], strict=True):
        w = np.sqrt(4 - c**2 / 4)
        sine = (0.5 * np.exp(c) - np.cos(2 * w)) / np.sin(2 * w)
        assert x == pytest.approx(np.exp(-c / 2) * (np.cos(w) + sine * np.sin(w)), abs=1e-12)


@pytest.mark.slow
def test_breakpoints_are_joints_whatever_the_time_span():
    def driven(t, x, v):
        return v[0] ** 2 / 2 + ca.if_else(t < 1.1, 1.0, -2.0) * x[0]

    problem = cg.BoundaryProblem(driven, (0.0, 2.0), [0.0], [1.0], breakpoints=[1.1])
    sweep = cg.sweep(problem, [{}, {"t_span": (0.5, 3.0)}], cg.Galerkin(3), 4)
    for path, span in zip(sweep, ((0.0, 2.0), (0.5, 3.0)), strict=True):
        alone = cg.BoundaryProblem(driven, span, [0.0], [1.0], breakpoints=[1.1])
        np.testing.assert_allclose(path.x, cg.solve(alone, cg.Galerkin(3), mesh=path.t).x, rtol=1e-14)
        assert (path.t[0], path.t[-1]) == span
        assert 1.1 in path.t
    with pytest.raises(ValueError, match=r"variation 1: breakpoints must increase inside of \(1.2, 3.0\)"):
        cg.sweep(problem, [{}, {"t_span": (1.2, 3.0)}], cg.Galerkin(3), 4)


@pytest.mark.parametrize("how", [{"tol": 1e-8}, {"method": cg.Galerkin(2), "intervals": 4}], ids=str)
@pytest.mark.slow
def test_with_a_given_energy_the_times_of_a_variation_choose_its_path(how):
    """A ball is thrown a meter far with the energy 10: flat, or high."""
    throw = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 - 9.81 * x[1], (0, 0.2), [0.0, 0.0], [1.0, 0.0], energy=10.0
    )
    paths = cg.sweep(throw, [{"t_span": (0.0, 0.2)}, {"t_span": (0.0, 1.5)}, {"t_span": (0.0, 0.3)}], **how)
    flat, high = np.sort(np.sqrt(np.roots([9.81**2 / 4, -20, 1])))
    assert [path.t[-1] for path in paths] == pytest.approx([flat, high, flat], rel=1e-8)
