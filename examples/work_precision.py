"""Speed against accuracy on one problem, in every way there is: degrees, rules, solvers, tolerances, shooting.

A pendulum goes nearly over the top between two angles in ten seconds.  Between the joints the error of degree m falls
with N^-(m+1), whatever the rule, so the higher degree wins as soon as a few digits are asked for.  What a tolerance
takes to find a mesh is paid once: solves on that mesh are among the fastest.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

DURATION, ANGLE = 10.0, 1.0
DEGREES, INTERVALS, TOLERANCES = (1, 2, 4, 8), (20, 40, 80), (1e-4, 1e-7, 1e-10)
RULES = (lambda m: cg.gauss(m), lambda m: cg.gauss(m + 1), lambda m: cg.lobatto(m + 1))
METHODS = [cg.Galerkin(m, quadrature=rule(m)) for m in DEGREES for rule in RULES]
SOLVERS = (cg.newton, cg.rootfinder, cg.ipopt)


def main():
    """Measure the trade, from the same coarse path in every way; returns it."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), (0.0, DURATION), [0.0], [ANGLE])
    coarse = cg.solve(  # the guess is one half oscillation of large amplitude
        problem, cg.Galerkin(3), 12, guess=lambda t: [ANGLE * t / DURATION + 3 * np.sin(np.pi * t / DURATION)]
    )
    return cg.trade(problem, METHODS, INTERVALS, tolerances=TOLERANCES, solvers=SOLVERS, shooting=True, guess=coarse)


def draw(measured):
    """Draw errors over the times of repeated solves; returns the figure."""
    axes = measured.plot()
    axes.set_title("A pendulum nearly over the top: what an error costs")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"cheapest within 1e-6: {answer.cheapest(1e-6).way}")
    for tol in (1e-2, 1e-4, 1e-6, 1e-9, 1e-12):
        for way in ("newton", "rootfinder", "ipopt", "shooting"):
            rows = [row for row in answer.rows if row.way == way and row.error <= tol]
            again, first = min(row.solve_seconds for row in rows), min(row.first_seconds for row in rows)
            print(f"{tol:g} by {way}: {1e3 * again:.2f} ms when repeated, {1e3 * first:.2f} ms in a first call")
    answer.to_csv("work_precision.csv")
    draw(answer).savefig("work_precision.png")
