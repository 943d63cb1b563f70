"""Errors of a path between two ends: of its discretization, by Newton steps in a higher degree, and of its roundoff.

Both hold only where the mesh resolves also the variations of the path: see `agreement`.
"""

from __future__ import annotations

import math

import numpy as np

from casadi_galerkin.boundary.graph import BoundaryGraph
from casadi_galerkin.calculus.mesh_adaptation import largest_change
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import EPS, TINY
from casadi_galerkin.functional.numbering import Data

# agreement below which a mesh is halved; at 0.83 some 3 % of undetermined kinks were accepted, at 0.95 a few
REQUIRED_AGREEMENT = 0.99
LEAST_AGREEMENT = 0.95  # agreement below which a given mesh does not resolve the variations
LARGEST_RATIO = 0.9  # largest ratio of two Newton steps with which their geometric series is summed
RESPONSE_FORCES = 3  # number of forces with which two degrees are compared: with one alone they may agree by chance


def discretization_error(graph: BoundaryGraph, path: PiecewisePolynomial) -> float:
    """Largest error of a path of the graph's degree, relative to the size of its components.

    The first Newton step from it in a higher degree on the same mesh estimates its error, at the joints and between
    them.  With the second step it is extrapolated as a geometric series.  Where the duration is free, a step of the
    duration counts as the distance that the path moves in that time.  The error of the multiplier of a given integral
    counts as well, relative to the multiplier, or to how it changes with the path where that changes by its size.  It
    is infinite where a step is not finite.
    """
    multipliers = graph.integral_multipliers(graph.on_path(path)[0]) if graph.numbering.integrals else np.empty(0)
    graph = graph.higher
    nodes, numbering = graph.method.element.nodes, graph.numbering
    unknowns, data = graph.on_path(path)
    unknowns[numbering.everywhere][: numbering.integrals] = multipliers
    values = np.eye(numbering.integrals, numbering.free, numbering.everywhere.start)

    def moved(step: np.ndarray) -> float:
        """Largest relative change of the path by a step."""
        change = graph.change(step)
        if numbering.free_duration:
            times = path.times(nodes[:-1])
            change = change - step[-1] * path(times, 1) * (times - times[0])
        return largest_change(path, nodes, change)

    def changed(step: np.ndarray) -> float:
        """The same, or the largest relative change of a multiplier."""
        return max(moved(step), *np.abs(graph.integral_multipliers(step)) / sizes) if len(sizes) else moved(step)

    with graph.stationarity.linearization() as at:
        step, *by_values = at.solve(at.relinearize(unknowns, data), *values)
        sizes = np.abs(multipliers)
        for by in by_values:
            sizes = np.fmax(sizes, np.abs(graph.integral_multipliers(by)) / max(moved(by), TINY))
        (again,) = at.solve(at.relinearize(unknowns + step, data))
    if not np.isfinite([step, again]).all():
        return math.inf
    first, second = changed(step), changed(again)
    return first / (1 - min(LARGEST_RATIO, second / first)) if first > 0 else 0.0


def agreement(graph: BoundaryGraph, path: PiecewisePolynomial) -> float:
    """Agreement, from 0 to 1, of the responses of a path to the same forces in the graph's degree and in a higher one.

    Where the ends hardly determine a path, as in ε x'' = t x' by exp(-1/2ε), a mesh that is too coarse for the path's
    variations determines it instead.  Every degree then finds some path, with a small estimated error.  But the degrees
    differ in how stiffly they hold it.

    It is the smallest ratio, over all forces and components, of the mean responses over the nodes.  Means are taken
    because single responses may be large in a layer that the path itself does not have.  A small mean counts as
    √eps times the largest.  Where responses disagree, they are compared again after one step of iterative refinement,
    and after two: rounding alone changes those of short intervals, and of a Hessian that is nearly singular.
    """
    if not graph.numbering.positions:
        return 1.0  # nothing can vary
    agreed = 0.0
    for refinements in range(3):
        higher = _responses(graph.higher, path, 1, refinements)
        lower = _responses(graph, path, 0, refinements).at(higher.nodes)
        if np.isfinite(lower).all() and np.isfinite(higher.values).all():  # neither Hessian is singular
            means = np.array([np.mean(np.abs(values), axis=1) for values in (lower, higher.values)])
            means = np.maximum(means, EPS**0.5 * np.max(means) + TINY)
            agreed = float(np.min(means.min(axis=0) / means.max(axis=0)))
        if agreed >= REQUIRED_AGREEMENT:
            break
    return agreed


