"""A damped and driven oscillator, x'' + c x' + ω₀² x = A cos(ωt), with its friction and drive as forces.

Damping shrinks areas of (x, p) by the same factor in every step, e^{-c h}: the determinant of the step's Jacobian shows
it.  The motion settles into the response of amplitude A / √((ω₀² - ω²)² + c²ω²), whatever the start.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import casadi_galerkin as cg

STIFFNESS, DAMPING = 4.0, 0.5  # ω₀² and c, for a mass of 1
DRIVE, FREQUENCY = 1.0, 1.5  # A and ω
DURATION, INTERVALS = 80.0, 160
STEP = DURATION / INTERVALS
RESPONSE = DRIVE / np.hypot(STIFFNESS - FREQUENCY**2, DAMPING * FREQUENCY)


def lagrangian(t: ca.SX, x: ca.SX, v: ca.SX) -> ca.SX:
    """Mass of 1 on a spring."""
    return v[0] ** 2 / 2 - STIFFNESS * x[0] ** 2 / 2


def force(t: ca.SX, x: ca.SX, v: ca.SX) -> list[ca.SX]:
    """Friction and drive."""
    return [DRIVE * ca.cos(FREQUENCY * t) - DAMPING * v[0]]


def response(t: np.ndarray) -> np.ndarray:
    """Motion after the start is forgotten."""
    phase = np.arctan2(DAMPING * FREQUENCY, STIFFNESS - FREQUENCY**2)
    return RESPONSE * np.cos(FREQUENCY * t - phase)


def main() -> tuple[cg.Trajectory, cg.Geometry]:
    """Step from x = 2 at rest into the response; returns the path and its geometry."""
    problem = cg.InitialProblem(lagrangian, (0, DURATION), start=[2.0], velocity=[0.0], force=force)
    path = cg.solve(problem, cg.Galerkin(degree=6), INTERVALS)
    return path, cg.geometry(path)


def draw(answer):
    """Draw the motion over the response that it settles into; returns the figure."""
    path, axes = answer[0], cg.panels()
    times = np.linspace(0, DURATION / 2, 1000)
    axes.plot(times, path(times)[0], label="from x = 2 at rest")
    axes.plot(times, response(times), "k:", label="response")
    axes.set(title="A damped and driven oscillator", xlabel="t in s", ylabel="x in m")
    axes.legend(fontsize="small")
    return axes.figure


if __name__ == "__main__":
    answer = path, measured = main()
    print(path)
    print(f"determinant of a step: {measured.determinants[0]:.12g}, e^(-c h) = {np.exp(-DAMPING * STEP):.12g}")
    left, shrunk = abs(path.x[0, -1] - response(path.t[-1])), np.exp(-DAMPING * DURATION / 2)
    print(f"from the response at the end: {left:.1e}; what the start adds has shrunk to {shrunk:.1e} of it")
    draw(answer).savefig("driven_oscillator.png")
