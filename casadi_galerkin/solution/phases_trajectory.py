"""The solution of several phases: the path of each, and all of them as one function of time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.numbers import counted, spanned
from casadi_galerkin.calculus.piecewise_polynomial import times_within
from casadi_galerkin.problems.phases import Phases
from casadi_galerkin.solution.control_trajectory import Comparisons, ControlTrajectory
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.export import Columns, Table
from casadi_galerkin.solution.plotting import Pictured, component_names, panels

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PhasesTrajectory(Table, Pictured):
    """An optimal path in several phases: ``path(t)`` is its position, ``path.phases[k]`` the path of phase k.

    At the time at which a phase begins, values are those of this phase; ``path.before(t)`` are those of the phase
    before.  Where phases have different numbers of components, what a phase does not have is NaN.

    Attributes
    ----------
    phases : ControlTrajectory of every phase, with its part of the cost
    problem : Phases with the times and parameters found
    cost : of all phases together, with what joins them
    cost_size, violation, residual, duals, iterations, solver, build_seconds, solve_seconds, method : as those of a
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

    phases: tuple[ControlTrajectory, ...]
    problem: Phases
    cost: float
    cost_size: float
    violation: float
    residual: float
    duals: tuple[np.ndarray, np.ndarray]
    iterations: int
    solver: str
    build_seconds: float
    solve_seconds: float
    method: Galerkin
    find_index: Callable[[], int]
    find_comparisons: Callable[[PhasesTrajectory], Comparisons]
    error_estimate: float | None = None
    cost_error: float | None = None

    @property
    def t(self) -> np.ndarray:
        """Joints of all phases, (N + 1,)."""
        return np.append(np.concatenate([path.t[:-1] for path in self.phases]), self.phases[-1].t[-1])

    @property
    def x(self) -> np.ndarray:
        """Positions at the joints, (d, N + 1)."""
        return self(self.t)

    def __call__(self, t: ArrayLike, nu: int = 0) -> np.ndarray:
        """Positions, or derivatives of order `nu`, at times t; (largest number of components,) + t.shape."""
        return self._evaluated(t, [lambda times, path=path: path(times, nu) for path in self.phases], "right")

    def before(self, t: ArrayLike, nu: int = 0) -> np.ndarray:
        """The same just before times t: at the time at which a phase begins, those of the phase before."""
        return self._evaluated(t, [lambda times, path=path: path.before(times, nu) for path in self.phases], "left")

    def control(self, t: ArrayLike) -> np.ndarray:
        """Controls at times t; (largest number of controls,) + t.shape."""
        return self._evaluated(t, [path.control for path in self.phases], "right")

    def costate(self, t: ArrayLike) -> np.ndarray:
        """Multipliers of the equations of motion and of the rates at times t; shape as of positions."""
        return self._evaluated(t, [path.costate for path in self.phases], "right")

    def _evaluated(self, t: ArrayLike, parts: Sequence[Callable[..., np.ndarray]], side: str) -> np.ndarray:
        begins = [path.t[0] for path in self.phases]
        times = times_within(np.array([begins[0], self.phases[-1].t[-1]]), t)
        flat = times.ravel()
        which = np.clip(np.searchsorted(begins, flat, side=side) - 1, 0, None)  # type: ignore[call-overload]
        values = [part(flat[which == k]) for k, part in enumerate(parts)]
        found = np.full((max(map(len, values)), len(flat)), np.nan)
        for k, value in enumerate(values):
            found[: len(value), which == k] = value
        return found.reshape(len(found), *times.shape)

    def amended(self, **changes: Any) -> PhasesTrajectory:
        """The same path with another report."""
        return replace(self, **changes)

    @property
    def solver_error(self) -> float:
        """As of a ControlTrajectory, the largest of all phases."""
        return max(path.solver_error for path in self.phases)

    @cached_property
    def morse_index(self) -> int | None:
        """As of a ControlTrajectory, of all phases together."""
        return self.find_index()

    def estimate_error(self) -> float:
        """Estimate the relative errors of x and of the cost, as for a ControlTrajectory; the largest of all phases."""
        if self.error_estimate is None:
            try:
                cost, path = self.find_comparisons(self).errors
            except ConvergenceError:
                cost, path = math.inf, math.inf
            self.__dict__.update(cost_error=cost, error_estimate=path)  # the class is frozen
        assert self.error_estimate is not None
        return self.error_estimate

    def table(self) -> Columns:
        """The tables of the phases one after the other, with the number of the phase; what a phase has not is NaN."""
        tables = [path.table() for path in self.phases]
        missing = [np.full(len(columns["t"]), np.nan) for columns in tables]
        names, columns = dict.fromkeys(name for each in tables for name in each), dict[str, np.ndarray]()
        columns["phase"] = np.repeat(np.arange(len(tables)), [*map(len, missing)])
        for name in names:
            parts = [each.get(name, none) for each, none in zip(tables, missing, strict=True)]
            columns[name] = np.concatenate(parts)
        return columns

    def plot(self, labels: Sequence[str] | None = None, time: str = "t") -> Axes:
        """Draw positions and controls of all phases, with gray lines between them; returns the axes of the positions.

        Parameters
        ----------
        labels : names of the positions with units, as many as there are in the phase with the most
        time : name of the time with its unit
        """
        top, bottom = panels(2, sharex=True)
        names = component_names("x", len(self.x), labels)
        for path in self.phases:
            for axes in (top, bottom):
                axes.set_prop_cycle(None)
            times, values = path.polynomial.line(path.fine_times)
            for name, value in zip(names, values, strict=False):
                top.plot(times, value, label=name)
            bottom.plot(times, path.control(times).T)
        for axes in (top, bottom):
            for path in self.phases[1:]:
                axes.axvline(path.t[0], color="0.6", linewidth=0.8)
        handles, shown = top.get_legend_handles_labels()
        named = dict(zip(shown, handles, strict=True))
        top.legend(named.values(), named.keys())
        bottom.set(xlabel=time, ylabel="u")
        top.set_title(f"{counted(len(self.phases), 'phase')}: cost {self.cost:.6g}")
        return top

    def __repr__(self) -> str:
        """Summarize the whole and every phase in a few lines."""
        count, intervals = counted(len(self.phases), "phase"), counted(len(self.t) - 1, "interval")
        known = [(self.cost_error, "of the cost"), (self.error_estimate, "of the path")]
        errors = ", ".join(f"{error:.1e} {whose}" for error, whose in known if error is not None)
        kind = "a local minimum" if self.morse_index == 0 else f"Morse index {self.morse_index}"
        lines = [
            f"PhasesTrajectory of {count} on {spanned(self.t)}, {intervals}",
            f"  method      {self.method}",
            f"  cost        {self.cost:.12g}, {kind}",
            *([f"  error       {errors}, estimated"] if errors else []),
        ]
        for k, path in enumerate(self.phases):
            size, n = counted(len(path.x), "component"), counted(len(path.control.values), "control")
            lines.append(f"  phase {k}     {size} and {n} on {spanned(path.t)}, cost {path.cost:.9g}")
            lines += [f"  {line.lstrip()} in phase {k}" for line in path._accuracy()]
        return "\n".join(
            [
                *lines,
                f"  solver      {self.solver}, {counted(self.iterations, 'iteration')}, violation {self.violation:.1e}",
                f"  seconds     {self.build_seconds:.4f} to build, {self.solve_seconds:.4f} to solve",
            ]
        )
