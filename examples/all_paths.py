"""All stationary paths without a guess: swings of a pendulum, soap films, geodesics of a torus.

A pendulum hangs down and is at 1 rad ten seconds later: in how many ways?  Two soap films span two rings.  Two points
of a torus, two turns apart on its outer equator, are joined by the equator itself, which is no shortest way, and by
geodesics that cross it; each of these has a mirror image, which is not listed.

No search proves that nothing is missing.  But of the swings, and of the geodesics with their mirror images, one more
has an even Morse index than an odd one, as Morse's theory asks of paths that can be drawn into one another.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

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


def main():
    """Search three times; returns the pendulum's swings, both films, and the geodesics."""
    swinging = cg.BoundaryProblem(pendulum, (0.0, 10.0), start=[0.0], end=[1.0])
    swings = cg.paths(swinging, cg.Galerkin(degree=8), intervals=16)
    rings = cg.BoundaryProblem(film, (-HALF_DISTANCE, HALF_DISTANCE), start=[1.0], end=[1.0])
    films = cg.paths(rings, cg.Galerkin(degree=8), intervals=16)
    turns = cg.BoundaryProblem(torus, (0.0, 1.0), start=[0.0, 0.0], end=[0.0, 4 * np.pi])
    geodesics = cg.paths(turns, cg.Galerkin(degree=8), intervals=16, symmetries=[mirrored])
    return swings, films, geodesics


def draw(answer):
    """Draw the three sets, each into one picture; returns the figure."""
    panels = cg.panels(3, size=(4.6, 7.6))
    titles = "Swings of a pendulum", "Soap films", "Geodesics of a torus"
    names = (
        ("angle in rad", "t in s"),
        ("radius, of the rings'", "place on the axis"),
        ("angle in rad", "part of the way"),
    )
    for axes, paths, title, (label, time) in zip(panels, answer, titles, names, strict=True):
        paths.plot(axes=axes, labels=label, time=time).set_title(title)
        indices = [f"index {path.morse_index}" for path in paths]
        axes.legend(axes.lines, indices, fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    return axes.figure


if __name__ == "__main__":
    answer = main()
    for found in answer:
        print(found)
        for path in found:
            print(f"  action {path.action:.12f}, Morse index {path.morse_index}")
    draw(answer).savefig("all_paths.png")
