"""Planar Lyapunov orbits between Earth and Moon: orbits of unknown period at given Jacobi constants.

In the frame that turns with Earth and Moon, with their distance, their masses and their rate as units, the Lagrangian
does not depend on time.  Its energy E is given, the Jacobi constant is C = -2E, and the duration is found.  By symmetry
half of an orbit runs from the axis through Earth and Moon to that axis, and meets it at right angles at both ends: that
is the natural condition of a free component.  Around the libration point L1 such orbits exist below C = 3.18834.
The usual way to them is to shoot from the axis; the last one is found so, too.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

MOON = 0.012150585609624  # mass of the Moon over that of both
DAYS = 4.342478  # unit of time: the month that returns to the same stars, over 2π
JACOBI = (3.18, 3.16, 3.14, 3.12, 3.1, 3.08, 3.06)
POINT = 0.8369151257723568  # place of L1 on the axis
PERIOD, WIDTH = 2.7, 0.012  # of a small orbit, as a guess
STEEPNESS = 3.6  # height over width of a small orbit


def lagrangian(t, x, v):
    """Half of the squared velocity against the stars, and the potentials of Earth and Moon."""
    earth, moon = x - ca.DM([-MOON, 0]), x - ca.DM([1 - MOON, 0])
    against_stars = v + ca.vertcat(-x[1], x[0])
    return ca.sumsqr(against_stars) / 2 + (1 - MOON) / ca.norm_2(earth) + MOON / ca.norm_2(moon)


def ellipse(t):
    """Guess: half of a small orbit."""
    phase = 2 * np.pi * t / PERIOD
    return [POINT - WIDTH * np.cos(phase), STEEPNESS * WIDTH * np.sin(phase)]


def main():
    """Solve for one constant after the other, each from the last orbit; returns half orbits by constant."""
    problem = cg.BoundaryProblem(lagrangian, (0.0, PERIOD / 2), [None, 0.0], [None, 0.0], energy=-JACOBI[0] / 2)
    half = cg.transcribe(problem, cg.Galerkin(degree=10), intervals=16)
    orbits, last = {}, ellipse
    for constant in JACOBI:
        last = orbits[constant] = half.solve(energy=-constant / 2, guess=last)
    return orbits


def draw(orbits):
    """Draw the family, with the Moon; returns the figure."""
    axes = cg.panels(size=(4.6, 4.2))
    for constant, path in orbits.items():
        x, y = path(np.linspace(0.0, path.t[-1], 200))
        axes.plot(np.append(x, x[::-1]), np.append(y, -y[::-1]), label=f"C = {constant:g}")
    axes.plot(1 - MOON, 0, "o", color="0.5", label="Moon")
    axes.plot(POINT, 0, "k+", label="L1")
    axes.set(title="Lyapunov orbits around L1", xlabel="x in Earth-Moon distances", ylabel="y", aspect="equal")
    axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    return axes.figure


if __name__ == "__main__":
    answer = main()
    for constant, path in answer.items():
        period = 2 * path.t[-1]
        print(f"C = {constant:g}: from x = {path.x[0, 0]:.9f} to {path.x[0, -1]:.9f}, ", end="")
        print(f"period {period:.12f}, {DAYS * period:.4f} days, Morse index {path.morse_index} of half an orbit")
    print(cg.compare(path.problem, path.method, mesh=path.t, guess=answer[JACOBI[-2]]))
    draw(answer).savefig("lyapunov_orbit.png")
