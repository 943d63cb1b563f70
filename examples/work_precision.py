"""Speed against accuracy on one problem: low against high degree, Gauss against Lobatto.

A pendulum goes nearly over the top between two angles in ten seconds.  Between the joints the error of degree m falls
with N^-(m+1), whatever the rule, so the higher degree wins as soon as a few digits are asked for.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

DURATION, ANGLE = 10.0, 1.0
METHODS = (
    cg.Galerkin(1),
    cg.Galerkin(2),
    cg.Galerkin(4),
    cg.Galerkin(4, quadrature=cg.lobatto(5)),
    cg.Galerkin(8),
    cg.Galerkin(8, quadrature=cg.lobatto(9)),
)
INTERVALS = (10, 20, 40, 80)
TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-9)


def lagrangian(t, x, v):
    """Kinetic minus potential energy for unit mass, length and gravity; x[0] is the angle from below."""
    return v[0] ** 2 / 2 + ca.cos(x[0])


def over(t):
    """Guess: one half oscillation of large amplitude."""
    return [ANGLE * t / DURATION + 3 * np.sin(np.pi * t / DURATION)]


def main():
    """Measure the trade; returns it."""
    problem = cg.BoundaryProblem(lagrangian, (0.0, DURATION), start=[0.0], end=[ANGLE])
    return cg.trade(problem, METHODS, INTERVALS, guess=over)


def draw(measured):
    """Draw errors over seconds; returns the figure."""
    axes = measured.plot()
    axes.set_title("A pendulum nearly over the top: what an error costs")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    for tolerance in TOLERANCES:
        row = answer.cheapest(tolerance)
        cost = f"{row.intervals} intervals, {1e3 * row.solve_seconds:.2f} ms"
        print(f"cheapest within {tolerance:g}: {row.method} on {cost}")
    answer.to_csv("work_precision.csv")
    draw(answer).savefig("work_precision.png")
