"""A start for Newton's method where it finds none: lower the action on a mesh that follows the path.

Two things make a near-collision hard.  A step that is long compared with the distance to a singularity lands on its
other side, where the action may be lower; and the time of the passage is a valley of the action that is nearly flat
and sharply curved, because x at fixed times is far from linear in a shift of the path in time.

Against the first, steps are short and damped by added inertia, and after every few the mesh is drawn to where the
path turns.  Against the second, after each step the joints alone are moved, at fixed x, so as to even out the jumps of
the energy, ∂S/∂t_i = 0.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from casadi_galerkin.boundary.transcription import Transcription
from casadi_galerkin.calculus.discrete_calculus import too_near
from casadi_galerkin.calculus.mesh_adaptation import equidistributed, resized_mesh, truncation_error
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solvers.deadline import seconds_left

MESHES, STEPS = 80, 3  # at most, and between two of them
RELAXED = 1e-13  # promised relative gain of the action below which there is none
MOST = 1e12  # inertia at which no step will be found
LEAP = 0.03  # longest step, relative to the size of the path: longer ones do not stay on their side of a singularity
SQUEEZE = 0.5  # largest relative change of an interval in one step
MOST_INTERVALS = 120  # a path on its way needs no more; its front moves on


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
        transcription = transcribed(path.mesh)
        for _ in range(STEPS):
            before = path
            path, inertia = lowered(transcription, path, inertia)
        error = truncation_error(path)
        if path is before and np.max(error) < 3 * tol:
            break
        if seconds_left() < 0:
            raise ConvergenceError("the time was up before a path was found", Path(path))
        mesh = equidistributed(path.mesh, error, len(path.nodes), tol, fewest=fewest)
        if len(mesh) - 1 > MOST_INTERVALS:
            mesh = resized_mesh(mesh, MOST_INTERVALS)
        if np.any(too_near(mesh)):
            raise ConvergenceError(
                "no path was found: as the action fell, joints came too near to one another", Path(path)
            )
        path = transcribed(mesh).guess_on_mesh(path, mesh)
    return path


def lowered(
    transcription: Transcription, path: PiecewisePolynomial, inertia: float
) -> tuple[PiecewisePolynomial, float]:
    """Take one damped step that lowers the action, and one of the joints if it lowers the action, too.

    Parameters
    ----------
    transcription : Transcription, for any mesh of as many intervals as `path` has
    path : PiecewisePolynomial of the transcription's degree
    inertia : added to the factor on ∂²L/∂v² (Levenberg and Marquardt in the kinetic metric), more if it is too little

    Returns
    -------
    the path it leads to, the same one where no step promises a gain; and the inertia to begin the next one with

    Raises
    ------
    ConvergenceError
        if no step lowers the action
    """
    unknowns, data = transcription.on_path(path)
    sizes = transcription.stationarity.sizes(unknowns, data)
    with transcription.stationarity.linearization() as at:

        def action(of_path: PiecewisePolynomial) -> float:
            """Value of the discrete action."""
            return float(at.evaluate("action", *transcription.on_path(of_path))[0][0])

        present = action(path)
        g = at.relinearize(unknowns, data)
        while inertia <= MOST:
            at.weight_inertia(unknowns, data, 1.0 + inertia)
            (step,) = at.solve(g)
            promised = -float(g @ step)
            if np.max(np.abs(step) / sizes) <= LEAP and promised >= 0:
                if promised <= RELAXED * abs(present):
                    return path, inertia
                trial = transcription.emb(unknowns + step, data)
                if action(trial) < present:
                    derivatives = at.evaluate("joint_time_derivatives", unknowns + step, data)
                    return min(trial, retimed(trial, *derivatives), key=action), inertia / 3
            inertia *= 3
    raise ConvergenceError("no path was found: no step lowers the action further", Path(path))


def retimed(
    path: PiecewisePolynomial, slope: np.ndarray, diagonal: np.ndarray, beside: np.ndarray
) -> PiecewisePolynomial:
    """Newton step of the inner joints at fixed node values; the same path where it is not defined.

    `slope` (N + 1,), and `diagonal` (N + 1,) and `beside` (N,) of a tridiagonal matrix, are the action's derivatives by
    all joints.
    """
    inner, shift = slice(1, -1), np.zeros(len(slope))
    matrix = np.diag(diagonal[inner]) + np.diag(beside[inner], 1) + np.diag(beside[inner], -1)
    try:
        shift[inner] = np.linalg.solve(matrix, -slope[inner])
    except np.linalg.LinAlgError:
        return path
    if not np.all(np.isfinite(shift)):
        return path
    largest = float(np.max(np.abs(np.diff(shift)) / np.diff(path.mesh)))
    return PiecewisePolynomial(path.mesh + shift * (SQUEEZE / max(largest, SQUEEZE)), path.nodes, path.values)
