"""Two witnesses of a path that are not among the equations it solves, nor among the points of its error estimate.

The balance of energy.  Along a true path the energy E = p·v - L changes by what L depends on time,

    E(t_{i+1}) - E(t_i) = -∫ ∂L/∂t dt        on every interval,

with p at the joints from the discrete Legendre transform.  A discrete path keeps it to the order of its error.  It does
not where L has a kink that no joint meets, or where the mesh is too coarse to be believed.

The action by another rule.  Where L is smooth, the action of a path hardly changes with one quadrature point more.  It
does where a path jumps over a singularity between two points, though the energies on both sides may agree.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, times_at
from casadi_galerkin.calculus.quadrature import Quadrature, gauss
from casadi_galerkin.calculus.roundoff import EPS, component_sizes
from casadi_galerkin.problems.legendre_transform import legendre_transform, velocities


@dataclass(frozen=True)
class EnergyBalance:
    """The balance of energy of a path at its joints.

    Attributes
    ----------
    t : (N + 1,), joints
    energy : (N + 1,), p·v - L
    velocity : (d, N + 1), the velocities that belong to the momenta; NaN where none was found
    kept : (N + 1,), E + ∫ ∂L/∂t dt, the same at all joints of a true path
    scale : (N + 1,), what `kept` is measured by: |p·v| + |E| + |v|ᵀ|∂²L/∂v²||v|, no less than its mean over time
    floor : (N + 1,), what the rounding of positions and momenta does to `kept`
    mean : that mean
    """

    t: np.ndarray
    energy: np.ndarray
    velocity: np.ndarray
    kept: np.ndarray
    scale: np.ndarray
    floor: np.ndarray
    mean: float

    def missed(self, tol: float) -> np.ndarray:
        """By how much every interval misses the balance, relative to the scale; (N,), infinite where it is undefined.

        Any two joints are compared, relative to the larger of their scales: near a singularity energies are large, and
        what goes wrong there shows between its two sides.  The worst difference is shared out among the intervals
        between by what changes there.  Joints where rounding alone comes near the tolerance tell nothing.
        """
        missed = np.zeros(len(self.t) - 1)
        if not np.all(np.isfinite(self.kept)):
            return np.where(np.isfinite(self.kept[1:] + self.kept[:-1]), 0.0, np.inf)
        told = np.flatnonzero(self.floor <= tol / 2 * self.scale)
        if len(told) < 2:
            return missed
        order = told[np.argsort(self.scale[told])]
        lowest, highest = (
            accumulate(self.kept[order]) for accumulate in (np.minimum.accumulate, np.maximum.accumulate)
        )
        gaps = np.maximum(self.kept[order] - lowest, highest - self.kept[order]) / self.scale[order]
        k = int(np.argmax(gaps))
        one, before = order[k], order[: k + 1]
        other = before[np.argmax(np.abs(self.kept[before] - self.kept[one]))]
        between = told[(told >= min(one, other)) & (told <= max(one, other))]
        change = np.abs(np.diff(self.kept[between]))
        if len(change):
            shared = gaps[k] * change / max(float(np.max(change)), np.finfo(float).tiny)
            missed[between[0] : between[-1]] = np.repeat(shared, np.diff(between))
        return missed


def energy_balance(
    lagrangian: ca.Function, path: PiecewisePolynomial, momentum: np.ndarray, quadrature: Quadrature
) -> EnergyBalance:
    """Evaluate the balance of energy of a path.

    Parameters
    ----------
    lagrangian : Function (t, x, v) -> scalar
    path : PiecewisePolynomial
    momentum : (d, N + 1), at the joints
    quadrature : rule for the integral of ∂L/∂t
    """
    t, steps, x = path.mesh, np.diff(path.mesh), path.values[:, :: path.degree]
    slopes = path.at_parts(np.array([0.0, 1.0]))[1]
    beside = np.append(slopes[:, :, 0], slopes[:, -1:, 1], axis=1)
    v = velocities(legendre_transform(lagrangian), t, x, momentum, beside)
    kinetic = np.sum(momentum * v, axis=0)
    energy = kinetic - np.array(lagrangian.map(len(t))(t[None, :], x, v)).ravel()
    mass = np.array(legendre_transform(lagrangian).map(len(t))(t[None, :], x, v)[1]).reshape(len(x), len(t), len(x))
    quadratic = np.einsum("it,itj,jt->t", np.abs(v), np.abs(mass), np.abs(v))  # of which p·v may be a difference
    local = np.abs(kinetic) + np.abs(energy) + quadratic
    mean = max(float(steps @ (local[1:] + local[:-1])) / 2 / float(np.sum(steps)), np.finfo(float).tiny)
    scale = np.maximum(local, mean)
    supplied = np.zeros(len(steps))
    if lagrangian.sparsity_jac(0, 0).nnz():
        points = np.array(quadrature.points)
        times, along = times_at(t, points), [a.reshape(len(x), -1) for a in path.at_parts(points)]
        symbols = lagrangian.sx_in()
        power = ca.Function("power", symbols, [ca.densify(ca.gradient(lagrangian(*symbols), symbols[0]))])
        values = np.array(power.map(len(times))(times[None, :], *along)).reshape(len(steps), -1)
        supplied = steps * (values @ np.array(quadrature.weights))
    kept = energy + np.append(0.0, np.cumsum(supplied))
    moved = np.einsum("it,itj,j->t", np.abs(v), np.abs(mass), component_sizes(path.values))
    return EnergyBalance(t, energy, v, kept, scale, EPS * (moved / np.append(steps[0], steps) + scale), mean)


def action_change(lagrangian: ca.Function, path: PiecewisePolynomial, mean: float) -> np.ndarray:
    """Change of every interval's action from Gauss(m) to Gauss(m + 1), relative to the terms of ∫ L dt; (N,).

    Parameters
    ----------
    lagrangian : Function (t, x, v) -> scalar
    path : PiecewisePolynomial of degree m
    mean : mean over time of the sizes of the terms of L, as of `EnergyBalance`
    """
    steps, found = np.diff(path.mesh), []
    for rule in (gauss(path.degree), gauss(path.degree + 1)):
        points = np.array(rule.points)
        times, along = times_at(path.mesh, points), [a.reshape(len(path.values), -1) for a in path.at_parts(points)]
        values = np.array(lagrangian.map(len(times))(times[None, :], *along)).reshape(len(steps), -1)
        found.append(steps * (values @ np.array(rule.weights)))
    change = np.abs(found[1] - found[0]) / (mean * float(np.sum(steps)))
    return np.where(np.isnan(change), np.inf, change)
