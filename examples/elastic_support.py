"""A taut cable with ice hangs from a ring, which is lifted with a given force, to an elastic support, which gives way.

In equilibrium the energy of the cable, ∫ (H x'²/2 + w x) ds over the distance s, and of the spring, k x²/2, is
stationary.  The force on the ring is a momentum given at the start, H x' = -F, and the spring an action of the end:
nobody writes down the balance of forces there, H x' = -k x.  The weight w of the ice grows along the cable.
"""

import numpy as np

import casadi_galerkin as cg

SPAN, TENSION, LIFT, SPRING = 40.0, 2000.0, 100.0, 300.0  # m, N, N, N/m
WEIGHT, ICE = 5.0, 0.4  # of the cable in N/m, and what the ice adds on every meter in N/m²


def problem():
    """State the cable with its height x(s) in m; both heights at the ends are free."""
    return cg.BoundaryProblem(
        lambda s, x, v: TENSION * v[0] ** 2 / 2 + (WEIGHT + ICE * s) * x[0],
        (0.0, SPAN),
        start=[None],
        end=[None],
        start_momentum=[-LIFT],
        end_action=lambda x0, x1: SPRING * x1[0] ** 2 / 2,
    )


def exact(s):
    """Height by integrating H x'' = w twice, and the balance of forces at the end."""

    def hanging(s):
        return (-LIFT * s + WEIGHT * s**2 / 2 + ICE * s**3 / 6) / TENSION

    load = WEIGHT * SPAN + ICE * SPAN**2 / 2 - LIFT  # what is left for the spring
    return hanging(s) - hanging(SPAN) - load / SPRING


def main():
    """Solve with polynomials of degree 3, which hold the exact shape."""
    return cg.solve(problem(), cg.Galerkin(degree=3), intervals=4)


def draw(path):
    """Draw the cable; returns the figure."""
    axes = path.plot(labels=["height in m"], time="distance in m")
    axes.set_title("A cable from a lifted ring to a spring")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    error = np.max(np.abs(answer.x[0] - exact(answer.t)))
    first, last = answer.x[0, [0, -1]]
    print(f"  height      {first:.6f} m at the ring, {last:.6f} m at the spring, error {error:.1e} m")
    print(f"  forces      {answer.momentum[0, -1]:.6f} N on the spring, {-SPRING * last:.6f} N from it")
    print(cg.compare(problem(), answer.method, mesh=answer.t))  # shooting meets the same ends
    draw(answer).savefig("elastic_support.png")
