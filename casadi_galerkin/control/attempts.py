"""What is tried in turn where an optimization finds nothing: IPOPT after fatrop, a gentler guess, longer durations.

Every failure counts with its iterations, and the report of what is found at last says what came before it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.problem import marks
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solvers.deadline import seconds_left
from casadi_galerkin.solvers.solver import Solver, fatrop, ipopt

# Times the duration of a guess with which a free one begins where nothing is found from that: a path has to have the
# time to swing.  Of 120 solves for least time, from guesses of 0.3 to 3 times what is natural, 103 are solved by it, 89
# without; shorter steps than four were no better.
LONGER = 4.0, 16.0
# Of 40 random guesses for an acrobot 35 lead to an optimum with half of their way from the straight line, 29 without.
GENTLER = 0.5


def or_with_ipopt(solver: Solver, solved: Callable[[Solver], ControlTrajectory]) -> ControlTrajectory:
    """What a solver finds; where fatrop fails, which stalls more easily, what IPOPT finds.  Both are then named."""
    try:
        return solved(solver)
    except ConvergenceError as failure:
        if solver.name != fatrop.name or seconds_left() < 0:
            raise
        stopped = str(failure).split(";")[0]
        try:
            path = solved(ipopt)
        except ConvergenceError as another:
            iterations = failure.iterations + another.iterations
            raise ConvergenceError(f"{stopped}; {another}", another.path, another.residual, iterations) from None
        return replace(path, solver=f"{path.solver}, after {stopped}", iterations=failure.iterations + path.iterations)


@dataclass(frozen=True)
class Beginning:
    """Where a solve begins.

    Attributes
    ----------
    longer : factor on the durations of the guess, where they are free
    share : part of the way from the straight line between the ends to the guess
    """

    longer: float = 1.0
    share: float = 1.0

    def __str__(self) -> str:
        """Say how it differs from the guess."""
        if self.share < 1:
            return "halfway between the straight line and the guess"
        return f"{self.longer:g} times the duration of the guess"


AS_GUESSED = Beginning()


def or_from_other_beginnings(
    problem: ControlProblem, guess: Guess | None, solved: Callable[[Beginning], ControlTrajectory]
) -> ControlTrajectory:
    """What is found from a guess; where that is nothing, from a gentler one, or from longer durations.

    Parameters
    ----------
    problem, guess : what is solved, and from where
    solved : what is found from a beginning

    Raises
    ------
    ConvergenceError
        that of the guess, and what else was tried in vain
    """
    tried, failures = list[str](), list[ConvergenceError]()
    for beginning in _beginnings(problem, guess):
        try:
            path = solved(beginning)
        except ConvergenceError as failure:
            failures.append(failure)
            if seconds_left() < 0:
                break
        except ValueError:
            if not failures:
                raise  # elsewhere than at the guess, a callable need not be finite
        else:
            if not failures:
                return path
            told = f"{path.solver}, from {beginning}"
            iterations = path.iterations + sum(failure.iterations for failure in failures)
            return replace(path, solver=told, iterations=iterations)
        tried.append(str(beginning))
    first, others = failures[0], tried[1:]
    if not others:
        raise first
    words = f"{first}. No path was found from {' or '.join(others)}, either"
    raise ConvergenceError(words, first.path, first.residual, sum(failure.iterations for failure in failures))


def _beginnings(problem: ControlProblem, guess: Guess | None) -> list[Beginning]:
    """The guess, and others in their order.

    An earlier answer is taken as it is.  So are durations without a bound: the cost may fall with them for ever.
    """
    bounds, beginnings = problem.duration_bounds, [AS_GUESSED]
    if isinstance(guess, ControlTrajectory):
        return beginnings
    if guess is not None:
        beginnings.append(Beginning(share=GENTLER))
    if bounds is not None and np.isfinite(bounds[1]).all():
        last, longest = 1.0, float(np.max(np.divide(bounds[1], np.diff(marks(problem)))))
        for factor in LONGER:
            if min(factor, longest) >= 2 * last:  # else it is the same guess again
                last = min(factor, longest)
                beginnings.append(Beginning(longer=last))
    return beginnings
