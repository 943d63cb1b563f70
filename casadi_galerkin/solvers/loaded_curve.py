"""Homotopy in a load: along paths that a load holds in place, from one path to stationary ones.

The paths that a load r holds in place, s times its size, obey

    ∇S(ξ) = s r.

They form a curve (ξ, s) (E. L. Allgower, K. Georg, "Numerical Continuation Methods", 1990).  Wherever it meets s = 0
the path is stationary.  One way to begin is at a stationary path, s = 0, with any load.  Another is at any path, s = 1,
with the load that holds it in place, its own residual r = ∇S(ξ).  Between paths of different Morse index the Hessian is
singular somewhere, which is a wall for Newton's method; the curve passes there in a fold.  Nobody knows how long the
curve is, or whether it comes back, so its points are counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from casadi_galerkin.functional.numbering import Data
from casadi_galerkin.solvers.arc_length import STEP_GROWTH, STEP_REDUCTION, Curve
from casadi_galerkin.solvers.deadline import seconds_left
from casadi_galerkin.solvers.newton import Solution, SolveFailure, damped_newton
from casadi_galerkin.solvers.stationarity import Linearization, Stationarity

FIRST_STEP, SMALLEST_STEP, FARTHEST = 0.1, 1e-4, 1e3  # of the arc length, in sizes of the path it begins at
POINTS = 300  # most corrections along one curve, those that fail included
# cosine of the largest angle between two tangents; without a limit some searches took 3 times as long
LEAST_COSINE = 0.7
POLISHING = 20  # most iterations of Newton's method from where the load is zero; with more it wanders, 4 times as long
CURVE_TOLERANCE = 0.02  # last Newton step over the arc step: points of the curve itself need no more accuracy


class LoadedCurve(Curve):
    """The curve of loaded paths through one path.

    Parameters
    ----------
    at : Linearization
    unknowns, share, data : the path ξ, and its s: zero of a stationary path
    load : r, as many as there are unknowns
    sizes : what the unknowns are measured by

    Attributes
    ----------
    iterations : of Newton's method so far
    """

    def __init__(
        self,
        at: Linearization,
        unknowns: np.ndarray,
        share: float,
        data: Data,
        load: np.ndarray,
        sizes: np.ndarray,
    ) -> None:
        self.at, self.data, self.load, self.iterations = at, data, load, 0
        self.start = np.append(unknowns, share)
        with np.errstate(over="ignore"):
            self.weights = np.append(1 / (len(sizes) * sizes**2), 0.0)
        follow = np.append(self.directions(self.start)[1], 1.0)
        self.weights[-1] = self.length(follow) ** 2  # path and load count the same at the start

    def directions(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The Newton step at a fixed load, and the derivative of the path by the share s of the load."""
        self.iterations += 1
        with np.errstate(invalid="ignore"):  # where both are infinite
            residual = self.at.relinearize(z[:-1], self.data) - z[-1] * self.load
        if not np.isfinite(self.at.matrix).all():
            return np.full_like(residual, np.nan), np.full_like(residual, np.nan)
        newton, follow = self.at.solve(residual, -self.load)
        return newton, follow

    def unloaded_points(self, side: float) -> Iterator[np.ndarray]:
        """Approximate paths without load, in the order in which they are met; `side` is the load's first sign."""
        z, step = self.start, FIRST_STEP
        tangent = self.tangent(z, np.append(np.zeros(len(z) - 1), side))
        for _ in range(POINTS):
            if seconds_left() < 0:
                return
            self.tolerance = CURVE_TOLERANCE * step
            found = self.corrected(z + step * tangent, tangent, step)
            following = tangent if found is None else self.tangent(found, tangent)
            if found is None or not self.cosine(following, tangent) > LEAST_COSINE:
                step *= STEP_REDUCTION
                if step < SMALLEST_STEP:
                    return
                continue
            before, z = z, found
            tangent = following
            if before[-1] * z[-1] < 0:
                share = before[-1] / (before[-1] - z[-1])
                yield before[:-1] + share * (z - before)[:-1]
            if self.length(z - self.start) > FARTHEST:
                return
            step *= STEP_GROWTH

    def stationary_paths(self, side: float, report: str) -> Iterator[Solution]:
        """The stationary paths that Newton's method leads to from where the load is zero."""
        for guess in self.unloaded_points(side):
            with suppress(SolveFailure):
                found = damped_newton(self.at.stationarity, guess, self.data, max_iter=POLISHING)
                yield replace(found, iterations=self.iterations + found.iterations, report=report)


def residual_load_curve(at: Linearization, unknowns: np.ndarray, data: Data) -> LoadedCurve:
    """The curve through a path under the load that holds it in place."""
    load = at.relinearize(unknowns, data).copy()
    return LoadedCurve(at, unknowns, 1.0, data, load, at.stationarity.sizes(unknowns, data))


def remove_load(stationarity: Stationarity, guess: np.ndarray, data: Data, verbose: int = 0) -> Solution:  # noqa: ARG001
    """Take the load that holds a guess in place away, until the first stationary path is met."""
    with stationarity.linearization() as at:
        curve = residual_load_curve(at, guess, data)
        for found in curve.stationary_paths(-1.0, "Newton, the load of the guess taken away"):
            return found
    raise SolveFailure("no path was met while the load of the guess was taken away", guess, curve.iterations)
