"""From a tolerance to a path: this package against `scipy.integrate.solve_bvp`, at the same true error.

Both get the same boundary problem and the same initial guess (the straight line between the ends unless the problem
has another), SciPy as a first-order system with vectorized right-hand side and analytic Jacobians.  For each
tolerance this package is run first; SciPy's tolerance is then lowered by factors of 3 until its true error is no
larger, or fails.  "Fresh" is the whole call with nothing kept from another; "first" the same after another Lagrangian
was solved on as many intervals, of the same degrees, whose graphs are kept; "again" a solve with the graph built and
the mesh known, from a path that is 1 % off, as in a sweep.  Times are medians of runs in one process, taken in turns.

True errors are taken against the exact path, 20 times in every interval of the finer mesh, relative to its size.

Run it alone on a quiet machine; it takes some minutes.
"""

import time
from statistics import median

import casadi as ca
import numpy as np
from cost import forget
from scipy.integrate import solve_bvp
from scipy.optimize import brentq

import casadi_galerkin as cg

TOLERANCES = (1e-3, 1e-6, 1e-9, 1e-12)
REPEATS, NODES, FIRST_NODES = 5, 100_000, 11
FLOOR = 1e-13  # an error that SciPy need not undercut
SHOWN = "fresh", "first", "again", "scipy"


class Case:
    """A boundary problem x'' = f(t, x) of d components with its exact path."""

    def __init__(self, name, lagrangian, span, exact, force, stiffness, guess=None):
        self.name, self.lagrangian, self.span, self.exact = name, lagrangian, span, exact
        self.force, self.stiffness = force, stiffness  # (d, K) -> (d, K), and its derivative (d, d, K)
        self.ends = [exact(np.array([t]))[:, 0] for t in span]
        self.guess = guess

    def start(self, t):
        """The guess; (d, K)."""
        if self.guess is not None:
            return self.guess(t)
        share = (t - self.span[0]) / (self.span[1] - self.span[0])
        return self.ends[0][:, None] * (1 - share) + self.ends[1][:, None] * share

    def error(self, path, mesh):
        """Largest error of a path between the joints of a mesh."""
        t = np.unique(np.concatenate([mesh[:-1] + s * np.diff(mesh) for s in np.linspace(0, 1, 21)]))
        x = self.exact(t)
        return np.max(np.abs(path(t) - x) / np.max(np.abs(x), axis=1, keepdims=True))

    def galerkin(self, tol):
        """The whole call."""
        problem = cg.BoundaryProblem(self.lagrangian, self.span, *self.ends)
        return cg.solve(problem, tol=tol, guess=None if self.guess is None else lambda t: self.guess(np.array(t)))

    def scipy(self, tol):
        """The whole call; None where it fails."""
        d = len(self.ends[0])
        eye, zero = np.eye(d), np.zeros((d, d))

        def jacobian(t, y):
            result = np.zeros((2 * d, 2 * d, y.shape[1]))
            result[:d, d:] = eye[:, :, None]
            result[d:, :d] = self.stiffness(t, y[:d])
            return result

        fixed = np.block([[eye, zero], [zero, zero]]), np.block([[zero, zero], [eye, zero]])
        t = np.linspace(*self.span, FIRST_NODES)
        x = self.start(t)
        with np.errstate(all="ignore"):
            answer = solve_bvp(
                lambda t, y: np.concatenate((y[d:], self.force(t, y[:d]))),
                lambda a, b: np.concatenate((a[:d] - self.ends[0], b[:d] - self.ends[1])),
                t,
                np.concatenate((x, np.gradient(x, t, axis=1))),
                fun_jac=jacobian,
                bc_jac=lambda a, b: fixed,
                tol=tol,
                max_nodes=NODES,
            )
        return answer if answer.success else None


def scalar(function):
    """Wrap a derivative of one component as (1, 1, K)."""
    return lambda t, x: function(t, x)[None]


