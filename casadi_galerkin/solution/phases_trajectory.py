"""The solution of several phases: the path of each, and all of them as one function of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.numbers import counted, spanned
from casadi_galerkin.calculus.piecewise_polynomial import times_within
from casadi_galerkin.problems.phases import Phases
from casadi_galerkin.solution.control_trajectory import OptimalPath
from casadi_galerkin.solution.export import Columns
from casadi_galerkin.solution.trajectory import Lines


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
    def solver_error(self) -> float:
        """As of a ControlTrajectory, the largest of all phases."""
        return max(path.solver_error for path in self.phases)

    def table(self, times: ArrayLike | None = None) -> Columns:
        """The tables of the phases one after the other, with the number of the phase; what a phase has not is NaN.

        Parameters
        ----------
        times : (K,); default those of the tables of the phases
        """
        chosen: list[np.ndarray | None] = [None] * len(self.phases)
        if times is not None:
            given = np.atleast_1d(times_within(self.t, times)).ravel()
            which = np.searchsorted([path.t[0] for path in self.phases[1:]], given, side="right")
            chosen = [given[which == k] for k in range(len(self.phases))]
        asked = [(k, some) for k, some in enumerate(chosen) if some is None or len(some)]
        tables = [{"phase": np.array(k), **self.phases[k].table(some)} for k, some in asked]
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
        yield from self._accuracy()
        for k, path in enumerate(self.phases):
            yield f"phase {k}", f"{path._size()} on {spanned(path.t)}, cost {path.cost:.9g}"

    def _doubts(self) -> Lines:
        """Those of the phases."""
        return ((name, f"{words} in phase {k}") for k, path in enumerate(self.phases) for name, words in path._doubts())
