"""How many boundary problems a second: the Lambert transfers of the porkchop plot, serial and by a pool of processes.

On one fixed mesh, for which every transfer needs a guess of its own, and to the tolerance of the plot, where each
starts from its neighbor.  The pool's time includes sending problems and answers, not the start of its processes.  Run
it on a quiet machine.
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

METHOD, INTERVALS = cg.Galerkin(degree=6), 10
WORKERS, REPEATS = 2, 3


def timed(call):
    """Seconds of a call, and what it returned."""
    began = time.perf_counter()
    result = call()
    return time.perf_counter() - began, result


def main():
    """Measure; returns the best seconds of each way, the transfers to the tolerance, and how far off the mesh is."""
    problem, transfers = porkchop.problem(), porkchop.variations()
    guessed = [{**transfer, "guess": porkchop.arc(transfer)} for transfer in transfers]

    def fixed():
        return cg.sweep(problem, guessed, METHOD, INTERVALS)

    def refined(executor=None, count=None):
        return cg.sweep(problem, transfers[:count], tol=porkchop.TOLERANCE, executor=executor)

    seconds = {"fixed mesh": [], "tolerance": [], f"{WORKERS} processes": []}
    with ProcessPoolExecutor(WORKERS, mp_context=get_context("spawn")) as pool:
        refined(pool, 200)  # processes start, import and build
        for _ in range(REPEATS):  # in turn, because other work on the machine comes and goes
            for name, call in zip(seconds, (fixed, refined, lambda: refined(pool)), strict=True):
                spent, found = timed(call)
                seconds[name].append(spent)
                if call is fixed:
                    on_mesh = found
                elif call is refined:
                    here = found
    for one, other in zip(here, found, strict=True):
        np.testing.assert_array_equal(one.x, other.x)
    return {name: min(spent) for name, spent in seconds.items()}, here, np.max(np.abs(here.action - on_mesh.action))


if __name__ == "__main__":
    print(f"Python {platform.python_version()}, CasADi {ca.__version__}, NumPy {np.__version__}, {platform.machine()}")
    seconds, transfers, apart = main()
    count = len(transfers)
    print(f"{count} Lambert transfers: {len(transfers.failures)} without an answer, {len(transfers.jumps)} on another")
    print(f"branch than their neighbors; actions differ by {apart:.0e} from those on the fixed mesh")
    for name, spent in seconds.items():
        print(f"{name:16} {spent:6.2f} s, {1e3 * spent / count:.2f} ms each")
