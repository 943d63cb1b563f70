"""The answer of a trajectory optimization: the path with its controls, costate and Hamiltonian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.lazy import lazy
from casadi_galerkin.calculus.nodes import lagrange_values
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, times_at
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.calculus.roundoff import component_sizes
from casadi_galerkin.problems.callables import with_parameters
from casadi_galerkin.problems.constrained_motion import constrained_motion
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.solution.control_path import ControlPath
from casadi_galerkin.solution.export import by_component
from casadi_galerkin.solution.plotting import SIZE, panels, plot_controls, plot_path
from casadi_galerkin.solution.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CONTINUOUS = 1e-8  # of the largest control: what the solver leaves between two values that should agree
SHOWN_OVERSHOOT = 1e-3  # of the bounds' width; less is no reason for another mesh


@dataclass(frozen=True, kw_only=True, repr=False)
class ControlTrajectory(Trajectory):
    """An optimal path of a controlled system: a `Trajectory` with more to it.

    Attributes
    ----------
    problem : ControlProblem
    cost : value of the discrete cost, a local minimum: paths that differ much from this one may cost less
    control : callable, ``control(t)`` -> (number of controls,) + t.shape
    costate : multipliers λ of the equations of motion, and of the rates, as a path: ``costate(t)`` -> (d,) + t.shape.
        The cost of a small extra force (or rate) δF(t) is ∫ λ·δF dt to first order
    duals : (equations,) and (unknowns,), Lagrange multipliers of the discrete equations and of the bounds: with this
        trajectory as its guess, a solve with the same method on the same intervals starts warm
    hamiltonian : (N,), mean of I - v·∂I/∂v - dλ/dt·∂I/∂(dλ/dt) over each interval, where
        I = ℓ + λ·(∂L/∂x + F) + dλ/dt·∂L/∂v; of order 2m.  The same on all intervals where nothing depends on t, but for
        waypoints and jumps at given times; zero as well where the duration is free, was found strictly inside
        `duration_bounds`, and no terminal cost depends on t.  With `hold` neither is so on an interval, but the mean
        over a phase of free duration is that
    violation : largest violation of an equation or bound, relative to the sizes of the terms it compares; at most 1e-8
    residual : the same in units of the relative precision of a double, 2.2e-16; at most 4.5e7
    start_velocity, end_velocity : (d,), the velocities given or found at the ends; of a component that follows a rate,
        the derivative of its polynomial
    arrival_velocity : (K, mechanical), the velocities before jumps, and at waypoints that are functions

    At the time of a jump ``path(t)``, `x`, `momentum` and `velocity` are those after it; ``path.before(t)`` is the
    position before.  The costate jumps as well, there and at waypoints: ``costate(t)`` and ``costate.before(t)``.

    `action` is that of the Lagrangian alone, `morse_index` is None, and `parameters` are the optimized ones.

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> move = cg.ControlProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0], [0.0], [0.0],
    ...     force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u**2 / 2, controls=1)
    >>> path = cg.solve(move, cg.Galerkin(degree=3), intervals=4)
    >>> round(path.cost, 6), path.control([0.0, 1.0]).round(6).tolist()
    (6.0, [[6.0, -6.0]])
    >>> start = {"position": path.x[:, 0], "velocity": path.start_velocity}
    >>> again = cg.InitialProblem(move.lagrangian, move.t_span, force=path.replay(), **start)
    >>> cg.solve(again, path.method, mesh=path.t).x[0, -1].round(9).tolist()
    1.0
    """

    problem: ControlProblem
    cost: float
    control: ControlPath
    costate: PiecewisePolynomial
    duals: tuple[np.ndarray, np.ndarray]
    hamiltonian: np.ndarray
    violation: float
    start_velocity: np.ndarray
    end_velocity: np.ndarray
    arrival_velocity: np.ndarray

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
            raise ValueError(f"an InitialProblem has no jumps, as the path at t = {self.problem.jumps[0][0]:.6g}")
        self._refuse_two_values()
        d = len(self.x)
        symbols = [ca.SX.sym("t"), ca.SX.sym("x", d), ca.SX.sym("v", d)]
        given = [] if self.parameters is None else [ca.SX.sym("p", len(self.parameters))]
        force = self.problem.force(*symbols, self.control.expression(symbols[0]), *given)
        names = ["t", "x", "v", "p"][: 3 + len(given)]
        return ca.Function("force", [*symbols, *given], [ca.densify(force)], names, ["value"])

    def _refuse_two_values(self) -> None:
        """Raise a ValueError where the two controls at a joint differ."""
        ends, u = np.array([0.0, 1.0]), self.control
        if not np.array_equal(u.points[[0, -1]], ends):
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

    @lazy
    def dynamics_defect(self) -> np.ndarray:
        """How far the equations of motion are missed between the points, one number per interval; (N,).

        The largest |∂L/∂v(x̄, dx̄/dt) - p̂| at r + 2 Gauss points, over the largest momentum (or impulse) on the path,
        with p̂ the joint's momentum plus the impulse ∫ (∂L/∂x + F) dt since then.  Where a component follows a rate, its
        value and its rate take the places of momentum and force.  Of order m.
        """
        inner = gauss(len(self.method.quadrature) + 2)
        s, steps = np.array(inner.points), np.diff(self.t)
        times = times_at(self.t, s)
        momentum, rate = self._motion(times)
        # ∫_0^{s_j} of the polynomial through the Gauss points, exact by the same rule scaled to [0, s_j]
        primitive = np.stack([a * (np.array(inner.weights) @ lagrange_values(s, a * s)) for a in s])
        shape = (len(self.x), len(steps), len(s))
        impulse = np.einsum("din,jn,i->dij", rate.reshape(shape), primitive, steps)
        mechanical = self.problem.mechanical
        at_joints = np.vstack((self.momentum[:mechanical], self.x[mechanical:]))
        defect = np.abs(momentum.reshape(shape) - at_joints[:, :-1, None] - impulse).max(axis=2)
        size = np.abs(at_joints).max(axis=1) + np.abs(impulse).max(axis=(1, 2))
        return np.asarray((defect / np.where(size > 0, size, 1.0)[:, None]).max(axis=0))

    @lazy
    def control_overshoot(self) -> np.ndarray:
        """Largest excess of the controls over their bounds between the points, over the bounds' width; (N,).

        It is large where a control jumps inside an interval (bang-bang) and asks for a joint at the jump; the summary
        shows it where it is.
        """
        low, high = (np.array(side)[:, None] for side in self.problem.control_bounds)
        width = np.where(np.isfinite(high - low) & (high > low), high - low, 1.0)
        u = self.control.at(np.linspace(0.0, 1.0, 4 * len(self.method.quadrature) + 1))
        excess = np.maximum(np.maximum(low - u, u - high), 0.0) / width
        return np.asarray(excess.max(axis=0).reshape(len(self.t) - 1, -1).max(axis=1))

    def _motion(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """∂L/∂v and ∂L/∂x + F along the path, and what follows rates with these; (d, K) each."""
        problem = self.problem
        d, n = problem.dimension, problem.controls
        symbols = [ca.SX.sym("t"), ca.SX.sym("x", d), ca.SX.sym("v", d)]
        u = ca.SX.sym("u", n)
        lagrangian, parts = self._lagrangian(*symbols), [0, problem.mechanical, d]
        force, own = (with_parameters(f, self.parameters)(*symbols, u) for f in (problem.force, problem.rates))
        work, momentum = (ca.vertsplit(ca.gradient(lagrangian, by), parts)[0] for by in symbols[1:3])
        rate = ca.vertcat(work + force, own)
        momentum = ca.vertcat(momentum, ca.vertsplit(symbols[1], parts)[1])
        outputs = [ca.densify(momentum), ca.densify(rate)]
        motion = ca.Function("motion", [*symbols, u], outputs).map(len(times))
        values = motion(times[None, :], self(times), self(times, 1), self.control(times))
        if problem.constraint is None:
            return np.array(values[0]), np.array(values[1])
        held = with_parameters(problem.constraint, self.parameters)(*symbols[:2])
        push = ca.SX.sym("push", held.numel())
        impulse = ca.mtimes(ca.jacobian(held, symbols[1]).T, push)
        pushed = ca.Function("pushed", [*symbols[:2], push], [ca.densify(impulse)]).map(len(times))
        return np.array(values[0]), np.array(values[1] + pushed(times[None, :], self(times), self.multipliers(times)))

    def _constrained_motion(self) -> ca.Function | None:
        """What the multipliers are found from, with the forces that the controls give."""
        if self.problem.constraint is None:
            return None
        held, force = (with_parameters(f, self.parameters) for f in (self.problem.constraint, self.replay()))
        return constrained_motion(self._lagrangian, held, force)

    def table(self) -> dict[str, np.ndarray]:
        """What a Trajectory has, controls and costate at the joints, after a jump there, by name."""
        return {
            **super().table(),
            **by_component("control", self.control(self.t)),
            **by_component("costate", self.costate(self.t)),
        }

    def plot(
        self,
        axes: Axes | None = None,
        labels: Sequence[str] | None = None,
        time: str = "t",
        control_labels: Sequence[str] | None = None,
        costate_labels: Sequence[str] | None = None,
    ) -> Axes:
        """Draw positions, controls with their bounds, and the costate, one above the other.

        Parameters
        ----------
        axes : Matplotlib axes for the positions; controls and costate are then left out
        labels : d names of the positions with units
        time : name of the time with its unit
        control_labels : n names of the controls with units
        costate_labels : d names of the costate with units: those of the cost over those of the momenta

        Returns
        -------
        the Matplotlib axes of the positions
        """
        if axes is not None:
            return super().plot(axes, labels, time)
        top: Axes
        top, middle, bottom = panels(3, size=(SIZE[0], 1.6 * SIZE[1]), sharex=True)
        super().plot(top, labels, time)
        self.plot_controls(middle, control_labels, "")
        line, at_joints = self.costate.line(self._fine()), self.costate(self.t)
        plot_path(*line, self.t, at_joints, bottom, costate_labels, time, "λ")
        top.set_xlabel("")
        top.set_title(f"Degree {self.method.degree} on {len(self.t) - 1} intervals: cost {self.cost:.6g}")
        return top

    def plot_controls(self, axes: Axes | None = None, labels: Sequence[str] | None = None, time: str = "t") -> Axes:
        """Draw the controls with their bounds; returns the Matplotlib axes.

        Parameters
        ----------
        axes : Matplotlib axes to draw into; default a new figure
        labels : n names of the controls with units
        time : name of the time with its unit
        """
        parts, steps = np.linspace(0.0, 1.0, 40), np.diff(self.t)[:, None]
        times = np.append(self.t[:-1, None] + steps * parts, np.full_like(steps, np.nan), axis=1).ravel()
        lines = np.full((len(self.control.values), len(times)), np.nan)
        lines[:, np.isfinite(times)] = self.control.at(parts)
        limits = np.array(self.problem.control_bounds)
        drawn = plot_controls(times, lines, self.control.times, self.control.values, limits, axes, labels)
        drawn.set_xlabel(time)
        return drawn

    def __repr__(self) -> str:
        """Summarize path and solve in a few lines."""
        size, n = len(self.x), len(self.control.values)
        return "\n".join(
            [
                f"ControlTrajectory of {size} component{'s' if size > 1 else ''} and {n} control{'s' if n > 1 else ''} "
                f"on [{self.t[0]:g}, {self.t[-1]:g}], {len(self.t) - 1} intervals",
                f"  method      {self.method}",
                f"  cost        {self.cost:.12g}",
                f"  Hamiltonian {self.hamiltonian[0]:.9g} at the start, varies by {np.ptp(self.hamiltonian):.1e}",
                *self._between_points(),
                f"  solver      {self.solver}, {self.iterations} iterations, violation {self.violation:.1e}",
                f"  seconds     {self.build_seconds:.4f} to build, {self.solve_seconds:.4f} to solve",
            ]
        )

    def _between_points(self) -> list[str]:
        """Lines on what the points do not see: the defect, and an overshoot of the controls if there is one."""
        lines = [f"  defect      {self._worst(self.dynamics_defect)}, of the largest momentum"]
        if np.max(self.control_overshoot) > SHOWN_OVERSHOOT:
            lines.append(f"  overshoot   {self._worst(self.control_overshoot)}, of the bounds' width")
        return lines

    def _worst(self, values: np.ndarray) -> str:
        """Largest of one value per interval, and where."""
        i = int(np.argmax(values))
        return f"{values[i]:.1e} between the points of [{self.t[i]:.4g}, {self.t[i + 1]:.4g}]"
