"""What is tried in turn where an optimization finds nothing: IPOPT after fatrop, and longer durations.

Every failure counts with its iterations, and the report of what is found at last says what came before it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

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


def or_from_longer_durations(
    problem: ControlProblem, guess: Guess | None, solved: Callable[[float], ControlTrajectory]
) -> ControlTrajectory:
    """What is found from a guess; where that is nothing, and the duration is free, from longer ones.

    Parameters
    ----------
    problem, guess : what is solved, and from where
    solved : factor on the duration of the guess -> what is found from there
    """
    failures = list[ConvergenceError]()
    for longer in _factors(problem, guess):
        try:
            path = solved(longer)
        except ConvergenceError as failure:
            failures.append(failure)
            if seconds_left() < 0:
                break
        else:
            told = f"{path.solver}, from {longer:g} times the duration of the guess" if failures else path.solver
            iterations = path.iterations + sum(failure.iterations for failure in failures)
            return replace(path, solver=told, iterations=iterations)
    first, *others = failures
    if not others:
        raise first
    words = f"{first}. From longer durations no path was found, either"
    raise ConvergenceError(words, first.path, first.residual, sum(failure.iterations for failure in failures))


def _factors(problem: ControlProblem, guess: Guess | None) -> list[float]:
    """Factors on the duration of a guess, in their order.

    An earlier answer keeps its own, and so do durations without a bound: the cost may fall with them for ever.
    """
    bounds, factors = problem.duration_bounds, [1.0]
    if bounds is None or np.isinf(bounds[1]).any() or isinstance(guess, ControlTrajectory):
        return factors
    longest = float(np.max(np.divide(bounds[1], np.diff(marks(problem)))))
    for factor in LONGER:
        if min(factor, longest) >= 2 * factors[-1]:  # else it is the same guess again
            factors.append(min(factor, longest))
    return factors
