"""A double pendulum that swings from one pose to another, in poses, in phase space, and as a moving picture.

Unit masses on unit rods.  Of the start, only that both are at rest there is known.  They hang where the motion to the
given end has them hang: at 1.0 and 1.2 rad.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

GRAVITY = 9.81  # m/s²
DURATION = 0.5  # s
FRAMES = 25
START, AT_START = (None, None), (0.0, 0.0)  # rad, rad/s
END = (0.34020240315987093, 0.67472456539636882)  # rad, from below


def lagrangian(t, x, v):
    """Kinetic minus potential energy in J; x holds the angles of both rods."""
    kinetic = v[0] ** 2 + v[1] ** 2 / 2 + v[0] * v[1] * ca.cos(x[0] - x[1])
    return kinetic + GRAVITY * (2 * ca.cos(x[0]) + ca.cos(x[1]))


def places(x):
    """Support, elbow and tip in the plane, in m; (2, K) angles -> (3, 2, K)."""
    elbow = np.stack((np.sin(x[0]), -np.cos(x[0])))
    return np.stack((np.zeros_like(elbow), elbow, elbow + np.stack((np.sin(x[1]), -np.cos(x[1])))))


def main():
    """Solve for the motion into the last pose."""
    problem = cg.BoundaryProblem(lagrangian, (0.0, DURATION), START, END, start_velocity=AT_START)
    return cg.solve(problem, cg.Galerkin(degree=6), intervals=10)


def draw(path):
    """Draw the poses of both rods, and their ways through phase space; returns the figure."""
    top, bottom = cg.panels(2, size=(4.6, 6.0))
    path.plot_poses(places, top, count=9)
    top.set(title="Nine poses of a double pendulum", xlabel="x in m", ylabel="y in m")
    for component in (0, 1):
        path.plot_phase(component, bottom, ("angle in rad", "momentum in kg m²/s"))
    bottom.legend(bottom.lines[::3], ["upper rod", "lower rod"], fontsize="small")
    bottom.set_title("In phase space")
    return top.figure


def film(path):
    """The mechanism moving, at half its speed."""
    axes = cg.panels(size=(4.0, 4.0))
    axes.set(xlabel="x in m", ylabel="y in m")
    return path.animate(places, axes, seconds=2 * DURATION, unit="s", frames=FRAMES)


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"  start       {answer.x[:, 0]} rad, {answer.velocity[:, 0]} rad/s: at rest")
    draw(answer).savefig("mechanism.png")
    film(answer).save("mechanism.gif", writer="pillow", dpi=50)
