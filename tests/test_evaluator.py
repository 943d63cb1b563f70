"""Evaluation without conversion: failures inside CasADi must not pass for answers."""

import casadi as ca
import numpy as np

from casadi_galerkin.engines import Evaluator
from casadi_galerkin.interval import NO_CUTOFF


def linear(options):
    matrix, rhs = ca.MX.sym("matrix", 2, 2), ca.MX.sym("rhs", 2)
    return Evaluator(ca.Function("linear", [matrix, rhs], [ca.solve(matrix, rhs, "qr", options)]))


def test_a_failed_evaluation_gives_no_numbers_and_the_next_one_is_right():
    solve = linear({})
    assert np.isnan(solve(np.array([1.0, 2.0, 2.0, 4.0]), np.ones(2))[0]).all()
    assert solve(np.array([2.0, 0.0, 0.0, 4.0]), np.ones(2))[0].tolist() == [0.5, 0.25]


def test_small_units_do_not_make_a_matrix_singular():
    (x,) = linear(NO_CUTOFF)(np.array([1e-20, 0.0, 0.0, 2e-20]), np.ones(2))
    np.testing.assert_allclose(x, [1e20, 5e19], rtol=1e-15)
