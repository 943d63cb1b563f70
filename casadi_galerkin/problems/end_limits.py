"""What a path constraint asks of an end that is not given.

Path constraints hold at the quadrature points, inside of the intervals.  The velocity at a free end is an unknown of
its own: where it is rewarded, it would exceed its limit on any mesh.  So values that no control changes at once are
limited at the end, too, as by an end condition.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_galerkin.problems.bounds import Limited
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.dependence import CONTROLS, VELOCITIES, rows_that_depend

TIME, POSITIONS = 0, 1  # numbers of further arguments t, x of a path constraint


def limited_at_end(problem: ControlProblem) -> np.ndarray:
    """Indices of path constraints that limit the end: those that depend on what is not given there.

    Equations that are as many as the controls are left out, because at the points they leave nothing free.  So are
    constraints of the time, and of the velocity of a component that follows a rate, no argument of an end condition.
    """
    g, low, high = problem.path_constraint
    fixed = np.arange(problem.dimension) >= problem.mechanical
    excluded = rows_that_depend(g, TIME, [True]) | rows_that_depend(g, CONTROLS, np.ones(problem.controls, dtype=bool))
    equal = np.equal(low, high)
    excluded |= rows_that_depend(g, VELOCITIES, fixed) | (equal & (np.count_nonzero(equal) >= problem.controls))
    free = [np.array([value is None for value in values]) for values in (problem.end, problem.end_velocity)]
    depends = rows_that_depend(g, POSITIONS, free[0]) | rows_that_depend(g, VELOCITIES, free[1] & ~fixed)
    return np.flatnonzero(depends & ~excluded)


def conditions_at_ends(problem: ControlProblem) -> Limited:
    """The end conditions of a problem, and behind them its path constraints that limit the end.

    To an equation of positions alone belongs that of their velocities.
    """
    conditions, low, high = problem.end_conditions
    rows = limited_at_end(problem)
    if not len(rows):
        return problem.end_conditions
    inputs, (g, *sides) = conditions.sx_in(), problem.path_constraint
    least, most = np.array(sides)[:, rows]
    _, _, x, v, *p = inputs
    values, first = g(0.0, x, v, ca.SX.zeros(problem.controls), *p), problem.mechanical
    moving = rows_that_depend(g, VELOCITIES, np.ones(problem.dimension, dtype=bool))
    moving |= rows_that_depend(g, POSITIONS, np.arange(problem.dimension) >= first)
    held = rows[(least == most) & ~moving[rows]].tolist()
    rates = [ca.jtimes(values[i], x, v) for i in held]
    stated = ca.densify(ca.vertcat(conditions(*inputs), values[rows.tolist()], *rates))
    limits = [(*given, *side, *[0.0] * len(held)) for given, side in ((low, least.tolist()), (high, most.tolist()))]
    return ca.Function("end_conditions", inputs, [stated]), limits[0], limits[1]
