"""A cart swings its pole up in two seconds with little effort ∫u² dt (M. Kelly, SIAM Review 59, 2017).

x[0] is the cart's position, x[1] the pole's angle from below; the force acts on the cart only.  From the straight line
an optimizer finds the swing-up of that paper, back once and over.  It is a local optimum: a guess that goes another way
leads to one that swings once more and costs less.  All work of the force ends up in the pole's height, 2 m g l.  That
force alone, replayed from rest step by step with the same method, brings cart and pole there again.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

CART, POLE, LENGTH, GRAVITY = 1.0, 0.3, 0.5, 9.81  # kg, kg, m, m/s²
DURATION, DISTANCE = 2.0, 1.0  # s, m
FORCE, TRACK = 20.0, 2.0  # N, m


def lagrangian(t, x, v):
    """Kinetic minus potential energy of cart and pole, J."""
    kinetic = (
        (CART + POLE) * v[0] ** 2 / 2 + POLE * LENGTH * v[0] * v[1] * ca.cos(x[1]) + POLE * (LENGTH * v[1]) ** 2 / 2
    )
    return kinetic + POLE * GRAVITY * LENGTH * ca.cos(x[1])


def problem():
    """Cart-pole from rest below to rest upright, a meter further on."""
    return cg.ControlProblem(
        lagrangian,
        (0.0, DURATION),
        start=[0.0, 0.0],
        end=[DISTANCE, np.pi],
        start_velocity=[0.0, 0.0],
        end_velocity=[0.0, 0.0],
        force=lambda t, x, v, u: [u[0], 0],
        running_cost=lambda t, x, v, u: u[0] ** 2,
        controls=1,
        control_bounds=(-FORCE, FORCE),
        position_bounds=([-TRACK, -np.inf], [TRACK, np.inf]),
    )


def once_more(t):
    """Guess: the cart goes evenly, and the pole lags behind at first."""
    part = np.pi * t / DURATION
    return [DISTANCE * t / DURATION, part - np.sin(part)]


def work(path):
    """Work of the force on the cart, ∫u dx, by quadrature where the controls are given."""
    weights = np.outer(np.diff(path.t), path.method.quadrature.weights).ravel()
    return weights @ (path.control.values[0] * path(path.control.times, 1)[0])


def replayed(path):
    """The same system from the same start under the force found, as a function of time: nothing is told of the end."""
    force, velocity = path.replay(), path.start_velocity
    start = cg.InitialProblem(lagrangian, path.problem.t_span, path.x[:, 0], velocity=velocity, force=force)
    return cg.solve(start, path.method, mesh=path.t)


def main():
    """Solve from a straight line."""
    return cg.solve(problem(), cg.Galerkin(degree=4), intervals=20)


def ends(x):
    """Cart and end of the pole in the plane, in m; (2, K) -> (2, 2, K)."""
    cart = np.stack((x[0], 0 * x[0]))
    return np.stack((cart, cart + LENGTH * np.stack((np.sin(x[1]), -np.cos(x[1])))))


def draw(path):
    """Draw cart and pole as a strip of poses, and the force; returns the figure."""
    top, bottom = cg.panels(2, size=(4.6, 3.6), height_ratios=(2, 3))
    path.plot_poses(ends, top, count=9, apart=0.45)
    top.set(title="Cart-pole swing-up, every 0.25 s", xticks=[], ylabel="m")
    path.plot_controls(bottom, ["force in N"], "t in s")
    return top.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"  work        {work(answer):.6f} J, exact {2 * POLE * GRAVITY * LENGTH} J")
    print(f"  replayed    cart and pole {np.abs(replayed(answer).x[:, -1] - answer.x[:, -1])} away from there")
    answer.to_csv("cart_pole.csv")  # what the actuator has to do
    draw(answer).savefig("cart_pole.png")
