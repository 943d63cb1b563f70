"""Control problems used by several tests, and the errors of their answers."""

from functools import lru_cache

import casadi as ca
import numpy as np

import casadi_galerkin as cg


def double_integrator(**changes):
    """Unit mass on a line from rest at 0 to rest at 1 in unit time, least ∫u²/2: cost 6, u = 6 - 12 t."""
    fields = {
        "lagrangian": lambda t, x, v: v[0] ** 2 / 2,
        "t_span": (0.0, 1.0),
        "start": [0.0],
        "end": [1.0],
        "start_velocity": [0.0],
        "end_velocity": [0.0],
        "force": lambda t, x, v, u: u,
        "running_cost": lambda t, x, v, u: u[0] ** 2 / 2,
        "controls": 1,
    }
    return cg.ControlProblem(**(fields | changes))


def speed_limited(limit):
    """The same in two units of time, no faster than a limit."""
    return double_integrator(t_span=(0.0, 2.0), path_constraint=(lambda t, x, v, u: v, -np.inf, limit))


def first_order(**changes):
    """One component whose rate is the control, from 0 to 1 in unit time, least ∫u²/2."""
    fields = {
        **dict.fromkeys(("lagrangian", "force", "start_velocity", "end_velocity")),
        "rates": lambda t, x, v, u: u,
    }
    return double_integrator(**(fields | changes))


def minimum_time():
    """Unit mass from rest to rest with a force of at most 1: T = 2."""
    return double_integrator(running_cost=lambda t, x, v, u: 1, control_bounds=(-1.0, 1.0), duration_bounds=(0.1, 10.0))


def pendulum(duration, **changes):
    """Pendulum from rest below to rest above, least ∫u²/2."""
    fields = {
        "lagrangian": lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]),
        "t_span": (0.0, duration),
        "end": [np.pi],
    }
    return double_integrator(**(fields | changes))


def pendulum_in_three():
    """The pendulum with time for one swing back."""
    return pendulum(3.0)


def varying_mass():
    """Mass that varies with the position, lever with time."""
    return double_integrator(
        lagrangian=lambda t, x, v: (1 + x[0] ** 2) * v[0] ** 2 / 2 - x[0] ** 2 / 2,
        force=lambda t, x, v, u: u * (1 + ca.sin(t) / 3) - v[0] / 5,
        t_span=(0.0, 2.0),
    )


def cart_pole():
    """Kelly's swing-up, SIAM Review 59 (2017)."""

    def lagrangian(t, x, v):
        kinetic = 1.3 * v[0] ** 2 / 2 + 0.15 * v[0] * v[1] * ca.cos(x[1]) + 0.3 * (0.5 * v[1]) ** 2 / 2
        return kinetic + 0.3 * 9.81 * 0.5 * ca.cos(x[1])

    return cg.ControlProblem(
        lagrangian,
        (0.0, 2.0),
        start=[0.0, 0.0],
        end=[1.0, np.pi],
        start_velocity=[0.0, 0.0],
        end_velocity=[0.0, 0.0],
        force=lambda t, x, v, u: [u[0], 0],
        running_cost=lambda t, x, v, u: u[0] ** 2,
        controls=1,
        control_bounds=(-20.0, 20.0),
        position_bounds=([-2.0, -np.inf], [2.0, np.inf]),
    )


def everything():
    """All that a problem can have at once: nothing is separable, linear or constant."""

    def lagrangian(t, x, v, p):
        kinetic = (1 + 0.3 * ca.cos(x[1])) * v[0] ** 2 / 2 + 0.2 * v[0] * v[1] * ca.sin(t) + p[0] * v[1] ** 2 / 2
        return kinetic - ca.cos(x[0]) * x[1] ** 2 + v[0] ** 4 / 12

    return cg.ControlProblem(
        lagrangian,
        (0.3, 1.5),
        start=[0.1, None],
        end=[None, 0.4],
        start_velocity=[None, 0.2],
        end_velocity=[0.1, None],
        force=lambda t, x, v, u, p: [u[0] * ca.cos(x[1]) - 0.1 * v[0], u[1] - p[1] * v[1] * v[0] * t],
        running_cost=lambda t, x, v, u, p: (
            u[0] ** 2 + ca.exp(u[1]) * x[0] ** 2 + t * v[0] * v[1] + ca.sumsqr(v) + p[0] * u[0]
        ),
        controls=2,
        terminal_cost=lambda t, x, v, p: t**2 * x[0] * v[0] + p[1] * v[1] ** 3 / (1 + v[1] ** 2),
        control_bounds=(-5.0, 5.0),
        path_constraint=(
            lambda t, x, v, u, p: [x[0] ** 2 + v[1] * u[0] * t, ca.sin(x[1]) * p[0]],
            [-np.inf, -3.0],
            [3.0, 3.0],
        ),
        duration_bounds=(0.5, 3.0),
        parameters=[1.1, 0.3],
        parameter_bounds=([0.5, -1.0], [2.0, 1.0]),
    )


