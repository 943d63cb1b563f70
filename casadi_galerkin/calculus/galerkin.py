"""A Galerkin method as data: degree, control points and quadrature, and its reference interval (paper, section 2)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.nodes import lagrange_basis, lagrange_values, lobatto_points
from casadi_galerkin.calculus.numbers import counted, real_array, whole_number
from casadi_galerkin.calculus.piecewise_polynomial import times_at
from casadi_galerkin.calculus.quadrature import Quadrature, gauss

LEBESGUE_WARNING = 50.0  # equispaced points pass it at degree 11; Lobatto points stay below 5 at degree 100


@dataclass(frozen=True)
class Element:
    """The reference interval [0, 1]: Lagrange polynomials of the m + 1 nodes at the r quadrature points.

    Attributes
    ----------
    nodes : (m + 1,), 0 and 1 among them
    points, weights : (r,), the quadrature
    values, slopes : (r, m + 1), l_j(q_k) and l_j'(q_k)
    """

    nodes: np.ndarray
    points: np.ndarray
    weights: np.ndarray
    values: np.ndarray
    slopes: np.ndarray


@dataclass(frozen=True, repr=False)
class Galerkin:
    """A Galerkin method as data: degree, control points and quadrature.

    Parameters
    ----------
    degree : int >= 1, degree m of the polynomial on every interval
    control_points : increasing sequence of m - 1 numbers in ]0, 1[; default ``lobatto_points(degree)``
    quadrature : Quadrature with r >= m points and of order u >= m; default ``gauss(degree)``

    The order at the joints is min(2m, u) for u >= 2m - 2, which all rules of this package have (S. Ober-Blöbaum and M.
    Vermeeren, "Superconvergence of Galerkin variational integrators", 2021), and 2(u - m + 1) otherwise.  Between the
    joints the position is of order min(m + 1, u, u - m + 2), the velocity of order min(m, u - m + 1).  With u < m not
    even uniform motion solves the discrete equations.  With r < m points, or with weights so negative that the square
    of a polynomial of degree m - 1 has a negative sum, each interval adds spurious critical directions.  All of these
    are refused.

    Raises
    ------
    TypeError, ValueError
        for a degree that is not a whole number >= 1, for control points that do not fit, and for a rule that is refused

    Examples
    --------
    >>> Galerkin(3)
    Galerkin(degree 3, 3 quadrature points of order 6)
    >>> from casadi_galerkin import trapezoid
    >>> Galerkin(1, quadrature=trapezoid()).order  # Störmer-Verlet
    2
    """

    degree: int
    control_points: tuple[float, ...]
    quadrature: Quadrature

    def __init__(
        self,
        degree: int,
        control_points: Sequence[float] | np.ndarray | None = None,
        quadrature: Quadrature | None = None,
    ) -> None:
        degree = whole_number("degree", degree)
        points = _control_points(degree, control_points)
        rule = gauss(degree) if quadrature is None else quadrature
        if not isinstance(rule, Quadrature):
            raise TypeError(f"quadrature must be a Quadrature such as gauss(3), got {rule!r}")
        _check_rule(degree, rule)
        self.__dict__.update(degree=degree, control_points=points, quadrature=rule)  # the class is frozen

    @property
    def order(self) -> int:
        """Order at the joints, min(2m, u, 2(u - m + 1)), which is min(2m, u) for u >= 2m - 2."""
        m, u = self.degree, self.quadrature.order
        return min(2 * m, u, 2 * (u - m + 1))

    @cached_property
    def element(self) -> Element:
        """The reference interval of this method."""
        nodes = np.concatenate(([0.0], self.control_points, [1.0]))
        points = np.array(self.quadrature.points)
        return Element(nodes, points, np.array(self.quadrature.weights), *lagrange_basis(nodes, points))

    def __getstate__(self) -> dict[str, object]:
        """The same for equal methods, whether the element has been asked for or not."""
        return {"degree": self.degree, "control_points": self.control_points, "quadrature": self.quadrature}

    def __repr__(self) -> str:
        """Name the method."""
        return f"Galerkin({self})"

    def __str__(self) -> str:
        """Degree, rule, and whether control points are others than Lobatto's; number and order tell the rules apart."""
        rule, usual = self.quadrature, self.control_points == tuple(lobatto_points(self.degree).tolist())
        own = "" if usual else "control points of its own, "
        return f"degree {self.degree}, {own}{counted(len(rule), 'quadrature point')} of order {rule.order}"


def check_method(method: object, optional: bool = False) -> None:
    """Refuse anything but a Galerkin method, or None where it is optional."""
    if not (isinstance(method, Galerkin) or (optional and method is None)):
        raise TypeError(f"method must be a Galerkin, such as Galerkin(degree=4), got {method!r}")


@lru_cache(64)
def _check_rule(degree: int, rule: Quadrature) -> None:
    """Refuse a rule with which paths, or their Hessians, would be silently wrong."""
    if len(rule) < degree or rule.order < degree:
        raise ValueError(
            f"a path of degree {degree} needs at least {degree} quadrature points and order {degree}, got {len(rule)} "
            f"and order {rule.order}: with less the discrete equations have solutions that are silently wrong"
        )
    slopes = legendre.legvander(2 * np.array(rule.points) - 1, degree - 1)
    least = float(np.linalg.eigvalsh(slopes.T * rule.weights @ slopes)[0])
    if least <= 0:
        raise ValueError(
            f"the quadrature must make squares of polynomials of degree {degree - 1} positive, got one of {least:.3g}: "
            "with its negative weights each interval adds spurious negative eigenvalues to the Hessian"
        )


def _control_points(degree: int, given: Sequence[float] | np.ndarray | None) -> tuple[float, ...]:
    if given is None:
        return tuple(lobatto_points(degree).tolist())
    points = real_array("control points", given)
    if points.shape != (degree - 1,):
        raise ValueError(f"degree {degree} takes {degree - 1} control points, got an array of shape {points.shape}")
    if not np.all((points > 0) & (points < 1)) or np.any(np.diff(points) <= 0):
        raise ValueError(f"control points must increase within ]0, 1[, got {points}")
    nodes = np.concatenate(([0.0], points, [1.0]))
    between = times_at(nodes, np.linspace(0.1, 0.9, 9))
    lebesgue = np.abs(lagrange_values(nodes, between)).sum(axis=1).max()
    if lebesgue > LEBESGUE_WARNING:
        warnings.warn(
            f"these control points magnify roundoff {lebesgue:.1e} times (Lebesgue constant); "
            f"lobatto_points({degree}) gives the same path without that loss",
            RuntimeWarning,
            stacklevel=3,
        )
    return tuple(points.tolist())
