"""Speed against accuracy, measured on the user's own problem: every method on every number of intervals.

Every cell is built once and solved repeatedly; its time is the median of the warm solves.  Errors are differences to
a reference, which is given or solved for (`reference`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from statistics import median

from tqdm import tqdm

from casadi_galerkin._solve import solve, transcribe
from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus, mesh_of
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.initial_problem import InitialProblem
from casadi_galerkin.problems.problem import check_types
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.guess import Guess, guess_values
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.studies.reference import Problem, Reference, ReferenceSolution, check_reference, finer
from casadi_galerkin.studies.trade_table import Row, Trade

REPEATS, LEAST, LONG = 7, 2, 2.0  # warm solves whose median counts; the least of them, where they take so many seconds


def _runner(problem: Problem, method: Galerkin, intervals: int, guess: Guess | None) -> Callable[[], Trajectory]:
    """A solve that can be repeated; the graph of a boundary problem is built once."""
    if isinstance(problem, BoundaryProblem):
        return partial(transcribe(problem, method, intervals).solve, guess=guess)
    return partial(solve, problem, method, intervals, guess=guess)


def _unknowns(problem: Problem, path: Trajectory) -> int:
    """Node values and controls that were solved for."""
    ends = [getattr(problem, name, None) or () for name in ("start", "end", "position")]
    fixed = sum(value is not None for end in ends for value in end)
    periodic = path.x.shape[0] if getattr(problem, "periodic", False) else 0
    controls = path.control.values.size if hasattr(path, "control") else 0
    return path.polynomial.values.size - fixed - periodic + controls


@dataclass
class _Cell:
    """One cell while it is measured: how to solve it again, its first answer or failure, seconds of the others."""

    run: Callable[[], Trajectory] | None = None
    path: Trajectory | None = None
    failure: str | None = None
    seconds: list[float] = field(default_factory=list)

    def repeat(self) -> None:
        if self.run is not None and (len(self.seconds) < LEAST or sum(self.seconds) < LONG):
            self.seconds.append(self.run().solve_seconds)


def _check(
    problem: Problem, methods: Sequence[Galerkin], counts: Sequence[int], guess: Guess | None
) -> list[tuple[Galerkin, int]]:
    """All cells; refuses what would fail in each of them, or in the reference."""
    if not methods or not counts:
        raise ValueError(f"give at least one method and one number of intervals, got {methods} and {counts}")
    if guess is not None:
        if isinstance(problem, InitialProblem):
            raise ValueError("an initial problem takes no guess: it is solved step by step")
        if not isinstance(guess, Trajectory) and not callable(guess):
            raise TypeError(f"the guess of a trade must fit every mesh: a callable or a Trajectory, got {guess!r}")
    keys = [(method, count) for method in methods for count in counts]
    for method, count in keys:
        check_types(problem, method, BoundaryProblem, InitialProblem, ControlProblem)
        mesh = mesh_of(problem.t_span, count, None)
        if guess is not None:
            guess_values(guess, DiscreteCalculus(method, mesh), problem.dimension)
    return keys


def _first(problem: Problem, method: Galerkin, intervals: int, guess: Guess | None) -> _Cell:
    """Build and solve a cell for the first time."""
    try:
        run = _runner(problem, method, intervals, guess)
        return _Cell(run, run())
    except (ConvergenceError, ValueError) as failure:
        return _Cell(failure=str(failure))


def _measured(problem: Problem, method: Galerkin, intervals: int, cell: _Cell, truth: ReferenceSolution) -> Row:
    path = cell.path
    if path is None:
        return Row(method, intervals, failure=cell.failure)
    count, seconds, errors = _unknowns(problem, path), median(cell.seconds), truth.errors(path)
    return Row(method, intervals, count, path.build_seconds, seconds, path.iterations, *errors)


def trade(
    problem: Problem,
    methods: Iterable[Galerkin],
    intervals: Iterable[int],
    reference: Reference | None = None,
    *,
    guess: Guess | None = None,
) -> Trade:
    """Solve a problem by every method on every number of intervals, and measure time and error of each.

    Parameters
    ----------
    problem : BoundaryProblem, InitialProblem or ControlProblem
    methods : several Galerkin
    intervals : several numbers of equal intervals
    reference : a Trajectory over the same time span, unless the duration is free, or a callable t -> (d,), that errors
        are differences to; default a solve several digits finer, whose own error is estimated and reported
    guess : a callable t -> (d,) or a Trajectory, for all cells and the reference: where several paths join the ends,
        it chooses one

    Raises
    ------
    TypeError, ValueError
        for input that does not fit, before anything is solved
    ConvergenceError
        if no method solved the problem, or no finer solve was found to measure against

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> oscillator = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), start=[0.0], end=[1.0])
    >>> measured = cg.trade(oscillator, [cg.Galerkin(2)], [4, 8, 16])
    >>> round(measured.order(cg.Galerkin(2)), 1)
    3.0
    """
    keys = _check(problem, list(methods), list(intervals), guess)
    if reference is not None:
        check_reference(problem, reference)
    with tqdm(total=(1 + REPEATS) * len(keys), desc="trade", disable=None, leave=False) as bar:
        cells = []
        for method, count in keys:
            cells.append(_first(problem, method, count, guess))
            bar.update()
        for _ in range(REPEATS):  # in turns, so that a busy spell of the machine does not fall on one cell alone
            for cell in cells:
                cell.repeat()
                bar.update()
    paths = [cell.path for cell in cells if cell.path is not None]
    if not paths:
        raise ConvergenceError(f"no method solved the problem on any mesh; the first failure: {cells[0].failure}")
    described, own = "given", getattr(reference, "error_estimate", None) or 0.0
    if own:
        described = f"given, own error {own:.1e}"
    if reference is None:
        reference, own = finer(problem, paths, guess)
        described = f"{reference.method} on {len(reference.t) - 1} intervals, own error {own:.1e}"
    truth = ReferenceSolution(problem, reference, paths[0].parameters)
    rows = [_measured(problem, *key, cell, truth) for key, cell in zip(keys, cells, strict=True)]
    return Trade(tuple(rows), described, own)
