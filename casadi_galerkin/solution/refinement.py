"""The loop of every refinement: estimate the error, stop, or solve on a better mesh.

The loop, its limits and its report are here.  The folders `boundary` and `control` bring the rest: a solve, a witness
of the error, and a rule for the next mesh.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.solution.errors import ConvergenceError, LimitReached, Limits
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solution.progress import progress
from casadi_galerkin.solution.quantity import Quantity
from casadi_galerkin.solution.trajectory import Trajectory

# distance over the duration within which a breakpoint may be the cause of an error that stays
BREAKPOINT_DISTANCE = 1e-2
HINT = "Try a looser tolerance, a guess nearer to the path, or higher limits"
NOT_SMOOTH = (
    "Either L is not smooth there: name that time in the breakpoints of the problem, or smooth a step in x, as by "
    "tanh. Or the path passes through a singularity: give a guess that leads around it"
)
NO_NEARER = (
    "Try another tolerance, looser or tighter, breakpoints where controls switch, more intervals to begin with, or a "
    "guess nearer to the path"
)

Level = TypeVar("Level")
Detail = TypeVar("Detail")


@dataclass(frozen=True)
class Estimate(Generic[Detail]):
    """The estimated error of a path.

    Attributes
    ----------
    error : largest relative error
    trusted : whether a path may be accepted by it; otherwise it only shows where the mesh is too coarse
    source : what the error was estimated from, in words
    detail : the information for the next mesh
    """

    error: float
    trusted: bool
    source: str
    detail: Detail


class Refinement(ABC, Generic[Level, Detail]):
    """The state of one refinement to a tolerance, of x or of a quantity `of` the path.

    A quantity is asked for where x is known to a loose tolerance.  Where it is not within its own, that of x is
    tightened in proportion, as if the two errors fell alike, but not below its own tolerance at first.

    Attributes
    ----------
    goal : the tolerance that was asked for
    tol, first_tol : the tolerance of x, which meshes are made for, now and where refinement begins
    asked : the path of the smallest known error of the quantity so far, with that error
    roundoff_level : an error below it that does not fall to half is taken to be at the roundoff floor
    persistence : largest number of levels in a row that come no nearer
    best : level of the smallest trusted error so far, and that error; where none is trusted yet, the last level
    """

    roundoff_level: float
    persistence = math.inf
    best: tuple[Level, float]
    asked: Trajectory | None = None
    reported = 0  # iterations that have been printed

    def __init__(
        self,
        tol: float,
        method: Galerkin,
        breakpoints: tuple[float, ...],
        limits: Limits,
        verbose: int,
        of: Quantity | None = None,
    ) -> None:
        self.goal, self.of = tol, of
        self.tol = self.first_tol = tol if of is None else math.sqrt(tol)
        self.method, self.breakpoints, self.limits, self.verbose = method, breakpoints, limits, verbose
        self.began = time.perf_counter()
        self.deadline = self.began + limits.seconds

    @property
    @abstractmethod
    def iterations(self) -> int:
        """Iterations of the solver in all levels."""

    @abstractmethod
    def estimate(self, level: Level) -> Estimate[Detail]:
        """Estimate the error of the path of a level."""

    @abstractmethod
    def better_mesh(self, level: Level, estimate: Estimate[Detail]) -> np.ndarray:
        """Joints of the next level."""

    @abstractmethod
    def solve_on(self, mesh: np.ndarray, level: Level) -> Level:
        """Solve on the next mesh, from what is known since the last level."""

    @abstractmethod
    def shortest(self, mesh: np.ndarray) -> np.ndarray:
        """Lengths that intervals of a mesh must exceed, (N,) or for all."""

    @abstractmethod
    def answer(self, level: Level, error: float | None) -> Path:
        """The path of a level, or the one `asked`, to be attached to the error where the refinement is stopped."""

    @abstractmethod
    def trajectory(self, level: Level, estimate: Estimate[Detail]) -> Trajectory:
        """The path of a level whose error is known, to be asked for a quantity."""

    @abstractmethod
    def solved(self, level: Level) -> tuple[int, int, float]:
        """Degree and intervals of one level, and the residual that the solver has left."""

    def not_smooth(self, when: float, duration: float) -> str:
        """Say why the error near a time may not fall."""
        rule = self.method.quadrature
        beside = [time for time in self.breakpoints if abs(time - when) <= BREAKPOINT_DISTANCE * duration]
        if beside and {0.0, 1.0}.intersection(rule.points):
            return (
                f"The quadrature has a point at the joint t = {beside[0]:.9g}, a breakpoint, and sees one side of a "
                f"jump there: take gauss({len(rule)}), whose points are inside the intervals"
            )
        return NOT_SMOOTH

    def out_of_time(self) -> bool:
        """Whether the time is up."""
        return time.perf_counter() > self.deadline

    def refine(self, level: Level) -> tuple[Level, float]:
        """Solve on better and better meshes until the estimated error is below the tolerance; returns both.

        Raises
        ------
        LimitReached
            with the best path attached
        """
        smallest, number, without_improvement = np.inf, 0, 0
        self.best, self.tol, self.asked = (level, np.inf), self.first_tol, None
        with progress("refinement", unit="level") as advance:
            while True:
                estimate = self.estimate(level)
                self._report(number, level, estimate)
                error, asked = self.error(level, estimate)
                if asked is not None and (self.asked is None or error < (self.asked.asked_error or 0.0)):
                    self.asked = asked
                if error <= self.goal:
                    return level, estimate.error
                if asked is not None:
                    self.tol = min(estimate.error / 2, max(self.goal, estimate.error * math.sqrt(self.goal / error)))
                at_floor, nearer = smallest / 2 < error < self.roundoff_level, error < smallest
                without_improvement = 0 if nearer else without_improvement + 1
                if nearer or smallest == np.inf:
                    self.best = level, estimate.error if self.asked is None else error
                smallest = min(smallest, error)
                if at_floor:
                    raise self.stopped(f"{self.goal:g} asked, {smallest:.0e} is the roundoff floor here", *self.best)
                self.check_time()
                if without_improvement >= self.persistence:
                    raise self.stopped(f"{without_improvement} levels in a row came no nearer", *self.best, NO_NEARER)
                if number + 1 >= self.limits.levels:
                    words = "level was" if self.limits.levels == 1 else "levels were"
                    raise self.stopped(f"{self.limits.levels:g} {words} not enough", *self.best)
                mesh = self.better_mesh(level, estimate)
                self.check_mesh(mesh, estimate)
                try:
                    level, number = self.solve_on(mesh, level), number + 1
                    advance(1)
                except ConvergenceError:
                    self.check_time()
                    raise

    def error(self, level: Level, estimate: Estimate[Detail]) -> tuple[float, Trajectory | None]:
        """The error of what is asked for, infinite where it is not known, and the path that was asked a quantity."""
        if not estimate.trusted:
            return np.inf, None
        if self.of is None:
            return estimate.error, None
        if estimate.error > self.first_tol:
            return np.inf, None
        path = self.trajectory(level, estimate).asked_for(self.of)
        return path.asked_error or 0.0, path

    def check_mesh(self, mesh: np.ndarray, estimate: Estimate[Detail]) -> None:
        """Stop where a mesh has too many intervals, or one that is too short."""
        steps, duration = np.diff(mesh), mesh[-1] - mesh[0]
        excess = steps / self.shortest(mesh)
        i, few = int(np.argmin(excess)), len(steps) <= self.limits.intervals
        if few and excess[i] > 1:
            return
        needs = f"intervals of {max(steps[i], 0.0):.1e}" if few else f"{len(steps)} intervals"
        shortest = f", the shortest near t = {mesh[i]:.9g}. {self.not_smooth(mesh[i], duration)}"
        source = f"estimated from {estimate.source}{shortest if few else ''}"
        reason = f"the mesh would need {needs} for an error of {estimate.error:.1e}, {source}"
        raise self.stopped(reason, *self.best)

    def check_time(self) -> None:
        """Stop where the time is up."""
        if self.out_of_time():
            raise self.stopped(f"{self.limits.seconds:g} seconds have passed", *self.best)

    def stopped(self, reason: str, level: Level, error: float, hint: str = HINT) -> LimitReached:
        """The error that reports the error reached and what to try, with the best path attached.

        Where times are so far from zero that their rounding may be the cause, it says so.
        """
        path = self.answer(level, error if self.asked is None else self.asked.error_estimate)
        if self.of is not None:
            error = np.inf if self.asked is None else self.asked.asked_error or 0.0
        latest, duration = float(np.max(np.abs(path.t))), float(np.ptp(path.t))
        if latest > duration and EPS * latest > self.tol * duration:
            hint = f"Times near {latest:.1e} are rounded by {EPS * latest:.0e}: count them from the start"
        known = f"an estimated error of {error:.1e}" if np.isfinite(error) else "no finite error estimate"
        return LimitReached(
            f"tolerance {self.goal:g} was not reached: {reason}. The best path has {len(path.t) - 1} intervals "
            f"and {known}; it is attached to this error as `path`. {hint}",
            path,
            self.solved(level)[2],
            self.iterations,
        )

    def late(self, failure: ConvergenceError) -> LimitReached:
        """The error for a failure after which the time is up, before there was a path."""
        words = f"{self.limits.seconds:g} seconds have passed before there was a path: {failure}"
        return LimitReached(words, failure.path, failure.residual, self.iterations)

    def _report(self, number: int, level: Level, estimate: Estimate[Detail]) -> None:
        """Print one line per level, with the iterations since the last one."""
        if not self.verbose:
            return
        if number == 0:
            print(f"{'Level':>7}{'Degree':>8}{'Intervals':>11}{'Iterations':>12}{'Max error':>12}  Estimated from")
        (degree, intervals, _), iterations = self.solved(level), self.iterations - self.reported
        self.reported = self.iterations
        print(f"{number:7d}{degree:8d}{intervals:11d}{iterations:12d}{estimate.error:12.2e}  {estimate.source}")
