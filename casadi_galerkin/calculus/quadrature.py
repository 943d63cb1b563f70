"""Quadrature rules (Q, w) on [0, 1].

A rule replaces the integral of f over [0, 1] by the sum of w(q) f(q) over the points q in Q, with weights
that sum to 1 (paper, section 3.2).  Two differences from the text, both stated where they matter:

* Q need not hold 0 and 1: a Gauss rule is the paper's with the weights 0 at both ends, and only points of
  nonzero weight are stored.
* ``w(0) = w(1) = 1/2`` is the :func:`trapezoid`, not the mid-point rule, whose one point is 1/2.
  Their functionals agree only where the Lagrangian is affine in x on the step.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.numbers import APART, counted, real_array, whole_number


@dataclass(frozen=True, repr=False)
class Quadrature:
    """A quadrature rule (Q, w) on [0, 1].

    Parameters
    ----------
    points : increasing sequence of r numbers in [0, 1]
    weights : sequence of r numbers that sum to 1; points of weight 0 are dropped

    Raises
    ------
    TypeError, ValueError
        for points that do not increase within [0, 1], and for weights that do not sum to 1 within roundoff

    Examples
    --------
    >>> Quadrature([0.0, 0.5, 1.0], [1 / 6, 2 / 3, 1 / 6]).order
    4
    """

    points: tuple[float, ...]
    weights: tuple[float, ...]

    def __init__(self, points: ArrayLike, weights: ArrayLike) -> None:
        q, w = real_array("points", points), real_array("weights", weights)
        if q.ndim != 1 or q.shape != w.shape or q.size == 0:
            raise ValueError(f"points and weights must be as many numbers, at least one, got {q.shape} and {w.shape}")
        if not (q[0] >= 0 and np.all(np.diff(q) > 0) and q[-1] <= 1 and abs(w.sum() - 1) <= APART):
            raise ValueError(
                f"points must increase within [0, 1], and weights sum to 1, got {q} and a sum of {float(w.sum())!r}"
            )
        keep = w != 0
        self.__dict__.update(points=tuple(q[keep].tolist()), weights=tuple(w[keep].tolist()))  # the class is frozen

    def __len__(self) -> int:
        """Number r of points of nonzero weight."""
        return len(self.points)

    def __repr__(self) -> str:
        """Number of points, where they begin and end, and order."""
        first, last = self.points[0], self.points[-1]
        return f"Quadrature of {counted(len(self), 'point')} from {first:.4g} to {last:.4g}, order {self.order}"

    @property
    def order(self) -> int:
        """Order u of the rule, the least degree of a polynomial that it does not integrate exactly.

        It is 2r for Gauss, 2r - 1 for Radau, 2r - 2 for Lobatto.
        """
        q, w = np.array(self.points), np.array(self.weights)
        # No rule with r points is exact beyond degree 2r - 1, so degree 2r always fails.
        moments, degrees = legendre.legvander(2 * q - 1, 2 * len(q)).T @ w, np.arange(2 * len(q) + 1)
        moments[0] -= 1
        return int(np.argmax(np.abs(moments) > APART * (1 + degrees * (degrees + 1))))  # their slopes reach n (n + 1)


def _roots(series: np.ndarray) -> np.ndarray:
    """Increasing roots of a Legendre series whose roots are all real.

    NumPy finds them, as complex numbers from version 2.5 on; a Newton step improves them, as NumPy does with Gauss's.
    """
    x = legendre.legroots(series).real
    return x - legendre.legval(x, series) / legendre.legval(x, legendre.legder(series))


def _legendre(n: int, x: np.ndarray) -> np.ndarray:
    """The Legendre polynomial P_n at x, (K,)."""
    return legendre.legvander(x, n)[:, n]


def _from_symmetric_interval(x: np.ndarray, w: np.ndarray) -> Quadrature:
    return Quadrature((1 + x) / 2, w / w.sum())


@lru_cache(128, typed=True)
def gauss(n: int) -> Quadrature:
    """Gauss-Legendre rule with n >= 1 points, of order 2n.

    Raises
    ------
    TypeError, ValueError
        where n is no whole number, or is less than 1

    Examples
    --------
    >>> gauss(3)
    Quadrature of 3 points from 0.1127 to 0.8873, order 6
    """
    n = whole_number("the number of points of gauss", n)
    return _from_symmetric_interval(*legendre.leggauss(n))


@lru_cache(128, typed=True)
def lobatto(n: int) -> Quadrature:
    """Gauss-Lobatto rule with n >= 2 points, both ends among them, of order 2n - 2.

    ``lobatto(2)`` is the trapezoidal rule, ``lobatto(3)`` Simpson's.

    Raises
    ------
    TypeError, ValueError
        where n is no whole number, or is less than 2

    Examples
    --------
    >>> lobatto(3) == Quadrature([0, 1 / 2, 1], [1 / 6, 2 / 3, 1 / 6])
    True
    >>> lobatto(4).order
    6
    """
    n = whole_number("the number of points of lobatto", n, 2)
    inner = _roots(legendre.legder(np.eye(n)[n - 1]))  # of P'_{n-1}
    x = np.concatenate(([-1.0], (inner - inner[::-1]) / 2, [1.0]))
    return _from_symmetric_interval(x, 1 / _legendre(n - 1, x) ** 2)


@lru_cache(128, typed=True)
def radau(n: int) -> Quadrature:
    """Gauss-Radau rule with n >= 1 points, the right end among them, of order 2n - 1.

    Raises
    ------
    TypeError, ValueError
        where n is no whole number, or is less than 1

    Examples
    --------
    >>> radau(2)
    Quadrature of 2 points from 0.3333 to 1, order 3
    """
    n = whole_number("the number of points of radau", n)
    x = np.append(_roots(np.append(np.zeros(n - 1), (1.0, -1.0)))[:-1], 1.0)  # of P_{n-1} - P_n
    return _from_symmetric_interval(x, (1 + x) / _legendre(n - 1, x) ** 2)


def midpoint() -> Quadrature:
    """Mid-point rule: one point, 1/2; order 2.  The same as ``gauss(1)``.

    Examples
    --------
    >>> midpoint() == gauss(1)
    True
    """
    return Quadrature((0.5,), (1.0,))


def trapezoid() -> Quadrature:
    """Trapezoidal rule, w(0) = w(1) = 1/2; order 2.  The same as ``lobatto(2)``.

    Examples
    --------
    >>> trapezoid() == lobatto(2)
    True
    """
    return Quadrature((0.0, 1.0), (0.5, 0.5))


def left_rectangle() -> Quadrature:
    """Left rectangle rule, w(0) = 1; order 1.

    Examples
    --------
    >>> left_rectangle()
    Quadrature of 1 point from 0 to 0, order 1
    """
    return Quadrature((0.0,), (1.0,))
