"""A pendulum between two angles in ten seconds: one problem, several stationary paths.

All of them are critical points of the action.  Which one Newton's method finds depends on the guess; the Morse
index, the number of directions in which the action decreases, tells them apart.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

DURATION, ANGLE = 10.0, 1.0


def lagrangian(t, x, v):
    """Kinetic minus potential energy over m l², for a length at which g/l = 1/s²; x[0] is the angle from below."""
    return v[0] ** 2 / 2 + ca.cos(x[0])


def swinging(amplitude, periods):
    """Guess: so many oscillations about the straight line."""
    return lambda t: [ANGLE * t / DURATION + amplitude * np.sin(2 * np.pi * periods * t / DURATION)]


# velocities at the start by shooting in higher precision, by Morse index
KNOWN = {0: 1.9995687170165, 1: 1.8318277309911, 2: 1.3287479250456}
# one half oscillation that goes nearly over the top, one whole one, and the straight line
GUESSES = (swinging(3.0, 0.5), swinging(2.0, 1.0), None)


def main():
    """Solve from three guesses, transcribing once; returns the paths by their Morse index."""
    problem = cg.BoundaryProblem(lagrangian, (0.0, DURATION), start=[0.0], end=[ANGLE])
    swing = cg.transcribe(problem, cg.Galerkin(degree=6), intervals=60)
    found = [swing.solve(guess=guess) for guess in GUESSES]
    return {path.morse_index: path for path in found}


def draw(paths):
    """Draw all paths into one picture; returns the figure."""
    axes, times = cg.panels(size=(4.6, 3.6)), np.linspace(0, DURATION, 600)
    for index, path in sorted(paths.items()):
        axes.plot(times, path(times)[0], label=f"Morse index {index}, action {path.action:.4f}")
    axes.plot([0, DURATION], [0, ANGLE], "ko")
    axes.set(title="Three paths between the same ends", xlabel="t in s", ylabel="angle in rad")
    axes.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.16))
    return axes.figure


if __name__ == "__main__":
    answer = main()
    for index, path in sorted(answer.items()):
        print(f"Morse index {index}: starts with velocity {path.velocity[0, 0]:.13f}, known {KNOWN[index]}\n{path}")
    draw(answer).savefig("pendulum.png")
