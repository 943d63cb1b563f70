"""A double pendulum that swings from one pose to another, as a moving picture, in phase space, and its matrix.

Unit masses on unit rods.  The ends are those of a motion that starts at rest, so the velocity at the start is known.
"""

from pathlib import Path

import casadi as ca
import numpy as np
from show import picture

import casadi_galerkin as cg

GRAVITY = 9.81  # m/s²
DURATION = 0.5  # s
START, END = (1.0, 1.2), (0.34020240315987093, 0.67472456539636882)  # rad, from below


def lagrangian(t, x, v):
    """Kinetic minus potential energy in J; x holds the angles of both rods."""
    kinetic = v[0] ** 2 + v[1] ** 2 / 2 + v[0] * v[1] * ca.cos(x[0] - x[1])
    return kinetic + GRAVITY * (2 * ca.cos(x[0]) + ca.cos(x[1]))


def places(x):
    """Support, elbow and tip in the plane, in m; (2, K) angles -> (3, 2, K)."""
    elbow = np.stack((np.sin(x[0]), -np.cos(x[0])))
    return np.stack((np.zeros_like(elbow), elbow, elbow + np.stack((np.sin(x[1]), -np.cos(x[1])))))


def main(plot=None):
    """Solve; with `plot`, the name of a file, draw both pictures, and the moving one beside them."""
    problem = cg.BoundaryProblem(lagrangian, (0.0, DURATION), START, END)
    swing = cg.transcribe(problem, cg.Galerkin(degree=6), 10)
    path = swing.solve()
    if plot:
        draw(swing, path, Path(plot))
    return path


def draw(swing, path, name):
    """Phase portrait and pattern of the Hessian as one picture; half as fast as a GIF of the same name."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 4.4), layout="constrained")
    for component in (0, 1):
        path.plot_phase(component, left, ("angle in rad", "momentum in kg m²/s"))
    left.legend(left.lines[::3], ["upper rod", "lower rod"])
    left.set_title("Double pendulum", fontsize="medium")
    swing.plot_hessian(right)
    figure.savefig(name, dpi=100)
    figure, axes = plt.subplots(figsize=(4.0, 4.0), layout="constrained")
    axes.set(xlabel="x in m", ylabel="y in m")
    path.animate(places, axes, seconds=2 * DURATION, unit="s").save(name.with_suffix(".gif"), writer="pillow", dpi=50)
    plt.close("all")
    print(f"pictures written to {name} and {name.with_suffix('.gif')}")


if __name__ == "__main__":
    answer = main(picture("mechanism.png"))
    print(answer)
    print(f"  velocity    {answer.velocity[:, 0]} rad/s at the start, which is at rest")
