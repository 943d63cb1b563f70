"""The search by which `paths` finds several stationary paths on one mesh, without a guess.

Curves of loaded paths are followed (`solvers.curve`): two from known paths, where a load begins to grow, and one from a
random smooth guess around one, which a load makes an equilibrium at first; again and again, from the beginning where
one has led to a path.  Where the load is zero there is a path; the curve is left there, and Newton's method of the
package finds and verifies it.  Of Carrier's 16 paths, growing loads alone found all from 2 of 5 seeds, both together
from all 5; and Newton's method from random guesses, even with deflation of the known paths, 5 of 13 geodesics on a
torus in 100 solves.

Under a constraint a growing load holds every node of the path where it pulls to, on a closed surface for ever, and the
curves do not come back.  There all curves begin at guesses, moved onto the constraint.

A discrete action also has critical points that are not paths, such as zigzags of a coarse mesh.  And where the paths of
a problem form a family, it has single critical points in its place.  So a critical point is dropped where a higher
degree or the error indicators show a large error, and where its second variation vanishes up to the error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.transcription import Transcription
from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus
from casadi_galerkin.calculus.numbers import counted, real_array
from casadi_galerkin.calculus.roundoff import component_sizes
from casadi_galerkin.problems.callables import with_parameters
from casadi_galerkin.solution.errors import ConjugatePointError, ConvergenceError
from casadi_galerkin.solution.guess import waves
from casadi_galerkin.solution.progress import progress
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.solvers.curve import CORRECTOR_ITERATIONS, LoadedCurve, residual_load_curve
from casadi_galerkin.solvers.deadline import seconds_left
from casadi_galerkin.solvers.newton import Solution, SolveFailure
from casadi_galerkin.solvers.second_variation import smallest_second_variation

Symmetry = Callable[[np.ndarray], ArrayLike]

SOLVES_WITHOUT_A_PATH = 20  # solves in succession without a new path after which a search ends
SEED = 0  # of the random guesses and loads, so that repeated searches give the same paths
SAME_PATH = 1e-6  # largest distance of node values, in sizes of the component, at which two paths count as one
RESOLVED_ERROR = 0.05  # largest estimated relative error of a path; that of zigzags is about one
SINGULAR_BELOW = (
    1e-3  # a second variation counts as zero below it, and below the root of the error; others are above 1e-2
)
AMPLITUDES = 2.0 ** np.arange(-2, 6)  # of guesses: small ones lead to paths of less action and a smaller index
RESOLVED_BY = "a higher degree or more intervals may"
NO_PATH = (
    "There may be no path between these ends in this time; else give cg.solve a guess nearer to it, or come from an "
    "easier problem by cg.sweep or cg.continuation"
)


def image(i: int, symmetry: Symmetry, values: np.ndarray) -> np.ndarray:
    """Node values of the image of a path under the i-th symmetry; refuses results that are no node values."""
    image = real_array(f"what symmetries[{i}] returns", symmetry(values.copy()))
    if image.shape != values.shape:
        raise ValueError(f"symmetries[{i}] must return an array of shape {values.shape}, got {image.shape}")
    if not np.isfinite(image).all():
        raise ValueError(f"symmetries[{i}] must return finite numbers, got {image[~np.isfinite(image)][0]}")
    return image


class Search:
    """The state of a search on a mesh, which may be another one than that of the transcription.

    Parameters
    ----------
    transcription, mesh
    accept : makes a path of a critical point, or raises: a ConjugatePointError where it belongs to a family
    symmetries : images under them count as the same path
    periods : (d,), components that differ by these count as the same; infinite where a component has none

    Attributes
    ----------
    iterations : without those of the solve that ended it with a path
    """

    def __init__(
        self,
        transcription: Transcription,
        mesh: np.ndarray,
        accept: Callable[[CriticalPoint], Trajectory],
        symmetries: tuple[Symmetry, ...] = (),
        periods: np.ndarray | None = None,
    ) -> None:
        self.transcription, self.stationarity, self.mesh = transcription, transcription.stationarity, mesh
        self.symmetries, self.accept = symmetries, accept
        self.periods = np.full(transcription.problem.dimension, np.inf) if periods is None else periods
        self.data = transcription.data(mesh)
        self.paths = list[Trajectory]()
        self.begun: list[np.ndarray] = []  # their unknowns on this mesh
        self.known: list[np.ndarray] = []  # node values of all critical points and their images, also of those dropped
        self.solves = self.last = self.unresolved = self.singular = self.iterations = 0
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

    def run(self, count: int) -> list[Trajectory]:
        """Search until `count` paths are found, or `SOLVES_WITHOUT_A_PATH` in succession have found no new one."""
        with progress("paths", count, "path") as advance:
            while len(self.paths) < count and self.solves - self.last < SOLVES_WITHOUT_A_PATH:
                self.solves += 1
                known = len(self.paths)
                with suppress(SolveFailure):
                    for solution in self.attempt():
                        self.consider(solution)
                        if len(self.paths) == count:
                            break
                if len(self.paths) > known:
                    self.last = self.solves
                advance(len(self.paths) - known)
                if seconds_left() < 0:
                    break
        if not self.paths:
            raise self.no_path_error() from self.failure and self.failure.__cause__
        return self.paths

    def attempt(self) -> Iterator[Solution]:
        """Verified critical points of the next solve, which may be known already."""
        constrained = self.transcription.problem.constraint is not None
        if self.solves == 1:
            try:
                yield self.transcription.critical_point(mesh=self.mesh).solution
            except ConvergenceError as failure:
                self.failure = failure
                self.iterations += failure.iterations
                self.singular += isinstance(failure, ConjugatePointError)
        elif not self.transcription.numbering.positions:
            return  # without free positions there is no other guess, and no load
        elif (self.solves - self.last) % 3 and self.paths and not constrained:
            yield from self.along_a_load()
        else:
            base = self.values(self.begun[self.solves % len(self.begun)]) if self.begun else 0.0
            near, one = AMPLITUDES[1:4], AMPLITUDES[[self.solves % len(AMPLITUDES)]]
            for amplitude in near if constrained and self.paths else one:
                values = base + amplitude * self.smooth()
                guess = self.on_constraint(self.transcription.guess_on_mesh(values, self.mesh).values)
                curve = residual_load_curve(self.stationarity, self.unknowns(guess), self.data)
                yield from curve.stationary_paths(-1.0, "Newton, along the load of a random guess")
                self.iterations += curve.iterations

    def smooth(self) -> np.ndarray:
        """The random smooth function of this solve at the nodes, of the size of each component; (d, N m + 1)."""
        period = 1.0 if self.transcription.problem.periodic else 2.0
        return waves(np.random.default_rng([SEED, self.solves]), self.component_sizes, period)(self.parts)

    def on_constraint(self, values: np.ndarray) -> np.ndarray:
        """Node values moved onto the constraint, at right angles to it, and those of given ends as they were."""
        problem = self.transcription.problem
        if problem.constraint is None:
            return values
        t, x = ca.SX.sym("t"), ca.SX.sym("x", problem.dimension)
        off = with_parameters(problem.constraint, problem.parameters)(t, x)
        step = ca.mtimes(ca.pinv(ca.jacobian(off, x)), off)
        moved = ca.Function("moved", [t, x], [x - step]).map(values.shape[1])
        times, given = self.mesh[0] + self.parts * (self.mesh[-1] - self.mesh[0]), values
        for _ in range(CORRECTOR_ITERATIONS):
            values = np.array(moved(times[None, :], values))
        fixed = ~np.isnan(problem.given_positions.T)
        values[:, [0, -1]] = np.where(fixed, given[:, [0, -1]], values[:, [0, -1]])
        return np.where(np.isfinite(values), values, given)

    def along_a_load(self) -> Iterator[Solution]:
        """All paths on a curve of loaded paths, from a known path."""
        number = self.solves % len(self.paths)
        begun, report = self.begun[number], f"Newton, along a load from action {self.paths[number].action:.6g}"
        load = self.unknowns(self.smooth()) / self.sizes**2
        curve = LoadedCurve(self.stationarity, self.data, np.append(begun, 0.0), self.sizes, load)
        for solution in curve.stationary_paths(1.0, report):
            if self.same(self.values(solution.unknowns), self.values(begun)):
                return  # the curve is closed
            yield solution

    def values(self, unknowns: np.ndarray) -> np.ndarray:
        """Node values (d, N m + 1) of unknowns."""
        return self.transcription.emb(unknowns, self.data).values

    def same(self, values: np.ndarray, others: np.ndarray, distance: float = SAME_PATH) -> bool:
        """Whether two arrays of node values are the same path, up to whole periods."""
        apart = values - others
        with np.errstate(invalid="ignore"):  # of a component without period
            turns = self.periods * np.round(apart[:, 0] / self.periods)
        apart -= np.where(np.isfinite(self.periods), turns, 0.0)[:, None]
        return bool(np.max(np.abs(apart) / self.component_sizes[:, None]) < distance)

    def consider(self, solution: Solution) -> None:
        """Keep a critical point if it is new and accepted, and not on the way to a path that another one has led to."""
        if not self.is_new(solution.unknowns):
            return
        try:
            path = self.accept(self.transcription.point(solution))
        except ConvergenceError as failure:
            self.failure = self.failure or failure
            self.singular += isinstance(failure, ConjugatePointError)
            self.unresolved += not isinstance(failure, ConjugatePointError)
            return
        here, *others = (each(each.t[0] + self.parts * np.ptp(each.t)) for each in (path, *self.paths))
        if any(self.same(here, other, SAME_PATH + 10 * path.estimate_error()) for other in others):
            return
        self.paths.append(path)
        self.begun.append(solution.unknowns)
        self.measure(*map(self.values, self.begun))

    def is_new(self, unknowns: np.ndarray) -> bool:
        """Record a critical point with its images under the symmetries; whether none of them was known."""
        values, numbering = self.values(unknowns), self.transcription.numbering
        same = [values]
        for i, symmetry in enumerate(self.symmetries):
            mirrored = image(i, symmetry, values).T.ravel()[numbering.place]
            same.append(self.values(np.concatenate((mirrored, unknowns[numbering.positions :]))))
        new = [each for each in same if not any(self.same(each, other) for other in self.known)]
        self.known += new
        return len(new) == len(same)

    def no_path_error(self) -> ConvergenceError:
        """The error that says why there is no path."""
        began, kind, why = self.failure, ConvergenceError, f"; from the straight line, {self.failure}"
        assert began is not None
        if self.unresolved:
            dropped = counted(self.unresolved, "critical point")
            why = f", but {dropped} of the discrete action that the mesh does not resolve; {RESOLVED_BY}. {NO_PATH}"
        elif self.singular:
            kind = ConjugatePointError
        return kind(
            f"no path was found in {counted(self.solves, 'solve')}{why}", began.path, began.residual, self.iterations
        )


def resolved(transcription: Transcription, point: CriticalPoint) -> Trajectory:
    """The path of a critical point; refuses one that the mesh does not resolve, or that belongs to a family."""
    graph, solution = transcription.for_problem(point.problem), point.solution
    path = graph.trajectory(point, 0.0)
    error = path.estimate_error()
    curvature = smallest_second_variation(graph.stationarity, solution.unknowns, solution.data)
    if curvature < min(SINGULAR_BELOW, error**0.5):
        raise ConjugatePointError("a path of a family, or between conjugate points, was found", path)
    if not error <= RESOLVED_ERROR:
        raise ConvergenceError(f"the mesh does not resolve the path: its error is {error:.0e}", path)
    return path
