"""Plots of arrays with Matplotlib, which is imported only when something is plotted."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from html import escape
from io import StringIO
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from casadi_galerkin.calculus.numbers import counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# M. Okabe and K. Ito's palette, told apart by color-blind readers
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MOST_DOTS = 200  # joints beyond which their dots would hide the line

Line: TypeAlias = tuple[np.ndarray, np.ndarray]  # times (K,) and values (d, K)
Points: TypeAlias = Sequence[tuple[float, float]]


def panels(rows: int = 1, columns: int = 1, size: tuple[float, float] | None = None, **options: Any) -> Any:
    """Matplotlib axes of a new figure in the style of the package's pictures: one, or an array of rows and columns.

    Parameters
    ----------
    rows, columns : numbers of panels
    size : of the figure, in inches; default Matplotlib's own
    options : of Matplotlib's ``subplots``, such as ``sharex=True``

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> import matplotlib.pyplot as plt
    >>> left, right = cg.panels(columns=2, size=(8.0, 3.2), sharey=True)
    >>> left.figure is right.figure
    True
    >>> plt.close(left.figure)
    """
    import matplotlib.pyplot as plt

    drawn = plt.subplots(rows, columns, figsize=size, layout="constrained", **options)[1]
    for axes in np.ravel(drawn):  # the style is theirs; a figure made in ``rc_context`` undoes what its backend sets up
        axes.set_prop_cycle(color=COLORS)
        axes.grid(True, color="0.92")
        axes.set_axisbelow(True)
    return drawn


def axes_or_new(axes: Axes | None) -> Axes:
    """Return the axes given, or those of a new figure."""
    if axes is not None:
        if not callable(getattr(axes, "plot", None)):
            raise TypeError(f"axes must be Matplotlib axes, got {axes!r}; all other arguments are given by name")
        return axes
    return panels()


class Pictured(ABC):
    """Base class of results that can be plotted; a notebook shows their text and their plot."""

    @abstractmethod
    def plot(self) -> Axes:
        """Draw it; returns the Matplotlib axes."""

    def _repr_html_(self) -> str:
        """The text and the plot."""
        import matplotlib.pyplot as plt
        from matplotlib.figure import Figure

        drawn, picture = self.plot().figure, StringIO()
        assert isinstance(drawn, Figure)
        drawn.savefig(picture, format="svg")
        plt.close(drawn)
        return f"<pre>{escape(repr(self))}</pre>{picture.getvalue()}"


def plot_path(
    line: Line,
    points: Line,
    axes: Axes | None,
    labels: Sequence[str] | None,
    time: str,
    name: str = "x",
) -> Axes:
    """Draw components over time: lines through times (K,) and values (d, K), points as dots, if at most `MOST_DOTS`.

    Without labels components have the name with an index.  Several are named by the legend, where their colors suffice.
    NaN breaks a line.
    """
    count = len(line[1])
    names = component_names(name, count, labels)
    axes = axes_or_new(axes)
    for i, (values, dots) in enumerate(zip(line[1], points[1], strict=True)):
        color = COLORS[i % len(COLORS)]
        axes.plot(line[0], values, color=color, label=names[i])
        if len(points[0]) <= MOST_DOTS:
            axes.plot(points[0], dots, ".", color=color)
    alone, told_apart = count == 1, 1 < count <= len(COLORS)
    axes.set(xlabel=time, ylabel=names[0] if alone else "" if told_apart and labels is not None else name)
    if told_apart:  # beside the axes, where it hides no line
        legend(axes, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return axes


def legend(axes: Axes, **options: Any) -> None:
    """Add a legend in which every name stands once."""
    handles, names = axes.get_legend_handles_labels()
    named = dict(zip(names, handles, strict=True))
    axes.legend(named.values(), named.keys(), fontsize="small", **options)


def legend_below(axes: Axes, **options: Any) -> None:
    """Put the legend of many or long entries under the axes, where it hides nothing and takes no width."""
    legend(axes, loc="upper center", bbox_to_anchor=(0.5, -0.18), **options)


def plot_plane(
    places: np.ndarray, joints: np.ndarray, axes: Axes | None, labels: Sequence[str], name: str = "x"
) -> Axes:
    """Draw a way through a plane: a line through places (2, K), joints (2, N + 1) as dots."""
    names = component_names(name, 2, labels)
    axes = axes_or_new(axes)
    if not axes.lines:
        axes.set_prop_cycle(color=COLORS)
    (line,) = axes.plot(*places)
    if joints.shape[1] <= MOST_DOTS:
        axes.plot(*joints, ".", color=line.get_color())
    axes.set(xlabel=names[0], ylabel=names[1])
    return axes


def component_names(name: str, count: int, labels: Sequence[str] | None) -> Sequence[str]:
    """Names of the components; a string is the name of one."""
    if labels is None:
        return [f"{name}[{i}]" for i in range(count)]
    given = np.atleast_1d(np.asarray(labels, dtype=object))  # a set has no order, and is refused
    if given.shape != (count,) or not all(isinstance(label, str) for label in given):
        raise ValueError(f"labels of {name} must be {counted(count, 'name')}, one per component, got {labels!r}")
    return given.tolist()
