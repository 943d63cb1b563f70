"""A path followed from that of an easier problem: under hardly any of its force, or over hardly any of its time.

Where a force rules the motion, as in ε x'' = F(t, x, x') with a small ε, the path has layers whose places nobody knows
before.  Under a small share of the force, which is a large ε, it has none.  Without a force the path over a short time
is nearly the straight line, and there are no conjugate points.  Newton's method finds either from any guess.  As the
share grows, layers form and conjugate points are passed, and the mesh is refined for each path before the next share
is tried.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca
import numpy as np

from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.levels import Levels
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.problems.problem import between_marks, with_values
from casadi_galerkin.solution.errors import ConvergenceError

GROWTH, SLOWEST = 10.0, 1.02  # factor by which a share first grows, and below which the path is lost
LEAST = 1e-8  # share that is tried last: where even that is too much, no share will do
MOST = 100  # shares that are tried


def under_growing_share(
    levels: Levels,
    under: Callable[[Levels, float], Levels],
    guess: PiecewisePolynomial,
    roughly: Callable[[Levels, np.ndarray, PiecewisePolynomial], CriticalPoint],
) -> CriticalPoint:
    """Find the path of a problem from those under shares of something.

    Parameters
    ----------
    levels : Levels of the problem
    under : `of_force` or `of_time`
    guess : PiecewisePolynomial of the problem
    roughly : (levels, mesh, guess) -> the path from there, on a mesh that resolves it
    """
    share, growth, known = 1 / GROWTH, GROWTH, 0.0
    for _ in range(MOST):
        part = levels if share == 1.0 else under(levels, share)
        guess = _over(part.problem.t_span, guess)
        try:
            point = roughly(part, guess.mesh, guess)
        except ConvergenceError as failure:
            lost = failure
            growth = math.sqrt(growth) if known else growth
            if growth < SLOWEST or share <= LEAST:
                break
            share = known * growth if known else share / GROWTH
        else:
            if share == 1.0:
                return point
            guess, known, growth = point.polynomial, share, min(growth**1.5, GROWTH)
            share = min(1.0, known * growth)
        finally:
            if part is not levels:
                levels.iterations += part.iterations
    words = f"the path under a growing share was lost at a share of {share:.2g}: {lost}"
    raise ConvergenceError(words, lost.path, lost.residual, lost.iterations)


def of_force(levels: Levels, share: float) -> Levels:
    """The problem under a share of its force."""
    problem = levels.problem
    assert problem.force is not None
    inputs = problem.force.sx_in()
    return Levels(with_values(problem, force=ca.Function("force", inputs, [share * problem.force(*inputs)])))


def of_time(levels: Levels, share: float) -> Levels:
    """The problem over a share of its time."""
    first, last = levels.problem.t_span
    return levels.of(levels.problem.varied({}, (first, first + share * (last - first))))


def _over(span: tuple[float, float], path: PiecewisePolynomial) -> PiecewisePolynomial:
    """The same path over other times."""
    return PiecewisePolynomial(between_marks(path.mesh, path.mesh[[0, -1]], span), path.nodes, path.values)
