"""The curve of fastest descent that ends anywhere on a slope: it arrives at right angles, and nobody tells it to.

With y downwards a bead that started at rest at y = 0 has speed √(2 g y), so the time of descent is the length
∫ |dx|/√(2 g y).  Paths of constant speed in that length make ∫ |v|²/(4 g y) over a unit of time stationary, which then
is half of the squared time of descent.  The end is on a line through a foot, a condition on the end with a multiplier;
that the curve crosses it at right angles (transversality) follows.  The bead is watched from a first point on, at which
it has already fallen; curves are cycloids.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

START = np.array([0.08, 0.12])  # where the bead is watched from, in m; at rest it was higher up, at y = 0
FOOT = np.array([3.0, 1.0])  # of all slopes, in m
SLOPES = (90.0, 60.0, 35.0)  # degrees from the horizontal; the first is a wall
GRAVITY = 9.81  # m/s²


def lagrangian(t, x, v):
    """Half of the squared speed of passing; x[1] is the depth."""
    return ca.sumsqr(v) / (4 * GRAVITY * x[1])


def on_slope(x0, x1, p):
    """Distance of the end from the slope through the foot, whose angle is p."""
    return ca.sin(p[0]) * (x1[0] - FOOT[0]) + ca.cos(p[0]) * (x1[1] - FOOT[1])


def main():
    """Solve for every slope; returns the paths by angle."""
    problem = cg.BoundaryProblem(
        lambda t, x, v, p: lagrangian(t, x, v),
        (0.0, 1.0),
        start=START,
        end=[None, None],
        end_conditions=on_slope,
        parameters=[np.radians(SLOPES[0])],
    )
    curves, path = {}, lambda t: START + t * (FOOT - START)
    descent = cg.transcribe(problem, cg.Galerkin(degree=12), intervals=16)
    for angle in SLOPES:
        path = curves[angle] = descent.solve(parameters=[np.radians(angle)], guess=path)
    return curves


def duration(path):
    """Time of descent from the first point on, in s."""
    return np.sqrt(2 * path.action)


def draw(curves):
    """Draw the curves and their slopes; returns the figure."""
    axes = cg.panels(size=(4.6, 3.6))
    for angle, path in curves.items():
        path.plot_plane(axes=axes, labels=("x in m", "depth in m"))
        line = axes.lines[-2]
        line.set_label(f"{angle:g}°: {duration(path):.4f} s")
        along = np.array([-np.cos(np.radians(angle)), np.sin(np.radians(angle))])
        ends = FOOT[:, None] + along[:, None] * np.array([-0.8, 2.4])
        axes.plot(*ends, color=line.get_color(), linewidth=0.8)
    axes.set(title="Fastest descents to three slopes", ylim=(3.2, 0.0))
    axes.legend(fontsize="small", loc="lower left")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    for angle, path in answer.items():
        x, y = path.x[:, -1]
        print(f"slope of {angle:g}°: arrives at ({x:.9f}, {y:.9f}) m after {duration(path):.12f} s")
    draw(answer).savefig("descent_to_a_slope.png")
