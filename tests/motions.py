"""Motions of known Lagrangians: from given starts, for tests of steps, and on ellipses."""

import casadi as ca
import numpy as np
from scenes import pendulum

import casadi_galerkin as cg

GRAVITY = 9.81


def oscillator(t, x, v):
    return v[0] ** 2 / 2 - x[0] ** 2 / 4


def varying_mass(t, x, v):
    return (1 + x[0] ** 2) * v[0] ** 2 / 2 - x[0] ** 2 / 2 - x[0] ** 4 / 4


def quartic(t, x, v):
    return v[0] ** 2 / 2 + v[0] ** 4 / 12 + ca.cos(x[0])


def kepler(t, x, v):
    return ca.dot(v, v) / 2 + 1 / ca.norm_2(x)


def of_anomaly(eccentricity, anomaly):
    """Position and time on an ellipse of axis 1 about the mass of `kepler`, from its pericenter."""
    position = [np.cos(anomaly) - eccentricity, np.sqrt(1 - eccentricity**2) * np.sin(anomaly)]
    return np.array(position), anomaly - eccentricity * np.sin(anomaly)


def on_ellipse(eccentricity, t):
    """Position on that ellipse at times within half a period of its pericenter, by Kepler's equation."""
    grid = np.linspace(-np.pi, np.pi, 20_001)
    anomaly = np.interp(t, of_anomaly(eccentricity, grid)[1], grid)
    for _ in range(8):
        anomaly -= (of_anomaly(eccentricity, anomaly)[1] - t) / (1 - eccentricity * np.cos(anomaly))
    return of_anomaly(eccentricity, anomaly)[0]


def henon_heiles(t, x, v):
    return ca.sumsqr(v) / 2 - ca.sumsqr(x) / 2 - x[0] ** 2 * x[1] + x[1] ** 3 / 3


def double_pendulum(t, x, v):
    kinetic = v[0] ** 2 + v[1] ** 2 / 2 + v[0] * v[1] * ca.cos(x[0] - x[1])
    return kinetic + GRAVITY * (2 * ca.cos(x[0]) + ca.cos(x[1]))


MOTIONS = {
    "pendulum": (pendulum, [2.0], [0.3], 0.2),
    "kepler": (kepler, [0.4, 0.0], [0.0, 2.0], 0.1),
    "double pendulum": (double_pendulum, [1.0, 1.2], [0.5, -0.2], 0.05),
    "varying mass in time": (lambda t, x, v: (2 + ca.sin(t)) * varying_mass(t, x, v) / 2, [0.7], [0.4], 0.2),
}


def start_of(scene, intervals):
    lagrangian, x, p, h = MOTIONS[scene]
    return cg.InitialProblem(lagrangian, (0, h * intervals), x, momentum=p)
