"""Many variations of one problem: built once, solved here or by any executor, failures kept beside the answers.

A CasADi Function must not be shared between threads.  So what goes to an executor is pickled: the problem once, and
chunks of variations; each worker process unpickles the problem and builds its graph once, whatever the number of its
chunks.  Nothing here knows whose executor it is: a process pool's, Dask's ``client.get_executor()``, mpi4py's
``MPIPoolExecutor``.

What ends a worker ends the whole of a process pool.  Chunks that were lost are solved again, one variation after the
other, by the executor if it still works, else by a process of their own; so only what ends its worker stays without an
answer, and never ends the process that asks.
"""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
from tqdm import tqdm

from casadi_galerkin._solve import solve, transcribe
from casadi_galerkin.boundary.branches import jumps
from casadi_galerkin.boundary.variations import nearest, values_of
from casadi_galerkin.calculus.discrete_calculus import mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.lazy import lazy
from casadi_galerkin.calculus.numbers import time_span, times_inside
from casadi_galerkin.control.refinement import first_control_mesh
from casadi_galerkin.problems.boundary_problem import VARIED, BoundaryProblem
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.export import Table, by_component
from casadi_galerkin.solution.trajectory import Trajectory

FIELDS = (*VARIED, "t_span", "guess")
CHUNKS, LARGEST_CHUNK = 64, 50  # enough chunks to keep workers equally busy; few enough that sending costs little
SMALLEST_NEIGHBOURHOOD = 4  # variations about one that has to be solved before
_one_at_a_time = threading.Lock()  # a worker of a cluster may run several chunks in threads of one process

Variation = Mapping[str, Any]
Answer = Trajectory | Exception
Answers = dict[int, Answer]  # by the number of the variation
Known = tuple[np.ndarray, Trajectory]  # the given values of a problem, and its path


class CutShort(ConvergenceError):
    """A solve that something else ended: its worker failed, or the sweep was interrupted.  A path may well exist.

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> issubclass(cg.CutShort, cg.ConvergenceError)
    True
    """


