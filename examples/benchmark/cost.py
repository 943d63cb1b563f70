"""What a solve costs: building, overhead, the growth with the number of intervals, memory and the error floor.

"Outside" is wall time less the time that CasADi spends on evaluating its Functions and factorizing matrices: tracing,
building graphs, symbolic factorization, and everything in Python.  It is the best of several runs in a warm process;
the growth is a median of rounds, since the speed of a machine changes more between two sizes measured one after the
other than their cost does.  The problem is a Kepler arc with d = 2 whose end is known to 1e-15, so that the error floor
can be seen.

Run it alone on a quiet machine; it takes 2 GiB of memory and two minutes.
"""

import platform
import resource
import sys
import time

import casadi as ca
import numpy as np

import casadi_galerkin as cg
from casadi_galerkin.functional import embedding, numbering
from casadi_galerkin.solvers import linear_solver

ECCENTRICITY, START = 0.6, (0.4, 0.0)  # from the pericenter, unit semi-major axis
SMALL, REPEATS = 20, 15  # intervals of the small problem, runs of which the best counts
SIZES = (100, 1000, 10_000, 100_000)


class Ledger:
    """Adds up the seconds that CasADi spends on evaluating, by timing its calls from outside."""

    def __init__(self):
        self.seconds = 0.0
        call, buffer = ca.Function.call, ca.Function.buffer
        numerical = self.timed(call)

        def called(f, given, *rest):
            arguments = given.values() if isinstance(given, dict) else given
            symbolic = any(isinstance(argument, (ca.MX, ca.SX)) for argument in arguments)
            return (call if symbolic else numerical)(f, given, *rest)

        def buffered(f):
            arrays, run = buffer(f)
            return arrays, self.timed(run)

        ca.Function.call, ca.Function.buffer = called, buffered
        for name in ("nfact", "neig"):
            setattr(ca.Linsol, name, self.timed(getattr(ca.Linsol, name)))

    def timed(self, call):
        """Let a callable enter its time."""

        def wrapped(*arguments):
            began = time.perf_counter()
            try:
                return call(*arguments)
            finally:
                self.seconds += time.perf_counter() - began

        return wrapped

    def outside(self, call):
        """Milliseconds of a call that are not evaluation, and those that are."""
        self.seconds, began = 0.0, time.perf_counter()
        call()
        total = time.perf_counter() - began
        return 1e3 * (total - self.seconds), 1e3 * self.seconds


def exact(t):
    """Position at time t after the pericenter, by Kepler's equation; (2,)."""
    anomaly = t
    for _ in range(50):
        anomaly -= (anomaly - ECCENTRICITY * np.sin(anomaly) - t) / (1 - ECCENTRICITY * np.cos(anomaly))
    return np.array([np.cos(anomaly) - ECCENTRICITY, np.sqrt(1 - ECCENTRICITY**2) * np.sin(anomaly)])


def arc(strength=1.0):
    """A Kepler arc; every call makes another Lagrangian."""
    return cg.BoundaryProblem(lambda t, x, v: ca.dot(v, v) / 2 + strength / ca.norm_2(x), (0.0, 1.0), START, exact(1.0))


def forget():
    """Drop the graphs that depend on the numbering alone."""
    for kept in (
        numbering.kept,
        embedding.embedding,
        embedding.embedded,
        embedding.variation,
        embedding.assembly,
        embedding.hessian_pattern,
        linear_solver.of_pattern,
    ):
        kept.cache_clear()


def overhead(ledger, degree):
    """Milliseconds (outside, evaluating) of three kinds of solve.

    The first of a Lagrangian, whose numbering (method, intervals, which ends are fixed) was used before by another one;
    the first of its numbering; and one repeated with the same transcription.
    """
    method = cg.Galerkin(degree)
    cg.solve(arc(), method, SMALL)
    known, new, again = [], [], []
    for _ in range(REPEATS):
        known.append(ledger.outside(lambda: cg.solve(arc(), method, SMALL)))
        forget()
        new.append(ledger.outside(lambda: cg.solve(arc(), method, SMALL)))
        transcription = cg.transcribe(arc(), method, SMALL)
        transcription.solve()
        again.append(ledger.outside(transcription.solve))
    return {"first solve": min(known), "first of its numbering": min(new), "repeated solve": min(again)}


def stepper(intervals, degree=4):
    """A callable of one Newton step: ∇S and ∇²S, a factorization, and two solutions with it."""
    transcription = cg.transcribe(arc(), cg.Galerkin(degree), intervals)
    point = transcription.critical_point()
    unknowns = point.solution.unknowns

    def step():
        with transcription.stationarity.linearization() as at:
            at.newton_step(unknowns, point.solution.data)

    return step


def growth():
    """Seconds of `stepper` for all sizes, and the fitted exponent: medians of rounds, in each of them equally long."""
    steps, rounds = [stepper(size) for size in SIZES], []
    for _ in range(REPEATS):
        seconds = []
        for size, step in zip(SIZES, steps, strict=True):
            runs, began = SIZES[-1] // size, time.perf_counter()
            for _ in range(runs):
                step()
            seconds.append((time.perf_counter() - began) / runs)
        rounds.append(seconds)
    exponents = [np.polyfit(np.log(SIZES), np.log(seconds), 1)[0] for seconds in rounds]
    return np.median(rounds, axis=0), np.median(exponents)


def floor(intervals=SIZES[-1], degree=4):
    """Solve at the largest size; seconds, error relative to the path's size, and peak memory of the process in GiB."""
    began = time.perf_counter()
    path = cg.solve(arc(), cg.Galerkin(degree), intervals)
    seconds = time.perf_counter() - began
    times = np.linspace(0, 1, 1001)
    error = np.max(np.abs(path(times) - np.stack([exact(t) for t in times], axis=1)))
    unit = 1024**3 if sys.platform == "darwin" else 1024**2
    return seconds, error, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit, path


def main():
    """Measure everything; returns the figures by name."""
    solve_seconds, error, memory, path = floor()  # first: the peak is that of the whole process
    figures = {
        f"solve, N = {SIZES[-1]}, m = 4: seconds": solve_seconds,
        f"solve, N = {SIZES[-1]}, m = 4: of them building": path.build_seconds,
        f"solve, N = {SIZES[-1]}, m = 4: largest error": error,
        f"solve, N = {SIZES[-1]}, m = 4: peak memory in GiB": memory,
    }
    ledger = Ledger()
    for degree in (4, 30):
        for what, (outside, evaluating) in overhead(ledger, degree).items():
            figures[f"{what}, N = {SMALL}, m = {degree}: ms outside"] = outside
            figures[f"{what}, N = {SMALL}, m = {degree}: ms evaluating"] = evaluating
    seconds, exponent = growth()
    for size, value in zip(SIZES, seconds, strict=True):
        figures[f"one Newton iteration, N = {size}, m = 4: ms"] = 1e3 * value
    figures["exponent of its growth with N"] = exponent
    return figures


if __name__ == "__main__":
    print(f"Python {platform.python_version()}, CasADi {ca.__version__}, NumPy {np.__version__}, {platform.machine()}")
    for name, figure in main().items():
        print(f"{name:58} {figure:10.3g}")
