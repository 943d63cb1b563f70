"""Bratu's problem, x'' + λ exp(x) = 0: two paths meet in a fold, and beyond it there is none.

The exact fold is where θ = √(2λ) cosh(θ/4) has a double root.  Continuation begins on the
lower branch at λ = 1 and aims at λ = 4; at the fold λ turns back, and reaches 1 again on the upper branch.
"""

import casadi as ca

import casadi_galerkin as cg

FOLD = 3.513830719125162


def lagrangian(t, x, v, p):
    """Lagrangian of x'' = -λ exp(x), p = (λ,)."""
    return v[0] ** 2 / 2 - p[0] * ca.exp(x[0])


def main():
    """Follow the branch."""
    problem = cg.BoundaryProblem(lagrangian, (0.0, 1.0), [0.0], [0.0], parameters=[1.0])
    return cg.continuation(problem, [4.0], cg.Galerkin(degree=8), intervals=10)


def draw(branch):
    """Draw the height of the paths over λ; returns the figure."""
    axes = branch.plot(lambda path: path(0.5)[0])
    axes.set(title=f"Bratu's problem, folded at λ = {branch.folds[0].parameters[0]:.9f}", xlabel="λ", ylabel="x(1/2)")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"  fold at λ = {answer.folds[0].parameters[0]:.13f}, exact {FOLD}")
    draw(answer).savefig("bratu.png")
