"""What is kept between solves of one numbering does not leak from one solve into another."""

import os
import signal
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np
import pytest
from control_problems import cart_pole
from paths import script

import casadi_galerkin as cg
from casadi_galerkin.functional.buffers import fork_waits, interrupts_raised

state = script("state")


def swinging(gravity):
    return cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + gravity * ca.cos(x[0]), (0.0, 1.0), [0.0], [1.0])


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs a timer signal")
@pytest.mark.filterwarnings("ignore:Exception ignored in PyObject_HasAttrString")  # from Python 3.13 on, an interrupt
def test_solves_after_an_interrupt_are_right_whatever_it_stopped():
    stopped, wrong = state.interrupts(150, seed=1)
    assert stopped > 30
    assert wrong == 0


@pytest.fixture
def is_interrupted():
    """Whether a solve that a signal meets after some seconds ends with one of some exceptions."""

    def interrupt(*_):
        raise KeyboardInterrupt

    def solved(solve, seconds, *kinds):
        try:
            signal.setitimer(signal.ITIMER_REAL, seconds)
            solve()
            signal.setitimer(signal.ITIMER_REAL, 0)  # where the solve was faster
        except kinds:
            return True
        return False

    before = signal.signal(signal.SIGALRM, interrupt)
    yield solved
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs a timer signal")
@pytest.mark.parametrize("solver", [cg.ipopt, cg.fatrop])
def test_an_optimization_that_was_interrupted_says_so_and_is_right_the_next_time(solver, is_interrupted):
    """CasADi's own code drops an interrupt now and then."""
    program = cg.transcribe(cart_pole(), cg.Galerkin(5), 30)
    paths = [program.solve(solver=solver) for _ in range(3)]
    seconds, stopped = min(path.solve_seconds for path in paths), 0  # of one that nothing else has held up
    for part in np.linspace(0.05, 0.4, 4):
        stopped += is_interrupted(lambda: program.solve(solver=solver), part * seconds, KeyboardInterrupt)
        again = program.solve(solver=solver).polynomial.values
        np.testing.assert_array_equal(again, paths[0].polynomial.values)
    assert stopped >= 2


@pytest.mark.parametrize("error", [RuntimeError("call for 'last' failed: KeyboardInterrupt"), SystemError("C API")])
def test_an_interrupt_that_a_solver_makes_another_error_is_raised(error):
    with pytest.raises(KeyboardInterrupt), interrupts_raised():
        raise error from KeyboardInterrupt()


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs a timer signal")
def test_ipopt_on_a_boundary_problem_is_interrupted_and_not_taken_for_failed(is_interrupted):
    """CasADi's own Python code drops some interrupts, outside of IPOPT, or makes SystemErrors of them."""
    swings = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), (0.0, 10.0), [0.0], [3.0])
    transcription = cg.transcribe(swings, cg.Galerkin(6), 400)
    paths = [transcription.solve(solver=cg.minimizer) for _ in range(4)]
    seconds, stopped = min(path.solve_seconds for path in paths[1:]), 0
    for part in np.linspace(0.1, 0.4, 4):  # early, because a solve may be faster than those that were timed
        stopped += is_interrupted(
            lambda: transcription.solve(solver=cg.minimizer), part * seconds, KeyboardInterrupt, SystemError
        )
        again = transcription.solve(solver=cg.minimizer).polynomial.values
        np.testing.assert_array_equal(again, paths[0].polynomial.values)
    assert stopped >= 2


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs forks")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_process_forked_beside_a_solving_thread_solves_too():
    assert state.forks(2) == (0, 0)


@pytest.mark.parametrize("problem", [swinging(9.81), cart_pole()], ids=["boundary", "control"])
def test_a_fork_waits_for_what_is_built(monkeypatch, problem):
    """What builds a Function may hold one of CasADi's locks, and a forked child would find it taken for ever."""
    free, made = [], ca.Function.__init__

    def taken():
        free.append(fork_waits.acquire(blocking=False))
        if free[-1]:
            fork_waits.release()

    def make(self, *arguments):
        with ThreadPoolExecutor(1) as another:
            another.submit(taken).result()
        made(self, *arguments)

    monkeypatch.setattr(ca.Function, "__init__", make)
    cg.transcribe(problem, cg.Galerkin(3), 4).solve()
    assert free
    assert not any(free)


