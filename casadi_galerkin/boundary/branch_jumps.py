"""Whether paths of neighboring problems lie on one branch, judged by the change of the action and the Morse index.

Along a smooth family of critical points, the action changes by its partial derivatives by the data only, since its
derivatives by the path vanish: dS = p_N·dx_N - p_0·dx_0 - E_N dt_N + E_0 dt_0 + ∂S/∂π·dπ, with parameters π.  Where S
is convex or concave between two of them, its change lies between the first-order predictions from both; a little more
is allowed.  A path of another branch has another action.  It may also have another Morse index, which changes along a
family at conjugate points only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import casadi as ca
import numpy as np

from casadi_galerkin.boundary.graph_cache import GraphCache
from casadi_galerkin.boundary.problem_data import data_vector, nearest
from casadi_galerkin.boundary.transcription import SecondVariation, Transcription
from casadi_galerkin.functional.functional import Functional, Parts
from casadi_galerkin.functional.mapping import by_rows
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.problem import section_times
from casadi_galerkin.solution.trajectory import Trajectory

BENT = 0.03  # part of the changes to first order that is allowed where S bends both ways between two points
ROUGH = 1e-6  # relative error of the action that is allowed for a coarse mesh


@dataclass(frozen=True)
class BranchPoint:
    """A path as a point of a family: given values, Morse index, action and its derivatives by the given values.

    The last two are NaN under constraints and end conditions, and where no action is stationary.
    """

    values: np.ndarray
    index: int | None
    action: float
    slopes: np.ndarray

    def on_other_branch(self, other: BranchPoint) -> bool:
        """Whether two neighboring points lie on different branches."""
        step = self.values - other.values
        here, there = float(self.slopes @ step), float(other.slopes @ step)
        allowed = abs(here - there) + BENT * (abs(here) + abs(there)) + ROUGH * (abs(self.action) + abs(other.action))
        return self.index != other.index or abs(self.action - other.action - (here + there) / 2) > allowed


def jumps(paths: Mapping[int, Trajectory]) -> dict[int, int]:
    """Number of a path -> number of its neighbor, for those that lie on another branch than their neighbor.

    The paths are of boundary problems.  The neighbor of a path is the nearest one that comes before it.
    """
    if not paths:
        return {}
    problems = [cast(BoundaryProblem, path.problem) for path in paths.values()]
    numbers, values = list(paths), np.array([data_vector(problem) for problem in problems])
    spread, on_other_branch = np.ptp(values, axis=0), dict[int, int]()
    points: list[BranchPoint] = []
    graphs = GraphCache(problems[0], by_rows)
    for k, (number, path) in enumerate(paths.items()):
        graph = graphs.for_problem(problems[k]).transcription(path.method, path.t)
        points.append(_branch_point(graph, path, values[k]))
        if k > 0:
            i = nearest(values[k], values[:k], spread)
            if points[k].on_other_branch(points[i]):
                on_other_branch[number] = numbers[i]
    return on_other_branch


def _branch_point(graph: Transcription, path: Trajectory, values: np.ndarray) -> BranchPoint:
    problem, mesh = graph.problem, path.t
    index = SecondVariation(graph, problem, path.polynomial).negative()
    if graph.numbering.multipliers or not graph.stationarity.variational:
        return BranchPoint(values, index, np.nan, np.full(len(values), np.nan))
    unknowns, data = graph.on_path(path.polynomial)
    found = _slopes(graph.functional).call([unknowns, *data])
    action, at_start, at_end, by_joints, *further = (np.array(value).ravel() for value in found)
    joints = section_times(problem)  # only the ends move
    ways = np.zeros((2, len(joints)))
    ways[0, 0] = ways[1, -1] = 1.0
    by_times = [np.interp(mesh, joints, way) @ by_joints for way in ways]
    return BranchPoint(values, index, float(action[0]), np.concatenate((by_times, at_start, at_end, *further)))


def _slopes(functional: Functional) -> ca.Function:
    """(ξ, data) -> S, and its derivatives by start, end, mesh, parameters and given momenta."""

    def parts() -> Parts:
        action, (_, *data) = functional.action, functional.symbols.items()
        slopes = {f"by_{name}": ca.densify(ca.gradient(action, symbol)) for name, symbol in data}
        return {}, {"action": action, **slopes}

    return functional.keep("slopes", parts)
