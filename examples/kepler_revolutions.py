"""Mercury around the Sun for 1000 revolutions, step by step: what a symplectic method keeps.

Units are astronomical units and years, so that GM = 4π².  Energy and angular momentum keep 13 digits, and the planet
returns to its perihelion after every period a^{3/2}.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import casadi_galerkin as cg

GM = 4 * np.pi**2
SEMI_MAJOR_AXIS, ECCENTRICITY = 0.387098, 0.205630
PERIOD = SEMI_MAJOR_AXIS**1.5
REVOLUTIONS, STEPS_A_REVOLUTION = 1000, 16


def lagrangian(t: ca.SX, x: ca.SX, v: ca.SX) -> ca.SX:
    """Kinetic minus potential energy, for a mass of 1."""
    return ca.dot(v, v) / 2 + GM / ca.norm_2(x)


def rotation(x: ca.SX) -> list[ca.SX]:
    """Generator of the rotations of the plane; its momentum map is the angular momentum."""
    return [-x[1], x[0]]


def main() -> tuple[cg.Trajectory, cg.Geometry]:
    """Step through all revolutions from the perihelion; returns the path and what it conserves."""
    perihelion = SEMI_MAJOR_AXIS * (1 - ECCENTRICITY)
    speed = np.sqrt(GM * (2 / perihelion - 1 / SEMI_MAJOR_AXIS))
    problem = cg.InitialProblem(lagrangian, (0, REVOLUTIONS * PERIOD), start=[perihelion, 0], velocity=[0, speed])
    path = cg.solve(problem, cg.Galerkin(degree=8), intervals=REVOLUTIONS * STEPS_A_REVOLUTION)
    conserved = cg.geometry(path, symmetry=rotation)
    return path, conserved


def draw(answer):
    """Draw the error of the energy; returns the figure."""
    path, axes = answer[0], cg.panels()
    axes.plot(path.t, 1e14 * (path.energy / path.energy[0] - 1), ".", markersize=1)
    axes.set(title="1000 revolutions of Mercury", xlabel="t in years", ylabel="relative error of the energy, 1e-14")
    return axes.figure


if __name__ == "__main__":
    answer = path, conserved = main()
    print(path)
    print(conserved)
    spin = np.sqrt(GM * SEMI_MAJOR_AXIS * (1 - ECCENTRICITY**2))
    print(f"exact: energy {-GM / (2 * SEMI_MAJOR_AXIS):.12g}, angular momentum {spin:.15g}")
    away = np.linalg.norm(path.x[:, -1] - path.x[:, 0])
    print(f"distance from the perihelion after {REVOLUTIONS} revolutions: {away:.1e} AU")
    draw(answer).savefig("kepler_revolutions.png")
