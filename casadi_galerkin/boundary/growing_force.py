"""A path under a force, followed from the path under hardly any of it.

Where a force rules the motion, as in ε x'' = F(t, x, x') with a small ε, the path has layers whose places nobody knows
before.  Under a small share of the force, which is a large ε, it has none, and Newton's method finds it from any guess.
As the share grows, the layers form, and the mesh is refined for each path before the next share is tried.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca
import numpy as np

from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.levels import Levels
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.problem import with_values
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import Guess

GROWTH, SLOWEST = 100.0, 1.1  # factor by which a share first grows, and below which the path is lost
LEAST = 1e-8  # share of the force that is tried last: where even that is too much, no share will do


def under_growing_force(
    levels: Levels,
    mesh: np.ndarray,
    guess: Guess | None,
    roughly: Callable[[Levels, np.ndarray, Guess | None], CriticalPoint],
) -> CriticalPoint:
    """Find the path under the whole force, from those under shares of it.

    Parameters
    ----------
    levels, mesh, guess : as for `first_path_strategies`
    roughly : (levels, mesh, guess) -> the path from there, on a mesh that resolves it
    """
    share, growth, known = 1 / GROWTH, GROWTH, 0.0
    while True:
        part = levels if share == 1.0 else Levels(_under_share(levels.problem, share))
        try:
            point = roughly(part, mesh, guess)
        except ConvergenceError as failure:
            growth = math.sqrt(growth) if known else growth
            if growth < SLOWEST or share <= LEAST:
                words = f"the path under a growing force was lost at a share of {share:.2g}: {failure}"
                raise ConvergenceError(words, failure.path, failure.residual, failure.iterations) from None
            share = known * growth if known else share / GROWTH
        else:
            if share == 1.0:
                return point
            mesh, guess, known = point.polynomial.mesh, point.polynomial, share
            share = min(1.0, known * growth)
        finally:
            if part is not levels:
                levels.iterations += part.iterations


def _under_share(problem: BoundaryProblem, share: float) -> BoundaryProblem:
    """The problem under a share of its force."""
    assert problem.force is not None
    inputs = problem.force.sx_in()
    return with_values(problem, force=ca.Function("force", inputs, [share * problem.force(*inputs)]))
