"""A control problem that is solved often and to a tolerance: each solve begins on the mesh of an earlier one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from casadi_galerkin.calculus.numbers import counted
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solvers.solver import Solver, ipopt


class AdaptiveControlTranscription:
    """A control problem with a tolerance, solved often.

    Parameters
    ----------
    problem : ControlProblem
    tol : as for `solve`
    solve : `solve` with its other arguments

    Attributes
    ----------
    first : ControlTrajectory, the first path that was found, which is the guess of later solves; None before

    Raises
    ------
    TypeError, ValueError
        as for `transcribe`

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> move = cg.ControlProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0], [0.0], [0.0],
    ...     force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u**2 / 2, controls=1)
    >>> transcription = cg.transcribe(move, tol=1e-6, of=lambda path: path.cost)
    >>> [round(transcription.solve(end=[end]).asked, 5) for end in (1.0, 2.0)]
    [6.0, 24.0]
    """

    def __init__(self, problem: ControlProblem, tol: float, solve: Callable[..., ControlTrajectory]) -> None:
        self.problem, self.tol, self._solve = problem, tol, solve
        self.first: ControlTrajectory | None = None

    def solve(
        self,
        start: Sequence[float | None] | None = None,
        end: Sequence[float | None] | None = None,
        *,
        start_velocity: Sequence[float | None] | None = None,
        end_velocity: Sequence[float | None] | None = None,
        parameters: Sequence[float] | None = None,
        guess: Guess | None = None,
        t_span: Sequence[float] | None = None,
        solver: Solver = ipopt,
        verbose: int = 0,
    ) -> ControlTrajectory:
        """Solve for the optimal path to the tolerance; whatever is left out is taken from the problem.

        Parameters
        ----------
        t_span : times of the ends
        start, end, start_velocity, end_velocity, parameters, solver : as for `ControlTranscription.solve`
        guess : the same; default the first path that was found
        verbose : 1 prints a line for each mesh and a summary, 2 also the solver's own output

        Raises
        ------
        LimitReached, ConvergenceError, ValueError, TypeError
            as for `solve`
        """
        ends = {"start": start, "end": end, "start_velocity": start_velocity, "end_velocity": end_velocity}
        problem = self.problem.varied({**ends, "parameters": parameters}, t_span)
        begun = self.first if guess is None else guess
        path = self._solve(problem, guess=begun, solver=solver, verbose=verbose)
        self.first = self.first or path
        return path

    def __repr__(self) -> str:
        """Say what was built, and what mesh is kept."""
        first = (
            "nothing solved yet"
            if self.first is None
            else f"first path on {counted(len(self.first.t) - 1, 'interval')}"
        )
        return f"AdaptiveControlTranscription of a control problem, tol={self.tol:g}: {first}"
