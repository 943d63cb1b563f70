"""Does one quadrature point more lower the error where the mass depends on the position?  Measure it.

Gauss(m) and Gauss(m + 1) have the same order 2m at the joints; only the constants differ, and by how much, and which
way, depends on the problem.  With a mass of 1 + x² the extra point helps; with e^x Gauss(m) is both the better and the
cheaper rule.
"""

import casadi as ca

import casadi_galerkin as cg
from casadi_galerkin.solution.plotting import COLORS

DEGREES, INTERVALS = (1, 2, 3), (2, 4, 8)


def oscillator(t, x, v):
    """Mass 1 + x² on a stiffening spring."""
    return (1 + x[0] ** 2) * v[0] ** 2 / 2 - x[0] ** 2 / 2 - x[0] ** 4 / 4


def exponential(t, x, v):
    """Mass e^x on a spring."""
    return ca.exp(x[0]) * v[0] ** 2 / 2 - x[0] ** 2 / 2


PROBLEMS = {
    "mass 1 + x²": cg.BoundaryProblem(oscillator, (0.0, 1.0), start=[0.7], end=[0.597334565142283]),
    "mass exp(x)": cg.BoundaryProblem(exponential, (0.0, 1.0), start=[0.0], end=[2.0]),
}


def gains(measured):
    """Factors by which the joint error on the finest mesh falls with one point more, by degree."""
    errors = {(row.method, row.intervals): row.joint_error for row in measured.rows}
    factors = {}
    for degree in DEGREES:
        few, more = (cg.Galerkin(degree, quadrature=cg.gauss(points)) for points in (degree, degree + 1))
        factors[degree] = errors[few, INTERVALS[-1]] / errors[more, INTERVALS[-1]]
    return factors


def main():
    """Compare both rules on both problems; returns the trades."""
    methods = [cg.Galerkin(m, quadrature=cg.gauss(r)) for m in DEGREES for r in (m, m + 1)]
    return {name: cg.trade(problem, methods, INTERVALS) for name, problem in PROBLEMS.items()}


def draw(answer):
    """Draw the errors of the first problem; returns the figure."""
    axes, rows = cg.panels(size=(4.6, 3.8)), answer["mass 1 + x²"].rows
    for i, method in enumerate(dict.fromkeys(row.method for row in rows)):
        chosen, points = [row for row in rows if row.method == method], len(method.quadrature)
        style = {"color": COLORS[method.degree - 1], "linestyle": "--" if i % 2 else "-"}
        label = f"degree {method.degree}, {points} points"
        axes.loglog([row.intervals for row in chosen], [row.joint_error for row in chosen], "o", label=label, **style)
    axes.set(title="Mass 1 + x²: one quadrature point more", xlabel="intervals", ylabel="error at the joints")
    axes.set_xticks(INTERVALS, labels=INTERVALS)
    axes.set_xticks([], minor=True)
    axes.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
    return axes.figure


if __name__ == "__main__":
    answer = main()
    for mass, measured in answer.items():
        for degree, factor in gains(measured).items():
            print(f"{mass}, degree {degree}: error of Gauss({degree}) over that of Gauss({degree + 1}) {factor:.1f}")
    draw(answer).savefig("mass_quadrature.png")
