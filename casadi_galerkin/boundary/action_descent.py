"""A start for Newton's method where it finds none: lower the action on a mesh that follows the path.

Two things make a near-collision hard.  A step that is long compared with the distance to a singularity lands on its
other side, where the action may be lower; and the time of the passage is a valley of the action that is nearly flat
and sharply curved, because x at fixed times is far from linear in a shift of the path in time.

Against the first, steps are short and damped by added inertia, and after every few the mesh is drawn to where the path
turns.  Against the second, between two steps the joints alone are moved, at fixed x, so as to even out the jumps of the
energy, ∂S/∂t_i = 0.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from casadi_galerkin.boundary.transcription import Transcription
from casadi_galerkin.calculus.discrete_calculus import too_near
from casadi_galerkin.calculus.mesh_adaptation import equidistributed, graded_alike, truncation
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solvers.deadline import seconds_left

MESHES, STEPS = 80, 3  # at most, and between two of them
POOR, GOOD = 0.25, 0.75  # gain over the one promised below which a step is refused, above which the next may be longer
RELAXED = 1e-13  # promised relative gain of the action below which a relaxation has ended
LEAST, MOST = 1e-3, 1e12  # inertia that is added if any is, and at which no step will be found
LEAP = 0.03  # longest step, relative to the size of the path: longer ones do not stay on their side of a singularity
SQUEEZE = 0.5  # largest relative change of an interval in one step
FINER = 2.0  # an interval is split into at most this many between two meshes
MOST_INTERVALS = 120  # a path on its way needs no more; its front moves on
SETTLED = 1e-4  # relative step at which Newton's method can take over


def descend(
    transcribed: Callable[[np.ndarray], Transcription], path: PiecewisePolynomial, tol: float
) -> PiecewisePolynomial:
    """Lower the action of a path on meshes that resolve it to a tolerance, none with fewer intervals than the first.

    Parameters
    ----------
    transcribed : joints -> Transcription for as many intervals, of the path's degree
    path : PiecewisePolynomial that meets the ends
    tol : relative size of what the path may leave out on an interval

    Raises
    ------
    ConvergenceError
        if no step lowers the action, joints come too near to one another, or the time was up
    """
    inertia, fewest = 1.0, len(path.mesh) - 1
    for _ in range(MESHES):
        descent = ActionDescent(transcribed(path.mesh), path, inertia)
        ended = descent.run(STEPS)
        path, inertia, error = descent.path, descent.inertia, truncation(descent.path)
        if np.max(error) < 3 * tol and (ended or (descent.step < SETTLED and inertia == 0)):
            break
        if seconds_left() < 0:
            raise ConvergenceError("the time was up before a path was found", Path(path))
        mesh = equidistributed(path.mesh, error, len(path.nodes), tol, FINER, fewest)
        if len(mesh) - 1 > MOST_INTERVALS:
            mesh = graded_alike(mesh, MOST_INTERVALS)
        if np.any(too_near(mesh)):
            raise ConvergenceError("joints came too near to one another", Path(path))
        path = transcribed(mesh).guess_on_mesh(path, mesh)
    return path


class ActionDescent:
    """Damped steps that lower the action, each followed by one of the joints.

    Parameters
    ----------
    transcription : Transcription, for any mesh of as many intervals as `path` has
    path : PiecewisePolynomial of the transcription's degree
    inertia : added to the factor on ∂²L/∂v² (Levenberg and Marquardt in the kinetic metric)

    Attributes
    ----------
    path, inertia : where it has come to; 0 where plain Newton steps are good
    step : the last step relative to the size of the path
    """

    def __init__(self, transcription: Transcription, path: PiecewisePolynomial, inertia: float) -> None:
        self.transcription, self.path, self.inertia = transcription, path, inertia
        self.step = np.inf

    def action(self, path: PiecewisePolynomial) -> float:
        """Value of the discrete action; infinite where it is not defined."""
        (value,) = self._at.evaluate("action", *self.transcription.on_path(path))[0]
        return float(value) if np.isfinite(value) else np.inf

    def run(self, steps: int) -> bool:
        """Take some steps; True where no more can be gained.

        Raises
        ------
        ConvergenceError
            if no step lowers the action
        """
        with self.transcription.stationarity.linearization() as self._at:
            self._action = self.action(self.path)
            for _ in range(steps):
                if not self.advance():
                    return True
                derivatives = self._at.evaluate("joint_time_derivatives", *self.transcription.on_path(self.path))
                trial = retimed(self.path, *derivatives)
                action = self.action(trial)
                if action < self._action:
                    self.path, self._action = trial, action
        return False

    def advance(self) -> bool:
        """Take one step; False where it promises nothing."""
        arguments = self.transcription.on_path(self.path)
        sizes = self.transcription.stationarity.sizes(*arguments)
        while self.inertia <= MOST:
            g = self._at.relinearize(*arguments)
            self._at.weight_inertia(*arguments, 1.0 + self.inertia)
            (step,) = self._at.solve(g)
            self.step = float(np.max(np.abs(step) / sizes))
            promised = -float(g @ step)
            if np.isfinite(self.step) and self.step <= LEAP and promised >= 0:
                if promised <= RELAXED * abs(self._action):
                    return False
                values = self.path.values + self.transcription.change(step)
                trial = PiecewisePolynomial(self.path.mesh, self.path.nodes, values)
                action = self.action(trial)
                gain = 2 * (self._action - action) / promised
                if gain > POOR:
                    self.path, self._action = trial, action
                    if gain > GOOD:
                        self.inertia = self.inertia / 3 if self.inertia > LEAST else 0.0
                    return True
            self.inertia = max(3 * self.inertia, LEAST)
        raise ConvergenceError("no step lowers the action", Path(self.path))


def retimed(
    path: PiecewisePolynomial, slope: np.ndarray, diagonal: np.ndarray, beside: np.ndarray
) -> PiecewisePolynomial:
    """Newton step of the inner joints at fixed node values; the same path where it is not defined.

    `slope` (N + 1,), and `diagonal` (N + 1,) and `beside` (N,) of a tridiagonal matrix, are the action's derivatives by
    all joints.
    """
    pivots, rhs, upper = diagonal.tolist(), (-slope).tolist(), beside.tolist()
    shift = [0.0] * len(rhs)  # of Python's numbers, which do not warn of what is not finite
    try:
        for i in range(2, len(shift) - 1):  # symmetric elimination without the ends; faster here than a dense solve
            factor = upper[i - 1] / pivots[i - 1]
            pivots[i] -= factor * upper[i - 1]
            rhs[i] -= factor * rhs[i - 1]
        for i in range(len(shift) - 2, 0, -1):
            shift[i] = (rhs[i] - upper[i] * shift[i + 1]) / pivots[i]
    except ZeroDivisionError:
        return path
    if not np.all(np.isfinite(shift)):
        return path
    largest = float(np.max(np.abs(np.diff(shift)) / np.diff(path.mesh)))
    return PiecewisePolynomial(path.mesh + np.array(shift) * (SQUEEZE / max(largest, SQUEEZE)), path.nodes, path.values)