def kepler(eccentricity):
    """A comet through its pericenter, eccentric anomaly -2 to 2; the guess is its ellipse at the wrong times."""
    half, minor = 2 - eccentricity * np.sin(2), np.sqrt(1 - eccentricity**2)

    def place(anomaly):
        return np.array([np.cos(anomaly) - eccentricity, minor * np.sin(anomaly)])

    def exact(t):
        anomaly = np.interp(t, *(lambda a: (a - eccentricity * np.sin(a), a))(np.linspace(-2.1, 2.1, 20_001)))
        for _ in range(6):
            anomaly -= (anomaly - eccentricity * np.sin(anomaly) - t) / (1 - eccentricity * np.cos(anomaly))
        return place(anomaly)

    def stiffness(t, x):
        r = np.hypot(*x)
        return 3 * x[:, None] * x[None] / r**5 - np.eye(2)[:, :, None] / r**3

    return Case(
        f"Kepler e = {eccentricity}",
        lambda t, x, v: ca.dot(v, v) / 2 + 1 / ca.norm_2(x),
        (-half, half),
        exact,
        lambda t, x: -x / np.hypot(*x) ** 3,
        stiffness,
        lambda t: place(2 * t / half),
    )


def reference(case):
    """Give a case without a closed form a path of degree 20 on 60 intervals as its exact one."""
    problem = cg.BoundaryProblem(case.lagrangian, case.span, *case.ends)
    path = cg.solve(problem, cg.Galerkin(20), 60)
    case.exact = path
    return case


def bratu(rate):
    """Lower branch of Bratu's problem."""
    theta = brentq(lambda th: th - np.sqrt(2 * rate) * np.cosh(th / 4), 0, 4.79, xtol=1e-15)
    return Case(
        f"Bratu {rate}",
        lambda t, x, v: v[0] ** 2 / 2 - rate * ca.exp(x[0]),
        (0.0, 1.0),
        lambda t: -2 * np.log(np.cosh((t - 0.5) * theta / 2) / np.cosh(theta / 4))[None],
        lambda t, x: -rate * np.exp(x),
        scalar(lambda t, x: -rate * np.exp(x)),
    )


def layer(epsilon):
    """A boundary layer of thickness √ε."""
    width = np.sqrt(epsilon)
    return Case(
        f"layer {epsilon:g}",
        lambda t, x, v: epsilon * v[0] ** 2 / 2 + x[0] ** 2 / 2,
        (0.0, 1.0),
        lambda t: (np.exp(-t / width) * np.expm1(-2 * (1 - t) / width) / np.expm1(-2 / width))[None],
        lambda t, x: x / epsilon,
        scalar(lambda t, x: np.ones_like(x) / epsilon),
    )


def oscillator(end):
    """Harmonic oscillator up to a time."""
    return Case(
        f"oscillator {end:g}",
        lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2,
        (0.0, end),
        lambda t: np.sin(t)[None] / np.sin(end),
        lambda t, x: -x,
        scalar(lambda t, x: -np.ones_like(x)),
    )


def troesch(rate):
    """Troesch's problem, its ends given by hand."""
    case = Case(
        f"Troesch {rate:g}",
        lambda t, x, v: v[0] ** 2 / 2 + ca.cosh(rate * x[0]),
        (0.0, 1.0),
        lambda t: t[None],
        lambda t, x: rate * np.sinh(rate * x),
        scalar(lambda t, x: rate**2 * np.cosh(rate * x)),
    )
    return reference(case)


def pendulum():
    """A short swing."""
    case = Case(
        "pendulum",
        lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]),
        (0.0, 1.0),
        lambda t: t[None],
        lambda t, x: -np.sin(x),
        scalar(lambda t, x: -np.cos(x)),
    )
    return reference(case)