def test_threads_may_share_transcriptions():
    assert state.threads(80) == 0


def swing(gravity):
    return cg.transcribe(swinging(gravity), cg.Galerkin(4), 20)


def test_solves_in_threads_give_the_same_as_one_after_the_other():
    gravities = np.linspace(1.0, 3.0, 16)
    alone = [swing(gravity).solve().action for gravity in gravities]
    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(lambda gravity: swing(gravity).solve().action, gravities))
    np.testing.assert_array_equal(together, alone)


def test_transcriptions_of_one_layout_can_be_solved_in_turn():
    first, second = swing(1.0), swing(2.0)
    expected = [first.solve(), second.solve()]
    again = [first.solve(), second.solve()]
    for before, after in zip(expected, again, strict=True):
        np.testing.assert_array_equal(after.x, before.x)
        assert (after.action, after.morse_index) == (before.action, before.morse_index)
    assert expected[0].action != expected[1].action


def test_a_rescue_by_ipopt_is_the_same_the_second_time():
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), (0.0, 20.0), [0.0], [3.0])
    tr = cg.transcribe(problem, cg.Galerkin(6), 80)
    first, _, second = tr.solve(), tr.solve(end=[2.5]), tr.solve()
    assert "IPOPT" in first.solver
    np.testing.assert_array_equal(second.x, first.x)
    assert (second.solver, second.iterations) == (first.solver, first.iterations)


QUADRATIC = {
    "mass and spring": lambda t, x, v, p: v[0] ** 2 + v[1] ** 2 / 2 - p[0] * x[0] ** 2 - x[1] * x[0],
    "depends on time": lambda t, x, v, p: (1 + t) * v[0] ** 2 + v[1] ** 2 + p[0] * ca.cos(t) * x[0] * x[1] - x[0],
    "magnetic": lambda t, x, v, p: ca.dot(v, v) / 2 + p[0] * (x[0] * v[1] - x[1] * v[0]),
    "indefinite": lambda t, x, v, p: v[0] * v[1] - p[0] * x[0] * x[1],
}


@pytest.mark.parametrize("name", QUADRATIC)
def test_a_quadratic_lagrangian_takes_its_hessian_from_the_data_of_each_solve(name):
    def problem(p):
        return cg.BoundaryProblem(QUADRATIC[name], (0.0, 1.5), [0.0, 1.0], [1.0, -1.0], parameters=[p])

    def other(gravity):
        return cg.BoundaryProblem(
            lambda t, x, v, p: ca.dot(v, v) * p[0] + x[0] * x[1] + gravity * x[0] * v[1],
            (0.0, 1.5),
            [0.0, 1.0],
            [1.0, -1.0],
            parameters=[1.0],
        )

    def path_of(p, mesh):
        tr = cg.transcribe(problem(p), cg.Galerkin(3), mesh=mesh)
        data = tr.data(tr.mesh)
        gradient, hessian = (np.array(f(np.zeros(tr.numbering.free), *data)) for f in (tr.gradient, tr.hessian))
        return tr.emb(-np.linalg.solve(hessian, gradient).ravel(), data).values

    even, graded = np.linspace(0, 1.5, 6), 1.5 * np.linspace(0, 1, 6) ** 2
    tr, between = cg.transcribe(problem(0.3), cg.Galerkin(3), 5), cg.transcribe(other(9.81), cg.Galerkin(3), 5)
    for p, mesh in ((0.3, even), (0.7, even), (0.7, graded), (0.3, even)):
        path = tr.solve(parameters=[p], mesh=mesh)
        assert path.iterations == 2
        np.testing.assert_allclose(path.polynomial.values, path_of(p, mesh), rtol=0, atol=1e-12)
        between.solve()


def test_the_joints_that_paths_and_transcriptions_share_cannot_be_written_to():
    tr = swing(1.0)
    path = tr.solve()
    for joints in (tr.mesh, path.t):
        with pytest.raises(ValueError, match="read-only"):
            joints[3] += 0.01
    np.testing.assert_array_equal(tr.solve().t, np.linspace(0.0, 1.0, 21))
