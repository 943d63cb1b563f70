"""Mesh adaptation: the truncation error of a path on each interval, and meshes that equidistribute it.

What a piecewise polynomial of degree m leaves out of a path on an interval, its truncation error, is estimated from the
decay of its Legendre coefficients there.  A new mesh makes it equally large on all intervals (equidistribution).
Nothing here depends on the problem that the path solves.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre

from casadi_galerkin.calculus.discrete_calculus import spread_between
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, sampling_parts
from casadi_galerkin.calculus.roundoff import TINY

MOST_PARTS_OF_AN_INTERVAL = 32.0  # an interval is split into at most this many at once
MOST_MERGED_INTERVALS = 4.0  # at most this many are merged at once; a mesh that has fewer times what it needs is kept
# largest ratio of densities of neighboring intervals of a new mesh, unless one would be split into more parts
NEIGHBOR_RATIO = 8.0
FEWEST = 4  # least number of intervals of a new mesh
LEAST_INTERVALS_GROWTH = 1.25  # least factor by which the number of intervals grows, if it does
LOW_DEGREE = 8  # below this degree errors are estimated with four degrees more, from it on with two more
ERROR_TARGET = 0.3  # a new mesh aims at this part of the tolerance


@lru_cache(32)  # so that its basis is computed once
def higher_degree_method(degree: int) -> Galerkin:
    """The method whose path on the same mesh is compared with one of this degree, to estimate the error of that.

    One degree more adds nothing to a path of the other parity.  At low degrees two more are too few: with a feature
    narrower than its interval they showed an eighth of the error.  At high degrees two are enough, and four add to the
    roundoff.
    """
    return Galerkin(degree + (4 if degree < LOW_DEGREE else 2))


@lru_cache(32)
def method_for(tol: float) -> Galerkin:
    """The default method for a tolerance: of low degree for a loose one, of high degree for a tight one."""
    return Galerkin(int(np.clip(np.ceil(2 - np.log10(tol)), 4, 14)))


@lru_cache(maxsize=64)
def _to_legendre(nodes: tuple[float, ...]) -> np.ndarray:
    """Matrix from values at the nodes of [0, 1] to Legendre coefficients."""
    return np.linalg.inv(legendre.legvander(2 * np.array(nodes) - 1, len(nodes) - 1))


def legendre_coefficients(path: PiecewisePolynomial, sizes: np.ndarray) -> np.ndarray:
    """Legendre coefficients of a path on every interval, relative to sizes (d,) of the components; (d, N, m + 1)."""
    return (path.local / sizes[:, None, None]) @ _to_legendre(tuple(path.nodes.tolist())).T


def truncation_error(path: PiecewisePolynomial, sizes: np.ndarray | None = None) -> np.ndarray:
    """Estimate the truncation error of a path on each interval, relative to the sizes of the components; (N,).

    It is taken for the first Legendre coefficient beyond the degree.  The coefficients of an analytic function fall
    geometrically: their rate follows from the last four, in pairs because of parity, and with it the next coefficient
    from the last two.  Below degree 3 there are not four: the next coefficient is then estimated from the change of the
    last one between neighboring intervals.
    """
    m = path.degree
    signed = legendre_coefficients(path, path.sizes if sizes is None else sizes)
    coefficients = np.abs(signed)
    if m < 3:
        steps, last = np.diff(path.mesh), np.max(coefficients[:, :, -1], axis=0)
        if len(steps) == 1:
            return last
        change = np.max(np.abs(np.diff(signed[:, :, -1] / steps**m, axis=1)), axis=0) / (steps[1:] + steps[:-1]) * 2
        largest = np.maximum(np.append(change[:1], change), np.append(change, change[-1:]))
        return largest * steps ** (m + 1) / (4 * m + 2)
    last = np.maximum(coefficients[:, :, -1], coefficients[:, :, -2])
    before = np.maximum(coefficients[:, :, -3], coefficients[:, :, -4])
    rate = np.sqrt(np.minimum(last / np.maximum(before, TINY), 1.0))
    following = rate * np.maximum(coefficients[:, :, -1], rate * coefficients[:, :, -2])
    return np.max(following, axis=0)


def largest_change(path: PiecewisePolynomial, nodes: np.ndarray, values: np.ndarray) -> float:
    """Largest size of a change of a path, relative to the sizes of the path's components.

    The change has `values` (d, N m' + 1) at `nodes`, and is sampled between them as well.
    """
    change = PiecewisePolynomial(path.mesh, nodes, values)
    sampled = change.at_parts(sampling_parts(change.degree))[0]
    return float(np.max(np.abs(sampled) / path.sizes[:, None, None]))


def largest_difference(path: PiecewisePolynomial, other: PiecewisePolynomial) -> float:
    """`largest_change` from a path to one of another degree on as many intervals."""
    return largest_change(path, other.nodes, other.values - path.at(other.nodes))


def spread_over(
    mesh: np.ndarray, cumulated: np.ndarray, intervals: int, breakpoints: tuple[float, ...] = ()
) -> np.ndarray:
    """Joints of intervals with equal integrals of a density, of which `cumulated` (N + 1,) is the integral over a mesh.

    Breakpoints are joints, and they are equal between two of them.
    """
    fixed = np.array([mesh[0], *breakpoints, mesh[-1]])
    edges = np.interp(fixed, mesh, cumulated)
    at = spread_between(edges, intervals)
    joints = np.interp(at, cumulated, mesh)
    joints[np.searchsorted(at, edges)] = fixed
    return joints


def resized_mesh(mesh: np.ndarray, intervals: int, breakpoints: tuple[float, ...] = ()) -> np.ndarray:
    """Joints that are graded like those of a mesh, but with another number of intervals; breakpoints are joints."""
    return spread_over(mesh, np.arange(len(mesh)), intervals, breakpoints)


def halved(mesh: np.ndarray) -> np.ndarray:
    """The mesh with every interval halved."""
    return resized_mesh(mesh, 2 * (len(mesh) - 1))


def parts_wanted(error: np.ndarray, order: int | np.ndarray, tol: float) -> np.ndarray:
    """Parts into which to split intervals with errors (N,) that fall with the step to the power `order`; (N,)."""
    return (error / (ERROR_TARGET * tol)) ** (1.0 / order)


def equidistributed(
    mesh: np.ndarray,
    parts: np.ndarray,
    fewest: int = FEWEST,
    breakpoints: tuple[float, ...] = (),
) -> np.ndarray:
    """Joints of a new mesh with intervals split as wanted, or nearly so: lengths of neighbors must not differ too much.

    Parameters
    ----------
    mesh : (N + 1,)
    parts : (N,), numbers of parts into which intervals are to be split; where below one, they are joined
    fewest : least number of intervals of the new mesh
    breakpoints : increasing times inside that are joints

    Returns
    -------
    (N' + 1,) joints with the same ends; N' = N where that is about enough, so that no graph has to be rebuilt
    """
    density = np.clip(parts, 1 / MOST_MERGED_INTERVALS, MOST_PARTS_OF_AN_INTERVAL) / np.diff(mesh)
    for i in range(1, len(density)):
        density[i] = max(density[i], density[i - 1] / NEIGHBOR_RATIO)
    for i in range(len(density) - 2, -1, -1):
        density[i] = max(density[i], density[i + 1] / NEIGHBOR_RATIO)
    density = np.minimum(density, MOST_PARTS_OF_AN_INTERVAL / np.diff(mesh))
    cumulated = np.concatenate(([0.0], np.cumsum(density * np.diff(mesh))))
    edges = np.interp([mesh[0], *breakpoints, mesh[-1]], mesh, cumulated)
    count = max(fewest, int(np.ceil(np.diff(edges)).sum()))
    before = len(mesh) - 1
    if before / MOST_MERGED_INTERVALS < count <= before:
        count = before
    elif count > before:
        count = max(count, int(np.ceil(LEAST_INTERVALS_GROWTH * before)))
    return spread_over(mesh, cumulated, count, breakpoints)


def resolving_interpolant(
    interpolated: Callable[[np.ndarray], PiecewisePolynomial],
    mesh: np.ndarray,
    tol: float,
    most: int,
    breakpoints: tuple[float, ...] = (),
) -> PiecewisePolynomial:
    """Interpolate a function on a mesh that resolves it to a tolerance, or on the first that has more than so many.

    Parameters
    ----------
    interpolated : takes joints, and returns the function's interpolant on them
    mesh : (N + 1,) joints to begin with
    tol : relative to the size of each component
    most : number of intervals beyond which the mesh is not refined
    breakpoints : increasing times inside that are joints
    """
    path = interpolated(mesh)
    while np.max(error := truncation_error(path)) > tol and len(path.mesh) <= most:
        parts = parts_wanted(error, path.degree + 1, tol)
        path = interpolated(equidistributed(path.mesh, parts, len(path.mesh), breakpoints))
    return path
