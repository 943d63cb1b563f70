"""Where a piecewise polynomial is too coarse, and a mesh that is not: arrays in, arrays out.

The size of what a path of degree m leaves out on an interval is read off the decay of its Legendre coefficients
there; a new mesh spreads it evenly (equidistribution).  Nothing here knows what problem the path solves.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre

from casadi_galerkin.calculus.discrete_calculus import spread_between
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import TINY, component_sizes

FINEST = 32.0  # an interval is split into at most this many at once
COARSEST = 4.0  # and at most this many are merged
NEIGHBORS = 8.0  # largest ratio of densities of neighboring intervals of a new mesh, unless one is split too much
FEWEST = 4  # intervals of a new mesh
FEWER = 3.0  # factor of too many intervals from which the number of intervals is lowered
GROWTH = 1.25  # least factor by which the number of intervals grows, if it does
LOW = 8  # degree below which an error estimate takes four degrees more, and from which it takes two
MESHES = 10  # on which a function is looked at until one resolves it
TARGET = 0.3  # a new mesh aims at this part of the tolerance


@lru_cache(32)
def of_degree(degree: int) -> Galerkin:
    """The default method of a degree, kept with its basis."""
    return Galerkin(degree)


def of_higher_degree(degree: int) -> Galerkin:
    """The method whose path on the same mesh tells the error of a path of this degree.

    One degree more adds nothing to a path of the other parity.  At low degrees two are too few: a feature narrower than
    its interval was seen to show an eighth of its error.  At high ones they are enough, and four add to the roundoff.
    """
    return of_degree(degree + (4 if degree < LOW else 2))


def method_for(tol: float) -> Galerkin:
    """The default method for a tolerance: of low degree for a loose one, of high degree for a tight one."""
    return of_degree(int(np.clip(np.ceil(2 - np.log10(tol)), 4, 14)))


@lru_cache(maxsize=64)
def _to_legendre(nodes: tuple[float, ...]) -> np.ndarray:
    """Matrix from values at the nodes of [0, 1] to Legendre coefficients."""
    return np.linalg.inv(legendre.legvander(2 * np.array(nodes) - 1, len(nodes) - 1))


def truncation(path: PiecewisePolynomial, sizes: np.ndarray | None = None) -> np.ndarray:
    """Estimate what a path of its degree leaves out on each interval, relative to the sizes of the components; (N,).

    The Legendre coefficients of an analytic function fall geometrically.  Their rate is taken from the last four,
    in pairs because of parity, and the first coefficient left out follows from the last two with it.  Below degree 3
    there are no four: the first coefficient left out then follows from the last one's change between neighbors.
    """
    m = len(path.nodes) - 1
    local = path.local / (component_sizes(path.values) if sizes is None else sizes)[:, None, None]
    signed = local @ _to_legendre(tuple(path.nodes.tolist())).T  # (d, N, m + 1)
    coefficients = np.abs(signed)
    if m < 3:
        steps, last = np.diff(path.mesh), np.max(coefficients[:, :, -1], axis=0)
        if len(steps) == 1:
            return np.asarray(last)
        change = np.max(np.abs(np.diff(signed[:, :, -1] / steps**m, axis=1)), axis=0) / (steps[1:] + steps[:-1]) * 2
        largest = np.maximum(np.append(change[:1], change), np.append(change, change[-1:]))
        return np.asarray(largest * steps ** (m + 1) / (4 * m + 2))
    last = np.maximum(coefficients[:, :, -1], coefficients[:, :, -2])
    before = np.maximum(coefficients[:, :, -3], coefficients[:, :, -4])
    rate = np.sqrt(np.minimum(last / np.maximum(before, TINY), 1.0))
    following = rate * np.maximum(coefficients[:, :, -1], rate * coefficients[:, :, -2])
    return np.asarray(np.max(following, axis=0))


def largest_change(path: PiecewisePolynomial, nodes: np.ndarray, values: np.ndarray) -> float:
    """Largest change of a path, relative to the sizes of its components, that has values (d, N m' + 1) at other nodes.

    It is sampled between the nodes as well.
    """
    change = PiecewisePolynomial(path.mesh, nodes, values)
    sampled = change.at_parts(np.linspace(0, 1, 4 * change.degree + 1))[0]
    return float(np.max(np.abs(sampled) / component_sizes(path.values)[:, None, None]))


def spread_over(
    mesh: np.ndarray, cumulated: np.ndarray, intervals: int, breakpoints: tuple[float, ...] = ()
) -> np.ndarray:
    """So many intervals with equal shares of what the joints of a mesh have `cumulated`, and whole between breakpoints.

    So no joint has to be moved onto a breakpoint.
    """
    fixed = np.array([mesh[0], *breakpoints, mesh[-1]])
    edges = np.interp(fixed, mesh, cumulated)
    at = spread_between(edges, intervals)
    joints = np.interp(at, cumulated, mesh)
    joints[np.searchsorted(at, edges)] = fixed
    return np.asarray(joints)


def graded_alike(mesh: np.ndarray, intervals: int, breakpoints: tuple[float, ...] = ()) -> np.ndarray:
    """Joints that are graded as those of a mesh, with so many intervals, breakpoints among them."""
    return spread_over(mesh, np.arange(len(mesh)), intervals, breakpoints)


def equidistributed(
    mesh: np.ndarray,
    error: np.ndarray,
    order: int,
    tol: float,
    finest: float = FINEST,
    fewest: int = FEWEST,
    breakpoints: tuple[float, ...] = (),
) -> np.ndarray:
    """Joints of a new mesh on which every interval's error should be a fraction of the tolerance.

    Parameters
    ----------
    mesh : (N + 1,)
    error : (N,), errors of the present intervals, which fall with the step to the power `order`
    order : int
    tol : tolerance
    finest : largest number of intervals that one is split into
    fewest : least number of intervals of the new mesh
    breakpoints : increasing times inside that are joints

    Returns
    -------
    (N' + 1,) joints with the same ends; N' = N where that is about enough, so that no graph need be built anew
    """
    wanted = np.clip((error / (TARGET * tol)) ** (1.0 / order), 1 / COARSEST, finest)
    density = wanted / np.diff(mesh)
    for i in range(1, len(density)):
        density[i] = max(density[i], density[i - 1] / NEIGHBORS)
    for i in range(len(density) - 2, -1, -1):
        density[i] = max(density[i], density[i + 1] / NEIGHBORS)
    density = np.minimum(density, finest / np.diff(mesh))
    cumulated = np.concatenate(([0.0], np.cumsum(density * np.diff(mesh))))
    edges = np.interp([mesh[0], *breakpoints, mesh[-1]], mesh, cumulated)
    count = max(fewest, int(np.ceil(np.diff(edges)).sum()))
    before = len(mesh) - 1
    if before / FEWER < count <= before:
        count = before
    elif count > before:
        count = max(count, int(np.ceil(GROWTH * before)))
    return spread_over(mesh, cumulated, count, breakpoints)


def resolved(
    interpolated: Callable[[np.ndarray], PiecewisePolynomial],
    mesh: np.ndarray,
    tol: float,
    most: int,
    breakpoints: tuple[float, ...] = (),
) -> PiecewisePolynomial:
    """A function on joints between which its interpolant leaves out at most a tolerance; or the last of `MESHES`.

    Parameters
    ----------
    interpolated : the function's interpolant on the joints that it is given
    mesh : (N + 1,) joints to begin with
    tol : relative to the size of each component
    most : number of intervals from which it is left as it is
    breakpoints : increasing times inside that are joints
    """
    path = interpolated(mesh)
    for _ in range(MESHES):
        error = truncation(path)
        if np.max(error) <= tol or len(path.mesh) > most:
            break
        path = interpolated(equidistributed(path.mesh, error, path.degree + 1, tol, breakpoints=breakpoints))
    return path
