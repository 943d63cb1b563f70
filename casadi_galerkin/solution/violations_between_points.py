"""How far an optimized path misses its equations and exceeds its bounds between the points that the solver sees.

The solver imposes the equations of motion, the rates and the bounds at the quadrature points and nodes alone.  Whoever
flies the path uses all of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, sampling_parts
from casadi_galerkin.calculus.roundoff import TINY, component_sizes, or_one
from casadi_galerkin.functional.interval import SlopeBasis
from casadi_galerkin.functional.pointwise import at_places
from casadi_galerkin.problems.callables import rows_that_depend
from casadi_galerkin.problems.constrained_motion import equations_of_motion
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.statements import AT_BOUND, bound_excess
from casadi_galerkin.solution.control_path import ControlPath, finer_rule
from casadi_galerkin.solution.jump_detection import JumpDetector
from casadi_galerkin.solution.time_jumps import integrand, largest_step, may_step, moving_phases
from casadi_galerkin.solution.trajectory import Trajectory

# times as many samples as for the path, to see obstacles that are as narrow as a twentieth of an interval
SAMPLING_FACTOR = 4


@dataclass(frozen=True, eq=False)
class BetweenPoints:
    """What an optimized path misses between the quadrature points of its intervals.

    Where a component follows a rate, its value and its rate take the places of momentum ∂L/∂v and force ∂L/∂x + F.

    Attributes
    ----------
    path : Trajectory, without its controls
    problem, control, costate, path_multipliers : as in `ControlTrajectory`
    """

    path: Trajectory
    problem: ControlProblem
    control: ControlPath
    costate: PiecewisePolynomial
    path_multipliers: ControlPath | None

    @property
    def momenta(self) -> np.ndarray:
        """Momenta at the joints, (d, N + 1)."""
        mechanical = self.problem.mechanical
        return np.vstack((self.path.momentum[:mechanical], self.path.x[mechanical:]))

    def motion(self, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Momenta and forces at fractions (K,) of every interval, (d, N, K) each."""
        times, x, v = self.path.polynomial.sampled(parts)
        pushes = np.empty((0, len(times))) if self.problem.constraint is None else self.path.multipliers(times)
        momentum, rate = at_places(equations_of_motion(self.problem), times, x, v, self.control.at(parts), pushes)
        shape = len(x), -1, len(parts)
        return momentum.reshape(shape), rate.reshape(shape)

    @cached_property
    def cost_of_forces(self) -> float:
        """Cost of forces and rates that would change momenta and first-order components by their sizes."""
        return float(np.max(np.abs(self.costate.values), axis=1) @ np.max(np.abs(self.momenta), axis=1))

    @cached_property
    def dynamics_defect(self) -> np.ndarray:
        """As in `ControlTrajectory`: p̂ is the joint's momentum plus the impulse since then."""
        inner = SlopeBasis(len(self.path.method.quadrature) + 2)
        momentum, rate = self.motion(inner.points)
        impulse = np.einsum("din,jn,i->dij", rate, inner.values(inner.points), np.diff(self.path.t))
        at_joints = self.momenta
        defect = np.abs(momentum - at_joints[:, :-1, None] - impulse).max(axis=2)
        size = np.abs(at_joints).max(axis=1) + np.abs(impulse).max(axis=(1, 2))
        return (defect / or_one(size)[:, None]).max(axis=0)

    def _missed(self, rates: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """What integrals of rates (..., N, K) along the controls in time exceed the quadrature by; (..., N).

        And the integrals of the sizes of the rates over the whole, (...).
        """
        rule, steps = self.path.method.quadrature, np.diff(self.path.t)
        (finer, its), found = finer_rule(len(rule)), rates(np.array(rule.points))
        missed = (rates(finer) @ its - found @ np.array(rule.weights)) * steps
        return missed, np.abs(found) @ np.array(rule.weights) @ steps

    @cached_property
    def missed_impulses(self) -> np.ndarray:
        """What the impulses of the controls as functions of time exceed those at the points by, relative; (d, N)."""
        missed, sizes = self._missed(lambda parts: self.motion(parts)[1])
        return missed / or_one(np.abs(self.momenta).max(axis=1) + sizes)[:, None]

    @property
    def control_misfit(self) -> np.ndarray:
        """As in `ControlTrajectory`."""
        return np.max(np.abs(self.missed_impulses), axis=0)

    @cached_property
    def missed_costs(self) -> np.ndarray:
        """What the controls as functions of time change the cost by, to first order, on every interval; (N,)."""
        return self._missed(lambda parts: at_places(self.integrand, *self.along(parts))[0].reshape(-1, len(parts)))[0]

    @property
    def flight_error(self) -> float:
        """Largest error of a momentum or value at a joint in a flight with `control(t)`, without its growth."""
        return float(np.max(np.abs(np.cumsum(self.missed_impulses, axis=1))))

    @property
    def constraint_excess(self) -> np.ndarray:
        """As in `ControlTrajectory`."""
        return np.max(self._relative_excess, axis=0)

    @property
    def common_excess(self) -> np.ndarray:
        """The same where neither comparisons with other paths nor multipliers tell of its cost; (N,).

        It is that of positions, and of path constraints on positions alone or that no quadrature point near by meets.
        """
        constraint, low, high = self.problem.path_constraint
        moving = [rows_that_depend(constraint, k, np.ones(constraint.numel_in(k), dtype=bool)) for k in ("v", "u")]
        values, places = self.path_constraints(self.path.method.element.points), np.arange(len(self.path.t) - 1)
        distances = [np.min(np.abs(values - np.reshape(side, (-1, 1, 1))), axis=2) for side in (low, high)]
        met = np.pad(np.min(distances, axis=0) <= AT_BOUND * self.constraint_changes, ((0, 0), (1, 1)))
        near = met[:, places] | met[:, places + 1] | met[:, places + 2]
        seen = np.any(moving, axis=0)[:, None] & near
        return np.max(np.where(np.pad(seen, ((0, len(self.path.x)), (0, 0))), 0.0, self._relative_excess), axis=0)

    @cached_property
    def _relative_excess(self) -> np.ndarray:
        """Excess of path constraints and positions as parts of the size of the path by which it is off, (k + d, N)."""
        excess = self.path_excess(self._samples)[1]
        outside = bound_excess(self.path.polynomial.at_parts(self._samples)[0], *self.problem.position_bounds)
        of_positions = np.max(outside, axis=2) / self.path.sizes[:, None]
        return np.minimum(np.vstack((np.max(excess, axis=2) / self.constraint_changes, of_positions)), 1.0)

    @property
    def _samples(self) -> np.ndarray:
        """Fractions of an interval at which constraints are sampled."""
        return sampling_parts(SAMPLING_FACTOR * self.path.method.degree)

    def path_constraints(self, parts: np.ndarray) -> np.ndarray:
        """As in `ControlTrajectory`."""
        constraint = self.problem.numeric.limits[0]
        times, x, v = self.path.polynomial.sampled(parts)
        (values,) = at_places(constraint, times, x, v, self.control.at(parts))
        return values.reshape(len(values), len(self.path.t) - 1, len(parts))

    def path_excess(self, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values of the path constraints, and their excess over their bounds, zero where a value is not finite."""
        values = self.path_constraints(parts)  # 0/0 is a ratio of two positions that vanish at an end
        return values, np.where(np.isfinite(values), bound_excess(values, *self.problem.limits[1:]), 0.0)

    @cached_property
    def constraint_changes(self) -> np.ndarray:
        """Changes of path constraints g if x, v and u change by their sizes, Σ |∂g/∂z| |z|, at their largest excess.

        An excess over this change is about the part of its size by which the path has to change.  The largest value of
        a constraint is no measure: the square of the distance to an obstacle is as large as that of the path, and is
        exceeded by the square of the size of the obstacle alone.  Nor are the derivatives away from the largest excess,
        where it changes along the path: to move along it does not help.

        Returns
        -------
        (k, N), at least `TINY`, and infinite where it is not finite
        """
        values, excess = self.path_excess(self._samples)
        if not len(values):
            return np.empty(values.shape[:2])
        t, *z = self.problem.limits[0].sx_in()[:4]
        constraint = self.problem.numeric.limits[0]
        derivative, path, joints = ca.jacobian(constraint(t, *z), ca.vertcat(*z)), self.path, self.path.t
        sizes = np.concatenate((path.sizes, component_sizes(path(joints, 1)), component_sizes(self.control.values)))
        times = joints[:-1] + np.diff(joints) * np.argmax(excess, axis=2) / (values.shape[2] - 1)
        terms = ca.Function("terms", [t, *z], [ca.densify(ca.mtimes(ca.fabs(derivative), sizes))])
        flat, each = times.ravel(), np.arange(len(times))
        (found,) = at_places(terms, flat, path(flat), path(flat, 1), self.control(flat))
        changes = found.reshape(len(times), *times.shape)[each, each]
        return np.where(np.isfinite(changes), np.maximum(changes, TINY), np.inf)

    def along(self, parts: np.ndarray) -> list[np.ndarray]:
        """Times and z of the `integrand` at fractions (K,) of every interval; (N K,) and (rows, N K) each."""
        costate = [a.reshape(len(a), -1) for a in self.costate.at_parts(parts)]
        times, x, v = self.path.polynomial.sampled(parts)
        multipliers = np.empty((0, len(times))) if self.path_multipliers is None else self.path_multipliers.at(parts)
        return [times, x, v, self.control.at(parts), *costate, multipliers]

    @cached_property
    def integrand(self) -> ca.Function:
        """The integrand of the cost with its multipliers."""
        return integrand(self.problem)

    @cached_property
    def jump_effects(self) -> np.ndarray:
        """Largest changes of the cost by jumps of callables in time, inside of each interval; (N,)."""
        joints, rule = self.path.t, self.path.method.quadrature
        if self.problem.autonomous:
            return np.zeros(len(joints) - 1)
        detector = JumpDetector(joints, rule)
        z = [np.repeat(a, len(detector.parts) // len(rule), axis=1) for a in self.along(np.array(rule.points))[1:]]
        values, rates, *_ = at_places(self.integrand, detector.times, *z)
        return detector.jump_effects(values[0], rates[0])

    @cached_property
    def largest_step(self) -> tuple[float, float]:
        """The largest step of the integrand that no derivative shows, and its time."""
        problem, joints, rule = self.problem, self.path.t, self.path.method.quadrature
        if not may_step(problem):
            return 0.0, float(joints[0])
        moving = moving_phases(problem)[np.searchsorted(problem.breakpoints, joints[:-1], side="right")]
        z = self.along(np.array(rule.points))[1:]
        return largest_step(self.integrand, self.path.polynomial, rule, z, moving)
