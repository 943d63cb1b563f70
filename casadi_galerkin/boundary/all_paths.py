"""The function `paths`: all stationary paths that a search finds, on one mesh or to a tolerance, in a `Paths`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count as counting
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.boundary.boundary_refinement import BoundaryRefinement, first_discretization
from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.several_paths import (
    RESOLVED_BY,
    SAME_PATH,
    SEED,
    SOLVES_WITHOUT_A_PATH,
    Search,
    Symmetry,
    image,
    resolved,
)
from casadi_galerkin.boundary.transcription import GraphCache, Transcription, transcribed
from casadi_galerkin.calculus.galerkin import Galerkin, check_method
from casadi_galerkin.calculus.mesh_adaptation import resized_mesh
from casadi_galerkin.calculus.numbers import counted, number, whole_number
from casadi_galerkin.functional.buffers import interrupts_raised
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.callables import with_parameters
from casadi_galerkin.problems.problem import check_kind
from casadi_galerkin.solution.errors import ConvergenceError, Limits, check_tolerance
from casadi_galerkin.solution.guess import refuse_free_phase
from casadi_galerkin.solution.path import plot_component
from casadi_galerkin.solution.plotting import Pictured
from casadi_galerkin.solution.quantity import Quantity, check_asked
from casadi_galerkin.solution.trajectory import Trajectory, index_in_words
from casadi_galerkin.solvers.solver import newton

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PATHS_SHOWN = 6  # paths in a repr
# factor on the intervals with which a refinement begins, for a search: with one, zigzags took the time
SEARCH_INTERVALS_FACTOR = 2
CANDIDATE_LIMITS = Limits(
    intervals=500, seconds=20.0
)  # of the refinement of one critical point, most of which end far below


@dataclass(frozen=True, repr=False, eq=False)
class Paths(Pictured):
    """Stationary paths of one problem in the order of their action.

    Attributes
    ----------
    trajectories : all different, each with its `action`, `morse_index` and `error_estimate`; `solver` says how it was
        found
    solves : how often Newton's method was begun from a guess, or a curve of paths followed
    unresolved : critical points of the discrete action that were dropped, because the mesh does not resolve them
    singular : critical points that were dropped, because the Hessian is singular there: they belong to a family of
        paths, or the ends are conjugate points
    stopped : why the search ended
    alternating_sum : of (-1)^index over all paths, where Morse's theory knows it, else None: one for each number of
        turns where all components have periods and one end of each is given, and zero where one is free at both ends

    Examples
    --------
    >>> import casadi as ca
    >>> import casadi_galerkin as cg
    >>> bratu = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - ca.exp(x[0]), (0, 1), start=[0.0], end=[0.0])
    >>> found = cg.paths(bratu, cg.Galerkin(8), 10, count=2)
    >>> len(found), found.stopped, [path.x[0, 5].round(6).tolist() for path in found]
    (2, 'stopped at count=2', [0.140539, 4.091467])
    """

    trajectories: tuple[Trajectory, ...]
    solves: int
    unresolved: int
    singular: int
    stopped: str
    alternating_sum: int | None = None

    def __len__(self) -> int:
        return len(self.trajectories)

    def __getitem__(self, i: int) -> Trajectory:
        return self.trajectories[i]

    def __iter__(self) -> Iterator[Trajectory]:
        return iter(self.trajectories)

    def plot(
        self, component: int = 0, axes: Axes | None = None, labels: Sequence[str] | None = None, time: str = "t"
    ) -> Axes:
        """Draw one component of all paths into one picture; returns the Matplotlib axes.

        Parameters
        ----------
        component : which, from 0 to d - 1
        axes : Matplotlib axes to draw into; default a new figure
        labels : name of the component with its unit
        time : name of the time with its unit
        """
        named = [(f"action {path.action:.6g}, {index_in_words(path)}", path) for path in self]
        return plot_component(named, component, axes, labels, time)

    def __repr__(self) -> str:
        """Tabulate the paths, and say how many were dropped and why the search ended."""
        count = len(self)
        lines = [f"Paths: {counted(count, 'stationary path')} in {counted(self.solves, 'solve')}; {self.stopped}"]
        for path in self.trajectories[:PATHS_SHOWN]:
            found = f"error {path.error_estimate:.0e}  {path.solver}"
            lines.append(f"  action {path.action:<18.12g} {index_in_words(path):15} {found}")
        if count > PATHS_SHOWN:
            lines.append(f"  ... {count - PATHS_SHOWN} more")
        if self.alternating_sum is not None:
            indices = [path.morse_index for path in self]
            found = sum((-1) ** index for index in indices if index is not None)
            missing = "" if found == self.alternating_sum else f", and not {self.alternating_sum}: some are missing"
            lines.append(f"  the sum of (-1)^index is {found}{missing}")
        if self.unresolved:
            lines.append(f"  {self.unresolved} dropped that the mesh does not resolve; {RESOLVED_BY}")
        if self.singular:
            lines.append(f"  {self.singular} dropped with a singular Hessian: a family of paths, or conjugate points")
        return "\n".join(lines)


@interrupts_raised()
def paths(
    problem: BoundaryProblem,
    method: Galerkin | None = None,
    intervals: int | None = None,
    count: int = 10,
    *,
    tol: float | None = None,
    of: Quantity | None = None,
    mesh: ArrayLike | None = None,
    symmetries: Sequence[Symmetry] = (),
    periods: Sequence[float | None] | None = None,
) -> Paths:
    """Find several stationary paths of a problem, without a guess.

    The search begins with the straight line, and goes on until it has `count` paths, or 20 solves in succession have
    found no new one.  That is no proof that there are no more.  Guesses and distances are measured by the sizes of the
    components on the paths found so far, and by one where these are zero.  The same call gives the same paths.

    With `tol` every critical point of a first mesh is refined until the estimated error of x is at most `tol`, as
    `solve` does.  What no mesh of 500 intervals resolves is dropped and counted.

    Parameters
    ----------
    problem : BoundaryProblem
    method : Galerkin, default degree 8; with a tolerance it fixes the degree
    intervals : number of equal intervals; or
    count : number of paths at which the search ends
    tol : relative tolerance between 0 and 1, in place of `method` and `intervals`, which are then where it begins
    of : the quantity that `tol` is the tolerance of, as for `solve`; default x
    mesh : (N + 1,) joints from t_span[0] to t_span[1]
    symmetries : callables that take the values of a path at all nodes, (d, N m + 1) in the order of time, and return
        those of a path that counts as the same one: its mirror image, as in ``lambda x: -x``.  Of such paths only one
        is returned
    periods : d numbers, such as ``[2 * np.pi, None]`` for an angle and a length.  Paths that are whole periods apart
        count once.  Where both ends of such a component are given, an end whole periods further is the same place: all
        numbers of turns are searched, 0, 1, -1, 2, ..., until `count` paths are found

    Returns
    -------
    Paths, in the order of their action

    Raises
    ------
    ConvergenceError
        if no path was found; a ConjugatePointError if the Hessian was singular wherever one was met
    TypeError, ValueError
        naming what came and what was expected, before anything is solved

    Examples
    --------
    >>> import casadi as ca
    >>> import casadi_galerkin as cg
    >>> bratu = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - ca.exp(x[0]), (0, 1), start=[0.0], end=[0.0])
    >>> [(round(path.action, 6), path.morse_index) for path in cg.paths(bratu, tol=1e-9, count=2)]
    [(-1.046517, 0), (16.440013, 1)]
    """
    check_kind(problem, BoundaryProblem)
    check_method(method, optional=True)
    check_asked(of, tol)
    if tol is None:
        transcription = transcribed(problem, method or Galerkin(8), intervals, mesh)
        accept = partial(resolved, transcription)
    else:
        method, joints = first_discretization(problem, check_tolerance(tol), method, intervals, mesh)
        if intervals is None and mesh is None:
            joints = resized_mesh(joints, SEARCH_INTERVALS_FACTOR * (len(joints) - 1), problem.breakpoints)
        graphs = GraphCache(problem)
        transcription, accept = graphs.transcription(method, joints), partial(_refined, graphs, tol, of, method)
    refuse_free_phase("paths", problem)
    count, images = whole_number("count", count), _checked(symmetries, transcription)
    lengths = _checked_periods(periods, problem)
    searches: list[Search] = []
    for end in _ends(problem, lengths):
        turned = transcription if end is None else transcription.for_problem(problem.varied({"end": end}))
        search = Search(turned, transcription.mesh, accept, images, lengths)
        try:
            search.run(count - sum(len(each.paths) for each in searches))
        except ConvergenceError:
            if end is None:
                raise
        searches.append(search)
        found = [path for each in searches for path in each.paths]
        lately = sum(len(each.paths) for each in searches[-SOLVES_WITHOUT_A_PATH:])
        if len(found) == count or (len(searches) >= SOLVES_WITHOUT_A_PATH and not lately):
            break
    if not found:
        raise searches[0].no_path_error()
    reached = len(found) == count
    stopped = (
        f"stopped at count={count}" if reached else f"stopped after {SOLVES_WITHOUT_A_PATH} solves without a new one"
    )
    solves, unresolved, singular = (
        sum(getattr(each, name) for each in searches) for name in ("solves", "unresolved", "singular")
    )
    known = None if images else _alternating_sum(problem, lengths, len(searches))
    return Paths(tuple(sorted(found, key=lambda path: path.action)), solves, unresolved, singular, stopped, known)


def _refined(graphs: GraphCache, tol: float, of: Quantity | None, method: Galerkin, point: CriticalPoint) -> Trajectory:
    """The path that a critical point of a first mesh becomes on finer ones."""
    of_problem = graphs.for_problem(point.problem)
    return BoundaryRefinement(of_problem, tol, method, newton, CANDIDATE_LIMITS, of).resume(point)


def _ends(problem: BoundaryProblem, lengths: np.ndarray) -> Iterator[list[float | None] | None]:
    """The given end, and all ends that are whole periods further where both ends are given, the nearest ones first."""
    yield None
    given = ~np.isnan(problem.given_positions).any(axis=0) & (not problem.periodic)
    turning = np.flatnonzero(np.isfinite(lengths) & given).tolist()
    for most in counting(1) if turning else ():
        for turns in product(range(most, -most - 1, -1), repeat=len(turning)):
            if max(map(abs, turns)) == most:
                end = list(problem.end)
                for i, turn in zip(turning, turns, strict=True):
                    end[i] += turn * lengths[i]
                yield end


def _alternating_sum(problem: BoundaryProblem, lengths: np.ndarray, classes: int) -> int | None:
    """Σ (-1)^index of all paths in so many classes of paths that differ in their turns; None where it is not known.

    Where all is periodic, and paths are told by given ends and turns alone, all paths of a class can be drawn into one
    another, and an action with a kinetic energy is bounded below there (M. Morse, 1934): the sum is one, the Euler
    characteristic of a point.  With free ends a path may be turned as a whole, and it is that of a torus, zero.
    """
    others = (problem.force, problem.constraint, problem.end_conditions, problem.energy)
    if not np.isfinite(lengths).all() or any(other is not None for other in others):
        return None
    free = np.isnan(problem.given_positions).all(axis=0)
    return 0 if np.any(free) else classes


def _checked_periods(periods: Sequence[float | None] | None, problem: BoundaryProblem) -> np.ndarray:
    """The periods as an array, infinite where there is none; refuses those that the problem does not have."""
    d = problem.dimension
    lengths = np.full(d, np.inf)
    if periods is None:
        return lengths
    if not isinstance(periods, (Sequence, np.ndarray)) or len(periods) != d:
        raise ValueError(f"periods must be {counted(d, 'number')} or None, one per component, got {periods!r}")
    for i, period in enumerate(periods):
        if period is not None:
            if not 0 < (number(period) or 0) < np.inf:
                raise ValueError(f"periods[{i}] must be a positive number, or None, got {period!r}")
            lengths[i] = period
            _check_period(problem, i, float(period))
    return lengths


def _check_period(problem: BoundaryProblem, i: int, period: float) -> None:
    """Refuse a period after which some part of the problem is another one, seen at a random place."""
    random = np.random.default_rng(SEED)
    for name in ("lagrangian", "force", "constraint", "end_action", "end_conditions"):
        function = with_parameters(getattr(problem, name), problem.parameters)
        if function is None:
            continue
        here = [random.normal(size=function.size1_in(k)) for k in range(function.n_in())]
        there = [values.copy() for values in here]
        for k in (0, 1) if name.startswith("end") else (1,):
            there[k][i] += period
        one, other = (np.array(function(*values)) for values in (here, there))
        if np.any(np.abs(one - other) > SAME_PATH * (np.abs(one) + 1)):
            raise ValueError(
                f"periods[{i}] = {period:g} is no period of the problem: its {name} is another one where x[{i}] is "
                f"{period:g} larger"
            )


def _checked(symmetries: Sequence[Symmetry], transcription: Transcription) -> tuple[Symmetry, ...]:
    """Refuse symmetries that do not map node values to node values; each is called once."""
    if not isinstance(symmetries, Sequence):
        raise TypeError(f"symmetries must be a sequence of callables of node values, got {symmetries!r}")
    values = transcription.guess_on_mesh(None, transcription.mesh).values
    for i, symmetry in enumerate(symmetries):
        if not callable(symmetry):
            raise TypeError(f"symmetries[{i}] must be a callable of node values, got {symmetry!r}")
        image(i, symmetry, values)
    return tuple(symmetries)