def _responses(graph: BoundaryGraph, path: PiecewisePolynomial, steps: int, refinements: int) -> PiecewisePolynomial:
    """Changes of a path by some forces, `steps` of Newton from it: the components for the first, then for the next."""
    unknowns, data = graph.on_path(path)
    with graph.stationarity.linearization() as at:
        gradient = at.relinearize(unknowns, data)
        for _ in range(steps):
            unknowns = unknowns + at.solve(gradient)[0]
            gradient = at.relinearize(unknowns, data)
        forces = _generic_forces(graph, path, at.mass)
        varied = at.solve(*forces)
        for _ in range(refinements):
            varied = at.refined(unknowns, data, forces, varied)
    changes = np.concatenate([graph.change(step) for step in varied])
    return PiecewisePolynomial(path.mesh, graph.method.element.nodes, changes)


def _generic_forces(graph: BoundaryGraph, path: PiecewisePolynomial, mass: np.ndarray) -> np.ndarray:
    """Virtual work ∫ F·δx dt of smooth forces F(t) that are the same in all degrees; (forces, unknowns).

    A force is the mass times an acceleration of the path's size, so that it moves the path by a finite distance also
    where the mass vanishes.  `mass`, (N r, d, d), is ∂²L̂/∂x'² at the points of the graph.
    """
    numbering, element, d, steps = graph.numbering, graph.method.element, len(path.values), np.diff(path.mesh)
    times = (path.mesh[:-1] - path.mesh[0] + element.points[:, None] * steps) / (path.mesh[-1] - path.mesh[0])
    phases = np.arange(d)[:, None, None] + 3 * times
    accelerations = np.cos(np.multiply.outer(np.arange(1, RESPONSE_FORCES + 1), phases)) * path.sizes[:, None, None]
    forces = np.einsum("qnij,fjqn->fiqn", mass.reshape(*times.shape, d, d), accelerations) * steps**2
    works = np.zeros((RESPONSE_FORCES, numbering.size))
    of_nodes = np.einsum("fiqn,qa->anif", forces, element.weights[:, None] * element.values)
    np.add.at(works.T, numbering.local, of_nodes)
    return works[:, : numbering.free]


def roundoff_error(graph: BoundaryGraph, unknowns: np.ndarray, data: Data) -> float:
    """Estimate the roundoff error of a path, relative to the size of its components.

    It is the root mean square, over a few random r, of the largest |∇²S⁻¹ r|, where r is an error of every equation by
    rounding of its terms (`Linearization.rounding_effects`).
    """
    with graph.stationarity.linearization() as at:
        at.relinearize(unknowns, data)
        moved = at.rounding_effects(unknowns, data)
    largest = np.max(np.abs(moved) / graph.stationarity.sizes(unknowns, data), axis=1)
    floor = float(np.sqrt(np.mean(largest**2))) + EPS
    return floor if math.isfinite(floor) else math.inf


def error_between_ends(graph: BoundaryGraph, path: PiecewisePolynomial) -> float:
    """Estimate the error of a path of the graph's degree: where `agreement` is poor, at least 1 minus that."""
    error, agreed = discretization_error(graph, path), agreement(graph, path)
    return error if agreed >= LEAST_AGREEMENT else max(error, 1 - agreed)
