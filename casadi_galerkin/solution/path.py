"""A path that can be evaluated and drawn: the base class of solutions, and the last path of a solve that failed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from zipfile import is_zipfile

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.numbers import checked_index, counted, finite, real_array, spanned, whole, whole_number
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, sampling_parts, times_within
from casadi_galerkin.solution.control_path import ControlPath
from casadi_galerkin.solution.export import Columns, File, Table, by_component, file_path
from casadi_galerkin.solution.plotting import (
    COLORS,
    Pictured,
    axes_or_new,
    component_names,
    legend_below,
    plot_path,
    plot_plane,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, repr=False, eq=False)
class Path(Table, Pictured):
    """A path x̄(t) over its joints.

    A Path that is no Trajectory is no solution: the `path` of a ConvergenceError is the last one of its solve.

    Attributes
    ----------
    polynomial : PiecewisePolynomial; its `values` (d, N m + 1) are the node values X̄
    """

    polynomial: PiecewisePolynomial

    @property
    def t(self) -> np.ndarray:
        """Joints, (N + 1,)."""
        return self.polynomial.mesh

    @cached_property
    def x(self) -> np.ndarray:
        """Positions at the joints, (d, N + 1)."""
        return self.polynomial.values[:, :: self.polynomial.degree].copy()

    @cached_property
    def sizes(self) -> np.ndarray:
        """Sizes of the components, to which errors are relative, (d,): their largest values; one below 1e-150."""
        return self.polynomial.sizes

    def table(self, times: ArrayLike | None = None) -> Columns:
        """Times and positions, after a jump there, by name.

        Parameters
        ----------
        times : (K,); default all joints, and between two of them four times as many as the degree, enough to draw
        """
        t = np.atleast_1d(times_within(self.t, self.fine_times if times is None else times)).ravel()
        return {"t": t, **by_component("x", self(t))}

    def _arrays(self) -> Columns:
        return of_parts("polynomial", vars(self.polynomial), ("mesh", "nodes", "values", "arrivals"))

    def __call__(self, t: ArrayLike, nu: int = 0) -> np.ndarray:
        """Position, or derivative of order `nu`, at times t; shape (d,) + t.shape.

        At a joint the derivative is the right one, at the last joint the left one.  Where the position jumps, it is the
        right one, too.
        """
        return self.polynomial(t, nu)

    def before(self, t: ArrayLike, nu: int = 0) -> np.ndarray:
        """Value, or derivative of order `nu`, just before times t; another one at a joint with a jump or a kink."""
        return self.polynomial.before(t, nu)

    def plot(self, axes: Axes | None = None, labels: Sequence[str] | None = None, time: str = "t") -> Axes:
        """Draw the components over time, joints as dots; returns the Matplotlib axes.

        Parameters
        ----------
        axes : Matplotlib axes to draw into; default a new figure
        labels : d names with units, such as "angle in rad"
        time : name of the time with its unit
        """
        drawn = plot_path(self._line(), (self.t, self.x), axes, labels, time)
        if axes is None:
            drawn.set_title(self._title(), wrap=True)
        return drawn

    def plot_plane(
        self, components: tuple[int, int] = (0, 1), axes: Axes | None = None, labels: Sequence[str] | None = None
    ) -> Axes:
        """Draw two components against each other on equal axes, joints as dots; returns the Matplotlib axes.

        Parameters
        ----------
        components : which two, from 0 to d - 1
        axes : Matplotlib axes to draw into; default a new figure
        labels : names of both with units, such as ("x in km", "y in km")
        """
        if len(self.x) == 1:
            raise ValueError(
                "plot_plane draws two components of a path against each other, and this one has only x[0]: draw it "
                "over time by plot, or against its velocity by plot_phase"
            )
        given = [whole(i) for i in np.ravel(np.asarray(components, dtype=object))]
        if len(given) != 2 or any(i is None or not 0 <= i < len(self.x) for i in given):
            raise ValueError(f"components must be two numbers from 0 to {len(self.x) - 1}, got {components!r}")
        chosen = np.array(given, dtype=int)
        names = [f"x[{i}]" for i in chosen] if labels is None else labels
        drawn = plot_plane(self._line()[1][chosen], self.x[chosen], axes, names)
        drawn.set_aspect("equal")
        return drawn

    def plot_poses(
        self, points: Callable[[np.ndarray], ArrayLike], axes: Axes | None = None, count: int = 8, apart: float = 0.0
    ) -> Axes:
        """Draw a mechanism at several instants, from light to dark, and the way of its last point.

        Parameters
        ----------
        points : as for `Trajectory.animate`
        axes : Matplotlib axes to draw into, labeled by their owner; default a new figure
        count : number of instants, evenly from start to end
        apart : how far every pose is moved to the right of the one before; a strip of them needs no trail
        """
        poses = self._places(points, np.linspace(self.t[0], self.t[-1], whole_number("count", count)))
        poses[:, 0] += finite("apart", apart) * np.arange(count)
        trail = np.empty((2, 0)) if apart else self._places(points, self.fine_times)[-1]
        axes = axes_or_new(axes)
        axes.plot(*trail, color=COLORS[5], linewidth=0.8, zorder=1)
        for k, shade in enumerate(np.linspace(0.2, 1.0, count)):
            axes.plot(*poses[:, :, k].T, "o-", color=COLORS[0], alpha=shade, markersize=3, linewidth=1.5)
        axes.set_aspect("equal")
        return axes

    def _places(self, points: Callable[[np.ndarray], ArrayLike], times: np.ndarray) -> np.ndarray:
        """Positions of the ends of the bars of a mechanism at times (K,); (n, 2, K)."""
        if not callable(points):
            raise TypeError(f"points must be a callable of positions, got {points!r}")
        places = real_array("the places that points returns", points(self(times)))
        if places.ndim != 3 or places.shape[1:] != (2, len(times)):
            raise ValueError(
                f"points must return an array of shape (n, 2, {len(times)}), got {places.shape}: n points, the two "
                "coordinates of each, and the times"
            )
        return places

    def _title(self) -> str:
        return f"A path of degree {self.polynomial.degree} on {counted(len(self.t) - 1, 'interval')}, not an answer"

    def _line(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (K,) and positions (d, K) of a smooth line, both of them where it jumps."""
        return self.polynomial.line(self.fine_times)

    @property
    def fine_times(self) -> np.ndarray:
        """Times (K,) at which a path is drawn, written and compared: all joints, and 4 m - 1 between two of them."""
        return self.polynomial.times(sampling_parts(self.polynomial.degree)[:-1])

    def __repr__(self) -> str:
        """State the size and the time of the path."""
        size, intervals = counted(len(self.x), "component"), counted(len(self.t) - 1, "interval")
        return f"Path of {size} on {spanned(self.t)}, degree {self.polynomial.degree} on {intervals}; not an answer"


