"""How wrong an optimal path is, and on which mesh it would be less so, from the same mesh with degree m + 2.

The relative changes of cost and duration and the largest change of x, at the same fraction of the duration and relative
to the size of its component, make D; with q the ratio of what the two paths leave out (`truncation_error`), the
estimated error is D / (1 - q).  The error of the cost alone is far smaller, of the order of D².  With phases of free
durations the joints of the two paths are at different fractions, and the paths may jump there: so they are compared at
the same parts of intervals, and what a shift in time does to x is taken off.

Four errors that both degrees share are looked for.  A switch from bound to bound is due where the switching function
∂(ℓ + λ·(F, ρ))/∂u, with forces F and rates ρ, is zero; if the next joint lies elsewhere, there may be no quadrature
point between the two that shows it.  Bounds of positions hold at nodes only: a path that passes one by ε between them
is moved by about √ε.  Those of controls and path constraints hold at quadrature points only: see `unseen_excess`.  And
where nothing depends on time the Hamiltonian is constant: what it varies by, times time over cost, was measured to be
of the order of D where both degrees put a switch at the wrong place.  The error of the cost is at least the square of
each.  Both errors are at least what jumps in time change (`jumps_in_time`).  What the solver leaves of cost and path,
both degrees may share, too: `solver_error` tells.

The new mesh spreads what the finer path has beyond degree m evenly.  Where a higher degree does not help the path has
a kink, and intervals are split as for order 2.  Where a control switches inside an interval its impulse ∫ u dt tells
when, and a joint is put there.  Two more stand beside it, as close as the switch is known: the next path has it between
them, and knows it some ten times better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import TARGET, equidistributed, truncation_error
from casadi_galerkin.calculus.nodes import lagrange_values
from casadi_galerkin.calculus.piecewise_polynomial import times_at
from casadi_galerkin.calculus.roundoff import component_sizes
from casadi_galerkin.control.constraint_violation import NEGLIGIBLE_MOMENTUM
from casadi_galerkin.control.jumps_in_time import jumps_in_time
from casadi_galerkin.control.switching import Switch, switches
from casadi_galerkin.problems.bounds import bound_excess
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.guess import FAR_FROM_GUESS

SLOWEST = 2 / 3  # q where a jump or a constraint at points keeps the higher degree from gaining much
UNSMOOTH_RATIO = 0.25  # an interval whose truncation falls by less with the higher degree is not smooth
KINK_ORDER = 2  # a jump of the acceleration inside a step h moves x by h²
FINEST = 8.0  # parts of one interval at once; a kink needs few levels and leaves few intervals behind
NARROW = 0.25  # of its neighbor is an interval beside a jump
CLOSE = 1 / 3  # of an interval: a joint so near to a jump gives way to it
MARGIN = 3.0  # times what is not known of a switch: joints beside it
AROUND = 0.05  # of sqrt(tol), over the duration: a switch between two joints moves x by the square of their distance
APART = 1e-4  # of the duration: where what is said of a switch differs by less, it has one joint
DISTINCT = 1e-8  # of the duration: nearer switches are one, such as those of two controls at a breakpoint
POSITION_ROUNDOFF = 1e-15  # of positions relative to their size
UNSEEN_RATIO = 0.1  # relative difference of two degrees' excess over a bound, below which no quadrature point sees it


def parts_of(degree: int) -> np.ndarray:
    """Parts of an interval at which paths are compared, its ends among them."""
    return np.linspace(0, 1, 4 * degree + 1)


def position_excess(path: ControlTrajectory) -> np.ndarray:
    """By how much positions leave their bounds between the nodes, relative to the components' sizes; (N,)."""
    low, high = (np.array(side)[:, None, None] for side in path.problem.position_bounds)
    positions = path.polynomial.values_at_parts(parts_of(path.method.degree))
    outside = bound_excess(positions, low, high) / path.sizes[:, None, None]
    return np.asarray(np.max(np.where(outside > POSITION_ROUNDOFF, outside, 0.0), axis=(0, 2)))


def bounded_values(path: ControlTrajectory, parts: np.ndarray) -> np.ndarray:
    """Controls, and then path constraints, at fractions (K,) of every interval; (count, N, K)."""
    controls = path.control.at(parts).reshape(-1, len(path.t) - 1, len(parts))
    return np.concatenate((controls, path.path_constraints(parts)))


def unseen_excess(path: ControlTrajectory, higher: ControlTrajectory) -> np.ndarray:
    """How far two degrees alike let controls and path constraints leave their bounds between the points, (N,).

    Nothing holds the path where no point meets a bound, as next to the end of a path where a control is largest.  Both
    degrees then pass it by ε of the size of what is bounded, and hardly differ on the interval; where a control jumps
    they do.  The path is then moved by at most about ε.
    """
    low, high = path.problem.control_bounds
    if path.problem.path_constraint is not None:
        _, least, most = path.problem.path_constraint
        low, high = low + least, high + most
    both = np.stack([bounded_values(p, parts_of(path.method.degree)) for p in (path, higher)])
    sizes = component_sizes(both[0].reshape(len(low), -1))
    lowest, highest, size = (np.reshape(a, (-1, 1, 1)) for a in (low, high, sizes))
    passed = np.min(bound_excess(both, lowest, highest), axis=0)
    apart, farthest = (np.max(a, axis=-1, keepdims=True) for a in (np.ptp(both, axis=0), passed))
    return np.asarray(np.max(np.where(apart < UNSEEN_RATIO * farthest, passed, 0.0) / size, axis=(0, 2)))


