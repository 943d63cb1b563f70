"""A swing-up in a closed loop: measured, planned anew and pushed on fifty times a second.

The cart-pole of Kelly's swing-up is to stand upright where it began, with little effort and soon; the duration is free.
The plan is built once.  Every 20 ms it is solved again from the state just measured, which is noisy, warm from the last
answer, and its force is held until the next.  A knock on the pole, of which no model says anything, is only one more
state to plan from.  The plant itself is integrated by CVODES, which shares nothing with the plans but the Lagrangian.
"""

import casadi as ca
import numpy as np
from cart_pole import FORCE, TRACK, lagrangian
from show import canvas, picture, save

import casadi_galerkin as cg

SAMPLE, COUNT = 0.02, 200  # s between two measurements, and how many
NOISE = np.array([1e-3, 2e-3, 5e-3, 1e-2])  # standard deviations: m, rad, m/s, rad/s
HASTE = 50.0  # N², what a second costs beside the force squared
SHORTEST, LONGEST = 0.8, 4.0  # s, of a plan; the first is how softly the balance is kept
KNOCK, KNOCKED = 1.0, 100  # rad/s, and the sample before which it comes


def problem():
    """Cart-pole from a measured state, at first at rest below, to rest upright at the origin."""
    return cg.ControlProblem(
        lagrangian,
        (0.0, 2.0),
        start=[0.0, 0.0],
        end=[0.0, np.pi],
        start_velocity=[0.0, 0.0],
        end_velocity=[0.0, 0.0],
        force=lambda t, x, v, u: [u[0], 0],
        running_cost=lambda t, x, v, u: HASTE + u[0] ** 2,
        controls=1,
        control_bounds=(-FORCE, FORCE),
        position_bounds=([-TRACK, -np.inf], [TRACK, np.inf]),
        duration_bounds=(SHORTEST, LONGEST),
    )


def plant():
    """What cart and pole do in one sample under a constant force: a Function of x0 = (x, v) and u."""
    x, v, u = ca.SX.sym("x", 2), ca.SX.sym("v", 2), ca.SX.sym("u")
    energy = lagrangian(0, x, v)
    momentum = ca.gradient(energy, v)
    load = ca.gradient(energy, x) + ca.vertcat(u, 0) - ca.jtimes(momentum, x, v)
    rates = ca.vertcat(v, ca.solve(ca.jacobian(momentum, v), load))
    return ca.integrator("plant", "cvodes", {"x": ca.vertcat(x, v), "u": u, "ode": rates}, 0, SAMPLE)


def main(plot=None, seed=1):
    """Run the loop; returns states (4, samples + 1), forces (samples,) and plans."""
    rng, system = np.random.default_rng(seed), plant()
    planner = cg.transcribe(problem(), cg.Galerkin(degree=3), intervals=15)
    state, states, forces, plans, plan = np.zeros(4), [np.zeros(4)], [], [], None
    for k in range(COUNT):
        state[3] += KNOCK * (k == KNOCKED)
        measured = state + NOISE * rng.standard_normal(4)
        plan = planner.solve(start=measured[:2], start_velocity=measured[2:], guess=plan)
        force = plan.control(SAMPLE / 2)[0]
        state = np.array(system(x0=state, u=force)["xf"]).ravel()
        states.append(state.copy())
        forces.append(force)
        plans.append(plan)
    if plot:
        draw(np.transpose(states), plans, plot)
    return np.transpose(states), np.array(forces), plans


def draw(states, plans, name):
    """Draw what happened over time, and some of the plans."""
    axes = canvas("A swing-up planned anew every 20 ms", "t in s", "position", (7.0, 4.0))
    times = SAMPLE * np.arange(states.shape[1])
    for k in (0, 40, KNOCKED):
        fine = np.linspace(*plans[k].t[[0, -1]], 100)
        axes.plot(SAMPLE * k + fine, plans[k](fine).T, "--", color="0.6", linewidth=1)
    axes.plot(times, states[1], label="pole in rad")
    axes.plot(times, states[0], label="cart in m")
    axes.axvline(SAMPLE * KNOCKED, color="0.5", linewidth=0.8, linestyle=":")
    axes.annotate("a knock", (SAMPLE * KNOCKED, 1.6), xytext=(4, 0), textcoords="offset points")
    axes.plot([], [], "--", color="0.6", label="plans")
    axes.legend(loc="center left")
    save(axes, name)


if __name__ == "__main__":
    states, forces, plans = main(picture("swing_up_loop.png"))
    again = plans[1:]
    print(f"first plan: {plans[0].iterations} iterations, {plans[0].cost:.6g} N² s over {plans[0].t[-1]:.4g} s")
    print(
        f"{len(again)} more: {np.median([plan.iterations for plan in again]):g} iterations and "
        f"{1e3 * np.median([plan.solve_seconds for plan in again]):.2f} ms each in the median, "
        f"{max(plan.iterations for plan in again)} iterations at most"
    )
    away = np.max(np.abs(states[:2, -25:].T - [0, np.pi]), axis=0)
    print(f"the last half second: cart within {1e3 * away[0]:.1f} mm, pole within {1e3 * away[1]:.1f} mrad of upright")
