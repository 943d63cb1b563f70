"""Several starts of one optimization: a solver finds a local optimum, and another guess may lead to a better one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.numbers import whole_number
from casadi_galerkin.control.optimizer import TOLERANCE
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import Guess, waves
from casadi_galerkin.solution.progress import progress

SMALLEST, LARGEST = -2.0, 1.0  # powers of two between which the amplitude of a random start lies
SAME = 1e-6  # relative difference of costs up to which two optima count as one


def best_of(
    starts: int, problem: ControlProblem, guess: Guess | None, solve: Callable[..., ControlTrajectory]
) -> ControlTrajectory:
    """Return the cheapest of the optima that are found from a guess and from random paths.

    A random path is a sum of waves that is bent to meet the ends.  Its size is that of the given ends, or one where
    these are zero.  The same number of starts always gives the same paths.

    Parameters
    ----------
    starts : how often to solve, the first time from `guess`
    problem : ControlProblem
    guess : for the first start, as for `ControlTranscription.solve`
    solve : what finds an optimum from a guess, or raises a ConvergenceError

    Raises
    ------
    ConvergenceError
        that of the first start, if no start succeeds
    ValueError
        for input that does not fit, and for a first guess on which a callable is not finite
    """
    if whole_number("starts", starts) == 1:
        return solve(guess=guess)
    begin, end = problem.t_span
    ends = np.array([problem.start, problem.end], dtype=float)  # NaN for None
    sizes = np.max(np.nan_to_num(np.abs(ends)), axis=0)
    random, optima, failures = np.random.default_rng(0), [], []

    def another() -> Callable[[ArrayLike], np.ndarray]:
        """A random path as a function of times."""
        amplitude = 2 ** random.uniform(SMALLEST, LARGEST)
        path = waves(random, amplitude * np.where(sizes > 0, sizes, 1.0))
        return lambda times: path((np.asarray(times) - begin) / (end - begin))

    with progress("starts", starts) as advance:
        for k in range(starts):
            try:
                optima.append(solve(guess=guess if k == 0 else another()))
            except (ConvergenceError, ValueError) as failure:
                if k == 0 and isinstance(failure, ValueError):
                    raise
                failures.append(failure)  # a random path may lead where a callable is not finite
            advance(1)
    if not optima:
        raise failures[0]
    best = min(optima, key=lambda optimum: optimum.cost)
    costs = np.sort([optimum.cost for optimum in optima])
    different = costs[np.append(True, np.diff(costs) > SAME * np.abs(costs[1:]) + TOLERANCE)]
    met = f"{len(different)} optima, with costs up to {costs[-1]:.6g}" if len(different) > 1 else "one optimum"
    told = f"best of {starts} starts, which met {met}"
    told += f"; {len(failures)} of them failed" if failures else ""
    return replace(best, solver=f"{best.solver}; {told}", iterations=sum(optimum.iterations for optimum in optima))
