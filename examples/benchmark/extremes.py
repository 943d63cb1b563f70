"""Numerical stability at the extremes: each case is a function of how extreme it is; the tests call the same ones.

Every function returns the error of x relative to its largest value, and what else its row shows.  `main` prints the
table: what was reached, what limits it, what the user sees beyond it.
"""

import sys
import time
import warnings

import casadi as ca
import numpy as np

import casadi_galerkin as cg
from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus

FOLD = 4.798714560334737  # θ at which Bratu's two branches meet: θ = 4 coth(θ/4)


def relative(path, exact, times):
    """Largest error at these times relative to the largest value."""
    known = exact(times)
    return float(np.max(np.abs(path(times) - known)) / np.max(np.abs(known)))


def oscillator(duration):
    """From 0 to sin T: the path sin t."""
    return cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0.0, duration), [0.0], [float(np.sin(duration))]
    )


def kepler_path(eccentricity):
    """Position (2, K) at times (K,) after the pericenter, by Kepler's equation with bisected Newton steps."""

    def exact(t):
        t = np.atleast_1d(np.asarray(t, dtype=float))
        low, high, anomaly = t - eccentricity, t + eccentricity, t.copy()
        for _ in range(100):
            miss = anomaly - eccentricity * np.sin(anomaly) - t
            low, high = np.where(miss < 0, anomaly, low), np.where(miss >= 0, anomaly, high)
            anomaly = anomaly - miss / (1 - eccentricity * np.cos(anomaly))
            anomaly = np.where((anomaly > low) & (anomaly < high), anomaly, (low + high) / 2)
        height = np.sqrt((1 - eccentricity) * (1 + eccentricity))
        return np.array([np.cos(anomaly) - eccentricity, height * np.sin(anomaly)])

    return exact


def kepler(eccentricity, first, last):
    """Problem between two times of an orbit, and its path."""
    exact = kepler_path(eccentricity)
    start, end = exact([first, last]).T
    problem = cg.BoundaryProblem(lambda t, x, v: ca.dot(v, v) / 2 + 1 / ca.norm_2(x), (first, last), start, end)
    return problem, exact


def degree(m, points=cg.lobatto_points):
    """A Kepler arc on two intervals of degree m."""
    problem, exact = kepler(0.3, 0.0, 2.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # equispaced points warn, as they should
        method = cg.Galerkin(m, points(m))
    path = cg.solve(problem, method, 2, guess=lambda t: exact(t)[:, 0] * (1 + 0.1 * t * (2 - t)))
    return relative(path, exact, np.linspace(0, 2, 401))


def many_intervals(m, intervals):
    """Oscillator; exact but for the discretization, 3e-5 h² for m = 1 and far below roundoff for m = 4."""
    path = cg.solve(oscillator(2.0), cg.Galerkin(m), intervals)
    return relative(path, lambda t: np.sin(t)[None, :], np.linspace(0, 2, 1001))


def ring(d, intervals=10, m=4):
    """A ring of d masses and stiffening springs, neighbors moving oppositely; d even.

    Each mass then moves as one alone on two doubly stretched springs: the difference to that solve, and seconds.
    """

    def lagrangian(t, x, v):
        stretch = x - ca.vertcat(x[1:], x[0])
        return ca.sumsqr(v) / 2 - ca.sum1(stretch**2) / 2 - ca.sum1(stretch**4) / 4

    def alone(t, x, v):
        return v[0] ** 2 / 2 - (2 * x[0]) ** 2 / 2 - (2 * x[0]) ** 4 / 4

    signs, method = (-1.0) ** np.arange(d), cg.Galerkin(m)
    path = cg.solve(cg.BoundaryProblem(lagrangian, (0.0, 0.5), 0 * signs, 0.3 * signs), method, intervals)
    one = cg.solve(cg.BoundaryProblem(alone, (0.0, 0.5), [0.0], [0.3]), method, intervals)
    return float(np.max(np.abs(path.x - signs[:, None] * one.x)) / 0.3), path.build_seconds + path.solve_seconds


def horizon(duration, m=8):
    """Solve x'' = x from 1 to 1: modes e^t and e^-t, two intervals to a unit of time."""

    def exact(t):
        return ((np.exp(-t) + np.exp(t - duration)) / (1 + np.exp(-duration)))[None, :]

    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + x[0] ** 2 / 2, (0.0, duration), [1.0], [1.0])
    path = cg.solve(problem, cg.Galerkin(m), int(2 * duration))
    return relative(path, exact, np.linspace(0, duration, 5001))


