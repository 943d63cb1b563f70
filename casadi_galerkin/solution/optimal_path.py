"""The answers of optimizations: what all have in common, their errors and pictures, and that of several phases."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.numbers import counted, spanned
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, times_at, times_within
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.phases import Phases
from casadi_galerkin.solution.control_path import ControlPath, side_by_side
from casadi_galerkin.solution.export import Columns
from casadi_galerkin.solution.path import of_parts
from casadi_galerkin.solution.plotting import COLORS, panels, plot_path
from casadi_galerkin.solution.quantity import Quantity
from casadi_galerkin.solution.trajectory import Answer, Lines

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ALONG = np.linspace(0.0, 1.0, 40)  # fractions of an interval at which a line is drawn


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class OptimalPath(Answer):
    """A path with controls, costs and multipliers: what the answers of all optimizations have.

    Attributes
    ----------
    cost, cost_size, cost_error, control, costate, path_multipliers, violation : as of a `ControlTrajectory`
    parts : the paths of the phases, if there are several
    number : of this phase, if it is one of several
    """

    comparison_factor: ClassVar = 2.0  # on 44 paths with bends, touches and switches no error was above twice these
    _left: ClassVar = "violation {0.violation:.1e}"

    cost: float
    cost_size: float
    control: ControlPath
    costate: PiecewisePolynomial
    violation: float
    path_multipliers: ControlPath | None = None
    cost_error: float | None = None
    parts: tuple[Any, ...] = ()
    number: int | None = None

    def estimate_error(self) -> float:
        """Estimate the relative error of x, and that of the cost; kept as `error_estimate` and `cost_error`.

        The path is compared with two of a higher degree, on the same mesh and on an interlaced one: the errors are
        twice the larger differences, and at least what positions exceed their bounds by between the points, and the
        remaining solver error.  They are infinite where one of the two is not found.  With `hold` they are those of the
        motion under controls that are held on these intervals.
        """
        if self.error_estimate is None:
            cost, path = self._comparisons.errors
            self.__dict__.update(cost_error=cost, error_estimate=path)  # the class is frozen
        assert self.error_estimate is not None
        return self.error_estimate

    def _known(self, of: Quantity) -> tuple[np.ndarray, np.ndarray, float]:
        """A quantity, its error and its size; those of the cost are known beside the two comparisons."""
        value, change, size = super()._known(of)
        if value.shape or value != self.cost:
            return value, change, size
        self.estimate_error()
        assert self.cost_error is not None
        return value, np.array(self.cost_error * self.cost_size), self.cost_size

    @property
    def phases(self) -> tuple[Any, ...]:
        """The paths of the phases into which the problem is parted, or this one alone."""
        return self.parts or (self,)

    def path_constraints(self, parts: np.ndarray) -> np.ndarray:
        """Values of the path constraints at fractions (K,) of every interval, joints included; (k, N, K)."""
        return side_by_side([phase.between_points.path_constraints(parts) for phase in self.phases])

    def _arrays(self) -> dict[str, np.ndarray]:
        """What `load` makes path and controls of."""
        return super()._arrays() | of_parts(
            "control", vars(self.control), ("mesh", "points", "values", "rule", "bounds")
        )

    def plot(
        self,
        axes: Axes | None = None,
        labels: Sequence[str] | None = None,
        time: str = "t",
        control_labels: Sequence[str] | None = None,
        costate_labels: Sequence[str] | None = None,
    ) -> Axes:
        """Draw positions, controls, path constraints and the costate, one above the other.

        Bounds are dashed lines, and breakpoints, such as the times at which phases begin, gray ones.

        Parameters
        ----------
        axes : Matplotlib axes for the positions; all else is then left out
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
        controlled, limited = bool(len(self.control.values)), self.path_multipliers is not None
        drawn = panels(2 + controlled + limited, sharex=True)
        top = super().plot(drawn[0], labels, "")
        self._draw_bounds(top, lambda problem: problem.position_bounds)
        if controlled:
            self.plot_controls(drawn[1], control_labels, "")
        if limited:
            self.plot_constraints(drawn[-2], time="")
        line, at_joints = self.costate.line(self.fine_times), (self.t, self.costate(self.t))
        plot_path(line, at_joints, drawn[-1], costate_labels, time, "λ")
        for panel, when in product(drawn, self.problem.breakpoints):
            panel.axvline(when, color="0.6", linewidth=0.8)
        top.set_title(self._title())
        return top

    def plot_controls(self, axes: Axes | None = None, labels: Sequence[str] | None = None, time: str = "t") -> Axes:
        """Draw the controls with their bounds; returns the Matplotlib axes.

        Parameters
        ----------
        axes : Matplotlib axes to draw into; default a new figure
        labels : n names of the controls with units
        time : name of the time with its unit

        Raises
        ------
        ValueError
            where there are no controls
        """
        if not len(self.control.values):
            raise ValueError("there are no controls to draw")
        points = self.control.times, self.control.values
        drawn = plot_path(self._broken(self.control.at(ALONG)), points, axes, labels, time, "u")
        self._draw_bounds(drawn, lambda problem: problem.control_bounds)
        return drawn

    def plot_constraints(self, axes: Axes | None = None, labels: Sequence[str] | None = None, time: str = "t") -> Axes:
        """Draw the path constraints with their bounds, and their multipliers dotted; returns the Matplotlib axes.

        Parameters
        ----------
        axes : Matplotlib axes to draw into; default a new figure
        labels : names of the path constraints with units
        time : name of the time with its unit

        Raises
        ------
        ValueError
            where there is no path constraint
        """
        if self.path_multipliers is None:
            raise ValueError("there is no path constraint to draw")
        times, values = self.path_multipliers.times, self.path_constraints(self.path_multipliers.points)
        line, points = self._broken(self.path_constraints(ALONG)), (times, values.reshape(len(values), -1))
        drawn = plot_path(line, points, axes, labels, time, "g")
        self._draw_bounds(drawn, lambda problem: problem.limits[1:])
        right = drawn.twinx()
        for i, multiplier in enumerate(self.path_multipliers.values):
            right.plot(times, multiplier, ":", color=COLORS[i % len(COLORS)])
        right.set_ylabel("multiplier μ")
        right.grid(False)
        return drawn

    def _draw_bounds(self, axes: Axes, of: Callable[[ControlProblem], Any]) -> None:
        """Add the bounds that the problem of each phase states as dashed lines, in the colors of what they are for."""
        for phase in self.phases:
            for i, bound in ((i, bound) for side in of(phase.problem) for i, bound in enumerate(side)):
                if np.isfinite(bound):
                    color = COLORS[i % len(COLORS)]
                    axes.plot(phase.t[[0, -1]], [bound, bound], "--", color=color, linewidth=0.8)

    def _broken(self, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Times (K,) and values (n, K) of lines at `ALONG`, broken at the joints, where they may jump."""
        times = times_at(self.t, ALONG).reshape(-1, len(ALONG))
        values = lines.reshape(len(lines), *times.shape)
        parted = [np.append(a, np.full_like(a[..., :1], np.nan), axis=-1) for a in (times, values)]
        return parted[0].ravel(), parted[1].reshape(len(lines), -1)

    def _title(self) -> str:
        return f"Degree {self.method.degree} on {counted(len(self.t) - 1, 'interval')}: cost {self.cost:.6g}"

    def _errors(self) -> str:
        """The known errors of cost and path; none of a cost that is zero."""
        known = [(self.cost_error, "of the cost"), (self.error_estimate, "of the path")]
        return ", ".join(f"{error:.1e} {whose}" for error, whose in known if error)


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PhasesTrajectory(OptimalPath):
    """An optimal path in several phases: ``path(t)`` is its position, ``path.phases[k]`` the path of phase k.

    At the time at which a phase begins, values are those of this phase; ``path.before(t)`` are those of the phase
    before.  Where phases have different numbers of components, what a phase does not have is NaN.

    Attributes
    ----------
    phases : ControlTrajectory of every phase, with its part of the cost
    problem : Phases with the times and parameters found
    cost : of all phases together, with what joins them
    cost_size, violation, residual, iterations, solver, build_seconds, solve_seconds, method : as those of a
        ControlTrajectory, of the whole
    error_estimate, cost_error : as there; None before `estimate_error`

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> def moving(span, start, end):
    ...     return cg.ControlProblem(lambda t, x, v: v[0] ** 2 / 2, span, start, end, components=1,
    ...         force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u**2 / 2, controls=1)
    >>> wall = cg.Phases([moving((0, 1), 1.0, 0.0), moving((1, 2), None, 2.0)], links=[lambda x, v: (x, -v)])
    >>> path = cg.solve(wall, cg.Galerkin(degree=3), intervals=2)
    >>> path.before(1.0, 1).round(9).tolist(), path(1.0, 1).round(9).tolist()
    ([-1.5], [1.5])
    >>> [round(phase.cost, 9) for phase in path.phases], path.estimate_error() < 1e-10
    ([0.375, 0.375], True)
    """

    problem: Phases

    @property
    def unseen_change(self) -> float:
        """As of a ControlTrajectory."""
        return self.phases[0].unseen_change

    @property
    def solver_error(self) -> float:
        """As of a ControlTrajectory, the largest of all phases."""
        return max(path.solver_error for path in self.phases)

    def table(self, times: ArrayLike | None = None) -> Columns:
        """The tables of the phases one after the other, with the number of the phase; what a phase has not is NaN.

        Parameters
        ----------
        times : (K,), values at the time at which a phase begins are those of this phase; default `fine_times` of every
            phase, so that both sides of what parts them are there
        """
        given = [path.fine_times for path in self.phases]
        if times is not None:
            asked = np.atleast_1d(times_within(self.t, times)).ravel()
            which = np.searchsorted([path.t[0] for path in self.phases[1:]], asked, side="right")
            given = [asked[which == k] for k in range(len(self.phases))]
        tables = [{"phase": np.array(k), **self.phases[k].table(own)} for k, own in enumerate(given) if len(own)]
        columns = dict.fromkeys(name for each in tables for name in each)
        return {
            name: np.concatenate([np.broadcast_to(each.get(name, np.nan), each["t"].shape) for each in tables])
            for name in columns
        }

    def _size(self) -> str:
        return counted(len(self.phases), "phase")

    def _lines(self) -> Lines:
        """What the summary says of the whole and of every phase."""
        yield "cost", f"{self.cost:.12g}, {self._kind()}"
        for k, path in enumerate(self.phases):
            yield f"phase {k}", f"{path._size()} on {spanned(path.t)}, cost {path.cost:.9g}"

    def _doubts(self) -> Lines:
        """Those of the phases."""
        return ((name, f"{words} in phase {k}") for k, path in enumerate(self.phases) for name, words in path._doubts())