@dataclass(frozen=True, repr=False)
class Sweep(Table):
    """What became of every variation, in the order of the variations.

    Attributes
    ----------
    answers : one for each variation, its Trajectory or the exception that says why there is none: a ConvergenceError,
        a CutShort where its worker failed or an interrupt came first, or whatever its guess raised

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> fall = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 10 * x[0], (0, 1), start=[0.0], end=[0.0])
    >>> throws = cg.sweep(fall, [{"end": [1.0]}, {"end": [2.0]}], cg.Galerkin(degree=2), intervals=4)
    >>> throws.x.shape, throws[1](1.0).tolist(), throws.failures
    ((2, 1, 5), [2.0], {})
    """

    answers: tuple[Answer, ...]

    def __len__(self) -> int:
        return len(self.answers)

    def __getitem__(self, i: int) -> Answer:
        return self.answers[i]

    def __iter__(self) -> Iterator[Answer]:
        return iter(self.answers)

    @property
    def failures(self) -> dict[int, Exception]:
        """Number of the variation -> exception, for those without an answer."""
        return {i: answer for i, answer in enumerate(self.answers) if not isinstance(answer, Trajectory)}

    @lazy
    def t(self) -> np.ndarray:
        """Joints, (variations, N + 1); NaN where there is no answer."""
        return self._stacked("t")

    @lazy
    def x(self) -> np.ndarray:
        """Positions at the joints, (variations, d, N + 1); NaN where there is no answer."""
        return self._stacked("x")

    @lazy
    def momentum(self) -> np.ndarray:
        """Momenta at the joints, (variations, d, N + 1); NaN where there is no answer."""
        return self._stacked("momentum")

    @lazy
    def action(self) -> np.ndarray:
        """Values of the action, (variations,); NaN where there is no answer."""
        return self._stacked("action")

    @lazy
    def cost(self) -> np.ndarray:
        """Costs of the variations of a control problem, (variations,); NaN where there is no answer."""
        return self._stacked("cost")

    def table(self) -> dict[str, np.ndarray]:
        """A row for each variation: why it failed, or an empty word; action, cost, duration, and both ends."""
        paths = [answer if isinstance(answer, Trajectory) else None for answer in self.answers]
        size, failures = max((len(path.x) for path in paths if path is not None), default=0), self.failures
        names = [name for name in ("action", "cost") if any(hasattr(path, name) for path in paths)]

        def ends(name: str) -> dict[str, np.ndarray]:
            """Values at the start and at the end."""
            found = np.full((len(paths), size, 2), np.nan)
            for i, path in enumerate(paths):
                if path is not None:
                    found[i] = getattr(path, name)[:, [0, -1]]
            return by_component(f"start_{name}", found[..., 0].T) | by_component(f"end_{name}", found[..., 1].T)

        return {
            "failure": np.array([str(failures.get(i, "")) for i in range(len(self))]),
            **{name: np.array([np.nan if path is None else getattr(path, name) for path in paths]) for name in names},
            "duration": np.array([np.nan if path is None else path.t[-1] - path.t[0] for path in paths]),
            **ends("x"),
            **ends("momentum"),
        }

    @lazy
    def jumps(self) -> dict[int, int]:
        """Number of the variation -> number of its neighbour, for those on another branch than their neighbour.

        A neighbour is the nearest variation that was solved and comes before.  Two variations are on different branches
        where their Morse indices differ, or where the action changes by more than its derivatives at both explain.
        Branches that differ in neither, such as mirror images, are not told apart; under constraints, end conditions,
        forces and a given energy only the index counts.
        """
        found = {}
        for i, answer in enumerate(self.answers):
            if isinstance(answer, Trajectory):
                if not isinstance(answer.problem, BoundaryProblem):
                    raise ValueError("jumps between branches are told for boundary problems only")
                found[i] = answer.problem, answer
        return jumps(found)

    def _stacked(self, name: str) -> np.ndarray:
        found = {i: np.asarray(getattr(a, name)) for i, a in enumerate(self.answers) if isinstance(a, Trajectory)}
        shapes = {value.shape for value in found.values()}
        if len(shapes) != 1:
            came = "the paths have different meshes" if shapes else "no variation has an answer"
            raise ValueError(f"{came}, so there is no array of their {name}: see answers and failures")
        stacked = np.full((len(self.answers), *shapes.pop()), np.nan)
        for i, value in found.items():
            stacked[i] = value
        return stacked

    def __repr__(self) -> str:
        """Summarise the sweep, with the first jump between branches and the reason of the first failure."""
        failures = self.failures
        text = f"Sweep of {len(self)} variation{'s' * (len(self) != 1)}, {len(self) - len(failures)} solved"
        cut_short = sum(isinstance(error, CutShort) for error in failures.values())
        if cut_short:
            text += f", {cut_short} cut short"
        boundary = all(isinstance(a.problem, BoundaryProblem) for a in self.answers if isinstance(a, Trajectory))
        if boundary and self.jumps:
            i, neighbour = next(iter(self.jumps.items()))
            text += f"\n  on another branch than their neighbours: {len(self.jumps)}, first {i} beside {neighbour}"
        if not failures:
            return text
        first, error = next(iter(failures.items()))
        reason = str(error) if isinstance(error, ConvergenceError) else _named(error)
        return f"{text}\n  variation {first} is the first without an answer: {reason}"


