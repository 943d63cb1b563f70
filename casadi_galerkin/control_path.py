"""Controls as functions of time: polynomials between quadrature points, in numbers and as a CasADi expression."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.nodes import lagrange_values


class ControlPath:
    """Controls between their values at the quadrature points: degree r - 1 an interval, free to jump at joints.

    Parameters
    ----------
    mesh : (N + 1,), the joints
    points : (r,), quadrature points of the reference interval
    values : (n, N r), controls at the quadrature points in the order of time
    """

    def __init__(self, mesh: np.ndarray, points: np.ndarray, values: np.ndarray) -> None:
        self.mesh, self.points, self.values = mesh, points, values

    def __call__(self, t: ArrayLike) -> np.ndarray:
        """Controls at times t within the mesh; shape (n,) + t.shape.  At a joint those of the interval after it."""
        times = np.asarray(t, dtype=float)
        flat = times.ravel()
        slack = 1e-12 * (self.mesh[-1] - self.mesh[0])
        if np.any(~((flat >= self.mesh[0] - slack) & (flat <= self.mesh[-1] + slack))):
            raise ValueError(f"times must lie within [{self.mesh[0]}, {self.mesh[-1]}], got {t!r}")
        r, steps = len(self.points), np.diff(self.mesh)
        i = np.clip(np.searchsorted(self.mesh, flat, side="right") - 1, 0, len(steps) - 1)
        basis = lagrange_values(self.points, np.clip((flat - self.mesh[i]) / steps[i], 0.0, 1.0))
        local = self.values[:, i[:, None] * r + np.arange(r)]
        return np.asarray(np.einsum("nkj,kj->nk", local, basis).reshape((len(self.values), *times.shape)))

    @property
    def times(self) -> np.ndarray:
        """The quadrature points in time, (N r,)."""
        return np.asarray((self.mesh[:-1, None] + np.diff(self.mesh)[:, None] * self.points).ravel())

    def expression(self, t: ca.SX) -> ca.SX:
        """The same as a CasADi expression of a scalar t, (n,): Horner's scheme, coefficients switching at joints."""
        r, inner = len(self.points), self.mesh[1:-1].tolist()
        steps = np.diff(self.mesh)
        monomials = np.linalg.inv(np.vander(2 * self.points - 1, r, increasing=True))
        local = self.values.reshape(len(self.values), len(steps), r)
        coefficients = np.einsum("cr,nir->cni", monomials, local)

        def switched(values: np.ndarray) -> ca.SX:
            return ca.pw_const(t, inner, values.tolist()) if inner else ca.SX(values[0])

        s = 2 * (t - switched(self.mesh[:-1])) / switched(steps) - 1
        total = [ca.SX(0) for _ in self.values]
        for power in coefficients[::-1]:
            total = [value * s + switched(row) for value, row in zip(total, power, strict=True)]
        return ca.vertcat(*total)
