"""Several stationary paths of one problem, without a guess.

Curves of loaded paths are followed from the paths found so far (`loaded_curve`).  In between, Newton's method is
started from random smooth guesses.  Guesses alone, even with deflation of the known paths, were measured to find 5 of
13 geodesics on a torus in 100 solves; with the curves all are found in 4 to 25.  Until a path is found, curves begin at
a guess: at first a load makes it an equilibrium, and the load is then removed.  Where Newton's method from the straight
line failed, 20 of 23 random problems of up to three components were solved in this way, and 5 by Newton's method from
as many random guesses.  Near a stationary path, the curve is left, and Newton's method of the package finds and
verifies the path.

A discrete action also has critical points that are not paths, such as zigzags of a coarse mesh.  And where the paths of
a problem form a family, it has single critical points in its place.  So a critical point is dropped where a higher
degree or the error indicators show a large error, and where its second variation vanishes up to the error.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.transcription import Transcription, transcribed
from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.numbers import checked_index, counted, real_array, whole_number
from casadi_galerkin.calculus.roundoff import component_sizes
from casadi_galerkin.functional.buffers import interrupts_raised
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.solution.errors import ConjugatePointError, ConvergenceError
from casadi_galerkin.solution.guess import waves
from casadi_galerkin.solution.orbit_phase import refuse_free_phase
from casadi_galerkin.solution.plotting import Pictured, plot_family
from casadi_galerkin.solution.progress import progress
from casadi_galerkin.solution.trajectory import Trajectory, index_in_words
from casadi_galerkin.solvers.curve import LoadedCurve, residual_load_curve
from casadi_galerkin.solvers.deadline import seconds_left
from casadi_galerkin.solvers.newton import Solution, SolveFailure, damped_newton
from casadi_galerkin.solvers.second_variation import smallest_second_variation

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Symmetry = Callable[[np.ndarray], ArrayLike]

PATIENCE = 20  # solves in succession without a new path after which a search ends
SEED = 0  # of the random guesses and loads, so that repeated searches give the same paths
SAME = 1e-6  # largest distance of node values, in sizes of the component, at which two paths count as one
RESOLVED = 0.05  # largest estimated relative error of a path; that of zigzags is about one
# a second variation below SOFT and below ERRORS times the estimated error counts as zero; regular ones are above 1e-2
SOFT, ERRORS = 1e-3, 10.0
SMALLEST, LARGEST = -2.0, 5.0  # powers of two between which the amplitude of a random guess lies
# the amplitudes until a path is found, in turn: small ones lead to paths of less action and a smaller index
GROWING = 2 ** np.arange(SMALLEST, LARGEST + 1)
SHOWN = 6  # paths in a repr
FINER = "a higher degree or more intervals may"
NO_PATH = (
    "There may be no path between these ends in this time; else give cg.solve a guess nearer to it, or come from an "
    "easier problem by cg.sweep or cg.continuation"
)


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

    def __len__(self) -> int:
        return len(self.trajectories)

    def __getitem__(self, i: int) -> Trajectory:
        return self.trajectories[i]

    def __iter__(self) -> Iterator[Trajectory]:
        return iter(self.trajectories)

    def plot(self, component: int = 0, axes: Axes | None = None, label: str | None = None, time: str = "t") -> Axes:
        """Draw one component of all paths into one picture; returns the Matplotlib axes.

        Parameters
        ----------
        component : which, from 0 to d - 1
        axes : Matplotlib axes to draw into; default a new figure
        label : name of the component with its unit
        time : name of the time with its unit
        """
        checked_index("component", component, len(self[0].x))
        drawn = [(f"action {path.action:.6g}, {index_in_words(path)}", path._line()) for path in self]
        lines = [(name, times, values[component]) for name, (times, values) in drawn]
        return plot_family(lines, axes, label or f"x[{component}]", time)

    def __repr__(self) -> str:
        """Tabulate the paths, and say how many were dropped and why the search ended."""
        count = len(self)
        lines = [f"Paths: {counted(count, 'stationary path')} in {counted(self.solves, 'solve')}; {self.stopped}"]
        for path in self.trajectories[:SHOWN]:
            found = f"error {path.error_estimate:.0e}  {path.solver}"
            lines.append(f"  action {path.action:<18.12g} {index_in_words(path):15} {found}")
        if count > SHOWN:
            lines.append(f"  ... {count - SHOWN} more")
        if self.unresolved:
            lines.append(f"  {self.unresolved} dropped that the mesh does not resolve; {FINER}")
        if self.singular:
            lines.append(f"  {self.singular} dropped with a singular Hessian: a family of paths, or conjugate points")
        return "\n".join(lines)


@interrupts_raised()
def paths(
    problem: BoundaryProblem,
    method: Galerkin,
    intervals: int | None = None,
    count: int = 10,
    *,
    mesh: ArrayLike | None = None,
    symmetries: Sequence[Symmetry] = (),
) -> Paths:
    """Find several stationary paths of a problem, without a guess.

    The search begins with the straight line, and goes on until it has `count` paths, or 20 solves in succession have
    found no new one.  That is no proof that there are no more.  Guesses and distances are measured by the sizes of the
    components on the paths found so far, and by one where these are zero.  The same call gives the same paths.

    Parameters
    ----------
    problem : BoundaryProblem
    method : Galerkin
    intervals : number of equal intervals; or
    count : number of paths at which the search ends
    mesh : (N + 1,) joints from t_span[0] to t_span[1]
    symmetries : callables that take the values of a path at all nodes, (d, N m + 1) in the order of time, and return
        those of a path that counts as the same one: its mirror image, as in ``lambda x: -x``, or, of angles, the path
        moved by whole turns so that it begins between 0 and 2π.  Of such paths only one is returned

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
    >>> [(round(path.action, 6), path.morse_index) for path in cg.paths(bratu, cg.Galerkin(8), 10, count=2)]
    [(-1.046517, 0), (16.440013, 1)]
    """
    transcription = transcribed(problem, method, intervals, mesh)
    refuse_free_phase("paths", problem)
    count = whole_number("count", count)
    return Search(transcription, transcription.mesh, _checked(symmetries, transcription)).run(count)


def _checked(symmetries: Sequence[Symmetry], transcription: Transcription) -> tuple[Symmetry, ...]:
    """Refuse symmetries that do not map node values to node values; each is called once."""
    if not isinstance(symmetries, Sequence):
        raise TypeError(f"symmetries must be a sequence of callables of node values, got {symmetries!r}")
    values = transcription.guess_on_mesh(None, transcription.mesh).values
    for i, symmetry in enumerate(symmetries):
        if not callable(symmetry):
            raise TypeError(f"symmetries[{i}] must be a callable of node values, got {symmetry!r}")
        _image(i, symmetry, values)
    return tuple(symmetries)


def _image(i: int, symmetry: Symmetry, values: np.ndarray) -> np.ndarray:
    """Node values of the image of a path under the i-th symmetry; refuses results that are no node values."""
    image = real_array(f"what symmetries[{i}] returns", symmetry(values.copy()))
    if image.shape != values.shape:
        raise ValueError(f"symmetries[{i}] must return an array of shape {values.shape}, got {image.shape}")
    if not np.isfinite(image).all():
        raise ValueError(f"symmetries[{i}] must return finite numbers, got {image[~np.isfinite(image)][0]}")
    return image


class Search:
    """The state of a search on a mesh, which may be another one than that of the transcription.

    `iterations` leaves out those of the solve that ended it with a path.
    """

    def __init__(self, transcription: Transcription, mesh: np.ndarray, symmetries: tuple[Symmetry, ...] = ()) -> None:
        self.transcription, self.stationarity, self.mesh = transcription, transcription.stationarity, mesh
        self.symmetries, self.random = symmetries, np.random.default_rng(SEED)
        self.amplitudes = cycle(GROWING)
        self.data = transcription.data(mesh)
        self.found: list[tuple[Trajectory, np.ndarray]] = []  # with their unknowns
        self.known: list[np.ndarray] = []  # node values of all critical points and their images, also of those dropped
        self.solves = self.curves = self.unresolved = self.singular = self.iterations = 0
        self.failure: ConvergenceError | None = None
        self.parts = DiscreteCalculus(transcription.method, mesh).node_parts
        self.measure(transcription.guess_on_mesh(None, mesh).values)

    def measure(self, *values: np.ndarray) -> None:
        """Set the sizes of components and of unknowns to their largest on some paths."""
        self.component_sizes = np.max([component_sizes(of_path) for of_path in values], axis=0)
        self.sizes = np.max([self.stationarity.sizes(self.unknowns(of_path), self.data) for of_path in values], axis=0)

    def unknowns(self, values: np.ndarray) -> np.ndarray:
        """Unknowns ξ from node values (d, N m + 1)."""
        return self.transcription.unknowns(values.T, self.data)

    def run(self, count: int) -> Paths:
        """Search until `count` paths are found, or `PATIENCE` solves in succession have found no new one."""
        last = 0
        with progress("paths", count, "path") as advance:
            while len(self.found) < count and self.solves - last < PATIENCE:
                self.solves += 1
                known, began = len(self.found), time.perf_counter()
                with suppress(SolveFailure):
                    for solution in self.attempt():
                        self.consider(solution, time.perf_counter() - began)
                        if len(self.found) == count:
                            break
                if len(self.found) > known:
                    last = self.solves
                advance(len(self.found) - known)
                if seconds_left() < 0:
                    break
        if not self.found:
            raise self.no_path_error() from self.failure and self.failure.__cause__
        reached = len(self.found) == count
        stopped = f"stopped at count={count}" if reached else f"stopped after {PATIENCE} solves without a new one"
        ordered = sorted((path for path, _ in self.found), key=lambda path: path.action)
        return Paths(tuple(ordered), self.solves, self.unresolved, self.singular, stopped)

    def attempt(self) -> Iterator[Solution]:
        """Verified critical points of the next solve, which may be known already."""
        if self.solves == 1:
            try:
                yield self.transcription.critical_point(mesh=self.mesh).solution
            except ConvergenceError as failure:
                self.failure = failure
                self.iterations += failure.iterations
                self.singular += isinstance(failure, ConjugatePointError)
        elif not self.transcription.numbering.positions:
            return  # without free positions there is no other guess, and no load
        elif not self.found:
            yield from self.along_residual_load()
        elif self.solves % 3:
            yield from self.along_a_load()
        else:
            yield self.from_a_guess()

    def smooth(self) -> np.ndarray:
        """Random smooth function at the nodes, of the size of each component; (d, N m + 1)."""
        period = 1.0 if self.transcription.problem.periodic else 2.0
        return waves(self.random, self.component_sizes, period)(self.parts)

    def guess(self, amplitude: float) -> np.ndarray:
        """Unknowns of a random guess."""
        values = amplitude * self.smooth()
        return self.unknowns(self.transcription.guess_on_mesh(values, self.mesh).values)

    def from_a_guess(self) -> Solution:
        """Newton's method from a random guess."""
        guess = self.guess(2 ** self.random.uniform(SMALLEST, LARGEST))
        solution = damped_newton(self.stationarity, guess, self.data)
        return replace(solution, report="Newton, from a random guess")

    def along_residual_load(self) -> Iterator[Solution]:
        """All paths on the curve from a random guess, which a load makes an equilibrium, as the load is removed."""
        curve = residual_load_curve(self.stationarity, self.guess(next(self.amplitudes)), self.data)
        yield from curve.stationary_paths(-1.0, "Newton, along the load of a random guess")
        self.iterations += curve.iterations

    def along_a_load(self) -> Iterator[Solution]:
        """All paths on a curve of loaded paths: to one side of a known path, and in the next solve to the other."""
        again = self.curves % 2
        if not again:
            self.start, self.begun = self.found[self.curves // 2 % len(self.found)]
            self.load = self.unknowns(self.smooth()) / self.sizes**2
        self.curves += 1
        values, report = self.start.polynomial.values, f"Newton, along a load from action {self.start.action:.6g}"
        curve = LoadedCurve(self.stationarity, self.data, self.load, np.append(self.begun, 0.0), self.sizes)
        for solution in curve.stationary_paths(-1.0 if again else 1.0, report):
            if self.same(self.values(solution.unknowns), values):
                return  # the curve is closed
            yield solution

    def values(self, unknowns: np.ndarray) -> np.ndarray:
        """Node values (d, N m + 1) of unknowns."""
        return self.transcription.emb(unknowns, self.data).values

    def same(self, values: np.ndarray, others: np.ndarray) -> bool:
        """Whether two arrays of node values are the same path."""
        return bool(np.max(np.abs(values - others) / self.component_sizes[:, None]) < SAME)

    def consider(self, solution: Solution, seconds: float) -> None:
        """Keep a critical point if it is new and regular, and its error is small."""
        if not self.is_new(solution.unknowns):
            return
        polynomial = self.transcription.emb(solution.unknowns, solution.data)
        point = CriticalPoint(solution, self.transcription.problem, polynomial)
        try:
            path = self.transcription.trajectory(point, seconds)
        except ConvergenceError as failure:
            self.failure = self.failure or failure
            self.singular += isinstance(failure, ConjugatePointError)
            return
        error = path.estimate_error()
        if smallest_second_variation(self.stationarity, solution.unknowns, self.data) < min(SOFT, ERRORS * error):
            self.singular += 1  # of a family, of which the discrete action has single critical points
            return
        if not error <= RESOLVED:
            self.unresolved += 1
            return
        self.found.append((path, solution.unknowns))
        self.measure(*(path.polynomial.values for path, _ in self.found))

    def is_new(self, unknowns: np.ndarray) -> bool:
        """Record a critical point with its images under the symmetries; whether none of them was known."""
        values, numbering = self.values(unknowns), self.transcription.numbering
        same = [values]
        for i, symmetry in enumerate(self.symmetries):
            image = _image(i, symmetry, values).T.ravel()[numbering.place]
            same.append(self.values(np.concatenate((image, unknowns[numbering.positions :]))))
        new = [each for each in same if not any(self.same(each, other) for other in self.known)]
        self.known += new
        return len(new) == len(same)

    def no_path_error(self) -> ConvergenceError:
        """The error that says why there is no path."""
        began = self.failure or ConvergenceError("a path of a family, or between conjugate points, was found")
        kind, why = ConvergenceError, f"; from the straight line, {began}"
        if self.unresolved:
            dropped = counted(self.unresolved, "critical point")
            why = f", but {dropped} of the discrete action that the mesh does not resolve; {FINER}. {NO_PATH}"
        elif self.singular:
            kind = ConjugatePointError
        return kind(
            f"no path was found in {counted(self.solves, 'solve')}{why}", began.path, began.residual, self.iterations
        )
