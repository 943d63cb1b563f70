"""A first path for a refinement: ways to find one, in the order of their cost."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from casadi_galerkin.boundary.action_descent import descend
from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.levels import Levels
from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import equidistributed, of_degree, truncation
from casadi_galerkin.functional.mapping import by_rows
from casadi_galerkin.solution.guess import Guess, guess_values
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solvers.newton import damped_newton
from casadi_galerkin.solvers.solver import Solver, SolverLike, newton

PATIENCE = 2  # meshes on which a first path may be lost before another is looked for; a false one was seen to creep
ITERATIONS = 40  # of Newton's method from an earlier path; where it took more it was measured to wander
DESCENT_DEGREE, DESCENT_INTERVALS, DESCENT_TOLERANCE = 6, 40, 1e-5
LEAPS = 0.02, 0.1  # of a descent: short ones stay on their side of a singularity, long ones arrive
GUESS_LEVELS, GUESS_INTERVALS, GUESS_TOLERANCE = 10, 200, 1e-4


def following(solver: SolverLike) -> SolverLike:
    """Newton's method from an earlier path, with the options of `solver` if that is Newton's method, too."""
    own = solver.options if isinstance(solver, Solver) and solver.name == newton.name else {}
    return partial(damped_newton, **{"max_iter": ITERATIONS, **own})


def mesh_for_guess(levels: Levels, method: Galerkin, guess: Guess, mesh: np.ndarray) -> np.ndarray:
    """Joints on which the guess itself is resolved: where it turns sharply, so may the path."""
    path = levels.transcription(method, mesh).guess_on_mesh(guess, mesh)
    given = guess.polynomial if isinstance(guess, Path) else guess
    for _ in range(GUESS_LEVELS):
        error = truncation(path)
        if not callable(given) or np.max(error) <= GUESS_TOLERANCE or len(mesh) > GUESS_INTERVALS:
            break  # there is nothing between the values of an array
        mesh = equidistributed(mesh, error, method.degree + 1, GUESS_TOLERANCE)
        calculus = DiscreteCalculus(method, mesh)
        path = calculus.emb(guess_values(given, calculus, len(path.values)))
    return mesh


def first_path_strategies(
    levels: Levels,
    method: Galerkin,
    mesh: np.ndarray,
    guess: Guess | None,
    solver: SolverLike,
    every_level: range,
    out_of_time: Callable[[], bool],
) -> Iterator[tuple[Callable[[], CriticalPoint], float]]:
    """Ways to a first path, each with the number of meshes on which it may be lost before the next one is tried.

    Newton's method on the coarse mesh; a descent of the action; whatever `solver` tries.
    """
    if isinstance(solver, Solver) and solver.name == newton.name:
        yield partial(levels.solve, method, mesh, guess, partial(damped_newton, **solver.options)), PATIENCE
        count = max(DESCENT_INTERVALS + 1, len(mesh))
        joints = np.interp(np.linspace(0, 1, count), np.linspace(0, 1, len(mesh)), mesh)
        graph = levels.transcription(method, mesh)
        for leap in LEAPS if graph.stationarity.variational and not graph.numbering.multipliers else ():
            yield partial(_by_descent, levels, joints, guess, leap, every_level, out_of_time), math.inf
    yield partial(levels.solve, method, mesh, guess, solver), math.inf


def _by_descent(
    levels: Levels,
    mesh: np.ndarray,
    guess: Guess | None,
    leap: float,
    every_level: range,
    out_of_time: Callable[[], bool],
) -> CriticalPoint:
    """Lower the action of a guess until Newton's method takes over."""
    method = of_degree(DESCENT_DEGREE)
    transcribed = partial(levels.transcription, method, mapping=by_rows)
    path = transcribed(mesh).guess_on_mesh(guess, mesh)
    path = descend(transcribed, path, DESCENT_TOLERANCE, leap, every_level, out_of_time)
    return levels.solve(method, path.mesh, path, following(newton))
