"""A drone flies through three gates: waypoints part its flight into legs, each with a free duration.

The drone is a point mass with a thrust in any direction of its vertical plane.  It starts and stops at rest and pays
for time and for the effort of its thrust beyond hovering.  A gate is a waypoint that is a function of position and
velocity: a place across, heights between two bars, and nearly level flight.  Since every duration is free and nothing
depends on time, the Hamiltonian is zero all along.
"""

import numpy as np

import casadi_galerkin as cg

MASS, GRAVITY, EFFORT = 0.5, 9.81, 0.05  # kg, m/s², 1/(N² s) of a second's price
GATES = ((3.0, (2.0, 2.6)), (6.0, (0.4, 1.0)), (9.0, (2.5, 3.1)))  # m: place, and heights of the bars
LEVEL = 0.5  # m/s, largest velocity up or down in a gate
LAST = (12.0, 1.0)  # m


def gate(place, low, high):
    """State where and how fast upward the drone is in a gate, with the bounds of these."""
    return lambda x, v: [x[0], x[1], v[1]], [place, low, -LEVEL], [place, high, LEVEL]


def problem():
    """State the flight with x = (across, up) in m and u the thrust in N; times are guesses."""
    return cg.ControlProblem(
        lambda t, x, v: MASS * (v[0] ** 2 + v[1] ** 2) / 2 - MASS * GRAVITY * x[1],
        (0.0, 4.0),
        start=[0.0, 1.0],
        end=LAST,
        start_velocity=[0.0, 0.0],
        end_velocity=[0.0, 0.0],
        force=lambda t, x, v, u: u,
        running_cost=lambda t, x, v, u: 1 + EFFORT * (u[0] ** 2 + (u[1] - MASS * GRAVITY) ** 2),
        controls=2,
        duration_bounds=(0.2, 3.0),
        waypoints=[(1.0 + i, gate(place, *bars)) for i, (place, bars) in enumerate(GATES)],
    )


def main():
    """Solve with three intervals on every leg, from the straight line."""
    return cg.solve(problem(), cg.Galerkin(degree=5), intervals=12)


def draw(path):
    """Draw the flight in its plane, with the bars of the gates and the thrust on the way; returns the figure."""
    axes = path.plot_plane(labels=("across in m", "up in m"))
    for place, (low, high) in GATES:
        axes.plot([place, place], [0.0, low], color="0.3", linewidth=3)
        axes.plot([place, place], [high, 3.6], color="0.3", linewidth=3)
    times = np.linspace(path.t[0], path.t[-1], 25)
    axes.quiver(*path(times), *path.control(times), color="0.6", width=0.003, scale=60)
    axes.set_title(f"Three gates in {np.ptp(path.t):.2f} s; arrows are the thrust")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    for when in answer.problem.breakpoints:
        joint = np.argmin(np.abs(answer.t - when))
        print(f"  gate        at {when:.4f} s, {answer.x[1, joint]:.4f} m up", end=", ")
        print(f"rising at {answer.velocity[1, joint]:.4f} m/s")
    draw(answer).savefig("gates.png")
