"""A Lambert transfer in kilometres and seconds: the flight between two positions in a given time.

Vallado, "Fundamentals of Astrodynamics and Applications", 4th edition, example 5.7.  Nothing is rescaled:
the solver does not see the units.
"""

import casadi as ca
import numpy as np
from show import canvas, picture, save

import casadi_galerkin as cg

MU = 398600.4418  # km³/s², the Earth's gravitational parameter
START = (15945.34, 0.0, 0.0)  # km
END = (12214.83899, 10249.46731, 0.0)  # km
FLIGHT = 76 * 60.0  # s


def lagrangian(t, x, v):
    """Kinetic minus potential energy of a unit mass, km²/s²."""
    return ca.dot(v, v) / 2 + MU / ca.norm_2(x)


def main(plot=None):
    """Solve; with `plot`, the name of a file, draw the orbit in its plane."""
    problem = cg.BoundaryProblem(lagrangian, (0.0, FLIGHT), START, END)
    path = cg.solve(problem, cg.Galerkin(degree=6), intervals=20)
    if plot:
        draw(path, plot)
    return path


def draw(path, name):
    """Draw the orbit, its joints, and the Earth."""
    axes = canvas("Lambert transfer, Vallado's example 5.7", "x in km", "y in km", (5.0, 4.6), aspect="equal")
    angles = np.linspace(0, 2 * np.pi, 200)
    axes.fill(6378.1363 * np.cos(angles), 6378.1363 * np.sin(angles), color="0.85")
    axes.text(0, 0, "Earth", ha="center", va="center")
    line = path(np.linspace(0, FLIGHT, 400))
    axes.plot(line[0], line[1])
    axes.plot(path.x[0], path.x[1], ".", color=axes.lines[0].get_color())
    axes.annotate("start", START[:2], xytext=(-8, 0), textcoords="offset points", ha="right", va="center")
    axes.annotate(f"{FLIGHT / 60:g} minutes later", END[:2], xytext=(-8, 4), textcoords="offset points", ha="right")
    axes.margins(0.1)
    save(axes, name)


if __name__ == "__main__":
    answer = main(picture("lambert.png"))
    print(answer)
    print("  velocity    ", answer.velocity[:, 0], "km/s at the start, published (2.058913, 2.915965, 0)")
    print("              ", answer.velocity[:, -1], "km/s at the end, published (-3.451565, 0.910315, 0)")
