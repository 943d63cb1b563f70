"""A balanced pendulum over a long horizon, x'' = x: shooting loses every digit, the global solve keeps them.

The path from 1 to 1, x = (e^{-t} + e^{t-T}) / (1 + e^{-T}), rises to upright and falls from there again.  Both
ends hold it: a change of one is felt over a unit of time, whatever T.  A change of the start's momentum alone grows
e^T times.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import casadi_galerkin as cg

HORIZONS = (10, 40, 200, 700)
STEPS_A_UNIT = 2


def lagrangian(t: ca.SX, x: ca.SX, v: ca.SX) -> ca.SX:
    """Pendulum near upright, in units of its own time; x is the angle from there."""
    return v[0] ** 2 / 2 + x[0] ** 2 / 2


def exact(t: np.ndarray, horizon: float) -> np.ndarray:
    """The path in closed form, written so that nothing overflows."""
    return (np.exp(-t) + np.exp(t - horizon)) / (1 + np.exp(-horizon))


def main() -> dict[int, tuple[cg.Comparison, float]]:
    """By horizon, the comparison and the largest error of the global path relative to the path's size 1."""
    results = {}
    for horizon in HORIZONS:
        problem = cg.BoundaryProblem(lagrangian, (0, horizon), start=[1], end=[1])
        comparison = cg.compare(problem, cg.Galerkin(degree=8), intervals=STEPS_A_UNIT * horizon)
        path = comparison.global_path
        results[horizon] = comparison, float(np.max(np.abs(path.x[0] - exact(path.t, horizon))))
    return results


def draw(results):
    """Draw the comparison at the second horizon; returns the figure."""
    axes = results[HORIZONS[1]][0].plot(time="t in units of the pendulum's own time")
    axes.set_title("The start's last digit grows with exp(t)")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    for comparison, error in answer.values():
        print(comparison)
        print(f"  error of the global path: {error:.1e}\n")
    draw(answer).savefig("inverted_pendulum.png")
