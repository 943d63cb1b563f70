"""How the cost varies about an optimum, and what the solver left of it: found when it is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from casadi_galerkin.solution.trajectory import SecondVariation


@dataclass(frozen=True)
class Left:
    """How far a solver may have left an optimum from where it should be.

    Attributes
    ----------
    components : (d,), how far each component of the path
    durations : how far free durations, relative to these
    cost : by how much the cost
    """

    components: np.ndarray
    durations: float
    cost: float


class CostVariation(SecondVariation, Protocol):
    """How the cost varies about an optimum."""

    def left(self) -> Left:
        """What the solver has left."""
