"""Problems that differ in their given values only, and whether their paths lie on one branch.

The given values of a problem are its ends, times, parameters, velocities, momenta and energy, as one vector.  A path of
another branch is far away, or has another Morse index, which changes along a family at conjugate points only.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain
from typing import cast

import numpy as np

from casadi_galerkin.boundary.transcription import GraphCache, SecondVariation
from casadi_galerkin.calculus.roundoff import or_one
from casadi_galerkin.functional.mapping import by_rows
from casadi_galerkin.problems.boundary_problem import BoundaryProblem, Given
from casadi_galerkin.problems.problem import VARIED, Problem, is_given
from casadi_galerkin.solution.guess import relative_distance
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


def ends_replaced(values: np.ndarray, problem: BoundaryProblem) -> np.ndarray:
    """Node values (d, N m + 1) of a path with the ends of another problem, and nothing else changed."""
    moved, ends = values.copy(), problem.given_positions.T
    moved[:, [0, -1]] = np.where(np.isnan(ends), values[:, [0, -1]], ends)
    return moved


def nearest(values: np.ndarray, known: np.ndarray, spread: np.ndarray) -> int:
    """Number of the row of `known` that is nearest to `values`, with distances in units of `spread`."""
    difference = (known - values) / or_one(spread)
    return int(np.argmin(np.sum(difference**2, axis=1)))


def jumps(paths: Mapping[int, Trajectory]) -> dict[int, int]:
    """Number of a path -> number of its neighbor, for those that lie on another branch than their neighbor.

    The paths are of boundary problems.  The neighbor of a path is the nearest one that comes before it.  On another
    branch the Morse index is another one, or both paths are further apart than the larger one's size, where that of the
    neighbor is bent to meet the same ends.
    """
    if not paths:
        return {}
    problems = [cast(BoundaryProblem, path.problem) for path in paths.values()]
    numbers, values = list(paths), np.array([data_vector(problem) for problem in problems])
    spread, on_other_branch = np.ptp(values, axis=0), dict[int, int]()
    indices: list[int | None] = []
    graphs = GraphCache(problems[0], by_rows)
    for k, (number, path) in enumerate(paths.items()):
        graph = graphs.for_problem(problems[k]).transcription(path.method, path.t)
        indices.append(SecondVariation(graph, problems[k], path.polynomial, path.integral_multipliers).negative())
        if k > 0:
            i = nearest(values[k], values[:k], spread)
            own, bent = path.polynomial.values, graph.guess_on_mesh(paths[numbers[i]], path.t).values
            away = min(relative_distance(own, bent), relative_distance(bent, own))  # either may be nearly zero
            if indices[k] != indices[i] or away > 1:
                on_other_branch[number] = numbers[i]
    return on_other_branch
