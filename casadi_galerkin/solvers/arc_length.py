"""A curve of solutions z = (ξ, s) of n equations in n + 1 unknowns, followed by its arc length, round its folds.

With the unit tangent ż at a point and a prediction along it, the next point solves

    F(ξ, s) = 0,    <ż, z - z_predicted> = 0

by Newton's method, with two solves of the same matrix ∂F/∂ξ per iteration (H. B. Keller, "Numerical solution of
bifurcation and nonlinear eigenvalue problems", 1977).  At a fold this matrix is singular, but that of both conditions
together is not.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

CORRECTOR_ITERATIONS = 10  # most iterations of Newton's method in one correction
STEP_GROWTH, STEP_REDUCTION = 1.5, 0.5  # factors on the step after a correction, and after one that failed


class Curve(ABC):
    """A curve of points z = (ξ, s).

    Attributes
    ----------
    weights : (n + 1,), of the scalar product in which arc length is measured
    tolerance : arc length of the last step of a correction
    """

    weights: np.ndarray
    tolerance: float

    @abstractmethod
    def directions(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The Newton step of ξ at fixed s, and the derivative dξ/ds along the curve."""

    def length(self, step: np.ndarray) -> float:
        """Arc length of a step."""
        with np.errstate(over="ignore", invalid="ignore"):
            return float(np.sqrt(step**2 @ self.weights))

    def cosine(self, one: np.ndarray, other: np.ndarray) -> float:
        """Cosine of the angle between two directions of length one."""
        return float((one * other) @ self.weights)

    def unit(self, direction: np.ndarray) -> np.ndarray:
        """A direction of length one."""
        with np.errstate(invalid="ignore"):
            return direction / self.length(direction)

    def tangent(self, z: np.ndarray, forward: np.ndarray) -> np.ndarray:
        """Unit tangent at a point of the curve, on the side of `forward`."""
        direction = np.append(self.directions(z)[1], 1.0)
        with np.errstate(invalid="ignore"):  # it is not finite where the matrix is singular
            return self.unit(np.copysign(1.0, (direction * forward) @ self.weights) * direction)

    def corrected(self, z: np.ndarray, normal: np.ndarray, longest: float) -> np.ndarray | None:
        """Correct z within the plane through it with this normal; None if that fails, or a step exceeds `longest`."""
        start, normal = z, normal * self.weights
        for _ in range(CORRECTOR_ITERATIONS):
            newton, follow = self.directions(z)
            with np.errstate(divide="ignore", invalid="ignore"):  # where the curve runs along the plane
                ds = -(normal[:-1] @ newton + normal @ (z - start)) / (normal[:-1] @ follow + normal[-1])
                step = np.append(newton + ds * follow, ds)
            z, length = z + step, self.length(step)
            if not length <= longest:
                return None
            if length < self.tolerance:
                return z
        return None
