"""What a trade of speed against accuracy has measured: its table, what is best in it, and its picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np

from casadi_galerkin._solve import solve
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.numbers import counted, finite
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.initial_problem import InitialProblem
from casadi_galerkin.problems.problem import check_kind, map_times
from casadi_galerkin.solution.export import Table
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solution.plotting import COLORS, Pictured, axes_or_new, legend_below
from casadi_galerkin.solution.quantity import Quantity
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.solvers.solver import Solver
from casadi_galerkin.stepping.shooting import shoot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AnyProblem: TypeAlias = BoundaryProblem | InitialProblem | ControlProblem
LEAST_ERROR = 64 * EPS  # errors below cannot be told from rounding


@dataclass(frozen=True, repr=False, eq=False)
class Row:
    """One way to solve a problem, which can be taken again, with its cost in time and its errors.

    Attributes
    ----------
    method, intervals : as `solve` takes them, or as a tolerance has found them; None where it has found none
    solver : as `solve` takes it; None where a path is found step by step
    tol : the tolerance; None of a fixed discretization
    of : the quantity that it is the tolerance of; None of the path
    mesh : (N + 1,), joints that were found for `tol`, taken as a fixed mesh; None of all other rows
    shooting : whether the path is found by `shoot`
    unknowns : node values and controls solved for
    first_seconds : of a first call with a problem, which builds everything but the patterns that another problem with
        the same method on as many intervals has left
    solve_seconds : of a repeated solve, with its graph of all intervals or of a step built; to a tolerance, where each
        level builds its own, of a repeated call
    iterations : of the solver
    error : of the quantity that the trade measures, and where none is named, of the path
    path_error : largest error of the path, at the joints and between them, relative to the size of each component
    joint_error : the same at the joints
    failure : why there is no answer; the numbers above are then NaN or 0.  None if there is one

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> oscillator = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), start=[0.0], end=[1.0])
    >>> (row,) = cg.trade(oscillator, [cg.Galerkin(6)], [4]).rows
    >>> row.way, row.intervals, row.unknowns, row.error < 1e-9, row.failure
    ('newton', 4, 23, True, None)
    >>> row.solve(oscillator.varied({"end": [2.0]}))(1.0).tolist()
    [2.0]
    """

    method: Galerkin | None = None
    intervals: int | None = None
    solver: Solver | None = None
    tol: float | None = None
    of: Quantity | None = None
    mesh: tuple[float, ...] | None = None
    shooting: bool = False
    unknowns: int = 0
    first_seconds: float = np.nan
    solve_seconds: float = np.nan
    iterations: int = 0
    error: float = np.nan
    path_error: float = np.nan
    joint_error: float = np.nan
    failure: str | None = None

    def solve(self, problem: AnyProblem, guess: Guess | None = None) -> Trajectory:
        """Solve a problem in this way, the one that was traded or another; arguments and errors as for `solve`.

        By shooting, `guess` is a Trajectory.  A mesh that was found for a tolerance is stretched to the time span.
        """
        if self.shooting:
            given = cast(BoundaryProblem, problem), cast(Galerkin, self.method), self.intervals  # which `shoot` checks
            return shoot(*given, guess=cast(Trajectory | None, guess))
        if self.mesh is None:
            method, intervals = (None, None) if self.adaptive else (self.method, self.intervals)
            return solve(problem, method, intervals, tol=self.tol, of=self.of, guess=guess, solver=self.solver)
        check_kind(problem, BoundaryProblem, InitialProblem, ControlProblem)
        mesh = map_times(np.array(self.mesh), [self.mesh[0], self.mesh[-1]], problem.t_span)
        return solve(problem, self.method, mesh=mesh, guess=guess, solver=self.solver)

    @property
    def adaptive(self) -> bool:
        """Whether mesh and degree are found for a tolerance."""
        return self.tol is not None and self.mesh is None

    @property
    def way(self) -> str:
        """The way in words, without method and intervals."""
        name = "steps" if self.solver is None else repr(self.solver).removeprefix("cg.")
        if self.shooting:
            return "shooting"
        if self.tol is None:
            return name
        of = "" if self.of is None else f" of {name_of(self.of)}"
        return f"{name}, {'tol' if self.adaptive else 'mesh of'} {self.tol:g}{of}"

    def __repr__(self) -> str:
        """The way, what it misses and what it takes, in one line."""
        by = f"Row of {self.way}" + (f": {self.method} on {self.intervals} intervals" if self.method else "")
        if self.failure is not None:
            return f"{by}: {_reason(self.failure)}"
        times = f"{1e3 * self.first_seconds:.3g} ms the first time, {1e3 * self.solve_seconds:.3g} ms again"
        return f"{by}: error {self.error:.1e}, {times}"


@dataclass(frozen=True, repr=False, eq=False)
class Trade(Table, Pictured):
    """Speed against accuracy of one problem.

    Attributes
    ----------
    rows : one for each way, in the order in which they were asked for
    reference : what the errors are differences to
    reference_error : its own estimated error, below which those of rows mean nothing; 0 where none is known
    quantity : name of what `Row.error` is the error of; None where it is the path

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
    reference_error: float = 0.0
    quantity: str | None = None

    def front(self) -> list[Row]:
        """Rows that no other row beats in both time of a repeated solve and error (the Pareto set), fastest first.

        Errors that differ by less than `floor` are equal.
        """
        chosen: list[Row] = []
        for row in sorted(self._solved(), key=lambda row: (row.solve_seconds, row.error)):
            if not chosen or row.error < chosen[-1].error - self.floor:
                chosen.append(row)
        return chosen

    def cheapest(self, tol: float) -> Row:
        """Row of the fastest repeated solve whose error, with that of the reference, is at most `tol`.

        Raises
        ------
        ValueError
            if there is none
        """
        most = finite("tol", tol)
        good = [row for row in self._solved() if row.error + self.reference_error <= most]
        if good:
            return min(good, key=lambda row: row.solve_seconds)
        best = min((row.error for row in self._solved()), default=np.nan)
        raise ValueError(
            f"no row has an error of at most {tol:g}: the least is {best:.1e}, the reference's own "
            f"{self.reference_error:.1e}. Trade with more intervals or higher degrees, or against a finer `reference`"
        )

    def order(self, method: Galerkin) -> float | None:
        """Order of the error in 1/N, the median from row to row of a method above the floor; None with fewer than 3.

        Rows to a tolerance, whose mesh is another, and of shooting, which loses digits, take no part.
        """
        fixed = [row for row in self._solved() if row.method == method and row.tol is None and not row.shooting]
        errors = sorted({row.intervals or 0: row.error for row in fixed if row.error > self.floor}.items())
        if len(errors) < 3:
            return None
        steps = np.diff(np.log(errors), axis=0)
        return float(np.median(-steps[:, 1] / steps[:, 0]))

    @property
    def floor(self) -> float:
        """Error below which rows cannot be told apart: roundoff, or the reference's own error."""
        return max(self.reference_error, LEAST_ERROR)

    def _solved(self) -> list[Row]:
        return [row for row in self.rows if row.failure is None]

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw errors over the times of repeated solves, and the floor below which errors mean nothing.

        A line joins the rows of one method and way: its color is the degree, its dots say how it is solved.  The broad
        line is the front.  Returns Matplotlib's axes.
        """
        axes = axes_or_new(axes)

        def draw(rows: Sequence[Row], **looks: Any) -> None:
            """An error of zero has no place on a logarithmic axis."""
            errors = [max(row.error, self.floor / 3) for row in rows]
            axes.loglog([1e3 * row.solve_seconds for row in rows], errors, **looks)

        draw(self.front(), label="the front", color="0.85", linewidth=7, zorder=0)
        axes.axhspan(self.floor / 10, self.floor, color="0.93", zorder=-1, label="rounding, or the reference's error")
        lines: dict[tuple[Galerkin | None, str, str], list[Row]] = {}
        for row in self._solved():
            kind = "to a tolerance" if row.adaptive else "on its mesh"  # each tolerance finds a degree of its own
            method = row.method if row.tol is None else None
            color = kind if method is None else f"degree {method.degree}"
            lines.setdefault((method, color, replace(row, tol=None).way), []).append(row)
        colors, dots = (list(dict.fromkeys(names[k] for names in lines)) for k in (1, 2))
        for (_, color, way), rows in lines.items():
            looks = {"color": COLORS[colors.index(color) % len(COLORS)], "marker": "os^DvP*"[dots.index(way) % 7]}
            draw(rows, label=f"{color}, {way}", markersize=4, linewidth=1, **looks)
        label = f"relative error of {self.quantity or 'the path'}"
        axes.set(xlabel="milliseconds of a repeated solve", ylabel=label)
        legend_below(axes, ncols=3)
        return axes

    def table(self) -> dict[str, np.ndarray]:
        """All rows by the names of their fields, way and method in words; what a row has not is NaN, 0 or empty."""
        names = [entry.name for entry in fields(Row) if entry.type in ("int", "float")]
        return {
            "way": np.array([row.way for row in self.rows]),
            "method": np.array([str(row.method or "") for row in self.rows]),
            "degree": np.array([row.method.degree if row.method else 0 for row in self.rows]),
            "intervals": np.array([row.intervals or 0 for row in self.rows]),
            "tol": np.array([np.nan if row.tol is None else row.tol for row in self.rows]),
            **{name: np.array([getattr(row, name) for row in self.rows]) for name in names},
            "failure": np.array([row.failure or "" for row in self.rows]),
        }

    def __repr__(self) -> str:
        """Say how much was measured; ``print`` shows the table."""
        ways = counted(len({row.way for row in self.rows}), "way")
        return f"Trade of {counted(len(self.rows), 'row')}, {ways} to solve; reference: {self.reference}"

    def __str__(self) -> str:
        """Readable table; the front is marked with a star."""
        front, named = self.front(), self.quantity is not None
        heads = "*,method,intervals,solved by,unknowns,first/ms,solve/ms,iterations,path,at joints"
        table = [(heads + named * ",error").split(","), *(_cells(row, row in front, named) for row in self.rows)]
        widths = [max(len(cells[k]) for cells in table if len(cells) == len(table[0])) for k in range(len(table[0]))]
        lines = ["  ".join(map(str.ljust, cells, widths)).rstrip() for cells in table]
        lines += [f"reference: {self.reference}", "*: no other row is both faster when repeated and more accurate"]
        if named:
            lines.insert(-1, f"error: of {self.quantity}")
        return "\n".join(lines)


def name_of(of: Quantity) -> str:
    """Name of a function; of a lambda, which has none, "it"."""
    name = getattr(of, "__name__", "")
    return name if name.isidentifier() else "it"


def _cells(row: Row, best: bool, named: bool) -> list[str]:
    """A row in a table: what it is, and what it has measured, or why it has not."""
    how = ["*" if best else "", str(row.method or ""), str(row.intervals or ""), row.way]
    if row.failure is not None:
        return [*how, f"failed: {_reason(row.failure)}"]
    seconds = [f"{1e3 * value:.3f}" for value in (row.first_seconds, row.solve_seconds)]
    errors = [row.path_error, row.joint_error, *([row.error] if named else [])]
    return [*how, str(row.unknowns), *seconds, str(row.iterations), *(f"{value:.1e}" for value in errors)]


def _reason(failure: str) -> str:
    """The first clause of a message."""
    return failure.partition(". ")[0].partition(": ")[0]
