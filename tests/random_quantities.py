"""Random smooth boundary problems, and quantities of their paths."""

import casadi as ca
import numpy as np
from scipy.optimize import brentq

import casadi_galerkin as cg


def problem(seed):
    """A few masses in a random smooth potential that changes with time, or one of them on a circle."""
    random = np.random.default_rng(seed)
    if seed % 5 == 0:
        a, b = random.uniform(0.3, 2.0, 2)
        lagrangian = lambda t, x, v: ca.dot(v, v) / 2 - a * x[1] - b * x[0] * ca.sin(t)  # noqa: E731
        angles = random.uniform(-1.0, 1.0, 2)
        ends = [[np.cos(angle), np.sin(angle)] for angle in angles]
        return cg.BoundaryProblem(
            lagrangian, (0, random.uniform(0.5, 2)), *ends, constraint=lambda t, x: ca.dot(x, x) - 1
        )
    d, waves = int(random.integers(1, 3)), 3
    stiffness, heights, phases = random.uniform(0.2, 3, d), random.normal(size=waves), random.uniform(0, 6, waves)
    numbers, speeds = random.uniform(-1.5, 1.5, (waves, d)), random.uniform(0, 2, waves)

    def lagrangian(t, x, v):
        potential = sum(k * x[i] ** 2 / 2 for i, k in enumerate(stiffness))
        for height, number, speed, phase in zip(heights, numbers, speeds, phases, strict=True):
            potential += height * ca.cos(ca.dot(ca.DM(number), x) - speed * t + phase)
        return ca.dot(v, v) / 2 * (1 + 0.1 * ca.sin(x[0])) - potential

    return cg.BoundaryProblem(lagrangian, (0, random.uniform(1, 4)), *random.uniform(-1, 1, (2, d)).tolist())


def _integral(path):
    points, weights = np.polynomial.legendre.leggauss(60)
    return float(weights @ path(path.t[-1] * (points + 1) / 2)[0] ** 2) * path.t[-1] / 2


def _crossing(path):
    """When x[0] is first halfway between its ends."""
    end = float(path.t[-1])
    level = (path(0.0)[0] + path(end)[0]) / 2
    times = np.linspace(0, end, 201)
    above = path(times)[0] > level
    k = int(np.argmax(above[1:] != above[:-1]))
    return brentq(lambda t: path(t)[0] - level, times[k], times[k + 1], xtol=1e-15, rtol=1e-15)


QUANTITIES = {
    "end velocity": lambda path: path(path.t[-1], 1),
    "velocities of momenta": lambda path: path.velocity[:, [0, -1]],
    "momenta": lambda path: path.momentum[:, [0, -1]],
    "action": lambda path: path.action,
    "x at a time": lambda path: path(0.37 * path.t[-1]),
    "an integral": _integral,
    "energy": lambda path: path.energy[0],
    "time of a crossing": _crossing,
}


def pushed_swing(seed):
    """A pendulum that is pushed: without bounds, with bounds, in its own time, as fast as it can, to a free end."""
    random = np.random.default_rng(seed)
    a, b, c = random.uniform(0.3, 2, 3)
    rest = {"end": [1.0], "end_velocity": [0.0]}
    kinds = [
        {**rest, "running_cost": lambda t, x, v, u: u[0] ** 2 / 2 + b * x[0] ** 2},
        {**rest, "running_cost": lambda t, x, v, u: u[0] ** 2 / 2 + b * x[0] ** 2, "control_bounds": (-3.5, 3.0)},
        {**rest, "running_cost": lambda t, x, v, u: 1.0 + c * u[0] ** 2 / 2, "duration_bounds": (0.2, 8.0)},
        {**rest, "running_cost": lambda t, x, v, u: 1.0, "duration_bounds": (0.2, 8.0), "control_bounds": (-2.5, 2.0)},
        {
            "end": [None],
            "end_velocity": [None],
            "running_cost": lambda t, x, v, u: u[0] ** 2 / 2,
            "terminal_cost": lambda t, x, v: 5 * b * (x[0] - 1) ** 2 + c * v[0] ** 2,
        },
    ]
    return cg.ControlProblem(
        lambda t, x, v: v[0] ** 2 / 2,
        (0, 1.5),
        [0.1],
        start_velocity=[0.0],
        force=lambda t, x, v, u: u - a * ca.sin(x),
        controls=1,
        **kinds[seed % len(kinds)],
    )


OF_OPTIMA = {
    "x at a time": lambda path: path(0.47 * path.t[-1]),
    "velocity at a time": lambda path: path(0.3 * path.t[-1], 1),
    "cost": lambda path: path.cost,
}
