"""What a continuation returns: the paths of a branch, the folds where it turns back, and the branches that cross it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_galerkin.calculus.numbers import checked_index, counted, finite
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solution.plotting import COLORS, Pictured, axes_or_new, component_names, legend
from casadi_galerkin.solution.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Height = Callable[[Path], float]

TARGET = "the target"  # why a branch ends that has led there
SHOWN = 4  # branches, and folds and branch points, in a repr


@dataclass(frozen=True, eq=False)
class Fold:
    """A turning point of a branch: beyond its parameters there are no paths near.

    At the apex of a pitchfork, where a branch meets its mirror image, the Morse index is the same before and after, and
    the symmetric path goes on beyond.

    Attributes
    ----------
    parameters : (n,), at which the branch turns back
    path : Path there
    after : number of paths of the branch before it, so that ``trajectories[after]`` is the first one behind it

    Examples
    --------
    >>> import casadi as ca
    >>> import casadi_galerkin as cg
    >>> bratu = lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * ca.exp(x[0])
    >>> problem = cg.BoundaryProblem(bratu, (0, 1), [0.0], [0.0], parameters=[1.0])
    >>> (fold,) = cg.continuation(problem, [4.0], intervals=10).folds
    >>> fold.parameters.round(6).tolist(), fold.path(0.5).round(4).tolist()
    ([3.513831], [1.1868])
    """

    parameters: np.ndarray
    path: Path
    after: int


@dataclass(frozen=True, eq=False)
class BranchPoint:
    """A simple branch point: another curve of paths crosses here, and the Morse index changes by one.

    Attributes
    ----------
    parameters : (n,), up to rounding
    path : Path there
    null_vector : Path, the variation at which the second variation vanishes; its largest value is one
    after : number of paths of the branch before it

    Examples
    --------
    >>> import casadi as ca
    >>> import casadi_galerkin as cg
    >>> rod = lambda s, x, v, p: v[0] ** 2 / 2 + p[0] * ca.cos(x[0])  # buckles under the load π²
    >>> problem = cg.BoundaryProblem(rod, (0, 1), [0.0], [0.0], parameters=[5.0])
    >>> (point,) = cg.continuation(problem, [20.0], intervals=10).branch_points
    >>> point.parameters.round(9).tolist(), abs(point.null_vector(0.25)).round(6).tolist()
    ([9.869604401], [0.707107])
    """

    parameters: np.ndarray
    path: Path
    null_vector: Path
    after: int


@dataclass(frozen=True, repr=False, eq=False)
class Branch(Pictured):
    """Critical paths along a line of parameters, and the branches that are connected with it by branch points.

    Attributes
    ----------
    trajectories : the K paths, in the order in which the branch was followed
    folds : in the same order
    branch_points : BranchPoints in the same order
    stopped : why it ended: at the target, or at the parameters it began with, to which a fold turned it back, before
        the first path that the mesh does not resolve, or where a branch that was followed before goes on
    missed : numbers of paths after which the Morse index changes by more than the folds and branch points found, as at
        a branch point that is not simple
    origin : BranchPoint from which it leads away; None for the branch of the problem's own path
    others : Branches that were followed from its branch points and from theirs
    waiting : number of branches that were not followed, because there were as many as asked for

    Examples
    --------
    >>> import casadi as ca
    >>> import casadi_galerkin as cg
    >>> bratu = lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * ca.exp(x[0])
    >>> problem = cg.BoundaryProblem(bratu, (0, 1), [0.0], [0.0], parameters=[1.0])
    >>> branch = cg.continuation(problem, [3.0], intervals=10)
    >>> branch.stopped, branch.parameters[[0, -1]].tolist(), branch.trajectories[-1](0.5).round(6).tolist()
    ('the target', [[1.0], [3.0]], [0.640147])

    A diagram:

    >>> rod = lambda s, x, v, p: v[0] ** 2 / 2 + p[0] * ca.cos(x[0])
    >>> problem = cg.BoundaryProblem(rod, (0, 1), [0.0], [0.0], parameters=[5.0])
    >>> straight = cg.continuation(problem, [20.0], intervals=10, branches=3)  # and bent to either side
    >>> [branch.trajectories[-1].morse_index for branch in straight.branches]
    [1, 0, 0]
    """

    trajectories: tuple[Trajectory, ...]
    folds: tuple[Fold, ...]
    branch_points: tuple[BranchPoint, ...]
    stopped: str
    missed: tuple[int, ...] = ()
    origin: BranchPoint | None = None
    others: tuple[Branch, ...] = ()
    waiting: int = 0

    @property
    def parameters(self) -> np.ndarray:
        """(K, n), of each path."""
        return np.array([path.parameters for path in self.trajectories])

    @property
    def reached(self) -> bool:
        """Whether the branch led to the target."""
        return self.stopped == TARGET

    @property
    def branches(self) -> tuple[Branch, ...]:
        """The branch and the others."""
        return self, *self.others

    def plot(
        self,
        height: Height | None = None,
        axes: Axes | None = None,
        labels: Sequence[str] | None = None,
        parameter: int = 0,
    ) -> Axes:
        """Draw one number of every path of all branches over one parameter, by Morse index; returns Matplotlib's axes.

        Minima of the action, of index 0, are drawn as full lines, all others dashed, folds as crosses and branch points
        as circles.

        Parameters
        ----------
        height : Path -> number to draw, such as ``lambda path: path(0.5)[0]``; at a fold, the path is no Trajectory.
            The default is the root mean square of x over time, the same for a path and its mirror image
        axes : Matplotlib axes to draw into, which keep their labels; default a new figure
        labels : names of the parameter and of the height, with units
        parameter : which, from 0 to n - 1
        """
        from matplotlib.collections import LineCollection

        if not (height is None or callable(height)):
            raise TypeError(f"height must be a callable Path -> number, got {height!r}")
        checked_index("parameter", parameter, self.parameters.shape[1])
        of_path = height or root_mean_square

        def place(at: Any) -> tuple[float, float]:  # of a path, a fold or a branch point
            value = finite("what height returns", of_path(getattr(at, "path", at)))
            return at.parameters[parameter], value

        if labels is None and axes is None:
            labels = f"p[{parameter}]", "root mean square of x" if height is None else "height"
        axes = axes_or_new(axes)
        for branch in self.branches:
            places = [(path.morse_index, *place(path)) for path in branch.trajectories]
            if branch.origin is not None:
                places.insert(0, (places[0][0], *place(branch.origin)))
            axes.add_collection(LineCollection([[at[1:] for at in places]], colors="0.8", zorder=1))
            for index, run in groupby(places, key=itemgetter(0)):
                name = "no Morse index" if index is None else f"Morse index {index}"
                color = COLORS[(index or 0) % len(COLORS)]
                axes.plot(*zip(*(at[1:] for at in run), strict=True), ".--" if index else ".-", label=name, color=color)
        for kind, style, size in (("fold", "k+", 12), ("branch point", "ko", 7)):
            found = [place(at) for branch in self.branches for at in getattr(branch, f"{kind}s".replace(" ", "_"))]
            if found:
                axes.plot(*zip(*found, strict=True), style, label=kind, markersize=size, fillstyle="none")
        legend(axes)
        if labels is not None:
            axes.set(**dict(zip(("xlabel", "ylabel"), component_names("the diagram", 2, labels), strict=True)))
        return axes

    def __repr__(self) -> str:
        """Summarize the branch, and say what other branches there are."""
        count, ends = counted(len(self.trajectories), "path"), f"from {self.parameters[0]} to {self.parameters[-1]}"
        found = [("fold", fold) for fold in self.folds] + [("branch point", point) for point in self.branch_points]
        found = sorted(found, key=lambda item: item[1].after)
        listed = [f"{name} at {at.parameters}, after {counted(at.after, 'path')}" for name, at in found]
        lines = [f"Branch of {count} {ends}, {self.stopped}"]
        for part in (listed, [repr(branch).splitlines()[0] for branch in self.others]):
            lines += [f"  {line}" for line in part[:SHOWN]] + [f"  ... {len(part) - SHOWN} more"] * (len(part) > SHOWN)
        if self.missed:
            after = counted(self.missed[0], "path")
            lines.append(f"  the Morse index changes by more than that after {after}: something is missed")
        if self.others:
            waiting = f", {self.waiting} more not followed" if self.waiting else ""
            lines.append(f"  {len(self.branches)} branches in all{waiting}")
        return "\n".join(lines)


def root_mean_square(path: Path) -> float:
    """Root of the mean of x·x over time, exact for the polynomial."""
    polynomial = path.polynomial
    rule, steps = gauss(polynomial.degree + 1), np.diff(polynomial.mesh)
    squares = np.sum(polynomial.at_parts(np.array(rule.points))[0] ** 2, axis=0)
    return float(np.sqrt(steps @ squares @ rule.weights / np.sum(steps)))
