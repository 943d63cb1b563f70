"""Seeded problems ε x'' = a(t) x' whose paths almost nothing ties to their ends: what is right, refused or wrong.

The velocity of the path is proportional to exp(A(t)/ε), A the integral of a.  Between two barriers of A the path
rests, and its place there is tied to the ends by exp(-depth/ε) alone: from some 36 on, by less than the last digit of a
double.  On a mesh that does not resolve how firmly it is tied it may be anything, with a small estimated error.
"""

import sys
from collections import Counter

import casadi as ca
import numpy as np

import casadi_galerkin as cg

DEEP = 30.0  # depth/ε from which rounding chooses the place: exp(-30) is 1e-13, and conditioning takes a digit or two
FINE = np.linspace(-1.0, 1.0, 100_001)


def case(seed):
    """A problem, a tolerance, its path at the times `FINE`, and how deep it rests, over ε."""
    random = np.random.default_rng(seed)
    count = random.integers(1, 4)
    heights, phases = random.normal(size=count), random.uniform(0, 2 * np.pi, count)
    rates = random.uniform(0.5, 4, count) * np.arange(1, count + 1)
    small, tol = 10 ** random.uniform(-4, -1), 10.0 ** -random.integers(1, 7)
    start, end = random.normal(size=2)

    def slope(t):
        return ca.dot(ca.DM(heights), ca.cos(ca.DM(rates) * t + ca.DM(phases)))

    exponent = (heights / rates) @ np.sin(np.outer(rates, FINE) + phases[:, None]) / small
    barrier = np.minimum(np.maximum.accumulate(exponent), np.maximum.accumulate(exponent[::-1])[::-1])
    speed = np.exp(exponent - np.max(exponent))
    risen = np.append(0.0, np.cumsum(speed[1:] + speed[:-1]))
    problem = cg.BoundaryProblem(
        lambda t, x, v: small * v[0] ** 2 / 2, (-1.0, 1.0), [start], [end], force=lambda t, x, v: slope(t) * v
    )
    return problem, tol, start + (end - start) * risen / risen[-1], np.max(barrier - exponent)


def verdict(seed):
    """Whether the path is tied, and what became of it."""
    problem, tol, exact, depth = case(seed)
    tied = "tied" if depth < DEEP else "tied by less than rounding"
    try:
        path = cg.solve(problem, tol=tol)
    except cg.ConvergenceError:
        return tied, "refused"
    error = np.max(np.abs(path(FINE)[0] - exact)) / np.max(np.abs(exact))
    return tied, "right" if error <= 2 * tol else "wrong"


def main(first=0, count=500):
    """Print how many of each; returns the numbers."""
    counted = Counter(verdict(seed) for seed in range(first, first + count))
    for (tied, what), number in sorted(counted.items()):
        print(f"{tied}: {number} {what}")
    return counted


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
