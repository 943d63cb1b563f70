"""Initial problems: what does not fit is refused, with what came and what was expected."""

import numpy as np
import pytest
from scenes import pendulum

import casadi_galerkin as cg


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({}, "give either momentum or velocity, got momentum=None and velocity=None"),
        ({"momentum": [1.0], "velocity": [1.0]}, r"got momentum=\[1.0\] and velocity=\[1.0\]"),
        ({"momentum": [1.0, 2.0]}, r"momentum must have 1 component, got 2"),
        ({"velocity": [1.0, 2.0]}, r"velocity must have 1 component, got 2"),
        ({"momentum": [None]}, "momentum must be all numbers"),
        ({"start": [np.nan], "momentum": [1.0]}, r"start\[0\] must be finite"),
        ({"momentum": [1.0], "t_span": (1, 0)}, "t_span must increase"),
        ({"momentum": [1.0], "force": lambda t, x, v: [1, 2]}, "force must return a vector of length 1, got shape"),
    ],
)
def test_bad_input_is_named(changes, message):
    given = {"lagrangian": pendulum, "t_span": (0, 1), "start": [1.0]} | changes
    with pytest.raises(ValueError, match=message):
        cg.InitialProblem(**given)
