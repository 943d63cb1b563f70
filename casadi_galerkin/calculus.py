"""The discrete calculus: time scale T, embedding emb_m, derivative Δ_m, anti-derivative ∫ Δ_w (paper, sections 2, 3).

Values X̄ at all nodes, joints and control points, stand for the continuous piecewise polynomial
x̄ = emb_m(X̄) of degree m.  Everything here is linear in X̄, and so is one sparse matrix and one vector:

    (x̄, dx̄/dt) at all quadrature points  =  E X̄,          ∫ f Δ_w t  =  ω · f.

Where the paper's text has to be read with care, this module follows the mathematics:

* the sum over interval k in the anti-derivative carries the factor h_k (the text leaves it out);
* the derivative at a quadrature point q = 1 is that of *this* interval's polynomial, not of the next one's;
* control points are c_{i,j} = t_i + c_j h_i, and the time scale may be graded: h_i = t_{i+1} - t_i.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.nodes import _degree, differentiation_matrix, lagrange_values, lobatto_points
from casadi_galerkin.polynomial import PiecewisePolynomial
from casadi_galerkin.quadrature import Quadrature, gauss, real_array

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


@dataclass(frozen=True)
class Galerkin:
    """A Galerkin method as data: degree, control points and quadrature.

    Parameters
    ----------
    degree : int >= 1, degree m of the polynomial on every interval
    control_points : increasing sequence of m - 1 numbers in ]0, 1[; default ``lobatto_points(degree)``
    quadrature : Quadrature with r >= m points; default ``gauss(degree)``

    The order at the joints is min(2m, u) with u the order of the quadrature (S. Ober-Blöbaum and M. Vermeeren,
    "Superconvergence of Galerkin variational integrators", 2021); between the joints the position is of order
    min(m + 1, u) and the velocity of order m; with ``lobatto(m)`` one less of each.  With r < m points the equations
    still have a solution, but a wrong one: each interval adds a spurious critical direction, so it is refused.
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
        degree = _degree(degree)
        points = _control_points(degree, control_points)
        rule = gauss(degree) if quadrature is None else quadrature
        if not isinstance(rule, Quadrature):
            raise TypeError(f"quadrature must be a Quadrature such as gauss(3), got {rule!r}")
        if len(rule) < degree:
            raise ValueError(
                f"a path of degree {degree} needs at least {degree} quadrature points, got {len(rule)}: "
                "with fewer the discrete equations have solutions that are silently wrong"
            )
        object.__setattr__(self, "degree", degree)
        object.__setattr__(self, "control_points", points)
        object.__setattr__(self, "quadrature", rule)

    @property
    def order(self) -> int:
        """Order at the joints, min(2m, u)."""
        return min(2 * self.degree, self.quadrature.order)

    @cached_property
    def element(self) -> Element:
        """The reference interval of this method."""
        nodes = np.concatenate(([0.0], self.control_points, [1.0]))
        points = np.array(self.quadrature.points)
        values = lagrange_values(nodes, points)
        return Element(nodes, points, np.array(self.quadrature.weights), values, values @ differentiation_matrix(nodes))

    def __str__(self) -> str:
        """Degree and rule; where control points are not Lobatto's, or the rule not Gauss's, where their points lie."""
        rule, usual = self.quadrature, self.control_points == tuple(lobatto_points(self.degree).tolist())
        control = "" if usual else f"control {_points(self.control_points, True)}, "
        points = _points(rule.points, rule != gauss(len(rule)))
        return f"degree {self.degree}, {control}{len(rule)} quadrature {points} of order {rule.order}"


def _points(points: tuple[float, ...], placed: bool) -> str:
    """Points in words, with the first and the last if they are to be placed."""
    if len(points) == 1:
        return f"point at {points[0]:.4g}" if placed else "point"
    return f"points from {points[0]:.4g} to {points[-1]:.4g}" if placed else "points"


def _control_points(degree: int, given: Sequence[float] | np.ndarray | None) -> tuple[float, ...]:
    if given is None:
        return tuple(lobatto_points(degree).tolist())
    points = real_array("control points", given)
    if points.shape != (degree - 1,):
        raise ValueError(f"degree {degree} takes {degree - 1} control points, got an array of shape {points.shape}")
    if not np.all((points > 0) & (points < 1)) or np.any(np.diff(points) <= 0):
        raise ValueError(f"control points must increase within ]0, 1[, got {points}")
    nodes = np.concatenate(([0.0], points, [1.0]))
    between = (nodes[:-1, None] + np.diff(nodes)[:, None] * np.linspace(0.1, 0.9, 9)).ravel()
    lebesgue = np.abs(lagrange_values(nodes, between)).sum(axis=1).max()
    if lebesgue > LEBESGUE_WARNING:
        warnings.warn(
            f"these control points magnify roundoff {lebesgue:.1e} times (Lebesgue constant); "
            f"lobatto_points({degree}) gives the same path without that loss",
            RuntimeWarning,
            stacklevel=4,
        )
    return tuple(points.tolist())


def time_scale(mesh: ArrayLike) -> np.ndarray:
    """Check the joints a = t_0 < ... < t_N = b of a time scale T; shape (N + 1,), N >= 1."""
    joints = real_array("the joints of a mesh", mesh)
    if joints.ndim != 1 or joints.size < 2:
        raise ValueError(f"a mesh is a sequence of at least 2 joints, got shape {joints.shape}")
    if not np.all(np.isfinite(joints)):
        raise ValueError("the joints of a mesh must be finite")
    if np.any(np.diff(joints) <= 0):
        i = int(np.argmax(np.diff(joints) <= 0))
        raise ValueError(
            f"the joints of a mesh must increase, got t[{i}] = {joints[i]} and t[{i + 1}] = {joints[i + 1]}"
        )
    joints.flags.writeable = False  # transcriptions and paths share them
    return joints


class DiscreteCalculus:
    """The discrete differential and integral calculus of a method on a time scale.

    Parameters
    ----------
    method : Galerkin
    mesh : (N + 1,) increasing joints t_0 ... t_N

    Attributes
    ----------
    mesh : (N + 1,), the time scale T
    """

    def __init__(self, method: Galerkin, mesh: ArrayLike) -> None:
        self.method, self.mesh = method, time_scale(mesh)
        self._element, self._nodes = method.element, (len(self.mesh) - 1) * method.degree + 1

    def _times(self, parts: np.ndarray) -> np.ndarray:
        """Times at these parts of every interval."""
        return np.asarray((self.mesh[:-1, None] + np.diff(self.mesh)[:, None] * parts).ravel())

    @cached_property
    def node_times(self) -> np.ndarray:
        """Joints and control points in the order of time; (N m + 1,)."""
        return np.append(self._times(self._element.nodes[:-1]), self.mesh[-1])

    @cached_property
    def node_parts(self) -> np.ndarray:
        """The same times as parts of the whole time, from 0 to 1; (N m + 1,)."""
        return np.asarray((self.node_times - self.mesh[0]) / (self.mesh[-1] - self.mesh[0]))

    @cached_property
    def quadrature_times(self) -> np.ndarray:
        """Quadrature points, interval by interval; (N r,)."""
        return self._times(self._element.points)

    @cached_property
    def weights(self) -> np.ndarray:
        """ω = h_i w_k, so that ``weights @ f`` is ∫_a^b f Δ_w t; (N r,)."""
        return np.outer(np.diff(self.mesh), self._element.weights).ravel()

    def emb(self, values: ArrayLike) -> PiecewisePolynomial:
        """Embedding emb_m: node values X̄ of shape (d, N m + 1) to the path x̄ (paper, section 2)."""
        array = real_array("node values", values)
        if array.ndim != 2 or array.shape[1] != self._nodes:
            raise ValueError(f"node values must have the shape (d, {self._nodes}), got {array.shape}")
        return PiecewisePolynomial(self.mesh, self._element.nodes, array)

    def delta(self, values: ArrayLike) -> np.ndarray:
        """Discrete derivative Δ_m: right derivative of emb_m(X̄) at t_0 ... t_{N-1}; shape (d, N)."""
        return self.emb(values)(self.mesh[:-1], 1)

    def integral(self, f: ArrayLike) -> np.ndarray:
        """Anti-derivative ∫_a^{t_i} f Δ_w t at all joints, from f at the quadrature points.

        Parameters
        ----------
        f : (..., N r), values in the order of `quadrature_times`

        Returns
        -------
        (..., N + 1), zero at t_0
        """
        array = real_array("values at the quadrature points", f)
        if array.shape[-1:] != self.weights.shape:
            raise ValueError(
                f"values at the quadrature points must have the shape (..., {len(self.weights)}), got {array.shape}"
            )
        per_interval = (array * self.weights).reshape(*array.shape[:-1], len(self.mesh) - 1, -1).sum(axis=-1)
        return np.concatenate((np.zeros((*array.shape[:-1], 1)), np.cumsum(per_interval, axis=-1)), axis=-1)

    def operator(self) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """The sparse matrix E of emb_m and its derivative at the quadrature points.

        Returns
        -------
        (entries, (rows, columns)) of the matrix of shape (2 N r, N m + 1), the triplet form that
        ``scipy.sparse.coo_array`` takes.  Applied to the node values of one component it gives x̄ at all
        quadrature points, then dx̄/dt at all of them, each of this interval's polynomial.
        """
        element, steps = self._element, np.diff(self.mesh)
        r, m, n = len(element.points), self.method.degree, len(steps)
        rows = np.broadcast_to(np.arange(n * r).reshape(n, r, 1), (n, r, m + 1))
        columns = np.broadcast_to(m * np.arange(n)[:, None, None] + np.arange(m + 1), (n, r, m + 1))
        values = np.broadcast_to(element.values, (n, r, m + 1))
        slopes = element.slopes / steps[:, None, None]
        entries = np.concatenate((values.ravel(), slopes.ravel()))
        return entries, (np.concatenate((rows.ravel(), n * r + rows.ravel())), np.concatenate((columns.ravel(),) * 2))
