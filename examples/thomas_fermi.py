"""The atom of Thomas and Fermi: how fast its potential falls at the nucleus, to ten digits, with their error.

The electrons of a heavy atom screen its nucleus: y'' = √(y³/t) with y(0) = 1 and y → 0 far away.  What is wanted is one
number, the slope at the nucleus, where the equation is singular; the path itself need not be known as well.  In t,
whose root the path contains, no mesh gives it, and the refusal says so.  In s = √t it is smooth, and the slope is the
momentum ∂L/∂(dy/ds) = (dy/ds)/(2s), which is regular at the nucleus.

Far away y tends to 144/t³, slowly; but what the end is missed by fades as t^-7.8 towards the nucleus.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

SLOPE = -1.588071022611375  # J. P. Boyd, Journal of Computational and Applied Mathematics 244 (2013), 90-101
FAR = 400.0


def atom():
    """The potential over s = √t."""
    return cg.BoundaryProblem(
        lambda s, y, w: w[0] ** 2 / (4 * s) + 0.8 * ca.fmax(y[0], 0) ** 2.5,
        t_span=(0.0, FAR**0.5),
        start=[1.0],
        end=[144 / FAR**3],
    )


def slope(path):
    """The slope dy/dt at the nucleus."""
    return path.momentum[0, 0]


def main():
    """Solve until the slope is known to 1e-10."""
    return cg.solve(atom(), tol=1e-10, of=slope, guess=lambda s: [1 / (1 + s**2) ** 2])


def draw(path):
    """Draw the potential over the distance; returns the figure."""
    axes = cg.panels()
    s = np.linspace(0, 5, 400)
    axes.plot(s**2, path(s)[0])
    axes.plot([0, -1 / path.asked], [1, 0], "--", color="0.6")
    axes.set(
        xlabel="distance from the nucleus",
        ylabel="screening y",
        title=f"The atom of Thomas and Fermi: slope {path.asked:.10f}",
    )
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"  slope       {answer.asked:.12f} at the nucleus, published {SLOPE:.12f}")
    draw(answer).savefig("thomas_fermi.png")
