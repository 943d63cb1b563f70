"""What a path constraint asks of an end that is not given.

Path constraints hold at the quadrature points, inside of the intervals.  The velocity at a free end is an unknown of
its own: where it is rewarded, it would exceed its limit on any mesh.  So values that no control changes at once are
limited at the end, too, as by an end condition.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.problems.bounds import Limited
from casadi_galerkin.problems.expressions import CONTROLS, POSITIONS, TIME, VELOCITIES, entries_of, rows_that_depend

END = 2, 3  # numbers of the arguments x1, v1 of end conditions


def limited_at_end(problem: Any) -> tuple[list[int], list[int]]:
    """Indices of path constraints that limit the end, and of equations of positions that limit its velocity.

    They depend on what is not given there.  Equations that are as many as the controls are left out, because at the
    points they leave nothing free.  So are constraints of the time, and of the velocity of a component that follows a
    rate, which is no argument of an end condition.  Nothing is added of what end conditions speak of at the end: the
    same twice has no multipliers, and what they fix may be where a constraint has no derivative.
    """
    g, low, high = problem.path_constraint
    conditions, everything = problem.end_conditions[0], np.ones(problem.dimension, dtype=bool)
    stated_x, stated_v = (np.isin(np.arange(problem.dimension), list(entries_of(conditions, k))) for k in END)
    fixed = np.arange(problem.dimension) >= problem.mechanical
    excluded = rows_that_depend(g, TIME, [True]) | rows_that_depend(g, CONTROLS, np.ones(problem.controls, dtype=bool))
    excluded |= rows_that_depend(g, POSITIONS, stated_x) | rows_that_depend(g, VELOCITIES, stated_v)
    equal = np.equal(low, high)
    excluded |= rows_that_depend(g, VELOCITIES, fixed) | (equal & (np.count_nonzero(equal) >= problem.controls))
    free_x, free_v = (np.array([value is None for value in values]) for values in (problem.end, problem.end_velocity))
    free_v &= ~fixed
    limited = rows_that_depend(g, POSITIONS, free_x) | rows_that_depend(g, VELOCITIES, free_v)
    moving = rows_that_depend(g, VELOCITIES, everything) | rows_that_depend(g, POSITIONS, fixed)
    held = equal & ~(moving | stated_v.any()) & rows_that_depend(g, POSITIONS, free_v)
    return np.flatnonzero(limited & ~excluded).tolist(), np.flatnonzero(held & ~excluded).tolist()


def conditions_at_ends(problem: Any) -> Limited:
    """The end conditions of a problem, and behind them its path constraints that limit the end."""
    conditions, low, high = problem.end_conditions
    rows, held = limited_at_end(problem)
    if not rows + held:
        return problem.end_conditions
    inputs, (g, *sides) = conditions.sx_in(), problem.path_constraint
    _, _, x, v, *p = inputs
    values = g(0.0, x, v, ca.SX.zeros(problem.controls), *p)
    rates = [ca.jtimes(values[i], x, v) for i in held]
    stated = ca.densify(ca.vertcat(conditions(*inputs), *(values[i] for i in rows), *rates))
    lows, highs = ([side[i] for i in rows] + [0.0] * len(held) for side in sides)
    return ca.Function("end_conditions", inputs, [stated]), (*low, *lows), (*high, *highs)
