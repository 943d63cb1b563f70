"""Goddard's rocket: how high it gets on a given load of fuel, through air that thins with height.

Full thrust first, then just as much as the drag and the burning of fuel at that speed are worth, then none: on the way
between, a singular arc, the best thrust is neither bound, and one that trembles about it reaches the same height.  The
thrust found there changes from mesh to mesh; only its mean over an interval, which is drawn, means something.  The
height is known to eight digits long before the path is to four: `of` asks for the cost alone, where `tol` would
ask for the path as well, and is not met.

In the units of COPS 3 (E. D. Dolan, J. J. Moré, T. S. Munson, 2004): heights from the center of the Earth in its
radius, masses in that of the rocket.  The published height is 1.01283; here are more digits, from finer meshes.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

EXHAUST, LARGEST = 0.5, 3.5  # speed of the exhaust, and largest thrust
EMPTY = 0.6  # mass without fuel
HIGHEST = 1.012836934  # to its last digit


def drag(height, speed):
    """Force of the air."""
    return 310 * speed**2 * ca.exp(-500 * (height - 1))


def problem():
    """Height and mass; what the burnt fuel takes with it is the last term of the force, u being the thrust."""
    return cg.ControlProblem(
        lambda t, x, v: x[1] * v[0] ** 2 / 2 + x[1] / x[0],
        (0.0, 0.2),
        start=[1.0, 1.0],
        end=[None, EMPTY],
        start_velocity=[0.0, None],
        force=lambda t, x, v, u: u[0] - drag(x[0], v[0]) - u[0] / EXHAUST * v[0],
        terminal_cost=lambda t, x, v: -x[0],
        controls=1,
        control_bounds=(0.0, LARGEST),
        duration_bounds=(0.01, 1.0),
        rates=lambda t, x, v, u: -u[0] / EXHAUST,
    )


def main():
    """Solve to a tolerance of the height."""
    return cg.solve(problem(), tol=1e-6, of=lambda path: path.cost)


def draw(path):
    """Draw height, mass and the mean thrust of every interval; returns the figure."""
    panels = cg.panels(3, size=(6.0, 7.0), sharex=True)
    times = np.linspace(*path.t[[0, -1]], 500)
    thrust = path.control.values.reshape(len(path.t) - 1, -1) @ path.method.quadrature.weights
    panels[0].plot(times, path(times)[0])
    panels[1].plot(times, path(times)[1])
    panels[2].stairs(thrust, path.t, baseline=None)
    for axes, name in zip(panels, ("height in Earth radii", "mass", "thrust over weight"), strict=True):
        axes.set_ylabel(name)
    panels[0].set_title(f"Goddard's rocket reaches {-path.cost:.7f} Earth radii")
    panels[-1].set_xlabel("time")
    return panels[0].figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"  height      {-answer.cost:.9f}, known to be {HIGHEST}")
    draw(answer).savefig("goddard.png")
