"""Does one quadrature point more lower the error where the mass depends on the position?  Measure it.

Gauss(m) and Gauss(m + 1) have the same order 2m at the joints; only the constants differ, and by how much, and which
way, depends on the problem.  With a mass of 1 + x² the extra point helps; with e^x Gauss(m) is both the better and the
cheaper rule.
"""

import casadi as ca
from show import canvas, picture, save

import casadi_galerkin as cg

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


def main(plot=None):
    """Compare both rules on both problems; returns the gains of each by degree."""
    methods = [cg.Galerkin(m, quadrature=cg.gauss(r)) for m in DEGREES for r in (m, m + 1)]
    trades = {name: cg.trade(problem, methods, INTERVALS) for name, problem in PROBLEMS.items()}
    if plot:
        rows = trades["mass 1 + x²"].rows
        axes = canvas("Mass 1 + x²: one quadrature point more", "intervals", "error at the joints", (8.0, 4.0))
        for method in methods:
            chosen = [row for row in rows if row.method == method]
            axes.loglog([row.intervals for row in chosen], [row.joint_error for row in chosen], "o-", label=str(method))
        axes.set_xticks(INTERVALS, labels=INTERVALS)
        axes.set_xticks([], minor=True)
        axes.figure.legend(fontsize="small", loc="outside right center")
        save(axes, plot)
    return {name: gains(measured) for name, measured in trades.items()}


if __name__ == "__main__":
    for mass, factors in main(picture("mass_quadrature.png")).items():
        for degree, factor in factors.items():
            print(f"{mass}, degree {degree}: error of Gauss({degree}) over that of Gauss({degree + 1}) {factor:.1f}")
