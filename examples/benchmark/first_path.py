"""The first path, from guesses good and bad: what a tolerance costs over the best fixed mesh of the same error.

Every problem is solved from four guesses: the path itself, 2 % off; nothing, that is the straight line; the path at
seven times, joined by lines; and at 25 times with noise of 5 %, joined by lines.  A call to a tolerance knows nothing
else.  The fixed mesh is the fastest of all degrees and numbers of intervals in the table below that ends, from the same
guess, on the same path with no larger an error, as only a user could choose who knows the path before.  Both are whole
calls with a new Lagrangian, building included, in a process that has solved on as many intervals before, in processor
time.

Run it alone on a quiet machine; it takes some minutes.
"""

import argparse
import time
from statistics import median

import casadi as ca
import numpy as np
from peers import chain, double_pendulum
from tolerance import bratu, kepler, layer, oscillator, pendulum, troesch

import casadi_galerkin as cg

TOLERANCES = (1e-6, 1e-9)
DEGREES, INTERVALS = (4, 6, 8, 10, 12), (4, 6, 8, 12, 16, 24, 32, 64)
REPEATS, FLOOR = 3, 1e-12  # an error that a fixed mesh need not undercut
FINE = 400  # times in every 1/FINE of the duration at which paths are compared
SAME = 1e-2  # relative difference from which two paths are different ones
NOISE, OFF = 0.05, 0.02
KINDS = "good", "straight", "corners", "noise"


class Problem:
    """A problem by name: a callable that makes it anew, and what leads to its path."""

    def __init__(self, name, make, guess=None):
        self.name, self.make, self.guess = name, make, guess

    def path(self):
        """The path that good guesses are made of."""
        return cg.solve(self.make(), tol=1e-10, guess=self.guess)


def known(case):
    """A case of the other benchmarks; Kepler's guesses begin from its own."""
    ends = getattr(case, "ends", None) or [case.start, case.end]
    span = getattr(case, "span", None) or case.t_span
    leads = case.guess if ends is getattr(case, "ends", None) else None
    return Problem(case.name, lambda: cg.BoundaryProblem(case.lagrangian, span, *ends), leads)


def simple(name, lagrangian, span, start, end, guess=None):
    """A problem from its parts."""
    return Problem(name, lambda: cg.BoundaryProblem(lagrangian, span, start, end), guess)


def problems():
    """The suite."""

    def swing(t, x, v):
        return v[0] ** 2 / 2 + ca.cos(x[0])

    def globe(t, x, v):
        return (v[0] ** 2 + ca.cos(x[0]) ** 2 * v[1] ** 2) / 2

    def charge(t, x, v):
        return ca.dot(v, v) / 2 + (x[0] * v[1] - x[1] * v[0]) / 2

    def earth(t, x, v):
        return ca.dot(v, v) / 2 + 398600.4418 / ca.norm_2(x)

    pendulums = double_pendulum()
    tanh = float(np.tanh(4 / np.sqrt(2)))
    return [
        *map(known, (oscillator(1.0), oscillator(5.0), pendulum(), bratu(1.0), bratu(3.5), troesch(5.0))),
        *map(known, (troesch(10.0), layer(1e-4), layer(1e-6), kepler(0.6), kepler(0.9), chain())),
        simple("double pendulum, T = 1", pendulums.lagrangian, (0, 1), [1.0, 1.2], [-0.5, -0.3]),
        simple("double pendulum, T = 2", pendulums.lagrangian, (0, 2), pendulums.start, pendulums.end, pendulums.guess),
        simple("Bratu 1, upper", lambda t, x, v: v[0] ** 2 / 2 - ca.exp(x[0]), (0, 1), [0.0], [0.0],
               lambda t: np.array([20 * t * (1 - t)])),
        simple("long swing", swing, (0, 10), [0.0], [1.0], lambda t: np.array([3 * np.sin(np.pi * t / 10) + t / 10])),
        simple("soliton", lambda t, x, v: v[0] ** 2 / 2 + (x[0] ** 2 - 1) ** 2 / 4, (-4, 4), [-tanh], [tanh]),
        simple("great circle", globe, (0, 1), [0.70933, -1.28762], [0.89832, -0.00793]),
        simple("charge", charge, (0, 3), [0.0, 1.0], [float(np.sin(3)), float(np.cos(3))]),
        simple("Lambert in km", earth, (0, 4560), [15945.34, 0.0, 0.0], [12214.83899, 10249.46731, 0.0]),
    ]  # fmt: skip


def guess_of(kind, path, seed):
    """A guess of a kind, made of the path; a callable of one time or of many."""
    first, last = path.t[[0, -1]]
    size = np.max(np.abs(path.polynomial.values), axis=1)
    if kind == "straight":
        return None
    if kind == "good":
        return lambda t: path(t) + OFF * np.multiply.outer(size, np.sin(np.pi * (t - first) / (last - first)))
    times = np.linspace(first, last, 7 if kind == "corners" else 25)
    values = path(times)
    if kind == "noise":
        values += NOISE * size[:, None] * np.random.default_rng(seed).standard_normal(values.shape)
    return lambda t: np.array([np.interp(t, times, row) for row in values])


