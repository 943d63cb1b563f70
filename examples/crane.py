"""A gantry crane moves a load on a rope of fixed length, in Cartesian coordinates: the rope is a constraint.

Trolley and load are at rest at both ends, 10 m apart, in 6 s; the drive of the trolley does it with the least
∫ F²/2 dt.  The multiplier of the constraint is the force of the rope.  Stated by the angle of the rope, the problem has
the same cost.  A digital drive, which holds its force for half a second, pays a little more.
"""

from dataclasses import replace

import casadi as ca
import numpy as np

import casadi_galerkin as cg

TROLLEY, LOAD, ROPE, GRAVITY, WAY, DURATION = 100.0, 500.0, 8.0, 9.81, 10.0, 6.0  # kg, kg, m, m/s², m, s


def problem():
    """State the crane with x = (trolley, load across, load up) in m."""
    return cg.ControlProblem(
        lambda t, x, v: TROLLEY * v[0] ** 2 / 2 + LOAD * (v[1] ** 2 + v[2] ** 2) / 2 - LOAD * GRAVITY * x[2],
        (0.0, DURATION),
        start=[0.0, 0.0, -ROPE],
        end=[WAY, WAY, -ROPE],
        start_velocity=[0.0, 0.0, 0.0],
        end_velocity=[0.0, 0.0, 0.0],
        force=lambda t, x, v, u: [1000 * u[0], 0, 0],
        running_cost=lambda t, x, v, u: u[0] ** 2 / 2,
        controls=1,
        constraint=lambda t, x: (x[1] - x[0]) ** 2 + x[2] ** 2 - ROPE**2,
    )


def in_angles():
    """State the same crane with x = (trolley in m, angle of the rope)."""

    def lagrangian(t, x, v):
        load = v[0] ** 2 + 2 * ROPE * v[0] * v[1] * ca.cos(x[1]) + (ROPE * v[1]) ** 2
        return TROLLEY * v[0] ** 2 / 2 + LOAD * load / 2 + LOAD * GRAVITY * ROPE * ca.cos(x[1])

    return cg.ControlProblem(
        lagrangian,
        (0.0, DURATION),
        start=[0.0, 0.0],
        end=[WAY, 0.0],
        start_velocity=[0.0, 0.0],
        end_velocity=[0.0, 0.0],
        force=lambda t, x, v, u: [1000 * u[0], 0],
        running_cost=lambda t, x, v, u: u[0] ** 2 / 2,
        controls=1,
    )


def main():
    """Solve it both ways, and with a force that is held on every interval; returns the three paths."""
    stated = problem(), in_angles(), replace(problem(), hold=True)
    return tuple(cg.solve(one, cg.Galerkin(degree=6), intervals=12) for one in stated)


def tension(path):
    """Force of the rope at the joints, N: the multiplier times the gradient of the constraint."""
    return 2 * ROPE * np.abs(path.multipliers(path.t)[0])


def draw(answer):
    """Draw trolley and load as a strip of poses, and both forces of the drive; returns the figure."""
    path, _, held = answer
    top, bottom = cg.panels(2, size=(4.6, 3.6), height_ratios=(2, 3))
    path.plot_poses(lambda x: np.stack(([x[0], 0 * x[0]], x[1:])), top, count=9)
    top.set(title=f"A crane carries its load {WAY:g} m", xticks=[], ylabel="m")
    for one in (path, held):
        one.plot_controls(bottom, ["force in kN"], "t in s")
    return top.figure


if __name__ == "__main__":
    answer = path, angle, held = main()
    path.estimate_error()
    print(path)
    print(f"  in angles   cost {angle.cost:.9f} kN² s, with the constraint {path.cost:.9f}")
    print(f"  held        {held.cost:.9f} kN² s, {100 * (held.cost / path.cost - 1):.1f} % more")
    least, most = tension(path).min(), tension(path).max()
    print(f"  rope        {least:.0f} to {most:.0f} N, the load weighs {LOAD * GRAVITY:.0f} N")
    draw(answer).savefig("crane.png")
