"""One Newton iteration against what the machine allows.

An iteration is ∇S, ∇²S and the solution with ∇²S for two right-hand sides, with the measures that Newton's method needs
of it.  Its limit is the evaluation of both derivatives at all points by a loop compiled in C, and LAPACK's banded
factorization and solution of the same matrix for one right-hand side (Cholesky where it is definite, else LU), with the
matrix in LAPACK's own form already: assembling it is not counted.

Run it alone on a quiet machine; it takes a minute or two, and it needs a C compiler, gcc or cc.
"""

import os
import platform
import shutil
import tempfile
import time
from itertools import product

import casadi as ca
import numpy as np
from scipy.linalg import lapack

import casadi_galerkin as cg
from casadi_galerkin.functional.buffers import Evaluator
from casadi_galerkin.functional.embedding import embedding

SIZES, DEGREES, LARGEST = (100, 1000, 10_000), (4, 8, 12), 200_000  # unknowns, beyond which memory is measured
TURNS, SECONDS = 5, 0.3  # in which all are timed one after the other, and what one takes at least in all of them


def pendulum():
    """One component."""
    return cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), (0.0, 2.0), [0.0], [1.0])


def kepler():
    """Two components."""
    return cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 + 1 / ca.norm_2(x), (0.0, 1.0), [0.4, 0.0], [-0.62894817682, 0.79966473097]
    )


def chain(masses):
    """Masses on stiffening springs, from rest at one place to an even row."""

    def lagrangian(t, x, v):
        stretch = x - ca.vertcat(0, x[:-1])
        return ca.dot(v, v) / 2 - ca.sum1(stretch**2 / 2 + stretch**4 / 4)

    return cg.BoundaryProblem(lagrangian, (0.0, 1.0), [0.0] * masses, np.linspace(0, 1, masses + 1)[1:])


def fastest(*calls):
    """Least milliseconds of each of some callables, timed in turns because a machine's speed drifts."""
    least = [np.inf] * len(calls)
    for _ in range(TURNS):
        for i, call in enumerate(calls):
            began = time.perf_counter()
            while time.perf_counter() - began < SECONDS / TURNS:
                start = time.perf_counter()
                call()
                least[i] = min(least[i], time.perf_counter() - start)
    return 1e3 * np.array(least)


def iteration(transcription, unknowns, data):
    """A callable: derivatives, solution and its measures."""

    def once():
        with transcription.stationarity.linearization() as at:
            at.newton_step(unknowns, data)

    return once


def banded(transcription, unknowns, data):
    """A callable: LAPACK's factorization and solution; and one that copies the inputs, which the first overwrites."""
    matrix = transcription.hessian.call([unknowns, *data])[0]
    columns, rows = (np.array(index) for index in reversed(matrix.sparsity().get_triplet()))
    entries, n = np.array(matrix.nonzeros()), matrix.size1()
    width = int(np.max(rows - columns))
    lower = np.zeros((width + 1, n), order="F")
    below = rows >= columns
    lower[(rows - columns)[below], columns[below]] = entries[below]
    right = np.ones((n, 1), order="F")
    if lapack.dpbsv(lower, right, lower=1)[2] == 0:
        return lambda: lapack.dpbsv(lower, right, lower=1), lambda: (lower.copy(order="F"), right.copy(order="F"))
    full = np.zeros((3 * width + 1, n), order="F")
    full[2 * width + rows - columns, columns] = entries
    return lambda: lapack.dgbsv(width, width, full, right), lambda: (full.copy(order="F"), right.copy(order="F"))


def compiled(f, count):
    """Map a Function over so many points, the loop compiled in C."""
    flags = {
        "compiler": shutil.which("gcc") or shutil.which("cc"),
        "flags": ["-O3", "-march=native"],
        "directory": tempfile.gettempdir() + os.sep,
    }
    inputs = [ca.MX.sym(f.name_in(i), f.size1_in(i), count) for i in range(f.n_in())]
    options = {"jit": True, "compiler": "shell", "jit_options": flags}
    return ca.Function(f.name(), inputs, f.map(count).call(inputs), options)


def points(transcription, unknowns, data):
    """A callable: both derivatives at all points, compiled in C."""
    functional, mesh = transcription.functional, data[2]
    parts, steps = functional.numbering.method.element.points, np.diff(mesh)
    at = (
        (mesh[:-1] + np.multiply.outer(parts, steps)).ravel(),
        np.tile(steps, len(parts)),
        *embedding(functional.numbering)(np.concatenate((unknowns, *data[:2]))),
    )
    loop = Evaluator(compiled(functional.pointwise.derivatives, functional.numbering.points))
    given = [np.array(a).ravel(order="F") for a in at]
    return lambda: loop(*given)


def main(sizes=SIZES):
    """Measure all; returns {(d, m, N): ratio to the limit}."""
    ratios = {}
    for problem in (pendulum(), kepler(), chain(6), chain(20)):
        for degree, intervals in product(DEGREES, sizes):
            if problem.dimension * degree * intervals <= LARGEST:
                transcription = cg.transcribe(problem, cg.Galerkin(degree), intervals)
                point = transcription.critical_point()
                at = transcription, point.solution.unknowns, point.solution.data
                whole, loop, solution, copies = fastest(iteration(*at), points(*at), *banded(*at))
                limit = loop + solution - copies
                ratios[problem.dimension, degree, intervals] = whole / limit
                row = "".join(f"{value:13.3f}" for value in (whole, loop, solution - copies))
                print(f"{problem.dimension:3d}{degree:3d}{intervals:7d}{row}{whole / limit:8.2f}", flush=True)
    return ratios


if __name__ == "__main__":
    print(f"Python {platform.python_version()}, CasADi {ca.__version__}, NumPy {np.__version__}, {platform.machine()}")
    print("  d  m      N iteration/ms    points/ms    banded/ms   ratio")
    figures = np.array(list(main().values()))
    print(f"ratios from {figures.min():.2f} to {figures.max():.2f}, median {np.median(figures):.2f}")
