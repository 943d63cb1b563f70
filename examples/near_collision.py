"""A comet on an orbit of eccentricity 0.99: in, round the sun at a hundredth of the semi-axis, and out again.

Unit semi-axis and unit gravitational parameter; eccentric anomaly from -2 to 2.  The ends lie on the same side of
the sun, and a path that turns back before it joins them as well.  The guess is a circle's arc round the sun: it only
shows the way round.
"""

import casadi as ca
import numpy as np
from show import canvas, dense, picture, save

import casadi_galerkin as cg
from casadi_galerkin.solution.plotting import COLORS

ECCENTRICITY, ANOMALY = 0.99, 2.0
HALF = ANOMALY - ECCENTRICITY * np.sin(ANOMALY)  # half of the time of flight, by Kepler's equation


def lagrangian(t, x, v):
    """Kinetic minus potential energy."""
    return ca.dot(v, v) / 2 + 1 / ca.norm_2(x)


def position(anomaly):
    """Position on the orbit; (2,)."""
    return np.array([np.cos(anomaly) - ECCENTRICITY, np.sqrt(1 - ECCENTRICITY**2) * np.sin(anomaly)])


def main(plot=None):
    """Solve to a relative error of 1e-9; with `plot`, the name of a file, draw the orbit."""
    problem = cg.BoundaryProblem(lagrangian, (-HALF, HALF), position(-ANOMALY), position(ANOMALY))
    path = cg.solve(
        problem, tol=1e-9, guess=lambda t: [np.cos(2 * t / HALF) - ECCENTRICITY / 2, np.sin(2 * t / HALF) / 2]
    )
    if plot:
        draw(path, plot)
    return path


def draw(path, name):
    """Draw the orbit near the sun, joints as dots."""
    axes = canvas("Near-collision, eccentricity 0.99", "x in semi-axes", "y in semi-axes", (6.0, 3.2))
    axes.plot(*path(dense(path)))
    axes.plot(*path.x, ".", label="joints")
    axes.plot(0, 0, "o", color=COLORS[4], label="sun")
    axes.legend()
    save(axes, name)


if __name__ == "__main__":
    answer = main(picture("near_collision.png"))
    print(answer)
    closest = np.hypot(*answer(0.0))
    print(f"  distance     {closest:.12f} from the sun half-way, exactly {1 - ECCENTRICITY:.12f}")
