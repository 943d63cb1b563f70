"""Troesch's problem, x'' = λ sinh(λx), whose layer at t = 1 defeats `solve_bvp` on equal intervals from λ = 20 on.

From the straight line, with nothing but a tolerance.  By the conserved energy x'²/2 - cosh(λx) the slopes at both ends
belong together, x'(1)² = x'(0)² + 4 sinh²(λ/2).  The one at the start falls like e^-λ, and from λ = 20 on it is below
what a tolerance relative to x, which is 1 at its largest, can resolve; it is nothing then to the one at the end.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

RATES = (5.0, 10.0, 20.0, 30.0, 50.0)


def lagrangian(t, x, v, p):
    """Lagrangian of x'' = λ sinh(λx), p = (λ,)."""
    return v[0] ** 2 / 2 + ca.cosh(p[0] * x[0])


def main():
    """Solve for every λ to a relative error of 1e-9; returns {λ: Trajectory}."""
    paths = {}
    for rate in RATES:
        problem = cg.BoundaryProblem(lagrangian, (0.0, 1.0), [0.0], [1.0], parameters=[rate])
        paths[rate] = cg.solve(problem, tol=1e-9)
    return paths


def slope_at_end(rate, slope_at_start):
    """x'(1) by conservation of the energy."""
    return np.hypot(slope_at_start, 2 * np.sinh(rate / 2))


def draw(paths):
    """Draw the paths over the logarithm of the distance from the end, joints as dots; returns the figure."""
    axes = cg.panels(size=(4.6, 3.6))
    for rate, path in paths.items():
        times = np.unique(np.concatenate((path.t, 1 - np.logspace(-14, 0, 500))))
        (line,) = axes.plot(1 - times[:-1], path(times[:-1])[0], label=f"λ = {rate:g}")
        axes.plot(1 - path.t[:-1], path.x[0, :-1], ".", color=line.get_color())
    axes.set(title="Troesch's problem", xlabel="distance from the end, 1 - t", ylabel="x", xscale="log")
    axes.legend(fontsize="small")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    for rate, path in answer.items():
        first, last = path.velocity[0, [0, -1]]
        start = f"{first:.4e}" if abs(first) > 1e-6 else "unresolved"
        print(
            f"λ = {rate:2g}: x'(0) = {start:10}, x'(1) = {last:.10e}, by the energy {slope_at_end(rate, first):.10e}, "
            f"{len(path.t) - 1} intervals, shortest {np.diff(path.t).min():.1e}"
        )
    draw(answer).savefig("troesch.png")
