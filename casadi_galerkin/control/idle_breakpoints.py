"""Breakpoints with free times where nothing happens: a refinement leaves them out, and puts them at switches at last.

Where a breakpoint with a free time has neither a waypoint nor a jump, its time is not determined.  As an unknown it
could take any value and would move all joints beside it.  The discrete cost is then lowest where a control switches
between two points and exceeds its bounds there, below the true cost.  So a refinement puts joints at the switches that
it finds, and these become the breakpoints of its solution.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from casadi_galerkin.calculus.piecewise_polynomial import times_at
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.phases import Phases
from casadi_galerkin.problems.problem import map_times, section_times, with_values
from casadi_galerkin.problems.statements import AT_BOUND
from casadi_galerkin.solution.control_trajectory import ControlTrajectory


def with_joined_phases(problem: Any) -> Any:
    """The problem without the breakpoints that have a free time, and neither a waypoint nor a jump.

    The bounds of the duration of two joined phases are the sums of their bounds.
    """
    if isinstance(problem, Phases) or problem.duration_bounds is None:
        return problem
    earliest, latest = (np.cumsum(side)[:-1] for side in problem.duration_bounds)
    with_event = [t for t, _ in (*problem.waypoints, *problem.jumps)]
    kept = np.flatnonzero((earliest == latest) | np.isin(problem.breakpoints, with_event))
    low, high = (tuple(np.add.reduceat(side, [0, *kept + 1]).tolist()) for side in problem.duration_bounds)
    return with_values(problem, breakpoints=tuple(problem.breakpoints[k] for k in kept), duration_bounds=(low, high))


def with_parted_phases(path: ControlTrajectory, problem: ControlProblem) -> ControlTrajectory:
    """The solution of a problem with joined phases as a solution of the original problem.

    Every breakpoint that was left out is put at the nearest switch, or where there is none at the nearest joint, that
    the bounds of the durations allow.
    """
    if len(problem.breakpoints) == len(path.problem.breakpoints):
        return path
    assert problem.duration_bounds is not None, "otherwise no breakpoint is left out"
    phases, kept = [*zip(*problem.duration_bounds, strict=True)], section_times(path.problem)
    times = map_times(np.array(section_times(problem)), section_times(with_joined_phases(problem)), kept)
    free = np.flatnonzero(~np.isin(times, kept))
    earliest, latest = times.copy(), times.copy()  # as the phases after them allow
    for k in free[::-1]:
        shortest, longest = phases[k]
        earliest[k], latest[k] = earliest[k + 1] - longest, latest[k + 1] - shortest
    switched = path.t[np.unique([np.argmin(np.abs(path.t - when)) for when in switch_times(path)]).astype(int)]
    for k in free:
        shortest, longest = phases[k - 1]
        first, last = max(earliest[k], times[k - 1] + shortest), min(latest[k], times[k - 1] + longest)
        allowed = [some[(first <= some) & (some <= last)] for some in (switched, path.t)]
        near = next(filter(len, allowed), np.array([first]))
        times[k] = near[np.argmin(np.abs(near - times[k]))]
    return replace(path, problem=problem.found(path.problem.t_span, path.parameters, tuple(times[1:-1].tolist())))


def switch_times(path: ControlTrajectory) -> np.ndarray:
    """Times at which controls jump from one of their bounds to the other, increasing.

    The value at a quadrature point between the two gives the time within its part of the interval.
    """
    low, high = (np.array(side)[:, None] for side in path.problem.control_bounds)
    u, ends = path.control.values, np.append(0.0, np.cumsum(path.method.quadrature.weights)).clip(0, 1)
    slack = AT_BOUND * np.max(np.abs(u), axis=1, keepdims=True, initial=0.0)
    side = (u >= high - slack).astype(int) - (u <= low + slack)
    begins, lasts = times_at(path.t, ends[:-1]), np.outer(np.diff(path.t), np.diff(ends)).ravel()
    found = list[float]()
    for values, at in zip(u, side, strict=True):
        bounded = np.flatnonzero(at)
        for a, b in pairwise(bounded):
            if at[a] != at[b] and b - a <= 2:
                inner = slice(a + 1, b)
                before = (values[inner] - values[b]) / (values[a] - values[b])
                found.append(float(begins[a] + lasts[a] + lasts[inner] @ before))
    return np.unique(found)
