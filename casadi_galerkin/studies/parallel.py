"""Variations of a problem solved chunk by chunk: in this process, or by the own ``map`` of an executor of processes.

A chunk has some √n / 2 of n variations; larger ones led to another branch in a porkchop plot.  Without a tolerance,
chunks follow the order given.  With one, a variation starts from the path and the mesh of its nearest neighbor: some
2√n, the centers, are solved first, next always the one nearest to a solved one, and then about each of them a chunk of
those that are nearest to it.  Chunks do not depend on who solves them, so that answers do not, either.

To an executor goes the pickled problem with every chunk; each worker builds its graph once.  Nothing here knows whose
executor it is: a process pool's, Dask's ``client.get_executor()``, mpi4py's ``MPIPoolExecutor``.  What ends a worker
ends the whole of a process pool: what was lost is solved again, one by one, by a process that is started again when a
variation ends it.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor
from contextlib import ExitStack, suppress
from functools import lru_cache, partial
from typing import Any, TypeVar

import numpy as np

from casadi_galerkin._solve import AdaptiveTranscription, transcribe
from casadi_galerkin.boundary.transcription import Transcription
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.roundoff import or_one
from casadi_galerkin.control.control_transcription import ControlTranscription
from casadi_galerkin.functional.buffers import fork_waits, interrupts_raised
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.problem import VARIED, Problem, map_times, section_times
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.quantity import Quantity
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.studies.sweep_file import CutShort, SweepFile

OF_PROBLEMS = "let its callables use no CasADi Function that exists in this process only, such as a casadi.Callback"

Variation = Mapping[str, Any]
Answer = Trajectory | Exception
Known = tuple[np.ndarray, Trajectory]  # the given values of a problem, and its path
Solve = Callable[[Variation, Sequence[Known]], Trajectory]  # of a variation, from paths that are known
Chunk = tuple[Sequence[Variation], Sequence[Known]]  # what is solved one after the other, and paths to start from
Run = Callable[[list[Chunk]], Iterable[Iterable[Answer]]]
Stated = TypeVar("Stated", BoundaryProblem, ControlProblem, BoundaryProblem | ControlProblem)


def data_vector(problem: Problem) -> np.ndarray:
    """All given numbers of a problem, its times first."""
    return np.array([*problem.t_span, *(a for values in problem.given.values() for a in values if a is not None)])


def nearest(values: np.ndarray, known: np.ndarray, spread: np.ndarray) -> int:
    """Number of the row of `known` that is nearest to `values`, with distances in units of `spread`."""
    return int(np.argmin(np.sum(((known - values) / or_one(spread)) ** 2, axis=1)))


def varied(problem: Stated, variation: Variation) -> Stated:
    """The problem of a variation."""
    given = {name: value for name, value in variation.items() if name in VARIED}
    return problem.varied(given, variation.get("t_span"))


def solver_of(
    problem: BoundaryProblem | ControlProblem,
    method: Galerkin | None,
    intervals: int | None,
    tol: float | None,
    of: Quantity | None,
) -> Solve:
    """A function that solves a variation: on a graph built once, or, to a tolerance, on meshes refined for it."""
    if tol is None:
        if method is None or intervals is None:
            raise ValueError(f"give a method and intervals, or tol, got method={method!r} and intervals={intervals!r}")
        return partial(_on_one_graph, transcribe(problem, method, intervals))
    return partial(_from_neighbors, transcribe(problem, method, intervals, tol=tol, of=of))


def _on_one_graph(graph: Transcription | ControlTranscription, variation: Variation, _: Sequence[Known]) -> Trajectory:
    """Solve on a mesh that is stretched to the times of the variation, with breakpoints where they are."""
    span, given = variation.get("t_span"), {name: value for name, value in variation.items() if name != "t_span"}
    if span is None:
        return graph.solve(**given)
    times = [span[0], *graph.problem.breakpoints, span[1]]
    return graph.solve(**given, mesh=map_times(graph.mesh, section_times(graph.problem), times))


def _from_neighbors(
    transcription: AdaptiveTranscription[Any], variation: Variation, known: Sequence[Known]
) -> Trajectory:
    """Solve to a tolerance from the nearest known path, and where that leads to none, as without one.

    A variation with a guess of its own is solved from that, on the mesh of its neighbor; one with a guess of the free
    duration, which chooses among the paths of an energy, has no neighbor.
    """
    guess, own = variation.get("guess"), varied(transcription.problem, variation)
    if known and not (getattr(own, "energy", None) is not None and "t_span" in variation):
        values = np.array([data_vector(own), *(place for place, _ in known)])
        _, near = known[nearest(values[0], values[1:], np.ptp(values, axis=0))]
        try:
            return transcription.find(own, near if guess is None else guess, near)
        except ConvergenceError:
            if guess is not None:
                raise
    return transcription.find(own, guess, None)


def _known(answers: Iterable[Answer]) -> list[Known]:
    """Those answers from which others may start."""
    return [(data_vector(answer.problem), answer) for answer in answers if isinstance(answer, Trajectory)]


def here(solver: Solve, chunks: list[Chunk]) -> Iterator[Iterator[Answer]]:
    """Solve all chunks in this process."""
    return (_answers(solver, *chunk) for chunk in chunks)


def _answers(solver: Solve, variations: Sequence[Variation], known: Sequence[Known]) -> Iterator[Answer]:
    """Solve variations one after the other; each may start from the answers before and from known paths."""
    paths = list(known)
    for variation in variations:
        answer: Answer
        try:
            with interrupts_raised():
                answer = solver(variation, paths)
        except Exception as error:
            error.__cause__ = error.__context__ = None  # their frames, like those of the error, would keep arrays alive
            answer = error.with_traceback(None)
        paths += _known([answer])
        yield answer


def picklable(what: str, given: object, remedy: str = OF_PROBLEMS) -> bytes:
    """What goes to other processes as bytes; a TypeError refuses what these could not read, with a remedy."""
    try:
        written = pickle.dumps(given)
        pickle.loads(written)
    except Exception as error:  # whatever the objects within raise
        raise TypeError(f"{what} cannot be pickled, as it must for other processes: {remedy} ({error})") from error
    return written


@lru_cache(1)
def _unpickled(pickled: bytes) -> Solve:
    """A worker's own solver, kept from chunk to chunk."""
    return solver_of(*pickle.loads(pickled))


