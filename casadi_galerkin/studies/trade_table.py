"""What a trade of speed against accuracy has measured: its table, what is best in it, and its picture."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.solution.export import Table
from casadi_galerkin.solution.plotting import Pictured, plot_work_precision
from casadi_galerkin.studies.reference import ROUNDOFF

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PLATEAU = 30.0  # errors below so many times the floor take no part in the fit of an order


@dataclass(frozen=True)
class Row:
    """One row of a trade: a method on a number of intervals, with its cost and its errors.

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

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> oscillator = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), start=[0.0], end=[1.0])
    >>> (row,) = cg.trade(oscillator, [cg.Galerkin(6)], [4]).rows
    >>> row.intervals, row.unknowns, row.error < 1e-9, row.failure
    (4, 23, True, None)
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


@dataclass(frozen=True, repr=False)
class Trade(Table, Pictured):
    """Speed against accuracy of one problem.

    Attributes
    ----------
    rows : for each method in turn, one row per number of intervals
    reference : what the errors are differences to
    reference_error : its own estimated relative error; 0 where it was given

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> oscillator = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), start=[0.0], end=[1.0])
    >>> measured = cg.trade(oscillator, [cg.Galerkin(2), cg.Galerkin(6)], [4])
    >>> measured.cheapest(1e-9).method
    Galerkin(degree 6, 6 quadrature points of order 12)
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
        """Draw errors over seconds, a line per method, with fitted orders and the floor; returns Matplotlib's axes."""
        lines = []
        for method in dict.fromkeys(row.method for row in self._solved()):
            rows, order = [row for row in self._solved() if row.method == method], self.order(method)
            label = str(method) if order is None else f"{method}: error ~ N^-{order:.1f}"
            lines.append((label, [row.solve_seconds for row in rows], [row.error for row in rows]))
        return plot_work_precision(lines, self.floor, axes)

    def table(self) -> dict[str, np.ndarray]:
        """All rows by the names of their fields, the method in words and by its degree; no failure is an empty word."""
        columns = {entry.name: np.array([getattr(row, entry.name) for row in self.rows]) for entry in fields(Row)[1:-1]}
        return {
            "degree": np.array([row.method.degree for row in self.rows]),
            "method": np.array([str(row.method) for row in self.rows]),
            **columns,
            "failure": np.array([row.failure or "" for row in self.rows]),
        }

    def __repr__(self) -> str:
        """Say how much was measured, and what came out best; ``print`` shows the table."""
        solved, methods = self._solved(), {row.method for row in self.rows}
        text = f"Trade of {len(self.rows)} rows, {len(methods)} method(s); reference: {self.reference}"
        if not solved:
            return text
        best = min(solved, key=lambda row: row.error)
        cost = f"{1e3 * best.solve_seconds:.3g} ms"
        return f"{text}\n  least error {best.error:.1e} in {cost}: {best.method}, {best.intervals} intervals"

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
