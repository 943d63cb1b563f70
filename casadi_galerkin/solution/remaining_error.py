"""The error that a solver has left in an optimum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


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