def layer(epsilon, tol=1e-9):
    """Boundary layer of width sqrt(ε), mesh and degree chosen from a tolerance."""
    width = np.sqrt(epsilon)
    problem = cg.BoundaryProblem(lambda t, x, v: epsilon * v[0] ** 2 / 2 + x[0] ** 2 / 2, (0.0, 1.0), [1.0], [0.0])
    path = cg.solve(problem, tol=tol)
    times = np.append(0.0, np.geomspace(width / 1e3, 1, 4000))
    return relative(path, lambda t: np.exp(-t / width)[None, :] * (1 - np.exp(2 * (t - 1) / width)), times)


def conjugate(gap):
    """Oscillator whose time span ends so much before (or after) the conjugate point π: error and Morse index."""
    path = cg.solve(oscillator(np.pi - gap), cg.Galerkin(10), 8)
    error = relative(path, lambda t: np.sin(t)[None, :], np.linspace(0, np.pi - gap, 401))
    return error, path.morse_index


def scaled(action=1.0, length=1.0, duration=1.0):
    """A pendulum swinging nearly over the top, in other units: the path and iterations."""
    problem = cg.BoundaryProblem(
        lambda t, x, v: action * ((v[0] * (duration / length)) ** 2 / 2 + ca.cos(x[0] / length)),
        (0.0, 10 * duration),
        [0.0],
        [length],
    )
    times = np.linspace(0, 10, 61)
    path = cg.solve(problem, cg.Galerkin(6), 60, guess=length * (3 * np.sin(np.pi * times / 10) + times / 10)[None, :])
    return path.x / length, path.iterations


def rescaled(**units):
    """Difference of that path to the one in units of 1, and whether the iterations are the same."""
    (path, iterations), (reference, expected) = scaled(**units), scaled()
    return float(np.max(np.abs(path - reference)) / np.max(np.abs(reference))), iterations == expected


def graded(decades):
    """A Kepler arc on a mesh from 10^-decades to 1 of its span: error, and that of the momentum."""
    problem, exact = kepler(0.3, 0.0, 2.0)
    mesh = np.append(0.0, np.geomspace(2 * 10.0**-decades, 2, 8 * decades + 1))
    path = cg.solve(problem, cg.Galerkin(10), mesh=mesh)
    speed = np.sqrt(1.3 / 0.7)
    return relative(path, exact, np.linspace(0, 2, 401)), float(abs(path.momentum[1, 0] - speed) / speed)


def collision(distance, factor=1.1):
    """A Kepler orbit of pericenter 1 - e = distance, solved from the orbit of a pericenter `factor` times as large."""
    problem, exact = kepler(1 - distance, -np.pi / 2, np.pi / 2)
    side, method = np.geomspace(0.3 * distance**1.5, np.pi / 2, 40), cg.Galerkin(10)
    mesh = np.concatenate((-side[::-1], [0.0], side))
    mesh[[0, -1]] = problem.t_span
    guess = kepler_path(1 - factor * distance)(DiscreteCalculus(method, mesh).node_times)
    path = cg.solve(problem, method, mesh=mesh, guess=guess)
    return relative(path, exact, np.linspace(-1, 1, 1001) ** 3 * np.pi / 2)


def bratu(gap):
    """Bratu's problem with θ below its fold by that part, on the lower branch; the distance of λ falls with gap²."""
    theta = FOLD * (1 - gap)
    parameter = theta**2 / (2 * np.cosh(theta / 4) ** 2)
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - parameter * ca.exp(x[0]), (0.0, 1.0), [0.0], [0.0])
    path = cg.solve(problem, cg.Galerkin(10), 8)

    def exact(t):
        return -2 * np.log(np.cosh((t - 0.5) * theta / 2) / np.cosh(theta / 4))[None, :]

    return relative(path, exact, np.linspace(0, 1, 201)), path.morse_index


EDGES = {  # L and guess, from 1 to 1 and down to near the edge x = 0 in between; at the last one |v| < 1
    "log": (lambda t, x, v: v[0] ** 2 / 2 + 1.2 * ca.log(x[0]), lambda t: 1 - 3 * t * (1 - t)),
    "root": (lambda t, x, v: v[0] ** 2 / 2 + 3.4 * ca.sqrt(x[0]), lambda t: 1 - 3.6 * t * (1 - t)),
    "division": (lambda t, x, v: v[0] ** 2 / 2 - 0.2 / x[0], lambda t: 1 - 3 * t * (1 - t)),
    "speed limit": (
        lambda t, x, v: -ca.sqrt(1 - v[0] ** 2) - 4 * (x[0] - 1) ** 2,
        lambda t: 1 + 0.5 * t + 0.49 * np.sin(np.pi * t) / np.pi,
    ),
}


