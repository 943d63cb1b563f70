"""Boundary problems of first order beside SciPy's `solve_bvp`: whole calls to the same true error of the path.

The problems are those of `solve_bvp`'s documentation and tests that have one path, three of J. R. Cash's test problems
(31 to 33), and Mathieu's equation with its characteristic value unknown.  Both begin with the same guess.  `solve_bvp`
runs at its loosest tolerance whose true error is small enough, found beforehand, which favours it; it has no Jacobian,
as most users give none.  Errors are the largest of the path, between joints, too, over the largest value of a
component, against a closed form where there is one, or an answer to 1e-12.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import fsolve
from scipy.special import erf, mathieu_a

import casadi_galerkin as cg

TOLERANCES = 1e-4, 1e-8
REPEATS = 3
NODES = 11  # of the first mesh of `solve_bvp`
SHOCK, SWIRL, SHEET, FLOW = 1e-3, 1e-3, 1e-2, 100.0


@dataclass(frozen=True)
class Case:
    """A problem, its rates and mixed conditions written for CasADi and NumPy alike, and what is known of it."""

    rates: Callable  # (m, t, x, p) -> rates, with m = casadi or numpy
    span: tuple[float, float]
    start: list
    end: list
    mixed: Callable | None = None  # (m, first, last, p) -> values that are zero
    exact: Callable | None = None  # t -> first component
    parameters: tuple[float, ...] = ()
    known: tuple[float, ...] = ()  # parameters
    guess: Callable = field(default=lambda t: None)  # t -> components
    singular: Any = None  # S of a term S x/t, which `solve_bvp` is told apart

    @property
    def problem(self) -> cg.ControlProblem:
        """As this package takes it."""
        of_p: dict[str, Any] = {}
        if self.parameters:
            of_p = {"parameters": self.parameters, "parameter_bounds": (0.1, 1e3)}
        if self.mixed is not None:
            mixed = self.mixed
            count = len(self.start) + len(self.parameters) - sum(a is not None for a in (*self.start, *self.end))
            of_p["end_conditions"] = (lambda a, b, *p: mixed(ca, a, b, *p), [0.0] * count, [0.0] * count)
        rates = self.rates
        return cg.ControlProblem(
            rates=lambda t, x, *p: rates(ca, t, x, *p), t_span=self.span, start=self.start, end=self.end, **of_p
        )

    def here(self, tol: float) -> tuple[Callable, tuple[float, ...]]:
        """Path and parameters."""
        path = cg.solve(self.problem, tol=tol, guess=None if self.guess(0.0) is None else self.guess)
        return path, path.parameters or ()

    def scipy(self, tol: float) -> tuple[Callable, tuple[float, ...]]:
        """The same by `solve_bvp`."""

        def conditions(a, b, *p):
            stated = [*zip(a, self.start, strict=True), *zip(b, self.end, strict=True)]
            given = [x - value for x, value in stated if value is not None]
            return np.array([*given, *(self.mixed(np, a, b, *p) if self.mixed else ())])

        def rates(t, x, *p):
            t = t if self.singular is None else np.where(t, t, np.inf)
            found = np.array([np.broadcast_to(rate, t.shape) for rate in self.rates(np, t, x, *p)])
            return found if self.singular is None else found - self.singular @ x / t

        t = np.linspace(*self.span, NODES)
        first, last = (np.array([value or 0.0 for value in some])[:, None] for some in (self.start, self.end))
        line = first + (last - first) * (t - t[0]) / (t[-1] - t[0])
        x = line if self.guess(t) is None else np.array([np.broadcast_to(row, t.shape) for row in self.guess(t)])
        more = {"p": np.array(self.parameters)} if self.parameters else {}
        found = solve_bvp(rates, conditions, t, x, **more, S=self.singular, tol=tol, max_nodes=20000)
        if not found.success:
            raise RuntimeError(found.message)
        return found.sol, () if found.p is None else tuple(found.p)


def bratu(larger):
    """-2 log(cosh((t - 1/2) θ/2) / cosh(θ/4)) with θ = √2 cosh(θ/4)."""
    theta = fsolve(lambda q: q - np.sqrt(2) * np.cosh(q / 4), 10.0 if larger else 1.5, xtol=1e-14)[0]
    return lambda t: -2 * np.log(np.cosh((t - 0.5) * theta / 2) / np.cosh(theta / 4))


def electrodes(m, first, last):
    """Butler-Volmer kinetics at both ends."""
    anode, cathode = -38.9 * first[0], 38.9 * (-0.5 - last[0])
    return [
        0.01 * (m.exp(anode) - m.exp(-anode)) + 1.64 * first[1],
        1e-4 * (m.exp(cathode) - m.exp(-cathode)) - 1.64 * last[1],
    ]


POTENTIAL = fsolve(lambda x: electrodes(np, x, [x[0] + 0.1 * x[1], x[1]]), [-0.1, -1.1], xtol=1e-13)


def sheet(m, t, x):
    """Cash's problem 31."""
    turned = ((x[0] - 1) * m.cos(x[1]) - x[2] * (1 / m.cos(x[1]) + SHEET * x[3] * m.tan(x[1]))) / SHEET
    return [m.sin(x[1]), x[2], -x[3] / SHEET, turned]


