"""Global against stepwise: the same equations solved at once, stepped from the start, and by shooting.

Both formulations have the same solution; what parts them is how they magnify rounding.  Two condition numbers say so,
in the same units: the relative change of the path, in the largest component and at the worst joint, for relative
changes 1 of the data, each component measured by its largest size along the path, X_c for positions, P_c for momenta:

    global     κ = max_{c, i}  Σ_j |∂x_c(t_i) / ∂e_j| X_j / X_c           data e: the positions given at the ends
    stepwise   κ = max_{c, i}  Σ_j |∂x_c(t_i) / ∂x_0j| X_j / X_c + |∂x_c(t_i) / ∂p_0j| P_j / X_c     data (x_0, p_0).

The first comes from the Hessian of the action, δX̄ = -(∇²S_ff)⁻¹ ∇²S_fe δe, the second from the product of the steps'
Jacobians, both along the global path.  For a given energy the global joints move with the data.  A saddle over a
horizon T has κ near 1 globally and e^{λT} stepwise; κ times 1e-16 is what either can keep.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin._solve import solve
from casadi_galerkin.boundary.sensitivity import at_joints
from casadi_galerkin.calculus.galerkin import Galerkin, check_method
from casadi_galerkin.calculus.numbers import counted, spanned
from casadi_galerkin.calculus.roundoff import EPS, ZERO, component_sizes
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.problem import check_kind
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.export import Table
from casadi_galerkin.solution.plotting import COLORS, Pictured, axes_or_new
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.stepping.geometry import jacobians
from casadi_galerkin.stepping.initial_value import started
from casadi_galerkin.stepping.shooting import check_start, shoot
from casadi_galerkin.stepping.shooting_residual import accumulated

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LARGE_GAP = 0.1  # relative gap from which its growth is no longer that of a small one
ROUNDING_GAP = 1000 * EPS  # relative gap up to which it may be the sum of rounding errors, without growth


@dataclass(frozen=True, eq=False)
class Attempt:
    """One way to the path, whether it got there or not.

    Attributes
    ----------
    path : Trajectory, or None if it failed
    failure : why, or None; `gap` is then that of the last path, if there was one
    gap : (N + 1,), largest difference of a component from the global path over that component's largest size, at
        the joints; not a number where there is no path
    iterations : of Newton's method
    seconds : building included
    """

    path: Trajectory | None
    failure: str | None
    gap: np.ndarray
    iterations: int
    seconds: float


@dataclass(frozen=True, repr=False, eq=False)
class Comparison(Table, Pictured):
    """A boundary problem solved globally and stepwise.

    Attributes
    ----------
    global_path : Trajectory
    stepped : Attempt, the steps from the global path's own (x_0, p_0)
    shooting : Attempt, the boundary problem solved by `shoot`; a gap as large as the path is that of another path
    gap_growth : rate λ of the gap of `stepped`, fitted to e^{λ t} at the joints where the gap lies between roundoff and
        0.1; not a number if these are fewer than three
    condition_global, condition_stepwise : how many times a formulation magnifies a relative change of its data: of the
        positions given at the ends globally, not a number where none is; of (x_0, p_0) step by step.  The module
        `casadi_galerkin.studies.comparison` has the formulas

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> balance = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + x[0] ** 2 / 2, (0, 40), start=[1.0], end=[1.0])
    >>> compared = cg.compare(balance, cg.Galerkin(degree=4), intervals=80)
    >>> round(compared.gap_growth, 1), compared.shooting.path is None
    (1.0, True)
    """

    global_path: Trajectory
    stepped: Attempt
    shooting: Attempt
    gap_growth: float
    condition_global: float
    condition_stepwise: float

    @property
    def parting_time(self) -> float:
        """First joint at which `stepped` is a tenth of the path's size away, or has failed; inf if there is none."""
        together = np.count_nonzero(_together(self.stepped.gap))
        return float(self.global_path.t[together]) if together < len(self.global_path.t) else np.inf

    def table(self) -> dict[str, np.ndarray]:
        """The gaps of both stepwise ways at the joints, by name."""
        return {"t": self.global_path.t, "stepped": self.stepped.gap, "shooting": self.shooting.gap}

    def __repr__(self) -> str:
        """Table of the three ways."""
        path = self.global_path
        rows = [("global", path.iterations, path.build_seconds + path.solve_seconds, "", self.condition_global)]
        for name, way in self._ways.items():
            gap = "failed" if way.path is None else f"{np.max(way.gap):.1e}"
            rows.append((name, way.iterations, way.seconds, gap, self.condition_stepwise))
        return "\n".join(
            [
                f"Comparison on {spanned(path.t)}, {counted(len(path.t) - 1, 'interval')}, {path.method}",
                f"  {'':22} iterations    seconds  largest gap  condition",
                *("  {:22}{:11d} {:10.4f}  {:>11}  {:9.1e}".format(*row) for row in rows),
                f"  the gap of the steps {self._growth()}",
                *(f"  {way.failure}" for way in self._ways.values() if way.failure),
            ]
        )

    @property
    def _ways(self) -> dict[str, Attempt]:
        return {"steps from its start": self.stepped, "shooting": self.shooting}

    def _growth(self) -> str:
        """What the gap of the steps does."""
        if np.isfinite(self.gap_growth):
            return f"grows like exp({self.gap_growth:.3g} t)"
        if np.all(self.stepped.gap <= ROUNDING_GAP):
            return "stays at roundoff"
        return "is between roundoff and a tenth at too few joints to tell how it grows"

    def plot(self, axes: Axes | None = None, time: str = "t") -> Axes:
        """Draw the gaps over time, logarithmic, without those that are zero or too large; returns the Matplotlib axes.

        Parameters
        ----------
        axes : Matplotlib axes to draw into; default a new figure
        time : name of the time with its unit, such as "t in s"
        """
        axes = axes_or_new(axes)
        for color, (name, way) in zip(COLORS, self._ways.items(), strict=False):
            shown = (way.gap > 0) & (way.gap < 1 / ZERO)
            if np.any(shown):
                label = name + (" (failed)" if way.path is None else "")
                axes.plot(self.global_path.t[shown], way.gap[shown], ".-", markersize=3, color=color, label=label)
        axes.set(yscale="log", xlabel=time, ylabel="relative gap to the global path")
        if axes.lines:
            axes.legend(fontsize="small")
        return axes


