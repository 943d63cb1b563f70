"""Global against stepwise: the same equations solved at once, stepped from the start, and by shooting.

Both formulations have the same solution; what parts them is how they magnify rounding.  Two condition numbers say so,
in the same units: the relative change of the path, in the largest component and at the worst joint, for relative
changes 1 of the data, each component measured by its largest size along the path, X_c for positions, P_c for momenta:

    global     κ = max_{c, i}  Σ_j |∂x_c(t_i) / ∂e_j| X_j / X_c           data e: the positions given at the ends
    stepwise   κ = max_{c, i}  Σ_j |∂x_c(t_i) / ∂x_0j| X_j / X_c + |∂x_c(t_i) / ∂p_0j| P_j / X_c     data (x_0, p_0).

The first comes from the Hessian of the action, δX̄ = -(∇²S_ff)⁻¹ ∇²S_fe δe, the second from the product of the steps'
Jacobians, both along the global path.  A saddle over a horizon T has κ near 1 globally and e^{λT} stepwise; κ times
1e-16 is what either can keep.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin._solve import solve, transcribe
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.roundoff import EPS, component_sizes
from casadi_galerkin.functional.interval import NO_CUTOFF
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.initial_problem import InitialProblem
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.plotting import plot_gaps
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.stepping.geometry import jacobians
from casadi_galerkin.stepping.shooting import chain, shoot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PARTED = 0.1  # relative gap beyond which it no longer grows like a small one


@dataclass(frozen=True)
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


@dataclass(frozen=True, repr=False)
class Comparison:
    """A boundary problem solved globally and stepwise.

    Attributes
    ----------
    global_path : Trajectory
    stepped : Attempt, the steps from the global path's own (x_0, p_0)
    shooting : Attempt, the boundary problem solved by `shoot`
    gap_growth : rate λ of the gap of `stepped`, fitted to e^{λ t} from roundoff to 0.1; not a number if it stays at
        roundoff
    condition_global, condition_stepwise : κ of both formulations, defined in the module
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
        parted = ~(self.stepped.gap <= PARTED)
        return float(self.global_path.t[np.argmax(parted)]) if parted.any() else np.inf

    def __repr__(self) -> str:
        """Table of the three ways."""
        path = self.global_path
        seconds = path.build_seconds + path.solve_seconds
        lines = [
            f"Comparison on [{path.t[0]:g}, {path.t[-1]:g}], {len(path.t) - 1} intervals, {path.method}",
            "                         iterations    seconds  largest gap  condition",
            f"  {'global':22}{path.iterations:11d} {seconds:10.4f}  {'':11}  {self.condition_global:9.1e}",
        ]
        for name, attempt in (("stepped from its start", self.stepped), ("shooting", self.shooting)):
            gap = "failed" if attempt.path is None else f"{np.max(attempt.gap):.1e}"
            cost = f"{attempt.iterations:11d} {attempt.seconds:10.4f}"
            lines.append(f"  {name:22}{cost}  {gap:>11}  {self.condition_stepwise:9.1e}")
        lines.append(f"  the gap of the steps grows like exp({self.gap_growth:.3g} t)")
        lines += [f"  {attempt.failure}" for attempt in (self.stepped, self.shooting) if attempt.failure]
        return "\n".join(lines)

    def plot(self, axes: Axes | None = None, time: str = "t") -> Axes:
        """Draw the gaps over time, logarithmic; returns the Matplotlib axes.

        Parameters
        ----------
        axes : Matplotlib axes to draw into; default a new figure
        time : name of the time with its unit, such as "t in s"
        """
        ways = {"stepped from the global start": self.stepped, "shooting": self.shooting}
        gaps = {name + (" (failed)" if way.path is None else ""): way.gap for name, way in ways.items()}
        return plot_gaps(self.global_path.t, gaps, axes, time)


