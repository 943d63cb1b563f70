"""A guess for Newton's method where others fail: descent of the action on a mesh that is adapted to the path.

A near-collision is difficult for two reasons.  A step that is longer than the distance to a singularity leads to its
other side, where the action may be lower.  And the action hardly depends on the time of the passage: along shifts of
the path in time it has a nearly flat, sharply curved valley, because x at fixed times depends on a shift nonlinearly.

Against the first, steps are short and damped by added inertia, and after every few steps the mesh is refined where the
path turns.  Against the second, after each step the joints alone are moved, at fixed x, to reduce the jumps of the
energy, ∂S/∂t_i = 0.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from casadi_galerkin.boundary.transcription import Transcription
from casadi_galerkin.calculus.discrete_calculus import too_near
from casadi_galerkin.calculus.mesh_adaptation import equidistributed, parts_wanted, resized_mesh, truncation_error
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solvers.deadline import seconds_left

DESCENT_MESHES, STEPS_ON_A_MESH = 80, 3  # largest number of meshes, and steps on each
LEAST_DECREASE = 1e-13  # predicted relative decrease of the action at which the descent ends
LARGEST_INERTIA = 1e12  # largest inertia that is tried
LONGEST_MOVE = 0.03  # longest step relative to the size of the path: longer ones may cross a singularity
LARGEST_JOINT_MOVE = 0.5  # largest relative change of an interval in one step
MOST_INTERVALS = 120  # largest number of intervals during a descent


def descend(
    transcribed: Callable[[np.ndarray], Transcription], path: PiecewisePolynomial, tol: float
) -> PiecewisePolynomial:
    """Lower the action of a path on meshes that resolve it to a tolerance, none with fewer intervals than the first.

    Parameters
    ----------
    transcribed : joints -> Transcription of the path's degree for as many intervals
    path : PiecewisePolynomial that meets the ends
    tol : largest relative truncation error on an interval

    Raises
    ------
    ConvergenceError
        if no step lowers the action, joints come too near to one another, or the time was up
    """
    inertia, fewest = 1.0, len(path.mesh) - 1
    for _ in range(DESCENT_MESHES):
        transcription = transcribed(path.mesh)
        for _ in range(STEPS_ON_A_MESH):
            before = path
            path, inertia = lowered(transcription, path, inertia)
        error = truncation_error(path)
        if path is before and np.max(error) < 3 * tol:
            break
        if seconds_left() < 0:
            raise ConvergenceError("the time was up before a path was found", Path(path))
        mesh = equidistributed(path.mesh, parts_wanted(error, len(path.nodes), tol), fewest=fewest)
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
    inertia : first value that is added to the factor of ∂²L/∂v² (Levenberg-Marquardt damping in the kinetic metric); it
        is increased until a step succeeds

    Returns
    -------
    the path after the step, or the same one where no decrease is predicted; and the inertia for the next step

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
        while inertia <= LARGEST_INERTIA:
            at.weight_inertia(unknowns, data, 1.0 + inertia)
            (step,) = at.solve(g)
            promised = -float(g @ step)
            if np.max(np.abs(step) / sizes) <= LONGEST_MOVE and promised >= 0:
                if promised <= LEAST_DECREASE * abs(present):
                    return path, inertia
                trial = transcription.emb(unknowns + step, data)
                if action(trial) < present:
                    (joint_step,) = at.evaluate("joint_step", unknowns + step, data)
                    return min(trial, retimed(trial, joint_step), key=action), inertia / 3
            inertia *= 3
    raise ConvergenceError("no path was found: no step lowers the action further", Path(path))


def retimed(path: PiecewisePolynomial, step: np.ndarray) -> PiecewisePolynomial:
    """Move the joints by a step (N + 1,), or a part of it; the same path where the step is not finite."""
    if not np.all(np.isfinite(step)):
        return path
    largest = float(np.max(np.abs(np.diff(step)) / np.diff(path.mesh)))
    return PiecewisePolynomial(
        path.mesh + step * (LARGEST_JOINT_MOVE / max(largest, LARGEST_JOINT_MOVE)), path.nodes, path.values
    )
