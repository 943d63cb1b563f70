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
from show import canvas, picture, save

import casadi_galerkin as cg
from casadi_galerkin.solution.plotting import COLORS

METHOD, INTERVALS, REPEATS = cg.Galerkin(degree=4), (10, 20, 40, 80, 160), 5
ECCENTRICITY, ANOMALY = 0.6, 2.0
HALF = ANOMALY - ECCENTRICITY * np.sin(ANOMALY)  # half of the time of flight, by Kepler's equation


def gravity(t, x, v):
    """Kinetic minus potential energy in the field of a unit mass."""
    return ca.dot(v, v) / 2 + 1 / ca.norm_2(x)


def upright(t, x, v):
    """Pendulum near upright; x[0] is the small angle from there."""
    return v[0] ** 2 / 2 + x[0] ** 2 / 2


def orbit(t):
    """Position on the Kepler orbit at a time from the perihelion, by Kepler's equation; (2,)."""
    anomaly = t
    for _ in range(50):
        anomaly -= (anomaly - ECCENTRICITY * np.sin(anomaly) - t) / (1 - ECCENTRICITY * np.cos(anomaly))
    return np.array([np.cos(anomaly) - ECCENTRICITY, np.sqrt(1 - ECCENTRICITY**2) * np.sin(anomaly)])


def balanced(duration):
    """The upright pendulum from 1 to 1, and its exact path, written so that nothing overflows."""
    problem = cg.BoundaryProblem(upright, (0.0, duration), [1.0], [1.0])
    return problem, lambda t: [(np.exp(-t) + np.exp(t - duration)) / (1 + np.exp(-duration))], None


SCENES = {
    "Kepler arc": (
        cg.BoundaryProblem(gravity, (-HALF, HALF), orbit(-HALF), orbit(HALF)),
        orbit,
        lambda t: [np.cos(2 * t / HALF) - ECCENTRICITY / 2, np.sin(2 * t / HALF)],
    ),
    "balanced for 15": balanced(15.0),
    "balanced for 40": balanced(40.0),
}


def joint_error(path, exact):
    """Largest error at the joints, relative to the size of the component."""
    known = np.stack([exact(t) for t in path.t], axis=1)
    return float(np.max(np.abs(path.x - known) / np.max(np.abs(known), axis=1, keepdims=True)))


def shot(problem, intervals, exact, guess):
    """What shooting costs and gives on so many intervals, or why it fails."""
    try:
        paths = [cg.shoot(problem, METHOD, intervals, guess=guess) for _ in range(REPEATS)]
    except cg.ConvergenceError as failure:
        return cg.Row(METHOD, intervals, failure=str(failure))
    return cg.Row(
        METHOD,
        intervals,
        solve_seconds=median(path.solve_seconds for path in paths),
        iterations=paths[0].iterations,
        joint_error=joint_error(paths[0], exact),
    )


def main(plot=None):
    """Measure both ways on all scenes; returns {scene: (rows of the global solve, rows of shooting)}."""
    measured = {}
    for name, (problem, exact, guess) in SCENES.items():
        coarse = cg.solve(problem, cg.Galerkin(degree=2), INTERVALS[0], guess=guess)
        together = cg.trade(problem, [METHOD], INTERVALS, exact, guess=coarse).rows
        measured[name] = together, tuple(shot(problem, count, exact, coarse) for count in INTERVALS)
    if plot:
        draw(measured, plot)
    return measured


def draw(measured, name):
    """Draw errors over seconds: lines for the global solve, dashes for shooting."""
    title = "All intervals at once, and shooting"
    axes = canvas(title, "seconds of a solve", "largest relative error at the joints", (8.0, 4.2))
    for color, (scene, ways) in zip(COLORS, measured.items(), strict=False):
        for way, rows, style in zip(("at once", "shooting"), ways, ("o-", "s--"), strict=True):
            solved = [row for row in rows if row.failure is None]
            times, errors = [row.solve_seconds for row in solved], [row.joint_error for row in solved]
            failed = f", {len(rows) - len(solved)} of {len(rows)} fail" if len(solved) < len(rows) else ""
            axes.loglog(times, errors, style, color=color, markersize=4, label=f"{scene}, {way}{failed}")
    axes.figure.legend(fontsize="small", loc="outside right center")
    save(axes, name)


if __name__ == "__main__":
    for scene, ways in main(picture("global_against_shooting.png")).items():
        print(f"{scene}\n{'':11}{'at once':>30}{'shooting':>30}")
        print(f"{'intervals':>11}" + 2 * f"{'iterations':>12}{'ms':>7}{'error':>11}")
        for pair in zip(*ways, strict=True):
            cells = [
                f"{row.iterations:12d}{1e3 * row.solve_seconds:7.2f}{row.joint_error:11.1e}"
                if row.failure is None
                else f"  {row.failure.split('. ')[0]}"
                for row in pair
            ]
            print(f"{pair[0].intervals:11d}" + "".join(cells))
