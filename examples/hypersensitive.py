"""A problem of first order that forgets its ends at once: x' = -x³ + u, least ∫ (x² + u²)/2 over a long time.

There is nothing mechanical here, one component that follows its rate.  The path drops to zero
within a few units of time, stays there, and rises to the end in the last few; a mesh of equal intervals sees neither.
A tolerance grades the mesh by itself.

Both layers are known: with the Hamiltonian zero, the costate on the way to rest is -x³ + √(x⁶ + x²), and on the way
out of it -x³ - √(x⁶ + x²).  The cost is the integral of its absolute value, from zero up to either end.
"""

import numpy as np

import casadi_galerkin as cg

START, END, DURATION = 1.5, 1.0, 1e4


def problem():
    """One component, one control, no mechanics."""
    return cg.ControlProblem(
        rates=lambda t, x, u: -(x**3) + u,
        t_span=(0.0, DURATION),
        start=START,
        end=END,
        running_cost=lambda t, x, u: (x**2 + u**2) / 2,
        controls=1,
    )


def potential(x):
    """∫ √(s⁶ + s²) ds from 0 to x."""
    return (x**2 * np.sqrt(1 + x**4) + np.arcsinh(x**2)) / 4


EXACT = potential(START) - START**4 / 4 + potential(END) + END**4 / 4  # 1.33081


def main():
    """Solve to a tolerance, from eight equal intervals and a straight line."""
    return cg.solve(problem(), tol=1e-6)


def draw(path):
    """Draw the two layers, with the control, and leave out what is between; returns the figure."""
    sides = cg.panels(columns=2, size=(6.0, 4.0), sharey=True)
    for axes, first in zip(sides, (0, DURATION - 6), strict=True):
        times = np.linspace(first, first + 6, 300)
        axes.plot(times, path(times)[0], label="x")
        axes.plot(times, path.control(times)[0], label="u")
        axes.set_xlabel("time")
        axes.ticklabel_format(useOffset=False)
    sides[0].set_title("Dropping to rest")
    sides[1].set_title("Rising from it")
    sides[1].legend()
    return sides[0].figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"  exact cost  {EXACT:.12f}, so the error is {abs(answer.cost / EXACT - 1):.1e} of it")
    print(f"  intervals from {np.diff(answer.t).min():.2g} to {np.diff(answer.t).max():.4g} long")
    draw(answer).savefig("hypersensitive.png")
