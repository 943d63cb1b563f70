"""Error estimate of an optimal path, by a path of degree m + 2 on the same mesh.

Let D be the largest of three differences between the two paths: the relative changes of the cost and of the duration,
and the largest change of x at the same fraction of the duration, relative to the size of its component.  Let q be the
ratio of the truncation errors of the two paths (`truncation_error`), at most 2/3, and 2/3 where controls switch or
there is a path constraint.  The estimated error is D / (1 - q).  The error of the cost alone is far smaller, of the
order of D².  Where phases have free durations, the joints of the two paths are at different fractions of the duration,
and the paths may jump there.  So they are compared at the same fractions of intervals, and the change of x by the shift
in time is subtracted.

Some errors are common to both degrees, so that the difference does not show them.  They are estimated separately:

- Switches from bound to bound.  A control should switch where the switching function ∂(ℓ + λ·(F, ρ))/∂u, with forces F
  and rates ρ, is zero.  If the nearest joint lies elsewhere, there may be no quadrature point between the two, and then
  neither path shows the difference.  A component whose rate jumps there is off by the jump times the delay, which
  may be large for a short burn of an engine.
- Bounds of positions, which hold at nodes only.  Where a path exceeds one by ε between nodes, the error of the path is
  about √ε; about ε for a component whose rate is controlled, which can follow its bound.  Where it only touches its
  bound, `touches` tells how late or early, also where rounding hides the excess.
- Impulses shorter than the distance of the first point from a joint.  There the controls at the points keep to their
  bounds, but add up to a larger impulse than these allow.  Both degrees then have the same momentum behind it, and the
  same defect (`ControlTrajectory.dynamics_defect`).
- Bounds of controls and path constraints, which hold at quadrature points only: see `unseen_excess` and
  `HigherDegree.constraint_excess`.  What these constraints and positions exceed their bounds by changes the cost in
  first order: see `HigherDegree.excess_effects`.
- The Hamiltonian, which is constant where nothing depends on time.  Its variation, times duration over cost, was
  measured to be of the order of D where both degrees switch at the same wrong time.
- Jumps in time (`solution.hamiltonian`): the errors of cost and path are estimated to be at least their effect.
- Steps as x or v move, or at given times while durations or parameters are free: no mesh takes their errors away.
- Controls that leave or meet a bound inside an interval (`bends`), where the quadrature does not see this.
- The error that the solver leaves (`second_order`).
- Controls as functions of time, which the equations see at the points only (`ControlTrajectory.control_misfit`).

The estimated error of the cost is at least the square of each of the first five, and at least the excess over path
constraints that no point near by meets, because nothing tells how steeply the cost changes there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import mul

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.mesh_adaptation import truncation_error
from casadi_galerkin.calculus.piecewise_polynomial import around, extreme_values, sampling_parts, times_at
from casadi_galerkin.calculus.roundoff import component_sizes
from casadi_galerkin.control.bends import Bend, bend_errors, bends, carried
from casadi_galerkin.control.optimizer import NEGLIGIBLE_MOMENTUM
from casadi_galerkin.control.switching import Switch, switches
from casadi_galerkin.control.touches import (
    Touch,
    bounds_touched,
    constraint_impulses,
    driven_positions,
    position_impulses,
    touch_error,
    touch_time,
    touches,
)
from casadi_galerkin.problems.bounds import bound_excess
from casadi_galerkin.solution.between_points import FINER
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.guess import FAR_FROM_GUESS

SLOWEST = 2 / 3  # largest q, which is also assumed where switches or path constraints slow down convergence
SHARED_DEFECT = 0.5  # ratio of the defects of both degrees above which a higher degree does not reduce it
HIDDEN = 1e-2  # difference of both paths over what the defect moves them below which it does not show the defect
TOUCHED_LATE = 2.0  # error of a free duration over how late a bound acts that is touched
ROUNDOFF = 1e-15  # of positions and of impulses, relative to their sizes
MET = 1e-4  # distance from a bound, over `constraint_changes`, up to which a point meets it
UNSEEN_RATIO = 0.1  # relative difference of two degrees' excess over a bound, below which no quadrature point sees it


def position_errors(path: ControlTrajectory, touched: Sequence[Touch]) -> np.ndarray:
    """Errors of the path on each interval, (N,), because its positions exceed their bounds between the nodes.

    At the nodes they do so by what the solver leaves.  This moves the bound, but not the time at which it is met, which
    is also known where the bound is only touched.
    """
    problem, x = path.problem, path.polynomial
    low, high = (np.array(side)[:, None] for side in problem.position_bounds)
    least, most = x.extremes(np.union1d(sampling_parts(x.degree), around(x.nodes)))
    at_nodes = np.max(bound_excess(x.local, *problem.position_bounds), axis=2) / path.sizes[:, None]
    excess = np.maximum(low - least, most - high) / path.sizes[:, None] - at_nodes
    powers = np.full(excess.shape, 0.5)
    powers[driven_positions(problem)] = 1.0
    for touch in (touch for touch in touched if touch.number < len(powers)):
        times = sorted((touch.acts, touch.extreme))
        first, last = np.searchsorted(path.t, path.t[0] + np.ptp(path.t) * np.array(times)) - 1
        powers[touch.number, max(first, 0) : last + 2] = 1.0
    return np.max(np.where(excess > ROUNDOFF, excess, 0.0) ** powers + at_nodes, axis=0)


def unseen_excess(values: list[np.ndarray], bounds: Sequence[ArrayLike]) -> np.ndarray:
    """Excess of bounded values over their bounds between the quadrature points, which is common to both degrees.

    Bounds hold at quadrature points only, and a control may be largest between them, as next to an end of the path.
    Both degrees then exceed the bound by the same amount, and hardly differ on the interval.  Where a control jumps
    they do differ, and the excess is not counted.

    Parameters
    ----------
    values : of both degrees at the same fractions of every interval, (n, N, K) each
    bounds : lower and upper bounds, (n,) each

    Returns
    -------
    the excess that counts, (n, N, K)
    """
    excess = np.min([bound_excess(one, *bounds) for one in values], axis=0)
    difference, largest = (np.max(a, axis=-1, keepdims=True) for a in (np.ptp(values, axis=0), excess))
    return np.where(difference < UNSEEN_RATIO * largest, excess, 0.0)


def unseen_control_excess(path: ControlTrajectory, higher: ControlTrajectory) -> np.ndarray:
    """The largest `unseen_excess` of controls on each interval, relative to the largest control, (N,)."""
    parts = sampling_parts(path.method.degree)
    values = [p.control.at(parts).reshape(-1, len(p.t) - 1, len(parts)) for p in (path, higher)]
    excess = np.max(unseen_excess(values, path.problem.control_bounds), axis=2)
    return np.max(excess / component_sizes(path.control.values)[:, None], axis=0)


@dataclass(frozen=True)
class HigherDegree:
    """A path of degree m, the path of degree m + 2 on the same mesh, and the errors estimated from the two.

    Attributes
    ----------
    path, higher : ControlTrajectory, of degree m and of degree m + 2
    touched_before : touches of bounds by paths on another mesh
    """

    path: ControlTrajectory
    higher: ControlTrajectory
    touched_before: Sequence[Touch] = ()

    @cached_property
    def switches(self) -> list[Switch]:
        """Switches of the path of higher degree."""
        return switches(self.higher, self.bends)

    @cached_property
    def bends(self) -> list[Bend]:
        """Bends of the path of higher degree."""
        return bends(self.higher)

    @cached_property
    def touches(self) -> list[Touch]:
        """Touches of bounds by the path."""
        return touches(self.path)

    @cached_property
    def touches_of_higher(self) -> list[Touch]:
        """Touches of bounds by the path of higher degree."""
        return touches(self.higher)

    @cached_property
    def touch_errors(self) -> list[float]:
        """Errors of the path because bounds that it touches act at wrong times."""
        return [touch_error(touch, self.touches_of_higher) for touch in self.touches]

    @cached_property
    def touch_times(self) -> tuple[list[float], list[float]]:
        """Times at which the path of higher degree should touch the bounds of positions, and path constraints."""
        t, times = self.higher.t, (list[float](), list[float]())
        for touch in self.touches_of_higher:
            part = touch_time(touch, [*self.touches, *self.touched_before])
            times[touch.number >= len(self.path.x)].append(float(t[0] + np.ptp(t) * part))
        return times

    def of_cost(self, change: float) -> float:
        """A change of the cost relative to its size; zero where the cost cannot be told from zero."""
        both = self.path, self.higher
        if max(abs(p.cost) for p in both) <= NEGLIGIBLE_MOMENTUM * max(p.between_points.cost_of_forces for p in both):
            return 0.0
        return change / max(p.cost_size for p in both)

    @cached_property
    def cost_change(self) -> float:
        """Change of the cost from one degree to the other, relative to the cost."""
        return self.of_cost(abs(self.higher.cost - self.path.cost))

    @cached_property
    def differences(self) -> np.ndarray:
        """Largest differences of the two paths on each interval, at the same fractions of the duration, (N,)."""
        path, higher, parts = self.path, self.higher, sampling_parts(self.path.method.degree)
        (before, slope), (after, _) = (p.polynomial.at_parts(parts) for p in (path, higher))
        own, other = (times_at((p.t - p.t[0]) / np.ptp(p.t), parts).reshape(-1, len(parts)) for p in (path, higher))
        change = np.abs(after - before - slope * np.ptp(path.t) * (other - own))
        return np.max(change / path.sizes[:, None, None], axis=(0, 2))

    @cached_property
    def change(self) -> float:
        """Error D / (1 - q) of cost, duration and positions; see the module."""
        path, higher = self.path, self.higher
        coarse, fine = (float(np.max(truncation_error(p.polynomial, path.sizes))) for p in (path, higher))
        at_points = path.problem.path_constraint[1] or self.switches
        ratio = SLOWEST if at_points else min(fine / max(coarse, fine, 1e-300), SLOWEST)
        duration = abs(np.ptp(higher.t) / np.ptp(path.t) - 1)
        return float(max(self.cost_change, duration, np.max(self.differences)) / (1 - ratio))

    @cached_property
    def bound_errors(self) -> np.ndarray:
        """Errors of the path on each interval because bounds hold at nodes or points only, (N,); see the module."""
        of_controls = unseen_control_excess(self.path, self.higher)
        of_positions = position_errors(self.path, self.touches)
        errors = [of_positions, of_controls, self.shared_defect, *self.constraint_excess[0]]
        return np.max(errors, axis=0)

    @cached_property
    def shared_defect(self) -> np.ndarray:
        """Errors of the path by impulses that exceed what the bounds of the controls allow in both degrees, (N,).

        Where the defect is that of a switch inside the interval, both paths differ by about as much as it moves them.
        """
        bounded = np.isfinite(self.path.problem.control_bounds)
        before, after = self.path.dynamics_defect, self.higher.dynamics_defect
        moved = after * np.diff(self.path.t) / np.ptp(self.path.t)
        shared = np.any(bounded) & (after > SHARED_DEFECT * before) & (self.differences < HIDDEN * moved)
        return np.where(shared, moved, 0.0)

    @cached_property
    def constraint_excess(self) -> tuple[np.ndarray, np.ndarray]:
        """Largest excess of path constraints on each interval in both degrees, over `constraint_changes`.

        This is about the part of its size by which the path has to change, at most one.  Where a constraint depends on
        controls, or velocities that they change at once, which bend or jump, only the `unseen_excess` counts.

        Returns
        -------
        of every constraint, (k, N), and that of constraints whose bounds no quadrature point of the interval or of its
            neighbors meets
        """
        path, bounds = self.path, self.path.problem.path_constraint[1:]
        parts = sampling_parts(FINER * path.method.degree)
        values = [p.path_constraints(parts) for p in (path, self.higher)]
        extremes = [[bound_excess(side, *bounds) for side in extreme_values(one)] for one in values]
        both = np.min(np.max(np.nan_to_num(extremes, posinf=0.0), axis=1), axis=0)
        common = np.where(bounds_touched(path.problem)[:, None], both, np.max(unseen_excess(values, bounds), axis=2))
        changes = path.between_points.constraint_changes
        at_points = path.path_constraints(path.method.element.points)
        distances = [np.min(np.abs(at_points - np.reshape(side, (-1, 1, 1))), axis=2) for side in bounds]
        met = np.pad(np.min(distances, axis=0) <= MET * changes, ((0, 0), (1, 1)))
        near = met[:, :-2] | met[:, 1:-1] | met[:, 2:]
        excess = np.minimum(common / changes, 1.0)
        return excess, np.where(near, 0.0, excess)

    @cached_property
    def control_misfit(self) -> np.ndarray:
        """Errors of the impulses because controls are known at points only, (N,); zero for rounding.

        Zero also where a force is not finite between the points, as u^1.5 is where u overshoots zero at a jump.
        """
        misfit = self.path.control_misfit
        return np.where(misfit > ROUNDOFF, misfit, 0.0)

    @cached_property
    def bend_errors(self) -> tuple[np.ndarray, np.ndarray]:
        """Relative errors of the path, and of the cost, where controls bend inside an interval; (N,) each.

        Of the impulses only what both degrees miss counts: the rest is in their difference.
        """
        (missed, of_cost), (of_higher, _) = bend_errors(self.path), bend_errors(self.higher)
        shared = np.where(missed * of_higher > 0, np.sign(missed) * np.minimum(np.abs(missed), np.abs(of_higher)), 0.0)
        shares = np.max(np.abs(shared) / self.path.between_points.impulse_sizes[:, None], axis=0)
        of_path = np.max(carried(self.path, shared)) * shares / max(np.sum(shares), 1e-300)
        return of_path, np.array([self.of_cost(change) for change in of_cost])

    @cached_property
    def rate_changes(self) -> list[float]:
        """Largest change of a rate at every switch, over the size of its component; zero where there are no rates."""
        first, between = self.path.problem.mechanical, self.higher.between_points
        sizes = self.higher.sizes[first:]
        changes = [between.force_change(s.due, s.control, s.before, s.after)[first:] for s in self.switches]
        return [float(np.max(np.nan_to_num(np.abs(change) / sizes), initial=0.0)) for change in changes]

    @property
    def rate_error(self) -> float:
        """Error of the components whose rates jump at switches, by those that are late; common to both degrees."""
        late = (abs(s.due - s.joint) for s in self.switches)
        return max(map(mul, self.rate_changes, late), default=0.0)

    @cached_property
    def common_error(self) -> float:
        """Error of the path that is common to both degrees: of switches, touches, bounds, and what steps in x."""
        late = [abs(s.due - s.joint) / np.ptp(self.higher.t) for s in self.switches] + self.touch_errors
        if self.path.problem.duration_bounds is not None:  # a free duration is longer or shorter by about as much
            late += [TOUCHED_LATE * abs(touch.extreme - touch.acts) for touch in self.touches]
        return float(max(*late, np.max(self.bound_errors), self.unseen_step))

    @cached_property
    def unseen_steps(self) -> np.ndarray:
        """Steps of callables on each interval that no derivative shows in either degree, times duration over cost."""
        least = np.minimum(self.path.between_points.unseen_steps.sizes, self.higher.between_points.unseen_steps.sizes)
        return np.array([self.of_cost(step * np.ptp(self.path.t)) for step in least])

    @property
    def unseen_step(self) -> float:
        """The largest of all `unseen_steps`."""
        return float(np.max(self.unseen_steps))

    @cached_property
    def jump_effects(self) -> np.ndarray:
        """Changes of the cost by jumps in time inside each interval, relative to the cost; (N,)."""
        return np.array([self.of_cost(change) for change in self.path.between_points.jump_effects])

    @cached_property
    def excess_effects(self) -> np.ndarray:
        """Changes of the cost on each interval by what positions and path constraints exceed their bounds by; (N,).

        Between the points they do.  The changes are of first order in the excess ε, the same in both degrees: to allow
        a bound of multiplier μ so much changes the cost by ∫ μ ε dt.
        """
        path, both, problem = self.path, (self.path, self.higher), self.path.problem
        impulses = [np.sum(position_impulses(path), axis=2)]
        parts = around(path.polynomial.nodes)
        excesses = [[bound_excess(p.polynomial.values_at_parts(parts), *problem.position_bounds) for p in both]]
        if path.path_multipliers is not None:
            parts = around(path.method.element.points)
            excesses.append([p.between_points.path_excess(parts)[1] for p in both])
            impulses.append(np.sum(constraint_impulses(path), axis=2))
        common = np.vstack([np.min(np.max(excess, axis=3), axis=0) for excess in excesses])
        return np.array([self.of_cost(change) for change in np.sum(common * np.vstack(impulses), axis=0)])

    @property
    def jump_error(self) -> float:
        """Relative error of the cost by all jumps in time."""
        return float(np.sum(self.jump_effects))

    def remaining_error(self, path: ControlTrajectory) -> tuple[float, float]:
        """Relative errors of the cost and of the path that the solver leaves with one of the degrees."""
        return self.of_cost(path.unseen_change), path.solver_error

    @property
    def errors(self) -> tuple[float, float]:
        """Errors of the cost, and of cost, duration and positions, with those that the solver leaves."""
        of_cost, of_path = self.remaining_error(self.path)
        return self.cost_error + of_cost, self.error + max(of_cost, of_path)

    @property
    def error(self) -> float:
        """Relative error of cost, duration and positions."""
        missed = np.maximum(self.control_misfit, self.bend_errors[0])
        return max(self.change, self.common_error, self.rate_error, self.cost_error, float(np.sum(missed)))

    @property
    def cost_error(self) -> float:
        """Relative error of the cost; an error of a path that keeps to all bounds changes it in second order only.

        Where the two paths are far apart, their costs may agree by chance, and the distance of the paths is the error.
        """
        distance = self.change if self.change > FAR_FROM_GUESS else 0.0
        change, common = self.cost_change / (1 - SLOWEST), self.common_error
        variation = self.of_cost(self.path.hamiltonian_variation)
        unmet = float(np.max(self.constraint_excess[1], initial=0.0))
        effects = self.jump_error + float(np.sum(self.excess_effects) + np.sum(self.bend_errors[1]))
        return max(change, common**2, variation**2, distance, unmet, effects)
