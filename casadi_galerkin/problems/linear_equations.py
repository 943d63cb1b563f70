"""Linear equations solved by QR in any units: conditions and equations of motion differ in theirs."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

# CasADi's QR calls a matrix with a pivot below an absolute 1e-12 singular, whatever its units, and gives up
NO_CUTOFF = {"eps": 0.0}


def solve_scaled(matrix: ca.MX, rhs: ca.MX, moving: Sequence[int] | slice, method: str = "qr") -> ca.MX:
    """Solution Y of A Y = B.  Rows are first divided by the sums of their sizes, since QR rounds small rows away.

    Where a row has entries for unknowns that move a path, only these count in its sum.  Multipliers have other units:
    with them in the sums, the entries that move a path could become too small.  QR needs no scales of columns.
    """
    sizes = ca.fabs(matrix)
    rows = ca.sum2(sizes[:, moving])
    scale = ca.diag(1 / (rows + (rows == 0) * ca.sum2(sizes)))
    return ca.solve(ca.mtimes(scale, matrix), ca.mtimes(scale, rhs), method, NO_CUTOFF if method == "qr" else {})
