"""Troesch's problem, x'' = λ sinh(λx), whose layer at t = 1 defeats most solvers from λ = 10 on.

From the straight line, with nothing but a tolerance.  The slope at the end and the one at the start, which is 21
orders of magnitude smaller at λ = 50, belong together by the conserved energy x'²/2 - cosh(λx).
"""

import casadi as ca
import numpy as np
from show import canvas, picture, save

import casadi_galerkin as cg

RATES = (5.0, 10.0, 20.0, 30.0, 50.0)


def lagrangian(t, x, v, p):
    """Lagrangian of x'' = λ sinh(λx), p = (λ,)."""
    return v[0] ** 2 / 2 + ca.cosh(p[0] * x[0])


def main(plot=None):
    """Solve for every λ to a relative error of 1e-9; returns {λ: Trajectory}."""
    paths = {}
    for rate in RATES:
        problem = cg.BoundaryProblem(lagrangian, (0.0, 1.0), [0.0], [1.0], parameters=[rate])
        paths[rate] = cg.solve(problem, tol=1e-9)
    if plot:
        draw(paths, plot)
    return paths


def draw(paths, name):
    """Draw the paths, joints as dots."""
    axes = canvas("Troesch's problem", "distance from the end, 1 - t", "x")
    for rate, path in paths.items():
        times = np.unique(np.concatenate((path.t, 1 - np.logspace(-14, 0, 500))))
        (line,) = axes.plot(1 - times[:-1], path.path(times[:-1])[0], label=f"λ = {rate:g}")
        axes.plot(1 - path.t[:-1], path.x[0, :-1], ".", color=line.get_color())
    axes.set(xscale="log")
    axes.legend()
    save(axes, name)


if __name__ == "__main__":
    for rate, path in main(picture("troesch.png")).items():
        print(
            f"λ = {rate:2g}: x'(0) = {path.velocity[0, 0]:.10e}, x'(1) = {path.velocity[0, -1]:.12e}, "
            f"{len(path.t) - 1} intervals, shortest {np.diff(path.t).min():.1e}"
        )
