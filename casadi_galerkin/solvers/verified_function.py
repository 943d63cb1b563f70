"""A CasADi Function of a solve whose outputs are NaN where the answer does not pass its check."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import casadi as ca
import numpy as np


def verified_function(
    inputs: Mapping[str, ca.MX],
    outputs: Mapping[str, ca.MX],
    verified: ca.MX,
    guesses: Collection[str],
    derivatives: bool = True,
) -> ca.Function:
    """The Function from inputs to outputs, by name; where it is not verified, the answer and its derivatives are NaN.

    An input that a call leaves out is NaN, too, which no check passes; but a guess is then zero.  Without
    `derivatives` CasADi refuses to differentiate it.
    """
    factor = ca.if_else(verified, 1.0, np.nan)  # the branches of if_else itself would have derivatives of zero
    checked = [factor * value for value in outputs.values()]
    left_out = [0.0 if name in guesses else np.nan for name in inputs]
    enabled = dict.fromkeys(("enable_forward", "enable_reverse", "enable_jacobian"), derivatives)
    options = {"default_in": left_out, **enabled}
    return ca.Function("solution", list(inputs.values()), checked, list(inputs), list(outputs), options)
