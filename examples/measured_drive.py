"""An instrument on springs, shaken by a measured acceleration: tabulated data, whose knots are breakpoints.

In the frame of the shaken table the instrument obeys x'' = -ω² x - a(t), with a(t) interpolated between 25 samples.
Its position was seen at the start and at the end; wanted is the motion between.  The acceleration has a kink at every
sample.  With the samples as breakpoints every mesh has joints there, and the order of the method holds between them.
"""

import casadi as ca
import numpy as np
from show import canvas, picture, save

import casadi_galerkin as cg

FREQUENCY = 9.0  # ω in rad/s
START, END = 0.004, -0.003  # positions seen, in m
SAMPLES = np.linspace(0.0, 3.0, 25)  # s
SHAKES = np.random.default_rng(5).normal(0.0, 1.5, len(SAMPLES))  # m/s², as a seismometer might give them
TOLERANCE = 1e-9


def lagrangian(t, x, v):
    """Energy of a unit mass on its springs, with the potential of the table's acceleration."""
    shake = ca.pw_lin(t, SAMPLES.tolist(), SHAKES.tolist())
    return v[0] ** 2 / 2 - FREQUENCY**2 * x[0] ** 2 / 2 - shake * x[0]


def main(plot=None):
    """Solve with the samples as breakpoints, then without; returns both paths."""
    ends = (SAMPLES[[0, -1]], [START], [END])
    known = cg.solve(cg.BoundaryProblem(lagrangian, *ends, breakpoints=SAMPLES[1:-1]), tol=TOLERANCE)
    unknown = cg.solve(cg.BoundaryProblem(lagrangian, *ends), tol=1e-3)
    if plot:
        draw(known, plot)
    return known, unknown


def draw(path, name):
    """Draw the motion, and the samples that shake it."""
    axes = canvas("An instrument on a shaken table", "t in s", "x in mm", (7.0, 3.6))
    times = np.linspace(0.0, 3.0, 1000)
    axes.plot(times, 1e3 * path(times)[0], label="motion")
    axes.plot(path.t, 1e3 * path.x[0], ".", color="C0", markersize=3)
    other = axes.twinx()
    other.plot(SAMPLES, SHAKES, ".-", color="0.7", linewidth=0.8, label="measured")
    other.set_ylabel("acceleration of the table in m/s²")
    axes.legend(loc="upper left")
    save(axes, name)


if __name__ == "__main__":
    known, unknown = main(picture("measured_drive.png"))
    print(known)
    print(f"with breakpoints: {len(known.t) - 1} intervals for a tolerance of {TOLERANCE:g}")
    print(f"without: {len(unknown.t) - 1} intervals for a tolerance of 1e-3")