def beyond_degree(path: ControlTrajectory, degree: int) -> np.ndarray:
    """What a path has on each interval that a lower degree has not, relative to the components' sizes; (N,)."""
    nodes = Galerkin(degree).element.nodes
    lower = path.polynomial.values_at_parts(nodes) @ lagrange_values(nodes, parts_of(degree)).T
    change = path.polynomial.values_at_parts(parts_of(degree)) - lower
    return np.asarray(np.max(np.abs(change) / path.sizes[:, None, None], axis=(0, 2)))


def negligible_cost(path: ControlTrajectory) -> float:
    """Cost of forces and rates so small, by `NEGLIGIBLE_MOMENTUM`, that they cannot be told from zero."""
    mechanical = path.problem.mechanical
    states = np.vstack((path.momentum[:mechanical], path.x[mechanical:]))
    return NEGLIGIBLE_MOMENTUM * float(np.max(np.abs(path.costate.values), axis=1) @ np.max(np.abs(states), axis=1))


@dataclass(frozen=True)
class HigherDegree:
    """A path, and the one on its mesh of degree m + 2, which tells how wrong it is.

    Attributes
    ----------
    path, higher : ControlTrajectory
    """

    path: ControlTrajectory
    higher: ControlTrajectory

    @cached_property
    def found(self) -> list[Switch]:
        """Switches of the higher path."""
        return switches(self.higher)

    def of_cost(self, change: float) -> float:
        """A change of the cost relative to it; zero where the cost is not told from zero."""
        both = self.path, self.higher
        cost = max(abs(path.cost) for path in both)
        return change / cost if cost > max(map(negligible_cost, both)) else 0.0

    @cached_property
    def cost_change(self) -> float:
        """Relative change of the cost."""
        return self.of_cost(abs(self.higher.cost - self.path.cost))

    @cached_property
    def change(self) -> float:
        """Relative error of cost, duration and positions, D / (1 - q)."""
        path, higher, parts = self.path, self.higher, parts_of(self.path.method.degree)
        (before, slope), (after, _) = (p.polynomial.at_parts(parts) for p in (path, higher))
        own, other = (times_at((p.t - p.t[0]) / np.ptp(p.t), parts).reshape(-1, len(parts)) for p in (path, higher))
        change = np.abs(after - before - slope * np.ptp(path.t) * (other - own))
        change /= path.sizes[:, None, None]
        coarse, fine = (float(np.max(truncation_error(p.polynomial, path.sizes))) for p in (path, higher))
        at_points = path.problem.path_constraint is not None or len(self.found) > 0
        ratio = SLOWEST if at_points else min(fine / max(coarse, fine, 1e-300), SLOWEST)
        duration = abs(np.ptp(higher.t) / np.ptp(path.t) - 1)
        return float(max(self.cost_change, duration, np.max(change)) / (1 - ratio))

    @cached_property
    def outside(self) -> np.ndarray:
        """Distances by which the path is moved by bounds that it leaves unseen, (N,); √ε where a position does by ε."""
        return np.asarray(np.maximum(np.sqrt(position_excess(self.path)), unseen_excess(self.path, self.higher)))

    @cached_property
    def shared(self) -> float:
        """What both degrees miss alike of the path: distances by which switches are late or bounds move it."""
        late = [abs(s.due - s.joint) / np.ptp(self.higher.t) for s in self.found]
        return float(max(*late, np.max(self.outside), 0.0))

    @cached_property
    def hamiltonian_variation(self) -> float:
        """Variation of the Hamiltonian between breakpoints, where it should be constant, times time over cost."""
        path = self.path
        if not path.problem.autonomous:
            return 0.0
        parts = np.split(path.hamiltonian, np.searchsorted(path.t, path.problem.breakpoints))
        return self.of_cost(float(max(np.ptp(part) for part in parts) * np.ptp(path.t)))

    @cached_property
    def jumps(self) -> np.ndarray:
        """Relative changes of the cost, and of the path, by jumps in time inside of intervals, (N,)."""
        if self.path.problem.autonomous:
            return np.zeros(len(self.path.t) - 1)
        return np.array([self.of_cost(change) for change in jumps_in_time(self.path)])

    def remaining_error(self, path: ControlTrajectory) -> tuple[float, float]:
        """What the solver leaves of the cost and of the path with one of the degrees, relative to these."""
        return self.of_cost(path.unseen_change), path.solver_error

    @property
    def errors(self) -> tuple[float, float]:
        """Errors of the cost, and of all, with what the solver leaves."""
        left, open_by = self.remaining_error(self.path)
        return self.cost_error + left, self.error + max(left, open_by)

    @property
    def error(self) -> float:
        """Relative error of cost, duration and positions."""
        return max(self.change, self.shared, self.cost_error)

    @property
    def cost_error(self) -> float:
        """Relative error of the cost; what both degrees miss of the path changes it in second order.

        The costs of two different paths tell nothing: their distance is the error.
        """
        apart = self.change if self.change > FAR_FROM_GUESS else 0.0
        jumped = float(np.sum(self.jumps))
        return max(self.cost_change / (1 - SLOWEST), self.shared**2, self.hamiltonian_variation**2, apart, jumped)

    def better_mesh(self, tol: float, cost_tol: float) -> np.ndarray:
        """Joints, in the time of the higher path, on which the errors of path and cost should be below tolerances."""
        path, higher = self.path, self.higher
        order, target = path.method.degree + 1, TARGET * tol
        error = beyond_degree(higher, path.method.degree)
        error *= max(self.change - float(np.sum(self.jumps)), 0.0) / max(np.max(error), 1e-300)
        coarse, fine = (truncation_error(p.polynomial, path.sizes) for p in (path, higher))
        kinked = (fine > UNSMOOTH_RATIO * coarse) & (error > target)
        error[kinked] = target * (error[kinked] / target) ** (order / KINK_ORDER)
        first = np.maximum(self.outside / tol, self.jumps / cost_tol) / TARGET  # of the order of a distance
        error = np.maximum(error, target * first**order)
        mesh, error = self.widened(error, target)
        mesh = equidistributed(mesh, error, order, tol, FINEST, breakpoints=higher.problem.breakpoints)
        return self.with_jumps(mesh, tol)

    def widened(self, error: np.ndarray, target: float) -> tuple[np.ndarray, np.ndarray]:
        """Mesh and errors without the narrow intervals around jumps; an interval with a jump need not be split."""
        mesh = self.higher.t
        steps = np.concatenate(([0.0], np.diff(mesh), [0.0]))
        narrow = steps[1:-1] < NARROW * np.maximum(steps[:-2], steps[2:])
        error, drop = error.copy(), np.zeros(len(mesh), dtype=bool)
        for s in self.found:
            times = (s.when, s.joint, s.due)
            first = max(int(np.searchsorted(mesh, min(times))) - 1, 0)
            last = min(int(np.searchsorted(mesh, max(times), side="right")) - 1, len(narrow) - 1)
            while first > 0 and narrow[first]:
                first -= 1
            while last < len(narrow) - 1 and narrow[last]:
                last += 1
            error[first : last + 1] = np.minimum(error[first : last + 1], target)
            drop[first + 1 : last + 1] |= narrow[first:last] | narrow[first + 1 : last + 1]
        keep = np.flatnonzero(~drop | np.isin(mesh, self.higher.problem.breakpoints))
        return mesh[keep], np.maximum.reduceat(error, keep[:-1])

    def with_jumps(self, mesh: np.ndarray, tol: float) -> np.ndarray:
        """Joints at switches, and on either side, as close as the switches are known or have to be.

        The impulse says when they are where the ends fix them, and the switching function only to which place between
        two points of the quadrature.  Where the ends do not, all controls may stay at their bounds on both sides of a
        joint, and the switching function knows better.  So where the two are far apart both have a joint.  A switch as
        near to a breakpoint as the path is known stands there: a joint beside it would be too near.
        """
        jumps: dict[float, float] = {}  # times, and how close to them joints stand
        duration, breakpoints = np.ptp(mesh), self.higher.problem.breakpoints
        closest, known = AROUND * np.sqrt(tol) * duration, max(self.change, TARGET * tol) * duration
        switched = [(s, s.when) for s in self.found]
        switched += [(s, s.due) for s in self.found if abs(s.due - s.when) > APART * duration]
        for s, when in switched:
            when = next((b for b in breakpoints if abs(b - when) < known), when)
            if any(abs(when - other) < DISTINCT * duration for other in jumps):
                continue
            k = int(np.searchsorted(mesh[1:-1], when))
            near = min((k, k + 1), key=lambda j: abs(mesh[j] - when))
            stays = mesh[near] in (mesh[0], *breakpoints, mesh[-1])
            if not stays and abs(mesh[near] - when) < CLOSE * (mesh[k + 1] - mesh[k]):
                mesh = np.delete(mesh, near)
            jumps[when] = max(closest, MARGIN * abs(s.when - s.joint), MARGIN * abs(s.due - s.joint))
        joints = np.unique(np.concatenate((mesh, list(jumps))))
        for when, distance in jumps.items():
            k = int(np.searchsorted(joints, when))
            wide = distance < NARROW * np.diff(joints)[k - 1 : k + 1]
            mesh = np.append(mesh, np.array([when - distance, when + distance])[wide])
        return np.unique(np.concatenate((mesh, list(jumps))))