def edge(name):
    """A Lagrangian near the edge of its domain.

    Returns whether a full first Newton step leaves the domain, the iterations, what found the path, and the
    difference to the path of another degree.
    """
    lagrangian, guess = EDGES[name]
    start, end = guess(0.0), guess(1.0)
    problem, method = cg.BoundaryProblem(lagrangian, (0.0, 1.0), [start], [end]), cg.Galerkin(10)
    transcription = cg.transcribe(problem, method, 80)
    nodes = guess(DiscreteCalculus(method, transcription.mesh).node_times)[None, :]
    data = np.array([start]), np.array([end]), transcription.mesh
    with transcription.stationarity.linearization() as at:
        trial = nodes[0, 1:-1] + at.newton_step(nodes[0, 1:-1], data).step
        (action,) = at.evaluate("action", trial, data)[0]
    leaves = not np.isfinite(action) or trial.min() < 0  # 1/x is finite beyond its pole
    path = transcription.solve(guess=nodes)
    other = cg.solve(problem, cg.Galerkin(12), 80, guess=path)
    difference = relative(path, other, np.linspace(0, 1, 1001))
    return bool(leaves), path.iterations, path.solver, difference


def rows():
    """Lines of the table: case, how far, call, what limits it, what is seen beyond."""
    lobatto, equal = cg.lobatto_points, cg.equispaced_points
    graph = "memory of the graph", "MemoryError of the system"
    roundoff, nothing = "roundoff", "nothing up to here"
    yield "degree, Lobatto points", "100", lambda: degree(100, lobatto), "cost: dense blocks", nothing
    for m in (10, 20, 30, 40):
        yield "degree, equispaced points", f"{m}", lambda m=m: degree(m, equal), "conditioning", "warning above 10"
    yield "intervals, m = 1", "1e6", lambda: many_intervals(1, 1_000_000), *graph
    yield "intervals, m = 4", "1e5", lambda: many_intervals(4, 100_000), *graph
    for d in (10, 100, 1000):
        yield "ring of masses (error, seconds)", f"{d}", lambda d=d: ring(d), "linear in d", nothing
    yield "horizon", "e^700", lambda: horizon(700.0), roundoff, nothing
    yield "horizon", "e^7000", lambda: horizon(7000.0), roundoff, nothing
    for epsilon in (1e-6, 1e-8, 1e-10, 1e-12):
        yield "layer, tol = 1e-9", f"ε = {epsilon:g}", lambda e=epsilon: layer(e), "the tolerance", nothing
    for gap in (1e-8, 1e-10, -1e-10, 1e-12):
        yield "conjugate point", f"{gap:g}", lambda g=gap: conjugate(g), "data: eps/gap", "ConjugatePointError"
    for units in ({"action": 1e-150}, {"action": 1e150}, {"length": 1e-12}, {"length": 1e12}, {"duration": 1e-12},
                  {"duration": 1e12}):  # fmt: skip
        name, factor = next(iter(units.items()))
        yield f"{name} (difference, same steps)", f"{factor:g}", lambda u=units: rescaled(**u), "range of doubles", ""
    yield "mesh over decades", "12", lambda: graded(12), roundoff, nothing
    for distance in (1e-2, 1e-3, 1e-4, 1e-6):
        yield "collision", f"{distance:g}", lambda q=distance: collision(q), "second variation", "ConjugatePointError"
    for gap in (1e-2, 1e-4, 1e-5, 1e-7):
        yield "Bratu's fold", f"1 - λ/λc ~ {gap**2:g}", lambda g=gap: bratu(g), "data: eps/gap", "ConjugatePointError"
    for name in EDGES:
        yield "edge of the domain", name, lambda n=name: edge(n), "line search backs off", "ConvergenceError"


def main():
    """Print the table; returns {(case, how far): result or the message of the failure}."""
    results = {}
    for case, far, call, limit, beyond in rows():
        began = time.perf_counter()
        try:
            result = call()
        except (cg.ConvergenceError, ValueError) as failure:
            result = f"{type(failure).__name__}: {failure}"[:90]
        results[case, far] = result
        values = result if isinstance(result, tuple) else (result,)
        shown = ", ".join(f"{value:.1e}" if isinstance(value, float) else str(value) for value in values)
        seconds = time.perf_counter() - began
        print(f"| {case} | {far} | {shown} | {seconds:.1f} s | {limit} | {beyond} |", flush=True)
    return results


if __name__ == "__main__":
    print(f"Python {sys.version.split()[0]}, CasADi {ca.__version__}, NumPy {np.__version__}")
    print(
        "| case | how far | error, and more | time | what limits it | what is seen beyond |\n|---|---|---|---|---|---|"
    )
    main()
