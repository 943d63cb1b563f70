"""A rocket of two stages climbs into orbit with the most mass left; the first stage is dropped when its fuel is spent.

The mass follows a rate and falls by the empty stage at a breakpoint: a jump.  What differs from stage to stage, thrust
and exhaust, depends on a component of rate zero that jumps from 0 to 1 there.  Separation is a waypoint, a mass before
the jump.  Engines run at full thrust, so that the least time leaves the most mass; the control is their direction.

The Earth is flat and without air.  Then the direction is known: its tangent falls linearly with time, across the
separation too (bilinear tangent steering), and so the jump can be checked: by shooting for the two numbers of this law.

Units: 100 km, 100 s and 100 t, so that speeds are in km/s and thrusts in MN.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

GRAVITY = 0.981
THRUST, EXHAUST = (2.4, 0.3), (2.9, 3.4)  # of both stages
MASS, FUEL, EMPTY = 1.5, 1.0, 0.12  # at liftoff, and of the first stage
HEIGHT, SPEED = 1.8, 7.8  # of the orbit


def by_stage(pair, stage):
    """The first of two numbers at stage 0, the second at stage 1."""
    return pair[0] + (pair[1] - pair[0]) * stage


def problem():
    """State x = (across, up, mass, stage) and the direction u; times are guesses."""
    return cg.ControlProblem(
        lambda t, x, v: x[2] * ((v[0] ** 2 + v[1] ** 2) / 2 - GRAVITY * x[1]),
        (0.0, 4.0),
        start=[0.0, 0.0, MASS, 0.0],
        end=[None, HEIGHT, None, None],
        start_velocity=[0.0, 0.0, None, None],
        end_velocity=[SPEED, 0.0, None, None],
        force=lambda t, x, v, u: (
            by_stage(THRUST, x[3]) * (ca.vertcat(ca.cos(u[0]), ca.sin(u[0])) - v[:2] / by_stage(EXHAUST, x[3]))
        ),
        rates=lambda t, x, v, u: [-by_stage(THRUST, x[3]) / by_stage(EXHAUST, x[3]), 0],
        running_cost=lambda t, x, v, u: 1,
        controls=1,
        duration_bounds=(0.1, 4.2),  # of every stage
        waypoints=[(1.2, [None, None, MASS - FUEL, None])],
        jumps=[(1.2, lambda x, v: ([x[0], x[1], x[2] - EMPTY, 1], v))],
    )


def main():
    """Solve with four intervals for each stage, from the straight line."""
    return cg.solve(problem(), cg.Galerkin(degree=6), intervals=8)


def draw(path):
    """Draw the way up, and the mass with its jump; returns the figure."""
    times, values = path.polynomial.line(np.union1d(path.t, np.linspace(path.t[0], path.t[-1], 200)))
    left, right = cg.panels(columns=2, size=(8.0, 3.2))
    left.plot(*(100 * values[:2]))
    left.plot(*(100 * path(path.problem.breakpoints[0])[:2]), "o")
    left.set(xlabel="across in km", ylabel="up in km", title="The first stage is dropped at the dot")
    right.plot(100 * times, 100 * values[2])
    right.set(xlabel="time in s", ylabel="mass in t", title=f"{100 * values[2, -1]:.3f} t arrive")
    return left.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    (dropped,) = answer.problem.breakpoints
    print(f"  separation  at {100 * dropped:.6f} s, fuel lasts {100 * FUEL * EXHAUST[0] / THRUST[0]:.6f} s", end=": ")
    print(f"{100 * answer.before(dropped)[2]:.6f} t before, {100 * answer(dropped)[2]:.6f} t after")
    tangents = np.tan(answer.control(answer.control.times)[0])
    line = np.polynomial.Polynomial.fit(answer.control.times, tangents, 1)
    print(f"  steering    tangent linear in time to {np.max(np.abs(line(answer.control.times) - tangents)):.1e}")
    draw(answer).savefig("two_stage_rocket.png")
