"""A soft landing on the Moon with the least fuel: the mass follows a rate, and the engine's switching time is free.

The rocket falls towards the ground and burns fuel, m' = -u/c with the speed c of its exhaust.  Thrust u and the
momentum that the exhaust takes along, m' v, are the force on d/dt (m v).  It is cheapest to fall first and to brake
with full thrust then.  So the time has two phases, each of one interval with a constant thrust: their durations are
found, and the answer is exact between the joints.  It agrees with the closed form: fall for a, then burn for b with

    v = v_a - g b - c log(m),    h = h_a + v_a b - g b²/2 + c ((m log(m) - m + 1) / k),    m = 1 - k b,  k = u_max/c.

The numbers are those of PSOPT's manual, in lunar units: 1.4204 of impulse, ∫ u dt.
"""

import numpy as np

import casadi_galerkin as cg

GRAVITY, EXHAUST, THRUST = 1.0, 2.349, 1.227
HEIGHT, SPEED = 1.0, -0.783


def problem(**changes):
    """Height and mass, from a fall to rest on the ground with any mass."""
    fields = {
        "lagrangian": lambda t, x, v: x[1] * (v[0] ** 2 / 2 - GRAVITY * x[0]),
        "t_span": (0.0, 1.5),  # a guess, as the breakpoint is
        "start": [HEIGHT, 1.0],
        "end": [0.0, None],
        "start_velocity": [SPEED, None],
        "end_velocity": [0.0, None],
        "force": lambda t, x, v, u: u[0] * (1 - v[0] / EXHAUST),
        "running_cost": lambda t, x, v, u: u[0],
        "controls": 1,
        "control_bounds": (0.0, THRUST),
        "duration_bounds": (0.1, 3.0),  # of every phase
        "rates": lambda t, x, v, u: -u[0] / EXHAUST,  # of the mass, the last component
        "breakpoints": [0.7],
        "hold": True,
    }
    return cg.ControlProblem(**(fields | changes))


def landed(fall, burn):
    """Height and velocity after a fall and a burn, both zero for the cheapest."""
    height, speed = HEIGHT + SPEED * fall - GRAVITY * fall**2 / 2, SPEED - GRAVITY * fall
    rate = THRUST / EXHAUST
    mass = 1 - rate * burn
    lifted = EXHAUST * (mass * np.log(mass) - mass + 1) / rate
    return height + speed * burn - GRAVITY * burn**2 / 2 + lifted, speed - GRAVITY * burn - EXHAUST * np.log(mass)


def main():
    """Solve with one interval for each phase."""
    return cg.solve(problem(), cg.Galerkin(degree=8), intervals=2)


def draw(path):
    """Draw height, mass and thrust over time; returns the figure."""
    axes = cg.panels(size=(6.0, 4.0))
    axes.set(title="A soft landing on the Moon", xlabel="time", ylabel="height, mass, thrust in lunar units")
    times = np.linspace(*path.t[[0, -1]], 200)
    for values, label in zip((*path(times), path.control(times)[0]), ("height", "mass", "thrust"), strict=True):
        axes.plot(times, values, label=label)
    axes.axvline(path.t[1], color="0.5", linewidth=0.8, linestyle=":")
    axes.legend(loc="center left")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    fall, burn = np.diff(answer.t)
    print(f"  fall for {fall:.9f}, burn for {burn:.9f}: height and velocity by the closed form", end=" ")
    print("{:.1e}, {:.1e}".format(*landed(fall, burn)))
    smooth = {"breakpoints": (), "hold": False, "duration_bounds": (0.5, 4.0)}
    blind = cg.solve(problem(**smooth), cg.Galerkin(degree=4), intervals=40)
    print(f"  one phase of 40 intervals of degree 4, thrust as it likes: {blind.cost:.9f}, exact {THRUST * burn:.9f}")
    draw(answer).savefig("moon_landing.png")
