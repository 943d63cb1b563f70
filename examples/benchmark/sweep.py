"""How many boundary problems a second: the Lambert transfers of the porkchop plot, serial and by a pool of processes.

The pool's time includes sending problems and answers, not the start of its processes.  Run it on a quiet machine.
"""

import platform
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import casadi as ca
import numpy as np

import casadi_galerkin as cg

sys.path.insert(0, str(Path(__file__).parents[1]))
import porkchop

WORKERS, REPEATS = 2, 3


def timed(call):
    """Seconds of a call, and what it returned."""
    began = time.perf_counter()
    result = call()
    return time.perf_counter() - began, result


def main():
    """Measure; returns the best seconds of the serial sweep and of the pool's, and the number of solves."""
    problem, transfers = porkchop.problem_and_variations()

    def sweep(executor=None, count=None):
        return cg.sweep(problem, transfers[:count], porkchop.METHOD, porkchop.INTERVALS, executor=executor)

    serial, pooled = [], []
    with ProcessPoolExecutor(WORKERS, mp_context=get_context("spawn")) as pool:
        sweep(pool, 200)  # processes start, import and build
        for _ in range(REPEATS):  # in turn, because other work on the machine comes and goes
            seconds, here = timed(sweep)
            serial.append(seconds)
            seconds, there = timed(lambda: sweep(pool))
            pooled.append(seconds)
    np.testing.assert_array_equal(here.x, there.x)
    return min(serial), min(pooled), len(transfers), len(here.failures)


if __name__ == "__main__":
    print(f"Python {platform.python_version()}, CasADi {ca.__version__}, NumPy {np.__version__}, {platform.machine()}")
    serial, pooled, count, failures = main()
    print(f"{count} Lambert transfers, {failures} without an answer")
    print(f"serial             {serial:6.2f} s, {1e3 * serial / count:.2f} ms each")
    print(f"{WORKERS} processes        {pooled:6.2f} s, {serial / pooled:.2f} times the throughput")
