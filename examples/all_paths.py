"""All stationary paths without a guess: swings of a pendulum, soap films, geodesics of a torus.

A pendulum hangs down and is at 1 rad ten seconds later: in how many ways?  Two soap films span two rings.  Two points
of a torus, two turns apart on its outer equator, are joined by the equator itself, which is no shortest way, and by
geodesics that cross it; each of these has a mirror image, which is not listed.

No search proves that nothing is missing.  But of the swings, and of the geodesics with their mirror images, one more
has an even Morse index than an odd one, as Morse's theory asks of paths that can be drawn into one another.
"""

import casadi as ca
import numpy as np
from show import picture, save

import casadi_galerkin as cg

ACTION = 9.0  # of the pendulum's paths at most
HALF_DISTANCE = 0.5  # of the rings, in units of their radius
RADII = 2.0, 1.0  # of the torus: of its axis, of its tube


def pendulum(t, x, v):
    """Kinetic minus potential energy over m l², for a length at which g/l = 1/s²; x[0] is the angle from below."""
    return v[0] ** 2 / 2 + ca.cos(x[0])


def film(t, x, v):
    """Area per length and 2π of the surface of revolution with radius x."""
    return x[0] * ca.sqrt(1 + v[0] ** 2)


def torus(t, x, v):
    """Half the squared speed; x[0] is the angle round the tube from the outer equator, x[1] that round the axis."""
    axis, tube = RADII
    return (tube**2 * v[0] ** 2 + (axis + tube * ca.cos(x[0])) ** 2 * v[1] ** 2) / 2


def mirrored(x):
    """The torus upside down."""
    return np.array([[-1.0], [1.0]]) * x


def main(plot=None):
    """Search three times; returns the pendulum's paths up to an action, both films, and the geodesics."""
    swinging = cg.BoundaryProblem(pendulum, (0.0, 10.0), start=[0.0], end=[1.0])
    swings = cg.paths(swinging, cg.Galerkin(degree=8), intervals=20)
    rings = cg.BoundaryProblem(film, (-HALF_DISTANCE, HALF_DISTANCE), start=[1.0], end=[1.0])
    films = cg.paths(rings, cg.Galerkin(degree=8), intervals=16)
    turns = cg.BoundaryProblem(torus, (0.0, 1.0), start=[0.0, 0.0], end=[0.0, 4 * np.pi])
    geodesics = cg.paths(turns, cg.Galerkin(degree=8), intervals=24, symmetries=[mirrored])
    if plot:
        draw(swings, films, geodesics, plot)
    return [path for path in swings if path.action <= ACTION], films, geodesics


def draw(swings, films, geodesics, name):
    """Draw the three sets, each into one picture."""
    import matplotlib.pyplot as plt

    _, (left, middle, right) = plt.subplots(1, 3, figsize=(12.0, 5.0), layout="constrained")
    swings.plot(axes=left, label="angle in rad", time="t in s")
    films.plot(axes=middle, label="radius, in radii of the rings", time="place on the axis")
    geodesics.plot(axes=right, label="angle round the tube in rad", time="part of the way")
    for axes, title in ((left, "Swings of a pendulum"), (middle, "Soap films"), (right, "Geodesics of a torus")):
        axes.set_title(title)
        indices = [line.get_label().rpartition(", ")[2] for line in axes.lines]
        axes.legend(axes.lines, indices, fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2)
    save(left, name)


if __name__ == "__main__":
    for found in main(picture("all_paths.png")):
        print(found if isinstance(found, cg.Paths) else f"{len(found)} swings of action up to {ACTION}")
        for path in found:
            print(f"  action {path.action:.12f}, Morse index {path.morse_index}")
