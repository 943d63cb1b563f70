"""How wrong a path between two ends is: by Newton steps in a higher degree, and by what rounding does to it."""

from __future__ import annotations

import math

import numpy as np

from casadi_galerkin.boundary.graph import BoundaryGraph, CriticalPoint
from casadi_galerkin.calculus.mesh_adaptation import largest_change, of_higher_degree
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.functional.mapping import one_by_one
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.solution.trajectory import Trajectory

SLOWEST = 0.9  # largest ratio of the two Newton steps of an estimate that their series is summed with
ROUNDED = 0.2  # of eps: what rounding to the nearest double changes in the root mean square


def discretization_error(graph: BoundaryGraph, path: PiecewisePolynomial, tol: float = 0.0) -> float:
    """Largest error of a path of a lower degree than the graph's, relative to the size of its components.

    The first Newton step from it on the same mesh estimates its error, in the joints as well as between them, and the
    second tells how far to trust the first: both are summed as a geometric series.  It makes the first at most
    1 / (1 - `SLOWEST`) times as large, so where that is below `tol` anyway, it is not taken.  Where the duration is
    free, a step of it counts by how far the path moves in that time.

    Returns infinity where a step is not finite.
    """
    nodes = graph.method.element.nodes
    data = graph.data(path.mesh, None, graph.plane(path))
    unknowns = graph.unknowns(path.at(nodes).T, data)

    def moved(step: np.ndarray) -> float:
        """Largest change of the path by a step."""
        change = graph.change(step)
        if graph.numbering.stretched:
            times = path.times(nodes[:-1])
            change = change - step[-1] * path(times, 1) * (times - times[0])
        return largest_change(path, nodes, change)

    second = 0.0
    with graph.stationarity.linearization() as at:
        (step,) = at.solve(at.relinearize(unknowns, data))
        first = moved(step)
        if first > (1 - SLOWEST) * tol:
            second = moved(*at.solve(at.relinearize(unknowns + step, data)))
    if not math.isfinite(first + second):
        return math.inf
    return first / (1 - min(SLOWEST, second / first)) if first > 0 else 0.0


def roundoff_error(graph: BoundaryGraph, point: CriticalPoint) -> float:
    """Estimate what rounding does to a path, relative to the size of its components.

    It is the root mean square, over a few choices of random signs, of the largest |∇²S⁻¹ r|, where every r_i is
    `ROUNDED` times eps and the terms that the i-th equation sums.  The true error was measured at 0.1 to 5 times
    that, or less by luck and symmetry.
    """
    unknowns, data = point.solution.unknowns, point.solution.data
    terms = ROUNDED * EPS * np.array(graph.functional.function("summary")(unknowns, *data)[3]).ravel()
    with graph.stationarity.linearization() as at:
        at.relinearize(unknowns, data)
        moved = at.blurs(terms) / graph.stationarity.sizes(unknowns, data)
    floor = float(np.sqrt(np.mean(np.max(np.abs(moved), axis=1) ** 2))) + EPS
    return floor if math.isfinite(floor) else math.inf


def error_between_ends(path: Trajectory) -> float:
    """Estimate the relative error of a path between two ends: see `Trajectory.estimate_error`."""
    problem = path.problem
    assert isinstance(problem, BoundaryProblem)
    higher = BoundaryGraph(problem, of_higher_degree(path.method.degree), path.t, one_by_one)
    return path.doubted(discretization_error(higher, path.polynomial))
