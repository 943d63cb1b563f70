"""Variations solved in this process, or by an executor in others; failures are kept beside the answers.

The solves of one process run one after the other, so threads would gain nothing.  What goes to an executor is pickled:
the problem once, and chunks of variations; each worker process unpickles the problem and builds its graph once,
whatever the number of its chunks.  Nothing here knows whose executor it is: a process pool's, Dask's
``client.get_executor()``, mpi4py's ``MPIPoolExecutor``.

What ends a worker ends the whole of a process pool.  Chunks that were lost are solved again, one variation after the
other, by a process of their own, which is started again where it fails; so only what ends its worker stays without an
answer, and never ends the process that asks.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import ExitStack, suppress
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

from casadi_galerkin._solve import solve, transcribe
from casadi_galerkin.boundary.problem_data import data_vector, nearest
from casadi_galerkin.calculus.discrete_calculus import mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.roundoff import or_one
from casadi_galerkin.control.refinement import first_control_discretization
from casadi_galerkin.functional.buffers import interrupts_raised
from casadi_galerkin.functional.threads import fork_waits
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.problem import VARIED, Problem, map_times, section_times
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.limits import Limits, check_tolerance
from casadi_galerkin.solution.progress import Advance
from casadi_galerkin.solution.trajectory import Trajectory

CHUNKS, LARGEST_CHUNK = 64, 50  # enough chunks to keep workers equally busy; few enough that sending costs little
SMALLEST_NEIGHBORHOOD = 4  # least variations in a chunk about one that has to be solved before them

Variation = Mapping[str, Any]
Answer = Trajectory | Exception
Known = tuple[np.ndarray, Trajectory]  # the given values of a problem, and its path
Chunk = tuple[Sequence[int], Sequence[Known]]  # variations to solve one after the other, and paths to start from
Solve = Callable[[Variation, Sequence[Known]], Trajectory]  # of a variation, from paths that are known
Solved = Callable[[Sequence[Variation], Sequence[Known]], list[Answer]]
Stated = TypeVar("Stated", BoundaryProblem, ControlProblem, BoundaryProblem | ControlProblem)


class CutShort(ConvergenceError):
    """A solve that something else ended: its worker failed, or the sweep was interrupted.  A path may well exist.

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> issubclass(cg.CutShort, cg.ConvergenceError)
    True
    """


def varied(problem: Stated, variation: Variation) -> Stated:
    """The problem of a variation."""
    given = {name: value for name, value in variation.items() if name in VARIED}
    return problem.varied(given, variation.get("t_span"))


class Neighbors:
    """Solves variations of a boundary problem to a tolerance, each from the nearest one that is solved already.

    A variation with a guess of its own is solved from that, on the mesh of its neighbor; one with a guess of the free
    duration, which chooses among the paths of an energy, has no neighbor.
    """

    def __init__(self, problem: BoundaryProblem, method: Galerkin | None, intervals: int | None, tol: float) -> None:
        self._transcription = transcribe(problem, method, intervals, tol=tol)

    def __call__(self, variation: Variation, known: Sequence[Known]) -> Trajectory:
        """Solve from the nearest known path; where that leads to none, from the straight line."""
        problem = varied(self._transcription.problem, variation)
        if not known or (problem.energy is not None and "t_span" in variation):
            return self._transcription.found(problem, variation.get("guess"), None)
        (_, near), guess = _nearest(problem, known), variation.get("guess")
        try:
            return self._transcription.found(problem, near if guess is None else guess, near)
        except ConvergenceError:
            if guess is not None:
                raise
            return self._transcription.found(problem, None, None)


def solver_of(
    problem: BoundaryProblem | ControlProblem, method: Galerkin | None, intervals: int | None, tol: float | None
) -> Solve:
    """A function that solves a variation: on a graph built once, or, to a tolerance, on meshes refined for it."""
    if tol is not None:
        if isinstance(problem, BoundaryProblem):
            return Neighbors(problem, method, intervals, tol)
        # refuses here what would fail in every variation
        first_control_discretization(problem, check_tolerance(tol), method, intervals, None, None, Limits())

        def refined(variation: Variation, _: Sequence[Known]) -> Trajectory:
            return solve(varied(problem, variation), method, intervals, tol=tol, guess=variation.get("guess"))

        return refined
    if method is None or intervals is None:
        raise ValueError(f"give a method and intervals, or tol, got method={method!r} and intervals={intervals!r}")
    transcription = transcribe(problem, method, intervals)

    def joints(start: float, end: float) -> np.ndarray:
        if isinstance(problem, BoundaryProblem):
            return mesh_of((start, end), intervals, None, problem.breakpoints)
        return map_times(transcription.mesh, section_times(problem), [start, *problem.breakpoints, end])

    def solved(variation: Variation, _: Sequence[Known]) -> Trajectory:
        given = dict(variation)
        span = given.pop("t_span", None)
        return transcription.solve(**given, mesh=None if span is None else joints(*span))

    return solved


def _answers(solver: Solve, variations: Sequence[Variation], known: Sequence[Known]) -> Iterator[Answer]:
    """Solve variations one after the other; each may start from the answers before and from known paths."""
    paths = list(known)
    for variation in variations:
        answer: Answer
        try:
            with interrupts_raised():
                answer = solver(variation, paths)
        except SystemExit as error:
            answer = CutShort(f"a callable of this variation raised SystemExit({error.code!r})")
        except Exception as error:
            error.__cause__ = error.__context__ = None  # their frames, like those of the error, would keep arrays alive
            answer = error.with_traceback(None)
        paths += _known(answer)
        yield answer


def _known(answer: Answer | None) -> list[Known]:
    """An answer as a path that other variations may start from, if it is one."""
    if not isinstance(answer, Trajectory) or not isinstance(answer.problem, BoundaryProblem):
        return []
    return [(data_vector(answer.problem), answer)]


def _nearest(problem: Problem, known: Sequence[Known]) -> Known:
    """The known path whose given values are nearest to those of a problem."""
    values = np.array([data_vector(problem), *(place for place, _ in known)])
    return known[nearest(values[0], values[1:], np.ptp(values, axis=0))]


def checked_pickle(given: object) -> bytes:
    """Problems and what goes with them as bytes, after a check that CasADi can read what it has written."""
    written = pickle.dumps(given)
    try:
        pickle.loads(written)
    except RuntimeError as error:
        raise TypeError(
            "the problem cannot be pickled, because its callables use a CasADi Function that exists in this process "
            f"only, such as a casadi.Callback: {error}"
        ) from error
    return written


def in_words(error: BaseException) -> str:
    """The kind of an error and its words."""
    return f"{type(error).__name__}: {error}"


@lru_cache(1)
def _unpickled(pickled: bytes) -> Solve:
    """A worker's own solver, kept from chunk to chunk."""
    return solver_of(*pickle.loads(pickled))


