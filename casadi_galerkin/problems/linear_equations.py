"""Linear equations solved by QR whatever their units, which differ between conditions and equations of motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import casadi as ca

# CasADi's QR calls a matrix with a pivot below an absolute 1e-12 singular, whatever its units, and gives up
NO_CUTOFF = {"eps": 0.0}
Solve = Callable[[ca.MX], ca.MX]  # of a matrix A: B -> solution Y of A Y = B


def scaled_solve(matrix: ca.MX, moving: Sequence[int], method: str = "qr") -> Solve:
    """Solve with a matrix whose rows are first divided by the sums of their sizes, since QR rounds small rows away.

    The `moving` unknowns are values of the path, and the rows of the same numbers are their equations of motion.  All
    other unknowns, multipliers and velocities at the ends, have other units: they are scaled by their entries in the
    equations of motion, relative to those of the moving ones.  QR needs no scaling of columns.
    """
    if matrix.is_empty():
        return lambda rhs: rhs
    sizes, chosen = ca.fabs(matrix), list(moving)
    further = sizes[:, sorted(set(range(matrix.size2())).difference(chosen))]
    rows = ca.sum2(sizes[:, chosen])
    units = ca.mtimes(_inverse(rows[chosen]).T, further[chosen, :])
    scale = _inverse(ca.fmax(rows, ca.mtimes(further, _inverse(units.T))) if further.numel() else rows)
    options = {**NO_CUTOFF, "cache": 1} if method == "qr" else {}  # the factors are those of the last matrix
    factors = ca.Linsol("scaled", method, matrix.sparsity(), options)

    def scaled(a: ca.MX) -> ca.MX:
        return ca.MX(a.sparsity(), a.nz[:] * scale[a.sparsity().row()])

    return partial(lambda a, rhs: factors.solve(a, scaled(rhs)), scaled(matrix))


def _inverse(sums: ca.MX) -> ca.MX:
    """Inverse of each sum, or one where it is zero."""
    return 1 / (sums + (sums == 0))
