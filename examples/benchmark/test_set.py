"""A dozen of Cash's test problems, ε x'' = F(t, x, x'), from a straight line: the error in tolerances, and seconds.

They are those of J. R. Cash's problems, in his numbering, whose path is known and has layers, corners or narrow
features.  Beside it stands what SciPy's `solve_bvp` does from the same line, on eleven points.  Its tolerance is one of
residuals, so that its errors are no measure of it; "-" stands for no path.
"""

import time

import numpy as np
from casadi import cos, exp, sin
from scipy.integrate import solve_bvp
from scipy.special import erf

import casadi_galerkin as cg

PI, POINTS = np.pi, 20_000  # of which `solve_bvp` takes no more


def bend(e, t):
    """From -t to t at t = 0, over √ε."""
    bent = [s * erf(s / np.sqrt(2 * e)) + np.sqrt(2 * e / PI) * np.exp(-(s**2) / (2 * e)) for s in (t, 1.0)]
    return bent[0] / bent[1]


def layer(width, t):
    """From 1 at t = 0 to 0 at t = 1, over a width."""
    return np.exp(-t / width) * np.expm1(2 * (t - 1) / width) / np.expm1(-2 / width)


PROBLEMS = {  # by number: times, F(ε, t, x, v), path(ε, t)
    1: ((0, 1), lambda e, t, x, v: x, lambda e, t: layer(e**0.5, t)),
    2: ((0, 1), lambda e, t, x, v: v, lambda e, t: np.expm1((t - 1) / e) / np.expm1(-1 / e)),
    3: ((-1, 1), lambda e, t, x, v: x - (1 + e * PI**2) * cos(PI * t) - (2 + cos(PI * t)) * (v + PI * sin(PI * t)),
        lambda e, t: np.cos(PI * t)),
    4: ((-1, 1), lambda e, t, x, v: (1 + e) * x - v, lambda e, t: np.exp(t - 1) + np.exp(-(1 + e) * (1 + t) / e)),
    7: ((-1, 1), lambda e, t, x, v: x - t * v - (1 + e * PI**2) * cos(PI * t) - PI * t * sin(PI * t),
        lambda e, t: np.cos(PI * t) + t + bend(e, t)),
    9: ((-1, 1), lambda e, t, x, v: -e * (4 * t * v + 2 * x) / (e + t**2), lambda e, t: 1 / (e + t**2)),
    10: ((-1, 1), lambda e, t, x, v: -t * v, lambda e, t: 1 + erf(t / (2 * e) ** 0.5) / erf(1 / (2 * e) ** 0.5)),
    13: ((-1, 1), lambda e, t, x, v: x - (1 + e * PI**2) * cos(PI * t),
         lambda e, t: np.cos(PI * t) + layer(e**0.5 / 2, (1 + t) / 2)),
    17: ((-0.1, 0.1), lambda e, t, x, v: -3 * (e / (e + t**2)) ** 2 * x, lambda e, t: t / (e + t**2) ** 0.5),
    18: ((0, 1), lambda e, t, x, v: -v, lambda e, t: np.exp(-t / e)),
    20: ((0, 1), lambda e, t, x, v: 1 - v**2,
         lambda e, t: 1 + e * (np.logaddexp((t - 0.745) / e, (0.745 - t) / e) - np.log(2))),
    21: ((0, 1), lambda e, t, x, v: x + x**2 - exp(-2 * t / e**0.5), lambda e, t: np.exp(-t / e**0.5)),
}  # fmt: skip


def of_package(e, tol, span, start, end, force):
    """The path that `cg.solve` finds, and its joints."""
    problem = cg.BoundaryProblem(lambda t, x, v: e * v[0] ** 2 / 2, span, [start], [end], force=lambda *p: force(e, *p))
    path = cg.solve(problem, tol=tol)
    return (lambda t: path(t)[0]), path.t


@np.errstate(all="ignore")  # where it diverges
def of_scipy(e, tol, span, start, end, force):
    """The same of `solve_bvp`."""
    times, slope = np.linspace(*span, 11), (end - start) / (span[1] - span[0])
    found = solve_bvp(
        lambda t, y: np.vstack((y[1], np.array(force(e, t[:, None], *y[:, :, None])).ravel() / e)),
        lambda left, right: np.array([left[0] - start, right[0] - end]),
        times, np.vstack((start + slope * (times - times[0]), slope + 0 * times)), tol=tol, max_nodes=POINTS,
    )  # fmt: skip
    if not found.success:
        raise cg.ConvergenceError(found.message)
    return (lambda t: found.sol(t)[0]), found.x


def outcome(number, e, tol, solve):
    """The largest error over the tolerance and the path's size, infinite where there is no path, and seconds."""
    span, force, exact = PROBLEMS[number]
    began = time.perf_counter()
    try:
        path, joints = solve(e, tol, span, *(float(exact(e, float(t))) for t in span), force)
    except cg.ConvergenceError:
        return np.inf, time.perf_counter() - began
    seconds, times = time.perf_counter() - began, np.union1d(np.linspace(*span, 1001), joints)
    return np.max(np.abs(path(times) - exact(e, times))) / np.max(np.abs(exact(e, times))) / tol, seconds


def main(tol=1e-6, stiffness=(1e-1, 1e-3, 1e-4, 1e-6)):
    """Print a line for each problem; returns errors in tolerances of this package and of `solve_bvp`, (K, 2)."""
    print("problem" + "".join(f"{f'ε = {e:g}':>15}{'solve_bvp':>13}" for e in stiffness))
    errors = []
    for number in PROBLEMS:
        found = [outcome(number, e, tol, solve) for e in stiffness for solve in (of_package, of_scipy)]
        cells = (f"{f'{error:.0e}' if error < np.inf else '-':>8}{seconds:5.2f}" for error, seconds in found)
        print(f"{number:7d}  " + "".join(cells), flush=True)
        errors += [error for error, _ in found]
    return np.array(errors).reshape(-1, 2)


if __name__ == "__main__":
    main()
