"""Draws arrays with Matplotlib, which is imported only when a plot is asked for; knows nothing of solves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# M. Okabe and K. Ito's palette, told apart by colour-blind readers
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DOTS = 200  # joints beyond which their dots would hide the line


def axes_or_new(axes: Axes | None) -> Axes:
    """Return the axes given, or those of a new figure."""
    if axes is not None:
        return axes
    import matplotlib.pyplot as plt

    return plt.subplots(figsize=(7.0, 4.0), layout="constrained")[1]


def plot_path(
    times: np.ndarray,
    values: np.ndarray,
    joints: np.ndarray,
    joint_values: np.ndarray,
    axes: Axes | None = None,
    name: str = "x",
) -> Axes:
    """Draw the components of a path over time, joints as dots where there are at most `DOTS`.

    Parameters
    ----------
    times, values : (K,) and (d, K), the path drawn as a line
    joints, joint_values : (N + 1,) and (d, N + 1)
    axes : Matplotlib axes to draw into; default a new figure
    name : of the path

    Returns
    -------
    the Matplotlib axes
    """
    axes = axes_or_new(axes)
    for i, (line, dots) in enumerate(zip(values, joint_values, strict=True)):
        color = COLORS[i % len(COLORS)]
        axes.plot(times, line, color=color, label=f"{name}[{i}]")
        if len(joints) <= DOTS:
            axes.plot(joints, dots, ".", color=color)
    axes.set_xlabel("t")
    axes.set_ylabel(name)
    if 1 < len(values) <= len(COLORS):
        axes.legend()
    return axes


def panels(count: int) -> list[Axes]:
    """Axes of a new figure, one above the other over the same time."""
    import matplotlib.pyplot as plt

    return list(plt.subplots(count, sharex=True, figsize=(7.0, 2.6 * count), layout="constrained")[1])


def plot_controls(
    times: np.ndarray, values: np.ndarray, points: np.ndarray, point_values: np.ndarray, bounds: np.ndarray, axes: Axes
) -> Axes:
    """Draw controls over time, quadrature points as dots where there are at most `DOTS`, finite bounds as dashed lines.

    Parameters
    ----------
    times, values : (K,) and (n, K), lines; NaN breaks them where the controls may jump
    points, point_values : (M,) and (n, M)
    bounds : (2, n), lower and upper
    axes : Matplotlib axes to draw into
    """
    for i, (line, dots) in enumerate(zip(values, point_values, strict=True)):
        color = COLORS[i % len(COLORS)]
        axes.plot(times, line, color=color, label=f"u[{i}]")
        if len(points) <= DOTS:
            axes.plot(points, dots, ".", markersize=3, color=color)
        for bound in bounds[:, i]:
            if np.isfinite(bound):
                axes.axhline(bound, color=color, linestyle="--", linewidth=0.8)
    axes.set_xlabel("t")
    axes.set_ylabel("u")
    if 1 < len(values) <= len(COLORS):
        axes.legend()
    return axes


def plot_gaps(times: np.ndarray, gaps: dict[str, np.ndarray], axes: Axes | None = None) -> Axes:
    """Draw how far paths are from a reference over time, on a logarithmic scale.

    Parameters
    ----------
    times : (N + 1,)
    gaps : (N + 1,) by name; values that are zero or not finite are left out
    axes : Matplotlib axes to draw into; default a new figure

    Returns
    -------
    the Matplotlib axes
    """
    axes = axes_or_new(axes)
    for color, (name, gap) in zip(COLORS, gaps.items(), strict=False):
        shown = np.isfinite(gap) & (gap > 0)
        axes.plot(times[shown], gap[shown], ".-", color=color, label=name)
    axes.set_yscale("log")
    axes.set_xlabel("t")
    axes.set_ylabel("relative gap to the global path")
    axes.legend()
    return axes


def plot_work_precision(
    lines: Mapping[str, tuple[Sequence[float], Sequence[float]]], floor: float, axes: Axes | None = None
) -> Axes:
    """Draw errors over seconds on logarithmic axes, and the floor below which errors mean nothing.

    Parameters
    ----------
    lines : label -> seconds and errors
    floor : error of roundoff or of the reference
    axes : Matplotlib axes to draw into; default a new figure

    Returns
    -------
    the Matplotlib axes
    """
    axes = axes_or_new(axes)
    for i, (label, (seconds, errors)) in enumerate(lines.items()):
        drawn = np.maximum(errors, floor / 3)  # an error of zero has no place on a logarithmic axis
        axes.loglog(seconds, drawn, "o-", color=COLORS[i % len(COLORS)], markersize=4, label=label)
    axes.axhspan(floor / 10, floor, color="0.85", zorder=0)
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
    axes.set_xlabel("seconds of a warm solve")
    axes.set_ylabel("largest relative error of the path")
    axes.legend(fontsize="small", loc="upper right")
    return axes