def sweep(
    problem: BoundaryProblem | ControlProblem,
    variations: Iterable[Variation],
    method: Galerkin | None = None,
    intervals: int | None = None,
    *,
    tol: float | None = None,
    executor: Executor | None = None,
) -> Sweep:
    """Solve many variations of one problem; a progress bar is shown in a terminal.

    Whatever becomes of one variation, the answers of the others are kept.  An interrupt (Ctrl-C) ends the sweep, which
    returns what it has.

    Parameters
    ----------
    problem : BoundaryProblem or ControlProblem
    variations : dicts of what differs from the problem: `start`, `end`, `parameters`, `t_span`; the velocities and
        momenta at the ends, and the energy, where the problem states them; and `guess`, as for `solve`, which with a
        process pool has to be picklable (an array, a Trajectory, a module's function)
    method, intervals : as for `solve`
    tol : as for `solve`; each variation of a boundary problem without a guess of its own starts from the path and the
        mesh of the nearest one that is solved, and so stays on its branch; see `Sweep.jumps`.  Variations of a control
        problem get a mesh of their own each
    executor : any Executor of processes in the sense of `concurrent.futures`; default none, one after the other.
        Not of threads: CasADi Functions are not thread-safe

    Returns
    -------
    Sweep

    Raises
    ------
    TypeError, ValueError
        for input that does not fit, before anything is solved.  A variation that cannot be solved raises nothing: its
        ConvergenceError, or whatever its guess raised, is kept in its place

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> fall = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 10 * x[0], (0, 1), start=[0.0], end=[0.0])
    >>> throws = cg.sweep(fall, [{"end": [height]} for height in (1.0, 2.0, 3.0)], cg.Galerkin(degree=2), intervals=4)
    >>> throws.momentum[:, 0, 0].round(6).tolist()
    [6.0, 7.0, 8.0]
    """
    if not isinstance(problem, (BoundaryProblem, ControlProblem)):
        raise TypeError(f"problem must be a BoundaryProblem or a ControlProblem, got {type(problem).__name__}")
    if isinstance(variations, (str, Mapping)) or not isinstance(variations, Iterable):
        raise TypeError(f"variations must be a sequence of dicts, got {variations!r}")
    if isinstance(executor, ThreadPoolExecutor):
        raise TypeError(
            "executor must run processes, got a ThreadPoolExecutor: CasADi Functions are not thread-safe, "
            "use a ProcessPoolExecutor"
        )
    if executor is not None and not isinstance(executor, Executor):
        raise TypeError(
            f"executor must be a concurrent.futures.Executor, such as ProcessPoolExecutor(), got {executor!r}"
        )
    checked = [_checked(problem, i, variation) for i, variation in enumerate(variations)]
    arguments = (problem, method, intervals, tol)
    solver = _solver(*arguments)  # refuses here what would fail in every worker
    answers: Answers = {}
    with tqdm(total=len(checked), unit="solve", disable=None) as bar, suppress(KeyboardInterrupt):
        if executor is None:
            _solve_here(solver, checked, answers, bar)
        else:
            pickled = pickle.dumps(arguments)
            _solve_chunks(solver, executor, pickled, checked, answers, bar)
            _solve_lost(executor, pickled, checked, answers, bar)
    interrupted = "the sweep was interrupted before this variation was solved"
    return Sweep(tuple(answers[i] if i in answers else CutShort(interrupted) for i in range(len(checked))))


def _checked(problem: BoundaryProblem | ControlProblem, number: int, variation: Variation) -> Variation:
    """Check one variation against the problem."""
    if not isinstance(variation, Mapping):
        raise TypeError(f"variation {number} must be a dict of {', '.join(FIELDS)}, got {variation!r}")
    unknown = [key for key in variation if key not in FIELDS]
    if unknown:
        raise ValueError(f"variation {number} has {unknown[0]!r}; what can be varied is {', '.join(FIELDS)}")
    checked = dict(variation)
    try:
        if "t_span" in checked:
            checked["t_span"] = time_span(checked["t_span"])
            if isinstance(problem, BoundaryProblem):
                times_inside("breakpoints", problem.breakpoints, checked["t_span"])
        given = {name: checked[name] for name in VARIED if name in checked}
        varied = problem.varied(given, checked.get("t_span", problem.t_span))
        checked |= {name: getattr(varied, name) for name in given}
    except (TypeError, ValueError) as error:
        raise type(error)(f"variation {number}: {error}") from None
    return checked


class Neighbours:
    """What solves variations of a boundary problem to a tolerance, each from the nearest that is solved.

    A variation with a guess of its own is solved from that, on the mesh of its neighbour.
    """

    def __init__(self, problem: BoundaryProblem, method: Galerkin | None, intervals: int | None, tol: float) -> None:
        self._problem, self._transcription = problem, transcribe(problem, method, intervals, tol=tol)

    def varied(self, variation: Variation) -> BoundaryProblem:
        """The problem of a variation."""
        given = {name: value for name, value in variation.items() if name in VARIED}
        return self._problem.varied(given, variation.get("t_span", self._problem.t_span))

    def solve(self, variation: Variation, known: Sequence[Known]) -> Trajectory:
        """Solve from the nearest known path; where that leads to none, from the straight line."""
        problem = self.varied(variation)
        if not known:
            return self._transcription.found(problem, variation.get("guess"), None)
        values = np.array([values_of(problem), *(place for place, _ in known)])
        near, guess = known[nearest(values[0], values[1:], np.ptp(values, axis=0))][1], variation.get("guess")
        try:
            return self._transcription.found(problem, near if guess is None else guess, near)
        except ConvergenceError:
            if guess is not None:
                raise
            return self._transcription.found(problem, None, None)


Solve = Callable[[Variation], Trajectory]


