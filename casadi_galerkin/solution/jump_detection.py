"""Detection of jumps of a function of time, by comparing its values with the integral of its derivative.

Each quadrature point represents a part of the interval, as long as its weight.  Over this part, from a to b,

    f(b) - f(a) = ∫ df/dt dt

holds where f is smooth; the difference of both sides is a jump.  Since its time within the part is unknown, the
quadrature of f may have an error of the jump times b - a.  Two degrees whose points lie on the same sides of the jump
make the same error, which their difference does not show.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.piecewise_polynomial import times_at
from casadi_galerkin.calculus.quadrature import Quadrature, gauss
from casadi_galerkin.calculus.roundoff import EPS

JOINT_MARGIN = EPS**0.5  # part of an interval beside a joint that is left out, because a jump there is one at the joint
RATE_RULE = gauss(4)  # rule for df/dt over a part


class JumpDetector:
    """Sampling of a function at K times, with both ends, in the part of the interval of each of the r points of a rule.

    Parameters
    ----------
    mesh : (N + 1,), joints
    rule : Quadrature
    """

    def __init__(self, mesh: np.ndarray, rule: Quadrature) -> None:
        self._mesh = mesh
        self._edges = np.clip(np.append(0.0, np.cumsum(rule.weights)), JOINT_MARGIN, 1 - JOINT_MARGIN)

    @cached_property
    def parts(self) -> np.ndarray:
        """The times as fractions of an interval; (r K,)."""
        places = np.array([0.0, *RATE_RULE.points, 1.0])
        return (self._edges[:-1, None] + np.diff(self._edges)[:, None] * places).ravel()

    @cached_property
    def times(self) -> np.ndarray:
        """The times, strictly inside their intervals; (N r K,)."""
        inside = np.nextafter(self._mesh[:-1], np.inf), np.nextafter(self._mesh[1:], -np.inf)
        early, late = (np.repeat(side, len(self.parts)) for side in inside)
        return np.clip(times_at(self._mesh, self.parts), early, late)

    def jump_effects(self, values: np.ndarray, rates: np.ndarray, rounded: ArrayLike = 0.0) -> np.ndarray:
        """Largest change of the integral over each interval by jumps, (..., N), beyond the roundoff of f.

        Parameters
        ----------
        values, rates : f and df/dt; (..., N r K) each
        rounded : the roundoff of f, which broadcasts to these
        """
        lasting = np.diff(self._mesh)[:, None] * np.diff(self._edges)
        f, slopes, least = (
            a.reshape(*a.shape[:-1], *lasting.shape, -1)
            for a in (values, rates, np.broadcast_to(rounded, values.shape))
        )
        missing = np.abs(f[..., -1] - f[..., 0] - lasting * (slopes[..., 1:-1] @ np.array(RATE_RULE.weights)))
        beyond = np.maximum(missing - least[..., -1] - least[..., 0], 0.0)
        return np.nansum(beyond * lasting, axis=-1)
