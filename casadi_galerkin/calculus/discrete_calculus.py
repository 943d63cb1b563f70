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

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.galerkin import Galerkin, check_method
from casadi_galerkin.calculus.numbers import counted, real_array, spanned, whole_number
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, times_at
from casadi_galerkin.calculus.roundoff import EPS

NEAREST = 64 * EPS  # two joints with a smaller relative difference count as one joint that was rounded in two ways


def time_scale(mesh: ArrayLike) -> np.ndarray:
    """Check the joints a = t_0 < ... < t_N = b of a time scale T; shape (N + 1,), N >= 1."""
    joints = real_array("the joints of a mesh", mesh)
    if joints.ndim != 1 or joints.size < 2:
        raise ValueError(f"a mesh is a sequence of at least 2 joints, got shape {joints.shape}")
    steps = np.diff(joints)
    wrong = ~((steps > NEAREST * np.abs(joints[1:])) & (steps < np.inf))
    if np.any(wrong):
        i = int(np.argmax(wrong))
        raise ValueError(
            f"the joints of a mesh must be finite and increase by more than roundoff, got t[{i}] = {joints[i]} and "
            f"t[{i + 1}] = {joints[i + 1]}"
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

    Raises
    ------
    TypeError, ValueError
        for a method that is not a Galerkin, and for joints that do not increase or are not finite

    Examples
    --------
    >>> calculus = DiscreteCalculus(Galerkin(2), [0.0, 0.5, 1.0])
    >>> squares = calculus.node_times[None, :] ** 2  # X̄ of t²
    >>> path = calculus.emb(squares)
    >>> path(0.3).round(12).tolist(), calculus.delta(squares)[:, 1].round(12).tolist()
    ([0.09], [1.0])
    >>> calculus.integral(path(calculus.quadrature_times)).round(6).tolist()  # ∫ t² dt up to every joint
    [[0.0, 0.041667, 0.333333]]
    """

    def __init__(self, method: Galerkin, mesh: ArrayLike) -> None:
        check_method(method)
        self.method, self.mesh = method, time_scale(mesh)
        self._element = method.element

    @cached_property
    def node_times(self) -> np.ndarray:
        """Joints and control points in the order of time; (N m + 1,)."""
        return np.append(times_at(self.mesh, self._element.nodes[:-1]), self.mesh[-1])

    @cached_property
    def node_parts(self) -> np.ndarray:
        """The `node_times` as fractions of the time span, from 0 to 1; (N m + 1,)."""
        return (self.node_times - self.mesh[0]) / (self.mesh[-1] - self.mesh[0])

    @cached_property
    def quadrature_times(self) -> np.ndarray:
        """Times of the quadrature points, interval by interval; (N r,)."""
        return times_at(self.mesh, self._element.points)

    @cached_property
    def weights(self) -> np.ndarray:
        """ω = h_i w_k, so that ``weights @ f`` is ∫_a^b f Δ_w t; (N r,)."""
        return np.outer(np.diff(self.mesh), self._element.weights).ravel()

    def emb(self, values: ArrayLike) -> PiecewisePolynomial:
        """Embedding emb_m: node values X̄ of shape (d, N m + 1) to the path x̄ (paper, section 2)."""
        return PiecewisePolynomial(self.mesh, self._element.nodes, real_array("values at the nodes", values))

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
        quadrature points, then dx̄/dt at all of them, each by the polynomial of its own interval.
        """
        element, steps = self._element, np.diff(self.mesh)
        r, m, n = len(element.points), self.method.degree, len(steps)
        rows = np.broadcast_to(np.arange(n * r).reshape(n, r, 1), (n, r, m + 1))
        columns = np.broadcast_to(m * np.arange(n)[:, None, None] + np.arange(m + 1), (n, r, m + 1))
        values = np.broadcast_to(element.values, (n, r, m + 1))
        slopes = element.slopes / steps[:, None, None]
        entries = np.concatenate((values.ravel(), slopes.ravel()))
        return entries, (np.concatenate((rows.ravel(), n * r + rows.ravel())), np.concatenate((columns.ravel(),) * 2))

    def __repr__(self) -> str:
        """Name the method and the time scale."""
        return f"DiscreteCalculus of {self.method} on {spanned(self.mesh)}, {counted(len(self.mesh) - 1, 'interval')}"


def mesh_of(
    t_span: tuple[float, float],
    intervals: int | Sequence[int] | None,
    mesh: ArrayLike | None,
    breakpoints: tuple[float, ...],
) -> np.ndarray:
    """Joints from a number of intervals, or from the joints themselves; exactly one must be given.

    The intervals are equally long, or as nearly so as breakpoints allow, or as many between any two breakpoints as are
    given; joints that are given must include these.
    """
    if (intervals is None) == (mesh is None):
        raise ValueError(f"give either intervals or mesh, got intervals={intervals!r} and mesh={mesh!r}")
    marks = np.array([t_span[0], *breakpoints, t_span[1]])
    if isinstance(intervals, (tuple, list)):
        counts = [whole_number("intervals", count) for count in intervals]
        if len(counts) != len(breakpoints) + 1:
            sections = counted(len(breakpoints) + 1, "section")
            raise ValueError(f"intervals must be a number, or one for each of {sections}, got {intervals!r}")
        return time_scale(_between(marks, counts))
    if mesh is None:
        count = whole_number("intervals", intervals)
        if count <= len(breakpoints):
            raise ValueError(
                f"intervals must be at least {1 + len(breakpoints)}, as {counted(len(breakpoints), 'breakpoint')} "
                f"{'is a joint' if len(breakpoints) == 1 else 'are joints'}, got {count}"
            )
        return time_scale(spread_between(marks, count))
    joints = time_scale(mesh)
    if (joints[0], joints[-1]) != t_span:
        raise ValueError(f"the mesh must run from {t_span[0]} to {t_span[1]}, got {joints[0]} to {joints[-1]}")
    check_breakpoints(joints, breakpoints)
    return joints


def check_breakpoints(mesh: np.ndarray, breakpoints: tuple[float, ...]) -> None:
    """Refuse a mesh that misses a breakpoint."""
    missing = sorted(set(breakpoints).difference(mesh.tolist()))
    if missing:
        nearest = float(mesh[np.argmin(np.abs(mesh - missing[0]))])
        raise ValueError(
            f"the mesh must have every breakpoint as a joint, but has none at {missing[0]}; the nearest is {nearest}"
        )


def remeshed(calculus: DiscreteCalculus, mesh: ArrayLike, breakpoints: tuple[float, ...]) -> DiscreteCalculus:
    """The calculus of a transcription on other joints, which must be as many and include the breakpoints."""
    other, intervals = DiscreteCalculus(calculus.method, mesh), len(calculus.mesh) - 1
    check_breakpoints(other.mesh, breakpoints)
    if len(other.mesh) - 1 != intervals:
        raise ValueError(f"this transcription has {intervals} intervals, got a mesh of {len(other.mesh) - 1}")
    return other


def spread_between(marks: np.ndarray, intervals: int) -> np.ndarray:
    """Joints that include the marks, with a given number of intervals that are as equally long as possible.

    Intervals are added one by one, each between the two marks where they are longest.
    """
    counts = np.ones(len(marks) - 1, dtype=int)
    for _ in range(intervals - len(counts)):
        counts[np.argmax(np.diff(marks) / counts)] += 1
    return _between(marks, counts.tolist())


def _between(marks: np.ndarray, counts: list[int]) -> np.ndarray:
    """Joints with so many equal intervals between any two marks."""
    parts = [np.linspace(*ends, n, endpoint=False) for ends, n in zip(pairwise(marks), counts, strict=True)]
    return np.append(np.concatenate(parts), marks[-1])
