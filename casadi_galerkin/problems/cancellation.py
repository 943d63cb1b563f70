"""Sizes of all terms of an expression, which its value does not show where they cancel."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np


def sizes_of_terms(value: ca.SX, symbols: Sequence[ca.SX]) -> ca.SX:
    """Sums of |∂value/∂w| |w| over the symbols, constants and intermediate results w that an expression is made of.

    The rounding of each entry of the expression is some eps of its sum: each w is rounded once.  Terms that are not
    finite, as of sqrt(p) at p = 0, are left out.  What a Function that the expression calls makes of its arguments is
    not seen, and the sums are then the sizes of the values.
    """
    f, errors = ca.Function("expression", symbols, [ca.densify(value)]), list[ca.SX]()
    if any(f.instruction_id(k) == ca.OP_CALL for k in range(f.n_instructions())):
        return ca.fabs(ca.densify(value))
    work, rounded = [ca.SX()] * f.sz_w(), ca.SX(*f.size_out(0))
    for k in range(f.n_instructions()):
        operation, source, target = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            rounded[target[1]] = work[source[0]]
            continue
        if operation == ca.OP_CONST:
            result = ca.SX(f.instruction_constant(k))
        elif operation == ca.OP_INPUT:
            result = symbols[source[0]].nz[source[1]]
        elif len(source) == 1:
            result = ca.SX.unary(operation, work[source[0]])
        else:
            result = ca.SX.binary(operation, work[source[0]], work[source[1]])
        errors.append(ca.SX.sym("error"))
        work[target[0]] = result * (1 + errors[-1])
    relative = ca.vertcat(*errors)
    sizes = ca.fabs(ca.substitute(ca.jacobian(rounded, relative), relative, ca.DM.zeros(len(errors))))
    return ca.densify(ca.sum2(ca.if_else(sizes < np.inf, sizes, 0.0)))
