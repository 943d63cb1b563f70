"""A boundary layer of thickness 1e-4: ε x'' = x with x(0) = 1, x(1) = 0 and ε = 1e-8.

Equal intervals see nothing of the layer; the refinement finds it and grades the mesh towards it.  What that costs is
measured against the exact x = sinh((1 - t)/√ε) / sinh(1/√ε).
"""

import numpy as np

import casadi_galerkin as cg

THICKNESS = 1e-4


def lagrangian(t, x, v):
    """Lagrangian of ε x'' = x."""
    return THICKNESS**2 * v[0] ** 2 / 2 + x[0] ** 2 / 2


def exact(t):
    """Exact path."""
    return np.exp(-t / THICKNESS) * np.expm1(-2 * (1 - t) / THICKNESS) / np.expm1(-2 / THICKNESS)


def main():
    """Solve to a relative error of 1e-9."""
    return cg.solve(cg.BoundaryProblem(lagrangian, (0.0, 1.0), [1.0], [0.0]), tol=1e-9)


def cost(path):
    """The trade of time for error, of tolerances and of fine equal meshes."""
    few = [cg.Galerkin(4), cg.Galerkin(12)]
    return cg.trade(path.problem, few, [100, 1000], lambda t: [exact(t)], tolerances=[1e-3, 1e-6, 1e-9])


def draw(path):
    """Draw the layer with its joints, and how long the intervals are; returns the figure."""
    top, bottom = cg.panels(2, size=(4.6, 4.8))
    times = np.linspace(0, 20 * THICKNESS, 500)
    joints = path.t[path.t <= times[-1]]
    top.plot(1e4 * times, path(times)[0])
    top.plot(1e4 * joints, path(joints)[0], "o", markersize=4, label="joints")
    top.set(title="A boundary layer of thickness 1e-4", xlabel="10,000 t", ylabel="x")
    top.legend()
    bottom.loglog(path.t[1:], np.diff(path.t), ".-")
    bottom.set(title="Its mesh", xlabel="t", ylabel="length of the interval before t")
    return top.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    times = answer.polynomial.times(np.linspace(0, 1, 20))  # on every interval
    print(f"  error       {np.max(np.abs(answer(times)[0] - exact(times))):.1e}")
    print(cost(answer))
    draw(answer).savefig("boundary_layer.png")
