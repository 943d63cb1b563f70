"""A two-link arm of two uniform rods, from hanging to upright, with a shoulder too weak to lift it straight.

x holds both angles from below, absolute; u the torques in shoulder and elbow.  The elbow's torque turns the forearm
and turns the upper arm back, so the generalized forces are (u_0 - u_1, u_1).  It swings up with torques below their
bounds; their work is what both rods gain in height.  From the straight line IPOPT takes 25 iterations, and 21 with
a barrier that adapts to its progress and a tolerance of 1e-9.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

GRAVITY, DURATION = 9.81, 1.5  # m/s², s
SHOULDER, ELBOW = 18.0, 8.0  # N m; held out straight, the arm weighs on the shoulder with 19.6 N m


def lagrangian(t, x, v):
    """Kinetic minus potential energy of two rods of 1 kg and 1 m each."""
    kinetic = v[0] ** 2 * 2 / 3 + v[1] ** 2 / 6 + v[0] * v[1] * ca.cos(x[0] - x[1]) / 2
    return kinetic + GRAVITY * (1.5 * ca.cos(x[0]) + 0.5 * ca.cos(x[1]))


def problem():
    """Arm from rest hanging to rest upright with the least squared torque."""
    return cg.ControlProblem(
        lagrangian,
        (0.0, DURATION),
        start=[0.0, 0.0],
        end=[np.pi, np.pi],
        start_velocity=[0.0, 0.0],
        end_velocity=[0.0, 0.0],
        force=lambda t, x, v, u: [u[0] - u[1], u[1]],
        running_cost=lambda t, x, v, u: (u[0] ** 2 + u[1] ** 2) / 2,
        controls=2,
        control_bounds=([-SHOULDER, -ELBOW], [SHOULDER, ELBOW]),
    )


def work(path):
    """Work of both torques in J, by quadrature where they are given."""
    (upper, lower), (shoulder, elbow) = path(path.control.times, 1), path.control.values
    weights = np.outer(np.diff(path.t), path.method.quadrature.weights).ravel()
    return weights @ ((shoulder - elbow) * upper + elbow * lower)


def main():
    """Solve from a straight line."""
    solver = cg.ipopt.with_options(mu_strategy="adaptive", tol=1e-9)
    return cg.solve(problem(), cg.Galerkin(degree=4), intervals=20, solver=solver)


def ends(x):
    """Shoulder, elbow and hand in the plane, in m; (2, K) -> (3, 2, K)."""
    elbow = np.stack((np.sin(x[0]), -np.cos(x[0])))
    return np.stack((0 * elbow, elbow, elbow + np.stack((np.sin(x[1]), -np.cos(x[1])))))


def draw(path):
    """Draw the arm as a strip of poses, and the torques; returns the figure."""
    top, bottom = cg.panels(2, size=(4.6, 3.6), height_ratios=(2, 3))
    path.plot_poses(ends, top, count=9, apart=1.4)
    top.set(title="Two-link arm, nine poses in 1.5 s", xticks=[], ylabel="m")
    path.plot_controls(bottom, ["shoulder in N m", "elbow in N m"], "t in s")
    return top.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    best = cg.solve(problem(), tol=1e-7, guess=answer)
    for name, path in (("here", answer), ("to 1e-7", best)):
        print(f"  {name:11} cost {path.cost:.6f}, work {work(path):.6f} J, exact {4 * GRAVITY} J")
    print(f"  torques     up to {np.max(np.abs(best.control.values), axis=1).round(3)} N m")
    draw(answer).savefig("two_link_arm.png")