def catenoid():
    """The stable film, x'' = (1 + x'²)/x, written with x'' = x/c² along it so that both solve the same equation."""
    c = brentq(lambda c: c * np.cosh(0.5 / c) - 1, 0.7, 1, xtol=1e-15)
    return Case(
        "catenary",
        lambda t, x, v: v[0] ** 2 / 2 + x[0] ** 2 / (2 * c**2),
        (-0.5, 0.5),
        lambda t: c * np.cosh(t / c)[None],
        lambda t, x: x / c**2,
        scalar(lambda t, x: np.ones_like(x) / c**2),
    )


def cases():
    """The suite."""
    return [
        oscillator(1.0),
        oscillator(5.0),
        oscillator(50.0),
        pendulum(),
        catenoid(),
        bratu(1.0),
        bratu(3.5),
        troesch(5.0),
        *map(layer, (1e-2, 1e-4, 1e-6, 1e-8)),
        kepler(0.6),
        kepler(0.9),
    ]


def seconds(call):
    """Wall time of a call, and its result."""
    began = time.perf_counter()
    result = call()
    return time.perf_counter() - began, result


def matched(case, error, tol):
    """SciPy's loosest tolerance whose true error is no larger; None where it fails before."""
    tol = min(0.1, 100 * tol)
    for _ in range(40):
        answer = case.scipy(tol)
        if answer is None:
            return None
        if case.error(lambda t, answer=answer: answer.sol(t)[: len(case.ends[0])], answer.x) <= error:
            return tol
        tol /= 3
    return None


def row(case, tol):
    """Measure one case at one tolerance; times in milliseconds, NaN where a solver fails."""
    try:
        path = case.galerkin(tol)
    except cg.ConvergenceError:
        return {"case": case.name, "tol": tol, "error": np.nan, **dict.fromkeys(SHOWN, np.nan)}
    error = case.error(path, path.t)
    problem = cg.BoundaryProblem(case.lagrangian, case.span, *case.ends)
    built = cg.transcribe(problem, path.method, mesh=path.t)
    scipy_tol = matched(case, max(error, FLOOR), tol)
    times = {key: [] for key in SHOWN}

    neighbor = 0.99 * path.polynomial.values
    built.solve(guess=neighbor)
    for _ in range(REPEATS):
        forget()
        times["fresh"].append(seconds(lambda: case.galerkin(tol))[0])
        times["first"].append(seconds(lambda: case.galerkin(tol))[0])
        times["again"].append(seconds(lambda: built.solve(guess=neighbor))[0])
        times["scipy"].append(seconds(lambda: case.scipy(scipy_tol))[0] if scipy_tol else np.nan)
    return {"case": case.name, "tol": tol, "error": error} | {key: 1e3 * median(runs) for key, runs in times.items()}


def main(tolerances=TOLERANCES, chosen=None):
    """Measure all; returns the rows."""
    return [row(case, tol) for tol in tolerances for case in chosen or cases()]


def show(rows):
    """Print the table in milliseconds, and the medians of SciPy's time over the others."""
    print(f"{'case':16}{'tol':>8}{'error':>9}" + "".join(f"{key:>9}" for key in SHOWN))
    for r in rows:
        print(f"{r['case']:16}{r['tol']:8.0e}{r['error']:9.1e}" + "".join(f"{r[key]:9.2f}" for key in SHOWN))
    print("\nSciPy's time over fresh, first and again: medians over the cases that SciPy solves")
    for tol in sorted({r["tol"] for r in rows}, reverse=True):
        group = [r for r in rows if r["tol"] == tol]
        solved = [r for r in group if np.isfinite(r["scipy"])]
        ratios = [median([r["scipy"] / r[key] for r in solved]) if solved else np.nan for key in SHOWN[:-1]]
        print(
            f"  {tol:.0e}:" + "".join(f"{ratio:7.1f}" for ratio in ratios),
            f"; SciPy fails at {len(group) - len(solved)}",
        )


if __name__ == "__main__":
    show(main())
