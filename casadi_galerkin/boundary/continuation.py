"""Follow a branch of critical paths while the parameters of a problem change, past its folds and branch points.

The parameters move on the line p(s) = p_0 + s (p_1 - p_0) from the problem's own to the target.  The branch is the
curve ∇S(ξ, p(s)) = 0, followed by its arc length (`solvers.curve`).  At a fold the Hessian is singular and ṡ changes
its sign; the branch then leads back, with another Morse index.  The fold is found as the zero of ṡ.  Where the sign of
(-1)^index ṡ changes, another branch crosses.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.boundary.branch import TARGET, Branch, BranchPoint, Fold
from casadi_galerkin.boundary.graph import CriticalPoint
from casadi_galerkin.boundary.transcription import Transcription, transcribed
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.numbers import numbers, whole_number
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.functional.buffers import interrupts_raised
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.legendre_transform import singular_mass
from casadi_galerkin.problems.problem import check_types, with_values
from casadi_galerkin.problems.statements import check
from casadi_galerkin.solution.errors import ConjugatePointError, ConvergenceError
from casadi_galerkin.solution.guess import Guess, refuse_free_phase
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solution.progress import Advance, progress
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.solvers.curve import Crossing, Curve, Point
from casadi_galerkin.solvers.newton import POLISHING, Solution, SolveFailure, damped_newton
from casadi_galerkin.solvers.second_variation import negative_eigenvalues

LOST = "cannot be followed beyond the parameters"
# last Newton step after which the next one is at roundoff; |ṡ| at a fold over its change between the points around it,
# where the error of s is of the order of the square
ACCURACY = EPS**0.5
# least change of an unknown that counts, over its size and over the largest change: rounding then leaves steps of
# EPS^(2/3), below ACCURACY; distance over the sizes of paths below which branch points are one; and a step so short
# that it passes what is no simple branch point, and has not jumped to a branch nearby
LEAST_CHANGE = EPS ** (1 / 3)


@interrupts_raised()
def continuation(
    problem: BoundaryProblem,
    target: Sequence[float],
    method: Galerkin | None = None,
    intervals: int | None = None,
    *,
    branches: int = 0,
    mesh: ArrayLike | None = None,
    guess: Guess | None = None,
) -> Branch:
    """Follow a path while the parameters change from the problem's own to a target.

    At a fold the path meets another one, and beyond it neither exists.  Where a fold lies between, the branch turns
    back there, and ends at the parameters it began with, at another path.  At a branch point other paths cross; with
    `branches`, these are followed as well, to both sides and from all of their own branch points, as far as they stay
    between the problem's parameters and the target's.  Steps are short enough for the branch to turn little in each;
    only a pair of folds much nearer to each other than a tenth of what the branch has covered may be passed over.

    The branch ends before the first path of which the mesh leaves out more than a thousandth between the joints:
    beyond, its folds would be those of the mesh.

    Parameters
    ----------
    problem : BoundaryProblem with parameters
    target : as many numbers as the problem has parameters
    method : Galerkin; default degree 8
    intervals : number of equal intervals; or
    mesh : (N + 1,) joints; the mesh is the same for the whole branch
    branches : largest number of branches, that of the problem's own path included; zero for this alone
    guess : for the first path, as for `solve`

    Returns
    -------
    Branch of the paths on the way, with its folds and branch points; its last path is that of the target, where the
    branch leads there.  With `branches`, it has the `others`, too

    Raises
    ------
    ConvergenceError
        where the branch cannot be followed, or its first path is not resolved, with the last path attached; in a
        diagram, `Branch.stopped` says where a branch could not be followed
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
    branches = whole_number("branches", branches, 0)
    transcription = transcribed(problem, method, intervals, mesh)
    refuse_free_phase("continuation", problem)
    follower = BranchFollower(transcription, aim)
    first = follower.first_point(guess)
    with progress("continuation", unit="path") as advance:
        follower.advance = advance
        branch = follower.follow(first)
        if branches:
            return follower.with_others(branch, branches)
    if branch.stopped.startswith(LOST):
        words = f"the branch {branch.stopped}. Its last path is attached to this error as `path`"
        raise ConvergenceError(words, branch.trajectories[-1])
    return branch


