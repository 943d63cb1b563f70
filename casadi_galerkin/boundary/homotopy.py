"""Homotopy in the force, from the path under a small share of it.

Where a force dominates the motion, as in ε x'' = F(t, x, x') with a small ε, the path has layers at places that are not
known in advance.  Under a small share of the force, which corresponds to a large ε, it has none, and Newton's method
finds it from any guess.  As the share grows, layers form.  So the mesh is refined for each path before the next share
is tried.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca

from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.graph_cache import GraphCache
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.problems.problem import with_values
from casadi_galerkin.solution.errors import ConvergenceError

GROWTH, LEAST_GROWTH = 10.0, 1.02  # first factor by which a share grows, and the factor below which the path is lost
LEAST = 1e-8  # smallest share that is tried
MOST = 100  # largest number of shares that are tried


def path_by_homotopy(
    graphs: GraphCache,
    guess: PiecewisePolynomial,
    intermediate_path: Callable[[GraphCache, PiecewisePolynomial], CriticalPoint],
) -> CriticalPoint:
    """Find the path of a problem by a homotopy in its force.

    Parameters
    ----------
    graphs : GraphCache of the problem
    guess : guess of the path of the problem
    intermediate_path : (graphs, guess) -> the path from this guess, on a mesh that resolves it
    """
    share, growth, known = 1 / GROWTH, GROWTH, 0.0
    for _ in range(MOST):
        part = graphs if share == 1.0 else with_scaled_force(graphs, share)
        try:
            point = intermediate_path(part, guess)
        except ConvergenceError as failure:
            lost = failure
            growth = math.sqrt(growth) if known else growth
            if growth < LEAST_GROWTH or share <= LEAST:
                break
            share = known * growth if known else share / GROWTH
        else:
            if share == 1.0:
                return point
            guess, known, growth = point.polynomial, share, min(growth**1.5, GROWTH)
            share = min(1.0, known * growth)
        finally:
            if part is not graphs:
                graphs.iterations += part.iterations
    words = f"the path under a growing share was lost at a share of {share:.2g}: {lost}"
    raise ConvergenceError(words, lost.path, lost.residual, lost.iterations)


def with_scaled_force(graphs: GraphCache, share: float) -> GraphCache:
    """The problem under a share of its force."""
    problem = graphs.problem
    assert problem.force is not None
    inputs = problem.force.sx_in()
    return GraphCache(with_values(problem, force=ca.Function("force", inputs, [share * problem.force(*inputs)])))