def compare(
    problem: BoundaryProblem,
    method: Galerkin | None = None,
    intervals: int | None = None,
    *,
    tol: float | None = None,
    mesh: ArrayLike | None = None,
    guess: Trajectory | None = None,
) -> Comparison:
    """Solve a boundary problem globally and stepwise, and measure how far the two come apart.

    Parameters
    ----------
    problem : BoundaryProblem; of given energy the steps from the global start have the duration that was found
    method : Galerkin, default degree 8
    intervals : number of equal intervals; or
    mesh : (N + 1,) joints from t_span[0] to t_span[1]; or
    tol : relative tolerance of the global path, whose degree and mesh all three then have
    guess : Trajectory from which both start; default the straight line between the ends.  Of given energy shooting
        starts with its duration, too, but the global solve with that of `t_span`

    Returns
    -------
    Comparison, which prints as a table and has a ``plot``

    Raises
    ------
    TypeError
        for what is no BoundaryProblem
    ValueError
        for input that does not fit
    ConvergenceError
        if the global solve fails; failures of the stepwise ways are part of the answer

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> balance = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + x[0] ** 2 / 2, (0, 40), start=[1.0], end=[1.0])
    >>> compared = cg.compare(balance, cg.Galerkin(degree=4), intervals=80)
    >>> compared.condition_global < 2, compared.condition_stepwise > 1e16
    (True, True)
    """
    check_kind(problem, BoundaryProblem)
    check_method(method, optional=True)
    check_start(problem, guess)
    if method is None and tol is None:
        method = Galerkin(8)
    path = solve(problem, method, intervals, tol=tol, mesh=mesh, guess=guess)
    method, solved = path.method, path.problem
    assert isinstance(solved, BoundaryProblem)

    def steps() -> Trajectory:
        """The steps from the start of the global path, which may have no mass there."""
        return solve(started(path, problem.force), method, mesh=path.t)

    joints = path.t if problem.energy is None else np.interp(path.t, path.t[[0, -1]], problem.t_span)
    stepped = _attempt(path, steps)
    shooting = _attempt(path, lambda: shoot(problem, method, mesh=joints, guess=guess))
    return Comparison(
        path,
        stepped,
        shooting,
        _growth_rate(path.t, stepped.gap),
        _condition_global(solved, path),
        _condition_stepwise(path),
    )


def _attempt(path: Trajectory, way: Callable[[], Trajectory]) -> Attempt:
    """Try one way and measure how far it ends up from the global path."""
    began, gap = time.perf_counter(), np.full(len(path.t), np.nan)
    try:
        found = way()
        answer, failure, iterations, x = found, None, found.iterations, found.x
    except (ConvergenceError, ValueError) as error:  # a ValueError where the mass is singular at the start
        left = getattr(error, "path", None)
        answer, failure, iterations = None, str(error), getattr(error, "iterations", 0)
        x = np.empty((len(path.x), 0)) if left is None else left.x
    seconds = time.perf_counter() - began
    count = x.shape[1]
    gap[:count] = np.max(np.abs(x - path.x[:, :count]) / component_sizes(path.x)[:, None], axis=0)
    return Attempt(answer, failure, gap, iterations, seconds)


def _together(gap: np.ndarray) -> np.ndarray:
    """Whether a joint lies before the first one with a gap above `LARGE_GAP`, or without a number; (N + 1,)."""
    return np.logical_and.accumulate(gap <= LARGE_GAP)


def _growth_rate(t: np.ndarray, gap: np.ndarray) -> float:
    """Slope of log(gap) between roundoff and parting."""
    small = (gap > ROUNDING_GAP) & _together(gap)
    return float(np.polyfit(t[small], np.log(gap[small]), 1)[0]) if np.count_nonzero(small) > 2 else np.nan


def _condition_stepwise(path: Trajectory) -> float:
    """κ of the map from (x_0, p_0) to the joints."""
    growth = accumulated(jacobians(path, path.problem))[:, : len(path.x)]
    positions, momenta = component_sizes(path.x), component_sizes(path.momentum)
    with np.errstate(over="ignore"):
        return float(np.max(np.abs(growth) @ np.concatenate((positions, momenta)) / positions))


def _condition_global(problem: BoundaryProblem, path: Trajectory) -> float:
    """κ of the map from the positions given at the ends to the joints."""
    sizes = component_sizes(path.x)
    start, end = ([i for i, value in enumerate(side) if value is not None] for side in (problem.start, problem.end))
    if not (start or end):
        return np.nan
    by = at_joints(problem, path).x
    moved = sum(np.abs(by[name]) @ sizes[given] for name, given in (("start", start), ("end", end)) if given)
    return float(np.max(moved / sizes[:, None]))
