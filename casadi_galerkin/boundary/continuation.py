"""Follow a branch of critical paths while the parameters of a problem change, past the folds of the branch.

The parameters move on the line p(s) = p_0 + s (p_1 - p_0) from the problem's own to the target.  The branch is the
curve ∇S(ξ, p(s)) = 0, followed by its arc length (`arc_length`).  At a fold the Hessian is singular and ṡ changes its
sign; the branch then leads back, with another Morse index.  The fold is found as the zero of ṡ.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.boundary.branch import Branch, Fold
from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.transcription import Transcription, transcribed
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.numbers import numbers
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.functional.buffers import interrupts_raised
from casadi_galerkin.functional.mass_check import check_mass
from casadi_galerkin.functional.numbering import Data
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.orbit_phase import refuse_free_phase
from casadi_galerkin.problems.problem import check_types
from casadi_galerkin.solution.errors import ConjugatePointError, ConvergenceError
from casadi_galerkin.solution.guess import Guess
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solution.progress import progress
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.solvers.arc_length import CORRECTOR_ITERATIONS, STEP_GROWTH, STEP_REDUCTION, Curve
from casadi_galerkin.solvers.newton import Solution, SolveFailure, damped_newton
from casadi_galerkin.solvers.second_variation import negative_eigenvalues

# arc lengths, in which the path is relative to how far the branch has led
FIRST_STEP, LONGEST_STEP, SMALLEST_STEP = 0.05, 0.1, 1e-12
# cosine of the largest angle between a step and the tangents at its two ends; beyond it may be another branch
LEAST_COSINE = 0.95
CROSSING_STEP = 1e-3  # a shorter step may cross another branch, instead of having jumped to one that passes nearby
CONVERGED_STEP = 1e-8  # last Newton step after which the next one is at roundoff
# |ṡ| at a fold over its change between the points before and after it; the error of s is of the order of its square
FOLD_TOLERANCE = 1e-8
# least change of an unknown that counts: over its size, so that rounding leaves steps of CONVERGED_STEP, and over the
# largest expected change, because a component may be zero up to rounding
LEAST_OF_SIZE, LEAST_OF_ALL = 1e-5, 1e-7
ROUNDED = 1e-12  # size of an unknown over its expected change, below which it counts as zero
ITERATIONS = 20  # most iterations for a fold; rounding may prevent FOLD_TOLERANCE
LOST = 0.01  # truncation error above which folds were seen to be those of the mesh; at 2e-3 they had 4 to 6 digits
POINTS = 1000  # most points of a branch


@interrupts_raised()
def continuation(
    problem: BoundaryProblem,
    target: Sequence[float],
    method: Galerkin | None = None,
    intervals: int | None = None,
    *,
    mesh: ArrayLike | None = None,
    guess: Guess | None = None,
) -> Branch:
    """Follow a path while the parameters change from the problem's own to a target.

    At a fold the path meets another one, and beyond it neither exists.  Where a fold lies between, the branch turns
    back there, and ends at the parameters it began with, at another path.  Steps are short enough for the branch to
    turn little in each; only a pair of folds much nearer to each other than a tenth of what the branch has covered may
    be passed over.

    The branch ends before the first path of which the mesh leaves out more than 1 % between the joints: beyond, its
    folds would be those of the mesh.

    Parameters
    ----------
    problem : BoundaryProblem with parameters
    target : as many numbers as the problem has parameters
    method : Galerkin; default degree 8
    intervals : number of equal intervals; or
    mesh : (N + 1,) joints; the mesh is the same for the whole branch
    guess : for the first path, as for `solve`

    Returns
    -------
    Branch of the paths on the way, with its folds; its last path is that of the target, where the branch leads there

    Raises
    ------
    ConvergenceError
        where the branch cannot be followed, or its first path is not resolved, with the last path attached
    ValueError, TypeError
        for input that does not fit

    Examples
    --------
    >>> import casadi as ca
    >>> bratu = lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * ca.exp(x[0])
    >>> problem = BoundaryProblem(bratu, (0, 1), [0.0], [0.0], parameters=[1.0])
    >>> continuation(problem, [4.0], intervals=10).folds[0].parameters.round(6)
    array([3.513831])
    """
    method = Galerkin(8) if method is None else method
    check_types(problem, method, BoundaryProblem)
    if problem.parameters is None:
        raise ValueError(
            "continuation changes the parameters of a problem, and this one has none: state it with parameters"
        )
    aim = np.array(numbers("target", target, len(problem.parameters)))
    if np.array_equal(aim, problem.parameters):
        raise ValueError(f"the target must differ from the problem's parameters, got {target!r} for both")
    transcription = transcribed(problem, method, intervals, mesh)
    refuse_free_phase("continuation", problem)
    check_mass(problem.varied({"parameters": aim.tolist()}))
    return BranchFollower(transcription, aim).run(guess)


@dataclass(frozen=True)
class Point:
    """A point z of the branch with its tangent, of any length, and the number of negative eigenvalues of ∇²S there."""

    z: np.ndarray
    tangent: np.ndarray
    trajectory: Trajectory
    negative: int | None

    @property
    def unresolved(self) -> str:
        """That the mesh does not resolve the path, and where; empty if it does."""
        return "".join(self.trajectory._unresolved(LOST)).strip()

    def on_branch_of(self, other: Point) -> bool:
        """Whether both points may lie on one branch: along it (-1)^`negative` ṡ has the sign of one determinant."""
        if self.negative is None or other.negative is None:
            return True
        turned = bool(self.tangent[-1] * other.tangent[-1] < 0)
        return turned == ((self.negative - other.negative) % 2 == 1)


class BranchFollower(Curve):
    """The state of a continuation along a branch."""

    tolerance = CONVERGED_STEP

    def __init__(self, transcription: Transcription, target: np.ndarray) -> None:
        self.transcription, self.stationarity = transcription, transcription.stationarity
        self.first, self.target = np.array(transcription.problem.parameters), target
        self.direction = target - self.first
        self.weights = np.ones(transcription.numbering.free + 1)
        self._lowest = self._highest = self._expected = np.zeros(transcription.numbering.free)
        # the last step that was not taken because it led to another branch, and the step after it
        self._across: tuple[Point, float] | None = None

    def parameters(self, z: np.ndarray) -> np.ndarray:
        """Parameters at a point z, exact at both ends."""
        near_first, near_target = self.first + z[-1] * self.direction, self.target - (1 - z[-1]) * self.direction
        return near_first if z[-1] < 0.5 else near_target

    def problem(self, z: np.ndarray) -> BoundaryProblem:
        """The problem at a point z."""
        return self.transcription.problem.varied({"parameters": self.parameters(z).tolist()})

    def data(self, z: np.ndarray) -> Data:
        """The graph's other inputs at a point z."""
        return self.transcription.for_problem(self.problem(z)).data(self.transcription.mesh)

    def directions(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The Newton step at fixed s, and the derivative dξ/ds."""
        unknowns, data = z[:-1], self.data(z)
        with self.stationarity.linearization() as at:
            (rate,) = at.evaluate("sensitivity", unknowns, data, self.direction)
            newton, follow = at.solve(at.relinearize(unknowns, data), rate)
        return newton, follow

    def solution(self, z: np.ndarray) -> Solution | None:
        """The path of a point z of the curve, verified; None where that moves it."""
        with suppress(SolveFailure):
            found = damped_newton(self.stationarity, z[:-1], self.data(z), max_iter=CORRECTOR_ITERATIONS)
            return found if self.length(np.append(found.unknowns - z[:-1], 0.0)) < CONVERGED_STEP else None
        return None

    def begin(self, z: np.ndarray, follow: np.ndarray) -> None:
        """Expect changes of the path up to the target from those a little way ahead, but at most its sizes.

        The first rate alone may be zero, or far too large near a fold.
        """
        size, change = np.abs(z[:-1]), np.abs(follow)
        self._lowest = self._highest = z[:-1]
        self._expected = np.where(size > ROUNDED * change, size, change)
        self.weigh(z)
        found = self.corrected(np.append(z[:-1], FIRST_STEP), np.append(0 * follow, 1.0), np.inf)
        if found is not None:
            ahead = np.abs(found[:-1] - z[:-1]) / FIRST_STEP
            self._expected = np.where(size > ROUNDED * ahead, np.minimum(ahead, size), ahead)

    def weigh(self, z: np.ndarray) -> None:
        """Set the weights of the path from how far its components have changed on the branch up to this point.

        Unlike the sizes of the components, these do not depend on the origin: all sheets of a branch stay apart.  What
        was expected at first counts less and less.
        """
        self._lowest, self._highest = np.minimum(self._lowest, z[:-1]), np.maximum(self._highest, z[:-1])
        changes = np.maximum.reduce((self._highest - self._lowest, self._expected, LEAST_OF_SIZE * np.abs(z[:-1])))
        largest = np.max(changes[: self.transcription.numbering.positions], initial=0.0)
        start, end, *further = self.data(z)
        sizes = self.stationarity.sizes(np.maximum(changes, LEAST_OF_ALL * largest), (0 * start, 0 * end, *further))
        self.weights[:-1] = 1 / (len(sizes) * sizes**2)
        self._expected = self._expected / 2

    def path(self, z: np.ndarray) -> PiecewisePolynomial:
        """The path of a point z."""
        return self.transcription.emb(z[:-1], self.data(z))

    def run(self, guess: Guess | None) -> Branch:
        """Follow the branch until the target or the start is reached, or a path that the mesh does not resolve."""
        start = self.transcription.critical_point(guess=guess)
        z = np.append(start.solution.unknowns, 0.0)
        follow = self.directions(z)[1]
        if not np.isfinite(follow).all():
            raise ConvergenceError(
                f"the branch cannot be followed from the parameters {self.first}: the path changes there at a rate "
                "that is not finite. Begin at other parameters",
                self.transcription.trajectory(start, 0.0),
            )
        self.begin(z, follow)
        points = [self.point(z, np.append(follow, 1.0), start)]
        if points[0].unresolved:
            raise ConvergenceError(f"the first path of the branch is {points[0].unresolved}", points[0].trajectory)
        folds, stopped = [], ""
        with progress("continuation", unit="path") as advance:
            for point in self.steps(points[0]):
                before = points[-1]
                if point.unresolved:
                    stopped = f"the next one, at {self.parameters(point.z)}, is {point.unresolved}"
                    break
                if point.tangent[-1] * before.tangent[-1] < 0:
                    folds.append(self.fold(before, point, len(points)))
                points.append(point)
                advance(1)
        parameters = np.array([self.parameters(point.z) for point in points])
        reached = bool(points[-1].z[-1] == 1)
        stopped = stopped or ("the target" if reached else "turned back to the start")
        return Branch(parameters, tuple(point.trajectory for point in points), tuple(folds), reached, stopped)

    def point(self, z: np.ndarray, tangent: np.ndarray, found: CriticalPoint) -> Point:
        """A verified point of the branch."""
        trajectory = self.transcription.trajectory(found, 0.0)
        return Point(z, tangent, trajectory, negative_eigenvalues(self.stationarity, z[:-1], self.data(z)))

    def steps(self, point: Point) -> Iterator[Point]:
        """Successive points; the steps are as long as the corrector converges."""
        step = FIRST_STEP
        for _ in range(POINTS):
            found, step = self.step(point, step)
            yield found
            if found.z[-1] in (0.0, 1.0):
                return
            point = found
        raise ConvergenceError(
            f"the branch was not followed to its end within {POINTS} paths; the last parameters are "
            f"{self.parameters(point.z)}. Its last path is attached to this error as `path`",
            point.trajectory,
        )

    def step(self, point: Point, step: float) -> tuple[Point, float]:
        """Take one step, shortened until it succeeds: the new point, and the next step."""
        self.weigh(point.z)
        tangent = self.unit(point.tangent)
        while step > SMALLEST_STEP:
            predicted, normal = point.z + step * tangent, tangent
            end = float(np.clip(predicted[-1], 0.0, 1.0))
            ends = bool(predicted[-1] != end)
            if ends:  # a step beyond the end is shortened to it
                share = (end - point.z[-1]) / tangent[-1]
                predicted, normal = point.z + share * tangent, np.append(np.zeros(len(point.z) - 1), 1.0)
                predicted[-1] = end
            z = self.corrected(predicted, normal, LONGEST_STEP)
            solution = None if z is None or not 0 <= z[-1] <= 1 else self.solution(z)
            if z is not None and solution is not None:
                z = np.append(solution.unknowns, z[-1])
                chord = self.unit(z - point.z)
                following = self.tangent(z, chord)
                bends = np.array([self.cosine(chord, tangent), self.cosine(chord, following)])
                returns = ends and following[-1] * tangent[-1] < 0  # from a fold beyond the end
                if np.all(bends > LEAST_COSINE) and not returns:  # NaN for a path that grows without bound
                    found = CriticalPoint(solution, self.problem(z), self.path(z))
                    with suppress(ConjugatePointError):  # the point is at a fold
                        taken = self.point(z, following, found), min(STEP_GROWTH * step, LONGEST_STEP)
                        if step < CROSSING_STEP or taken[0].on_branch_of(point):
                            return taken
                        self._across = taken
            step *= STEP_REDUCTION
        across, self._across = self._across, None
        if across is not None and self.length(across[0].z - point.z) <= LONGEST_STEP:
            return across  # another branch does cross here, and no short step succeeds so near to it
        raise ConvergenceError(
            f"the branch cannot be followed beyond the parameters {self.parameters(point.z)}: no step is short enough. "
            "Another branch may cross it there, or its paths grow without bound. "
            "Its last path is attached to this error as `path`",
            point.trajectory,
        )

    def fold(self, before: Point, after: Point, count: int) -> Fold:
        """Find the zero of ṡ between two points, by the secant and bisection on the chord between them."""
        tangent = self.unit(before.tangent)
        ends, rates = [before.z, after.z], [tangent[-1], after.tangent[-1]]
        level = FOLD_TOLERANCE * abs(rates[0] - rates[1])
        for iteration in range(ITERATIONS):
            if min(map(abs, rates)) < level:
                break
            share = 0.5 if iteration % 3 == 2 else rates[0] / (rates[0] - rates[1])
            z = self.corrected(ends[0] + share * (ends[1] - ends[0]), tangent, LONGEST_STEP)
            if z is None:
                continue
            rate = self.tangent(z, tangent)[-1]
            side = int(rate * rates[0] <= 0)
            ends[side], rates[side] = z, rate
        z = ends[int(abs(rates[1]) < abs(rates[0]))]
        return Fold(self.parameters(z), Path(self.path(z)), count)
