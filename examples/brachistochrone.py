"""The curve of fastest descent between two points of a cycloid, both below the point of release.

L = √((1 + v²)/(2x)) is time per horizontal length t, for unit gravity and depth x below the point where the bead was
at rest.  There, at x = 0, L is singular; between two later points the problem is regular.  The cycloid
t = θ - sin θ, x = 1 - cos θ is run through in the time θ; a point on the rim of a rolling wheel of radius 1 draws it.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

FIRST, LAST = 0.5, 2.5  # the cycloid's θ at the ends; the descent takes LAST - FIRST


def lagrangian(t, x, v):
    """Time per horizontal length at depth x[0] and slope v[0]."""
    return ca.sqrt((1 + v[0] ** 2) / (2 * x[0]))


def cycloid(angle):
    """Horizontal position and depth."""
    return np.array([angle - np.sin(angle), 1 - np.cos(angle)])


def main():
    """Solve between two points of the cycloid."""
    (begin, start), (finish, end) = cycloid(FIRST), cycloid(LAST)
    problem = cg.BoundaryProblem(lagrangian, (begin, finish), [start], [end])
    return cg.solve(problem, cg.Galerkin(degree=12), mesh=begin + (finish - begin) * np.linspace(0, 1, 25) ** 2)


def draw(path):
    """Draw depth downwards, on the whole cycloid; returns the figure."""
    axes = cg.panels()
    axes.plot(*cycloid(np.linspace(0, np.pi, 200)), color="0.8", linewidth=4, label="cycloid")
    path.plot(axes)
    axes.set(title="The curve of fastest descent", aspect="equal")
    axes.set(xlabel="horizontal place, in radii of the wheel", ylabel="depth, in radii of the wheel")
    axes.lines[1].set_label(f"found, takes {path.action:.6f}")
    axes.invert_yaxis()
    axes.legend()
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"  time        {answer.action:.15f}, exact {LAST - FIRST}")
    draw(answer).savefig("brachistochrone.png")