def load(file: File) -> Path | tuple[Path, ControlPath]:
    """Read the path that `to_npz` wrote, as a guess for another solve.

    It is no answer, and has not been verified anew.  Its duration, where this was free, is to be stated as the `t_span`
    of the next problem.

    Parameters
    ----------
    file : the archive, a string or a Path

    Returns
    -------
    Path, which is called, drawn and given as `guess`; of a ControlTrajectory the pair of it and its controls

    Raises
    ------
    TypeError, ValueError
        for what is no path of a file, and for a file without a path

    Examples
    --------
    >>> import casadi_galerkin as cg, os, tempfile
    >>> fall = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 8 * x[0], (0, 1), start=[0.0], end=[0.0])
    >>> file = os.path.join(tempfile.mkdtemp(), "fall.npz")
    >>> cg.solve(fall, cg.Galerkin(degree=2), intervals=2).to_npz(file)
    >>> cg.load(file)
    Path of 1 component on [0, 1], degree 2 on 2 intervals; not an answer
    >>> cg.solve(fall, tol=1e-6, guess=cg.load(file)).iterations
    1
    """
    with open(file_path(file), "rb") as stream:
        zipped = is_zipfile(stream)  # of a table in text, numpy says that it holds pickles
        stream.seek(0)
        archive = dict(np.load(stream)) if zipped else {}
    path, control = (
        {name.removeprefix(kind): archive[name] for name in archive if name.startswith(kind)}
        for kind in ("polynomial.", "control.")
    )
    if not path:
        raise ValueError(f"{file} holds no path; only to_npz of a path writes one, and not that of other results")
    found = Path(PiecewisePolynomial(**path))
    return (found, ControlPath(**control)) if control else found


def plot_component(
    paths: Sequence[tuple[str, Path]], component: int, axes: Axes | None, labels: Sequence[str] | None, time: str
) -> Axes:
    """Draw one component of several paths, given with their names."""
    lines = [path.polynomial.line(path.fine_times) for _, path in paths]
    chosen = [(t, values[checked_index("component", component, len(values))]) for t, values in lines]
    (heading,) = component_names("x", 1, f"x[{component}]" if labels is None else labels)
    axes = axes_or_new(axes)
    for i, line in enumerate(chosen):
        axes.plot(*line, color=COLORS[i % len(COLORS)], label=paths[i][0])
    axes.set(xlabel=time, ylabel=heading)
    if 0 < len(paths) <= len(COLORS):
        legend_below(axes)
    return axes


def of_parts(kind: str, given: Mapping[str, Any], names: Sequence[str]) -> dict[str, np.ndarray]:
    """Arrays that are not None, by names such as "polynomial.mesh"."""
    return {f"{kind}.{name}": given[name] for name in names if given[name] is not None}
