"""Bratu's problem, x'' + λ exp(x) = 0: two paths meet in a fold, and beyond it there is none.

The exact fold is where θ = √(2λ) cosh(θ/4) has a double root.  Continuation begins on the
lower branch at λ = 1 and aims at λ = 4; at the fold λ turns back, and reaches 1 again on the upper branch.
"""

import casadi as ca
import numpy as np
from show import canvas, picture, save

import casadi_galerkin as cg

FOLD = 3.513830719125162


def lagrangian(t, x, v, p):
    """Lagrangian of x'' = -λ exp(x), p = (λ,)."""
    return v[0] ** 2 / 2 - p[0] * ca.exp(x[0])


def main(plot=None):
    """Follow the branch; with `plot`, the name of a file, draw the height of its paths over λ."""
    problem = cg.BoundaryProblem(lagrangian, (0.0, 1.0), [0.0], [0.0], parameters=[1.0])
    branch = cg.continuation(problem, [4.0], cg.Galerkin(degree=8), intervals=10)
    if plot:
        draw(branch, plot)
    return branch


def draw(branch, name):
    """Draw the branch with its fold."""
    axes = canvas("Bratu's problem", "λ", "x(1/2)")
    heights = np.array([path(0.5)[0] for path in branch.trajectories])
    for index, label in ((0, "local minima of the action"), (1, "saddles, Morse index 1")):
        chosen = [path.morse_index == index for path in branch.trajectories]
        axes.plot(branch.parameters[chosen, 0], heights[chosen], ".-", label=label)
    fold = branch.folds[0]
    axes.plot(fold.parameters[0], fold.path(0.5)[0], "k+", markersize=12, label=f"fold, λ = {fold.parameters[0]:.9f}")
    axes.legend(loc="center left")
    save(axes, name)


if __name__ == "__main__":
    answer = main(picture("bratu.png"))
    print(answer)
    print(f"  fold at λ = {answer.folds[0].parameters[0]:.13f}, exact {FOLD}")
