"""A Lambert transfer in kilometers and seconds: the flight between two positions in a given time.

What a mission asks for are the two velocities: they are solved for until they are known to ten digits, and their error
is printed.

Vallado, "Fundamentals of Astrodynamics and Applications", 4th edition, example 5.7.  Nothing is rescaled:
the solver does not see the units.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

MU = 398600.4418  # km³/s², the Earth's gravitational parameter
START = (15945.34, 0.0, 0.0)  # km
END = (12214.83899, 10249.46731, 0.0)  # km
FLIGHT = 76 * 60.0  # s


def lagrangian(t, x, v):
    """Kinetic minus potential energy of a unit mass, km²/s²."""
    return ca.dot(v, v) / 2 + MU / ca.norm_2(x)


def launch_and_arrival(path):
    """Velocities at both ends, km/s."""
    return path.velocity[:, [0, -1]]


def main():
    """Solve from the straight line between both positions."""
    problem = cg.BoundaryProblem(lagrangian, (0.0, FLIGHT), START, END)
    return cg.solve(problem, tol=1e-10, of=launch_and_arrival)


def draw(path):
    """Draw the orbit, its joints, and the Earth; returns the figure."""
    axes = path.plot_plane(labels=("x in km", "y in km"))
    angles = np.linspace(0, 2 * np.pi, 200)
    axes.fill(6378.1363 * np.cos(angles), 6378.1363 * np.sin(angles), color="0.85")
    axes.text(0, 0, "Earth", ha="center", va="center")
    axes.annotate("start", START[:2], xytext=(-8, 0), textcoords="offset points", ha="right", va="center")
    axes.annotate(f"{FLIGHT / 60:g} minutes later", END[:2], xytext=(-8, 4), textcoords="offset points", ha="right")
    axes.set_title("Lambert transfer, Vallado's example 5.7")
    axes.margins(0.1)
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print("  velocity    ", answer.velocity[:, 0], "km/s at the start, published (2.058913, 2.915965, 0)")
    print("              ", answer.velocity[:, -1], "km/s at the end, published (-3.451565, 0.910315, 0)")
    print(f"               both known to {answer.asked_error:.0e} of the larger")
    answer.to_csv("lambert.csv")  # times, positions, velocities, momenta and energy
    draw(answer).savefig("lambert.png")
