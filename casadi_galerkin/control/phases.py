"""Breakpoints whose times are no unknowns of a refinement: left out of the problem, and named by the answer.

Where nothing happens at a breakpoint with a free time, any time is as good as another.  As an unknown it would come to
any of them, and move all joints beside it: to where a control switches between two points and leaves its bounds there,
at a lower cost than the true one.  A refinement puts joints at switches itself, and they are the breakpoints of its
answer.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from casadi_galerkin.control.switching import switches
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.problem import map_times, section_times, with_values
from casadi_galerkin.solution.control_trajectory import ControlTrajectory


def with_joined_phases(problem: ControlProblem) -> ControlProblem:
    """The problem without the breakpoints that have a free time, and neither a waypoint nor a jump.

    The durations of the phases beside them may be any within their bounds, so that of both together any within the sum.
    """
    if problem.duration_bounds is None:
        return problem
    earliest, latest = (np.cumsum(side)[:-1] for side in problem.duration_bounds)
    happening = [t for t, _ in (*problem.waypoints, *problem.jumps)]
    kept = np.flatnonzero((earliest == latest) | np.isin(problem.breakpoints, happening))
    low, high = (tuple(np.add.reduceat(side, [0, *kept + 1]).tolist()) for side in problem.duration_bounds)
    return with_values(problem, breakpoints=tuple(problem.breakpoints[k] for k in kept), duration_bounds=(low, high))


def with_parted_phases(path: ControlTrajectory, problem: ControlProblem) -> ControlTrajectory:
    """The answer to a problem with joined phases as one to the problem itself.

    Every breakpoint that was left out comes to a switch, or where there is none to a joint: to the nearest one that the
    bounds of the durations allow.
    """
    if len(problem.breakpoints) == len(path.problem.breakpoints):
        return path
    assert problem.duration_bounds is not None, "else none is left out"
    phases, kept = [*zip(*problem.duration_bounds, strict=True)], section_times(path.problem)
    times = map_times(np.array(section_times(problem)), section_times(with_joined_phases(problem)), kept)
    free = np.flatnonzero(~np.isin(times, kept))
    earliest, latest = times.copy(), times.copy()  # as the phases after them allow
    for k in free[::-1]:
        shortest, longest = phases[k]
        earliest[k], latest[k] = earliest[k + 1] - longest, latest[k + 1] - shortest
    switched = np.array([switch.joint for switch in switches(path)])
    for k in free:
        shortest, longest = phases[k - 1]
        first, last = max(earliest[k], times[k - 1] + shortest), min(latest[k], times[k - 1] + longest)
        allowed = [some[(first <= some) & (some <= last)] for some in (switched, path.t)]
        near = next(filter(len, allowed), np.array([first]))
        times[k] = near[np.argmin(np.abs(near - times[k]))]
    return replace(path, problem=problem.found(path.problem.t_span, path.parameters, tuple(times[1:-1].tolist())))
