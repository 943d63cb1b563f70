"""The one verb."""

from __future__ import annotations

from numpy.typing import ArrayLike

from casadi_galerkin.boundary import Engine, transcribed
from casadi_galerkin.calculus import Galerkin
from casadi_galerkin.control import transcribe_control
from casadi_galerkin.control_problem import ControlProblem
from casadi_galerkin.control_refinement import solve_control_to_tolerance
from casadi_galerkin.control_trajectory import ControlTrajectory
from casadi_galerkin.engines import ipopt, rootfinder
from casadi_galerkin.guesses import Guess, mesh_of
from casadi_galerkin.initial import integrate
from casadi_galerkin.problems import BoundaryProblem, InitialProblem
from casadi_galerkin.refinement import Limits, solve_to_tolerance
from casadi_galerkin.trajectory import Trajectory


def solve(
    problem: BoundaryProblem | InitialProblem | ControlProblem,
    method: Galerkin | None = None,
    intervals: int | None = None,
    *,
    tol: float | None = None,
    mesh: ArrayLike | None = None,
    guess: Guess | None = None,
    solver: Engine = rootfinder,
    limits: Limits | None = None,
    verbose: int = 0,
) -> Trajectory:
    """Solve a problem: with a fixed discretisation, or to a tolerance.

    With `method` and `intervals` or `mesh`, this is `transcribe` followed by `Transcription.solve`.  With `tol`, the
    degree and the mesh are chosen so that the estimated error of x, at the joints and between them and relative to
    the largest value of each component, is at most `tol`; `method` then fixes the degree, and `intervals` or `mesh`
    are where refinement begins.

    An `InitialProblem` is solved step by step, with `method` and `intervals` or `mesh`; a `ControlProblem`, whose
    answer is a ControlTrajectory, by IPOPT, with these or `tol`, and a `guess`.  Its `tol` bounds the relative errors
    of cost and duration as well.

    Parameters
    ----------
    problem : BoundaryProblem, InitialProblem or ControlProblem
    method : Galerkin
    intervals : number of equal intervals; or
    mesh : (N + 1,) joints from t_span[0] to t_span[1]
    tol : relative tolerance between 0 and 1; for boundary and control problems
    guess, solver : as for `Transcription.solve`; for boundary problems, the guess for control problems too
    limits : Limits that stop a refinement; only with `tol`
    verbose : 1 prints a summary and, with `tol`, a line a level; 2 also the solver's lines

    Examples
    --------
    >>> from casadi_galerkin import BoundaryProblem, Galerkin, solve
    >>> problem = BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), start=[0.0], end=[1.0])
    >>> path = solve(problem, Galerkin(degree=4), intervals=10)
    >>> float(path.path(0.5)[0].round(6))
    0.569747
    """
    _check_limits(limits)
    if isinstance(problem, ControlProblem):
        if solver not in (rootfinder, ipopt):
            raise ValueError(f"a ControlProblem is solved by ipopt, got the solver {solver!r}")
        return _solve_control(problem, method, intervals, tol, mesh, guess, limits, verbose)
    if isinstance(problem, InitialProblem):
        if guess is not None or tol is not None or limits is not None or solver is not rootfinder:
            raise ValueError("an initial problem takes no tol, limits, guess or solver: it is solved step by step")
        if method is None:
            raise ValueError("give a method and intervals, got no method")
        return integrate(problem, method, mesh_of(problem.t_span, intervals, mesh), verbose)
    if tol is not None:
        path = solve_to_tolerance(problem, tol, method, intervals, mesh, guess, solver, limits or Limits(), verbose)
        if verbose:
            print(path)
        return path
    if limits is not None:
        raise ValueError("limits stop a refinement: give tol with them")
    if method is None:
        raise TypeError("method must be a Galerkin, such as Galerkin(degree=4), got None; or give tol instead")
    transcription = transcribed(problem, method, intervals, mesh, "single")
    return transcription.solve(guess=guess, solver=solver, verbose=verbose)


def _check_limits(limits: Limits | None) -> None:
    if limits is not None and not isinstance(limits, Limits):
        raise TypeError(f"limits must be Limits, such as Limits(intervals=500), got {limits!r}")


def _solve_control(
    problem: ControlProblem,
    method: Galerkin | None,
    intervals: int | None,
    tol: float | None,
    mesh: ArrayLike | None,
    guess: Guess | None,
    limits: Limits | None,
    verbose: int,
) -> ControlTrajectory:
    """Solve a control problem with a fixed discretisation or to a tolerance."""
    if tol is not None:
        path = solve_control_to_tolerance(problem, tol, method, intervals, mesh, guess, limits or Limits(), verbose)
        if verbose:
            print(path)
        return path
    if limits is not None:
        raise ValueError("limits stop a refinement: give tol with them")
    if method is None:
        raise TypeError("method must be a Galerkin, such as Galerkin(degree=4), got None; or give tol instead")
    return transcribe_control(problem, method, intervals, mesh=mesh).solve(guess=guess, verbose=verbose)
