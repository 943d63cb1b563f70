"""Pseudo-arclength continuation: curves of critical points z = (ξ, s), followed through folds and branch points.

    F(ξ, s) = ∇S(ξ, data(s)) - s r = 0,    data(s) = (1 - s) data_0 + s data_1

The data are all that is given: ends, times, parameters, an energy, a factor on a force; r is a load that holds a path
in place.  With the unit tangent ż at a point and a prediction along it, the next point solves F = 0 and
<ż, z - z_predicted> = 0 by Newton's method, with two solves of the one matrix ∂F/∂ξ in each iteration (H. B. Keller,
"Numerical solution of bifurcation and nonlinear eigenvalue problems", 1977).  A step is accepted where chord and
tangents, at both of its ends, differ in direction by no more than an angle: the error of the prediction is then at most
its sine times the step.

At a fold ∂F/∂ξ is singular, at a simple branch point the whole J = ∂F/∂z has rank n - 1.  There

    F + μ b = 0,    g = 0    with    [J b; Cᵀ 0]ᵀ (ψ, g) = (0, 1)

is regular for almost all b and C, and so is its matrix (W. J. F. Govaerts, "Numerical Methods for Bifurcations of
Dynamical Equilibria", 2000, chapter 8): Newton's method finds the point to roundoff, and μ = 0 tells that it lies on
the curve.  The other curve through it follows from ψ·F_zz(ż, ż) = 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Generic, NamedTuple, TypeVar

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.roundoff import EPS, or_one
from casadi_galerkin.functional.numbering import Data
from casadi_galerkin.solvers.deadline import seconds_left
from casadi_galerkin.solvers.newton import POLISHING, Solution, SolveFailure, damped_newton
from casadi_galerkin.solvers.stationarity import Linearization, Stationarity

CORRECTOR_ITERATIONS = 10  # most iterations of Newton's method in one correction
STEP_GROWTH = 1.5  # factor on the step after a correction; one over its square after one that failed
LOAD_COSINE = 0.7  # measured on searches for several paths: without this limit of the angle some took 3 times as long
FIRST_STEP, MOST_STEPS = 0.1, 300  # arc length in units of the weights; nobody knows how long a curve is
FARTHEST_LOAD = 1e3  # arc length from where a curve of loads begins, in sizes of the path
CURVE_TOLERANCE = 0.02  # last Newton step over the arc step, where the points of a curve are not asked for
# |<ψ F_zz, (t, t')>| over the largest second derivative, below which a branch point is not simple
SIMPLE_BRANCH_POINT = EPS**0.5


@dataclass(frozen=True, eq=False)
class Point:
    """A point z of a curve with its unit tangent."""

    z: np.ndarray
    tangent: np.ndarray


At = TypeVar("At", bound=Point)


class Crossing(NamedTuple):
    """A branch point z, the null vector of ∂F/∂ξ, and the tangent of the other curve through it.

    The tangent is as long as a step to where the second variation is a tenth of its terms; it is None where the branch
    point is not simple, or the other curve is a straight family of paths.
    """

    z: np.ndarray
    null_vector: np.ndarray
    other: np.ndarray | None


class Curve(Generic[At]):
    """A curve of critical points; lengths are measured with `weights`, (n + 1,), of the scalar product.

    Parameters
    ----------
    stationarity : Stationarity
    data, target : data at s = 0 and at s = 1; without target they are the same everywhere
    load : r, as many as there are unknowns

    Attributes
    ----------
    iterations : of Newton's method so far
    tolerance : arc length of the last step of a correction
    """

    weights: np.ndarray
    tolerance: float
    least_cosine, smallest_step, longest_step = LOAD_COSINE, 1e-4, np.inf

    def __init__(
        self, stationarity: Stationarity, data: Data, target: Data | None = None, load: np.ndarray | None = None
    ) -> None:
        self.stationarity, self.first, self.load, self.iterations = stationarity, data, load, 0
        self.target = data if target is None else target
        self.change = tuple(b - a for a, b in zip(self.first, self.target, strict=True))

    def data(self, s: float) -> Data:
        """The data at a fraction s, exact at both ends, and where they do not change."""
        if self.load is not None:
            return self.first
        near, rest = (self.first, s) if s < 0.5 else (self.target, s - 1)
        return tuple(value + rest * change for value, change in zip(near, self.change, strict=True))

    def linearized(self, at: Linearization, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """F and ∂F/∂s at a point; `at` has ∂F/∂ξ."""
        self.iterations += 1
        data = self.data(z[-1])
        if self.load is not None:
            with np.errstate(invalid="ignore"):  # where both are infinite
                return at.relinearize(z[:-1], data) - z[-1] * self.load, -self.load
        (rate,) = at.evaluate("by_data", z[:-1], data, *self.change)
        return at.relinearize(z[:-1], data), rate

    def directions(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The Newton step of ξ at fixed s, and the derivative dξ/ds along the curve."""
        with self.stationarity.linearization() as at:
            residual, rate = self.linearized(at, z)
            if not np.isfinite(at.matrix).all():
                return np.full_like(residual, np.nan), np.full_like(residual, np.nan)
            newton, follow = at.solve(residual, rate)
        return newton, follow

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

    def taken(self, point: At, step: float) -> At | None:
        """The point after one step; None where it was too long."""
        self.tolerance = CURVE_TOLERANCE * step
        z = self.corrected(point.z + step * point.tangent, point.tangent, step)
        if z is None:
            return None
        tangent = self.tangent(z, point.tangent)
        straight = self.cosine(tangent, point.tangent) > self.least_cosine
        return replace(point, z=z, tangent=tangent) if straight else None

    def walk(self, point: At) -> Iterator[At]:
        """Successive points; they end where no step is short enough."""
        step = FIRST_STEP
        for _ in range(MOST_STEPS):
            if seconds_left() < 0:
                return
            found = self.taken(point, step)
            step = min(step * STEP_GROWTH ** (-2 if found is None else 1), self.longest_step)
            if found is not None:
                yield found
                point = found
            elif step < self.smallest_step:
                return

    def jacobian(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """F and the whole J = [∂F/∂ξ, ∂F/∂s], dense, (n, n + 1)."""
        with self.stationarity.linearization() as at:
            residual, rate = self.linearized(at, z)
            matrix = ca.DM(self.stationarity.linear_solver.sparsity, at.matrix.tolist()).full()
        return residual, np.column_stack((matrix, rate))

    def reach(self, z: np.ndarray, direction: np.ndarray, y: np.ndarray) -> float:
        """How many times a direction leads to where yᵀ∂F/∂ξ y, or yᵀ∂F/∂ξ |y|, has changed by a tenth of its terms.

        A change that is odd where y is not, or even, does not show in the former.  It is infinite where neither
        changes, as along a family of paths.
        """
        here = np.zeros(2)
        with self.stationarity.linearization() as at:
            for factor in (0.0, *4.0 ** np.arange(np.log2(EPS) / 2, -np.log2(EPS) / 2)):
                *along, s = z + factor * direction
                forms = [at.evaluate("curvature", along, self.data(s), y, other) for other in (y, np.abs(y))]
                signed, positive = np.array(forms)[:, :, 0].T
                if factor == 0:
                    here = signed
                elif np.any(np.abs(signed - here) > positive / 10):
                    return float(factor)
        return np.inf

    def orientation(self, z: np.ndarray, tangent: np.ndarray) -> float:
        """Sign of the determinant of J with the tangent as last row: along the curve it changes at branch points."""
        columns = self.columns(z)
        matrix = np.vstack((self.jacobian(z)[1] * columns, self.unit(tangent) / columns))
        return float(np.linalg.slogdet(matrix / or_one(np.max(np.abs(matrix), axis=1))[:, None])[0])

    def columns(self, z: np.ndarray) -> np.ndarray:
        """Sizes of all unknowns, of multipliers those that make their columns as large as others; (n + 1,)."""
        with np.errstate(divide="ignore"):
            columns = 1 / np.sqrt(self.weights)
        free = ~np.isfinite(columns)
        if np.any(free):
            columns[free], scaled = 1.0, np.abs(self.jacobian(z)[1])
            rows = or_one(np.max(scaled[:, ~free] * columns[~free], axis=1))
            columns[free] = 1 / or_one(np.max(scaled[:, free] / rows[:, None], axis=0))
        return columns

    def branch_point(self, z: np.ndarray, tangent: np.ndarray) -> Crossing | None:
        """The branch point near a point of the curve with this tangent; None if Newton's method leads to none."""
        columns, (residual, jacobian) = self.columns(z), self.jacobian(z)
        rows = 1 / or_one(np.max(np.abs(jacobian * columns), axis=1))
        for _ in range(CORRECTOR_ITERATIONS):
            scaled = rows[:, None] * jacobian * columns
            if not np.isfinite(scaled).all():
                return None
            left, values, right = np.linalg.svd(scaled)  # whose last vectors border the matrix
            psi, kernel = rows * left[:, -1], columns * right[-2:]
            null = np.array([kernel[1, -1], -kernel[0, -1]]) @ kernel
            null /= np.max(np.abs(null))
            second = np.array([self.second_derivative(z, psi, direction, null[:-1]) for direction in kernel])
            if not np.isfinite(second).all():
                return None
            matrix = np.block([[scaled, left[:, -1:]], [columns * second, np.zeros((2, 1))]])
            *step, mu = -np.linalg.lstsq(matrix, np.concatenate((rows * residual, [values[-1], 0.0])), rcond=None)[0]
            z, length = z + columns * step, np.linalg.norm(step)
            if not length < 1 / EPS:
                return None
            if length < EPS**0.5:  # the next step is roundoff
                if abs(mu) > EPS ** (2 / 3) * np.max(np.abs(scaled) @ np.abs(z / columns), initial=1.0):
                    return None
                return self._crossing(z, tangent, psi, kernel, null)
            residual, jacobian = self.jacobian(z)
        return None

    def second_derivative(self, z: np.ndarray, psi: np.ndarray, direction: np.ndarray, y: np.ndarray) -> np.ndarray:
        """ψ·F_zz times a direction, by central differences, whose steps follow its `reach`; (n + 1,)."""
        reach = self.reach(z, direction, y)
        step = EPS ** (1 / 3) * (reach if np.isfinite(reach) else 1.0)
        with np.errstate(invalid="ignore"):
            there, back = (self.jacobian(z + side * step * direction)[1] for side in (1, -1))
            return psi @ (there - back) / (2 * step)

    def _crossing(
        self, z: np.ndarray, tangent: np.ndarray, psi: np.ndarray, kernel: np.ndarray, null: np.ndarray
    ) -> Crossing:
        """The branch point with what leads on, from the null vectors of J, (2, n + 1), and the one of ∂F/∂ξ."""
        reach, rest = self.reach(z, null, null[:-1]), kernel[:, -1] @ kernel
        if not np.isfinite(reach):
            return Crossing(z, null[:-1], None)
        basis = np.array([reach * null, rest / rest[-1]])
        form = np.array([self.second_derivative(z, psi, direction, null[:-1]) for direction in basis]) @ basis.T
        fraction = (tangent - tangent[-1] * basis[1])[:-1] @ null[:-1] / (reach * null[:-1] @ null[:-1])
        along = np.array([fraction, tangent[-1]]) / np.hypot(fraction, tangent[-1])
        across = np.array([-along[1], along[0]])
        mixed, own = along @ form @ across, across @ form @ across
        if not abs(mixed) > SIMPLE_BRANCH_POINT * np.max(np.abs(form)):
            return Crossing(z, null[:-1], None)
        direction = across - own / (2 * mixed) * along
        return Crossing(z, null[:-1], direction / np.linalg.norm(direction) @ basis)


class LoadedCurve(Curve[Point]):
    """The curve of paths under a fraction s of a load or of a change of the data; it meets paths of the data at s = 0.

    Parameters
    ----------
    stationarity, data : as of `Curve`
    z : a point of the curve
    sizes : (n,), what the unknowns are measured by
    load, target : one of both, as of `Curve`
    """

    def __init__(
        self,
        stationarity: Stationarity,
        data: Data,
        z: np.ndarray,
        sizes: np.ndarray,
        load: np.ndarray | None = None,
        target: Data | None = None,
    ) -> None:
        super().__init__(stationarity, data, target, load)
        with np.errstate(over="ignore"):
            self.weights = np.append(1 / (len(sizes) * sizes**2), 0.0)
        self.start, self.follow = z, np.append(self.directions(z)[1], 1.0)
        self.weights[-1] = self.length(self.follow) ** 2  # path and load count the same at the start

    def unloaded_points(self, side: float) -> Iterator[np.ndarray]:
        """Approximate paths without load, in the order in which they are met; `side` is the first sign of ṡ."""
        z = self.start
        if not 0 < self.length(self.follow) < np.inf:
            return  # there is no load, or the path under it is not isolated
        for point in self.walk(Point(z, self.unit(side * self.follow))):
            before, z = z, point.z
            if before[-1] * z[-1] < 0:
                fraction = before[-1] / (before[-1] - z[-1])
                yield before[:-1] + fraction * (z - before)[:-1]
            if self.length(z - self.start) > FARTHEST_LOAD:
                return

    def stationary_paths(self, side: float, report: str) -> Iterator[Solution]:
        """The stationary paths that Newton's method leads to from where the load is zero."""
        for guess in self.unloaded_points(side):
            with suppress(SolveFailure):
                found = damped_newton(self.stationarity, guess, self.first, max_iter=POLISHING)
                yield replace(found, iterations=self.iterations + found.iterations, report=report)


def residual_load_curve(stationarity: Stationarity, unknowns: np.ndarray, data: Data) -> LoadedCurve:
    """The curve through a path under the load that holds it in place, at s = 1."""
    with stationarity.linearization() as at:
        load = at.relinearize(unknowns, data)
    return LoadedCurve(stationarity, data, np.append(unknowns, 1.0), stationarity.sizes(unknowns, data), load)


def remove_load(stationarity: Stationarity, guess: np.ndarray, data: Data, verbose: int = 0) -> Solution:  # noqa: ARG001
    """Take the load that holds a guess in place away, until the first stationary path is met."""
    curve = residual_load_curve(stationarity, guess, data)
    for found in curve.stationary_paths(-1.0, "Newton, the load of the guess taken away"):
        return found
    raise SolveFailure("no path was met while the load of the guess was taken away", guess, curve.iterations)