def _solver(
    problem: BoundaryProblem | ControlProblem, method: Galerkin | None, intervals: int | None, tol: float | None
) -> Solve | Neighbours:
    """What solves the variations: a graph built once, or with a tolerance a control problem's refinement each."""
    if tol is not None:
        if isinstance(problem, BoundaryProblem):
            return Neighbours(problem, method, intervals, tol)
        first_control_mesh(problem, tol, method, intervals, None)  # refuses here what would fail in every variation

        def refined(variation: Variation) -> Trajectory:
            fields = {name: value for name, value in variation.items() if name in VARIED}
            varied = problem.varied(fields, variation.get("t_span", problem.t_span))
            return solve(varied, method, intervals, tol=tol, guess=variation.get("guess"))

        return refined
    if method is None or intervals is None:
        raise ValueError(f"give a method and intervals, or tol, got method={method!r} and intervals={intervals!r}")
    transcription = transcribe(problem, method, intervals)
    breakpoints = problem.breakpoints if isinstance(problem, BoundaryProblem) else ()

    def solved(variation: Variation) -> Trajectory:
        given = dict(variation)
        span = given.pop("t_span", None)
        return transcription.solve(**given, mesh=None if span is None else mesh_of(span, intervals, None, breakpoints))

    return solved


def _answer(solver: Solve, variation: Variation) -> Answer:
    try:
        return solver(variation)
    except Exception as error:  # a guess may raise anything
        error.__cause__ = error.__context__ = None  # their frames, like those of the error, would keep arrays alive
        return error.with_traceback(None)


def _answers(solver: Solve | Neighbours, variations: Sequence[Variation], known: Sequence[Known]) -> Iterator[Answer]:
    """Answers one after the other; with a tolerance each may start from those before and from paths that are known."""
    paths = list(known)
    for variation in variations:
        if isinstance(solver, Neighbours):
            answer = _answer(partial(solver.solve, known=paths), variation)
            paths += _known(answer)
            yield answer
        else:
            yield _answer(solver, variation)


def _known(answer: Answer | None) -> list[Known]:
    """What other variations may start from."""
    if not isinstance(answer, Trajectory) or not isinstance(answer.problem, BoundaryProblem):
        return []
    return [(values_of(answer.problem), answer)]


