"""Many variations of one problem: built once, solved here or by any executor, failures kept beside the answers.

A CasADi Function must not be shared between threads.  So what goes to an executor is pickled: the problem once, and
chunks of variations; each worker process unpickles the problem and builds its graph once, whatever the number of its
chunks.  Nothing here knows whose executor it is: a process pool's, Dask's ``client.get_executor()``, mpi4py's
``MPIPoolExecutor``.
"""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
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
from casadi_galerkin.calculus.numbers import components, numbers, time_span
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.trajectory import Trajectory

FIELDS = ("start", "end", "parameters", "t_span", "guess")
CHUNKS, LARGEST_CHUNK = 64, 50  # enough chunks to keep workers equally busy; few enough that sending costs little
_one_at_a_time = threading.Lock()  # a worker of a cluster may run several chunks in threads of one process

Variation = Mapping[str, Any]
Failure = ConvergenceError | ValueError | TypeError
Answer = Trajectory | Failure


@dataclass(frozen=True, repr=False)
class Sweep:
    """What became of every variation, in the order of the variations.

    Attributes
    ----------
    answers : one for each variation, its Trajectory or the error that says why there is none
    """

    answers: tuple[Answer, ...]

    def __len__(self) -> int:
        return len(self.answers)

    def __getitem__(self, i: int) -> Answer:
        return self.answers[i]

    def __iter__(self) -> Iterator[Answer]:
        return iter(self.answers)

    @property
    def failures(self) -> dict[int, Failure]:
        """Number of the variation -> error, for those without an answer."""
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
        if not failures:
            return text
        first, error = next(iter(failures.items()))
        return f"{text}\n  variation {first} is the first without an answer: {error}"


def sweep(
    problem: BoundaryProblem,
    variations: Sequence[Variation],
    method: Galerkin | None = None,
    intervals: int | None = None,
    *,
    tol: float | None = None,
    executor: Executor | None = None,
) -> Sweep:
    """Solve many variations of one problem; a progress bar is shown in a terminal.

    Parameters
    ----------
    problem : BoundaryProblem
    variations : dicts of what differs from the problem: `start`, `end`, `parameters`, `t_span`; and `guess`, as for
        `solve`, which with a process pool has to be picklable (an array, a Trajectory, a module's function)
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
        ConvergenceError, or the ValueError or TypeError about its guess, is kept in its place

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> fall = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 10 * x[0], (0, 1), start=[0.0], end=[0.0])
    >>> throws = cg.sweep(fall, [{"end": [height]} for height in (1.0, 2.0, 3.0)], cg.Galerkin(degree=2), intervals=4)
    >>> throws.momentum[:, 0, 0].round(6).tolist()
    [6.0, 7.0, 8.0]
    """
    if not isinstance(problem, BoundaryProblem):
        raise TypeError(f"problem must be a BoundaryProblem, got {type(problem).__name__}")
    if isinstance(executor, ThreadPoolExecutor):
        raise TypeError(
            "executor must run processes, got a ThreadPoolExecutor: CasADi Functions are not thread-safe, "
            "use a ProcessPoolExecutor"
        )
    checked = [_checked(problem, i, variation) for i, variation in enumerate(variations)]
    arguments = (problem, method, intervals, tol)
    with tqdm(total=len(checked), unit="solve", disable=None) as bar:
        if executor is None:
            solver = _solver(*arguments)
            answers = []
            for variation in checked:
                answers.append(_answer(solver, variation))
                bar.update()
        else:
            _solver(*arguments)  # refuses here what would fail in every worker
            answers = _gathered(executor, pickle.dumps(arguments), checked, bar)
    return Sweep(tuple(answers))


def _checked(problem: BoundaryProblem, number: int, variation: Variation) -> Variation:
    """Check one variation against the problem."""
    unknown = [key for key in variation if key not in FIELDS]
    if unknown:
        raise ValueError(f"variation {number} has {unknown[0]!r}; what can be varied is {', '.join(FIELDS)}")
    checked = dict(variation)
    try:
        for name in ("start", "end"):
            if name in checked:
                checked[name] = components(name, checked[name], problem.dimension)
                expected = getattr(problem, name)
                if [value is None for value in checked[name]] != [value is None for value in expected]:
                    raise ValueError(f"{name} must have None where the problem has it, {expected}, got {checked[name]}")
        if "t_span" in checked:
            checked["t_span"] = time_span(checked["t_span"])
        if "parameters" in checked:
            if problem.parameters is None:
                raise ValueError(f"the problem has no parameters, got parameters={checked['parameters']!r}")
            checked["parameters"] = numbers("parameters", checked["parameters"], len(problem.parameters))
    except (TypeError, ValueError) as error:
        raise type(error)(f"variation {number}: {error}") from None
    return checked


def _solver(
    problem: BoundaryProblem, method: Galerkin | None, intervals: int | None, tol: float | None
) -> Callable[[Variation], Trajectory]:
    """What solves one variation: a graph built once, or with a tolerance one refinement each."""
    if tol is not None:
        first_mesh(problem, tol, method, intervals, None)  # refuses here what would fail in every variation

        def refined(variation: Variation) -> Trajectory:
            fields = {name: variation.get(name, getattr(problem, name)) for name in FIELDS[:-1]}
            return solve(problem.varied(**fields), method, intervals, tol=tol, guess=variation.get("guess"))

        return refined
    if method is None or intervals is None:
        raise ValueError(f"give a method and intervals, or tol, got method={method!r} and intervals={intervals!r}")
    transcription = transcribe(problem, method, intervals)

    def solved(variation: Variation) -> Trajectory:
        given = dict(variation)
        span = given.pop("t_span", None)
        return transcription.solve(**given, mesh=None if span is None else mesh_of(span, intervals, None))

    return solved


def _answer(solver: Callable[[Variation], Trajectory], variation: Variation) -> Answer:
    try:
        return solver(variation)
    except (ConvergenceError, ValueError, TypeError) as error:
        error.__context__ = None  # its frames, like those of the error, would keep their arrays alive
        return error.with_traceback(None)


@lru_cache(1)
def _unpickled(pickled: bytes) -> Callable[[Variation], Trajectory]:
    """A worker's own solver, kept from chunk to chunk."""
    return _solver(*pickle.loads(pickled))


def _chunk(pickled: bytes, variations: Sequence[Variation]) -> list[Answer]:
    """What a worker does."""
    with _one_at_a_time:
        solver = _unpickled(pickled)
        return [_answer(solver, variation) for variation in variations]


def _gathered(executor: Executor, pickled: bytes, variations: Sequence[Variation], bar: tqdm[Any]) -> list[Answer]:
    """Answers of all chunks, in order."""
    size = min(LARGEST_CHUNK, -(-len(variations) // CHUNKS) or 1)
    chunks = [variations[i : i + size] for i in range(0, len(variations), size)]
    futures: list[Future[list[Answer]]] = [executor.submit(_chunk, pickled, chunk) for chunk in chunks]
    try:
        for future in as_completed(futures):
            bar.update(len(future.result()))
    finally:
        for future in futures:
            future.cancel()  # of use only when a chunk has raised
    return [answer for future in futures for answer in future.result()]
