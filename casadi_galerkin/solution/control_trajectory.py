"""The solution of a trajectory optimization: the path with its controls, costate and Hamiltonian."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.numbers import counted
from casadi_galerkin.calculus.roundoff import TINY, component_sizes
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.statements import FEASIBLE
from casadi_galerkin.solution.export import Columns, by_component
from casadi_galerkin.solution.optimal_path import OptimalPath
from casadi_galerkin.solution.trajectory import UNRESOLVED, Lines, Trajectory
from casadi_galerkin.solution.violations_between_points import BetweenPoints

# what counts as none of the cost, by which optima that differ by `UNRESOLVED` differ, and of the largest component
NEGLIGIBLE = UNRESOLVED * UNRESOLVED
STEP = (
    "a callable steps, as x or v pass some value or at a given time while durations or parameters are free, and no "
    "derivative shows it: smooth the step, or state what is before and behind it as phases"
)


@dataclass(frozen=True)
class RemainingError:
    """Estimated distance of the point where a solver stopped from the optimum.

    Attributes
    ----------
    components : (d,), error of each component of the path
    durations : largest relative error of a free duration
    cost : error of the cost
    """

    components: np.ndarray
    durations: float
    cost: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class ControlTrajectory(OptimalPath, Trajectory):
    """An optimal path of a controlled system: a `Trajectory` with its controls, costs and multipliers.

    Attributes
    ----------
    problem : ControlProblem
    cost : value of the discrete cost; stationary, and a minimum among paths near by where `morse_index` is 0
    cost_size : what errors of the cost are relative to: its size or, where that is smaller, 1e-6 of half of
        ∫ |δ|ᵀ|∇²ℓ||δ| dt with the distances δ of (x, v, u) from their means, as where a path follows a curve exactly
    cost_error : estimated relative error of the cost, zero where the cost is only roundoff; None before
        `estimate_error`
    control : callable, ``control(t)`` -> (number of controls,) + t.shape
    costate : multipliers λ of the equations of motion, and of the rates, as a path: ``costate(t)`` -> (d,) + t.shape.
        The cost of a small extra force δF(t), or rate, which keeps the momenta, is ∫ λ·δF dt to first order
    path_multipliers : callable like `control`, of the path constraints, or None where there is none: positive where an
        upper bound acts, negative where a lower one does.  Raising the bounds by δ(t), but not at a free end, changes
        the cost by -∫ μ·δ dt
    hamiltonian : (N,), mean of I - v·∂(I + μ·g)/∂v - dλ/dt·∂I/∂(dλ/dt) over each interval, where
        I = ℓ + λ·(∂L/∂x + F, ρ) + dλ/dt·(∂L/∂v, z) with components z that follow the rates ρ, and μ are the
        multipliers of the path constraints g; of order 2m.  The same on all intervals where nothing depends on t, no
        waypoint or jump has a given time, and no phase a duration at its bounds; zero as well where the duration is
        free, was found strictly inside `duration_bounds`, and no terminal cost depends on t.  With `hold` neither is
        true of single intervals, but the second is of the mean over a phase of free duration
    violation : largest violation of an equation or bound, relative to the sizes of the terms it compares; at most 1e-8
    residual : the same in units of the relative precision of a double, 2.2e-16; at most 4.5e7
    start_velocity, end_velocity : (d,), the velocities given or found at the ends; of a component that follows a rate,
        the derivative of its polynomial
    phases : the path of every phase into which jumps, waypoints that are functions, and breakpoints whose times are
        free part the problem; the `end_velocity` of one is the velocity before the jump

    At the time of a jump ``path(t)``, `x`, `momentum` and `velocity` are those after it; ``path.before(t)`` is the
    position before.  The costate jumps as well, there and at waypoints: ``costate(t)`` and ``costate.before(t)``.

    `morse_index` is the number of independent directions, among those that keep the equations and the bounds that are
    met, in which the cost decreases to second order, by more than 1e-6 of it for moves as large as the path.  From a
    guess as symmetric as the problem it may be above 0; it is None where rounding hides it.

    `action` is that of the Lagrangian alone, and `parameters` are the optimized ones.

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> move = cg.ControlProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0], [0.0], [0.0],
    ...     force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u**2 / 2, controls=1)
    >>> path = cg.solve(move, cg.Galerkin(degree=3), intervals=4)
    >>> round(path.cost, 6), path.control([0.0, 1.0]).round(6).tolist()
    (6.0, [[6.0, -6.0]])
    >>> start = {"start": path.x[:, 0], "velocity": path.start_velocity}
    >>> again = cg.InitialProblem(move.lagrangian, move.t_span, force=path.replay(), **start)
    >>> cg.solve(again, path.method, mesh=path.t).x[0, -1].round(9).tolist()
    1.0
    """

    problem: ControlProblem
    hamiltonian: np.ndarray
    start_velocity: np.ndarray
    end_velocity: np.ndarray

    @cached_property
    def _remaining_error(self) -> RemainingError:
        """The remaining solver errors."""
        return self.variations.remaining_error(self.number)

    @property
    def unseen_change(self) -> float:
        """Change of the cost, to first order, by the next Newton steps from the point where the solver stopped."""
        return self._remaining_error.cost

    @cached_property
    def solver_error(self) -> float:
        """Relative error of x and of free durations that the solver has left, from the next Newton steps.

        Computed when first used.  It is large where the cost hardly depends on the path.
        """
        return max(float(np.max(self._remaining_error.components / self.sizes)), self._remaining_error.durations)

    @cached_property
    def sizes(self) -> np.ndarray:
        """Sizes of the components, to which errors are relative, (d,): their largest values; one where these are zero.

        They are one as well for a component that should be zero and is only an error of the solver.
        """
        sizes = self.polynomial.sizes
        large = sizes >= NEGLIGIBLE * np.max(sizes)
        if np.all(large):
            return sizes
        return np.where(large | (sizes > self._remaining_error.components), sizes, 1.0)

    def table(self, times: ArrayLike | None = None) -> Columns:
        """The columns of a Trajectory, and controls and costate, after a jump there, by name."""
        columns = super().table(times)
        return {
            **columns,
            **by_component("control", self.control(columns["t"])),
            **by_component("costate", self.costate(columns["t"])),
        }

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
        u = self.control
        values = u.at(np.array([0.0, 1.0])).reshape(len(u.values), -1, 2)
        jumps = np.abs(values[:, 1:, 0] - values[:, :-1, 1])
        relative = jumps / component_sizes(u.values)[:, None]
        if u.rule[0] == 0 and u.rule[-1] == 1 and np.any(relative > FEASIBLE):
            k, i = np.unravel_index(np.argmax(relative), jumps.shape)
            raise ValueError(
                f"the control u[{k}] jumps by {jumps[k, i]:.3g} at the joint t = {self.t[i + 1]:.6g}, where "
                f"{self.method} has a point on both sides: no force of time alone has both values. Solve with a rule "
                "without points at both ends, such as gauss or radau, to replay it"
            )
        return self._force()

    def _force(self) -> ca.Function:
        """The force of the optimized controls."""
        t, x, v, *p = symbols = self.problem.lagrangian.sx_in()
        force = self.problem.force(t, x, v, self.control.expression(t), *p)
        return ca.Function("force", symbols, [ca.densify(force)], ["t", "x", "v", "p"][: len(symbols)], ["value"])

    @cached_property
    def between_points(self) -> BetweenPoints:
        """What equations and bounds miss between the quadrature points, where the solver does not see it."""
        return BetweenPoints(self, self.problem, self.control, self.costate, self.path_multipliers)

    @property
    def dynamics_defect(self) -> np.ndarray:
        """Largest relative residual of the equations of motion between the points, for each interval; (N,).

        The largest |∂L/∂v(x̄, dx̄/dt) - p̂| at r + 2 Gauss points, over the largest momentum (or impulse) on the path,
        with p̂ the joint's momentum plus the impulse ∫ (∂L/∂x + F) dt since then.  Where a component follows a rate, its
        value and its rate take the places of momentum and force.  Of order m.
        """
        return self.between_points.dynamics_defect

    @property
    def control_misfit(self) -> np.ndarray:
        """Error of the impulse over each interval if the controls are taken as functions of time; (N,).

        The difference of ∫ (∂L/∂x + F) dt along `control(t)` to its quadrature, which sees the controls at the points
        only, over the largest momentum plus the sum of all impulses.  Where a component follows a rate, its value and
        its rate take the places of momentum and force.  A path that is flown with these controls misses by about the
        sum of all intervals, times the growth of an error along it.  It is of the order of the method, but large where
        controls turn over between the points, as an angle does that is limited to one turn.
        """
        return self.between_points.control_misfit

    @property
    def constraint_excess(self) -> np.ndarray:
        """Largest excess of path constraints and positions over their bounds between the points; (N,).

        That of positions is relative to their sizes, that of a path constraint to its change where the path changes by
        its size.  So both are about the part of its size by which the path is off, at most one.
        """
        return self.between_points.constraint_excess

    def _size(self) -> str:
        controls = len(self.control.values)
        return super()._size() + (f" and {counted(controls, 'control')}" if controls else "")

    def _lines(self) -> Lines:
        """What the summary says of the path."""
        if len(self.control.values) or self.problem.costs:
            if self.morse_index and not self._not_optimal:
                directions = counted(self.morse_index, "direction")
                tried = "" if "starts" in self.solver else ", several `starts`"
                yield "SADDLE", f"no minimum: the cost decreases in {directions}; try a guess beside it{tried}"
            yield "cost", f"{self.cost:.12g}, {self._kind()}"
            where = " between breakpoints" if self.problem.breakpoints else ""
            varies = f"varies by {self._hamiltonian_change:.1e}{where}"
            yield "Hamiltonian", f"{self.hamiltonian[0]:.9g} at the start, {varies}"
        what = "momentum" if self.problem.mechanical else "value"
        yield "defect", f"{self._worst(self.dynamics_defect)}, of the largest {what}"
        if np.max(self.constraint_excess) > FEASIBLE:  # solvers leave as much
            yield "excess", f"{self._worst(self.constraint_excess)}, of the path's size"

    def _worst(self, values: np.ndarray) -> str:
        """Largest of one value per interval, and its interval."""
        i = int(np.argmax(values))
        return f"{values[i]:.1e} between the points of [{self.t[i]:.4g}, {self.t[i + 1]:.4g}]"

    @property
    def _hamiltonian_change(self) -> float:
        """The largest variation of the Hamiltonian between two breakpoints."""
        sections = np.split(self.hamiltonian, np.searchsorted(self.t, self.problem.breakpoints))
        return float(max(map(np.ptp, sections)))

    @property
    def _not_optimal(self) -> bool:
        """Whether further Newton steps would change the cost by more than a solver should leave."""
        return self.unseen_change > NEGLIGIBLE * self.cost_size

    def _kind(self) -> str:
        """The kind of critical point, in words; none where the solver has stopped before one."""
        if not self._not_optimal:
            return super()._kind()
        return "not yet optimal" if self.cost_error is None else "optimal but for the error below"

    def _doubts(self) -> Lines:
        """What the solver leaves of cost or path, what the mesh does not show between its points, and what varies."""
        if self._not_optimal:
            words = f"the cost may still change by {self.unseen_change:.1e}; the solver's tolerances are absolute"
            yield "NOT DETERMINED:", words
        if self.solver_error > UNRESOLVED:
            words = f"is {self.solver_error:.0e} of its size; the cost hardly depends on it"
            yield "NOT DETERMINED:", f"the remaining solver error of x {words}"
        between, finer = self.between_points, "take more intervals, or give tol"
        size, when = between.largest_step
        if size * np.ptp(self.t) > NEGLIGIBLE * self.cost_size:
            yield "NOT RESOLVED:", f"at t = {when:.6g} {STEP}"
        yield from self._unresolved()
        costs = max(self.cost_size, between.cost_of_forces, TINY)  # with what forces cost
        for values, words in (
            (
                between.jump_effects / costs,
                "a callable jumps, by up to {:.0e} of the cost {}; name its time in breakpoints",
            ),
            (self.constraint_excess, f"bounds are exceeded by {{:.0e}} of the path {{}}; {finer}"),
            (self.control_misfit, f"`control(t)` misses the motion by {{:.0e}} {{}}; {finer}"),
        ):
            yield from self._above(values, UNRESOLVED, words)
        fraction = self._hamiltonian_change * np.ptp(self.t) / costs
        constant = self.problem.autonomous and not self.problem.hold  # held controls are optimal in the mean only
        # the cost of an optimum is stationary: its error is of second order in this; without costs it is rounding alone
        if constant and fraction**2 > UNRESOLVED and self.problem.costs:
            words = f"varies by {fraction:.0e} of the cost; take more intervals"
            yield "NOT RESOLVED:", f"the Hamiltonian, which should be constant, {words}"

    @property
    def _truncation_error(self) -> np.ndarray:
        """Truncation error, or the defect of the equations of motion between the points where that is smaller."""
        return np.minimum(super()._truncation_error, self.dynamics_defect)
