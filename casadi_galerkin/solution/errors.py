"""How a solve may end without a verified solution: its limits, and its exceptions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadi_galerkin.calculus.numbers import number
from casadi_galerkin.solution.path import Path


class ConvergenceError(RuntimeError):
    """A solve that did not end in a verified solution.

    Attributes
    ----------
    path : the last path of the solve, which can be called and plotted, but is no solution; None if there is none
    residual : float, the largest ratio of a residual to its roundoff floor; of an optimization the largest violation
        over the relative precision of a double
    iterations : int

    Examples
    --------
    >>> import casadi as ca
    >>> import casadi_galerkin as cg
    >>> steep = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - ca.log(x[0] - 2), (0, 1), start=[0.0], end=[1.0])
    >>> try:
    ...     cg.solve(steep, cg.Galerkin(degree=4), intervals=4)
    ... except cg.ConvergenceError as error:
    ...     print(error.path)
    Path of 1 component on [0, 1], degree 4 on 4 intervals; not an answer
    """

    def __init__(self, message: str, path: Path | None = None, residual: float = np.nan, iterations: int = 0) -> None:
        super().__init__(message)
        self.path, self.residual, self.iterations = path, residual, iterations


class ConjugatePointError(ConvergenceError):
    """The Hessian of the action is singular: the ends are conjugate, or a family of paths joins them.

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> free = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), start=[None], end=[None])
    >>> try:
    ...     cg.solve(free, cg.Galerkin(degree=2), intervals=4)
    ... except cg.ConjugatePointError as error:
    ...     print(type(error.path).__name__)
    Path
    """


class LimitReached(ConvergenceError):
    """A refinement was stopped before it reached its tolerance; another guess for the same path would not help.

    Its `path` is the best so far: the Trajectory or ControlTrajectory that solves its own mesh, with the error reached
    as its `error_estimate`, or its `asked_error` where the tolerance was that of a quantity; of an optimum, what the
    first of two comparisons shows of it, which may be less.  Where the time was up before there was one, or where the
    path on that mesh is not isolated, it is as for other errors.

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> layer = cg.BoundaryProblem(lambda t, x, v: 1e-8 * v[0] ** 2 / 2 + x[0] ** 2 / 2, (0, 1), start=[1.0], end=[0.0])
    >>> try:
    ...     cg.solve(layer, tol=1e-9, limits=cg.Limits(intervals=10))
    ... except cg.LimitReached as error:
    ...     print(len(error.path.t) - 1 <= 10, 1e-9 < error.path.error_estimate)
    True True
    """


@dataclass(frozen=True)
class Limits:
    """Limits at which a refinement stops if it has not reached its tolerance; ``math.inf`` is no limit.

    Parameters
    ----------
    intervals : largest number of intervals of a mesh
    seconds : longest time.  No solve on a new mesh begins after it, and Newton's method and IPOPT stop after the
        iteration, which may take seconds on a fine mesh; fatrop has no such limit, and a solve by it is finished first
    levels : largest number of meshes, one for each level of the refinement

    Raises
    ------
    ValueError
        for a limit that is not positive, or of intervals or levels and not whole

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> layer = cg.BoundaryProblem(lambda t, x, v: 1e-8 * v[0] ** 2 / 2 + x[0] ** 2 / 2, (0, 1), start=[1.0], end=[0.0])
    >>> cg.solve(layer, tol=1e-6, limits=Limits(intervals=5000, seconds=30)).error_estimate < 1e-6
    True
    """

    intervals: float = 20_000
    seconds: float = 120.0
    levels: float = 80

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (number(value) or 0) > 0:
                raise ValueError(f"the limit of {name} must be a positive number, got {value!r}")
            if name != "seconds" and value % 1 > 0:  # not a number where it is infinite
                raise ValueError(f"the limit of {name} must be a whole number or inf, got {value!r}")


def check_tolerance(tol: float) -> float:
    """Refuse a relative tolerance that is not between 0 and 1."""
    checked = number(tol)
    if checked is None or not 0 < checked < 1:
        raise ValueError(f"tol must be a number between 0 and 1, got {tol!r}")
    return checked
