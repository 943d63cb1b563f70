"""A relativistic charged particle in a magnetic field: forces that depend on the velocity.

L = -mc²√(1 - v²/c²) + q A·v with A = B(-y, x)/2.  The exact path is a circle, run through at the frequency
qB/(γm); units with m = c = q = B = 1.  The guess is the straight line between the ends, as always.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

SPEED = 0.9  # in units of c
GAMMA = 1 / np.sqrt(1 - SPEED**2)
DURATION = 1.5 * np.pi * GAMMA  # three quarters of a turn


def lagrangian(t, x, v):
    """Relativistic kinetic part, and the vector potential of a uniform field."""
    return -ca.sqrt(1 - ca.dot(v, v)) + (x[0] * v[1] - x[1] * v[0]) / 2


def exact(t):
    """Clockwise circle about the origin, radius γ v."""
    return GAMMA * SPEED * np.array([np.cos(t / GAMMA), -np.sin(t / GAMMA)])


def main():
    """Solve between two points of the circle."""
    problem = cg.BoundaryProblem(lagrangian, (0.0, DURATION), exact(0.0), exact(DURATION))
    return cg.solve(problem, cg.Galerkin(degree=8), intervals=12)


def draw(path):
    """Draw the path on its circle; returns the figure."""
    axes = cg.panels(size=(4.6, 4.4))
    axes.plot(*exact(np.linspace(0, 2 * np.pi * GAMMA, 300)), color="0.8", linewidth=4, label="exact circle")
    path.plot_plane(axes=axes, labels=("x in mc/(qB)", "y in mc/(qB)"))
    axes.lines[1].set_label("path, joints")
    axes.legend(fontsize="small", loc="center")
    axes.set_title(f"A charge at {SPEED:g} c in a magnetic field")
    for place, text in ((path.x[:, 0], "start"), (path.x[:, -1], "end")):
        axes.annotate(text, place, xytext=(-8, -8), textcoords="offset points", ha="right", va="top")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    times = np.linspace(0, DURATION, 1000)
    print(answer)
    print(f"  speed       {np.linalg.norm(answer.velocity[:, 0]):.15f} c at the start, exact {SPEED}")
    print(f"  error       {np.max(np.abs(answer(times) - exact(times))):.1e} between the joints, largest")
    print(cg.geometry(answer, symmetry=lambda x: [-x[1], x[0]]))  # the canonical angular momentum is kept
    draw(answer).savefig("charged_particle.png")
