"""From node values to x and dx/dt at all quadrature points (E), and back to gradients (Eᵀ) and Hessians (Eᵀ · E).

These are CasADi expressions of the `Numbering` alone.  They use E as the product of two factors: the selection of each
interval's node values, and the dense matrices of the reference `Element`.  Because the step is an input of the
pulled-back Lagrangian, they do not depend on the mesh, and Functions of the longer ones are cached for other
Lagrangians.

Slopes are computed from differences to the first value of the interval, and the gradient by that value from the sum of
the others (the l_j sum to one, the l_j' to zero).  Roundoff then stays near 1e-14 at 1e5 intervals instead of growing
with 1/h.

Local node values are arranged as a matrix of shape (d N, m + 1): column a is node a of all intervals, component
fastest.  Points are numbered the same way: quadrature point slowest, then interval, then component.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from casadi_galerkin.functional.numbering import CACHE_SIZE, Numbering

BLAS = "classic" if ca.has_blas("classic") else "reference"  # measured: 3 to 5 times faster than the reference


def _times(left: ca.MX, right: np.ndarray | ca.DM) -> ca.MX:
    """Dense product with a constant."""
    return ca.mtimes(left, ca.MX(ca.DM(right)), BLAS)


@lru_cache(CACHE_SIZE)
def embedding(numbering: Numbering) -> ca.Function:
    """E: u -> x (d, N r), x' (d, N r) at the quadrature points."""
    element, n, d = numbering.method.element, numbering.intervals, numbering.dimension
    r, m = len(element.points), numbering.method.degree
    u = ca.MX.sym("u", numbering.size)
    local = ca.reshape(u.get_nz(False, numbering.local.ravel().tolist()), d * n, m + 1)
    first, others = ca.horzsplit(local, [0, 1, m + 1])
    basis = np.vstack((element.values[:, 1:], element.slopes[:, 1:]))
    change, slope = ca.horzsplit(_times(others - ca.repmat(first, 1, m), basis.T), [0, r, 2 * r])
    outputs = [ca.reshape(a, d, n * r) for a in (ca.repmat(first, 1, r) + change, slope)]
    return ca.Function("embedding", [u], outputs, ["u"], ["x", "slope"])


@dataclass(frozen=True)
class Embedded:
    """Symbols of a path, and its values and slopes at the quadrature points; the same for all Lagrangians.

    Attributes
    ----------
    symbols : unknowns, start, end and mesh by name
    u : the vector u of the numbering, made of unknowns, start and end
    joints : (N + 1,), the mesh, stretched where the duration is free
    duration : scalar, from the first joint to the last
    points : t (1, N r), h (1, N r), x (d, N r), x' (d, N r)
    """

    symbols: dict[str, ca.MX]
    u: ca.MX
    joints: ca.MX
    duration: ca.MX
    points: list[ca.MX]


@lru_cache(CACHE_SIZE)
def embedded(numbering: Numbering) -> Embedded:
    """Embed the symbols of a numbering."""
    n, points = numbering.intervals, numbering.method.element.points
    sizes = (numbering.free, len(numbering.fixed_start), len(numbering.fixed_end), n + 1)
    symbols = {
        name: ca.MX.sym(name, size) for name, size in zip(("unknowns", "start", "end", "mesh"), sizes, strict=True)
    }
    *values, mesh = symbols.values()
    u = ca.vertcat(*values)
    joints, steps, duration = mesh, mesh[1:] - mesh[:-1], mesh[-1] - mesh[0]
    if numbering.free_duration:  # the steps do not depend on the time of the start
        stretch = ca.exp(symbols["unknowns"][-1])
        joints, steps, duration = mesh[0] + stretch * (mesh - mesh[0]), stretch * steps, stretch * duration
    t = ca.repmat(joints[:-1], 1, len(points)) + _times(steps, points[None, :])
    times = [ca.reshape(t, 1, numbering.points), ca.repmat(steps.T, 1, len(points))]
    return Embedded(symbols, u, joints, duration, [*times, *embedding(numbering).call([u])])


