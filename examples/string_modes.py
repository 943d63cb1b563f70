"""Ten modes of a string whose density varies, and of Mathieu's equation: eigenvalues are multipliers.

∫ (x'² + V x²)/2 dt is stationary among all x with ∫ ρ x²/2 dt = 1/2 where x'' + (λ ρ - V) x = 0, and minus the
multiplier is the eigenvalue λ.  The Morse index, on the space of variations that keep the integral, is the number of
the mode less one: it tells whether one was missed.  Each begins at a sine with as many waves, squeezed where the
density is large.

The string of density (1 + t)⁻² on (0, 1) has λ_n = 1/4 + (nπ / log 2)².  Mathieu's equation with zero ends on (0, π),
x'' + (λ - 2 q cos 2t) x = 0, has the characteristic values b_1(q), b_2(q), ...: https://dlmf.nist.gov/28.2.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

MODES, Q = range(1, 11), 5.0


def string():
    """State the string of varying density, and the fraction of its waves up to t."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2,
        (0.0, 1.0),
        start=[0.0],
        end=[0.0],
        integral_conditions=(lambda t, x, v: x[0] ** 2 / (1 + t) ** 2 / 2, [0.5]),
    )
    return problem, lambda t: np.log2(1 + t)


def mathieu():
    """State Mathieu's equation; its waves are nearly even."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 + Q * ca.cos(2 * t) * x[0] ** 2,
        (0.0, np.pi),
        start=[0.0],
        end=[0.0],
        integral_conditions=(lambda t, x, v: x[0] ** 2 / 2, [0.5]),
    )
    return problem, lambda t: t / np.pi


def main():
    """Find the modes of both, each on one graph."""
    return [modes(*string()), modes(*mathieu())]


def modes(problem, waves):
    """Find the modes of one problem."""
    transcription = cg.transcribe(problem, cg.Galerkin(degree=8), intervals=20)
    return [transcription.solve(guess=lambda t, n=n: [np.sin(n * np.pi * waves(t))]) for n in MODES]


def draw(found):
    """Draw the first modes, each at the height of its number; returns the figure."""
    panels = cg.panels(1, 2, size=(6.4, 3.6))
    for axes, modes, name in zip(panels, found, ("String of density (1 + t)⁻²", f"Mathieu, q = {Q:g}"), strict=True):
        for n, mode in zip(MODES, modes, strict=True):
            times = np.linspace(*mode.t[[0, -1]], 400)
            axes.plot(times, n + 0.4 * mode(times)[0] / np.abs(mode.x).max(), lw=1)
        axes.set(title=name, xlabel="t", ylabel="number of the mode")
    return panels[0].figure


if __name__ == "__main__":
    answer = main()
    for n, *modes in zip(MODES, *answer, strict=True):
        ours = [f"{-mode.integral_multipliers[0]:19.12f} (index {mode.morse_index})" for mode in modes]
        exact = 0.25 + (n * np.pi / np.log(2)) ** 2
        print(f"{n:3d} string {ours[0]}, exact {exact:19.12f};  b_{n} {ours[1]}")
    print(answer[0][-1])
    draw(answer).savefig("string_modes.png")
