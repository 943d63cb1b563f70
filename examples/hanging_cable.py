"""A cable of given length between two masts hangs in a catenary, and its tension is the multiplier of its length.

Of all shapes x(s) of this length the cable takes the one of least potential energy, ∫ w x sqrt(1 + x'²) ds, a given
integral beside it.  What is stationary is ∫ (w x + μ) sqrt(1 + x'²) ds: where the height is x, the cable is pulled
with w x + μ, and its horizontal part, which is minus the energy of that Lagrangian, is the same everywhere.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

SPAN, MASTS, WEIGHT = 120.0, (20.0, 35.0), 15.0  # m, heights in m, and N/m
LENGTHS = (123.0, 127.0, 134.0)  # m


def length(s, x, v):
    """Length of the cable over the ground."""
    return ca.sqrt(1 + v[0] ** 2)


def problem():
    """State the cable with its height x(s) in m above the ground and its energy in J."""
    return cg.BoundaryProblem(
        lambda s, x, v: WEIGHT * x[0] * length(s, x, v),
        (0.0, SPAN),
        start=[MASTS[0]],
        end=[MASTS[1]],
        integral_conditions=(length, [LENGTHS[0]]),
    )


def main():
    """Solve for every length on the same graph."""
    transcription = cg.transcribe(problem(), cg.Galerkin(degree=8), intervals=16)
    return [transcription.solve(integral_values=[length]) for length in LENGTHS]


def tensions(cable):
    """Pull at the joints in N, and its horizontal part."""
    return WEIGHT * cable.x[0] + cable.integral_multipliers[0], -cable.energy


def draw(cables):
    """Draw all cables; returns the figure."""
    axes = cg.panels(size=(5.2, 3.4))
    for cable, length in zip(cables, LENGTHS, strict=True):
        s = np.linspace(0, SPAN, 200)
        axes.plot(s, cable(s)[0], label=f"{length:.0f} m, at most {tensions(cable)[0].max():.0f} N")
    axes.set(title="Cables of given length", xlabel="distance in m", ylabel="height in m")
    axes.legend(fontsize="small")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    for cable, length in zip(answer, LENGTHS, strict=True):
        pull, level = tensions(cable)
        a = level[0] / WEIGHT  # of the catenary x = a cosh((s - s_0) / a) + constant
        sag = np.sqrt(length**2 - np.diff(MASTS)[0] ** 2) - 2 * a * np.sinh(SPAN / 2 / a)
        print(f"{length:.0f} m: pulled with {pull[0]:.6f} N and {pull[-1]:.6f} N, off the catenary by {sag:.1e} m")
    print(answer[-1])
    draw(answer).savefig("hanging_cable.png")
