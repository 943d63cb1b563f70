"""Known integrators are one method with different rules: symplectic Euler, midpoint, Verlet, and higher orders.

A path of degree 1 with the left rectangle is the symplectic Euler method, with one point in the middle the midpoint
rule, with the trapezoid that of Störmer and Verlet.  All are symplectic: the energy of a pendulum oscillates by an
error of their order, and does not drift.  Control points only describe the same polynomials by other values: the path
is the same but for rounding.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

START, DURATION, STEPS = 2.0, 20.0, (100, 200, 400, 800)  # rad, in units of √(length / gravity)
METHODS = {
    "symplectic Euler": cg.Galerkin(1, quadrature=cg.left_rectangle()),
    "midpoint": cg.Galerkin(1, quadrature=cg.midpoint()),
    "Störmer-Verlet": cg.Galerkin(1, quadrature=cg.trapezoid()),
    "degree 2, Radau": cg.Galerkin(2, quadrature=cg.radau(2)),
    "degree 2, Gauss": cg.Galerkin(2, quadrature=cg.gauss(2)),
    "degree 2, Lobatto": cg.Galerkin(2, quadrature=cg.lobatto(3)),
    "degree 3, Gauss": cg.Galerkin(3, quadrature=cg.gauss(3)),
}
POINTS = (cg.lobatto_points, cg.chebyshev_points, cg.equispaced_points)


def lagrangian(t, x, v):
    """Kinetic minus potential energy of a pendulum, in units of its mass, length and gravity."""
    return v[0] ** 2 / 2 + ca.cos(x[0])


def main():
    """Trade all rules by the angle at the end, step with the coarsest, and join two angles with all control points."""
    falling = cg.InitialProblem(lagrangian, (0.0, DURATION), start=[START], velocity=[0.0])
    measured = cg.trade(falling, METHODS.values(), STEPS, of=lambda path: path.x[0, -1])
    paths = {name: cg.solve(falling, method, STEPS[0]) for name, method in METHODS.items()}
    joining = cg.BoundaryProblem(lagrangian, (0.0, 3.0), start=[START], end=[-START])
    same = [cg.solve(joining, cg.Galerkin(8, control_points=points(8)), intervals=6) for points in POINTS]
    return measured, paths, same


def draw(answer):
    """Draw the errors of the energy along the paths of fewest steps; returns the figure."""
    axes = cg.panels(size=(5.6, 3.8))
    for name, path in answer[1].items():
        axes.semilogy(path.t[1:], np.abs(path.energy[1:] / path.energy[0] - 1), label=name)
    axes.set(title=f"A pendulum in {STEPS[0]} steps by seven rules", xlabel="t", ylabel="relative error of the energy")
    axes.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
    return axes.figure


if __name__ == "__main__":
    answer = measured, paths, same = main()
    for name, method in METHODS.items():
        changes = np.abs(paths[name].energy / paths[name].energy[0] - 1)
        first, last = (np.max(part) for part in np.array_split(changes, 2))
        print(f"{name:18} order {measured.order(method):.1f}, energy off by {first:.0e} and {last:.0e} in both halves")
    apart = np.ptp([path(np.linspace(0, 3, 100)) for path in same], axis=0).max()
    print(f"control points of three kinds, degree 8: the same path to {apart:.0e}")
    draw(answer).savefig("classical_rules.png")
