"""Linear equations solved by QR whatever their units, which differ between conditions and equations of motion."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

# CasADi's QR calls a matrix with a pivot below an absolute 1e-12 singular, whatever its units, and gives up
NO_CUTOFF = {"eps": 0.0}
CORRECTION = 1e-3  # largest step of a refinement that is taken, over the solution


def solve_scaled(matrix: ca.MX, rhs: ca.MX, moving: Sequence[int], method: str = "qr", refined: bool = False) -> ca.MX:
    """Solution Y of A Y = B.  Rows are first divided by the sums of their sizes, since QR rounds small rows away.

    If it is `refined` by one step, small components of Y are as accurate as large ones: QR mixes the rows of both.
    A step that is no small part of Y is that of a matrix that is singular up to rounding, and is not taken.

    The `moving` unknowns are values of the path, and the rows of the same numbers are their equations of motion.  All
    other unknowns, multipliers and velocities at the ends, have other units: they are scaled by their entries in the
    equations of motion, relative to those of the moving ones.  QR needs no scaling of columns.
    """
    if matrix.is_empty():
        return rhs
    sizes, chosen = ca.fabs(matrix), list(moving)
    further = sizes[:, sorted(set(range(matrix.size2())).difference(chosen))]
    rows = ca.sum2(sizes[:, chosen])
    units = ca.mtimes(_inverse(rows[chosen]).T, further[chosen, :])
    scale = _inverse(ca.fmax(rows, ca.mtimes(further, _inverse(units.T))) if further.numel() else rows)
    a, b = (ca.MX(a.sparsity(), a.nz[:] * scale[a.sparsity().row()]) for a in (matrix, rhs))
    options = {**NO_CUTOFF, "cache": 1} if method == "qr" else {}  # the factors are those of the last matrix
    factors = ca.Linsol("scaled", method, a.sparsity(), options)
    y = factors.solve(a, b)
    if not refined:
        return y
    step = factors.solve(a, b - ca.mtimes(a, y))
    return y + ca.if_else(ca.norm_inf(ca.vec(step)) <= CORRECTION * ca.norm_inf(ca.vec(y)), step, 0)


def _inverse(sums: ca.MX) -> ca.MX:
    """Inverse of each sum, or one where it is zero."""
    return 1 / (sums + (sums == 0))
