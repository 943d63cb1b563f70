"""Speed against accuracy, measured on the user's own problem: every method on every number of intervals.

Every cell is built once and solved repeatedly; its time is the median of the warm solves.  Errors are differences to
a reference, which is given or solved for (`accuracy`).
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from casadi_galerkin.accuracy import ROUNDOFF, Problem, Reference, Yardstick, check_reference, finer
from casadi_galerkin.boundary import transcribe
from casadi_galerkin.calculus import DiscreteCalculus, Galerkin
from casadi_galerkin.control_problem import ControlProblem
from casadi_galerkin.guesses import Guess, check_types, given_values, mesh_of
from casadi_galerkin.plotting import plot_work_precision
from casadi_galerkin.problems import BoundaryProblem, InitialProblem
from casadi_galerkin.solve import solve
from casadi_galerkin.trajectory import ConvergenceError, Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

REPEATS, LEAST, LONG = 7, 2, 2.0  # warm solves whose median counts; the least of them, where they take so many seconds
PLATEAU = 30.0  # errors below so many times the floor take no part in the fit of an order


@dataclass(frozen=True)
class Row:
    """One cell of a trade: a method on so many intervals, its cost and its errors.

    Attributes
    ----------
    method, intervals : as `solve` takes them
    unknowns : node values and controls solved for
    build_seconds, solve_seconds : the first building, and the median of repeated warm solves
    iterations : of the solver
    error : largest error of the path, at the joints and between them, relative to the size of each component
    joint_error : the same at the joints
    action_error : of the action, relative to ∫ |L| dt
    energy_error : largest error of the energy at the joints, relative to the largest of its terms |p·v| + |L|
    failure : why there is no answer; the numbers above are then NaN or 0.  None if there is one
    """

    method: Galerkin
    intervals: int
    unknowns: int = 0
    build_seconds: float = np.nan
    solve_seconds: float = np.nan
    iterations: int = 0
    error: float = np.nan
    joint_error: float = np.nan
    action_error: float = np.nan
    energy_error: float = np.nan
    failure: str | None = None


@dataclass(frozen=True)
class Trade:
    """Speed against accuracy of one problem.

    Attributes
    ----------
    rows : all cells, methods slowest
    reference : what the errors are differences to
    reference_error : its own estimated relative error; 0 where it was given
    """

    rows: tuple[Row, ...]
    reference: str
    reference_error: float

    def front(self) -> list[Row]:
        """Rows that no other row beats in both time and error (the Pareto set), fastest first."""
        chosen: list[Row] = []
        for row in sorted(self._solved(), key=lambda row: (row.solve_seconds, row.error)):
            if not chosen or row.error < chosen[-1].error:
                chosen.append(row)
        return chosen

    def cheapest(self, tol: float) -> Row:
        """Fastest row whose error, with that of the reference, is at most `tol`; ValueError if there is none."""
        good = [row for row in self._solved() if row.error + self.reference_error <= tol]
        if good:
            return min(good, key=lambda row: row.solve_seconds)
        best = min((row.error for row in self._solved()), default=np.nan)
        raise ValueError(
            f"no row has an error of at most {tol:g}: the least is {best:.1e}, the reference's own "
            f"{self.reference_error:.1e}. Trade with more intervals or higher degrees"
        )

    def order(self, method: Galerkin) -> float | None:
        """Order of the error in 1/N, fitted to the rows of a method above roundoff; None with fewer than 3."""
        rows = [row for row in self._solved() if row.method == method and row.error > PLATEAU * self.floor]
        if len({row.intervals for row in rows}) < 3:
            return None
        logs = np.log([[row.intervals, row.error] for row in rows])
        return float(-np.polyfit(logs[:, 0], logs[:, 1], 1)[0])

    @property
    def floor(self) -> float:
        """Error below which rows cannot be told apart: roundoff, or the reference's own error."""
        return max(self.reference_error, ROUNDOFF)

    def _solved(self) -> list[Row]:
        return [row for row in self.rows if row.failure is None]

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw errors over seconds, a line a method, with fitted orders and the floor; returns the Matplotlib axes."""
        lines = []
        for method in dict.fromkeys(row.method for row in self._solved()):
            rows, order = [row for row in self._solved() if row.method == method], self.order(method)
            label = str(method) if order is None else f"{method}: error ~ N^-{order:.1f}"
            lines.append((label, [row.solve_seconds for row in rows], [row.error for row in rows]))
        return plot_work_precision(lines, self.floor, axes)

    def to_csv(self, path: str | Path) -> None:
        """Write all rows to a file of comma-separated values, the method in words and by its degree."""
        names = [entry.name for entry in fields(Row)]
        with Path(path).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["degree", *names])
            writer.writerows([row.method.degree, *(getattr(row, name) for name in names)] for row in self.rows)

    def __str__(self) -> str:
        """Readable table; the front is marked with a star."""
        front = self.front()
        width = max(len(str(row.method)) for row in self.rows)
        heads = [
            "intervals",
            "unknowns",
            "build/ms",
            "solve/ms",
            "iterations",
            "error",
            "at-joints",
            "action",
            "energy",
        ]
        lines = [f"  {'method':{width}}" + "".join(f"{head:>11}" for head in heads)]
        for row in self.rows:
            line = f"{'*' if row in front else ' '} {row.method!s:{width}}{row.intervals:11d}"
            if row.failure is not None:
                lines.append(f"{line}  failed: {row.failure}")
                continue
            seconds = "".join(f"{1e3 * value:11.3f}" for value in (row.build_seconds, row.solve_seconds))
            errors = (row.error, row.joint_error, row.action_error, row.energy_error)
            numbers = f"{row.unknowns:11d}{seconds}{row.iterations:11d}" + "".join(f"{e:11.1e}" for e in errors)
            lines.append(line + numbers)
        return "\n".join([*lines, f"reference: {self.reference}", "*: no other row is both faster and more accurate"])


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
    return path.path.values.size - fixed - periodic + controls


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
            _check_guess(guess, DiscreteCalculus(method, mesh), problem.dimension)
    return keys


def _check_guess(guess: Guess, calculus: DiscreteCalculus, dimension: int) -> None:
    values = given_values(guess, calculus, dimension)
    finite = np.isfinite(values).all(axis=0)
    if not finite.all():
        i = int(np.argmin(finite))
        raise ValueError(f"the guess must be finite, got {values[:, i]} at t = {calculus.node_times[i]}")


def _first(problem: Problem, method: Galerkin, intervals: int, guess: Guess | None) -> _Cell:
    """Build and solve a cell for the first time."""
    try:
        run = _runner(problem, method, intervals, guess)
        return _Cell(run, run())
    except (ConvergenceError, ValueError) as failure:
        return _Cell(failure=str(failure))


def _measured(problem: Problem, method: Galerkin, intervals: int, cell: _Cell, truth: Yardstick) -> Row:
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
        if no cell was solved, or no finer solve was found to measure against
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
        raise ConvergenceError(f"no cell of the trade was solved; the first: {cells[0].failure}")
    described, own = "given", 0.0
    if reference is None:
        reference, own = finer(problem, paths, guess)
        described = f"{reference.method} on {len(reference.t) - 1} intervals, own error {own:.1e}"
    truth = Yardstick(problem, reference, paths[0].parameters)
    rows = [_measured(problem, *key, cell, truth) for key, cell in zip(keys, cells, strict=True)]
    return Trade(tuple(rows), described, own)
