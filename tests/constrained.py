"""Mechanisms in Cartesian coordinates, their constraints, and the same in angles from the lower vertical."""

import casadi as ca
import numpy as np
from motions import double_pendulum
from scenes import pendulum

GRAVITY = 9.81


def planar(t, x, v):
    return ca.sumsqr(v) / 2 - x[1]


def spatial(t, x, v):
    return ca.sumsqr(v) / 2 - x[2]


def uneven(t, x, v):
    """A mass that depends on place, in a potential that is no polynomial: no rule integrates it exactly."""
    return (1 + x[0] / 3) * ca.sumsqr(v) / 2 - ca.exp(x[1])


def unit_length(t, x):
    return ca.sumsqr(x) - 1


def on_circle(angle):
    return np.array([np.sin(angle), -np.cos(angle)])


def on_sphere(angles):
    polar, azimuth = angles
    return np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), -np.cos(polar)])


def spherical_pendulum(t, x, v):
    return (v[0] ** 2 + ca.sin(x[0]) ** 2 * v[1] ** 2) / 2 + ca.cos(x[0])


def two_masses(t, x, v):
    return ca.sumsqr(v) / 2 - GRAVITY * (x[1] + x[3])


def rods(t, x):
    return ca.vertcat(ca.sumsqr(x[:2]) - 1, ca.sumsqr(x[2:] - x[:2]) - 1)


def of_rods(angles):
    first, second = (on_circle(angle) for angle in angles)
    return np.concatenate((first, first + second))


MECHANISMS = {  # in angles; in Cartesian coordinates; positions of angles; constraint
    "pendulum": (pendulum, planar, lambda a: on_circle(a[0]), unit_length),
    "spherical pendulum": (spherical_pendulum, spatial, on_sphere, unit_length),
    "double pendulum": (double_pendulum, two_masses, of_rods, rods),
}
