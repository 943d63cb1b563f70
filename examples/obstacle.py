"""A vehicle in the plane drives round a disc with the least ∫|u|²/2 dt; the disc is a path constraint.

The straight line runs through the disc a little below its center, so the cheaper way is below; the way above is a local
optimum, in which some of the random starts end.  The best path touches the disc in its lowest point at half time, and
is a cubic before and after: its cost is 6 for the unit length, and twice 6 d²/(T/2)³ for going down by d and up again.
Path constraints hold at the quadrature points; with a Lobatto rule these hold the joints, and with an even number of
intervals half time is one of them: the answer is then exact.
"""

import numpy as np

import casadi_galerkin as cg
from casadi_galerkin.solution.plotting import COLORS

CENTER, RADIUS, DURATION = (0.5, 0.05), 0.25, 1.0
EXACT, EXACT_ABOVE = (
    6 / DURATION**3 + 2 * 6 * d**2 / (DURATION / 2) ** 3 for d in (RADIUS - CENTER[1], RADIUS + CENTER[1])
)


def distance(t, x, v, u):
    """Squared distance from the disc's center."""
    return (x[0] - CENTER[0]) ** 2 + (x[1] - CENTER[1]) ** 2


def problem():
    """Unit mass from rest to rest, outside the disc."""
    return cg.ControlProblem(
        lambda t, x, v: (v[0] ** 2 + v[1] ** 2) / 2,
        (0.0, DURATION),
        start=[0.0, 0.0],
        end=[1.0, 0.0],
        start_velocity=[0.0, 0.0],
        end_velocity=[0.0, 0.0],
        force=lambda t, x, v, u: u,
        running_cost=lambda t, x, v, u: (u[0] ** 2 + u[1] ** 2) / 2,
        controls=2,
        path_constraint=(distance, RADIUS**2, np.inf),
    )


def main():
    """Solve from the straight line and from seven random paths, and return the best."""
    method = cg.Galerkin(degree=4, quadrature=cg.lobatto(5))
    return cg.solve(problem(), method, intervals=20, starts=8)


def draw(path):
    """Draw the path round the disc, with the directions of thrust, and its distance; returns the figure."""
    axes, bottom = cg.panels(2, size=(4.6, 5.6), height_ratios=(3, 2))
    path.plot_plane(axes=axes, labels=("x in m", "y in m"))
    turn = np.linspace(0, 2 * np.pi, 200)
    axes.fill(CENTER[0] + RADIUS * np.cos(turn), CENTER[1] + RADIUS * np.sin(turn), color="0.85")
    times = np.linspace(0, DURATION, 24)
    axes.quiver(*path(times), *path.control(times), color=COLORS[1], width=0.005)
    axes.set_title(f"Round an obstacle, at a cost of {path.cost:.6f}")
    path.plot_constraints(bottom, ["squared distance in m²"], "t in s")
    bottom.set_title("Its bound, dashed, pushes where it is touched")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"  exact       {EXACT} below, {EXACT_ABOVE} above")
    draw(answer).savefig("obstacle.png")
