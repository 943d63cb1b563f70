"""The elastica: an elastic rod buckles under a load, in all shapes between 0 and a hundred times its stiffness.

The angle x of a rod of length one obeys x'' + p sin x = 0, with the load p in units of stiffness over length squared.
Both ends are held straight, x = 0, while one may move.  The action is the energy of the rod and its load, so that a
shape of Morse index 0 is stable.  The straight rod is crossed at p = (kπ)² by the shapes that begin as x = sin(kπ s)
(Euler, 1744), and only the first of these is stable.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg


def lagrangian(s, x, v, p):
    """Strain energy over length, less that of the load p[0]; x[0] is the angle and s the place on the rod."""
    return v[0] ** 2 / 2 + p[0] * ca.cos(x[0])


def main():
    """Follow the straight rod and all that branches off; returns the straight branch, which has the others."""
    rod = cg.BoundaryProblem(lagrangian, (0.0, 1.0), start=[0.0], end=[0.0], parameters=[5.0])
    return cg.continuation(rod, [100.0], cg.Galerkin(degree=8), intervals=12, branches=12)


def shape(path):
    """The rod in the plane, from its angle."""
    s = np.linspace(0.0, 1.0, 201)
    slopes = np.array([np.cos(path(s)[0]), np.sin(path(s)[0])])
    return np.cumsum((slopes[:, 1:] + slopes[:, :-1]) / 2, axis=1) * s[1]


def draw(diagram):
    """Draw the angle at a quarter of the rod over the load, and one rod of every shape; returns the figure."""
    above, below = cg.panels(rows=2, size=(4.6, 6.4))
    diagram.plot(lambda path: path(0.25)[0], axes=above).set(xlabel="load p", ylabel="angle at a quarter in rad")
    above.set_title("An elastic rod under a load")
    for branch in diagram.branches[1::2]:
        path = branch.trajectories[-1]
        below.plot(*shape(path), label=f"from p = {branch.origin.parameters[0]:.6g}")
    below.set(title="Shapes at p = 100", aspect="equal", xlabel="along the load", ylabel="across")
    below.legend(fontsize="small")
    return above.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    for k, point in enumerate(answer.branch_points, start=1):
        print(f"  (kπ)² = {(k * np.pi) ** 2:.12f}, found {point.parameters[0]:.12f}")
    draw(answer).savefig("elastica.png")
