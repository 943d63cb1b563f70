"""Stepping against SciPy's DOP853 at equal error: Kepler, e = 0.6, 10 revolutions; and the cost of a step.

Both are run here, in turn, and medians of whole solve calls are printed.  Either side uses the loosest of its settings
that meets the error; `build` is what building the graph takes, left out of `solve` and part of `all`.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

import casadi_galerkin as cg

REVOLUTIONS, REPEATS = 10, 7
SPAN = (0.0, 2 * np.pi * REVOLUTIONS)
POSITION, VELOCITY = [0.4, 0.0], [0.0, 2.0]


def lagrangian(t: ca.SX, x: ca.SX, v: ca.SX) -> ca.SX:
    """Kepler problem with GM = 1."""
    return ca.dot(v, v) / 2 + 1 / ca.norm_2(x)


def field(_: float, y: np.ndarray) -> tuple[float, float, float, float]:
    """The same as a first-order system, in plain Python as is fastest for SciPy."""
    x1, x2, v1, v2 = y.tolist()
    cube = (x1 * x1 + x2 * x2) ** 1.5
    return v1, v2, -x1 / cube, -x2 / cube


def stepped(degree: int, intervals: int) -> tuple[float, float]:
    """Error at the end and seconds of building."""
    problem = cg.InitialProblem(lagrangian, SPAN, POSITION, velocity=VELOCITY)
    path = cg.solve(problem, cg.Galerkin(degree), intervals)
    return float(np.max(np.abs(path.x[:, -1] - POSITION))), path.build_seconds


def dop853(rtol: float) -> float:
    """Error at the end."""
    answer = solve_ivp(field, SPAN, [*POSITION, *VELOCITY], method="DOP853", rtol=rtol, atol=rtol)
    return float(np.max(np.abs(answer.y[:2, -1] - POSITION)))


def seconds(run: Callable[[], object]) -> float:
    """Wall time of one call."""
    began = time.perf_counter()
    run()
    return time.perf_counter() - began


def equal_error(error: float, degree: int) -> tuple[int, float]:
    """The loosest settings that meet an error: intervals, and SciPy's rtol."""
    intervals = next(n for n in range(100, 2000, 20) if stepped(degree, n)[0] <= error)
    rtol = next(tol for tol in 10.0 ** np.arange(-6, -14, -0.25) if dop853(tol) <= error)
    return intervals, float(rtol)


def compare(error: float, degree: int) -> float:
    """Print one line of the table; returns SciPy's time over ours."""
    intervals, rtol = equal_error(error, degree)
    builds, ours, theirs = [], [], []
    for _ in range(REPEATS):
        began = time.perf_counter()
        builds.append(stepped(degree, intervals)[1])
        ours.append(time.perf_counter() - began)
        theirs.append(seconds(lambda: dop853(rtol)))
    whole, build, scipy = (1e3 * statistics.median(times) for times in (ours, builds, theirs))
    print(
        f"{error:8.0e}  degree {degree:2d}, {intervals:4d} steps  {whole - build:8.1f} {whole:8.1f} {build:8.1f}"
        f"   rtol {rtol:7.1e}  {scipy:8.1f}   {scipy / (whole - build):6.1f} {scipy / whole:6.1f}"
    )
    return scipy / (whole - build)


def cost_per_step(degree: int) -> None:
    """Print the time of a step, verified, for growing numbers of steps of the same length."""
    for intervals in (100, 1000, 10000, 100000):
        problem = cg.InitialProblem(lagrangian, (0.0, SPAN[1] * intervals / 1000), POSITION, velocity=VELOCITY)
        times = [cg.solve(problem, cg.Galerkin(degree), intervals).solve_seconds for _ in range(3)]
        print(f"degree {degree}, {intervals:6d} steps: {1e6 * statistics.median(times) / intervals:6.1f} us a step")


def drift(degree: int = 4, intervals: int = 100_000) -> None:
    """Print what 1e5 steps, 1000 revolutions, do to angular momentum and energy."""
    problem = cg.InitialProblem(lagrangian, (0.0, 2000 * np.pi), POSITION, velocity=VELOCITY)
    path = cg.solve(problem, cg.Galerkin(degree), intervals)
    (x, y), (px, py) = path.x, path.momentum
    energy = (px**2 + py**2) / 2 - 1 / np.hypot(x, y) + 0.5
    spread = np.max(np.abs(x * py - y * px - 0.8))
    first, last = (np.max(np.abs(part)) for part in (energy[: intervals // 2], energy[intervals // 2 :]))
    print(f"{intervals} steps of degree {degree}: angular momentum {spread:.1e}, energy {first:.3e}, later {last:.3e}")


def main() -> dict[float, float]:
    """Print all tables; returns SciPy's time over ours, by error."""
    print(
        "milliseconds to an error      at the end:       solve      all    build               DOP853   / solve  / all"
    )
    ratios = {error: max(compare(error, degree) for degree in (5, 6, 8, 10)) for error in (1e-6, 1e-10)}
    cost_per_step(8)
    drift()
    return ratios


if __name__ == "__main__":
    main()
