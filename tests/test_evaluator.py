import casadi as ca
import numpy as np

from casadi_galerkin.stages import Evaluator


def test_an_evaluation_that_aborts_gives_nan_not_the_answer_before_it():
    """CasADi's QR gives up on a pivot below 1e-12 and leaves the output as it was."""
    matrix, rhs = ca.MX.sym("a", 2, 2), ca.MX.sym("rhs", 2)
    solve = Evaluator(ca.Function("solve", [matrix, rhs], [ca.solve(matrix, rhs, "qr")]))
    np.testing.assert_allclose(solve(np.array([2.0, 0.0, 0.0, 1.0]), np.array([6.0, 5.0]))[0], [3.0, 5.0], rtol=1e-15)
    assert np.isnan(solve(np.array([2.0, 0.0, 0.0, 1e-14]), np.array([6.0, 5.0]))[0]).all()
    np.testing.assert_allclose(solve(np.array([3.0, 0.0, 0.0, 1.0]), np.array([6.0, 5.0]))[0], [2.0, 5.0], rtol=1e-15)
