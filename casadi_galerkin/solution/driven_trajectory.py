"""A trajectory that controls drive: its replay, and what its quadrature points do not see of equations and bounds."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.nodes import lagrange_values
from casadi_galerkin.calculus.piecewise_polynomial import sampling_parts
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.calculus.roundoff import TINY, component_sizes, or_one
from casadi_galerkin.problems.bounds import bound_excess
from casadi_galerkin.problems.callables import with_parameters
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.controlled_motion import equations_of_motion
from casadi_galerkin.solution.control_path import ControlPath
from casadi_galerkin.solution.trajectory import Trajectory

CONTINUOUS = 1e-8  # jump of a control over the largest control up to which it is an error of the solver


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class DrivenTrajectory(Trajectory):
    """A trajectory with the controls that drive it; see `ControlTrajectory` for the attributes."""

    problem: ControlProblem
    control: ControlPath

    def replay(self) -> ca.Function:
        """Return the force (t, x, v[, p]) -> (d,) of the optimized controls, for an `InitialProblem`.

        Stepped with the same method on the same joints it gives the same path.

        Raises
        ------
        ValueError
            where the rule has points at both ends of an interval (Lobatto) and a control jumps at a joint: a function
            of time has one value there, and the path was found with two; and where a component follows a rate, or the
            path jumps
        """
        if self.problem.mechanical < len(self.x):
            raise ValueError(f"an InitialProblem has no rates, which x[{self.problem.mechanical}] follows")
        if self.problem.jumps:
            when = self.problem.jumps[0][0]
            raise ValueError(f"an InitialProblem has no jumps, but the path jumps at t = {when:.6g}")
        self._refuse_two_values()
        return self._force()

    def _force(self) -> ca.Function:
        """The force of the optimized controls."""
        t, x, v, *p = symbols = self.problem.lagrangian.sx_in()
        force = self.problem.force(t, x, v, self.control.expression(t), *p)
        return ca.Function("force", symbols, [ca.densify(force)], ["t", "x", "v", "p"][: len(symbols)], ["value"])

    def _refuse_two_values(self) -> None:
        """Raise a ValueError where the two controls at a joint differ."""
        ends, u = np.array([0.0, 1.0]), self.control
        if not np.array_equal(u.rule[[0, -1]], ends):
            return
        values = u.at(ends).reshape(len(u.values), -1, 2)
        jumps = np.abs(values[:, 1:, 0] - values[:, :-1, 1])
        largest = component_sizes(u.values)[:, None]
        if np.any(jumps > CONTINUOUS * largest):
            k, i = np.unravel_index(np.argmax(jumps / largest), jumps.shape)
            raise ValueError(
                f"the control u[{k}] jumps by {jumps[k, i]:.3g} at the joint t = {self.t[i + 1]:.6g}, where "
                f"{self.method} has a point on both sides: no force of time alone has both values. Solve with a rule "
                "without points at both ends, such as gauss or radau, to replay it"
            )

    @cached_property
    def dynamics_defect(self) -> np.ndarray:
        """Largest relative residual of the equations of motion between the points, for each interval; (N,).

        The largest |∂L/∂v(x̄, dx̄/dt) - p̂| at r + 2 Gauss points, over the largest momentum (or impulse) on the path,
        with p̂ the joint's momentum plus the impulse ∫ (∂L/∂x + F) dt since then.  Where a component follows a rate, its
        value and its rate take the places of momentum and force.  Of order m.
        """
        inner = gauss(len(self.method.quadrature) + 2)
        s, steps = np.array(inner.points), np.diff(self.t)
        momentum, rate = self._motion(s)
        # ∫_0^{s_j} of the polynomial through the Gauss points, exact by the same rule scaled to [0, s_j]
        primitive = np.stack([a * (np.array(inner.weights) @ lagrange_values(s, a * s)) for a in s])
        impulse = np.einsum("din,jn,i->dij", rate, primitive, steps)
        at_joints = self._momenta
        defect = np.abs(momentum - at_joints[:, :-1, None] - impulse).max(axis=2)
        size = np.abs(at_joints).max(axis=1) + np.abs(impulse).max(axis=(1, 2))
        return np.asarray((defect / or_one(size)[:, None]).max(axis=0))

    @cached_property
    def control_misfit(self) -> np.ndarray:
        """Error of the impulse over each interval if the controls are taken as functions of time; (N,).

        The difference of ∫ (∂L/∂x + F) dt along `control(t)` to its quadrature, which sees the controls at the points
        only, over the largest momentum plus the sum of all impulses.  Where a component follows a rate, its value and
        its rate take the places of momentum and force.  A path that is flown with these controls misses by about the
        sum of all intervals, times the growth of an error along it.  It is of the order of the method, but large where
        controls turn over between the points, as an angle does that is limited to one turn.
        """
        rule, steps = self.method.quadrature, np.diff(self.t)
        rules = rule, gauss(len(rule) + 2)
        impulse, finer = (self._motion(np.array(r.points))[1] @ np.array(r.weights) * steps for r in rules)
        size = np.abs(self._momenta).max(axis=1) + np.abs(impulse).sum(axis=1)
        return np.asarray((np.abs(finer - impulse) / or_one(size)[:, None]).max(axis=0))

    @cached_property
    def control_overshoot(self) -> np.ndarray:
        """Largest excess of the controls over their bounds between the points, over the bounds' width; (N,).

        It is large where a control jumps inside an interval (bang-bang), where a joint at the jump would help; the
        summary then shows it.
        """
        low, high = (np.array(side)[:, None] for side in self.problem.control_bounds)
        width = np.where(np.isfinite(high - low) & (high > low), high - low, 1.0)
        u = self.control.at(sampling_parts(len(self.method.quadrature)))
        excess = bound_excess(u, low, high) / width
        return np.asarray(excess.max(axis=0).reshape(len(self.t) - 1, -1).max(axis=1))

    def path_constraints(self, parts: np.ndarray) -> np.ndarray:
        """Values of the path constraints at fractions (K,) of every interval, joints included; (k, N, K)."""
        if self.problem.path_constraint is None:
            return np.empty((0, len(self.t) - 1, len(parts)))
        constraint = with_parameters(self.problem.path_constraint[0], self.parameters)
        times, x, v = self.polynomial.sampled(parts)
        values = np.array(constraint.map(len(times))(times[None, :], x, v, self.control.at(parts)))
        return values.reshape(len(values), len(self.t) - 1, len(parts))

    @cached_property
    def constraint_excess(self) -> np.ndarray:
        """Largest excess of the path constraints over their bounds between the points; (N,).

        It is relative to the largest value of each constraint on the path, or to its finite bound where that is larger.
        """
        if self.problem.path_constraint is None:
            return np.zeros(len(self.t) - 1)
        low, high = (np.array(side)[:, None, None] for side in self.problem.path_constraint[1:])
        values = self.path_constraints(sampling_parts(len(self.method.quadrature)))
        sizes = [np.max(np.abs(np.where(np.isfinite(a), a, 0.0)), axis=(1, 2)) for a in (values, low, high)]
        size = np.max(sizes, axis=0)[:, None, None]
        return np.asarray((bound_excess(values, low, high) / np.maximum(size, TINY)).max(axis=(0, 2), initial=0.0))

    @property
    def _momenta(self) -> np.ndarray:
        """Momenta at the joints, and of components that follow rates their values; (d, N + 1)."""
        mechanical = self.problem.mechanical
        return np.vstack((self.momentum[:mechanical], self.x[mechanical:]))

    def _motion(self, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """∂L/∂v and ∂L/∂x + F at fractions (K,) of every interval, (d, N, K) each.

        Where a component follows a rate, its value and its rate take their places.
        """
        times, x, v = self.polynomial.sampled(parts)
        pushes = np.empty((0, len(times))) if self.problem.constraint is None else self.multipliers(times)
        motion = equations_of_motion(self.problem).map(len(times))
        momentum, rate = motion(times[None, :], x, v, self.control.at(parts), pushes)
        shape = len(x), -1, len(parts)
        return np.array(momentum).reshape(shape), np.array(rate).reshape(shape)