def milliseconds(call):
    """Processor time of a whole call, and its path; None where it fails."""
    began = time.process_time()
    try:
        path = call()
    except cg.ConvergenceError:
        path = None
    return 1e3 * (time.process_time() - began), path


def error(path, exact):
    """Largest difference of two paths, relative to the components' sizes."""
    times = np.linspace(*exact.t[[0, -1]], FINE)
    x = exact(times)
    size = np.max(np.abs(x), axis=1, keepdims=True)
    return float(np.max(np.abs(path(times) - x) / np.where(size > 0, size, 1.0)))


def finer(problem, path):
    """The same path to the last digits."""
    mesh = np.interp(np.linspace(0, 1, 2 * len(path.t) - 1), np.linspace(0, 1, len(path.t)), path.t)
    return cg.solve(problem.make(), cg.Galerkin(path.method.degree + 4), mesh=mesh, guess=path)


def best_fixed(problem, guess, exact, reached):
    """Milliseconds of the fastest fixed mesh with an error of at most `reached`, and which it is; None if none is."""
    calls = {}
    for degree in DEGREES:
        for intervals in INTERVALS:

            def call(degree=degree, intervals=intervals):
                return cg.solve(problem.make(), cg.Galerkin(degree), intervals, guess=guess)

            spent, path = milliseconds(call)
            if path is not None and error(path, exact) <= reached:
                calls[degree, intervals] = spent, call
                break  # a finer mesh of this degree takes longer
    if not calls:
        return None, "none"
    nearly = sorted(calls, key=lambda which: calls[which][0])[:2]
    times = {which: median(milliseconds(calls[which][1])[0] for _ in range(REPEATS)) for which in nearly}
    best = min(times, key=times.get)
    return times[best], f"{best[0]} x {best[1]}"


def row(problem, kind, tol, path, seed=0, fixed=True):
    """Measure one problem from one guess."""
    guess = guess_of(kind, path, seed)
    spent, found = milliseconds(lambda: cg.solve(problem.make(), tol=tol, guess=guess))
    measured = {"problem": problem.name, "guess": kind, "tol": tol, "found": found, "ms": spent}
    if found is None:
        return measured | {"error": np.nan, "fixed": None, "mesh": ""}
    if spent < 1000:
        call = lambda: cg.solve(problem.make(), tol=tol, guess=guess)  # noqa: E731
        measured["ms"] = median(milliseconds(call)[0] for _ in range(REPEATS))
    exact = finer(problem, found)
    measured["error"] = error(found, exact)
    if not fixed:
        return measured | {"fixed": None, "mesh": ""}
    measured["fixed"], measured["mesh"] = best_fixed(problem, guess, exact, max(measured["error"], FLOOR))
    return measured


def main(chosen=None, tolerances=TOLERANCES, kinds=KINDS, fixed=True):
    """Measure all; returns and prints the rows."""
    print(f"{'problem':24}{'guess':10}{'tol':>7}{'error':>9}{'degree':>8}{'N':>5}{'iter':>6}{'ms':>9}{'fixed':>9}{'ratio':>7}"
          "  best fixed mesh; solver")  # fmt: skip
    rows = []
    for i, problem in enumerate(problems()):
        if chosen and not any(part in problem.name for part in chosen):
            continue
        path = problem.path()
        for kind in kinds:
            for tol in tolerances:
                rows.append(row(problem, kind, tol, path, i, fixed))
                show(rows[-1])
    for tol in tolerances:
        group = [r for r in rows if r["tol"] == tol]
        ratios = sorted(r["ms"] / r["fixed"] for r in group if r["fixed"])
        if ratios:
            print(f"tol {tol:.0e}: {sum(r['found'] is not None for r in group)} of {len(group)} solved, {len(ratios)} "
                  f"by a fixed mesh; ratio {median(ratios):.2f} in the median, {ratios[-1]:.1f} at worst")  # fmt: skip
    return rows


def show(r):
    """Print one row."""
    print(f"{r['problem'][:23]:24}{r['guess']:10}{r['tol']:7.0e}", end="")
    if r["found"] is None:
        print(f"   fails after {r['ms']:.0f} ms", flush=True)
        return
    path, ratio = r["found"], r["ms"] / r["fixed"] if r["fixed"] else np.nan
    print(f"{r['error']:9.1e}{path.method.degree:8d}{len(path.t) - 1:5d}{path.iterations:6d}{r['ms']:9.1f}"
          f"{r['fixed'] or np.nan:9.1f}{ratio:7.2f}  {r['mesh']}; {path.solver}", flush=True)  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("chosen", nargs="*", help="parts of names")
    main(parser.parse_args().chosen)
