"""A swing-up in a closed loop: measured, planned anew and pushed on fifty times a second.

The cart-pole of Kelly's swing-up is to stand upright where it began, with little effort and soon; the duration is free.
The plan is built once.  Every 20 ms it is solved again from the state just measured, which is noisy, warm from the last
answer, and its force is held until the next.  A knock on the pole, of which no model says anything, is only one more
state to plan from.  The plant itself is integrated by CVODES, which shares nothing with the plans but the Lagrangian.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

CART, POLE, LENGTH, GRAVITY = 1.0, 0.3, 0.5, 9.81  # kg, kg, m, m/s²
FORCE, TRACK = 20.0, 2.0  # N, m
SAMPLE, COUNT = 0.02, 200  # s between two measurements, and how many
NOISE = np.array([1e-3, 2e-3, 5e-3, 1e-2])  # standard deviations: m, rad, m/s, rad/s
HASTE = 50.0  # N², what a second costs beside the force squared
SHORTEST, LONGEST = 0.8, 4.0  # s, of a plan; the first is how softly the balance is kept
KNOCK, KNOCKED = 1.0, 100  # rad/s, and the sample before which it comes


def lagrangian(t, x, v):
    """Kinetic minus potential energy of cart and pole, J; x[0] is the cart's place, x[1] the angle from below."""
    kinetic = (CART + POLE) * v[0] ** 2 / 2 + POLE * (LENGTH * v[1]) ** 2 / 2
    return kinetic + POLE * LENGTH * (v[0] * v[1] + GRAVITY) * ca.cos(x[1])


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


def main(seed=1):
    """Run the loop; returns states (4, samples + 1), forces (samples,) and plans."""
    rng, system = np.random.default_rng(seed), plant()
    planner = cg.transcribe(problem(), cg.Galerkin(degree=3), intervals=15)
    state, states, forces, plans, plan = np.zeros(4), [np.zeros(4)], [], [], None
    for k in range(COUNT):
        state[3] += KNOCK * (k == KNOCKED)
        measured = state + NOISE * rng.standard_normal(4)
        plan = planner.solve(start=measured[:2], start_velocity=measured[2:], guess=plan, solver=cg.sqp)
        force = plan.control(SAMPLE / 2)[0]
        state = np.array(system(x0=state, u=force)["xf"]).ravel()
        states.append(state.copy())
        forces.append(force)
        plans.append(plan)
    return np.transpose(states), np.array(forces), plans


def draw(answer):
    """Draw what happened over time, and some of the plans; returns the figure."""
    (states, _, plans), axes = answer, cg.panels()
    for k in (0, 40, KNOCKED):
        fine = np.linspace(*plans[k].t[[0, -1]], 100)
        names = ["_", "_" if k else "plans"]
        axes.plot(SAMPLE * k + fine, plans[k](fine).T, "--", color="0.6", linewidth=1, label=names)
    axes.plot(SAMPLE * np.arange(states.shape[1]), states[:2].T, label=["cart in m", "pole in rad"])
    axes.axvline(SAMPLE * KNOCKED, color="0.5", linewidth=0.8, linestyle=":", label="a knock")
    axes.set(title="A swing-up planned anew every 20 ms", xlabel="t in s", ylabel="pole in rad, cart in m")
    axes.legend(fontsize="small", loc="center right")
    return axes.figure


if __name__ == "__main__":
    answer = states, forces, plans = main()
    print(f"first plan: {plans[0].iterations} iterations, {plans[0].cost:.6g} N² s over {plans[0].t[-1]:.4g} s")
    iterations, seconds = np.median([(plan.iterations, plan.solve_seconds) for plan in plans[1:]], axis=0)
    print(f"{len(plans) - 1} more: {iterations:g} iterations and {1e3 * seconds:.2f} ms each in the median")
    away = np.max(np.abs(states[:2, -25:].T - [0, np.pi]), axis=0)
    print(f"the last half second: cart within {1e3 * away[0]:.1f} mm, pole within {1e3 * away[1]:.1f} mrad of upright")
    draw(answer).savefig("swing_up_loop.png")
