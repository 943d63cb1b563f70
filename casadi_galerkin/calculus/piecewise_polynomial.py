"""A piecewise polynomial, continuous but for jumps at joints, evaluated and differentiated."""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.nodes import differentiation_matrix, lagrange_basis, lagrange_values
from casadi_galerkin.calculus.numbers import APART, counted, read_only, real_array, spanned, whole
from casadi_galerkin.calculus.roundoff import component_sizes


def times_within(mesh: np.ndarray, t: ArrayLike) -> np.ndarray:
    """Times t as an array within the mesh; refuses one that lies outside by more than its rounding."""
    times = real_array("times", t)
    slack = APART * (mesh[-1] - mesh[0])
    if np.any(~((times >= mesh[0] - slack) & (times <= mesh[-1] + slack))):
        raise ValueError(f"times must lie within [{mesh[0]}, {mesh[-1]}], got {t!r}")
    return np.asarray(np.clip(times, mesh[0], mesh[-1]))


def times_at(mesh: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Times at the same fractions (K,), from 0 to 1, of every interval; (N K,)."""
    return (mesh[:-1, None] + (mesh[1:] - mesh[:-1])[:, None] * parts).ravel()


def sampling_parts(degree: int) -> np.ndarray:
    """Fractions of an interval, 0 and 1 among them, at which something of this degree is sampled between its nodes."""
    return np.linspace(0.0, 1.0, 4 * degree + 1)


@lru_cache(64)
def _basis(nodes: tuple[float, ...], parts: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The `lagrange_basis` at fractions (K,) of an interval, kept for other paths; (K, m + 1) each."""
    return lagrange_basis(np.array(nodes), np.array(parts))


class PiecewisePolynomial:
    """A path x̄ in P^m_T given by its values X̄ at all nodes; it is continuous, unless there are `arrivals`.

    Parameters
    ----------
    mesh : (N + 1,), the joints
    nodes : (m + 1,), nodes of the reference interval, 0 and 1 among them
    values : (d, N m + 1), values at joints and control points in the order of time
    arrivals : (d, N), values at the ends of the intervals, where a path jumps; `values` are then those after the jumps

    Raises
    ------
    ValueError
        for values of another shape

    Examples
    --------
    >>> line = PiecewisePolynomial(np.array([0.0, 1.0, 3.0]), np.array([0.0, 1.0]), np.array([[0.0, 2.0, 0.0]]))
    >>> line(2.0).tolist(), line(2.0, 1).tolist()
    ([1.0], [-1.0])
    """

    def __init__(
        self, mesh: np.ndarray, nodes: np.ndarray, values: np.ndarray, arrivals: np.ndarray | None = None
    ) -> None:
        self.mesh, self.nodes, self.values = map(read_only, (mesh, nodes, values))
        self.arrivals = None if arrivals is None else read_only(arrivals)
        count = (len(self.mesh) - 1) * self.degree + 1
        if self.values.ndim != 2 or self.values.shape[1] != count:
            raise ValueError(f"values at the nodes must have the shape (d, {count}), got {self.values.shape}")

    @property
    def degree(self) -> int:
        """Degree m of the polynomial on every interval."""
        return len(self.nodes) - 1

    @cached_property
    def sizes(self) -> np.ndarray:
        """What errors of the components are relative to, (d,): their largest values; one where these are zero."""
        return component_sizes(self.values)

    def times(self, parts: np.ndarray) -> np.ndarray:
        """Times at these fractions, from [0, 1[, of every interval, and the last joint."""
        return np.append(times_at(self.mesh, parts), self.mesh[-1])

    @property
    def node_times(self) -> np.ndarray:
        """Times of the values, joints and control points; (N m + 1,)."""
        return self.times(self.nodes[:-1])

    @property
    def local(self) -> np.ndarray:
        """Values at the nodes of every interval, (d, N, m + 1)."""
        m, values = self.degree, self.values
        ends = values[:, m::m] if self.arrivals is None else self.arrivals
        return np.concatenate((values[:, :-1].reshape(len(values), -1, m), ends[:, :, None]), axis=2)

    @property
    def jumps(self) -> np.ndarray:
        """Numbers of the joints at which the path jumps; (K,)."""
        if self.arrivals is None:
            return np.empty(0, dtype=int)
        return 1 + np.flatnonzero(np.any(self.arrivals != self.values[:, self.degree :: self.degree], axis=0))

    def between(self, first: int, last: int) -> PiecewisePolynomial:
        """The path between two joints, given by their numbers."""
        m, arrivals = self.degree, self.arrivals
        values = self.values[:, m * first : m * last + 1]
        kept = None if arrivals is None else arrivals[:, first:last]
        return PiecewisePolynomial(self.mesh[first : last + 1], self.nodes, values, kept)

    def at_parts(self, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values and derivatives (d, N, K) at the same fractions (K,) of every interval, by its own polynomial."""
        values, slopes = _basis(tuple(self.nodes.tolist()), tuple(parts.tolist()))
        local = self.local
        derivatives = (local - local[:, :, :1]) @ slopes.T / (self.mesh[1:] - self.mesh[:-1])[:, None]
        return local @ values.T, derivatives

    def sampled(self, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times (N K,), values and derivatives (d, N K) at these fractions (K,) of one interval after the other."""
        values, derivatives = (a.reshape(len(a), -1) for a in self.at_parts(parts))
        return times_at(self.mesh, parts), values, derivatives

    def at(self, nodes: np.ndarray) -> np.ndarray:
        """Node values (d, N m' + 1) on the same mesh with other nodes; without times, whose rounding would count."""
        if np.array_equal(nodes, self.nodes):
            return self.values
        inner = self.at_parts(nodes[:-1])[0]
        return np.concatenate((inner.reshape(len(self.values), -1), self.values[:, -1:]), axis=1)

    def __call__(self, t: ArrayLike, nu: int = 0) -> np.ndarray:
        """Value, or derivative of order `nu`, at times t within the mesh; shape (d,) + t.shape.

        At a joint, derivatives, and values where the path jumps, are those on the right; at the last joint on the left.
        """
        return self._evaluated(t, nu, "right")

    def before(self, t: ArrayLike, nu: int = 0) -> np.ndarray:
        """Value, or derivative of order `nu`, just before times t: at a joint, that on the left."""
        return self._evaluated(t, nu, "left")

    def line(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Times and values to draw, from increasing times (K,) that include all joints; both values where it jumps."""
        joints = self.mesh[self.jumps]
        k = np.searchsorted(times, joints)
        return np.insert(times, k, joints), np.insert(self(times), k, self.before(joints), axis=1)

    def _evaluated(self, t: ArrayLike, nu: int, side: Literal["left", "right"]) -> np.ndarray:
        order = whole(nu)
        if order is None or order < 0:
            raise ValueError(f"nu must be a whole number from 0 on, got {nu!r}")
        times, steps = times_within(self.mesh, t), np.diff(self.mesh)
        if order > self.degree:
            return np.zeros((len(self.values), *times.shape))
        flat = times.ravel()
        i = np.clip(np.searchsorted(self.mesh, flat, side=side) - 1, 0, len(steps) - 1)
        basis, local = lagrange_values(self.nodes, (flat - self.mesh[i]) / steps[i]), self.local[:, i]
        if order:  # a derivative does not see a constant; without it the roundoff is that of the differences
            slopes = np.linalg.matrix_power(differentiation_matrix(self.nodes), order)
            basis, local = basis @ slopes / steps[i, None] ** order, local - local[:, :, :1]
        return np.einsum("dkj,kj->dk", local, basis).reshape((len(self.values), *times.shape))

    def __repr__(self) -> str:
        """Name the size, the degree and the time span."""
        return (
            f"PiecewisePolynomial of {counted(len(self.values), 'component')} and degree {self.degree} on "
            f"{spanned(self.mesh)}, {counted(len(self.mesh) - 1, 'interval')}"
        )