def compare(
    problem: BoundaryProblem,
    method: Galerkin,
    intervals: int | None = None,
    *,
    mesh: ArrayLike | None = None,
    guess: Trajectory | None = None,
) -> Comparison:
    """Solve a boundary problem globally and stepwise, and measure how the two part.

    Parameters
    ----------
    problem : BoundaryProblem
    method : Galerkin
    intervals : number of equal intervals; or
    mesh : (N + 1,) joints from t_span[0] to t_span[1]
    guess : Trajectory from which both start; default the straight line between the ends

    Raises
    ------
    ConvergenceError
        if the global solve fails; failures of the stepwise ways are part of the answer
    """
    path = solve(problem, method, intervals, mesh=mesh, guess=guess)
    start = InitialProblem(
        problem.lagrangian,
        problem.t_span,
        path.x[:, 0].tolist(),
        momentum=path.momentum[:, 0].tolist(),
        parameters=problem.parameters,
    )
    stepped = _attempt(path, lambda: solve(start, method, mesh=path.t))
    shooting = _attempt(path, lambda: shoot(problem, method, mesh=path.t, guess=guess))
    return Comparison(
        path,
        stepped,
        shooting,
        _growth_rate(path.t, stepped.gap),
        _condition_global(problem, path),
        _condition_stepwise(problem, path),
    )


def _attempt(path: Trajectory, way: Callable[[], Trajectory]) -> Attempt:
    """Try one way and measure how far it ends up from the global path."""
    began, gap = time.perf_counter(), np.full(len(path.t), np.nan)
    try:
        found = way()
        answer, failure, iterations, x = found, None, found.iterations, found.x
    except ConvergenceError as error:
        answer, failure, iterations = None, str(error), error.iterations
        x = np.empty((len(path.x), 0)) if error.path is None else error.path.x
    seconds = time.perf_counter() - began
    count = x.shape[1]
    gap[:count] = np.max(np.abs(x - path.x[:, :count]) / component_sizes(path.x)[:, None], axis=0)
    return Attempt(answer, failure, gap, iterations, seconds)


def _growth_rate(t: np.ndarray, gap: np.ndarray) -> float:
    """Slope of log(gap) between roundoff and parting."""
    small = (gap > 10 * EPS) & (gap < PARTED)
    return float(np.polyfit(t[small], np.log(gap[small]), 1)[0]) if np.count_nonzero(small) > 2 else np.nan


def _condition_stepwise(problem: BoundaryProblem, path: Trajectory) -> float:
    """κ of the map from (x_0, p_0) to the joints."""
    growth = chain(jacobians(problem, path))[:, : len(path.x)]
    positions, momenta = component_sizes(path.x), component_sizes(path.momentum)
    return float(np.max(np.abs(growth) @ np.concatenate((positions, momenta)) / positions))


def _condition_global(problem: BoundaryProblem, path: Trajectory) -> float:
    """κ of the map from the positions given at the ends to the joints."""
    d, none = problem.dimension, [None] * problem.dimension
    free = BoundaryProblem(
        problem.lagrangian,
        problem.t_span,
        none,
        None if problem.periodic else none,
        problem.parameters,
        problem.periodic,
    )
    transcription = transcribe(free, path.method, mesh=path.t)
    numbering = transcription.numbering.of_nodes
    nodes = path.polynomial.values.T.ravel()[: transcription.numbering.free]
    data = [] if problem.parameters is None else [problem.parameters]
    hessian = transcription.hessian(nodes, [], [], path.t, *data)
    given = [int(numbering[0, i]) for i, value in enumerate(problem.start) if value is not None]
    given += [int(numbering[-1, i]) for i, value in enumerate(problem.end) if value is not None]
    inner = np.setdiff1d(np.arange(len(nodes)), given).tolist()
    response = np.zeros((len(nodes), len(given)))
    response[given] = np.eye(len(given))
    response[inner] = -np.array(ca.solve(hessian[inner, inner], hessian[inner, given], "qr", NO_CUTOFF))
    sizes = component_sizes(path.x)
    joints = np.abs(response[numbering[:: path.method.degree]])
    return float(np.max(joints @ sizes[np.array(given, dtype=int) % d] / sizes, initial=0.0))
