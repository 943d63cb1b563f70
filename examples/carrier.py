"""Carrier's problem, ε² x'' + 2 (1 - t²) x + x² = 1 between zeros: the smaller ε is, the more paths there are.

At ε = 0.3 there are 4 paths, at 0.15 there are 12, and at 0.1 there are 16.  As ε grows they vanish again: two that
mirror each other end at a symmetric one in a pitchfork, and two symmetric ones meet in a fold.  The families are not
connected with one another between these ε, so the picture is drawn family by family.
"""

import numpy as np

import casadi_galerkin as cg

COUNTS = {0.3: 4, 0.15: 12, 0.1: 16}  # numbers of paths
LARGEST = 0.5  # ε up to which they are followed
METHOD, INTERVALS = cg.Galerkin(degree=8), 32


def lagrangian(t, x, v, p):
    """Lagrangian of Carrier's equation, p = (ε,)."""
    return (p[0] * v[0]) ** 2 / 2 - (1 - t**2) * x[0] ** 2 - x[0] ** 3 / 3 + x[0]


def problem(small):
    """The problem for one ε."""
    return cg.BoundaryProblem(lagrangian, (-1.0, 1.0), [0.0], [0.0], parameters=[small])


def main():
    """Find all paths at three ε, and follow those of the least one; returns both."""
    found = {small: cg.paths(problem(small), METHOD, INTERVALS, count=20) for small in COUNTS}
    diagrams = []
    for path in found[0.1]:
        reached = [branch.trajectories[-1] for diagram in diagrams for branch in diagram.branches]
        if not any(np.allclose(path.x, other.x, atol=1e-6) for other in reached if other.parameters == (0.1,)):
            followed = cg.continuation(problem(0.1), [LARGEST], METHOD, INTERVALS, branches=12, guess=path)
            diagrams.append(followed)
    return found, diagrams


def draw(answer):
    """Draw the slope at the start over ε, of all families; returns the figure."""
    axes = cg.panels(size=(6.4, 4.4))
    for diagram in answer[1]:
        diagram.plot(lambda path: path(-1.0, 1)[0], axes=axes)
    axes.set(title="All paths of Carrier's problem", xlabel="ε", ylabel="x'(-1)")
    axes.legend(fontsize="small", ncols=2)
    return axes.figure


if __name__ == "__main__":
    answer = main()
    for small, paths in answer[0].items():
        print(f"ε = {small}: {paths}")
    for diagram in answer[1]:
        print(diagram)
    draw(answer).savefig("carrier.png")