def _side_by_side(numbering: Numbering, *values: ca.MX) -> ca.MX:
    """Values (rows, N r) each -> (rows N, r) each, concatenated horizontally."""
    return ca.horzcat(*(ca.reshape(a, a.shape[0] * numbering.intervals, -1) for a in values))


def gathered(numbering: Numbering, entries: np.ndarray, values: ca.MX) -> ca.MX:
    """Values that belong, column by column, to these entries of u, summed for every unknown."""
    unknown = np.flatnonzero(entries < numbering.free)
    rows, columns = entries[unknown].tolist(), unknown.tolist()
    selection = ca.DM(ca.Sparsity.triplet(numbering.free, len(entries), rows, columns), 1.0)
    return ca.densify(ca.mtimes(ca.MX(selection), ca.vec(values)))  # zero for an unknown without values


def _coefficients(numbering: Numbering) -> list[ca.MX]:
    """Symbols of the coefficients of δx and δx', (d, N r) each."""
    return [ca.MX.sym(name, numbering.dimension, numbering.points) for name in ("fx", "fv")]


def integrated(numbering: Numbering, fx: ca.MX, fv: ca.MX) -> ca.MX:
    """Eᵀ times the coefficients (d, N r) of δx and δx', summed for every unknown."""
    element = numbering.method.element
    w, r = element.weights[:, None], len(element.points)
    both = _side_by_side(numbering, fx, fv)
    others = _times(both, np.vstack((w * element.values[:, 1:], w * element.slopes[:, 1:])))
    first = _times(both[:, :r], w) - ca.sum2(others)
    return gathered(numbering, numbering.local.ravel(), ca.horzcat(first, others))


def summed(numbering: Numbering, f: ca.MX) -> ca.MX:
    """∫ f Δ_w t on the reference interval, summed, from values (1, N r), step included; scalar."""
    return ca.sum1(_times(_side_by_side(numbering, f), numbering.method.element.weights[:, None]))


@lru_cache(CACHE_SIZE)
def variation(numbering: Numbering) -> ca.Function:
    """From an integrand f and its gradient fx, fv: the action, momenta, gradient, and sums of the sizes of its terms.

    Momenta (d, N + 1) are -∂S/∂x_0 at the first joint and ∂S_k/∂x_{k+1}, of interval k, at the others.  The
    roundoff of a sum is a few eps times the sum of the sizes of its terms.
    """
    element, d, (fx, fv) = numbering.method.element, numbering.dimension, _coefficients(numbering)
    w, f = element.weights[:, None], ca.MX.sym("f", 1, numbering.points)
    both, basis = _side_by_side(numbering, fx, fv), np.vstack((w * element.values, w * element.slopes))
    first, last = ca.horzsplit(_times(both, basis[:, [0, -1]]))
    momenta = ca.horzcat(-first[:d], ca.reshape(last, d, numbering.intervals))
    terms = gathered(numbering, numbering.local.ravel(), _times(ca.fabs(both), np.abs(basis)))
    outputs = [summed(numbering, f), momenta, integrated(numbering, fx, fv), terms]
    return ca.Function(
        "variation", [f, fx, fv], outputs, ["f", "fx", "fv"], ["action", "momentum", "gradient", "terms"]
    )