def _named(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"


def _sendable(answer: Answer) -> Answer:
    """The answer, or an exception with the same words if it cannot be pickled, which would take others with it."""
    if isinstance(answer, Exception):
        try:
            pickle.loads(pickle.dumps(answer))
        except Exception:  # pickling runs the exception's own code, too
            return RuntimeError(_named(answer))
    return answer


@lru_cache(1)
def _unpickled(pickled: bytes) -> Solve | Neighbours:
    """A worker's own solver, kept from chunk to chunk."""
    return _solver(*pickle.loads(pickled))


def _chunk(pickled: bytes, variations: Sequence[Variation], known: Sequence[Known] = ()) -> list[Answer]:
    """What a worker does."""
    with _one_at_a_time:
        return [_sendable(answer) for answer in _answers(_unpickled(pickled), variations, known)]


def _alone(pickled: bytes, variations: Sequence[Variation], number: int) -> list[Answer]:  # noqa: ARG001
    """What a worker does again; another call than the one that failed, whose failure Dask would otherwise repeat."""
    return _chunk(pickled, variations)


@dataclass(frozen=True)
class Chunk:
    """Numbers of variations that are solved one after the other, and paths that they may start from."""

    numbers: Sequence[int]
    known: Sequence[Known] = ()


def _chunks(count: int) -> list[Chunk]:
    """Chunks in the order given."""
    size = min(LARGEST_CHUNK, -(-count // CHUNKS) or 1)
    return [Chunk(range(first, min(first + size, count))) for first in range(0, count, size)]


def _neighbourhoods(
    solver: Neighbours,
    variations: Sequence[Variation],
    answers: Answers,
    bar: tqdm[Any],
    solved: Callable[[Sequence[Variation], Sequence[Known]], list[Answer]],
) -> list[Chunk]:
    """Chunks of variations that are near one another, each about one that is solved first, those farther off later.

    The first ones are solved here, the nearest to one that is solved before the others.  Chunks are the same whoever
    solves them, so that the answers are, too.
    """
    count = len(variations)
    size = min(LARGEST_CHUNK, max(SMALLEST_NEIGHBOURHOOD, -(-count // CHUNKS)))
    values = np.array([values_of(solver.varied(variation)) for variation in variations])
    scaled = values / [spread if spread > 0 else 1.0 for spread in np.ptp(values, axis=0)] if count else values
    centres = np.arange(0, count, size)
    apart = np.array([np.sum((scaled - scaled[centre]) ** 2, axis=1) for centre in centres]).reshape(-1, count)
    waiting = np.where(centres == 0, 0.0, np.inf)  # distances from what is solved; NaN for what is
    begins: dict[int, list[Known]] = {}
    for _ in centres:
        i = int(np.nanargmin(waiting))
        first = int(centres[i])
        order = sorted(begins, key=lambda k: float(apart[k, first]))
        near = next((begins[k] for k in order if begins[k]), [])
        with suppress(Exception):  # of a worker; it is solved again with what is lost
            (answers[first],) = solved([variations[first]], near)
        begins[i] = _known(answers.get(first))
        waiting = np.minimum(waiting, apart[i, centres])
        waiting[i] = np.nan
        bar.update()
    belongs = np.argmin(apart, axis=0)
    chunks = []
    for i, begin in begins.items():
        own = np.flatnonzero(belongs == i)
        own = own[np.argsort(apart[i, own], kind="stable")]
        chunks.append(Chunk([k for k in own.tolist() if k != centres[i]], begin))
    return chunks


def _solve_here(solver: Solve | Neighbours, variations: Sequence[Variation], answers: Answers, bar: tqdm[Any]) -> None:
    """Solve all in this process."""
    chunks = [Chunk(range(len(variations)))]
    if isinstance(solver, Neighbours):
        chunks = _neighbourhoods(solver, variations, answers, bar, lambda *given: list(_answers(solver, *given)))
    for chunk in chunks:
        some = [variations[i] for i in chunk.numbers]
        for i, answer in zip(chunk.numbers, _answers(solver, some, chunk.known), strict=True):
            answers[i] = answer
            bar.update()


def _solve_chunks(
    solver: Solve | Neighbours,
    executor: Executor,
    pickled: bytes,
    variations: Sequence[Variation],
    answers: Answers,
    bar: tqdm[Any],
) -> None:
    """Solve all chunks; those of a worker that fails are left out."""

    def submitted(some: Sequence[Variation], known: Sequence[Known]) -> Future[list[Answer]]:
        return executor.submit(_chunk, pickled, some, known)

    chunks = _chunks(len(variations))
    if isinstance(solver, Neighbours):
        chunks = _neighbourhoods(solver, variations, answers, bar, lambda *given: submitted(*given).result())
    futures: dict[Future[list[Answer]], Sequence[int]] = {}
    try:
        for chunk in chunks:
            try:
                futures[submitted([variations[i] for i in chunk.numbers], chunk.known)] = chunk.numbers
            except Exception:
                if not futures:
                    raise  # it has never worked
                break  # a worker has failed meanwhile
        for future in as_completed(futures):
            with suppress(Exception):
                bar.update(len(future.result()))
    finally:  # also after an interrupt, be it here or in a worker
        for future, numbers in futures.items():
            if not future.cancel() and future.done() and future.exception() is None:
                answers.update(zip(numbers, future.result(), strict=True))


def _solve_lost(
    executor: Executor, pickled: bytes, variations: Sequence[Variation], answers: Answers, bar: tqdm[Any]
) -> None:
    """Solve what has no answer yet, each alone, so that a worker that fails tells which variation it fails of."""
    lost = [i for i in range(len(variations)) if i not in answers]
    with ExitStack() as own:
        for i in lost:
            try:
                executor = _working(executor, pickled, own)
            except Exception as error:
                answers.update((j, CutShort(f"no worker works, {_named(error)}")) for j in lost if j not in answers)
                break
            try:
                (answers[i],) = executor.submit(_alone, pickled, [variations[i]], i).result()
            except Exception as error:
                answers[i] = CutShort(f"the worker that solved this variation failed, {_named(error)}")
            bar.update()


def _working(executor: Executor, pickled: bytes, own: ExitStack) -> Executor:
    """The executor if it still works, else a process of our own."""
    try:
        executor.submit(_chunk, pickled, []).result()
    except Exception:
        executor = own.enter_context(ProcessPoolExecutor(1, getattr(executor, "_mp_context", None)))
        executor.submit(_chunk, pickled, []).result()
    return executor
