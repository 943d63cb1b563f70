"""A path that can be evaluated and drawn, whether it is an answer or only what a solve got to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.lazy import lazy
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.solution.plotting import plot_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SMOOTH = 200  # times on a path that make a smooth line


@dataclass(frozen=True, repr=False)
class Path:
    """A path x̄(t) over its joints.

    By itself it is no answer: the `path` of a ConvergenceError is what the solve had come to.

    Attributes
    ----------
    polynomial : PiecewisePolynomial; its `values` (d, N m + 1) are the node values X̄
    """

    polynomial: PiecewisePolynomial

    @property
    def t(self) -> np.ndarray:
        """Joints, (N + 1,)."""
        return self.polynomial.mesh

    @lazy
    def x(self) -> np.ndarray:
        """Positions at the joints, (d, N + 1)."""
        return self.polynomial.values[:, :: self.polynomial.degree].copy()

    def __call__(self, t: ArrayLike, nu: int = 0) -> np.ndarray:
        """Position, or derivative of order `nu`, at times t; shape (d,) + t.shape.

        At a joint the derivative is the right one, at the last joint the left one.
        """
        return self.polynomial(t, nu)

    def plot(self, axes: Axes | None = None, labels: Sequence[str] | None = None, time: str = "t") -> Axes:
        """Draw the components over time, joints as dots; returns the Matplotlib axes.

        Parameters
        ----------
        axes : Matplotlib axes to draw into; default a new figure
        labels : d names with units, such as "angle in rad"
        time : name of the time with its unit
        """
        times = self._fine()
        drawn = plot_path(times, self(times), self.t, self.x, axes, labels, time)
        if axes is None:
            drawn.set_title(self._title())
        return drawn

    def _title(self) -> str:
        return f"A path of degree {self.polynomial.degree} on {len(self.t) - 1} intervals, not an answer"

    def _fine(self) -> np.ndarray:
        """Times that make a smooth line; all joints are among them."""
        return self.polynomial.times(np.linspace(0, 1, max(2, SMOOTH // (len(self.t) - 1)), endpoint=False))

    def __repr__(self) -> str:
        """Say what it is and over which time."""
        d, size = len(self.polynomial.values), len(self.t) - 1
        return (
            f"Path of {d} component{'s' * (d > 1)} on [{self.t[0]:g}, {self.t[-1]:g}], degree "
            f"{self.polynomial.degree} on {size} interval{'s' * (size > 1)}; not an answer"
        )
