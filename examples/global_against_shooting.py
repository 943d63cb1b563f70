"""Speed against accuracy of the two ways to a boundary problem: all intervals at once, and shooting from the start.

Both solve the same discrete equations from the same coarse path, so where both work they give the same errors; what
they magnify of the rounding differs.  Round the sun, on a Kepler arc, both keep all digits.  A pendulum balanced
upright for a time T, x'' = x, has a part that grows like e^T and one that decays: shooting keeps a rounding error of
e^T ε, and at T = 40 no start that a computer holds meets the end.  To the global solve T makes no difference.

Measured is the position at a joint late on the path, where rounding has grown and the order is twice the degree.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

METHOD, INTERVALS = cg.Galerkin(degree=4), (10, 20, 40, 80, 160)
ECCENTRICITY, ANOMALY = 0.6, 2.0
HALF = ANOMALY - ECCENTRICITY * np.sin(ANOMALY)  # half of the time of flight, by Kepler's equation
X, Y = np.cos(ANOMALY) - ECCENTRICITY, np.sqrt(1 - ECCENTRICITY**2) * np.sin(ANOMALY)


def upright(duration):
    """The pendulum near upright, from 1 to 1."""
    return cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + x[0] ** 2 / 2, (0.0, duration), [1.0], [1.0]), None


SCENES = {
    "Kepler arc": (
        cg.BoundaryProblem(lambda t, x, v: ca.dot(v, v) / 2 + 1 / ca.norm_2(x), (-HALF, HALF), [X, -Y], [X, Y]),
        lambda t: [np.cos(2 * t / HALF) - ECCENTRICITY / 2, np.sin(2 * t / HALF)],
    ),
    "upright for 15": upright(15.0),
    "upright for 40": upright(40.0),
}


def late_position(path):
    """First component after nine tenths of the time, a joint of every mesh."""
    begin, end = path.problem.t_span
    return path(begin + 0.9 * (end - begin))[0]


def main():
    """Measure both ways on all scenes; returns the trade of each."""
    measured = {}
    for name, (problem, guess) in SCENES.items():
        coarse = cg.solve(problem, cg.Galerkin(degree=2), INTERVALS[0], guess=guess)
        measured[name] = cg.trade(problem, [METHOD], INTERVALS, shooting=True, of=late_position, guess=coarse)
    return measured


def draw(measured):
    """Draw the trades one above the other, with one legend; returns the figure."""
    panels = cg.panels(3, size=(4.6, 7.6), sharex=True, sharey=True)
    for axes, (scene, trade) in zip(panels, measured.items(), strict=True):
        failed = any(row.failure is not None for row in trade.rows)
        trade.plot(axes).set(title=f"{scene}: shooting fails" if failed else scene, ylabel="relative error")
    handles = panels[0].get_legend().legend_handles
    for axes in panels:
        axes.get_legend().remove()
        axes.label_outer()
    axes.figure.legend(handles=handles, fontsize="small", loc="outside lower center", ncols=2)
    return axes.figure


if __name__ == "__main__":
    answer = main()
    for scene, trade in answer.items():
        print(f"{scene}\n{trade}\n")
    draw(answer).savefig("global_against_shooting.png")
