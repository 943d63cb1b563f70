"""Robertson's reactions: two rates, and a third concentration that no rate but an equation determines.

The unknown function without a rate is a control, and its equation a path constraint with equal bounds: a system of
differential and algebraic equations (DAE).  Nothing is left to choose, so there is no cost.  Radau's rule suits it: its
last point is the end of an interval.  The second substance rises within a thousandth of a second to a few millionths of
the first, and all goes on for much longer: joints are closer at the start.  The numbers at 40 s are those with which
solvers of stiff equations are tested (H. H. Robertson, 1966).
"""

import numpy as np

import casadi_galerkin as cg

DURATION = 40.0  # s
PUBLISHED = 0.7158270687193941, 0.9185534764557338e-5, 0.2841637457458413
MESH = np.append(0.0, np.geomspace(1e-4, DURATION, 24))


def rates(t, x, u):
    """Of the first two concentrations; u is the third."""
    slow, fast = 0.04 * x[0] - 1e4 * x[1] * u[0], 3e7 * x[1] ** 2
    return [-slow, slow - fast]


def problem():
    """Nothing but the first substance at the start; what there is stays one in all."""
    return cg.ControlProblem(
        rates=rates,
        t_span=(0.0, DURATION),
        start=[1.0, 0.0],
        controls=1,
        path_constraint=(lambda t, x, u: x[0] + x[1] + u[0] - 1, 0.0, 0.0),
    )


def main():
    """Solve from a guess of path and third concentration."""
    guess = (lambda t: [1.0 - 0.007 * t, 1e-5], lambda t: [0.007 * t])
    return cg.solve(problem(), cg.Galerkin(degree=7, quadrature=cg.radau(7)), mesh=MESH, guess=guess)


def draw(path):
    """Draw the three concentrations over the logarithm of time; returns the figure."""
    axes = cg.panels(size=(6.0, 4.0))
    times = np.geomspace(1e-6, DURATION, 400)
    for values, label in zip((*path(times), path.control(times)[0]), ("first", "second, 10⁴", "third"), strict=True):
        axes.plot(times, values * (1e4 if "second" in label else 1), label=label)
    axes.set(title="Robertson's reactions", xlabel="time in s", ylabel="concentration", xscale="log")
    axes.legend(loc="center left")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    found = *answer.x[:, -1], answer.control(DURATION)[0]
    for name, value, published in zip(("first", "second", "third"), found, PUBLISHED, strict=True):
        print(f"  {name:7}{value:20.13e}, published {published:20.13e}")
    draw(answer).savefig("robertson.png")
