"""Sizes of all terms of an expression, which its value does not show where they cancel."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from casadi_galerkin.problems.instructions import calls_functions, replayed


def sizes_of_terms(value: ca.SX, symbols: Sequence[ca.SX]) -> ca.SX:
    """Sums of |∂value/∂w| |w| over the symbols, constants and intermediate results w that an expression is made of.

    The rounding of each entry of the expression is some eps of its sum: each w is rounded once.  Terms that are not
    finite, as of sqrt(p) at p = 0, are left out.  What a Function that the expression calls makes of its arguments is
    not seen, and the sums are then the sizes of the values.
    """
    f, errors = ca.Function("expression", symbols, [ca.densify(value)]), list[ca.SX]()
    if calls_functions(f):
        return ca.fabs(ca.densify(value))

    def with_error(result: ca.SX) -> ca.SX:
        errors.append(ca.SX.sym("error"))
        return result * (1 + errors[-1])

    (entries,) = replayed(f, ca.SX, [symbol.nonzeros() for symbol in symbols], with_error)
    rounded = ca.vertcat(*entries)
    relative = ca.vertcat(*errors)
    sizes = ca.fabs(ca.substitute(ca.jacobian(rounded, relative), relative, ca.DM.zeros(len(errors))))
    return ca.densify(ca.sum2(ca.if_else(sizes < np.inf, sizes, 0.0)))
