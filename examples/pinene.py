"""Five rate constants of α-pinene from measurements: parameters that are free, and a cost at given times.

Heated α-pinene becomes dipentene, allo-ocimene, β-pyronene and a dimer.  Their concentrations were measured eight times
(R. E. Fuguitt, J. E. Hawkins, 1947).  A sixth component counts the squares of what is missed: it has no rate, and jumps
where something was measured.  There are no controls, and the start is known: what is free are the constants.

In COPS 3 (2004) the least sum of squares is 19.872167.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

TIMES = np.array([0.123, 0.306, 0.492, 0.78, 1.068, 1.503, 2.262, 3.642])  # in 10⁴ minutes
MEASURED = np.array(  # in percent
    [
        [88.35, 7.3, 2.3, 0.4, 1.75],
        [76.4, 15.6, 4.5, 0.7, 2.8],
        [65.1, 23.1, 5.3, 1.1, 5.8],
        [50.4, 32.9, 6.0, 1.5, 9.3],
        [37.5, 42.7, 6.0, 1.9, 12.0],
        [25.9, 49.1, 5.9, 2.2, 17.0],
        [14.0, 57.4, 5.1, 2.6, 21.0],
        [4.5, 63.1, 3.8, 2.9, 25.7],
    ]
)
PUBLISHED = 19.872167


def rates(t, x, p):
    """Of the five concentrations, and none of the sum of squares."""
    return [-(p[0] + p[1]) * x[0], p[0] * x[0], p[1] * x[0] - (p[2] + p[3]) * x[2] + p[4] * x[4], p[2] * x[2],
            p[3] * x[2] - p[4] * x[4], 0]  # fmt: skip


def missed(x, values):
    """The sum of squares after a measurement."""
    return x[5] + ca.sumsqr(x[:5] - values)


def problem():
    """All α-pinene at the start; constants that are not negative."""

    def measurement(values):
        return lambda x, p: ca.vertcat(x[:5], missed(x, values))

    return cg.ControlProblem(
        rates=rates,
        t_span=(0.0, TIMES[-1]),
        start=[100.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        parameters=[0.5] * 5,  # a guess
        parameter_bounds=(0.0, 10.0),
        jumps=[(t, measurement(values)) for t, values in zip(TIMES[:-1], MEASURED[:-1], strict=True)],
        terminal_cost=lambda t, x, p: missed(x, MEASURED[-1]),
    )


def main():
    """Solve with two intervals between measurements."""
    return cg.solve(problem(), cg.Galerkin(degree=6), intervals=16)


def draw(path):
    """Draw concentrations and measurements; returns the figure."""
    axes = cg.panels(size=(6.0, 4.0))
    times = np.linspace(0.0, TIMES[-1], 300)
    for i, name in enumerate(("α-pinene", "dipentene", "allo-ocimene", "β-pyronene", "dimer")):
        (line,) = axes.plot(times, path(times)[i], label=name)
        axes.plot(TIMES, MEASURED[:, i], "o", color=line.get_color(), markersize=4)
    axes.set(title="Isomers of α-pinene", xlabel="time in 10⁴ minutes", ylabel="percent")
    axes.legend()
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"  sum of squares {answer.cost:.6f}, published {PUBLISHED}; constants", np.round(answer.parameters, 6))
    draw(answer).savefig("pinene.png")
