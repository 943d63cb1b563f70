"""A boundary layer of thickness 1e-4: ε x'' = x with x(0) = 1, x(1) = 0 and ε = 1e-8.

Eight equal intervals see nothing of the layer; the refinement finds it and grades the mesh towards it.  Exact:
x = sinh((1 - t)/√ε) / sinh(1/√ε).
"""

import numpy as np
from show import canvas, dense, picture, save

import casadi_galerkin as cg

THICKNESS = 1e-4


def lagrangian(t, x, v):
    """Lagrangian of ε x'' = x."""
    return THICKNESS**2 * v[0] ** 2 / 2 + x[0] ** 2 / 2


def exact(t):
    """Exact path."""
    return np.exp(-t / THICKNESS) * np.expm1(-2 * (1 - t) / THICKNESS) / np.expm1(-2 / THICKNESS)


def main(plot=None):
    """Solve to a relative error of 1e-9; with `plot`, the name of a file, draw the layer and the mesh."""
    path = cg.solve(cg.BoundaryProblem(lagrangian, (0.0, 1.0), [1.0], [0.0]), tol=1e-9)
    if plot:
        draw(path, plot)
    return path


def draw(path, name):
    """Draw the layer over the logarithm of time."""
    axes = canvas("A boundary layer of thickness 1e-4", "t", "x", xscale="log")
    times = np.logspace(-6, 0, 500)
    axes.plot(times, path(times)[0])
    axes.plot(path.t[1:], path.x[0, 1:], ".", label="joints")
    axes.legend()
    save(axes, name)


if __name__ == "__main__":
    answer = main(picture("boundary_layer.png"))
    print(answer)
    times = dense(answer)
    print(f"  error        {np.max(np.abs(answer(times)[0] - exact(times))):.1e}")
