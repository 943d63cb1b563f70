"""How fast, and at which angle, a ball is thrown that hits a target in a given time in spite of air drag.

Drag is c |v| v per mass, with c = 0.01/m about that of a golf ball.  Drag is a force, so there is no action to minimize
and no Morse index; the discrete Lagrange-d'Alembert equations are solved all at once.  In vacuum the ball leaves at
v = (d/T, g T/2).
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

GRAVITY = 9.81  # m/s²
DRAG = 0.01  # 1/m
TARGET = [60.0, 0.0]  # m
DURATIONS = (2.0, 4.0, 6.0)  # s


def lagrangian(t, x, v):
    """Kinetic minus potential energy per mass; x = (distance, height)."""
    return ca.sumsqr(v) / 2 - GRAVITY * x[1]


def drag(t, x, v):
    """Force per mass, against the velocity."""
    return -DRAG * ca.norm_2(v) * v


def main():
    """Solve for every duration; returns the throws by duration."""
    problem = cg.BoundaryProblem(lagrangian, (0.0, 4.0), start=[0.0, 0.0], end=TARGET, force=drag)
    throw = cg.transcribe(problem, tol=1e-10)  # the mesh of the first throw serves the others
    return {duration: throw.solve(t_span=(0.0, duration)) for duration in DURATIONS}


def draw(throws):
    """Draw the flights, with those in vacuum dashed; returns the figure."""
    axes = cg.panels(size=(4.6, 4.2))
    for duration, path in throws.items():
        path.plot_plane(axes=axes, labels=("distance in m", "height in m"))
        line, times = axes.lines[-2], np.linspace(0.0, duration, 200)
        line.set_label(f"{duration:g} s, leaves at {speed(path):.1f} m/s")
        parabola = times / duration * TARGET[0], GRAVITY / 2 * times * (duration - times)
        axes.plot(*parabola, "--", color=line.get_color(), linewidth=0.8)
    axes.plot(*TARGET, "kx")
    axes.set_title("Three throws with drag, dashed without")
    axes.figure.legend(fontsize="small", loc="outside lower center")
    return axes.figure


def speed(path):
    """Speed at which the ball is thrown, in m/s."""
    return np.linalg.norm(path.velocity[:, 0])


if __name__ == "__main__":
    answer = main()
    for duration, path in answer.items():
        angle = np.degrees(np.arctan2(*path.velocity[::-1, 0]))
        lost = 1 - np.linalg.norm(path.velocity[:, -1]) ** 2 / speed(path) ** 2
        print(f"{duration:g} s: {speed(path):.6f} m/s at {angle:.4f}°, drag takes {100 * lost:.1f} % of the energy")
    draw(answer).savefig("projectile.png")
