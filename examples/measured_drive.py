"""An instrument on springs, shaken by a measured acceleration: tabulated data, whose knots are breakpoints.

In the frame of the shaken table the instrument obeys x'' = -ω² x - a(t), with a(t) interpolated between 25 samples.
Its position was seen at the start and at the end; wanted is the motion between.  The acceleration has a kink at every
sample.  With the samples as breakpoints every mesh has joints there, and the order of the method holds between them.
"""

import json

import casadi as ca
import numpy as np

import casadi_galerkin as cg
from casadi_galerkin.solution.plotting import COLORS

FREQUENCY = 9.0  # ω in rad/s
START, END = 0.004, -0.003  # positions seen, in m
SAMPLES = np.linspace(0.0, 3.0, 25)  # s
SHAKES = np.random.default_rng(5).normal(0.0, 1.5, len(SAMPLES))  # m/s², as a seismometer might give them
TOLERANCE = 1e-9


def lagrangian(t, x, v):
    """Energy of a unit mass on its springs, with the potential of the table's acceleration."""
    shake = ca.pw_lin(t, SAMPLES.tolist(), SHAKES.tolist())
    return v[0] ** 2 / 2 - FREQUENCY**2 * x[0] ** 2 / 2 - shake * x[0]


def main():
    """Solve with the samples as breakpoints, then without; returns both paths."""
    ends = (SAMPLES[[0, -1]], [START], [END])
    known = cg.solve(cg.BoundaryProblem(lagrangian, *ends, breakpoints=SAMPLES[1:-1]), tol=TOLERANCE)
    unknown = cg.solve(cg.BoundaryProblem(lagrangian, *ends), tol=1e-3)
    return known, unknown


def draw(answer):
    """Draw the motion, and the samples that shake it; returns the figure."""
    path, (top, bottom) = answer[0], cg.panels(2, size=(4.6, 3.6), sharex=True)
    times = np.linspace(0.0, 3.0, 1000)
    top.plot(times, 1e3 * path(times)[0])
    top.plot(path.t, 1e3 * path.x[0], ".", color=COLORS[0], markersize=4)
    top.set(title="An instrument on a shaken table", ylabel="motion in mm")
    bottom.plot(SAMPLES, SHAKES, ".-", color=COLORS[1])
    bottom.set(xlabel="t in s", ylabel="measured in m/s²")
    return top.figure


if __name__ == "__main__":
    answer = known, unknown = main()
    print(known)
    print(f"with breakpoints: {len(known.t) - 1} intervals for a tolerance of {TOLERANCE:g}")
    print(f"without: {len(unknown.t) - 1} intervals for a tolerance of 1e-3")
    print(json.dumps({name: column[:3] for name, column in known.to_dict().items()}))  # the first rows
    draw(answer).savefig("measured_drive.png")
