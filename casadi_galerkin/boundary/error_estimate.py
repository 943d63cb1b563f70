"""How wrong a path between two ends is: by Newton steps in a higher degree, and by what rounding does to it."""

from __future__ import annotations

import math

import numpy as np

from casadi_galerkin.boundary.graph import BoundaryGraph, CriticalPoint
from casadi_galerkin.calculus.mesh_adaptation import interval_maxima, of_higher_degree
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import EPS, component_sizes
from casadi_galerkin.functional.mapping import one_by_one
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.solution.trajectory import Trajectory

SLOWEST = 0.9  # largest ratio of the two Newton steps of an estimate that their series is summed with
ROUNDED = 0.2  # of eps: what rounding to the nearest double changes in the root mean square
SIGNS = 4  # random signs of the rounding of the equations, from which its effect on the path is estimated


def corrections(graph: BoundaryGraph, path: PiecewisePolynomial) -> list[PiecewisePolynomial]:
    """Two Newton steps from a path on the same mesh, of any degree up to this one's; zero if it is critical here.

    With a higher degree than the path's the first estimates the path's error, in the joints as well as between
    them, and the second how far to trust the first.  Where the duration is free, a step of it counts by how far the
    path moves in that time.
    """
    nodes, steps = graph.method.element.nodes, []
    data = graph.data(path.mesh, None, graph.plane(path))
    unknowns = graph.unknowns(path.at(nodes).T, data)
    with graph.stationarity.linearization() as at:
        for _ in range(2):
            found = at.newton_step(unknowns, data)
            steps.append(found.step if np.isfinite(found.norm) else np.full_like(unknowns, np.nan))
            unknowns = unknowns + steps[-1]
    changes = [graph.change(step) for step in steps]
    if graph.numbering.stretched:
        times = path.times(nodes[:-1])
        by_stretch = path(times, 1) * (times - times[0])
        changes = [change - step[-1] * by_stretch for change, step in zip(changes, steps, strict=True)]
    return [PiecewisePolynomial(path.mesh, nodes, change) for change in changes]


def discretization_error(graph: BoundaryGraph, path: PiecewisePolynomial) -> float:
    """Largest error of a path of a lower degree, relative to the size of its components.

    The two Newton steps from it are summed as a geometric series; infinite where one is not finite.
    """
    sizes = component_sizes(path.values)[:, None]
    first, second = (float(np.max(interval_maxima(step) / sizes)) for step in corrections(graph, path))
    if not math.isfinite(first + second):
        return math.inf
    return first / (1 - min(SLOWEST, second / first)) if first > 0 else 0.0


def roundoff_error(graph: BoundaryGraph, point: CriticalPoint) -> float:
    """Estimate what rounding does to a path, relative to the size of its components.

    It is the root mean square, over a few choices of random signs, of the largest |∇²S⁻¹ r|, where every r_i is
    `ROUNDED` times eps and the terms that the i-th equation sums.  The true error was measured at 0.1 to 5 times
    that, or less by luck and symmetry.
    """
    unknowns, data = point.solution.unknowns, point.data
    terms = ROUNDED * EPS * np.array(graph.functional.function("summary")(unknowns, *data)[3]).ravel()
    signs = np.random.default_rng(len(unknowns)).choice((-1.0, 1.0), (SIGNS, len(unknowns)))
    with graph.stationarity.linearization() as at:
        at.relinearize(unknowns, data)
        moved = np.array(at.solve(*(signs * terms))) / graph.stationarity.sizes(unknowns, data)
    floor = float(np.sqrt(np.mean(np.max(np.abs(moved), axis=1) ** 2))) + EPS
    return floor if math.isfinite(floor) else math.inf


def error_between_ends(path: Trajectory) -> float:
    """Estimate the relative error of a path between two ends: see `Trajectory.estimate_error`."""
    problem = path.problem
    assert isinstance(problem, BoundaryProblem)
    higher = BoundaryGraph(problem, of_higher_degree(path.method.degree), path.t, one_by_one)
    return path.doubted(discretization_error(higher, path.polynomial))
