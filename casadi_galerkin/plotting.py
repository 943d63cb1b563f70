"""Draws arrays with Matplotlib, which is imported only when a plot is asked for; knows nothing of solves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# M. Okabe and K. Ito's palette, told apart by colour-blind readers
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")


def axes_or_new(axes: Axes | None) -> Axes:
    """Return the axes given, or those of a new figure."""
    if axes is not None:
        return axes
    import matplotlib.pyplot as plt

    return plt.subplots(figsize=(7.0, 4.0), layout="constrained")[1]


def plot_path(
    times: np.ndarray, values: np.ndarray, joints: np.ndarray, joint_values: np.ndarray, axes: Axes | None = None
) -> Axes:
    """Draw the components of a path over time, joints as dots.

    Parameters
    ----------
    times, values : (K,) and (d, K), the path drawn as a line
    joints, joint_values : (N + 1,) and (d, N + 1)
    axes : Matplotlib axes to draw into; default a new figure

    Returns
    -------
    the Matplotlib axes
    """
    axes = axes_or_new(axes)
    for i, (line, dots) in enumerate(zip(values, joint_values, strict=True)):
        color = COLORS[i % len(COLORS)]
        axes.plot(times, line, color=color, label=f"x[{i}]")
        axes.plot(joints, dots, ".", color=color)
    axes.set_xlabel("t")
    axes.set_ylabel("x")
    if 1 < len(values) <= len(COLORS):
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
