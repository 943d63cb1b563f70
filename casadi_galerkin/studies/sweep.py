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
from functools import lru_cache
from typing import Any

import numpy as np
from tqdm import tqdm

from casadi_galerkin._solve import solve, transcribe
from casadi_galerkin.boundary.refinement import first_mesh
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
_one_at_a_time = threading.Lock()  # a worker of a cluster may run several chunks in threads of one process

Variation = Mapping[str, Any]
Answer = Trajectory | Exception
Answers = dict[int, Answer]  # by the number of the variation


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
        """Summarise the sweep, with the reason of the first failure."""
        failures = self.failures
        text = f"Sweep of {len(self)} variation{'s' * (len(self) != 1)}, {len(self) - len(failures)} solved"
        cut_short = sum(isinstance(error, CutShort) for error in failures.values())
        if cut_short:
            text += f", {cut_short} cut short"
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
    method, intervals, tol : as for `solve`; with `tol`, every variation gets a mesh of its own
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
            for i, variation in enumerate(checked):
                answers[i] = _answer(solver, variation)
                bar.update()
        else:
            pickled = pickle.dumps(arguments)
            _solve_chunks(executor, pickled, checked, answers, bar)
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


def _solver(
    problem: BoundaryProblem | ControlProblem, method: Galerkin | None, intervals: int | None, tol: float | None
) -> Callable[[Variation], Trajectory]:
    """What solves one variation: a graph built once, or with a tolerance one refinement each."""
    if tol is not None:
        if isinstance(problem, ControlProblem):  # refuses here what would fail in every variation
            first_control_mesh(problem, tol, method, intervals, None)
        else:
            first_mesh(problem, tol, method, intervals, None)

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


def _answer(solver: Callable[[Variation], Trajectory], variation: Variation) -> Answer:
    try:
        return solver(variation)
    except Exception as error:  # a guess may raise anything
        error.__cause__ = error.__context__ = None  # their frames, like those of the error, would keep arrays alive
        return error.with_traceback(None)


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
def _unpickled(pickled: bytes) -> Callable[[Variation], Trajectory]:
    """A worker's own solver, kept from chunk to chunk."""
    return _solver(*pickle.loads(pickled))


def _chunk(pickled: bytes, variations: Sequence[Variation]) -> list[Answer]:
    """What a worker does."""
    with _one_at_a_time:
        solver = _unpickled(pickled)
        return [_sendable(_answer(solver, variation)) for variation in variations]


def _alone(pickled: bytes, variations: Sequence[Variation], number: int) -> list[Answer]:  # noqa: ARG001
    """What a worker does again; another call than the one that failed, whose failure Dask would otherwise repeat."""
    return _chunk(pickled, variations)


def _solve_chunks(
    executor: Executor, pickled: bytes, variations: Sequence[Variation], answers: Answers, bar: tqdm[Any]
) -> None:
    """Solve all chunks; those of a worker that fails are left out."""
    size = min(LARGEST_CHUNK, -(-len(variations) // CHUNKS) or 1)
    futures: dict[Future[list[Answer]], int] = {}
    try:
        for first in range(0, len(variations), size):
            try:
                futures[executor.submit(_chunk, pickled, variations[first : first + size])] = first
            except Exception:
                if not futures:
                    raise  # it has never worked
                break  # a worker has failed meanwhile
        for future in as_completed(futures):
            with suppress(Exception):
                bar.update(len(future.result()))
    finally:  # also after an interrupt, be it here or in a worker
        for future, first in futures.items():
            if not future.cancel() and future.done() and future.exception() is None:
                answers.update(enumerate(future.result(), first))


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
