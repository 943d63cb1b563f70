"""A free-flying robot comes to rest with the least fuel: two pairs of thrusters, one on either side, steer its flight.

Its mass is one, and so is its inertia; the thrusters push along its axis, or turn it by pushing against each other.
Each pair has two thrusters that point in opposite ways, so that what they burn is the sum of four controls that are not
negative.  They switch, and the robot drifts in between.  It is Sakawa's problem (1999); 7.91055 of fuel are published.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

ARM = 0.2  # of the thrusters
PUBLISHED = 7.91055


def force(t, x, v, u):
    """Push along the axis, which has the angle x[2], and torque."""
    left, right = u[0] - u[1], u[2] - u[3]
    push = left + right
    return [push * ca.cos(x[2]), push * ca.sin(x[2]), ARM * (left - right)]


def problem():
    """From rest to rest within twelve units of time."""
    return cg.ControlProblem(
        lambda t, x, v: ca.dot(v, v) / 2,
        (0.0, 12.0),
        start=[-10.0, -10.0, np.pi / 2],
        end=[0.0, 0.0, 0.0],
        start_velocity=[0.0, 0.0, 0.0],
        end_velocity=[0.0, 0.0, 0.0],
        force=force,
        running_cost=lambda t, x, v, u: ca.sum1(u),
        controls=4,
        control_bounds=(0.0, 1.0),
        path_constraint=(lambda t, x, v, u: [u[0] + u[1], u[2] + u[3]], -np.inf, 1.0),
    )


def main():
    """Solve on many short intervals, as the thrusters switch at unknown times."""
    return cg.solve(problem(), cg.Galerkin(degree=2), intervals=240)


def draw(path):
    """Draw the way, with the push as arrows; returns the figure."""
    axes, times = cg.panels(size=(6.0, 4.0)), np.linspace(0.0, 12.0, 61)
    x, u = path(times), path.control(times)
    push = np.array([1.0, -1.0, 1.0, -1.0]) @ u
    axes.plot(*x[:2])
    axes.quiver(*x[:2], push * np.cos(x[2]), push * np.sin(x[2]), angles="xy", width=0.004, color="0.4")
    axes.set(title=f"A robot flies with {path.cost:.4f} of fuel", xlabel="x", ylabel="y", aspect="equal")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"  fuel {answer.cost:.5f}, published {PUBLISHED}")
    draw(answer).savefig("free_flying_robot.png")
