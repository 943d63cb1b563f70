"""Retries of an optimization that fails: other solvers, guesses nearer to the straight line, longer durations.

Iterations of failed solves are counted, and the report of the solution names what failed before it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.problems.bounds import FEASIBLE
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.problem import section_times
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solvers.deadline import seconds_left
from casadi_galerkin.solvers.solver import Solver, fatrop, ipopt

# Factors on the free duration of a guess for the retries after a failure, because a path may need time to swing.  Of
# 120 problems of least time, with guesses of 0.3 to 3 times a natural duration, 103 are solved with them and 89
# without; smaller factors than four were no better.
DURATION_FACTORS = 4.0, 16.0
# Parts of the way from the straight line to the guess for the retries after a failure: of 40 random guesses for an
# acrobot, 29 lead to an optimum without them, 35 with the first, and 40 with both.
GUESS_SHARES = {"halfway between the straight line and the guess": 0.5, "the straight line between the ends": 0.0}
# For IPOPT where it fails on a feasible path: along a singular arc of a rocket on 100 intervals, noise kept its error
# above the usual 1e-9 until the restoration failed, and elsewhere moved it away again from an optimum that it had met.
# The costs of both differed by 1e-12 where both ended.
LOOSELY_ACCEPTABLE = {"acceptable_tol": 1e-8, "acceptable_iter": 1}
# For IPOPT where it calls a problem infeasible, as from an inconsistent straight line: of 150 problems of least
# time and two rates it solves three of the seven that fail with the usual first barrier of 1e-2.
HIGH_BARRIER = {"mu_init": 1.0}
INFEASIBLE = "Infeasible Problem Detected"  # IPOPT's own words


def with_fallbacks(solver: Solver, solved: Callable[[Solver], ControlTrajectory]) -> ControlTrajectory:
    """Solve, and where a solver fails that another may replace, with that one; the report then names both."""
    try:
        return solved(solver)
    except ConvergenceError as failure:
        another = _fallback(solver, failure)
        if another is None or seconds_left() < 0:
            raise
        stopped = str(failure).split(";")[0]
        try:
            path = with_fallbacks(another, solved)
        except ConvergenceError as last:
            iterations = failure.iterations + last.iterations
            words = str(last) if str(last).startswith(stopped) else f"{stopped}; {last}"
            raise ConvergenceError(words, last.path, last.residual, iterations) from None
        return replace(path, solver=f"{path.solver}, after {stopped}", iterations=failure.iterations + path.iterations)


def _fallback(solver: Solver, failure: ConvergenceError) -> Solver | None:
    """IPOPT where fatrop fails, which stalls more easily, and IPOPT with other options where IPOPT fails.

    It is less exact where it fails on a feasible path, and begins with a higher barrier where it calls the problem
    infeasible.
    """
    if solver.name == fatrop.name:
        return ipopt
    feasible = failure.residual * EPS <= FEASIBLE
    others = LOOSELY_ACCEPTABLE if feasible else HIGH_BARRIER
    tried = others.keys() & solver.options.keys() or not (feasible or INFEASIBLE in str(failure))
    return None if tried else replace(solver, options={**solver.options, **others})


def retry_from_other_guesses(
    problem: ControlProblem, guess: Guess | None, solved: Callable[..., ControlTrajectory]
) -> ControlTrajectory:
    """Solve from a guess; where that fails, from halfway to the straight line, from this, or with longer durations.

    Parameters
    ----------
    problem, guess : arguments of the solve
    solved : solves from a beginning, by the names `longer` and `share` of `ControlTranscription.starting_point`

    Raises
    ------
    ConvergenceError
        of the solve from the guess, with the other beginnings that were tried
    """
    tried, failures = list[str](), list[ConvergenceError]()
    for name, beginning in _beginnings(problem, guess):
        try:
            path = solved(**beginning)
        except ConvergenceError as failure:
            failures.append(failure)
            if seconds_left() < 0:
                break
        except ValueError:
            if not failures:
                raise  # at other beginnings than the guess, a callable need not be finite
        else:
            if not failures:
                return path
            report = f"{path.solver}, from {name}"
            iterations = path.iterations + sum(failure.iterations for failure in failures)
            return replace(path, solver=report, iterations=iterations)
        tried.append(name)
    first, others = failures[0], tried[1:]
    if not others:
        raise first
    words = f"{first}. No path was found from {' or '.join(others)}, either"
    raise ConvergenceError(words, first.path, first.residual, sum(failure.iterations for failure in failures))


def _beginnings(problem: ControlProblem, guess: Guess | None) -> Iterator[tuple[str, dict[str, float]]]:
    """The guess, and then the other beginnings, each with its name.

    There are none for an earlier solution, and no longer durations where these are unbounded, because the cost may then
    decrease without a limit.
    """
    yield "guess", {}
    if isinstance(guess, ControlTrajectory):
        return
    if guess is not None:
        for name, share in GUESS_SHARES.items():
            yield name, {"share": share}
    bounds = problem.duration_bounds
    if bounds is not None and np.isfinite(bounds[1]).all():
        last, longest = 1.0, float(np.max(np.divide(bounds[1], np.diff(section_times(problem)))))
        for factor in DURATION_FACTORS:
            if min(factor, longest) >= 2 * last:  # else it is almost the same guess again
                last = min(factor, longest)
                yield f"{last:g} times the duration of the guess", {"longer": last}
