"""A controller inside a simulation: the plans of a closed loop and the plant are one CasADi Function.

A crane's load sways.  Ten times a second the trolley's force is planned anew for the next three seconds, as the least
that brings trolley and load to rest at the origin.  Plan and plant are Functions of the state, so the loop is one, too:
it is simulated from many starts in one call, without Python between two samples, and written as C code.
"""

from functools import cache

import casadi as ca
import numpy as np

import casadi_galerkin as cg

TROLLEY, LOAD, ROPE, GRAVITY = 1.0, 0.5, 2.0, 9.81  # kg, kg, m, m/s²
FORCE, HORIZON = 3.0, 3.0  # N, s
SAMPLE, COUNT, STARTS = 0.1, 100, 8  # s between two plans, plans of a loop, loops


def lagrangian(t, x, v):
    """Kinetic minus potential energy in J; x is the trolley's place and the angle of the rope."""
    kinetic = (TROLLEY + LOAD) * v[0] ** 2 / 2 + LOAD * (ROPE * v[1]) ** 2 / 2
    return kinetic + LOAD * ROPE * (v[0] * v[1] + GRAVITY) * ca.cos(x[1])


def planner():
    """The plan from a start and its velocity to rest: a Function."""
    problem = cg.ControlProblem(
        lagrangian,
        (0.0, HORIZON),
        start=[0.2, 0.1],
        end=[0.0, 0.0],
        start_velocity=[0.0, 0.0],
        end_velocity=[0.0, 0.0],
        force=lambda t, x, v, u: [u[0], 0],
        running_cost=lambda t, x, v, u: u[0] ** 2 / 2,
        controls=1,
        control_bounds=(-FORCE, FORCE),
    )
    return cg.solution_function(problem, cg.Galerkin(degree=3), intervals=15, solver=cg.fatrop)


def plant():
    """What trolley and load do in one sample under a constant force, by Newton's laws: a Function of x0 and u."""
    state, u = ca.SX.sym("x", 4), ca.SX.sym("u")
    _, angle, speed, turning = ca.vertsplit(state)
    pull = LOAD * ca.sin(angle) * (ROPE * turning**2 + GRAVITY * ca.cos(angle))
    trolley = (u + pull) / (TROLLEY + LOAD * ca.sin(angle) ** 2)
    rope = -(trolley * ca.cos(angle) + GRAVITY * ca.sin(angle)) / ROPE
    rates = ca.vertcat(speed, turning, trolley, rope)
    return ca.integrator("plant", "rk", {"x": state, "u": u, "ode": rates}, 0, SAMPLE, {"simplify": True})


@cache
def sample():
    """Plan from a state, and push for one sample: a Function of the state, to the next one and the force."""
    plan, state = planner(), ca.MX.sym("state", 4)
    blank = {name: ca.DM.zeros(*plan.size_in(name)) for name in ("guess", "controls", "end", "end_velocity")}
    force = plan(start=state[:2], start_velocity=state[2:], **blank)["u"][0]
    return ca.Function("sample", [state], [plant()(x0=state, u=force)["xf"], force], ["state"], ["next", "force"])


def main(seed=3):
    """Simulate all loops; returns states (4, STARTS, COUNT + 1) and forces (STARTS, COUNT)."""
    starts = np.random.default_rng(seed).uniform(-0.3, 0.3, (4, STARTS))
    states, forces = sample().mapaccum(COUNT).map(STARTS)(starts)
    later = np.array(states).reshape(4, STARTS, COUNT)
    return np.concatenate((starts[:, :, None], later), axis=2), np.array(forces).reshape(STARTS, COUNT)


def draw(answer):
    """Draw place and angle of all loops over time; returns the figure."""
    (states, _), axes, times = answer, cg.panels(2, size=(4.6, 4.4), sharex=True), SAMPLE * np.arange(COUNT + 1)
    for name, panel, values in zip(("trolley in m", "rope in rad"), axes, states, strict=False):
        panel.plot(times, values.T, linewidth=1)
        panel.set_ylabel(name)
    axes[0].set_title(f"A swaying load brought to rest, from {STARTS} starts")
    axes[1].set_xlabel("t in s")
    return axes[0].figure


if __name__ == "__main__":
    answer = states, forces = main()
    print(f"{STARTS} loops of {COUNT} plans each, forces up to {np.max(np.abs(forces)):.2f} N")
    print(f"after {SAMPLE * COUNT:g} s: at most {1e3 * np.max(np.abs(states[:2, :, -1])):.1f} mm or mrad away")
    print(f"the same as C code: {sample().generate('swaying_load.c')}")
    draw(answer).savefig("swaying_load.png")