def swirl(m, t, x):
    """Cash's problem 33: x = (g, g', f, f', f'', f''')."""
    return [x[1], (x[0] * x[3] - x[2] * x[1]) / SWIRL, x[3], x[4], x[5], -(x[2] * x[5] + x[0] * x[1]) / SWIRL]


CASES = {
    "exponentials": Case(
        lambda m, t, x: [x[1], x[0]], (0, 1), [1, None], [0, None],
        exact=lambda t: (np.exp(-t) - np.exp(t - 2)) / (1 - np.exp(-2)),
    ),
    "Bratu": Case(lambda m, t, x: [x[1], -m.exp(x[0])], (0, 1), [0, None], [0, None], exact=bratu(False)),
    "Bratu, upper": Case(
        lambda m, t, x: [x[1], -m.exp(x[0])], (0, 1), [0, None], [0, None], exact=bratu(True),
        guess=lambda t: [4 * np.sin(np.pi * t), 12 * np.cos(np.pi * t)],
    ),
    "Sturm-Liouville": Case(
        lambda m, t, x, p: [x[1], -p[0] ** 2 * x[0]], (0, 1), [0, None], [0, None], lambda m, a, b, p: [a[1] - p[0]],
        lambda t: np.sin(2 * np.pi * t), (6.0,), (2 * np.pi,),
        lambda t: [np.sin(2 * np.pi * t), 6 * np.cos(2 * np.pi * t)],
    ),
    "Emden": Case(
        lambda m, t, x: [x[1], -x[0] ** 5 - 2 * x[1] / t], (0, 1), [None, 0], [np.sqrt(3) / 2, None],
        exact=lambda t: (1 + t**2 / 3) ** -0.5, guess=lambda t: [1 + 0 * t, 0 * t], singular=np.diag([0.0, -2.0]),
    ),
    "twenty at once": Case(
        lambda m, t, x: [a for i in range(0, 20, 2) for a in (x[i + 1], 0 * x[i])],
        (0, 1), [0, None] * 10, [1, None] * 10, exact=lambda t: t,
    ),
    "shock": Case(
        lambda m, t, x: [
            x[1], -(t * x[1] + SHOCK * np.pi**2 * m.cos(np.pi * t) + np.pi * t * m.sin(np.pi * t)) / SHOCK
        ],
        (-1, 1), [-2, None], [0, None],
        exact=lambda t: np.cos(np.pi * t) + erf(t / np.sqrt(2 * SHOCK)) / erf(1 / np.sqrt(2 * SHOCK)),
    ),
    "electrodes": Case(
        lambda m, t, x: [x[1], 0 * x[0]], (0, 0.1), [None, None], [None, None], electrodes,
        lambda t: POTENTIAL[0] + POTENTIAL[1] * t,
    ),
    "Cash 31": Case(sheet, (0, 1), [0, None, 0, None], [0, None, 0, None]),
    "Cash 32": Case(
        lambda m, t, x: [x[1], x[2], x[3], FLOW * (x[1] * x[2] - x[0] * x[3])],
        (0, 1), [0, 0, None, None], [1, 0, None, None],
    ),
    "Cash 33": Case(swirl, (0, 1), [-1, None, 0, 0, None, None], [1, None, 0, 0, None, None]),
    "Mathieu": Case(
        lambda m, t, x, p: [x[1], -(p[0] - 10 * m.cos(2 * t)) * x[0]], (0, np.pi), [1, 0], [None, 0],
        parameters=(8.0,), known=(float(mathieu_a(2, 5)),), guess=lambda t: [np.cos(2 * t), -2 * np.sin(2 * t)],
    ),
}  # fmt: skip


