"""What a continuation returns: the paths of a branch, the folds where it turns back, and where others cross it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from casadi_galerkin.calculus.numbers import checked_index, counted, finite
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solution.plotting import Pictured, plot_branches
from casadi_galerkin.solution.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Height = Callable[[Path], float]

BRANCHES_SHOWN = 7  # branches and branch points in a repr


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
    """Critical paths along a line of parameters.

    Attributes
    ----------
    parameters : (K, n), of each path, in the order in which the branch was followed
    trajectories : the K paths
    folds : in the same order
    reached : whether the branch led to the target
    stopped : why it ended: at the target, or at the parameters it began with, to which a fold turned it back, or before
        the first path that the mesh does not resolve
    branch_points : BranchPoints in the same order
    origin : BranchPoint from which it leads away; None for the branch of the problem's own path
    missed : numbers of paths after which the Morse index changes by more than the folds and branch points found, as at
        a branch point that is not simple

    Examples
    --------
    >>> import casadi as ca
    >>> import casadi_galerkin as cg
    >>> bratu = lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * ca.exp(x[0])
    >>> problem = cg.BoundaryProblem(bratu, (0, 1), [0.0], [0.0], parameters=[1.0])
    >>> branch = cg.continuation(problem, [3.0], intervals=10)
    >>> branch.stopped, branch.parameters[[0, -1]].tolist(), branch.trajectories[-1](0.5).round(6).tolist()
    ('the target', [[1.0], [3.0]], [0.640147])
    """

    parameters: np.ndarray
    trajectories: tuple[Trajectory, ...]
    folds: tuple[Fold, ...]
    reached: bool
    stopped: str
    branch_points: tuple[BranchPoint, ...] = ()
    origin: BranchPoint | None = None
    missed: tuple[int, ...] = ()

    def plot(
        self,
        height: Height | None = None,
        axes: Axes | None = None,
        labels: Sequence[str] | None = None,
        parameter: int = 0,
    ) -> Axes:
        """Draw one number of every path over one parameter, by Morse index; returns Matplotlib's axes.

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
        return _drawn([self], height, axes, labels, parameter)

    def __repr__(self) -> str:
        """Summarize the branch."""
        count, ends = counted(len(self.trajectories), "path"), f"from {self.parameters[0]} to {self.parameters[-1]}"
        found = [("fold", fold) for fold in self.folds] + [("branch point", point) for point in self.branch_points]
        lines = [f"Branch of {count} {ends}, {self.stopped}"]
        for name, at in sorted(found, key=lambda item: item[1].after):
            lines.append(f"  {name} at {at.parameters}, after {counted(at.after, 'path')}")
        for after in self.missed:
            lines.append(
                f"  the Morse index changes by more than that after {counted(after, 'path')}: something is missed"
            )
        return "\n".join(lines)


@dataclass(frozen=True, repr=False, eq=False)
class Diagram(Pictured):
    """The branches that are connected with a path by branch points.

    Attributes
    ----------
    branches : Branches, that of the problem's own path first
    waiting : number of branches that were not followed, because `branches` was reached

    Examples
    --------
    >>> import casadi as ca
    >>> import casadi_galerkin as cg
    >>> rod = lambda s, x, v, p: v[0] ** 2 / 2 + p[0] * ca.cos(x[0])
    >>> problem = cg.BoundaryProblem(rod, (0, 1), [0.0], [0.0], parameters=[5.0])
    >>> diagram = cg.continuation(problem, [20.0], intervals=10, branches=3)  # straight, and bent to either side
    >>> [branch.trajectories[-1].morse_index for branch in diagram]
    [1, 0, 0]
    """

    branches: tuple[Branch, ...]
    waiting: int

    def __len__(self) -> int:
        return len(self.branches)

    def __getitem__(self, i: int) -> Branch:
        return self.branches[i]

    def __iter__(self) -> Iterator[Branch]:
        return iter(self.branches)

    @property
    def folds(self) -> tuple[Fold, ...]:
        """Folds of all branches."""
        return tuple(fold for branch in self.branches for fold in branch.folds)

    @property
    def branch_points(self) -> tuple[BranchPoint, ...]:
        """Branch points of all branches; one that two of them pass comes once."""
        points: dict[int, BranchPoint] = {}
        for branch in self.branches:
            points |= {id(point.path): points.get(id(point.path), point) for point in branch.branch_points}
        return tuple(points.values())

    def plot(
        self,
        height: Height | None = None,
        axes: Axes | None = None,
        labels: Sequence[str] | None = None,
        parameter: int = 0,
    ) -> Axes:
        """Draw all branches into one picture, as `Branch.plot` draws one, with the same arguments."""
        return _drawn(self.branches, height, axes, labels, parameter)

    def __repr__(self) -> str:
        """Summarize all branches."""
        waiting = f", {self.waiting} more not followed" if self.waiting else ""
        at = ", ".join(map(str, [point.parameters for point in self.branch_points[:BRANCHES_SHOWN]]))
        lines = [
            f"Diagram of {len(self)} branch{'es' * (len(self) != 1)}{waiting}",
            f"  {counted(len(self.branch_points), 'branch point')}{' at ' * bool(at)}{at}",
        ]
        for branch in self.branches[:BRANCHES_SHOWN]:
            folded = f"; {counted(len(branch.folds), 'fold')}" if branch.folds else ""
            lines.append(f"  {repr(branch).splitlines()[0]}{folded}")
        if len(self) > BRANCHES_SHOWN:
            lines.append(f"  ... {len(self) - BRANCHES_SHOWN} more")
        return "\n".join(lines)


def root_mean_square(path: Path) -> float:
    """Root of the mean of x·x over time, exact for the polynomial."""
    polynomial = path.polynomial
    rule, steps = gauss(polynomial.degree + 1), np.diff(polynomial.mesh)
    squares = np.sum(polynomial.at_parts(np.array(rule.points))[0] ** 2, axis=0)
    return float(np.sqrt(steps @ squares @ rule.weights / np.sum(steps)))


def _drawn(
    branches: Sequence[Branch],
    height: Height | None,
    axes: Axes | None,
    labels: Sequence[str] | None,
    parameter: int,
) -> Axes:
    if height is None:
        height, name = root_mean_square, "root mean square of x"
    elif callable(height):
        name = "height"
    else:
        raise TypeError(f"height must be a callable Path -> number, got {height!r}")
    checked_index("parameter", parameter, branches[0].parameters.shape[1])

    def place(at: Fold | BranchPoint | Trajectory, parameters: np.ndarray) -> tuple[float, float]:
        path = at if isinstance(at, Trajectory) else at.path
        return parameters[parameter], finite("what height returns", height(path))

    drawn = []
    for branch in branches:
        paths = zip(branch.trajectories, branch.parameters, strict=True)
        places = [(path.morse_index, *place(path, parameters)) for path, parameters in paths]
        if branch.origin is not None and places:
            places.insert(0, (places[0][0], *place(branch.origin, branch.origin.parameters)))
        drawn.append(places)
    folds = [place(fold, fold.parameters) for branch in branches for fold in branch.folds]
    points = [place(point, point.parameters) for branch in branches for point in branch.branch_points]
    if labels is None and axes is None:
        labels = f"p[{parameter}]", name
    return plot_branches(drawn, folds, points, axes, labels)