def plane(**changes):
    """Unit mass in a plane from rest at (0, 0) to rest at (1, 0) in two units of time, least ∫u²/2."""
    fields = {
        "lagrangian": lambda t, x, v: ca.dot(v, v) / 2,
        "t_span": (0.0, 2.0),
        "start": [0.0, 0.0],
        "end": [1.0, 0.0],
        "start_velocity": [0.0, 0.0],
        "end_velocity": [0.0, 0.0],
        "force": lambda t, x, v, u: u,
        "running_cost": lambda t, x, v, u: ca.dot(u, u) / 2,
        "controls": 2,
    }
    return cg.ControlProblem(**(fields | changes))


def cartesian_pendulum(**changes):
    """The pendulum of three seconds on its circle, x = (across, up)."""
    fields = {
        "lagrangian": lambda t, x, v: ca.dot(v, v) / 2 - x[1],
        "t_span": (0.0, 3.0),
        "start": [0.0, -1.0],
        "end": [0.0, 1.0],
        "start_velocity": [0.0, 0.0],
        "end_velocity": [0.0, 0.0],
        "force": lambda t, x, v, u: u[0] * ca.vertcat(-x[1], x[0]),
        "constraint": lambda t, x: ca.dot(x, x) - 1,
    }
    return double_integrator(**(fields | changes))


def two_phases():
    """A rocket whose mass follows a rate, in two phases of free durations, with a condition that joins both ends."""
    return cg.ControlProblem(
        lambda t, x, v, p: x[1] * v[0] ** 2 / 2 - p[0] * x[1] * x[0] * t,
        (0.0, 1.0),
        [0.0, 1.0],
        [None, None],
        [0.1, None],
        [None, None],
        force=lambda t, x, v, u, p: u[0] * (1 - p[0] * v[0]) - v[0] ** 2,
        running_cost=lambda t, x, v, u, p: u[0] ** 2 + x[1] ** 2,
        controls=1,
        rates=lambda t, x, v, u, p: -p[0] * u[0] * x[1] ** 2 * (1 + t),
        end_conditions=(lambda x0, v0, x1, v1, p: [x1[0] * x1[1] + v0[0] * v1[0] * p[0], x0[1] - x1[1]], 0.1, 0.9),
        duration_bounds=(0.1, 2.0),
        breakpoints=[0.4],
        parameters=[0.3],
        parameter_bounds=(0.1, 0.5),
        hold=True,
    )


def staged(**changes):
    """A mass with a lag of its force in two phases of free durations, and a law at the joint that mixes everything."""
    fields = {
        "lagrangian": lambda t, x, v, p: (1 + x[1] ** 2 + t / 5) * v[0] ** 2 / 2 - p[0] * x[0] ** 2 * x[1] / 2,
        "t_span": (0.0, 2.0),
        "start": [0.2, 0.5],
        "end": [1.0, None],
        "start_velocity": [0.1, None],
        "end_velocity": [None, None],
        "force": lambda t, x, v, u, p: u[0] - v[0] / 10,
        "rates": lambda t, x, v, u, p: u[0] * x[0] - x[1],
        "running_cost": lambda t, x, v, u, p: u[0] ** 2 + x[1] ** 2 + 1,
        "terminal_cost": lambda t, x, v, p: x[1] ** 2 + v[0] ** 2 + (p[0] - 1) ** 2,
        "duration_bounds": (0.2, 3.0),
        "parameters": [1.1],
        "parameter_bounds": (0.5, 2.0),
        "waypoints": [(0.8, (lambda x, v, p: [x[0] * v[0] + p[0] * x[1], v[0] ** 2], [-1.0, 0.1], [2.0, 4.0]))],
        "jumps": [
            (
                0.8,
                lambda x, v, p: ([x[0] + x[1] ** 2 / 20, p[0] * x[1] / 2 + v[0] / 10], [0.8 * v[0] + x[1] / 5, v[1]]),
            ),
            (1.5, lambda x, v, p: (x, -v / 2)),
        ],
    }
    return double_integrator(**(fields | changes))


FRACTIONS = np.linspace(0, 1, 1001)


FINE = cg.Galerkin(12)  # on 20 intervals its errors are below 1e-11, see the published costs in test_transcription


@lru_cache
def resolved(make, *arguments):
    path = cg.solve(make(*arguments), FINE, intervals=20)
    return path.cost, path(path.t[0] + FRACTIONS * np.ptp(path.t))


def true_error(path, cost, way):
    """Relative error of the cost and of the positions at the same fractions of the duration."""
    found = path(path.t[0] + FRACTIONS * np.ptp(path.t))
    sizes = np.max(np.abs(way), axis=1, keepdims=True)
    return max(abs(path.cost / cost - 1), np.max(np.abs(found - way) / sizes))


NEAR = {  # a problem, a method, and what differs in a problem near by
    "cart-pole": (cart_pole, cg.Galerkin(4), {"start": [0.02, -0.03], "start_velocity": [0.05, 0.1]}),
    "bang-bang": (minimum_time, cg.Galerkin(3), {"start": [0.1], "end_velocity": [0.05]}),
    "everything": (everything, cg.Galerkin(3), {"start": [0.12, None], "end_velocity": [0.12, None]}),
}
