"""Linear equations solved by QR in any units: conditions and equations of motion differ in theirs."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

# CasADi's QR calls a matrix with a pivot below an absolute 1e-12 singular, whatever its units, and gives up
NO_CUTOFF = {"eps": 0.0}


def solve_scaled(matrix: ca.MX, rhs: ca.MX, moving: Sequence[int], method: str = "qr") -> ca.MX:
    """Solution Y of A Y = B.  Rows are first divided by the sums of their sizes, since QR rounds small rows away.

    The unknowns that move a path have equations of motion, the rows of the same numbers.  Multipliers and velocities of
    ends have other units: they are measured by what they do to equations of motion beside what moves the path does.
    QR needs no scales of columns.
    """
    sizes, chosen = ca.fabs(matrix), list(moving)
    further = sizes[:, sorted(set(range(matrix.size2())).difference(chosen))]
    rows = ca.sum2(sizes[:, chosen])
    units = ca.mtimes(_inverse(rows[chosen]).T, further[chosen, :])
    scale = _inverse(ca.fmax(rows, ca.mtimes(further, _inverse(units.T))) if further.numel() else rows)
    scaled = (ca.MX(a.sparsity(), a.nz[:] * scale[a.sparsity().row()]) for a in (matrix, rhs))
    return ca.solve(*scaled, method, NO_CUTOFF if method == "qr" else {})


def _inverse(sums: ca.MX) -> ca.MX:
    """One over each of some sums, one where it is zero."""
    return 1 / (sums + (sums == 0))
