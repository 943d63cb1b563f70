"""Control points C in ]0, 1[ and barycentric Lagrange interpolation on the nodes {0} ∪ C ∪ {1}.

The m - 1 control points and the two ends are the m + 1 nodes of the Lagrange polynomials l_0 ... l_m of one interval
(paper, section 2).  Their choice changes conditioning, and the solution only where bounds are imposed at them.
Formulas after J.-P. Berrut and L. N. Trefethen, "Barycentric Lagrange interpolation", SIAM Review 46 (2004).
"""

from __future__ import annotations

import numpy as np

from casadi_galerkin.calculus.numbers import whole_number
from casadi_galerkin.calculus.quadrature import lobatto


def lobatto_points(degree: int) -> np.ndarray:
    """Control points of the given degree >= 1 at the inner Gauss-Lobatto points; shape (degree - 1,).

    Examples
    --------
    >>> lobatto_points(3).round(6).tolist()
    [0.276393, 0.723607]
    """
    return np.array(lobatto(whole_number("degree", degree) + 1).points[1:-1])


def chebyshev_points(degree: int) -> np.ndarray:
    """Control points at the inner Chebyshev points (1 - cos(jπ/m))/2, m = degree >= 1; shape (degree - 1,).

    Examples
    --------
    >>> chebyshev_points(3).round(6).tolist()
    [0.25, 0.75]
    """
    degree = whole_number("degree", degree)
    return np.sin(np.pi / 2 * np.arange(1, degree) / degree) ** 2


def equispaced_points(degree: int) -> np.ndarray:
    """Equally spaced control points j/m, m = degree >= 1; shape (degree - 1,).  Ill-conditioned above 10.

    Examples
    --------
    >>> equispaced_points(4).tolist()
    [0.25, 0.5, 0.75]
    """
    degree = whole_number("degree", degree)
    return np.arange(1, degree) / degree


def barycentric_weights(nodes: np.ndarray) -> np.ndarray:
    """Weights 1/Π_{k≠j}(s_j - s_k) of distinct nodes, scaled so that the largest is 1; shape of `nodes`."""
    gaps = nodes[:, None] - nodes[None, :]
    np.fill_diagonal(gaps, 1.0)
    logs = -np.log(np.abs(gaps)).sum(axis=1)  # the plain product leaves the range of doubles near degree 500
    return np.prod(np.sign(gaps), axis=1) * np.exp(logs - logs.max())


def lagrange_values(nodes: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Lagrange polynomials l_j(s_k) of the nodes; shape (len(s), len(nodes)).  Rows sum to 1."""
    gaps = s[:, None] - nodes[None, :]
    hit = gaps == 0
    gaps[hit] = 1.0
    terms = barycentric_weights(nodes) / gaps
    rows = hit.any(axis=1)
    terms[rows] = hit[rows]
    return terms / terms.sum(axis=1, keepdims=True)


def differentiation_matrix(nodes: np.ndarray) -> np.ndarray:
    """Derivatives l_j'(s_k) at the nodes themselves; square.  Rows sum to zero by construction."""
    weights = barycentric_weights(nodes)
    gaps = nodes[:, None] - nodes[None, :]
    np.fill_diagonal(gaps, 1.0)
    matrix = weights[None, :] / weights[:, None] / gaps
    np.fill_diagonal(matrix, 0.0)
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    return matrix


def lagrange_basis(nodes: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lagrange polynomials l_j(s_k) of the nodes, and their derivatives; (len(s), len(nodes)) each."""
    values = lagrange_values(nodes, s)
    return values, values @ differentiation_matrix(nodes)
