"""The simplest walker: two legs that walk down a gentle slope without a motor, step after step the same.

The hip is heavy and the feet are light.  The standing leg falls over as a pendulum upside down and the other one swings
past it; where it strikes the ground the two change their parts, and some speed is lost.  A step that repeats itself is
sought: its start is its end after the strike, as end conditions on both ends, and its duration is free.  There is
nothing to choose, so this is a boundary problem of equations of first order.

M. Garcia, A. Chatterjee, A. Ruina, M. Coleman, The simplest walking model (1998), have the numbers of both gaits on
a slope of 0.009: the long one, which is stable, and the short one.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

SLOPE = 0.009
PUBLISHED = 0.200310900544287, -0.199832473004977  # angle of the standing leg and its speed after the strike


def rates(t, x):
    """Of the standing leg's angle and speed, and of the angle between the legs and its speed."""
    leg, speed, between, turning = x[0], x[1], x[2], x[3]
    falling = ca.sin(leg - SLOPE)
    return [speed, falling, turning, falling + (speed**2 - ca.cos(leg - SLOPE)) * ca.sin(between)]


def step(x0, x1):
    """A step begins as the one before it ends, behind the strike, where both feet are on the ground."""
    kept = ca.cos(2 * x1[0])
    behind = ca.vertcat(-x1[0], kept * x1[1], -2 * x1[0], kept * (1 - kept) * x1[1])
    return ca.vertcat(x0 - behind, x1[2] - 2 * x1[0])


def problem():
    """Times are in those of the leg as a pendulum, √(l/g)."""
    return cg.ControlProblem(
        rates=rates, t_span=(0.0, 3.8), components=4, end_conditions=(step, 0.0, 0.0), duration_bounds=(1.0, 6.0)
    )


def main():
    """Find the long gait from straight lines."""
    return cg.solve(problem(), tol=1e-10, guess=lambda t: [0.2 - 0.4 * t / 3.8, -0.2, 0.4 - 0.8 * t / 3.8, 0.0])


def draw(path):
    """Draw the legs on their way through one step; returns the figure."""
    axes = cg.panels(size=(6.0, 4.0))
    for k, (leg, between) in enumerate(path(np.linspace(*path.t[[0, -1]], 9))[[0, 2]].T):
        hip = np.array([-np.sin(leg), np.cos(leg)])
        foot = hip + np.array([np.sin(leg - between), -np.cos(leg - between)])
        axes.plot([0.0, hip[0], foot[0]], [0.0, hip[1], foot[1]], "o-", color=str(0.8 - 0.1 * k), markersize=3)
    axes.set(title=f"A step down a slope, in {path.t[-1]:.4f} times √(l/g)", xlabel="along the slope, in legs")
    axes.set_aspect("equal")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    for name, value, published in zip(("angle", "speed"), answer.x[:2, 0], PUBLISHED, strict=True):
        print(f"  {name:7}{value:19.15f}, published {published:19.15f}")
    draw(answer).savefig("walking.png")
