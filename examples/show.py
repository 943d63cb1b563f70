"""Pictures of the scenes, with or without a screen."""

import sys

import numpy as np


def picture(default):
    """Name of the file to draw into: the first argument of the script, or `default`."""
    return sys.argv[1] if len(sys.argv) > 1 else default


def dense(path):
    """Twenty times on each interval of a path whose intervals differ by orders of magnitude; increasing, (20 N,)."""
    return (path.t[:-1, None] + np.diff(path.t)[:, None] * np.linspace(0, 1, 20)).ravel()


def canvas(title, xlabel, ylabel, size=(6.0, 4.0), **settings):
    """Labelled Matplotlib axes in the colours of the package."""
    import matplotlib.pyplot as plt

    from casadi_galerkin.solution.plotting import COLORS

    axes = plt.subplots(figsize=size, layout="constrained")[1]
    axes.set_prop_cycle(color=COLORS)
    axes.set(title=title, xlabel=xlabel, ylabel=ylabel, **settings)
    return axes


def save(axes, name):
    """Write the figure of these axes to a file, which needs no screen, and say so."""
    import matplotlib.pyplot as plt

    axes.figure.savefig(name, dpi=100)
    plt.close(axes.figure)
    print(f"picture written to {name}")