@lru_cache(CACHE_SIZE)
def assembly(
    numbering: Numbering,
    colind: tuple[int, ...],
    row: tuple[int, ...],
    symmetric: bool,
    blocks: tuple[tuple[int, int], ...],
) -> ca.Function:
    """Eᵀ blockdiag(·) E and Eᵀ: gradient fx, fv and Jacobian at the points -> sparse matrix and gradient.

    The Jacobian is one matrix per block, (entries of the (d, d) pattern, N r).  Each interval contributes a dense
    (m + 1) by (m + 1) grid of cells with that pattern, and neighbors overlap in the joint:

        ■ ■ ■ · ·
        ■ ■ ■ · ·
        ■ ■ ■ ■ ■
        · · ■ ■ ■
        · · ■ ■ ■

    Of a symmetric matrix only cells of node pairs (a, b) with a >= b are computed; the others are their transposes.
    """
    element, computed = numbering.method.element, _computed(numbering, symmetric)
    basis, weights, (a, b) = (element.values, element.slopes), element.weights[:, None], np.nonzero(computed)
    products = np.vstack([weights * basis[i][:, a] * basis[j][:, b] for i, j in blocks])
    inputs = [ca.MX.sym(f"block{i}{j}", len(row), numbering.points) for i, j in blocks]
    cells = _times(_side_by_side(numbering, *inputs), products)
    coefficients, pattern = _coefficients(numbering), hessian_pattern(numbering, colind, row, symmetric)
    outputs = [pattern.matrix(cells), integrated(numbering, *coefficients)]
    names = ["fx", "fv", *(f"block{i}{j}" for i, j in blocks)]
    return ca.Function("assembly", [*coefficients, *inputs], outputs, names, ["matrix", "gradient"])


class Summation:
    """The sum of entries that belong to rows and columns of a square matrix; those beyond its size are left out.

    Parameters
    ----------
    size : of the matrix
    rows, columns, numbers : (count,) each, of the summands, and their numbers among the entries

    Attributes
    ----------
    sparsity : Sparsity of the matrix
    """

    def __init__(self, size: int, rows: np.ndarray, columns: np.ndarray, numbers: np.ndarray) -> None:
        inside = (rows < size) & (columns < size)
        numbers, targets = numbers[inside], columns[inside] * size + rows[inside]
        order = np.argsort(targets, kind="stable")
        numbers, (targets, first, counts) = (
            numbers[order],
            np.unique(targets[order], return_index=True, return_counts=True),
        )
        starts = np.searchsorted(targets, size * np.arange(size + 1))
        self.sparsity = ca.Sparsity(size, size, starts.tolist(), (targets % size).tolist())
        self._rounds = [  # in none of which a nonzero occurs twice: where, and what is added there
            (np.flatnonzero(counts > k).tolist(), numbers[first[counts > k] + k].tolist())
            for k in range(counts.max(initial=1))
        ]

    def matrix(self, entries: ca.MX) -> ca.MX:
        """The matrix; sums are added in place, as a sum of matrices would copy all."""
        (_, first), *others = self._rounds
        entries = ca.vec(entries)
        values = ca.vec(entries.get_nz(False, first))  # an empty one is a row
        for where, numbers in others:
            values.nz[where] = values.nz[where] + entries.nz[numbers]
        return ca.MX(self.sparsity, values)


def _computed(numbering: Numbering, symmetric: bool) -> np.ndarray:
    """Which cells (m + 1, m + 1) of an interval are computed."""
    every = np.ones([len(numbering.method.element.nodes)] * 2, dtype=bool)
    return np.tril(every) if symmetric else every


@lru_cache(CACHE_SIZE)
def hessian_pattern(numbering: Numbering, colind: tuple[int, ...], row: tuple[int, ...], symmetric: bool) -> Summation:
    """The sum of the cells of all intervals; the pattern (colind, row) of a cell is symmetric and has its diagonal.

    Their entries are numbered node pair slowest, then interval, then entry of the pattern.
    """
    computed, local = _computed(numbering, symmetric), numbering.local
    row_in, column_in = np.array(row), np.repeat(np.arange(len(colind) - 1), np.diff(colind))
    a, b, interval, entry = np.ogrid[: len(local), : len(local), : numbering.intervals, : len(row)]
    cell = np.cumsum(computed).reshape(computed.shape) - 1
    cell = np.where(computed, cell, cell.T)[:, :, None, None]
    in_cell = np.where(computed[a, b], entry, np.lexsort((column_in, row_in)))  # else the transposed entry
    numbers = (cell * numbering.intervals + interval) * len(row) + in_cell
    rows, columns = local[a, interval, row_in[entry]], local[b, interval, column_in[entry]]
    return Summation(numbering.free, *(index.ravel() for index in np.broadcast_arrays(rows, columns, numbers)))
