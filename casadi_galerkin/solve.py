"""The one verb."""

from __future__ import annotations

from numpy.typing import ArrayLike

from casadi_galerkin.boundary import Engine, Guess, transcribe
from casadi_galerkin.calculus import Galerkin
from casadi_galerkin.control import transcribe_control
from casadi_galerkin.control_problem import ControlProblem
from casadi_galerkin.engines import ipopt, rootfinder
from casadi_galerkin.problems import BoundaryProblem
from casadi_galerkin.trajectory import Trajectory


def solve(
    problem: BoundaryProblem | ControlProblem,
    method: Galerkin,
    intervals: int | None = None,
    *,
    mesh: ArrayLike | None = None,
    guess: Guess | None = None,
    solver: Engine = rootfinder,
    verbose: int = 0,
) -> Trajectory:
    """Solve a problem with a fixed discretisation: `transcribe`, then `Transcription.solve`.

    Parameters
    ----------
    problem : BoundaryProblem, or ControlProblem, which IPOPT solves and whose answer is a ControlTrajectory
    method : Galerkin
    intervals : number of equal intervals; or
    mesh : (N + 1,) joints from t_span[0] to t_span[1]
    guess, solver, verbose : as for `Transcription.solve`

    Examples
    --------
    >>> from casadi_galerkin import BoundaryProblem, Galerkin, solve
    >>> problem = BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), start=[0.0], end=[1.0])
    >>> path = solve(problem, Galerkin(degree=4), intervals=10)
    >>> float(path.path(0.5)[0].round(6))
    0.569747
    """
    if isinstance(problem, ControlProblem):
        if solver not in (rootfinder, ipopt):
            raise ValueError(f"a ControlProblem is solved by ipopt, got solver={solver!r}")
        return transcribe_control(problem, method, intervals, mesh=mesh).solve(guess=guess, verbose=verbose)
    return transcribe(problem, method, intervals, mesh=mesh).solve(guess=guess, solver=solver, verbose=verbose)
