"""Speed against accuracy of the two ways to a boundary problem: all intervals at once, and shooting from the start.

Both solve the same discrete equations from the same coarse path, so where both work they give the same errors; what
they magnify of the rounding differs.  Round the sun, on a Kepler arc, both keep all digits.  A pendulum balanced
upright for a time T, x'' = x, has a part that grows like e^T and one that decays: shooting keeps a rounding error of
e^T ε, and at T = 40 no start that a computer holds meets the end.  To the global solve T makes no difference.

Times are medians of repeated solves, without what is built before them: the graph of all intervals, or that of a step.
"""

from statistics import median

import casadi as ca
import numpy as np

import casadi_galerkin as cg
from casadi_galerkin.solution.plotting import COLORS

METHOD, INTERVALS, REPEATS = cg.Galerkin(degree=4), (10, 20, 40, 80, 160), 3
ECCENTRICITY, ANOMALY = 0.6, 2.0
HALF = ANOMALY - ECCENTRICITY * np.sin(ANOMALY)  # half of the time of flight, by Kepler's equation


def orbit(t):
    """Position on the Kepler orbit at a time from the perihelion, by Kepler's equation; (2,)."""
    anomaly = t
    for _ in range(50):
        anomaly -= (anomaly - ECCENTRICITY * np.sin(anomaly) - t) / (1 - ECCENTRICITY * np.cos(anomaly))
    return np.array([np.cos(anomaly) - ECCENTRICITY, np.sqrt(1 - ECCENTRICITY**2) * np.sin(anomaly)])


def arc():
    """The Kepler arc, its exact path, and a guess that goes round the sun."""
    ends = (-HALF, HALF), orbit(-HALF), orbit(HALF)
    problem = cg.BoundaryProblem(lambda t, x, v: ca.dot(v, v) / 2 + 1 / ca.norm_2(x), *ends)
    return problem, orbit, lambda t: [np.cos(2 * t / HALF) - ECCENTRICITY / 2, np.sin(2 * t / HALF)]


def balanced(duration):
    """The upright pendulum from 1 to 1, and its exact path, written so that nothing overflows."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + x[0] ** 2 / 2, (0.0, duration), [1.0], [1.0])
    return problem, lambda t: [(np.exp(-t) + np.exp(t - duration)) / (1 + np.exp(-duration))], None


SCENES = {"Kepler arc": arc(), "balanced for 15": balanced(15.0), "balanced for 40": balanced(40.0)}


def shot(problem, intervals, exact, guess):
    """What shooting costs and gives on so many intervals, or why it fails."""
    try:
        paths = [cg.shoot(problem, METHOD, intervals, guess=guess) for _ in range(REPEATS)]
    except cg.ConvergenceError as failure:
        return cg.Row(METHOD, intervals, failure=str(failure))
    known = np.stack([exact(t) for t in paths[0].t], axis=1)
    error = np.max(np.abs(paths[0].x - known) / np.max(np.abs(known), axis=1, keepdims=True))
    seconds = median(path.solve_seconds for path in paths)
    return cg.Row(METHOD, intervals, solve_seconds=seconds, iterations=paths[0].iterations, joint_error=error)


def main():
    """Measure both ways on all scenes; returns {scene: (rows of the global solve, rows of shooting)}."""
    measured = {}
    for name, (problem, exact, guess) in SCENES.items():
        coarse = cg.solve(problem, cg.Galerkin(degree=2), INTERVALS[0], guess=guess)
        together = cg.trade(problem, [METHOD], INTERVALS, exact, guess=coarse).rows
        measured[name] = together, tuple(shot(problem, count, exact, coarse) for count in INTERVALS)
    return measured


def draw(measured):
    """Draw errors over seconds: lines for the global solve, dashes for shooting; returns the figure."""
    axes = cg.panels(size=(4.6, 4.0))
    for i, (scene, ways) in enumerate(measured.items()):
        for way, rows, style in zip(("at once", "shooting"), ways, ("o-", "s--"), strict=True):
            solved = [(row.solve_seconds, row.joint_error) for row in rows if row.failure is None]
            if solved:
                axes.loglog(*zip(*solved, strict=True), style, color=COLORS[i], markersize=4, label=f"{scene}, {way}")
    axes.set(title="Shooting (dashed) fails from T = 40", xlabel="seconds of a solve", ylabel="largest error at joints")
    axes.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2)
    return axes.figure


if __name__ == "__main__":
    answer = main()
    for scene, ways in answer.items():
        print(f"{scene}\n{'intervals':>11}{'iterations, ms and error at once, then by shooting':>56}")
        for pair in zip(*ways, strict=True):
            cells = [
                f"{row.iterations:12d}{1e3 * row.solve_seconds:7.2f}{row.joint_error:11.1e}"
                if row.failure is None
                else f"  {row.failure.split('. ')[0]}"
                for row in pair
            ]
            print(f"{pair[0].intervals:11d}" + "".join(cells))
    draw(answer).savefig("global_against_shooting.png")
