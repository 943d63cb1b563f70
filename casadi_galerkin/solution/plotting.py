"""Draws arrays with Matplotlib, which is imported only when a plot is asked for; knows nothing of solves."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

# M. Okabe and K. Ito's palette, told apart by colour-blind readers
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DOTS = 200  # joints beyond which their dots would hide the line
WIDTH = 30  # characters that fit beside the lowest panel
FRAMES_A_SECOND = 25


def axes_or_new(axes: Axes | None, size: tuple[float, float] = (7.0, 4.0)) -> Axes:
    """Return the axes given, or those of a new figure of that size in inches."""
    if axes is not None:
        return axes
    import matplotlib.pyplot as plt

    return plt.subplots(figsize=size, layout="constrained")[1]


def plot_path(
    times: np.ndarray,
    values: np.ndarray,
    joints: np.ndarray,
    joint_values: np.ndarray,
    axes: Axes | None = None,
    labels: Sequence[str] | None = None,
    time: str = "t",
    name: str = "x",
) -> Axes:
    """Draw the components of a path over time, joints as dots where there are at most `DOTS`.

    Parameters
    ----------
    times, values : (K,) and (d, K), the path drawn as a line
    joints, joint_values : (N + 1,) and (d, N + 1)
    axes : Matplotlib axes to draw into; default a new figure
    labels : d names with units, such as "angle in rad"; default the name with an index
    time : name of the time with its unit
    name : of the path where it has no labels

    Returns
    -------
    the Matplotlib axes
    """
    names, heading = _named(name, len(values), labels)
    axes = axes_or_new(axes)
    for i, (line, dots) in enumerate(zip(values, joint_values, strict=True)):
        color = COLORS[i % len(COLORS)]
        axes.plot(times, line, color=color, label=names[i])
        if len(joints) <= DOTS:
            axes.plot(joints, dots, ".", color=color)
    axes.set(xlabel=time, ylabel=heading)
    if 1 < len(values) <= len(COLORS):
        axes.legend()
    return axes


def plot_family(
    times: np.ndarray, lines: Sequence[tuple[str, np.ndarray]], axes: Axes | None, label: str, time: str
) -> Axes:
    """Draw one component of several paths over the same times (K,); `lines` are their names and values (K,)."""
    axes = axes_or_new(axes)
    for i, (name, values) in enumerate(lines):
        axes.plot(times, values, color=COLORS[i % len(COLORS)], label=name)
    axes.set(xlabel=time, ylabel=label)
    if len(lines) <= len(COLORS):
        axes.legend(fontsize="small")
    return axes


def _named(name: str, count: int, labels: Sequence[str] | None) -> tuple[Sequence[str], str]:
    """Names of the components, and what stands at their axis."""
    if labels is None:
        names = [f"{name}[{i}]" for i in range(count)]
        return names, names[0] if count == 1 else name
    given = np.asarray(labels, dtype=object)  # by position; a set has none
    if given.shape != (count,) or not all(isinstance(label, str) for label in given):
        raise ValueError(f"labels of {name} must be {count} name(s), one per component, got {labels!r}")
    unbroken = ", ".join(label.replace(" ", "\N{NO-BREAK SPACE}") for label in given)
    return given.tolist(), fill(unbroken, WIDTH).replace("\N{NO-BREAK SPACE}", " ")


def panels(count: int) -> list[Axes]:
    """Axes of a new figure, one above the other over the same time."""
    import matplotlib.pyplot as plt

    return list(plt.subplots(count, sharex=True, figsize=(7.0, 2.6 * count), layout="constrained")[1])


def plot_controls(
    times: np.ndarray,
    values: np.ndarray,
    points: np.ndarray,
    point_values: np.ndarray,
    bounds: np.ndarray,
    axes: Axes,
    labels: Sequence[str] | None = None,
) -> Axes:
    """Draw controls over time, quadrature points as dots where there are at most `DOTS`, finite bounds as dashed lines.

    Parameters
    ----------
    times, values : (K,) and (n, K), lines; NaN breaks them where the controls may jump
    points, point_values : (M,) and (n, M)
    bounds : (2, n), lower and upper
    axes : Matplotlib axes to draw into
    labels : n names with units, such as "force in N"; default u with an index
    """
    names, heading = _named("u", len(values), labels)
    for i, (line, dots) in enumerate(zip(values, point_values, strict=True)):
        color = COLORS[i % len(COLORS)]
        axes.plot(times, line, color=color, label=names[i])
        if len(points) <= DOTS:
            axes.plot(points, dots, ".", markersize=3, color=color)
        for bound in bounds[:, i]:
            if np.isfinite(bound):
                axes.axhline(bound, color=color, linestyle="--", linewidth=0.8)
    axes.set_ylabel(heading)
    if 1 < len(values) <= len(COLORS):
        axes.legend()
    return axes


def plot_gaps(times: np.ndarray, gaps: dict[str, np.ndarray], axes: Axes | None = None, time: str = "t") -> Axes:
    """Draw how far paths are from a reference over time, on a logarithmic scale.

    Parameters
    ----------
    times : (N + 1,)
    gaps : (N + 1,) by name; values that are zero or not finite are left out
    axes : Matplotlib axes to draw into; default a new figure
    time : name of the time with its unit

    Returns
    -------
    the Matplotlib axes
    """
    axes = axes_or_new(axes)
    for color, (name, gap) in zip(COLORS, gaps.items(), strict=False):
        shown = np.isfinite(gap) & (gap > 0)
        axes.plot(times[shown], gap[shown], ".-", color=color, label=name)
    axes.set_yscale("log")
    axes.set_xlabel(time)
    axes.set_ylabel("relative gap to the global path")
    axes.legend()
    return axes


def plot_phase(
    x: np.ndarray,
    p: np.ndarray,
    joint_x: np.ndarray,
    joint_p: np.ndarray,
    labels: tuple[str, str],
    axes: Axes | None = None,
) -> Axes:
    """Draw one component in phase space: a line through (x, p), all (K,), joints as dots, the first one larger."""
    axes = axes_or_new(axes, (5.0, 4.0))
    if not axes.lines:
        axes.set_prop_cycle(color=COLORS)
    (line,) = axes.plot(x, p)
    axes.plot(joint_x, joint_p, ".", color=line.get_color())
    axes.plot(joint_x[:1], joint_p[:1], "o", color=line.get_color())
    axes.set(xlabel=labels[0], ylabel=labels[1])
    return axes


def plot_pattern(rows: np.ndarray, columns: np.ndarray, size: int, axes: Axes | None = None) -> Axes:
    """Draw the nonzeros of a square matrix, row 0 on top."""
    from matplotlib.ticker import MaxNLocator

    axes = axes_or_new(axes, (4.6, 4.8))
    axes.plot(columns, rows, "s", color=COLORS[0], markersize=max(0.4, 230 / size), markeredgewidth=0)
    axes.set(xlim=(-0.5, size - 0.5), ylim=(size - 0.5, -0.5), aspect="equal", xlabel="unknown", ylabel="equation")
    axes.set_title(f"{len(rows)} nonzeros, {100 * len(rows) / size**2:.3g} % of {size} × {size}", fontsize="medium")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(integer=True))
    return axes


def animate_linkage(
    times: np.ndarray, points: np.ndarray, interval: float, axes: Axes | None = None, unit: str = ""
) -> FuncAnimation:
    """Move a chain of bars through points (n, 2, K), one frame every `interval` seconds; the last point leaves a trail.

    The title is the time in the unit given.  The axes are scaled to hold all of it; an animation runs only as long as a
    reference to it is kept.
    """
    from matplotlib.animation import FuncAnimation
    from matplotlib.figure import Figure

    axes = axes_or_new(axes, (5.0, 5.0))
    low, high = points.min(axis=(0, 2)), points.max(axis=(0, 2))
    middle, half = (low + high) / 2, 0.55 * max(np.max(high - low), np.finfo(float).tiny)
    axes.set(xlim=middle[0] + [-half, half], ylim=middle[1] + [-half, half], aspect="equal")
    (trail,) = axes.plot([], [], color=COLORS[5])
    (bars,) = axes.plot([], [], "o-", color=COLORS[0], linewidth=2)
    clock = axes.set_title("", fontsize="medium")
    digits = max(0, 2 - int(np.floor(np.log10(times[-1] - times[0]))))

    def frame(k: int) -> tuple[Artist, ...]:
        bars.set_data(points[:, 0, k], points[:, 1, k])
        trail.set_data(points[-1, 0, : k + 1], points[-1, 1, : k + 1])
        clock.set_text(f"t = {times[k]:.{digits}f} {unit}".rstrip())
        return bars, trail, clock

    figure = axes.figure
    assert isinstance(figure, Figure)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # laid out once; anew for every frame it took 0.2 s each
    return FuncAnimation(figure, frame, frames=len(times), interval=1000 * interval)


Points: TypeAlias = Sequence[tuple[float, float]]
LINE_STYLES: Sequence[tuple[str, Sequence[str], dict[str, Any]]] = (  # by name, and how a legend shows them
    ("color", COLORS, {"linewidth": 3}),
    ("linestyle", ("-", "--", ":", "-."), {"color": "0.3", "linewidth": 1}),
    ("marker", ("o", "s", "^", "D", "v", "P", "*"), {"color": "0.3", "linestyle": "", "markersize": 4}),
)


def plot_work_precision(
    lines: Sequence[tuple[tuple[str, str, str], Points]],
    front: Points,
    floor: float,
    label: str,
    axes: Axes | None = None,
) -> Axes:
    """Draw errors over seconds on logarithmic axes, and the floor below which errors mean nothing.

    Parameters
    ----------
    lines : names of the color, the dashes and the dots of each, and (seconds, error) of its points
    front : (seconds, error) of the points that no other betters
    floor : error of roundoff or of the reference
    label : of the errors
    axes : Matplotlib axes to draw into; default a new figure

    Returns
    -------
    the Matplotlib axes
    """
    from matplotlib.lines import Line2D
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axes = axes_or_new(axes, (8.0, 4.5))
    chosen: list[dict[str, str]] = []
    entries = [Line2D([], [], label="the front", color="0.85", linewidth=7)]
    for k, (style, values, sample) in enumerate(LINE_STYLES):
        names = list(dict.fromkeys(key[k] for key, _ in lines))
        chosen.append({name: values[i % len(values)] for i, name in enumerate(names)})
        if k == 0 or len([name for name in names if name]) > 1:  # one rule, or one solver, goes without saying
            given: list[dict[str, Any]] = [sample | {style: chosen[k][name], "label": name} for name in names if name]
            entries += [Line2D([], [], **entry) for entry in given]

    def drawn(points: Points) -> tuple[list[float], list[float]]:
        """Milliseconds and errors; an error of zero has no place on a logarithmic axis."""
        return [1e3 * seconds for seconds, _ in points], [max(error, floor / 3) for _, error in points]

    axes.loglog(*drawn(front), color="0.85", linewidth=7, zorder=0, solid_capstyle="round")
    for (color, dashes, dots), points in lines:
        looks = {"color": chosen[0][color], "linestyle": chosen[1][dashes], "marker": chosen[2][dots]}
        axes.loglog(*drawn(points), markersize=4, linewidth=1, **looks)
    axes.axhspan(floor / 10, floor, color="0.93", zorder=-1)
    axes.text(
        0.99,
        floor,
        f"roundoff or the reference's error, {floor:.0e} ",
        transform=axes.get_yaxis_transform(),
        ha="right",
        va="bottom",
        fontsize="small",
        color="0.4",
    )
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set(xlabel="milliseconds of a repeated solve", ylabel=label)
    axes.legend(handles=entries, fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))  # beside the lines
    return axes
