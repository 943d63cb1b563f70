"""Two rods, hung one below the other, swing in space from one position to another: Cartesian coordinates and tension.

The rods are light, 1 m long, with a mass of 1 kg at the end of each.  In angles their kinetic energy fills a line and
is singular at the poles; in Cartesian coordinates it is |v|²/2, and the rods are two constraints.  Their multipliers
are the tensions, so one sees whether ropes would do: where a tension is negative, a rod pushes.  Gravity acts along the
third axis only, so that the angular momentum about it is kept.
"""

import casadi as ca
import numpy as np
from show import picture, save

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


def main(plot=None):
    """Solve between the two positions; returns the path."""
    problem = cg.BoundaryProblem(lagrangian, (0.0, DURATION), place(FIRST), place(LAST), constraint=rods)
    path = cg.solve(problem, cg.Galerkin(degree=8), intervals=24, guess=guess)
    if plot:
        draw(path, plot)
    return path


def spin(path):
    """Angular momentum about the vertical at the joints, in kg m²/s."""
    (x, y, _, a, b, _), (p, q, _, r, s, _) = path.x, path.momentum
    return x * q - y * p + a * s - b * r


def draw(path, name):
    """Draw the way of both masses from above, with the rods at a few instants, and the tensions."""
    import matplotlib.pyplot as plt

    from casadi_galerkin.solution.plotting import COLORS

    _, (left, right) = plt.subplots(1, 2, figsize=(9.0, 4.0), layout="constrained")
    left.set(title="Two rods from above", xlabel="x in m", ylabel="y in m", aspect="equal")
    times = np.linspace(0.0, DURATION, 200)
    x = path(times)
    for i, of in enumerate(("upper", "lower")):
        left.plot(x[3 * i], x[3 * i + 1], color=COLORS[i])
        right.plot(times, -path.multipliers(times)[i], color=COLORS[i], label=f"{of} rod")
    for k in range(0, 200, 33):
        left.plot([0, x[0, k], x[3, k]], [0, x[1, k], x[4, k]], color="0.6", linewidth=0.8, marker=".", zorder=0)
    right.set(title="Their tensions", xlabel="t in s", ylabel="N")
    right.axhline(0, color="0.7", linewidth=0.8)
    right.legend()
    save(left, name)


if __name__ == "__main__":
    path = main(picture("swinging_chain.png"))
    print(path)
    tension = -path.multipliers(np.linspace(0.0, DURATION, 200))
    for of, values in zip(("upper", "lower"), tension, strict=True):
        print(f"tension of the {of} rod from {values.min():.6f} to {values.max():.6f} N")
    print(f"angular momentum about the vertical {spin(path)[0]:.9f}, varies by {np.ptp(spin(path)):.1e}")
