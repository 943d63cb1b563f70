"""Geodesics of an ellipsoid, x² + y²/0.64 + z²/0.36 = 1: many join two of its vertices, and one is shortest.

The surface is a constraint.  Jacobi found (1838) that along a geodesic the product of two numbers does not change:
Q = Σ (x_i/a_i²)², which belongs to the normal, and Σ (v_i/a_i)², which belongs to the direction (Joachimsthal's).
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

AXES = np.array([1.0, 0.8, 0.6])


def surface(t, x):
    """Zero on the ellipsoid."""
    return ca.sumsqr(x / AXES) - 1


def main():
    """Find six geodesics from (1, 0, 0) to (0, 0.8, 0)."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2, (0.0, 1.0), start=[1.0, 0.0, 0.0], end=[0.0, 0.8, 0.0], constraint=surface
    )
    return cg.paths(problem, cg.Galerkin(degree=8), intervals=14, count=6)


def length(path):
    """Length of a geodesic, which is run through at an even speed."""
    return np.sqrt(2 * path.action)


def draw(found):
    """Draw all geodesics on the ellipsoid, seen along z and along y; returns the figure."""
    panels = cg.panels(columns=2, size=(8.6, 4.0))
    angles = np.linspace(0, 2 * np.pi, 200)
    for axes, (i, j) in zip(panels, ((0, 1), (0, 2)), strict=True):
        axes.plot(AXES[i] * np.cos(angles), AXES[j] * np.sin(angles), color="0.7")
        for path in found:
            places = path(np.linspace(0, 1, 400))
            axes.plot(places[i], places[j], label=f"{length(path):.4f}, index {path.morse_index}")
        axes.set(xlabel="xyz"[i], ylabel="xyz"[j], aspect="equal")
    panels[0].set_title("Geodesics of an ellipsoid")
    panels[1].legend(title="length", fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    return panels[0].figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    for path in answer:
        print(f"  length {length(path):.9f}")
    draw(answer).savefig("ellipsoid.png")