def _chunk(pickled: bytes, chunk: Chunk) -> list[Answer]:
    """Solve one chunk; this is what a worker runs."""
    with fork_waits:  # a worker of a cluster may run several chunks in threads of one process
        return list(_answers(_unpickled(pickled), *chunk))


def by_executor(executor: Executor, pickled: bytes, chunks: list[Chunk]) -> Iterator[list[Answer]]:
    """Solve all chunks by an executor, and one by one, in a process of their own, what its workers lose."""
    run, results, count = partial(_chunk, pickled), iter(list[list[Answer]]()), 0
    with suppress(BrokenExecutor):  # a chunk may end its worker before the last one is sent
        results = executor.map(run, chunks)
    with suppress(Exception):  # of a worker that failed
        for answers in results:
            yield answers
            count += 1
    with ExitStack() as started:
        context = getattr(executor, "_mp_context", None)
        process: ProcessPoolExecutor | None = None
        for variations, known in chunks[count:]:
            answers = []
            for variation in variations:
                process = process or started.enter_context(ProcessPoolExecutor(1, context))
                try:
                    answers += process.submit(run, ([variation], [*known, *_known(answers)])).result()
                except Exception as error:
                    process = None
                    why = f"the worker that solved this variation failed, {type(error).__name__}: {error}"
                    answers.append(CutShort(why))
            yield answers


def answered(
    run: Run,
    variations: Sequence[Variation],
    problems: Sequence[Problem],
    file: SweepFile | None,
) -> Iterator[tuple[int, Answer]]:
    """Numbers of variations and their answers, as they come.

    Parameters
    ----------
    run : solves chunks, `here` or `by_executor`
    variations : in their order
    problems : what they state, where each is solved from its neighbors; else none
    file : which has the answers of some chunks, and keeps those of the others; or None
    """
    solved, numbers = partial(_in_chunks, run, variations, file), range(len(variations))
    size = 1 + math.isqrt(len(numbers)) // 2
    if not problems:
        yield from solved([(list(numbers[first : first + size]), []) for first in numbers[::size]])
        return
    values = np.array([data_vector(problem) for problem in problems])
    places = values / or_one(np.ptp(values, axis=0))
    centers = np.array(numbers[::size])
    apart = np.array([np.sum((places - places[center]) ** 2, axis=1) for center in centers])
    order, away = list[int](), apart[0, centers]  # next always the center that is nearest to one before
    for _ in centers:
        order.append(int(np.argmin(away)))
        away = np.minimum(away, apart[order[-1], centers])
        away[order] = np.inf
    found = dict[int, Answer]()
    for i, answer in solved([(centers[order].tolist(), [])]):
        found[i] = answer
        yield i, answer
    belongs, chunks = np.argmin(apart, axis=0), []
    for k, center in enumerate(centers):
        own = np.setdiff1d(np.flatnonzero(belongs == k), centers)
        nearby = _known(found[i] for i in centers[np.argsort(apart[:, center], kind="stable")].tolist())
        chunks.append((own[np.argsort(apart[k, own], kind="stable")].tolist(), nearby[:1]))
    yield from solved(chunks)


def _in_chunks(
    run: Run,
    variations: Sequence[Variation],
    file: SweepFile | None,
    chunks: Sequence[tuple[list[int], list[Known]]],
) -> Iterator[tuple[int, Answer]]:
    """Answers of chunks, given by the numbers of their variations: those that the file has, and then the others."""
    fresh = []
    for numbers, known in chunks:
        kept = file.get(numbers) if file else None
        if kept is None:
            fresh.append((numbers, ([variations[i] for i in numbers], known)))
        else:
            yield from zip(numbers, kept, strict=True)
    for (numbers, _), answers in zip(fresh, run([chunk for _, chunk in fresh]), strict=True):
        found = []
        for i, answer in zip(numbers, answers, strict=True):
            found.append(answer)
            yield i, answer
        if file:
            file.keep(numbers, found)
