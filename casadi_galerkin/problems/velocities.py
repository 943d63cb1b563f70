"""The velocities that belong to given momenta p = ∂L/∂v, by Newton's method at many points at once."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.problems.legendre_transform import DEGENERATE_MASS, scaled_masses

VELOCITY_ITERATIONS = 100
VELOCITY_TOLERANCE = 1e-9  # residual over the sizes of its terms from which a velocity counts as found


def _at(transform: ca.Function, t: np.ndarray, x: np.ndarray) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Velocities v (d, K) -> momenta (d, K), mass matrices (K, d, d)."""
    mapped = transform.map(len(t))

    def at(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        momenta, masses = (np.array(a) for a in mapped(t[None, :], x, v))
        return momenta, masses.reshape(len(v), len(t), len(v)).transpose(1, 0, 2)

    return at


def convex(transform: ca.Function, t: np.ndarray, x: np.ndarray, v: np.ndarray) -> bool:
    """Whether ∂²L/∂v² has no negative eigenvalue at any of many points; arguments as for `velocities`."""
    eigenvalues = np.linalg.eigvalsh(scaled_masses(_at(transform, t, x)(v)[1])[0])
    return bool(np.all(eigenvalues[:, 0] >= -DEGENERATE_MASS * np.abs(eigenvalues).max(axis=1)))


def velocities(
    transform: ca.Function, t: np.ndarray, x: np.ndarray, momentum: np.ndarray, guess: np.ndarray
) -> np.ndarray:
    """Velocities v with ∂L/∂v(t, x, v) = p at many points; NaN where none was found.

    Newton's method from a guess, or from rest where L is not defined at it; each step is halved until the next one is
    shorter, and the last is one that rounding lets become no shorter.

    Parameters
    ----------
    transform : `legendre_transform` of L
    t : (K,)
    x, momentum, guess : (d, K)
    """
    at = _at(transform, t, x)
    v, (found, masses) = guess, at(guess)
    undefined = ~(np.isfinite(found).all(axis=0) & np.isfinite(masses).all(axis=(1, 2)))
    if undefined.any():
        v = np.where(undefined, 0.0, guess)
        found, masses = at(v)
    settled = np.zeros(x.shape[1], dtype=bool)
    for _ in range(VELOCITY_ITERATIONS):
        inverse = _inverse(masses)
        step = np.einsum("kij,jk->ik", inverse, momentum - found)
        length = np.max(np.abs(step), axis=0)
        settled |= ~(length > 4 * EPS * np.max(np.abs(v), axis=0))
        if settled.all():
            break
        damping = np.where(settled, 0.0, 1.0)
        while True:
            trial = v + damping * step
            found, masses = at(trial)
            after = np.max(np.abs(np.einsum("kij,jk->ik", inverse, momentum - found)), axis=0)
            refused = ~(after <= (1 - damping / 4) * length) & (damping > EPS)
            if not refused.any():
                break
            damping[refused] /= 2
        v, settled = trial, settled | (damping <= EPS)
    moved = VELOCITY_TOLERANCE * np.abs(v) + 4 * EPS * np.max(
        np.abs(guess), axis=0
    )  # also what rounding leaves of a guess
    sizes = VELOCITY_TOLERANCE * (np.abs(momentum) + np.abs(found)) + np.einsum(
        "kij,jk->ik", np.abs(_defined(masses)), moved
    )
    sizes += EPS * np.max(np.abs(momentum), axis=1, keepdims=True)  # where a mass vanishes, p is only rounding
    return np.where((np.isfinite(found) & (np.abs(momentum - found) <= sizes)).all(axis=0), v, np.nan)


def _inverse(masses: np.ndarray) -> np.ndarray:
    """Pseudo-inverses of mass matrices (K, d, d)."""
    scaled, scales = scaled_masses(_defined(masses))
    return np.linalg.pinv(scaled, rcond=DEGENERATE_MASS, hermitian=True) / scales


def _defined(masses: np.ndarray) -> np.ndarray:
    """Mass matrices (K, d, d), zero where one is not finite."""
    return np.where(np.isfinite(masses).all(axis=(1, 2))[:, None, None], masses, 0.0)