def _chunk(pickled: bytes, variations: Sequence[Variation], known: Sequence[Known] = ()) -> list[Answer]:
    """Solve one chunk; this is what a worker runs."""
    with fork_waits:  # a worker of a cluster may run several chunks in threads of one process
        return list(_answers(_unpickled(pickled), variations, known))


class Batch:
    """Variations on the way to their answers.

    Parameters
    ----------
    solver : solves a variation in this process
    variations, problems : in their order, each with the problem that it states

    Attributes
    ----------
    answers : those that there are, by the number of their variation
    advance : called with the number of new answers
    """

    def __init__(self, solver: Solve, variations: Sequence[Variation], problems: Sequence[Problem]) -> None:
        self.solver, self.variations, self.problems = solver, variations, problems
        self.answers: dict[int, Answer] = {}
        self.advance: Advance = lambda _: None

    def solve_here(self) -> None:
        """Solve all in this process."""
        for numbers, known in self._chunks(lambda *given: list(_answers(self.solver, *given))):
            some = [self.variations[i] for i in numbers]
            for i, answer in zip(numbers, _answers(self.solver, some, known), strict=True):
                self.answers[i] = answer
                self.advance(1)

    def solve_by(self, executor: Executor, pickled: bytes) -> None:
        """Solve all by an executor, whose workers unpickle what `solver_of` takes."""
        self._solve_chunks(executor, pickled)
        self._solve_lost(executor, pickled)

    def _chunks(self, solved: Solved) -> list[Chunk]:
        """Chunks in the order given, or of neighbors, the first of which `solved` has solved."""
        if isinstance(self.solver, Neighbors):
            return self._neighborhoods(solved)
        count = len(self.variations)
        size = min(LARGEST_CHUNK, -(-count // CHUNKS) or 1)
        return [(range(first, min(first + size, count)), ()) for first in range(0, count, size)]

    def _neighborhoods(self, solved: Solved) -> list[Chunk]:
        """Chunks of variations that are near one another, each about a center, ordered by their distance from it.

        The centers are solved here by `solved`, always next the one that is nearest to a solved one.  The chunks do not
        depend on who solves them, so that the answers do not, either.
        """
        count = len(self.variations)
        if not count:
            return []
        size = min(LARGEST_CHUNK, max(SMALLEST_NEIGHBORHOOD, -(-count // CHUNKS)))
        values = np.array([data_vector(problem) for problem in self.problems])
        scaled = values / or_one(np.ptp(values, axis=0))
        centers = np.arange(0, count, size)
        apart = np.array([np.sum((scaled - scaled[center]) ** 2, axis=1) for center in centers])
        waiting = np.where(centers == 0, 0.0, np.inf)  # distances from what is solved; NaN for what is
        begins: dict[int, list[Known]] = {}
        for _ in centers:
            i = int(np.nanargmin(waiting))
            first = int(centers[i])
            order = sorted(begins, key=lambda k: float(apart[k, first]))
            near = next((begins[k] for k in order if begins[k]), [])
            with suppress(Exception):  # of a worker; it is solved again with what is lost
                (self.answers[first],) = solved([self.variations[first]], near)
            begins[i] = _known(self.answers.get(first))
            waiting = np.minimum(waiting, apart[i, centers])
            waiting[i] = np.nan
            self.advance(1)
        belongs = np.argmin(apart, axis=0)
        chunks: list[Chunk] = []
        for i, begin in begins.items():
            own = np.flatnonzero(belongs == i)
            own = own[np.argsort(apart[i, own], kind="stable")]
            chunks.append(([k for k in own.tolist() if k != centers[i]], begin))
        return chunks

    def _solve_chunks(self, executor: Executor, pickled: bytes) -> None:
        """Solve all chunks; those of a worker that fails are left out."""
        taken: list[Future[list[Answer]]] = []

        def submitted(some: Sequence[Variation], known: Sequence[Known]) -> Future[list[Answer]]:
            taken.append(executor.submit(_chunk, pickled, some, known))
            return taken[-1]

        chunks = self._chunks(lambda *given: submitted(*given).result())
        futures: dict[Future[list[Answer]], Sequence[int]] = {}
        try:
            for numbers, known in chunks:
                try:
                    futures[submitted([self.variations[i] for i in numbers], known)] = numbers
                except Exception:
                    if not taken:
                        raise  # it has never worked
                    break  # a worker has failed meanwhile
            for future in as_completed(futures):
                with suppress(Exception):
                    self.advance(len(future.result()))
        finally:  # also after an interrupt, be it here or in a worker
            for future, numbers in futures.items():
                if not future.cancel() and future.done() and future.exception() is None:
                    self.answers.update(zip(numbers, future.result(), strict=True))

    def _solve_lost(self, executor: Executor, pickled: bytes) -> None:
        """Solve what has no answer yet, each alone, so that a process that fails tells which variation it fails of."""
        lost = [i for i in range(len(self.variations)) if i not in self.answers]
        known = [path for answer in self.answers.values() for path in _known(answer)]
        context, process = getattr(executor, "_mp_context", None), None
        with ExitStack() as started:
            for i in lost:
                process = process or started.enter_context(ProcessPoolExecutor(1, context))
                near = [_nearest(self.problems[i], known)] if isinstance(self.solver, Neighbors) and known else []
                try:
                    (self.answers[i],) = process.submit(_chunk, pickled, [self.variations[i]], near).result()
                except Exception as error:
                    self.answers[i] = CutShort(f"the worker that solved this variation failed, {in_words(error)}")
                    process = None
                known += _known(self.answers[i])
                self.advance(1)
