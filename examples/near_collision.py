"""A comet on an orbit of eccentricity 0.99: in, round the sun at a hundredth of the semi-axis, and out again.

Unit semi-axis and unit gravitational parameter; eccentric anomaly from -2 to 2.  The ends lie on the same side of
the sun, and a path that turns back before it joins them as well.  The guess is a circle's arc round the sun: it only
shows the way round.
"""

import casadi as ca
import numpy as np

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


def main():
    """Solve to a relative error of 1e-9."""
    problem = cg.BoundaryProblem(lagrangian, (-HALF, HALF), position(-ANOMALY), position(ANOMALY))
    return cg.solve(
        problem, tol=1e-9, guess=lambda t: [np.cos(2 * t / HALF) - ECCENTRICITY / 2, np.sin(2 * t / HALF) / 2]
    )


def draw(path):
    """Draw the orbit with its joints, and what is near the sun; returns the figure."""
    top, bottom = cg.panels(2, size=(4.6, 4.6), height_ratios=(2, 3))
    for axes in (top, bottom):
        path.plot_plane(axes=axes, labels=("x in semi-axes", "y in semi-axes"))
        axes.plot(0, 0, "o", color=COLORS[4], label="sun")
    top.set_title("A comet of eccentricity 0.99")
    bottom.set(title="Near the sun", xlim=(-0.06, 0.02), ylim=(-0.025, 0.025))
    bottom.locator_params(axis="x", nbins=5)
    bottom.legend(fontsize="small")
    return top.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    closest = np.hypot(*answer(0.0))
    print(f"  distance    {closest:.12f} from the sun half-way, exactly {1 - ECCENTRICITY:.12f}")
    draw(answer).savefig("near_collision.png")
