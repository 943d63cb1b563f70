"""A spacecraft spirals from a circular orbit to one of twice the radius with the least ∫|u|²/2 dt.

Polar coordinates x = (r, θ), unit gravitational parameter; u holds radial and tangential thrust acceleration, the
latter with lever arm r.  The angle of arrival is free.  The best thrust is Lawden's primer vector, here -(λ_r, r λ_θ).
Over many revolutions it would be constant and tangential, and change the circular speed evenly from 1 to 1/√2 (T. N.
Edelbaum, 1961); over the two of this transfer the cost is 3 % above that.
"""

import numpy as np

import casadi_galerkin as cg
from casadi_galerkin.solution.plotting import COLORS

RADIUS, DURATION = 2.0, 20.0
SLOW_SPIRAL = (1 - RADIUS**-0.5) ** 2 / (2 * DURATION)  # ∫|u|²/2 dt of Edelbaum's thrust


def lagrangian(t, x, v):
    """Kinetic minus potential energy of unit mass in the field of a unit mass."""
    return (v[0] ** 2 + (x[0] * v[1]) ** 2) / 2 + 1 / x[0]


def problem():
    """Circular orbit to circular orbit, angle of arrival free."""
    return cg.ControlProblem(
        lagrangian,
        (0.0, DURATION),
        start=[1.0, 0.0],
        end=[RADIUS, None],
        start_velocity=[0.0, 1.0],
        end_velocity=[0.0, RADIUS**-1.5],
        force=lambda t, x, v, u: [u[0], x[0] * u[1]],
        running_cost=lambda t, x, v, u: (u[0] ** 2 + u[1] ** 2) / 2,
        controls=2,
    )


def guess(t):
    """Radius growing evenly, angle with the mean of the two orbits' rates."""
    part = t / DURATION
    return [1 + (RADIUS - 1) * part, t * (1 + RADIUS**-1.5) / 2]


def main():
    """Solve from an even spiral, interval by interval."""
    return cg.solve(problem(), cg.Galerkin(degree=5), intervals=20, guess=guess, solver=cg.fatrop)


def draw(path):
    """Draw the spiral with thrust arrows; returns the figure."""
    axes = cg.panels(size=(4.6, 4.4))
    circle = np.linspace(0, 2 * np.pi, 200)
    for radius in (1.0, RADIUS):
        axes.plot(radius * np.cos(circle), radius * np.sin(circle), color="0.8")
    radius, angle = path(np.linspace(0, DURATION, 500))
    axes.plot(radius * np.cos(angle), radius * np.sin(angle), color=COLORS[0])
    times = np.linspace(0, DURATION, 40)
    (radius, angle), (radial, tangential) = path(times), path.control(times)
    across = radial * np.cos(angle) - tangential * np.sin(angle)
    up = radial * np.sin(angle) + tangential * np.cos(angle)
    axes.quiver(radius * np.cos(angle), radius * np.sin(angle), across, up, color=COLORS[1], width=0.005, zorder=3)
    axes.set(title="Low-thrust transfer", aspect="equal")
    axes.set(xlabel="x in radii of the first orbit", ylabel="y in radii of the first orbit")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"  a slow spiral's cost {SLOW_SPIRAL:.9f}, {answer.x[1, -1] / (2 * np.pi):.3f} revolutions here")
    times = answer.control.times
    primer = -answer.costate(times) * np.stack((np.ones_like(times), answer(times)[0]))
    print(f"  thrust of up to {np.max(np.abs(primer)):.4f}, and the primer vector: differ by", end=" ")
    print(f"{np.max(np.abs(answer.control.values - primer)):.1e}")
    draw(answer).savefig("low_thrust.png")
