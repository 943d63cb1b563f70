"""The linear algebra of a Newton iteration: LDLᵀ of regularized conditions against QR."""

import casadi as ca
import numpy as np
import pytest
from constrained import of_rods, rods, two_masses

import casadi_galerkin as cg
from casadi_galerkin.solvers.linear_solver import METHODS, factors_of, negative_pivots

SAME = 1e-6  # of two steps: what is left of the softening after one refinement, measured at 1e-8 at most


def chain(count):
    """Unit masses below one another on unit rods, and the positions of given angles."""

    def place(angles):
        return np.cumsum([np.sin(angles), -np.cos(angles)], axis=1).T.ravel()

    def lengths(t, x):
        places = ca.horzcat(ca.DM.zeros(2, 1), ca.reshape(x, 2, count))
        return (ca.sum1((places[:, 1:] - places[:, :-1]) ** 2).T - 1) / 2

    first, last = 0.3 * np.cos(0.7 * np.arange(count)), 0.4 * np.cos(0.5 * np.arange(count) + 0.3)
    lagrangian = lambda t, x, v: ca.dot(v, v) / 2 - 10 * ca.sum1(x[1::2])  # noqa: E731
    problem = cg.BoundaryProblem(lagrangian, (0, 0.5), place(first), place(last), constraint=lengths)
    return problem, lambda t: place(first + (last - first) * t / 0.5)


def two_rods():
    """Two masses on rods, with the guess that turns their angles evenly."""
    first, last = np.array([1.0, 1.2]), np.array([0.34, 0.675])
    problem = cg.BoundaryProblem(two_masses, (0, 0.5), of_rods(first), of_rods(last), constraint=rods)
    return problem, lambda t: of_rods(first + (last - first) * t / 0.5)


@pytest.mark.parametrize(
    ("case", "intervals"), [(two_rods(), 6), (two_rods(), 100), (chain(20), 6)], ids=["short", "long", "20 rods"]
)
def test_a_step_with_regularized_conditions_is_that_of_qr(case, intervals):
    problem, guess = case
    transcription = cg.transcribe(problem, cg.Galerkin(4), intervals)
    data = transcription.data(transcription.mesh)
    unknowns = transcription.unknowns(transcription.guess_on_mesh(guess, transcription.mesh).values.T, data)
    derivatives, linear = transcription.functional.function("derivatives"), transcription.stationarity.linear_solver
    given = (*derivatives(unknowns, *data)[:2], np.concatenate((unknowns, *data[:2])))
    steps = [linear.solving("newton_step", method)(*given)[0] for method in METHODS]
    ldl, qr = (np.array(step).ravel() for step in steps)
    np.testing.assert_allclose(ldl, qr, rtol=0, atol=SAME * np.max(np.abs(qr)))


@pytest.mark.slow
def test_a_long_chain_of_rods_needs_no_qr():
    problem, guess = chain(20)
    transcription = cg.transcribe(problem, cg.Galerkin(4), 6)
    path = transcription.solve(guess=guess)
    assert path.morse_index == 0
    tuned = transcription.solve(guess=path, solver=cg.newton.with_options(linear_solver="ldl"))
    np.testing.assert_allclose(tuned.x, path.x, rtol=0, atol=1e-11)


def test_the_residual_of_what_is_not_a_number_is_not_one():
    problem, guess = two_rods()
    transcription = cg.transcribe(problem, cg.Galerkin(4), 6)
    data = transcription.data(transcription.mesh)
    unknowns = transcription.unknowns(transcription.guess_on_mesh(guess, transcription.mesh).values.T, data)
    with transcription.stationarity.linearization() as at:
        at.newton_step(unknowns, data)
        unknowns[0] = np.nan
        residual = at.verification(unknowns, data)[2]
    assert np.isnan(residual)


@pytest.mark.parametrize(("matrix", "negative"), [([[0, 1], [1, 0]], 1), ([[0, 2, 1], [2, 0, 1], [1, 1, -1]], 2)])
def test_negative_eigenvalues_are_counted_where_a_pivot_is_zero(matrix, negative):
    dense = ca.densify(ca.DM(matrix))
    assert np.count_nonzero(np.linalg.eigvalsh(matrix) < 0) == negative
    assert negative_pivots(dense, factors_of(dense.sparsity())) == negative
