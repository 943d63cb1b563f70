"""The one verb."""

from __future__ import annotations

from numpy.typing import ArrayLike

from casadi_galerkin.boundary import Engine, Guess, mesh_of, transcribe
from casadi_galerkin.calculus import Galerkin
from casadi_galerkin.engines import rootfinder
from casadi_galerkin.initial import integrate
from casadi_galerkin.problems import BoundaryProblem, InitialProblem
from casadi_galerkin.trajectory import Trajectory


def solve(
    problem: BoundaryProblem | InitialProblem,
    method: Galerkin,
    intervals: int | None = None,
    *,
    mesh: ArrayLike | None = None,
    guess: Guess | None = None,
    solver: Engine = rootfinder,
    verbose: int = 0,
) -> Trajectory:
    """Solve a problem with a fixed discretisation.

    A `BoundaryProblem` is solved globally, by `transcribe` and `Transcription.solve`, an `InitialProblem` step by step.

    Parameters
    ----------
    problem : BoundaryProblem or InitialProblem
    method : Galerkin
    intervals : number of equal intervals; or
    mesh : (N + 1,) joints from t_span[0] to t_span[1]
    guess, solver : as for `Transcription.solve`; an initial problem takes neither
    verbose : as for `Transcription.solve`

    Examples
    --------
    >>> from casadi_galerkin import BoundaryProblem, Galerkin, solve
    >>> problem = BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), start=[0.0], end=[1.0])
    >>> path = solve(problem, Galerkin(degree=4), intervals=10)
    >>> float(path.path(0.5)[0].round(6))
    0.569747
    """
    if isinstance(problem, InitialProblem):
        if guess is not None or solver is not rootfinder:
            raise ValueError(
                "an initial problem takes no guess and no solver: its steps are solved one after the other"
            )
        return integrate(problem, method, mesh_of(problem.t_span, intervals, mesh), verbose)
    return transcribe(problem, method, intervals, mesh=mesh).solve(guess=guess, solver=solver, verbose=verbose)
