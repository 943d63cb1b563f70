"""From rest to rest a unit length away in the shortest time: full thrust, then full brake, T = 2.

The duration is free and the control jumps.  With an even number of equal intervals the jump falls on a joint and
the answer is exact.  With an odd number it falls inside an interval: the duration found is too short, because the
control leaves its bounds between the quadrature points, and the summary says where.  A tolerance puts joints beside it.

Three variations.  With a buffer at the end that takes what speed v is left, for a price times the energy v²/2, full
thrust lasts for a = √(1 + v²/2) and the brake for a - v: with the price √(7/8), a = √(8/7) and v = a/2.  With a gear
of free ratio p between motor and load, the motor's inertia J counts p² times: the best ratio matches both, p = 1/√J.
And where thrust changes by at most k in a unit of time, it turns over within 2/k, and T² = 4 + 4/(3 k²).
"""

from dataclasses import replace
from math import sqrt

import casadi_galerkin as cg

THRUST = 1.0
PRICE = sqrt(7 / 8)  # of the energy left for the buffer
FULL_THRUST = sqrt(8 / 7)  # how long, with the buffer
INERTIA = 1 / 16  # of the motor, the load's is 1
TURN = 2.0


def problem():
    """Unit mass on a line, bounded force, free duration."""
    return cg.ControlProblem(
        lambda t, x, v: v[0] ** 2 / 2,
        (0.0, 1.0),
        start=0.0,
        end=1.0,
        start_velocity=0.0,
        end_velocity=0.0,
        force=lambda t, x, v, u: u,
        running_cost=lambda t, x, v, u: 1,
        controls=1,
        control_bounds=(-THRUST, THRUST),
        duration_bounds=(0.1, 10.0),
    )


def buffered():
    """Arriving with any speed, which costs its energy times a price."""
    return replace(problem(), end_velocity=None, terminal_cost=lambda t, x, v: PRICE * v[0] ** 2 / 2)


def slow_to_turn():
    """Thrust that changes by at most two units in a unit of time."""
    return replace(problem(), control_rate_bounds=(-TURN, TURN))


def geared():
    """A motor with bounded torque drives the load through a gear; its ratio p[0] is free."""
    return replace(
        problem(),
        lagrangian=lambda t, x, v, p: (1 + INERTIA * p[0] ** 2) * v[0] ** 2 / 2,
        force=lambda t, x, v, u, p: p[0] * u[0],
        running_cost=lambda t, x, v, u, p: 1,
        parameters=1.0,
        parameter_bounds=(0.1, 10.0),
    )


def main():
    """Solve on ten intervals."""
    return cg.solve(problem(), cg.Galerkin(degree=2), intervals=10)


def draw(path):
    """Draw position, thrust and costate; returns the figure."""
    names = {"labels": ["place in m"], "control_labels": ["thrust in N"], "costate_labels": ["costate in s/N"]}
    axes = path.plot(time="t in s", **names)
    axes.set_title("Minimum time")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"  duration    {answer.t[-1]:.12f}, exact 2")
    between = cg.solve(problem(), cg.Galerkin(degree=2), intervals=11)
    print(between)
    print(f"  duration    {between.t[-1]:.12f}, exact 2")
    moved = cg.solve(problem(), tol=1e-6, intervals=11)
    print(f"to 1e-6 from there: duration {moved.t[-1]:.9f}, largest misfit {moved.control_misfit.max():.1e}")
    soft = cg.solve(buffered(), cg.Galerkin(degree=2), intervals=12)  # the brake begins after 2/3 of the time
    print(f"with a buffer: duration {soft.t[-1]:.12f}, exact {1.5 * FULL_THRUST:.12f}", end="; ")
    print(f"speed at the end {soft.end_velocity[0]:.12f}, exact {FULL_THRUST / 2:.12f}")
    driven = cg.solve(geared(), cg.Galerkin(degree=2), intervals=10)
    print(f"with a gear: ratio {driven.parameters[0]:.12f}, exact {INERTIA**-0.5:g}", end="; ")
    print(f"duration {driven.t[-1]:.12f}, exact {2 * INERTIA**0.25 * sqrt(2):.12f}")
    turned = cg.solve(slow_to_turn(), cg.Galerkin(degree=3), intervals=64)
    print(f"where thrust turns slowly: {turned.t[-1]:.6f}, exact {2 * sqrt(1 + 1 / (3 * TURN**2)):.6f}")
    draw(answer).savefig("minimum_time.png")
