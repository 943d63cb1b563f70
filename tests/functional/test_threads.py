"""What a solve does to the process it runs in: nothing that is left behind, and nothing that is not the user's."""

import sys

import numpy as np

import casadi_galerkin as cg
from casadi_galerkin.functional.threads import without_zero_pivots


def test_casadis_word_of_a_zero_pivot_is_not_heard_where_the_solve_succeeds(capsys):
    """With steps of one, the Hessian of v²/2 - x² by the trapezoidal rule has zeros on its diagonal."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2, (0, 5), [0.0], [1.0])
    path = cg.solve(problem, cg.Galerkin(1, quadrature=cg.trapezoid()), intervals=5)
    np.testing.assert_allclose(path.x[0, 1::2], [1, -1, 1], rtol=0, atol=1e-15)  # x_{i-1} + x_{i+1} = 0
    assert path.morse_index == 2  # eigenvalues -2 cos(k π / 5)
    assert capsys.readouterr().err == ""


def test_everything_else_is_passed_on_and_the_stream_put_back(capsys):
    before = sys.stderr
    with without_zero_pivots():
        with without_zero_pivots():
            pass  # leaves the outer one as it is
        sys.stderr.write("CasADi - WARN")
        sys.stderr.write('ING("LDL factorization has zeros in D") [here]\nanother ')
        sys.stderr.write("line\nand a part")
        sys.stderr.flush()
    assert sys.stderr is before
    assert capsys.readouterr().err == "another line\nand a part"


def test_a_filter_that_was_put_back_is_taken_away_by_the_next_block():
    """As another thread does that redirects the stream within a block and puts it back after its end."""
    before = sys.stderr
    with without_zero_pivots():
        within = sys.stderr
        sys.stderr = before
    sys.stderr = within
    with without_zero_pivots():
        pass
    assert sys.stderr is before
