"""The conditions of a boundary problem on the ends of a path, as equations between its first and its last state.

In the global solve all of them are one term of the functional, whose rows are the momenta at positions that are not
given (`functional.boundary_terms`).  In shooting the same rows are equations; η are the term's own multipliers:

    start      x_0 = given   or   p_0 = rows of x_0         of a periodic path p_0 = p_N
    end        x_N = given   or   p_N = -(rows of x_N)      of a periodic path x_N = x_0
    further    rows of η = 0

Under a constraint g = 0 with G = ∂g/∂x, the equations of momenta hold up to an impulse Gᵀμ, where μ is another part of
η.  A start that is not given as a whole must lie on the constraint, g(t_0, x_0) = 0, as far as that depends on what is
free.  The steps do not depend on the normal part of p_0, so that it is set to zero, G p_0 = 0.  They stay on the
constraint by themselves, so that the equations of given positions at the end, too, hold up to Gᵀμ, as far as g depends
on these alone.  There μ is zero at the end asked for, and G is not differentiated: the steps of Newton's method then
lead away from other points whose offset is normal, such as the antipode on a sphere.

A given energy E adds λ T̄ E to the functional, with λ the stretch of the steps (`functional.interval`) and T̄ the
duration that the mesh has.  It is an action of the end, and λ a component with both ends free: p_λ,0 = 0 and
p_λ,N = -T̄ E.  Below, x and p have λ and p_λ as their last components, and d counts them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.functional.boundary_terms import rows_of_ends
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.expressions import POSITIONS, rows_that_depend


def end_equations(problem: BoundaryProblem, plane: np.ndarray | None) -> ca.Function:
    """(ends) -> as many equations between the ends as the start has entries, and their dense Jacobian.

    The ends are (x_0, p_0, η, x_N, p_N), (4d + k,), of which the start is (x_0, p_0, η); `plane` fixes the phase where
    it is free.  The equations are those of the module's docstring.
    """
    d, times = problem.dimension, problem.t_span
    constraint = problem.numeric.constraint
    rows = rows_of_ends(problem, plane)
    x, p = ([ca.SX.sym(f"{name}{k}", d) for k in (0, 1)] for name in "xp")
    own = [ca.SX.sym("own", rows.size1_in(2))]
    given: list[Sequence[Any]] = [problem.start, problem.end]
    first, last, further = ca.vertsplit(rows(*x, *own), [0, d, 2 * d, rows.size1_out(0)])
    momenta = [first, -last]
    if problem.periodic:
        momenta[0], given[1] = p[1] + first, ca.vertsplit(x[0])
    equations, held = [], ca.SX.sym("held", d)
    if constraint is not None:
        further = ca.vertcat(further, ca.jtimes(constraint(times[0], x[0]), x[0], p[0]))
    for k, values in enumerate(given):
        free = np.array([value is None for value in values])
        bound = rows_that_depend(constraint, POSITIONS, free)
        pushes = ca.SX(d, 1)
        for chosen, place, pushed in ((bound, x[k], free), (~bound & (k == 1), held, ~free)):
            if constraint is not None and chosen.any():
                own.append(ca.SX.sym("impulse", np.count_nonzero(chosen)))
                acting = constraint(times[k], place)[np.flatnonzero(chosen).tolist()]
                pushes += ca.DM(pushed) * ca.jtimes(acting, place, own[-1], True)
                further = ca.vertcat(further, acting) if k == 0 else further
        for i, value in enumerate(values):
            equations.append((x[k][i] - value if value is not None else p[k][i] - momenta[k][i]) + pushes[i])
    if problem.energy is not None:
        x, p = ([ca.vertcat(a, ca.SX.sym("stretch")) for a in ends] for ends in (x, p))
        equations += [p[0][d], p[1][d] + problem.energy * (times[1] - times[0])]
    values, ends = ca.vertcat(*equations, further), ca.vertcat(x[0], p[0], *own, x[1], p[1])
    outputs = ca.substitute([ca.densify(values), ca.densify(ca.jacobian(values, ends))], [held], [x[1][:d]])
    return ca.Function("end_equations", [ends], outputs)
