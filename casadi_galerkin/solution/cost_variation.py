"""Second variation of the cost at an optimum, and the error that the solver has left; computed on demand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from casadi_galerkin.solution.trajectory import SecondVariation


@dataclass(frozen=True)
class RemainingError:
    """Estimated distance of the point where a solver stopped from the optimum.

    Attributes
    ----------
    components : (d,), error of each component of the path
    durations : largest relative error of a free duration
    cost : error of the cost
    """

    components: np.ndarray
    durations: float
    cost: float


class CostVariation(SecondVariation, Protocol):
    """Second variation of the cost at an optimum."""

    def remaining_error(self) -> RemainingError:
        """Estimate the error that the solver has left."""
