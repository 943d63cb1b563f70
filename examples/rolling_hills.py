"""A car over rolling hills, with the least effort: a periodic motion, stated by conditions that join both ends.

The road rises and falls with the sine of the way.  The car is to take one hill in a given time and to arrive as fast as
it set out, so that it can go on like this for ever; how fast that is, is not given.  Where in the hill it begins makes
no difference, and three hills at once cost three times as much.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

HILL, TIME = 1.0, 1.0  # from one top to the next, and the time for it
HEIGHT, GRAVITY, DRAG = 0.05, 9.81, 0.3


def lagrangian(t, x, v):
    """Kinetic less potential energy, by the mass, along a road that is x long and nearly flat."""
    return v[0] ** 2 / 2 - GRAVITY * HEIGHT * ca.cos(2 * np.pi * x[0] / HILL)


def problem(hills=1, begin=0.0):
    """Some hills, in as many times the time; start and velocities are left free but for what joins them."""
    return cg.ControlProblem(
        lagrangian,
        (0.0, hills * TIME),
        start=begin,
        end=begin + hills * HILL,
        force=lambda t, x, v, u: u[0] - DRAG * v[0],
        running_cost=lambda t, x, v, u: u[0] ** 2 / 2,
        controls=1,
        end_conditions=(lambda x0, v0, x1, v1: v1 - v0, 0.0, 0.0),
    )


def main():
    """Solve for one hill."""
    return cg.solve(problem(), cg.Galerkin(degree=6), intervals=16)


def draw(path):
    """Draw speed and thrust over the way, above the road; returns the figure."""
    top, road = cg.panels(2, size=(6.0, 4.0), sharex=True, height_ratios=(3, 1))
    times = np.linspace(*path.t[[0, -1]], 200)
    way = path(times)[0]
    top.plot(way, path(times, 1)[0], label="speed")
    top.plot(way, path.control(times)[0], label="thrust")
    top.set_title("The cheapest steady way over a hill")
    top.legend()
    road.fill_between(way, HEIGHT * np.cos(2 * np.pi * way / HILL), -HEIGHT, color="0.8")
    road.set(xlabel="way", ylabel="road")
    return top.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"  sets out and arrives with {answer.start_velocity[0]:.9f} and {answer.end_velocity[0]:.9f}")
    three = cg.solve(problem(hills=3), cg.Galerkin(degree=6), intervals=48)
    print(f"  three hills cost {three.cost / answer.cost:.9f} times as much as one")
    steady = (DRAG * HILL / TIME) ** 2 / 2
    print(f"  on a flat road the cost would be {steady:.6g} a hill, here it is {answer.cost:.6g}")
    draw(answer).savefig("rolling_hills.png")
