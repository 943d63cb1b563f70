"""Problems that differ in their given values only, and whether their paths lie on one branch.

The given values of a problem are its ends, times, parameters, velocities, momenta and energy, as one vector.  Along a
smooth family of critical points, the action changes by its partial derivatives by the data only, since its derivatives
by the path vanish: dS = p_N·dx_N - p_0·dx_0 - E_N dt_N + E_0 dt_0 + ∂S/∂π·dπ, with parameters π.  Where S is convex or
concave between two of them, its change lies between the first-order predictions from both; a little more is allowed.
A path of another branch has another action.  It may also have another Morse index, which changes along a family at
conjugate points only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain
from typing import cast

import casadi as ca
import numpy as np

from casadi_galerkin.boundary.transcription import GraphCache, SecondVariation, Transcription
from casadi_galerkin.calculus.roundoff import or_one
from casadi_galerkin.functional.functional import Functional, Parts
from casadi_galerkin.functional.mapping import by_rows
from casadi_galerkin.problems.boundary_problem import BoundaryProblem, Given
from casadi_galerkin.problems.problem import VARIED, Problem, is_given, section_times
from casadi_galerkin.solution.trajectory import Trajectory


def _given(problem: Problem) -> dict[str, Given]:
    """All given values by name; None where a component is free."""
    values = {name: getattr(problem, name, None) for name in VARIED}
    return {name: value if isinstance(value, tuple) else (value,) for name, value in values.items() if is_given(value)}


def same_statement(one: Problem, other: BoundaryProblem) -> bool:
    """Whether one of two problems may be `varied` from the other: the same components given, the same breakpoints."""
    if not isinstance(one, BoundaryProblem) or one.breakpoints != other.breakpoints:
        return False
    patterns = [
        {name: [a is None for a in value] for name, value in _given(problem).items()} for problem in (one, other)
    ]
    return patterns[0] == patterns[1]


def data_vector(problem: Problem) -> np.ndarray:
    """All given numbers of a problem, its times first."""
    return np.array([*problem.t_span, *(a for a in chain(*_given(problem).values()) if a is not None)])


def interpolated_problem(one: BoundaryProblem, other: BoundaryProblem, fraction: float) -> BoundaryProblem:
    """The problem with given values interpolated linearly between those of two problems; `fraction` is 0 at `one`."""
    start, end = ((1 - fraction) * a + fraction * b for a, b in zip(one.t_span, other.t_span, strict=True))
    before, after = _given(one), _given(other)
    changes: dict[str, object] = {}
    for name, values in after.items():
        mixed = [
            None if a is None or b is None else (1 - fraction) * a + fraction * b
            for a, b in zip(before[name], values, strict=True)
        ]
        changes[name] = mixed[0] if name == "energy" else mixed
    return other.varied(changes, (start, end))


def ends_replaced(values: np.ndarray, problem: BoundaryProblem) -> np.ndarray:
    """Node values (d, N m + 1) of a path with the ends of another problem, and nothing else changed."""
    moved, ends = values.copy(), problem.given_positions.T
    moved[:, [0, -1]] = np.where(np.isnan(ends), values[:, [0, -1]], ends)
    return moved


def nearest(values: np.ndarray, known: np.ndarray, spread: np.ndarray) -> int:
    """Number of the row of `known` that is nearest to `values`, with distances in units of `spread`."""
    difference = (known - values) / or_one(spread)
    return int(np.argmin(np.sum(difference**2, axis=1)))


# part of the changes to first order that is allowed where S bends both ways between two points
CHANGE_OF_CURVATURE = 0.03
ACTION_ERROR = 1e-6  # relative error of the action that is allowed for a coarse mesh


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
        allowed = (
            abs(here - there)
            + CHANGE_OF_CURVATURE * (abs(here) + abs(there))
            + ACTION_ERROR * (abs(self.action) + abs(other.action))
        )
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
    index = SecondVariation(graph, problem, path.polynomial, path.integral_multipliers).negative()
    if graph.numbering.multipliers or not graph.stationarity.variational:
        return BranchPoint(values, index, np.nan, np.full(len(values), np.nan))
    unknowns, data = graph.on_path(path.polynomial)
    found = _slopes(graph.functional).call([unknowns, *data])
    action, at_start, at_end, by_joints, *further = (np.array(value).ravel() for value in found)
    joints = section_times(problem)  # only the ends move
    by_end = np.zeros((2, len(joints)))
    by_end[0, 0] = by_end[1, -1] = 1.0
    by_times = [np.interp(mesh, joints, moved) @ by_joints for moved in by_end]
    return BranchPoint(values, index, float(action[0]), np.concatenate((by_times, at_start, at_end, *further)))


def _slopes(functional: Functional) -> ca.Function:
    """(ξ, data) -> S, and its derivatives by start, end, mesh, parameters and given momenta."""

    def parts() -> Parts:
        action, (_, *data) = functional.action, functional.symbols.items()
        slopes = {f"by_{name}": ca.densify(ca.gradient(action, symbol)) for name, symbol in data}
        return {}, {"action": action, **slopes}

    return functional.keep("slopes", parts)
