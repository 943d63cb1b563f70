"""Speed against accuracy on one problem, in every way there is: degrees, rules, solvers, tolerances, shooting.

A pendulum goes nearly over the top between two angles in ten seconds.  Between the joints the error of degree m falls
with N^-(m+1), whatever the rule, so the higher degree wins as soon as a few digits are asked for.  What a tolerance
takes to find a mesh is paid once: solves on that mesh are among the fastest.
"""

import casadi as ca
import numpy as np
from show import picture, save

import casadi_galerkin as cg

DURATION, ANGLE = 10.0, 1.0
DEGREES, INTERVALS, TOLERANCES = (1, 2, 4, 8), (20, 40, 80), (1e-4, 1e-7, 1e-10)
RULES = (lambda m: cg.gauss(m), lambda m: cg.gauss(m + 1), lambda m: cg.lobatto(m + 1))
METHODS = [cg.Galerkin(m, quadrature=rule(m)) for m in DEGREES for rule in RULES]
SOLVERS = (cg.newton, cg.rootfinder, cg.ipopt)


def main(plot=None):
    """Measure the trade, from the same coarse path in every way; returns it."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), (0.0, DURATION), [0.0], [ANGLE])
    coarse = cg.solve(  # the guess is one half oscillation of large amplitude
        problem, cg.Galerkin(3), 12, guess=lambda t: [ANGLE * t / DURATION + 3 * np.sin(np.pi * t / DURATION)]
    )
    measured = cg.trade(
        problem, METHODS, INTERVALS, tolerances=TOLERANCES, solvers=SOLVERS, shooting=True, guess=coarse
    )
    if plot:
        axes = measured.plot()
        axes.set_title("A pendulum nearly over the top: what an error costs")
        save(axes, plot)
    return measured


if __name__ == "__main__":
    measured = main(picture("work_precision.png"))
    print(measured)
    for tol in (1e-2, 1e-4, 1e-6, 1e-9):
        for name, first_call in (("first call", True), ("repeated", False)):
            row = measured.cheapest(tol, first_call)
            cost = 1e3 * (row.first_seconds if first_call else row.solve_seconds)
            print(f"cheapest {name} within {tol:g}: {row.way}, {row.method}, {row.intervals} intervals, {cost:.2f} ms")
