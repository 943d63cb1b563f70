"""Linear equations solved by QR whatever their units, which differ between conditions and equations of motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca

# CasADi's QR calls a matrix with a pivot below an absolute 1e-12 singular, whatever its units, and gives up
NO_CUTOFF = {"eps": 0.0}


def solve_scaled(matrix: ca.MX, rhs: ca.MX, moving: Sequence[int]) -> ca.MX:
    """Solution Y of A Y = B by QR; see `scaled_solver`."""
    return scaled_solver(matrix, moving)(rhs)


def scaled_solver(matrix: ca.MX, moving: Sequence[int], method: str = "qr") -> Callable[[ca.MX], ca.MX]:
    """The function B -> Y with A Y = B, which may be called several times with the same factors.

    Rows are first divided by the sums of their sizes, since QR rounds small rows away.  The `moving` unknowns are
    values of the path, and the rows of the same numbers are their equations of motion.  All other unknowns, multipliers
    and velocities at the ends, have other units: they are scaled by their entries in the equations of motion, relative
    to those of the moving ones.  QR needs no scaling of columns.
    """
    if matrix.is_empty():
        return lambda rhs: rhs
    sizes, chosen = ca.fabs(matrix), list(moving)
    further = sizes[:, sorted(set(range(matrix.size2())).difference(chosen))]
    rows = ca.sum2(sizes[:, chosen])
    units = ca.mtimes(_inverse(rows[chosen]).T, further[chosen, :])
    scale = _inverse(ca.fmax(rows, ca.mtimes(further, _inverse(units.T))) if further.numel() else rows)

    def scaled(values: ca.MX) -> ca.MX:
        return ca.MX(values.sparsity(), values.nz[:] * scale[values.sparsity().row()])

    own, options = scaled(matrix), {**NO_CUTOFF, "cache": 1} if method == "qr" else {}  # it keeps the last factors
    factors = ca.Linsol("scaled", method, own.sparsity(), options)
    return lambda rhs: factors.solve(own, scaled(rhs))


def _inverse(sums: ca.MX) -> ca.MX:
    """Inverse of each sum, or one where it is zero."""
    return 1 / (sums + (sums == 0))
