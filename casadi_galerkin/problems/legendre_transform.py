"""The Legendre transform p = ∂L/∂v, its inverse, and whether the mass matrix ∂²L/∂v² determines velocities."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.numbers import APART
from casadi_galerkin.calculus.roundoff import EPS, component_sizes, or_one

VELOCITY_ITERATIONS = 100


@lru_cache(8)
def legendre_transform(lagrangian: ca.Function) -> ca.Function:
    """The arguments of L -> p = ∂L/∂v (d,), mass matrix ∂²L/∂v² (d, d)."""
    symbols = lagrangian.sx_in()
    mass, momentum = ca.hessian(lagrangian(*symbols), symbols[2])
    return ca.Function("legendre", symbols, [ca.densify(momentum), ca.densify(mass)])


def momentum_at(lagrangian: ca.Function, t: ca.SX, x: ca.SX, v: ca.SX, *parameters: ca.SX) -> ca.SX:
    """∂L/∂v at expressions of the arguments of L, (d,)."""
    symbol = ca.SX.sym("v", v.numel())
    momentum = ca.gradient(lagrangian(t, x, symbol, *parameters), symbol)
    return ca.substitute(momentum, symbol, ca.densify(v))


@np.errstate(invalid="ignore")  # masses may be infinite
def scaled_masses(masses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mass matrices (..., d, d) scaled so that units do not matter, and the scales that they were divided by.

    Rows and columns are divided by the square roots of their largest entries, again and again, until all of these are
    near one; each pass takes the square root of the factor that is left.
    """
    scales = np.ones_like(masses)
    while True:
        rows = np.sqrt(or_one(np.max(np.abs(masses / scales), axis=-1)))
        scales = scales * rows[..., :, None] * rows[..., None, :]
        if not np.any(np.abs(np.log2(rows)) > 1):
            return masses / scales, scales


def singular(mass: np.ndarray, where: str) -> Iterator[str]:
    """That a mass matrix (d, d) is singular or not finite at a point, whatever the units; `where` tells the point."""
    if not np.all(np.isfinite(mass)):
        yield f"the lagrangian must be finite with its derivatives {where}; its mass matrix is {mass}"
        return
    sizes = np.linalg.svd(scaled_masses(mass)[0], compute_uv=False)
    if sizes[-1] <= APART * sizes[0]:
        yield (
            f"the lagrangian is degenerate: its mass matrix ∂²L/∂v² is singular {where}, so its momenta do not "
            f"determine the velocities; got {mass.tolist()}"
        )


def generic_places(problem: Any, count: int, unit: float = 1.0) -> tuple[np.ndarray, ...]:
    """Times, positions, velocities and accelerations as if at random near the line between the ends; (d, count)."""
    (first, last), given = problem.t_span, np.array([problem.start, problem.end], dtype=float)
    start, end = given = np.where(np.isnan(given), 0.0, given)
    off = np.cos(np.arange(3 * len(start) * count) ** 2).reshape(3, count, -1) * unit * component_sizes(given.T)
    when = (1 + np.arange(count)[:, None]) / (1 + count)
    x, v, a = (
        start + when * (end - start) + off[0],
        (end - start + off[1]) / (last - first),
        off[2] / (last - first) ** 2,
    )
    return first + when[:, 0] * (last - first), x.T, v.T, a.T


def singular_mass(problem: Any) -> Iterator[str]:
    """A rule: the mass matrix is regular at one of some generic points between the ends.

    Only components with an equation of motion have a mass.  Under a constraint it may be singular, because components
    that the constraint determines need no mass.
    """
    problem, count = problem.with_multipliers(), problem.mechanical
    if problem.constraint is not None or not count:
        return
    transform, (times, *places) = legendre_transform(problem.lagrangian), generic_places(problem, 3)
    for t, x, v in zip(times, places[0].T, places[1].T, strict=True):
        try:
            mass = transform(t, x, v, *[problem.parameters or ()][: transform.n_in() - 3])[1].full()[:count, :count]
        except RuntimeError:  # a Function within L may fail
            return
        if not np.isfinite(mass).all() or not list(singular(mass, "")):
            return
    yield from singular(mass, f"wherever it was tried, such as at t = {t:.6g}, x = {x}, v = {v}")


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
    return bool(np.all(eigenvalues[:, 0] >= -APART * np.abs(eigenvalues).max(axis=1)))


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
        scaled, scales = scaled_masses(_defined(masses))
        inverse = np.linalg.pinv(scaled, rcond=APART, hermitian=True) / scales
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
    moved = np.sqrt(EPS) * np.abs(v) + 4 * EPS * np.max(np.abs(guess), axis=0)  # also what rounding leaves of a guess
    sizes = np.einsum("kij,jk->ik", np.abs(_defined(masses)), moved)
    sizes += np.sqrt(EPS) * (np.abs(momentum) + np.abs(found))
    sizes += EPS * np.max(np.abs(momentum), axis=1, keepdims=True)  # where a mass vanishes, p is only rounding
    return np.where((np.isfinite(found) & (np.abs(momentum - found) <= sizes)).all(axis=0), v, np.nan)


def _defined(masses: np.ndarray) -> np.ndarray:
    """Mass matrices (K, d, d), zero where one is not finite."""
    return np.where(np.isfinite(masses).all(axis=(1, 2))[:, None, None], masses, 0.0)
