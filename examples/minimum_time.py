"""From rest to rest a unit length away in the shortest time: full thrust, then full brake, T = 2.

The duration is free and the control jumps.  With an even number of equal intervals the jump falls on a joint and
the answer is exact.  With an odd number it falls inside an interval: the duration found is too short, because the
control leaves its bounds between the quadrature points, and the summary says where.  A tolerance moves a joint there.
"""

from show import picture, save

import casadi_galerkin as cg

THRUST = 1.0


def problem():
    """Unit mass on a line, bounded force, free duration."""
    return cg.ControlProblem(
        lambda t, x, v: v[0] ** 2 / 2,
        (0.0, 1.0),
        start=[0.0],
        end=[1.0],
        start_velocity=[0.0],
        end_velocity=[0.0],
        force=lambda t, x, v, u: u,
        running_cost=lambda t, x, v, u: 1,
        controls=1,
        control_bounds=(-THRUST, THRUST),
        duration_bounds=(0.1, 10.0),
    )


def main(plot=None):
    """Solve on ten intervals."""
    path = cg.solve(problem(), cg.Galerkin(degree=2), intervals=10)
    if plot:
        axes = path.plot()
        axes.set_title("Minimum time")
        save(axes, plot)
    return path


if __name__ == "__main__":
    answer = main(picture("minimum_time.png"))
    print(answer)
    print(f"  duration    {answer.t[-1]:.12f}, exact 2")
    between = cg.solve(problem(), cg.Galerkin(degree=2), intervals=11)
    print(between)
    print(f"  duration    {between.t[-1]:.12f}, exact 2")
    moved = cg.solve(problem(), tol=1e-6, intervals=11)
    print(f"to 1e-6 from there: duration {moved.t[-1]:.9f}, largest overshoot {moved.control_overshoot.max():.1e}")
