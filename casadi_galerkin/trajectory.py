"""The answer: a path that can be evaluated everywhere, with its momenta, energy and the report of the solve."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus import Galerkin
from casadi_galerkin.legendre import legendre_transform, velocities
from casadi_galerkin.plotting import FRAMES_A_SECOND, animate_linkage, plot_path, plot_phase
from casadi_galerkin.polynomial import PiecewisePolynomial
from casadi_galerkin.problems import Problem
from casadi_galerkin.tracing import with_parameters

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes


class ConvergenceError(RuntimeError):
    """A solve that did not end in a verified answer.

    Attributes
    ----------
    path : PiecewisePolynomial, the best iterate, not a solution; None if there is none
    residual : float, its largest residual over that residual's roundoff floor; of an optimisation its largest violation
        over the relative precision of a double
    iterations : int
    """

    def __init__(
        self, message: str, path: PiecewisePolynomial | None = None, residual: float = np.nan, iterations: int = 0
    ) -> None:
        super().__init__(message)
        self.path, self.residual, self.iterations = path, residual, iterations


class ConjugatePointError(ConvergenceError):
    """The Hessian of the action is singular: the ends are conjugate, or a family of paths joins them."""


def _no_index() -> None:
    """Steps have none."""


@dataclass(frozen=True)
class Trajectory:
    """A critical point of the discrete action.

    Attributes
    ----------
    t : (N + 1,), joints
    x : (d, N + 1), positions at the joints
    momentum : (d, N + 1), by the discrete Legendre transform p_0 = -∂S/∂x_0, ..., p_N = ∂S/∂x_N; of order min(2m, u)
    path : callable, ``path(t)`` -> (d,) + t.shape, ``path(t, 1)`` its derivative
    action : value of the discrete action
    iterations : of the solver
    residual : largest residual over its own roundoff floor
    solver : what found it
    build_seconds, solve_seconds : spent on building the graph and on the solve
    method : Galerkin
    problem : what was solved, with the ends, parameters and times that it was solved for
    error_estimate : estimated relative error of the path between the joints; only with a tolerance
    count_negative : finds `morse_index`
    """

    t: np.ndarray
    x: np.ndarray
    momentum: np.ndarray
    path: PiecewisePolynomial
    action: float
    iterations: int
    residual: float
    solver: str
    build_seconds: float
    solve_seconds: float
    method: Galerkin
    problem: Problem
    error_estimate: float | None = None
    count_negative: Callable[[], int | None] = field(default=_no_index, repr=False)

    @cached_property
    def morse_index(self) -> int | None:
        """Number of negative eigenvalues of the action's Hessian, 0 for a local minimum; found when first asked for.

        None for steps, and where ∂²L/∂v² is not positive at every joint, so that no finer mesh has a finite index.
        """
        return self.count_negative()

    @property
    def lagrangian(self) -> ca.Function:
        """L(t, x, v[, p]) as a CasADi Function of one point."""
        return self.problem.lagrangian

    @property
    def parameters(self) -> tuple[float, ...] | None:
        """Values of the Lagrangian's parameters p."""
        return self.problem.parameters

    @cached_property
    def velocity(self) -> np.ndarray:
        """Velocities at the joints that belong to the momenta, p = ∂L/∂v; (d, N + 1), of order min(2m, u).

        NaN where none was found.  The derivative of the polynomial itself, ``path(t, 1)``, is of order m only.
        """
        transform = legendre_transform(with_parameters(self.lagrangian, self.parameters))
        return velocities(transform, self.t, self.x, self.momentum, self.path(self.t, 1))

    @cached_property
    def energy(self) -> np.ndarray:
        """Energy p·v - L at the joints, from positions and momenta; (N + 1,)."""
        joints = range(len(self.t))
        given = [] if self.parameters is None else [ca.DM(self.parameters)]
        mapped = self.lagrangian.map(len(joints))
        repeated = [ca.repmat(values, 1, len(joints)) for values in given]
        lagrangian = np.array(mapped(self.t[None, :], self.x, self.velocity, *repeated)).ravel()
        return np.asarray(np.sum(self.momentum * self.velocity, axis=0) - lagrangian)

    def plot(self, axes: Axes | None = None, labels: Sequence[str] | None = None, time: str = "t") -> Axes:
        """Draw the components over time, joints as dots; returns the Matplotlib axes.

        Parameters
        ----------
        axes : Matplotlib axes to draw into; default a new figure
        labels : d names with units, such as "angle in rad"
        time : name of the time with its unit
        """
        times = self._fine()
        drawn = plot_path(times, self.path(times), self.t, self.x, axes, labels, time)
        if axes is None:
            index = "" if self.morse_index is None else f", Morse index {self.morse_index}"
            intervals = len(self.t) - 1
            drawn.set_title(f"Degree {self.method.degree} on {intervals} intervals: action {self.action:.6g}{index}")
        return drawn

    def plot_phase(self, component: int = 0, axes: Axes | None = None, labels: tuple[str, str] | None = None) -> Axes:
        """Draw one component against its momentum, the start as a larger dot; returns the Matplotlib axes.

        Dots are the momenta of the discrete Legendre transform; between them the line is ∂L/∂v along the polynomial,
        which is of order m only and may jump at the joints of a coarse mesh.

        Parameters
        ----------
        component : which, from 0 to d - 1
        axes : Matplotlib axes to draw into, so that several paths make one portrait; default a new figure
        labels : names of position and momentum with units
        """
        if not 0 <= component < len(self.x):
            raise ValueError(f"component must be from 0 to {len(self.x) - 1}, got {component!r}")
        times = self._fine()
        x, p = self.path(times)[component], self._slope(times)[component]
        names = (f"x[{component}]", f"p[{component}]") if labels is None else labels
        return plot_phase(x, p, self.x[component], self.momentum[component], names, axes)

    def animate(
        self,
        points: Callable[[np.ndarray], ArrayLike],
        axes: Axes | None = None,
        seconds: float | None = None,
        unit: str = "",
    ) -> FuncAnimation:
        """Move a planar mechanism along the path; returns Matplotlib's FuncAnimation, to show or to save.

        Parameters
        ----------
        points : x (d, K) -> (n, 2, K), places in the plane of the n ends of a chain of bars, fixed ones included
        axes : Matplotlib axes to draw into, labelled by their owner; default a new figure
        seconds : how long it runs; default the duration of the path, taken as seconds
        unit : of the time shown in the title
        """
        duration = float(self.t[-1] - self.t[0]) if seconds is None else seconds
        count = max(2, round(FRAMES_A_SECOND * duration))
        times = np.linspace(self.t[0], self.t[-1], count)
        places = np.asarray(points(self.path(times)), dtype=float)
        if places.ndim != 3 or places.shape[1:] != (2, count):
            raise ValueError(f"points must return an array of shape (n, 2, {count}), got {places.shape}")
        return animate_linkage(times, places, duration / count, axes, unit)

    def _fine(self) -> np.ndarray:
        """Times that make a smooth line; all joints among them."""
        per_interval = max(2, 200 // (len(self.t) - 1))
        parts = np.linspace(0, 1, per_interval, endpoint=False)
        return np.append((self.t[:-1, None] + np.diff(self.t)[:, None] * parts).ravel(), self.t[-1])

    def _slope(self, times: np.ndarray) -> np.ndarray:
        """∂L/∂v along the polynomial, (d, K)."""
        symbols = self.lagrangian.sx_in()
        slope = ca.Function("slope", symbols, [ca.densify(ca.gradient(self.lagrangian(*symbols), symbols[2]))])
        given = [] if self.parameters is None else [np.tile(np.array(self.parameters)[:, None], (1, len(times)))]
        return np.array(slope.map(len(times))(times[None, :], self.path(times), self.path(times, 1), *given))

    def __str__(self) -> str:
        """Summarise path and solve in a few lines."""
        size, energy = len(self.x), self.energy
        saddle = "no Morse index" if self.morse_index is None else f"a saddle of Morse index {self.morse_index}"
        kind = "a local minimum" if self.morse_index == 0 else saddle
        return "\n".join(
            [
                f"Trajectory of {size} component{'s' if size > 1 else ''} on [{self.t[0]:g}, {self.t[-1]:g}], "
                f"{len(self.t) - 1} intervals",
                f"  method      {self.method}",
                f"  action      {self.action:.15g}, {kind}",
                f"  energy      {energy[0]:.12g} at the start, varies by {np.ptp(energy):.1e}",
                f"  solver      {self.solver}, {self.iterations} iterations, residual {self.residual:.1g} of its "
                "roundoff floor",
                f"  seconds     {self.build_seconds:.4f} to build, {self.solve_seconds:.4f} to solve",
            ]
        )
