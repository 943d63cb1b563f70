"""The error of an optimal path, and its next mesh, by comparison with optimal paths of two degrees more.

The first has the same mesh; if it differs by more than the tolerance, the path is refused, and nothing more is needed.
The second has an interlaced mesh: every joint gives way to two, at parts of the shorter interval beside it that differ
(`JOINT_BEFORE`, `JOINT_AFTER`), so that no point of the new intervals is where the joint was.  Wherever a control
switches or meets a bound, a constraint is touched or a callable jumps, the three paths see it at different places
between different points, and differ by about the error of the first.  Joints that have to stay, at the ends and at
breakpoints, get another one close by, at `BESIDE_FIXED` of the interval: what happens beside them is seen by no other
point.  An interval beside much shorter ones would hardly differ, and is halved.  The errors are `SAFETY` times the
larger differences of x, of the durations and of the cost.  Where all three may be wrong in the same way, the errors are
at least what else is known of it (`errors`).

The better mesh makes the part of the better path that degree m leaves out equally large on all intervals.  It is
known from its last Legendre coefficients, and scaled to the error.  Where the coefficients do not fall, something
bends inside, and the interval is split as for a method of order 2: so meshes are graded towards the place.  Where a
control switches between two points, the next mesh has joints at both: the interval of the switch shrinks by the
distance of points from level to level, and its error by the square of that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import FEWEST, legendre_coefficients, parts_wanted, spread_over
from casadi_galerkin.calculus.piecewise_polynomial import sampling_parts, times_at
from casadi_galerkin.calculus.quadrature import gauss, lobatto
from casadi_galerkin.calculus.roundoff import EPS, TINY
from casadi_galerkin.control.optimizer import ACCEPTABLE, FIRST_BARRIER
from casadi_galerkin.problems.problem import map_times, section_times
from casadi_galerkin.problems.statements import AT_BOUND
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.guess import FAR_FROM_GUESS
from casadi_galerkin.solution.optimal_path import PhasesTrajectory
from casadi_galerkin.solvers.solver import Solver, ipopt, sqp

DEGREES_ADDED = 2  # degrees added; one adds nothing to a path of the other parity
SAFETY = ControlTrajectory.comparison_factor
JOINT_BEFORE, JOINT_AFTER = 0.31, 0.23  # distances of new joints from an old one, over the shorter interval beside it
BESIDE_FIXED = 0.05  # the same for an old joint that stays
UNSMOOTH_DECAY = 0.25  # ratio of the last two Legendre coefficients to the two before from which a path is not smooth
KINK_ORDER = 2  # of the error where it is not: a jump of the acceleration inside a step h changes x by the order of h²
MOST_PARTS = 4.0  # parts that an interval becomes at once, and intervals that become one
# First barrier of IPOPT from an earlier path: with the first barrier itself a robot arm left its path, and found none.
NEAR_BARRIER = FIRST_BARRIER**2
# Ratio of IPOPT's tolerance to a barrier: from an earlier path the first one is hardly used.  The last barrier keeps
# values off bounds to which little pushes them, such as controls on the short intervals beside a switch: with IPOPT's
# own 10, the mass of a rocket was known to 3e-7 only.
BARRIER_RATIO = 1 / NEAR_BARRIER


def raised(method: Galerkin) -> Galerkin:
    """The method with `DEGREES_ADDED` and as many points more: Lobatto's where this has one at 0, else Gauss's."""
    rule = lobatto if method.quadrature.points[0] == 0 else gauss
    return Galerkin(method.degree + DEGREES_ADDED, quadrature=rule(len(method.quadrature) + DEGREES_ADDED))


def from_near(solver: Solver, path: ControlTrajectory) -> Solver:
    """The solver from an earlier path, with other options where it has none of its own.

    IPOPT's tolerances are absolute: a small cost is measured in its own size.
    """
    solver = ipopt if solver.name == sqp.name else solver  # which needs the same mesh
    options = {"mu_init": NEAR_BARRIER, "barrier_tol_factor": BARRIER_RATIO}
    if solver.name == ipopt.name and 0 < path.cost_size < 1:
        options["obj_scaling_factor"] = 1 / path.cost_size
    return replace(solver, options={**options, **solver.options})


def interlaced(mesh: np.ndarray, breakpoints: tuple[float, ...]) -> np.ndarray:
    """The mesh with two joints in place of each, one more on either side of those that stay, and long rests halved."""
    steps, stays = np.diff(mesh), np.isin(mesh, [mesh[0], *breakpoints, mesh[-1]])
    shorter = np.minimum(np.append(np.inf, steps), np.append(steps, np.inf))
    before = mesh[1:] - np.where(stays[1:], BESIDE_FIXED * steps, JOINT_BEFORE * shorter[1:])
    after = mesh[:-1] + np.where(stays[:-1], BESIDE_FIXED * steps, JOINT_AFTER * shorter[:-1])
    longer = before - after > (1 - JOINT_AFTER) * steps  # than between equal intervals
    return np.sort(np.concatenate((mesh[stays], before, after, (before + after)[longer] / 2)))


@dataclass(frozen=True)
class TwoComparisons:
    """A path, two others of higher degree, and what they differ by.

    Attributes
    ----------
    path : of degree m
    finer : of degree m + 2, on the same mesh and, where that has not refused the path, on the interlaced one
    """

    path: ControlTrajectory
    finer: tuple[ControlTrajectory, ...]

    @property
    def better(self) -> ControlTrajectory:
        """The last of them."""
        return self.finer[-1]

    @cached_property
    def errors(self) -> tuple[float, float]:
        """Relative errors of the cost, and of all: of cost, durations and x.

        Both are at least what positions exceed their bounds by between the points, the effect of jumps in time, and the
        rounding of times; a step that no derivative shows is an error of the path.  The remaining solver error is
        added.
        """
        of_cost = self.of_cost(self.path.unseen_change)
        of_path = max(of_cost, self.path.solver_error)
        return (
            max(self.cost_error, self._common_error, self.step_in_place**2) + of_cost,
            max(self.change, self.common_error) + of_path,
        )

    @property
    def common_error(self) -> float:
        """Relative error that all three paths may have in common, with that of a step that no derivative shows.

        It is that of a flight with `control(t)` as well.
        """
        between = self.path.between_points
        excess = float(np.max(between.constraint_excess))
        return max(self._common_error, self.step_in_place, between.flight_error, excess)

    @cached_property
    def _common_error(self) -> float:
        path, between = self.path, self.path.between_points
        rounding = 0.0 if path.problem.autonomous else EPS * np.max(np.abs(path.t)) / np.ptp(path.t)
        of_cost = self.of_cost(np.sum(between.jump_effects)), self.of_cost(abs(np.sum(between.missed_costs)))
        return float(max(np.max(between.common_excess), *of_cost, rounding))

    @cached_property
    def step_in_place(self) -> float:
        """Largest step of the integrand that no derivative shows, times duration over cost."""
        return self.of_cost(self.path.between_points.largest_step[0] * np.ptp(self.path.t))

    @property
    def step_time(self) -> float:
        """When it is."""
        return self.path.between_points.largest_step[1]

    def of_cost(self, change: float) -> float:
        """A change of the cost relative to its size; zero where the costs cannot be told from zero."""
        paths = self.path, *self.finer
        of_forces = max(p.between_points.cost_of_forces for p in paths)
        if max(abs(p.cost) for p in paths) <= ACCEPTABLE * of_forces:
            return 0.0
        return float(change / max(p.cost_size for p in paths))

    @cached_property
    def cost_error(self) -> float:
        """Relative error of the cost, or of the path where paths are far apart, whose costs may agree by chance."""
        change = SAFETY * self.of_cost(max(abs(p.cost - self.path.cost) for p in self.finer))
        return max(change, self.distance) if self.distance > FAR_FROM_GUESS else change

    @property
    def change(self) -> float:
        """Relative error of cost, durations and x by the two comparisons alone."""
        return max(self.cost_error, self.distance)

    @cached_property
    def distance(self) -> float:
        """Relative error of durations, and of x at the same fractions of phases."""
        return SAFETY * max(_distance(self.path, other) for other in self.finer)

    def mesh(self, tol: float, goal: float, least: float) -> np.ndarray:
        """Joints in the time of the better path with which x should be known to `tol`.

        Its intervals become at least `least` parts each, but where a switch is between two joints.  What else is known
        to be missed is brought to `goal`, the tolerance of a quantity or of x itself; bounds are kept between the
        points, for a quantity where the multipliers do not tell of them.
        """
        mesh, degree = self.better.t, self.path.method.degree
        between = (self.path if len(self.finer) == 1 else self.better).between_points  # on that mesh
        errors, smooth = beyond_degree(self.better)
        errors *= self.change / max(np.max(errors), TINY)
        parts = parts_wanted(errors, np.where(smooth, degree + 1, KINK_ORDER), tol)
        excess, of_cost = between.common_excess if goal < tol else between.constraint_excess, self.of_cost(1.0)
        for missed, order, allowed in (
            (excess, KINK_ORDER, goal),
            (between.control_misfit, KINK_ORDER, tol),
            (of_cost * np.abs(between.missed_costs), KINK_ORDER, goal),
            (of_cost * between.jump_effects, 1, goal),
        ):
            parts = np.maximum(parts, parts_wanted(missed, order, allowed))
        beside = switches(self.better)
        for before, after in beside:
            inside = slice(np.searchsorted(mesh, before, "right") - 1, np.searchsorted(mesh, after))
            parts[inside] = np.minimum(parts[inside], 1.0)
        fixed = tuple(np.unique([*self.better.problem.breakpoints, *beside.ravel()]).tolist())
        cumulated = np.append(0.0, np.cumsum(np.clip(parts, least, MOST_PARTS)))
        counts = np.diff(np.interp([mesh[0], *fixed, mesh[-1]], mesh, cumulated))
        return spread_over(mesh, cumulated, max(FEWEST, int(np.ceil(counts).sum())), fixed)


def _largest(name: str) -> Any:
    """The largest value of an attribute in all phases."""
    return property(lambda self: max(getattr(one, name) for one in self._each))


@dataclass(frozen=True)
class PhasesComparisons:
    """The same of all phases of a path: errors are the largest of a phase, and the cost is that of the whole."""

    path: PhasesTrajectory
    finer: tuple[PhasesTrajectory, ...]
    change, step_in_place, common_error = map(_largest, ("change", "step_in_place", "common_error"))

    @cached_property
    def _each(self) -> list[TwoComparisons]:
        with_cost = [[replace(phase, cost=path.cost) for phase in path.phases] for path in (self.path, *self.finer)]
        return [TwoComparisons(path, tuple(finer)) for path, *finer in zip(*with_cost, strict=True)]

    @property
    def better(self) -> PhasesTrajectory:
        """The last path of higher degree."""
        return self.finer[-1]

    @property
    def errors(self) -> tuple[float, float]:
        """The largest relative errors of the cost, and of all."""
        costs, others = zip(*(one.errors for one in self._each), strict=True)
        return max(costs), max(others)

    @property
    def step_time(self) -> float:
        """When it is."""
        return max(self._each, key=lambda one: one.step_in_place).step_time

    def of_cost(self, change: float) -> float:
        """A change of the cost relative to its size."""
        return max(one.of_cost(change) for one in self._each)

    def mesh(self, tol: float, goal: float, least: float) -> np.ndarray:
        """Joints of all phases, with which x should be known to `tol`."""
        meshes = [one.mesh(tol, goal, least) for one in self._each]
        return np.append(np.concatenate([mesh[:-1] for mesh in meshes]), meshes[-1][-1])


def compared(path: Any, solve: Callable[[Galerkin, np.ndarray], Any]) -> Iterator[Any]:
    """Compare a path, or phases, with what `solve` finds with a method on a mesh: with one path, and then with two."""
    method, compare = raised(path.method), TwoComparisons if isinstance(path, ControlTrajectory) else PhasesComparisons
    same = solve(method, path.t)
    yield compare(path, (same,))
    mesh = path.t if path.problem.hold else interlaced(path.t, path.problem.breakpoints)  # held controls have one
    yield compare(path, (same, solve(method, mesh)))


def switches(path: ControlTrajectory) -> np.ndarray:
    """Times of the points between which a control comes to one of its bounds or leaves it, (K, 2).

    Between the bounds the first value may be a mean of those before and after a switch.  Where it does so from point to
    point, as on singular arcs, nothing is known of when; nor are joints needed beside a breakpoint.
    """
    low, high = (np.array(side)[:, None] for side in path.problem.control_bounds)
    u, times, marks = path.control.values, path.control.times, section_times(path.problem)
    slack = AT_BOUND * np.max(np.abs(u), axis=1, keepdims=True, initial=0.0)
    side = (u >= high - slack).astype(int) - (u <= low + slack)
    found = list[np.ndarray]()
    for at in side:
        changes = np.flatnonzero(np.diff(at))
        for run in np.split(changes, np.flatnonzero(np.diff(changes) > 1) + 1):
            if 0 < len(run) <= 2:
                first, last = run[0], run[-1] + 1
                first, last = first - (at[first] == 0), last + (at[last] == 0)
                found.append(times[[max(first, 0), min(last, len(times) - 1)]])
    beside = np.reshape(found, (-1, 2))
    wide = np.ptp(beside, axis=1) > np.sqrt(EPS) * np.ptp(path.t)
    return beside[wide & (np.diff(np.searchsorted(marks, beside), axis=1)[:, 0] == 0)]


def _distance(path: ControlTrajectory, other: ControlTrajectory) -> float:
    """Largest relative difference of durations, and of x at the same fractions of phases."""
    marks, others = section_times(path.problem), section_times(other.problem)
    inside = sampling_parts(path.method.degree)[1:-1]  # at joints paths may jump
    largest = float(np.max(np.abs(np.diff(marks) - np.diff(others)))) / np.ptp(marks)
    for one, two, own, its in ((path, other, marks, others), (other, path, others, marks)):
        times = times_at(one.t, inside)
        change = np.abs(two(map_times(times, own, its)) - one(times)) / path.sizes[:, None]
        largest = max(largest, float(np.max(change)))
    return largest


def beyond_degree(path: ControlTrajectory) -> tuple[np.ndarray, np.ndarray]:
    """The part beyond degree m of a path of degree m + 2 on each interval, and if it is smooth there; (N,) each.

    It is relative to the sizes of the components.
    """
    coefficients = np.abs(legendre_coefficients(path.polynomial, path.sizes))
    last, before = (np.max(coefficients[:, :, [k, k + 1]], axis=2) for k in (-2, -4))
    worst = np.argmax(last, axis=0), np.arange(last.shape[1])
    return last[worst], (last < UNSMOOTH_DECAY * before)[worst]
