"""Several starts of an optimization: the guess, the straight line where that fails, and random paths for other optima.

Each solve finds a local optimum, or none, and from another start it may find a better one, or one at all.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.numbers import counted, whole_number
from casadi_galerkin.calculus.roundoff import EPS, or_one
from casadi_galerkin.control.optimizer import TOLERANCE
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import Guess, waves
from casadi_galerkin.solution.progress import progress
from casadi_galerkin.solvers.deadline import seconds_left

# Factor on a free duration after a failure, as a path may need time to swing: of 228 problems with known answers IPOPT
# found 221 paths from guesses of 0.4 to 2.5 times the least duration, and 6 of the other 7 from four times these.
LONGER_DURATION = 4.0
SAME_COST = np.sqrt(EPS)  # relative difference of costs up to which two optima count as one


def first_found(attempts: Iterable[tuple[str, Callable[[], ControlTrajectory]]]) -> ControlTrajectory:
    """The path of the first attempt that finds one, with the iterations of all.

    Parameters
    ----------
    attempts : where each begins, as in "from the straight line", and what makes it; all but the first by IPOPT

    Raises
    ------
    ConvergenceError
        of the first attempt, naming the others
    """
    failures, tried = list[ConvergenceError](), list[str]()
    for how, attempt in attempts:
        try:
            path = attempt()
        except ConvergenceError as failure:
            failures.append(failure)
        except ValueError:
            if not failures:
                raise  # at another start than the guess, a callable need not be finite
        else:
            if not failures:
                return path
            report = f"{path.solver}, {how}, after {str(failures[0]).split(';')[0]}"
            iterations = path.iterations + sum(failure.iterations for failure in failures)
            return replace(path, solver=report, iterations=iterations)
        tried.append(how)
        if seconds_left() < 0:
            break
    first, others = failures[0], tried[1:]
    words = f". IPOPT found no path {' or '.join(others)}, either" if others else ""
    iterations = sum(failure.iterations for failure in failures)
    raise ConvergenceError(f"{first}{words}", first.path, first.residual, iterations)


def best_of(starts: int, problem: Any, guess: Guess | None, solve: Callable[..., Any]) -> Any:
    """The optimum of least cost, with the iterations and seconds of all optima; arguments and errors as `optima_of`."""
    optima, summary = optima_of(starts, problem, guess, solve)
    return replace(
        optima[0],
        solver=optima[0].solver + summary,
        iterations=sum(optimum.iterations for optimum in optima),
        solve_seconds=sum(optimum.solve_seconds for optimum in optima),
    )


def optima_of(starts: int, problem: Any, guess: Guess | None, solve: Callable[..., Any]) -> tuple[list[Any], str]:
    """Optima from a guess and from random paths in the order of their costs, and a summary of the starts.

    A random path is a sum of waves that is bent to meet the ends.  Its size is about that of the given ends, or one
    where these are zero.  The same number of starts always gives the same paths.  None begins after the deadline.

    Parameters
    ----------
    starts : how often to solve, the first time from `guess`
    problem : ControlProblem
    guess : for the first start, as for `ControlTranscription.solve`
    solve : finds an optimum from a guess, or raises a ConvergenceError

    Raises
    ------
    ConvergenceError
        that of the first start, if no start succeeds
    ValueError
        for input that does not fit, and for a first guess on which a callable is not finite
    """
    if whole_number("starts", starts) == 1:
        return [solve(guess=guess)], ""
    begin, end = problem.t_span
    sizes = or_one(np.max(np.nan_to_num(np.abs(problem.given_positions)), axis=0))
    random, optima, failures = np.random.default_rng(0), list[ControlTrajectory](), list[Exception]()

    def another() -> Callable[[ArrayLike], np.ndarray]:
        """A random path as a function of times."""
        path = waves(random, random.exponential() * sizes)
        return lambda times: path((np.asarray(times) - begin) / (end - begin))

    with progress("starts", starts) as advance:
        for k in range(starts):
            try:
                optima.append(solve(guess=guess if k == 0 else another()))
            except (ConvergenceError, ValueError) as failure:
                if k == 0 and isinstance(failure, ValueError):
                    raise
                failures.append(failure)  # on a random path a callable may not be finite
            advance(1)
            if seconds_left() < 0:
                break
    if not optima:
        raise failures[0]
    optima.sort(key=lambda optimum: optimum.cost)
    count = len(distinct_optima(optima))
    met = f"{count} optima, with costs up to {optima[-1].cost:.6g}" if count > 1 else "one optimum"
    summary = f"; best of {counted(len(optima) + len(failures), 'start')}, which met {met}"
    if failures:
        reasons = Counter(str(failure).split(" after ")[0] for failure in failures)
        summary += f"; {len(failures)} of them failed, most often: {reasons.most_common(1)[0][0]}"
    return optima, summary


def distinct_optima(optima: list[Any]) -> list[Any]:
    """Optima of different costs, from a list with increasing costs."""
    costs = np.array([optimum.cost for optimum in optima])
    new = np.append(True, np.diff(costs) > SAME_COST * np.abs(costs[1:]) + TOLERANCE)
    return [optima[i] for i in np.flatnonzero(new)]
