"""What is raised where a solve does not end in a verified answer."""

from __future__ import annotations

import numpy as np

from casadi_galerkin.solution.path import Path


class ConvergenceError(RuntimeError):
    """A solve that did not end in a verified answer.

    Attributes
    ----------
    path : what the solve had come to, which can be called and plotted, but is no answer; None if there is nothing
    residual : float, its largest residual over that residual's roundoff floor; of an optimisation its largest violation
        over the relative precision of a double
    iterations : int
    """

    def __init__(self, message: str, path: Path | None = None, residual: float = np.nan, iterations: int = 0) -> None:
        super().__init__(message)
        self.path, self.residual, self.iterations = path, residual, iterations


class ConjugatePointError(ConvergenceError):
    """The Hessian of the action is singular: the ends are conjugate, or a family of paths joins them."""


class LimitReached(ConvergenceError):
    """A refinement that follows a path and was stopped before its tolerance; another start would not help.

    Its `path` is the best so far: of a trajectory optimisation a ControlTrajectory that solves its own mesh.
    """
