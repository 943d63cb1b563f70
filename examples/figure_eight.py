"""Three bodies that chase one another along a figure eight: a periodic critical point of the action.

A. Chenciner and R. Montgomery, Annals of Mathematics 152 (2000); initial values by C. Simó.  The path is found from a
rough guess for the given period; what was published for time 0 is then compared with it.

Equal masses and G are 1.  Jacobi's coordinates leave out the center of mass: x = (r, R), with r from body 1 to body 2
and R from their middle to body 3.  Two components of the start that are 0 fix the rotation and the shift in time: then
all bodies are on the x axis at time 0.  They allow a kink in the momenta there, and there is none.  Another orbit
differs by 1e-7 of its action only; it is no figure eight, and its Morse index is 3 in place of 2.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

PERIOD = 6.32591398
POSITION_1, VELOCITY_3 = (0.97000436, -0.24308753), (-0.93240737, -0.86473146)  # published, at time 0; body 3 is at 0
METHOD, INTERVALS = cg.Galerkin(degree=8), 36


def lagrangian(t, x, v):
    """Kinetic minus potential energy of the relative motion of three unit masses."""
    r, middle = x[:2], x[2:]
    kinetic = ca.dot(v[:2], v[:2]) / 4 + ca.dot(v[2:], v[2:]) / 3
    return kinetic + 1 / ca.norm_2(r) + 1 / ca.norm_2(middle + r / 2) + 1 / ca.norm_2(middle - r / 2)


def bodies(x):
    """Positions (3, 2, ...) of the bodies from Jacobi's coordinates (4, ...); velocities likewise."""
    r, middle = x[:2], x[2:]
    return np.stack((-r / 2 - middle / 3, r / 2 - middle / 3, 2 * middle / 3))


def rough(t):
    """Guess: bodies a third of the period apart on (sin s, 0.3 sin 2s), turned until they start on the x axis."""
    s = 2 * np.pi * (t / PERIOD + np.array([1, -1, 0]) / 3)
    turn = -np.arctan2(0.3 * np.sin(4 * np.pi / 3), np.sin(2 * np.pi / 3))
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    first, second, third = (rotation @ np.array([np.sin(s), 0.3 * np.sin(2 * s)])).T
    return np.concatenate((second - first, third - (first + second) / 2))


def main():
    """Solve from the rough guess."""
    problem = cg.BoundaryProblem(lagrangian, (0.0, PERIOD), start=[None, 0.0, None, 0.0], periodic=True)
    return cg.solve(problem, METHOD, INTERVALS, guess=rough)


def angular_momentum(path):
    """Σ x × p at the joints; (N + 1,)."""
    x, p = path.x, path.momentum
    return x[0] * p[1] - x[1] * p[0] + x[2] * p[3] - x[3] * p[2]


def draw(path):
    """Draw the curve, and the bodies at time 0, in a line, and a twelfth of the period later, isosceles."""
    axes = cg.panels(size=(5.2, 3.4))
    axes.plot(*bodies(path(np.linspace(0, PERIOD, 600)))[0], color="0.6", zorder=0)
    for moment, marker, when in ((0.0, "o", "t = 0"), (PERIOD / 12, "s", "t = T/12")):
        places = bodies(path(moment))
        axes.plot(*np.vstack((places, places[:1])).T, marker=marker, markersize=9, linestyle=":", label=when)
        for body, place in enumerate(places, start=1):
            axes.annotate(f"{body}", place, color="w", fontsize=7, ha="center", va="center")
    axes.set(title="Three bodies on a figure eight", xlabel="x", ylabel="y", aspect="equal")
    axes.legend(fontsize="small", loc="lower right")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    first = bodies(answer.x[:, 0])[0]
    speed = np.linalg.norm(bodies(answer.velocity[:, 0])[2])
    print(answer)
    print(f"  body 1 from the center  {np.linalg.norm(first):.9f}, published {np.linalg.norm(POSITION_1):.9f}")
    print(f"  speed of body 3 there   {speed:.9f}, published {np.linalg.norm(VELOCITY_3):.9f}")
    print(f"  angular momentum        {np.max(np.abs(angular_momentum(answer))):.1e}")
    print(f"  kink of the momenta     {np.max(np.abs(answer.momentum[:, 0] - answer.momentum[:, -1])):.1e} at time 0")
    draw(answer).savefig("figure_eight.png")
