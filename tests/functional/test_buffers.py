"""Functions on arrays leave the streams of a process as they found them, whatever CasADi warns of."""

import sys
from concurrent.futures import ThreadPoolExecutor

import casadi as ca

from casadi_galerkin.functional.buffers import Evaluator


def singular():
    """A Function whose evaluation makes CasADi warn: LDL of a matrix with a zero pivot."""
    a = ca.MX.sym("a", 2, 2)
    return Evaluator(ca.Function("singular", [a], [ca.solve(a, ca.DM([1.0, 1.0]), "ldl")]))


def test_a_warning_of_casadi_stays_away_and_other_words_appear(capfd):
    singular()([0.0, 0.0, 0.0, 0.0])
    print("a user's own line", file=sys.stderr)
    assert capfd.readouterr().err == "a user's own line\n"


def test_threads_that_evaluate_at_once_leave_stderr_as_it_was():
    before, evaluators = sys.stderr, [singular() for _ in range(4)]
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda evaluator: [evaluator([0.0, 0.0, 0.0, 0.0]) for _ in range(50)], evaluators))
    assert sys.stderr is before
