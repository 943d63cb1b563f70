"""What a continuation returns: the paths of a branch and the folds where it turns back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from casadi_galerkin.calculus.numbers import checked_index, counted, finite
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solution.plotting import plot_branch
from casadi_galerkin.solution.trajectory import Trajectory, index_in_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes


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


@dataclass(frozen=True, repr=False, eq=False)
class Branch:
    """Critical paths along a line of parameters.

    Attributes
    ----------
    parameters : (K, n), of each path, in the order in which the branch was followed
    trajectories : the K paths
    folds : in the same order
    reached : whether the branch led to the target
    stopped : why it ended: at the target, or at the parameters it began with, to which a fold turned it back, or before
        the first path that the mesh does not resolve

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

    def plot(self, height: Callable[[Path], float], axes: Axes | None = None, parameter: int = 0) -> Axes:
        """Draw one number of every path over one parameter, by Morse index, and the folds; returns Matplotlib's axes.

        Parameters
        ----------
        height : Path -> number to draw, such as ``lambda path: path(0.5)[0]``; at a fold, the path is no Trajectory
        axes : Matplotlib axes to draw into, labeled by their owner; default a new figure, labeled by the parameter
        parameter : which, from 0 to n - 1
        """
        if not callable(height):
            raise TypeError(f"height must be a callable Path -> number, got {height!r}")
        checked_index("parameter", parameter, self.parameters.shape[1])

        def checked(path: Path) -> float:
            return finite("what height returns", height(path))

        heights = np.array([checked(path) for path in self.trajectories])
        indices = [index_in_words(path) for path in self.trajectories]
        values = self.parameters[:, parameter]
        parts = {index: np.array([index == found for found in indices]) for index in dict.fromkeys(indices)}
        folds = np.array([(fold.parameters[parameter], checked(fold.path)) for fold in self.folds]).reshape(-1, 2)
        drawn = plot_branch(values, heights, parts, folds, axes)
        if axes is None:
            drawn.set(xlabel=f"p[{parameter}]", ylabel="height")
        return drawn

    def __repr__(self) -> str:
        """Summarize the branch."""
        count, ends = counted(len(self.trajectories), "path"), f"from {self.parameters[0]} to {self.parameters[-1]}"
        lines = [f"Branch of {count} {ends}, {self.stopped}"]
        lines += [f"  fold at {fold.parameters}, after {counted(fold.after, 'path')}" for fold in self.folds]
        return "\n".join(lines)
