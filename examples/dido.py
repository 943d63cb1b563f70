"""Queen Dido's problem: as much land as a rope of given length encloses, along a straight shore.

The area, by Green's theorem, is ∫ (y x' - x y')/2 dt, which is linear in the velocities, and has no mass at all: that
comes with the given integral, ∫ (x'² + y'²)/2 dt = l²/2.  On its stationary paths the speed is constant, so that their
length is l.  The multiplier is the radius over the length, of an arc of a circle.

Between given ends the rope is an arc over their chord, shorter or longer than half a circle.  Where the end may be
anywhere on the shore, half a circle is best, with the area l²/2π: the natural condition there says that the rope meets
the shore at a right angle.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

CHORD, LENGTHS = 1.0, (1.2, 1.57, 2.5)  # in km


def problem(length, end):
    """State the rope from the origin to a place (end, 0), or to anywhere on the shore for None."""
    return cg.BoundaryProblem(
        lambda t, x, v: (x[0] * v[1] - x[1] * v[0]) / 2,  # minus the area to the right of the rope
        (0.0, 1.0),
        start=[0.0, 0.0],
        end=[end, 0.0],
        integral_conditions=(lambda t, x, v: ca.dot(v, v) / 2, [length**2 / 2]),
    )


def half_ellipse(t):
    """Guess: a way that leaves the shore; the straight one would have the least length."""
    return np.array([(1 - np.cos(np.pi * t)) / 2, np.sin(np.pi * t) / 2])


def main():
    """Enclose as much as possible over the chord, and then from the origin to anywhere."""
    method, ropes = cg.Galerkin(degree=8), [(length, CHORD) for length in LENGTHS] + [(LENGTHS[-1], None)]
    return [cg.solve(problem(length, end), method, intervals=8, guess=half_ellipse) for length, end in ropes]


def draw(ropes):
    """Draw all ropes on the shore; returns the figure."""
    axes = cg.panels(size=(4.8, 3.6))
    for rope in ropes:
        rope.plot_plane(axes=axes, labels=("along the shore in km", "inland in km"))
        axes.lines[-1].set_label(f"area {-rope.action:.4f} km²")
    axes.set_title("What a rope encloses")
    axes.legend(fontsize="small", loc="lower right")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    for rope in answer:
        length = np.sqrt(2 * rope.problem.integral_values[0])
        radius = rope.integral_multipliers[0] * length
        print(f"rope {length:.2f} km: radius {radius:.12f} km, area {-rope.action:.12f} km², {rope.morse_index=}")
    print(f"half a circle of the last length has {length**2 / (2 * np.pi):.12f} km²")
    draw(answer).savefig("dido.png")