def error(case: Case, answer: tuple[Callable, tuple[float, ...]], finest: Callable | None) -> float:
    """True error of the path and of parameters."""
    times = np.linspace(*case.span, 1001)[1:-1]
    path, parameters = answer
    found, others = path(times), [abs(p / q - 1) for p, q in zip(parameters, case.known, strict=False)]
    right = case.exact(times)[None] if case.exact is not None else finest(times)
    return max(
        float(np.max(np.abs(found[: len(right)] - right) / np.max(np.abs(right), axis=1, keepdims=True))), *others, 0.0
    )


def timed(run: Callable) -> tuple[Any, float]:
    """Answer, and processor time in ms."""
    began = time.process_time()
    answer = run()
    return answer, 1e3 * (time.process_time() - began)


def measured(name: str, tol: float) -> tuple[float, float, float, float, float]:
    """Estimated and true error here, and time; true error and time of `solve_bvp`, NaN where it finds no answer."""
    case = CASES[name]
    finest = None if case.exact is not None else case.here(1e-12)[0]
    path, _ = case.here(tol)
    mine = error(case, case.here(tol), finest)
    theirs, its = np.nan, None
    for exponent in range(2, 13):
        try:
            theirs = error(case, case.scipy(10.0**-exponent), finest)
        except (RuntimeError, ValueError, ZeroDivisionError):
            theirs = np.nan
            continue
        if theirs <= tol:
            its = 10.0**-exponent
            break
    ours, scipys = [], []
    for _ in range(REPEATS):
        ours.append(timed(lambda: case.here(tol))[1])
        if its is not None:
            scipys.append(timed(lambda: case.scipy(its))[1])
    return path.error_estimate, mine, median(ours), theirs if its else np.nan, median(scipys) if scipys else np.nan


def main(names=(), tolerances=TOLERANCES):
    """Print the table; returns its rows."""
    print(f"{'problem':17}{'tol':>7}{'estimate':>10}{'error':>9}{'ms':>7}{'solve_bvp error':>17}{'ms':>8}")
    rows = []
    for name in names or CASES:
        for tol in tolerances:
            try:
                row = measured(name, tol)
            except (cg.ConvergenceError, ValueError) as failure:
                print(f"{name:17}{tol:7.0e} {failure}", flush=True)
                continue
            estimate, mine, ours, theirs, scipys = row
            print(f"{name:17}{tol:7.0e}{estimate:10.1e}{mine:9.1e}{ours:7.0f}{theirs:17.1e}{scipys:8.0f}", flush=True)
            rows.append((name, tol, *row))
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="problems, all if none is named")
    parser.add_argument("--tolerances", type=float, nargs="+", default=TOLERANCES)
    main(**vars(parser.parse_args()))
