"""A double pendulum in chaotic motion: the same equations solved globally and step by step, until chaos parts them.

The ends come from a motion of 24 s, rounded to two digits.  The global solve finds a motion between these ends that
meets both to the last digit.  Stepping from that very path's start leaves it, the gap growing by a factor e about
twice a second, and shooting has no start to offer: the end magnifies a change of it beyond all digits of a double.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import casadi_galerkin as cg

GRAVITY = 9.81
DURATION, STEPS_A_SECOND = 24, 25


def lagrangian(t: ca.SX, x: ca.SX, v: ca.SX) -> ca.SX:
    """Two masses of 1 on rods of length 1; x are the angles from hanging."""
    kinetic = v[0] ** 2 + v[1] ** 2 / 2 + v[0] * v[1] * ca.cos(x[0] - x[1])
    return kinetic + GRAVITY * (2 * ca.cos(x[0]) + ca.cos(x[1]))


def main() -> cg.Comparison:
    """Compare the global path with the stepwise ways to it."""
    method, intervals = cg.Galerkin(degree=8), DURATION * STEPS_A_SECOND
    start = [2.0, 2.5]
    motion = cg.InitialProblem(lagrangian, (0, DURATION), start=start, velocity=[0, 0])
    guess = cg.solve(motion, method, intervals)
    problem = cg.BoundaryProblem(lagrangian, (0, DURATION), start=start, end=np.round(guess.x[:, -1], 2).tolist())
    return cg.compare(problem, method, intervals, guess=guess)


def draw(comparison):
    """Draw how far the steps come apart from the global path; returns the figure."""
    axes = comparison.plot(time="t in s")
    axes.set_title("Chaos parts the steps from the global path")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"parted at t = {answer.parting_time:g} s")
    answer.to_npz("double_pendulum.npz")  # the gaps over time
    draw(answer).savefig("double_pendulum.png")