@dataclass(frozen=True, eq=False)
class PathPoint(Point):
    """A point of the branch with its path.

    Attributes
    ----------
    trajectory : None at a branch point
    negative : number of negative eigenvalues of ∇²S; None where that is unknown
    parity : sign that is the same all along the branch between branch points; NaN where unknown
    crossing : branch point on the step that led here
    missed : whether the number of negative eigenvalues has changed by more than that step explains
    """

    trajectory: Trajectory | None = None
    negative: int | None = None
    parity: float = np.nan
    crossing: Crossing | None = None
    missed: bool = False


@dataclass
class Node:
    """A branch point of a diagram: tangents of both curves through it, and the sides of the other one yet to follow.

    `extent` is how far the branch that found it had led.
    """

    z: np.ndarray
    found: BranchPoint
    own: np.ndarray
    other: np.ndarray | None
    sides: list[float]
    extent: tuple[np.ndarray, np.ndarray]


class BranchFollower(Curve[PathPoint]):
    """The state of a continuation along the branches of a problem."""

    tolerance, least_cosine, smallest_step, longest_step = ACCURACY, 0.95, 1e-12, 0.1
    advance: Advance

    def __init__(self, transcription: Transcription, target: np.ndarray) -> None:
        self.transcription = transcription
        start, end, mesh, parameters, *given = transcription.data(transcription.mesh)
        super().__init__(
            transcription.stationarity, (start, end, mesh, parameters, *given), (start, end, mesh, target, *given)
        )
        # other rules may hold no longer where the branch turns back before
        check(self.problem(np.ones(1)), [singular_mass])
        self.weights = np.ones(transcription.numbering.free + 1)
        self.nodes: list[Node] = []

    def parameters(self, z: np.ndarray) -> np.ndarray:
        """Parameters at a point z."""
        _, _, _, parameters, *_ = self.data(z[-1])
        return parameters

    def problem(self, z: np.ndarray) -> BoundaryProblem:
        """The problem at a point z."""
        return with_values(self.transcription.problem, parameters=tuple(self.parameters(z).tolist()))

    def solution(self, z: np.ndarray) -> Solution | None:
        """The path of a point z of the curve, verified; None where that moves it."""
        with suppress(SolveFailure):
            found = damped_newton(self.stationarity, z[:-1], self.data(z[-1]), max_iter=POLISHING)
            return found if self.length(np.append(found.unknowns - z[:-1], 0.0)) < ACCURACY else None
        return None

    def path(self, z: np.ndarray) -> Path:
        """The path of a point z."""
        return Path(self.transcription.emb(z[:-1], self.data(z[-1])))

    def first_point(self, guess: Guess | None) -> PathPoint:
        """The first path of the branch, with the tangent that leads to the target."""
        start = self.transcription.critical_point(guess=guess)
        z = np.append(start.solution.unknowns, 0.0)
        follow = self.directions(z)[1]
        if not np.isfinite(follow).all():
            raise ConvergenceError(
                f"the branch cannot be followed from the parameters {self.parameters(z)}: the path changes there at a "
                "rate that is not finite. Begin at other parameters",
                self.transcription.trajectory(start, 0.0),
            )
        size, change = np.abs(z[:-1]), np.abs(follow)
        self._lowest = self._highest = z[:-1]
        self._expected = np.where(size > ACCURACY * change, size, change)  # the rate may be zero, or large near a fold
        point = self.point(z, np.append(follow, 1.0), start)
        assert point.trajectory is not None
        if unresolved := list(point.trajectory._unresolved()):
            words = f"the first path of the branch is {' '.join(*unresolved)}"
            raise ConvergenceError(words, point.trajectory)
        return point

    def weigh(self, z: np.ndarray) -> None:
        """Set the weights of the path from how far its components have changed on the branch up to this point.

        Unlike the sizes of the components, these do not depend on the origin: all sheets of a branch stay apart.  What
        was expected at first counts less and less.
        """
        self._lowest, self._highest = np.minimum(self._lowest, z[:-1]), np.maximum(self._highest, z[:-1])
        changes = np.maximum.reduce((self._highest - self._lowest, self._expected, LEAST_CHANGE * np.abs(z[:-1])))
        largest = np.max(changes[: self.transcription.numbering.positions], initial=0.0)
        start, end, *further = self.data(z[-1])
        sizes = self.stationarity.sizes(np.maximum(changes, LEAST_CHANGE * largest), (0 * start, 0 * end, *further))
        self.weights[:-1] = 1 / (len(sizes) * sizes**2)
        self._expected = self._expected / 2

    def point(self, z: np.ndarray, tangent: np.ndarray, found: CriticalPoint) -> PathPoint:
        """A verified point of the branch."""
        trajectory = self.transcription.trajectory(found, 0.0)
        return PathPoint(z, tangent, trajectory, *self.parity(z, tangent))

    def parity(self, z: np.ndarray, tangent: np.ndarray) -> tuple[int | None, float]:
        """The number of negative eigenvalues, and the sign that changes at branch points alone."""
        negative = negative_eigenvalues(self.stationarity, z[:-1], self.data(z[-1]))
        if negative is None:
            return None, self.orientation(z, tangent)
        return negative, float(np.sign(tangent[-1]) * (-1) ** negative)

    def taken(self, point: PathPoint, step: float) -> PathPoint | None:
        """The point after one step, with the branch point on the way; None where the step was too long."""
        tangent = self.unit(point.tangent)
        predicted, normal = point.z + step * tangent, tangent
        end = float(np.clip(predicted[-1], 0.0, 1.0))
        ends = bool(predicted[-1] != end)
        if ends:  # a step beyond the end is shortened to it
            predicted, normal = point.z + (end - point.z[-1]) / tangent[-1] * tangent, np.eye(len(tangent))[-1]
            predicted[-1] = end
        z = self.corrected(predicted, normal, self.longest_step)
        solution = None if z is None or not 0 <= z[-1] <= 1 else self.solution(z)
        if z is None or solution is None:
            return None
        z = np.append(solution.unknowns, z[-1])
        chord = self.unit(z - point.z)
        following = self.tangent(z, chord)
        bends = np.array([self.cosine(chord, tangent), self.cosine(chord, following)])
        turned = point.trajectory is not None and bool(following[-1] * tangent[-1] < 0)
        if not np.all(bends > self.least_cosine) or (ends and turned):  # NaN for a path that grows without bound
            return None  # or it returns from a fold beyond the end
        try:
            found = self.point(z, following, self.transcription.for_problem(self.problem(z)).point(solution))
        except ConjugatePointError:  # the point is at a fold
            return None
        crossed = bool(found.parity * point.parity < 0)
        crossing = self.crossing(point, found) if crossed else None
        change = 0 if found.negative is None or point.negative is None else abs(found.negative - point.negative)
        missed = (crossed and crossing is None) or change > turned + crossed
        if missed and step >= LEAST_CHANGE:
            return None
        return replace(found, crossing=crossing, missed=missed)

    def crossing(self, one: PathPoint, other: PathPoint) -> Crossing | None:
        """The branch point between two points; None if there is none, as between points of two branches."""
        chord = other.z - one.z
        found = self.branch_point(one.z + chord / 2, self.unit(chord))
        near = found is not None and self.length(found.z - one.z - chord / 2) <= self.length(chord)
        return found if near else None

    def fold(self, before: PathPoint, after: PathPoint) -> np.ndarray:
        """The zero of ṡ between two points, by the secant and bisection on the chord between them."""
        tangent = self.unit(before.tangent)
        ends, rates = [before.z, after.z], [tangent[-1], after.tangent[-1]]
        level = ACCURACY * abs(rates[0] - rates[1])
        for iteration in range(POLISHING):
            if min(map(abs, rates)) < level:
                break
            fraction = 0.5 if iteration % 3 == 2 else rates[0] / (rates[0] - rates[1])
            z = self.corrected(ends[0] + fraction * (ends[1] - ends[0]), tangent, self.longest_step)
            if z is None:
                continue
            rate = self.tangent(z, tangent)[-1]
            side = int(rate * rates[0] <= 0)
            ends[side], rates[side] = z, rate
        return ends[int(abs(rates[1]) < abs(rates[0]))]

    def follow(self, first: PathPoint, origin: BranchPoint | None = None) -> Branch:
        """Follow a branch until the target or the start is reached, or a path that the mesh does not resolve."""
        points = [] if first.trajectory is None else [first]
        folds, crossed, missed = list[Fold](), list[BranchPoint](), list[int]()
        before, stopped = first, ""
        self.weigh(first.z)
        for point in self.walk(first):
            assert point.trajectory is not None
            if unresolved := list(point.trajectory._unresolved()):
                stopped = f"the next one, at {self.parameters(point.z)}, is {' '.join(*unresolved)}"
                break
            after = len(points)
            if point.missed:
                missed.append(after)
            known = point.crossing is not None and self.known(point, point.crossing, after, crossed)
            if before.trajectory is not None and point.tangent[-1] * before.tangent[-1] < 0:
                apex = self.fold(before, point) if point.crossing is None else point.crossing.z
                folds.append(Fold(self.parameters(apex), self.path(apex), after))
            if known:
                stopped = "joined to one that was followed before"
                break
            points.append(point)
            self.advance(1)
            before = point
            self.weigh(point.z)
            if point.z[-1] in (0.0, 1.0):
                stopped = TARGET if point.z[-1] else "turned back to the start"
                break
        else:
            stopped = (
                f"{LOST} {self.parameters(before.z)}: no step is short enough. "
                "Another branch may cross it there, or its paths grow without bound"
            )
        paths = tuple(point.trajectory for point in points if point.trajectory is not None)
        return Branch(paths, tuple(folds), tuple(crossed), stopped, tuple(missed), origin)

    def known(self, point: PathPoint, crossing: Crossing, after: int, crossed: list[BranchPoint]) -> bool:
        """Record a branch point that was passed; whether the curve beyond it was followed before."""
        tangent = self.unit(point.tangent)
        for node in self.nodes:
            apart = np.abs(crossing.z - node.z)[: self.transcription.numbering.positions]
            sizes = np.abs(node.z) + (0.0 if node.other is None else np.abs(node.other))
            if abs(crossing.z[-1] - node.z[-1]) < LEAST_CHANGE and np.max(apart) < LEAST_CHANGE * np.max(sizes):
                crossed.append(replace(node.found, after=after))
                lines = [
                    0.0 if line is None else abs(self.cosine(tangent, self.unit(line)))
                    for line in (node.own, node.other)
                ]
                new = lines[1] > lines[0] and len(node.sides) == 2
                if lines[1] > lines[0]:
                    node.sides.clear()
                return not new
        path, change = self.path(crossing.z), self.transcription.change(crossing.null_vector)
        variation = Path(PiecewisePolynomial(path.t, path.polynomial.nodes, change))
        found = BranchPoint(self.parameters(crossing.z), path, variation, after)
        sides = [] if crossing.other is None else [-1.0, 1.0]
        self.nodes.append(Node(crossing.z, found, tangent, crossing.other, sides, (self._lowest, self._highest)))
        crossed.append(found)
        return False

    def with_others(self, first: Branch, most: int) -> Branch:
        """A branch with the others from all branch points, followed one after the other until there are so many."""
        others = list[Branch]()
        while 1 + len(others) < most and (nodes := [node for node in self.nodes if node.sides]):
            node = nodes[0]
            assert node.other is not None
            (self._lowest, self._highest), self._expected = node.extent, np.abs(node.other[:-1])
            branch = self.follow(PathPoint(node.z, node.sides.pop() * node.other), node.found)
            others += [branch] if branch.trajectories else []
        return replace(first, others=tuple(others), waiting=sum(len(node.sides) for node in self.nodes))
