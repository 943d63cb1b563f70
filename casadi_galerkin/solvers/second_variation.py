"""The second variation of the action: the direction of smallest curvature (0 at conjugate points), and Morse index."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.functional.numbering import Data
from casadi_galerkin.solvers.linear_solver import factors_of, negative_pivots
from casadi_galerkin.solvers.stationarity import Linearization, Stationarity, joined

SINGULAR = 1e-12  # second variation over the sum of its terms below which the Hessian is called singular
ROUNDING_OF_QUOTIENT = 10 * EPS  # rounding of zᵀ∇²S y by that of the entries, over |z|ᵀ|∇²S||y|
# least terms at the points over the assembled |yᵀ∇²S y|; families at most 7e-7, regular paths 1 - 1e-5
LEAST_POINTWISE_TERMS = 1e-3


def smallest_curvature(at: Linearization, unknowns: np.ndarray, data: Data) -> tuple[np.ndarray, float]:
    """Direction of the smallest second variation relative to the sizes of its terms, and that; 0 at a conjugate point.

    Three inverse iterations, weighted by the sizes of the Hessian's rows, find the direction y; the pointwise sums
    give its quotient yᵀ∇²S y / Σ |z|ᵀ|∇²L̂||z|, which does not depend on scales or on the mesh.  Where a free
    component enters L by its velocity alone, y is a constant, and the terms at the points are roundoff without
    cancellation, so that the quotient says nothing: they are then far smaller than yᵀ∇²S y from the assembled Hessian.
    `at` is left with the Hessian at `unknowns`.

    With a force the matrix is not symmetric: y is taken against the same direction of the transposed matrix.
    """
    if len(unknowns) == 0:
        return unknowns, np.inf  # nothing can vary
    at.relinearize(unknowns, data)
    linear, symmetric = at.stationarity.linear_solver, at.stationarity.functional.symmetric
    sizes, rhs = (np.array(a).ravel() for a in linear.sizes(joined(unknowns, data)))
    measured = np.where(np.isfinite(sizes), sizes, 0.0)  # not the multipliers
    entries = ca.fabs(ca.DM(linear.sparsity, at.matrix.tolist()))
    weights = np.array(ca.mtimes(entries, measured)).ravel() / sizes
    y = z = force = np.zeros(len(unknowns))
    for _ in range(3):
        (solved,) = at.solve(rhs)
        (other,) = (solved,) if symmetric else at.solve(weights * solved, transposed=True)
        with np.errstate(over="ignore", invalid="ignore"):
            largest, most = (np.max(np.abs(a / sizes)) for a in (solved, other))
        if not np.isfinite(largest + most):
            return y, 0.0  # singular to the last digit
        if min(largest, most) == 0:
            return y, np.inf  # all positions follow from the conditions on the ends
        y, z, force = solved / largest, other / most, rhs / largest  # ∇²S y = -force
        rhs = weights * z
    signed, positive = (float(value[0]) for value in at.evaluate("curvature", unknowns, data, z, y))
    assembled = abs(z @ force)
    if not (math.isfinite(signed) and LEAST_POINTWISE_TERMS * assembled < positive < math.inf):
        return y, 0.0
    path = slice(linear.numbering.positions)
    terms = 0.0 if symmetric else float(ca.bilin(entries[path, path], abs(z[path]), abs(y[path])))
    return y, abs(signed) / positive if assembled > ROUNDING_OF_QUOTIENT * terms else 0.0


def smallest_second_variation(stationarity: Stationarity, unknowns: np.ndarray, data: Data) -> float:
    """Smallest second variation relative to the sizes of its terms, as `smallest_curvature` finds it."""
    with stationarity.linearization() as at:
        return smallest_curvature(at, unknowns, data)[1]


def negative_eigenvalues(stationarity: Stationarity, unknowns: np.ndarray, data: Data) -> int | None:
    """Morse index: number of negative eigenvalues of the Hessian.

    None where the kinetic energy is indefinite by structure, such as v_0 v_1: the index then grows without bound
    as the mesh is refined, and LDLᵀ without pivoting does not find it.  None as well where the matrix is no Hessian, or
    not finite.

    With multipliers it is the index of the second variation among the directions that keep the conditions.
    """
    functional, linear = stationarity.functional, stationarity.linear_solver
    if not (functional.pointwise.kinetic and functional.symmetric):
        return None
    if len(unknowns) == 0:
        return 0
    with stationarity.linearization() as at:
        at.relinearize(unknowns, data)
        if not np.isfinite(at.matrix).all():
            return None
        regularized = linear.regularized(ca.DM(linear.sparsity, at.matrix.tolist()))
        factors = at.keep("inertia", lambda: factors_of(regularized.sparsity()))  # a Linsol keeps what it factored last
        return negative_pivots(regularized, factors) - linear.numbering.multipliers  # each condition adds one
