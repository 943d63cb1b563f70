"""Several answers to one problem: stationary paths in the order of their action."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from casadi_galerkin.calculus.numbers import counted, place
from casadi_galerkin.solution.plotting import Pictured, plot_family
from casadi_galerkin.solution.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHOWN = 6  # paths in a repr
FINER = "a higher degree or more intervals may"


@dataclass(frozen=True, repr=False)
class Paths(Pictured):
    """Stationary paths of one problem in the order of their action.

    Attributes
    ----------
    trajectories : all different, each with its `action`, `morse_index` and `error_estimate`; `solver` says how it was
        found
    solves : how often Newton's method was begun from a guess, or a curve of paths followed
    unresolved : critical points of the discrete action that were dropped, because the mesh does not resolve them
    singular : critical points that were dropped, because the Hessian is singular there: they belong to a family of
        paths, or the ends are conjugate points
    stopped : why the search ended

    Examples
    --------
    >>> import casadi as ca
    >>> import casadi_galerkin as cg
    >>> bratu = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - ca.exp(x[0]), (0, 1), start=[0.0], end=[0.0])
    >>> found = cg.paths(bratu, cg.Galerkin(8), 10, count=2)
    >>> len(found), found.stopped, [path.x[0, 5].round(6).tolist() for path in found]
    (2, 'stopped at count=2', [0.140539, 4.091467])
    """

    trajectories: tuple[Trajectory, ...]
    solves: int
    unresolved: int
    singular: int
    stopped: str

    def __len__(self) -> int:
        return len(self.trajectories)

    def __getitem__(self, i: int) -> Trajectory:
        return self.trajectories[i]

    def __iter__(self) -> Iterator[Trajectory]:
        return iter(self.trajectories)

    def plot(self, component: int = 0, axes: Axes | None = None, label: str | None = None, time: str = "t") -> Axes:
        """Draw one component of all paths into one picture; returns the Matplotlib axes.

        Parameters
        ----------
        component : which, from 0 to d - 1
        axes : Matplotlib axes to draw into; default a new figure
        label : name of the component with its unit
        time : name of the time with its unit
        """
        place("component", component, len(self[0].x))
        drawn = [(f"action {path.action:.6g}, {_index(path)}", path._line()) for path in self]
        lines = [(name, times, values[component]) for name, (times, values) in drawn]
        return plot_family(lines, axes, label or f"x[{component}]", time)

    def __repr__(self) -> str:
        """Tabulate the paths, and say how many were dropped and why the search ended."""
        count = len(self)
        lines = [f"Paths: {counted(count, 'stationary path')} in {counted(self.solves, 'solve')}; {self.stopped}"]
        for path in self.trajectories[:SHOWN]:
            lines.append(
                f"  action {path.action:<18.12g} {_index(path):15} error {path.error_estimate:.0e}  {path.solver}"
            )
        if count > SHOWN:
            lines.append(f"  ... {count - SHOWN} more")
        if self.unresolved:
            lines.append(f"  {self.unresolved} dropped that the mesh does not resolve; {FINER}")
        if self.singular:
            lines.append(f"  {self.singular} dropped with a singular Hessian: a family of paths, or conjugate points")
        return "\n".join(lines)


def _index(path: Trajectory) -> str:
    return "no Morse index" if path.morse_index is None else f"Morse index {path.morse_index}"
