"""Two rods, hung one below the other, swing in space from one position to another: Cartesian coordinates and tension.

The rods are light, 1 m long, with a mass of 1 kg at the end of each.  In angles their kinetic energy fills a line and
is singular at the poles; in Cartesian coordinates it is |v|²/2, and the rods are two constraints.  Their multipliers
are the tensions, so one sees whether ropes would do: where a tension is negative, a rod pushes.  Gravity acts along the
third axis only, so that the angular momentum about it is kept.  Step by step, the same motion leads to the same end.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

GRAVITY = 9.81  # m/s²
DURATION = 1.2  # s
FIRST = np.array([[0.9, 0.0], [1.2, 0.4]])  # angle from below and azimuth of either rod, rad
LAST = np.array([[0.6, 2.0], [1.0, 1.6]])


def lagrangian(t, x, v):
    """Kinetic minus potential energy per mass; x holds three coordinates of either mass."""
    return ca.sumsqr(v) / 2 - GRAVITY * (x[2] + x[5])


def rods(t, x):
    """Half of the squared lengths, whose gradients are the unit vectors along the rods."""
    return [(ca.sumsqr(x[:3]) - 1) / 2, (ca.sumsqr(x[3:] - x[:3]) - 1) / 2]


def place(angles):
    """Positions of both masses."""
    polar, azimuth = angles.T
    along = np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), -np.cos(polar)]).T
    return np.cumsum(along, axis=0).ravel()


def guess(t):
    """Turn all angles evenly."""
    return place(FIRST + (LAST - FIRST) * t / DURATION)


def main():
    """Solve between the two positions; returns the path."""
    problem = cg.BoundaryProblem(lagrangian, (0.0, DURATION), place(FIRST), place(LAST), constraint=rods)
    return cg.solve(problem, cg.Galerkin(degree=8), intervals=24, guess=guess)


def turn(x):
    """How a turn about the vertical moves both masses; what it keeps is the angular momentum in kg m²/s."""
    return [-x[1], x[0], 0, -x[4], x[3], 0]


def stepped(path):
    """The same path by shooting, from the momenta of this one."""
    return cg.shoot(path.problem, path.method, intervals=len(path.t) - 1, guess=path)


def draw(path):
    """Draw the way of both masses from above, with the rods at a few instants, and the tensions; returns the figure."""
    top, bottom = cg.panels(2, size=(4.6, 6.4), height_ratios=(3, 2))
    times = np.linspace(0.0, DURATION, 200)
    path.plot_plane((0, 1), top)
    path.plot_plane((3, 4), top, ("x in m", "y in m"))
    top.set_title("Two rods from above")
    for x in path(times[::33]).T:
        top.plot([0, x[0], x[3]], [0, x[1], x[4]], color="0.6", linewidth=0.8, zorder=0)
    bottom.plot(times, -path.multipliers(times).T, label=["upper rod", "lower rod"])
    bottom.set(title="Their tensions", xlabel="t in s", ylabel="tension in N")
    bottom.axhline(0, color="0.7", linewidth=0.8)
    bottom.legend(fontsize="small")
    return top.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    for of, tension in zip(("upper", "lower"), -answer.multipliers(np.linspace(0.0, DURATION, 200)), strict=True):
        print(f"tension of the {of} rod from {tension.min():.6f} to {tension.max():.6f} N")
    print(f"shooting differs by {np.max(np.abs(stepped(answer).x - answer.x)):.1e} m")
    print(cg.geometry(answer, symmetry=turn))
    draw(answer).savefig("swinging_chain.png")
