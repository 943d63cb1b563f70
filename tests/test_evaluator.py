from contextlib import nullcontext

import casadi as ca
import numpy as np
import pytest

import casadi_galerkin as cg
from casadi_galerkin import threads
from casadi_galerkin.stages import Chain, Evaluator


def test_an_evaluation_that_aborts_gives_nan_not_the_answer_before_it():
    """CasADi's QR gives up on a pivot below 1e-12 and leaves the output as it was."""
    matrix, rhs = ca.MX.sym("a", 2, 2), ca.MX.sym("rhs", 2)
    solve = Evaluator(ca.Function("solve", [matrix, rhs], [ca.solve(matrix, rhs, "qr")]))
    np.testing.assert_allclose(solve(np.array([2.0, 0.0, 0.0, 1.0]), np.array([6.0, 5.0]))[0], [3.0, 5.0], rtol=1e-15)
    assert np.isnan(solve(np.array([2.0, 0.0, 0.0, 1e-14]), np.array([6.0, 5.0]))[0]).all()
    np.testing.assert_allclose(solve(np.array([3.0, 0.0, 0.0, 1.0]), np.array([6.0, 5.0]))[0], [2.0, 5.0], rtol=1e-15)


class Look:
    """A stage that looks at the number of threads, and may fail."""

    inputs = ()

    def __init__(self, fails):
        self.seen, self.fails = [], fails

    def run(self):
        self.seen.append(threads.count())
        if self.fails:
            raise RuntimeError("failed on purpose")


@pytest.mark.parametrize("fails", [False, True])
def test_stages_run_on_one_thread_and_leave_as_many_as_they_found(fails):
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2, (0.0, 1.0), [0.0], [1.0])
    transcription = cg.transcribe(problem, cg.Galerkin(2), 2)
    point = transcription.critical_point()
    before, look = threads.count(), Look(fails)
    chain = Chain(transcription.system.algebra.workspace, [look], [])
    with pytest.raises(RuntimeError) if fails else nullcontext():
        chain(point.solution.unknowns, point.data)
    assert look.seen == [1]
    assert threads.count() == before
