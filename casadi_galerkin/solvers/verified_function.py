"""A solve as a CasADi Function, which checks its own answer."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import casadi as ca
import numpy as np


def verified_function(
    inputs: Mapping[str, ca.MX], outputs: Mapping[str, ca.MX], verified: ca.MX, guesses: Collection[str]
) -> ca.Function:
    """The Function from inputs to outputs, by name, whose outputs are NaN where the answer is not verified.

    An input that a call leaves out is NaN, too, which no check passes; but a guess is then zero.
    """
    checked = [ca.if_else(verified, value, np.nan) for value in outputs.values()]
    left_out = [0.0 if name in guesses else np.nan for name in inputs]
    options = {"default_in": left_out}
    return ca.Function("solution", list(inputs.values()), checked, list(inputs), list(outputs), options)
