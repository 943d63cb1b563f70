"""Several starts of one optimization: each solve finds a local optimum, and another guess may lead to a better one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.numbers import counted, whole_number
from casadi_galerkin.calculus.roundoff import or_one
from casadi_galerkin.control.optimizer import TOLERANCE
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import Guess, waves
from casadi_galerkin.solution.progress import progress
from casadi_galerkin.solvers.deadline import seconds_left

SMALLEST, LARGEST = -2.0, 1.0  # powers of two between which the amplitude of a random start lies
SAME = 1e-6  # relative difference of costs up to which two optima count as one


def best_of(
    starts: int, problem: ControlProblem, guess: Guess | None, solve: Callable[..., ControlTrajectory]
) -> ControlTrajectory:
    """The optimum of least cost, with the iterations and seconds of all optima; arguments and errors as `optima_of`."""
    optima, summary = optima_of(starts, problem, guess, solve)
    return replace(
        optima[0],
        solver=optima[0].solver + summary,
        iterations=sum(optimum.iterations for optimum in optima),
        solve_seconds=sum(optimum.solve_seconds for optimum in optima),
    )


def optima_of(
    starts: int, problem: ControlProblem, guess: Guess | None, solve: Callable[..., ControlTrajectory]
) -> tuple[list[ControlTrajectory], str]:
    """Optima from a guess and from random paths in the order of their costs, and a summary of the starts.

    A random path is a sum of waves that is bent to meet the ends.  Its size is that of the given ends, or one where
    these are zero.  The same number of starts always gives the same paths.  No start begins after the deadline.

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
    ends = problem.given_positions
    sizes = or_one(np.max(np.nan_to_num(np.abs(ends)), axis=0))
    random, optima, failures = np.random.default_rng(0), list[ControlTrajectory](), list[Exception]()

    def another() -> Callable[[ArrayLike], np.ndarray]:
        """A random path as a function of times."""
        amplitude = 2 ** random.uniform(SMALLEST, LARGEST)
        path = waves(random, amplitude * sizes)
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
    return optima, summary + (f"; {len(failures)} of them failed, {_most_often(failures)}" if failures else "")


def _most_often(failures: list[Exception]) -> str:
    """The most frequent reason of the failures."""
    reasons = Counter(str(failure).split(" after ")[0] for failure in failures)
    ((reason, count),) = reasons.most_common(1)
    return reason if count == len(failures) else f"most often: {reason}"


def distinct_optima(optima: list[ControlTrajectory]) -> list[ControlTrajectory]:
    """Optima of different costs, from a list with increasing costs."""
    costs = np.array([optimum.cost for optimum in optima])
    new = np.append(True, np.diff(costs) > SAME * np.abs(costs[1:]) + TOLERANCE)
    return [optima[i] for i in np.flatnonzero(new)]
