"""The residual of single shooting: the path from a start, how far it misses the end conditions, and their derivative.

The unknowns are the start (x_0, p_0, η): the first state, and the multipliers that the conditions on the ends bring
along.  The derivative of the joint values by the start is the product of the steps' Jacobians, exact by the
implicit function theorem.  The conditions of a boundary problem are equations between the first and the last state: in
the global solve all of them are one term of the functional, whose rows are the momenta at positions that are not given
(`functional.boundary_terms`); here the same rows are equations, with η the term's own multipliers:

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
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import EPS, TINY
from casadi_galerkin.functional.boundary_terms import rows_of_ends
from casadi_galerkin.functional.buffers import Evaluator
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.callables import rows_that_depend
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import guess_values, phase_plane
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.stepping.initial_value import check_steps
from casadi_galerkin.stepping.stepper import Roll, Stepper


@dataclass(frozen=True)
class Shot:
    """One path from a start.

    Attributes
    ----------
    roll : Roll
    sizes : (4d + k,), of the ends as `end_equations` has them, the n = 2d + k of the start first
    miss : (n,), by how much the equations between the ends are missed
    floor : (n,), what the rounding of the start and of the end do to it; Newton's method may stop below it
    steps : (N, 2d, 2d), Jacobians of the steps
    by_ends : (n, 4d + k), derivatives of the miss by the ends
    by_start : (n, n), its derivative by the start
    terms : (n, n), sizes of the terms that the derivative sums
    growth : (N + 1, 2d, 2d), derivatives of (x_i, p_i) by (x_0, p_0)
    """

    roll: Roll
    sizes: np.ndarray
    miss: np.ndarray
    floor: np.ndarray
    steps: np.ndarray
    by_ends: np.ndarray
    by_start: np.ndarray
    terms: np.ndarray
    growth: np.ndarray

    @property
    def path(self) -> PiecewisePolynomial:
        """The path from joint to joint."""
        return self.roll.unstretched().path()

    @property
    def residual(self) -> float:
        """Largest residual of a step, or miss of the end, over its roundoff floor.

        The floor of the miss is the rounding of the states at all joints, carried on to the end; for the momentum of
        the end it is at least that of the terms that it sums.
        """
        d, states = len(self.roll.x), np.abs(np.concatenate((self.roll.x, self.roll.p)))
        onward = accumulated(self.steps[::-1].transpose(0, 2, 1))[::-1].transpose(0, 2, 1)  # ∂(x_N, p_N)/∂(x_i, p_i)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            floor = self.sizes.copy()
            floor[-2 * d :] = np.einsum("iab,bi->a", np.abs(onward), states)
            floor[-d:] = np.maximum(floor[-d:], self.roll.p_terms[:, -1])
            ratios = np.abs(self.miss) / (np.abs(self.by_ends) @ (EPS * floor + TINY))
        return float(max(np.max(self.roll.residual), np.max(ratios)))


class Shooting:
    """The boundary problem as equations in the start (x_0, p_0, η).

    Attributes
    ----------
    unknowns : number of entries of the start
    plane : (2d,), normal and point of the plane that fixes the phase, or None
    """

    def __init__(
        self, problem: BoundaryProblem, method: Galerkin, mesh: np.ndarray, guess: Trajectory | None = None
    ) -> None:
        self.mesh = mesh
        self.plane = None
        if problem.free_phase:
            calculus = DiscreteCalculus(method, mesh)
            self.plane = phase_plane(calculus.emb(guess_values(guess, calculus, problem.dimension)))
        self.stepper = Stepper(problem, method, problem.energy is not None)
        equations = end_equations(problem, self.plane)
        self.unknowns, self._equations = equations.size1_out(0), Evaluator(equations)

    def shoot(self, start: np.ndarray, velocity: np.ndarray) -> Shot:
        """The path from a start; `velocity` predicts the first step.  Raises if one of its steps fails."""
        d = self.stepper.dimension
        if self.stepper.free_duration and not start[d - 1] > 0:
            raise ConvergenceError(f"the duration would be {start[d - 1]:.2g} of the one begun with")
        roll = self.stepper.roll(start[:d], start[d : 2 * d], velocity, self.mesh)
        check_steps(roll.unstretched())
        steps = self.stepper.jacobians(self.mesh, roll.x, roll.p, roll.unknowns)
        growth = accumulated(steps)
        ends = np.concatenate((start, roll.x[:, -1], roll.p[:, -1]))
        miss, by_ends = self._equations(ends)
        by_ends = by_ends.reshape(len(ends), -1).T
        with np.errstate(over="ignore", invalid="ignore"):
            sizes = self._sizes(roll, steps, start[2 * d :], np.abs(by_ends))
            moved = np.append(np.zeros(len(start)), np.abs(growth[-1]) @ np.abs(start[: 2 * d]))
            floor = EPS * (np.abs(by_ends) @ (sizes + moved))
            by_start = by_ends @ self._ends_by_start(growth[-1])
            terms = np.abs(by_ends) @ self._ends_by_start(np.abs(steps[-1]) @ np.abs(growth[-2]))
        return Shot(roll, sizes, miss, floor, steps, by_ends, by_start, terms, growth)

    def _ends_by_start(self, growth: np.ndarray) -> np.ndarray:
        """Derivatives of the ends by the start, (4d + k, n), where `growth` is that of (x_N, p_N) by (x_0, p_0)."""
        start = np.eye(self.unknowns)
        return np.concatenate((start, growth @ start[: len(growth)]))

    def _sizes(self, roll: Roll, steps: np.ndarray, own: np.ndarray, by_ends: np.ndarray) -> np.ndarray:
        """Sizes of the ends, (4d + k,): of (x, p) the largest at the joints, of η what matters as much in an equation.

        The size of a momentum is that of the terms that it sums, which may cancel: at an equilibrium, and those of the
        momentum of the stretch where the energy is near zero.
        """
        states = np.max(np.concatenate((np.abs(roll.x), roll.p_terms)), axis=1)
        if self.stepper.free_duration:
            states[-1] = max(states[-1], np.sum(np.abs(steps[:, -1, :-1]), axis=0) @ states[:-1])
        sizes = np.concatenate((states, np.zeros(len(own)), states))
        asked = by_ends @ sizes
        for i, column in enumerate(by_ends[:, len(states) : -len(states)].T):
            found = (column > 0) & (asked > 0)
            alike = np.min(asked[found] / column[found]) if found.any() else 0.0
            sizes[len(states) + i] = max(abs(own[i]), alike)
        return sizes


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
        bound = rows_that_depend(constraint, "x", free)
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


def accumulated(jacobians: np.ndarray) -> np.ndarray:
    """Products of the steps' Jacobians (N, n, n) up to every joint; (N + 1, n, n), the first the identity."""
    products = np.empty((len(jacobians) + 1, *jacobians.shape[1:]))
    products[0] = np.eye(len(products[0]))
    with np.errstate(over="ignore", invalid="ignore"):  # the growth may leave the range of doubles
        for step, before, after in zip(jacobians, products, products[1:], strict=False):
            np.matmul(step, before, out=after)
    return products
