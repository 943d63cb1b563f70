"""A control problem that is solved often and to a tolerance: each solve begins on the mesh of an earlier one."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.numbers import check_verbose, counted
from casadi_galerkin.control.control_refinement import ControlRefinement, first_control_discretization
from casadi_galerkin.control.control_transcription import check_solver
from casadi_galerkin.functional.buffers import interrupts_raised
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solution.limits import Limits, check_tolerance
from casadi_galerkin.solution.quantity import Quantity
from casadi_galerkin.solvers.solver import Solver, ipopt


class AdaptiveControlTranscription:
    """A control problem with a tolerance, solved often.

    Parameters
    ----------
    problem : ControlProblem
    tol, of, method, intervals, mesh, limits : as for `solve`

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

    def __init__(
        self,
        problem: ControlProblem,
        tol: float,
        method: Galerkin | None,
        intervals: int | None,
        mesh: ArrayLike | None,
        limits: Limits | None,
        of: Quantity | None = None,
    ) -> None:
        self.problem, self.tol, self.limits, self.of = problem, check_tolerance(tol), limits or Limits(), of
        self._coarse = method, intervals, mesh
        first_control_discretization(problem, self.tol, *self._coarse, None, self.limits)  # refuses what does not fit
        self.first: ControlTrajectory | None = None

    @interrupts_raised()
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
        check_solver(solver)
        check_verbose(verbose)
        ends = {"start": start, "end": end, "start_velocity": start_velocity, "end_velocity": end_velocity}
        problem = self.problem.varied({**ends, "parameters": parameters}, t_span)
        begun = self.first if guess is None else guess
        method, joints = first_control_discretization(problem, self.tol, *self._coarse, begun, self.limits)
        refinement = ControlRefinement(problem, self.tol, method, self.limits, solver, verbose, self.of)
        path = refinement.run(joints, begun, 1)
        self.first = self.first or path
        if verbose:
            print(path)
        return path

    def __repr__(self) -> str:
        """Say what was built, and what mesh is kept."""
        size = counted(self.problem.dimension, "component")
        words = f"AdaptiveControlTranscription of a control problem of {size}, tol={self.tol:g}"
        if self.first is None:
            return f"{words}: nothing solved yet"
        intervals = counted(len(self.first.t) - 1, "interval")
        return f"{words}: first path of degree {self.first.method.degree} on {intervals}"
