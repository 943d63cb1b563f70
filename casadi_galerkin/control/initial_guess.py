"""Where an optimisation starts: from a guess to a value for every field of the `ControlNumbering`, and a look at it."""

from __future__ import annotations

import numpy as np

from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus
from casadi_galerkin.control.numbering import ControlNumbering
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.guess import Guess, guess_values, meeting_ends


def first_values(
    problem: ControlProblem, numbering: ControlNumbering, mesh: np.ndarray, guess: Guess | None
) -> dict[str, np.ndarray]:
    """Values of all fields at a guess, within the bounds and with what is fixed as it is fixed.

    Without a guess the path is the straight line between the ends, and controls are zero, or the middle of their
    bounds where these exclude zero.
    """
    calculus = DiscreteCalculus(numbering.method, mesh)
    begin, duration = mesh[0], mesh[-1] - mesh[0]
    fractions = (mesh - begin) / duration
    path = _path(problem, calculus, guess)
    velocities = (path[[1, -1]] - path[[0, -2]]) / np.diff(calculus.node_times)[[0, -1], None]
    controls = np.tile(_resting(*problem.control_bounds), (numbering.points, 1))
    parameters = np.array(problem.parameters or ())
    if isinstance(guess, ControlTrajectory):
        controls = _earlier_controls(guess, numbering, (calculus.quadrature_times - begin) / duration)
        velocities = np.stack((guess.start_velocity, guess.end_velocity))
        if numbering.free_duration:
            duration = np.clip(guess.t[-1] - guess.t[0], *(problem.duration_bounds or ()))
        if numbering.free_parameters and guess.parameters is not None and len(guess.parameters) == numbering.parameters:
            parameters = np.clip(guess.parameters, *(problem.parameter_bounds or ()))
    for velocity, fixed in zip(velocities, (problem.start_velocity, problem.end_velocity), strict=True):
        for i, value in enumerate(fixed):
            velocity[i] = velocity[i] if value is None else value
    return {
        "path": path,
        "controls": np.clip(controls, *problem.control_bounds),
        "start_velocity": velocities[0],
        "end_velocity": velocities[1],
        "duration": np.array([duration]),
        "parameters": parameters,
        "begin": np.array([begin]),
        "fractions": fractions,
    }


def _resting(low: tuple[float, ...], high: tuple[float, ...]) -> np.ndarray:
    """Zero where the bounds hold it; else their middle, or the finite one."""
    return np.array(
        [
            0.0 if a <= 0 <= b else (a + b) / 2 if np.isfinite(b - a) else a if np.isfinite(a) else b
            for a, b in zip(low, high, strict=True)
        ]
    )


def _path(problem: ControlProblem, calculus: DiscreteCalculus, guess: Guess | None) -> np.ndarray:
    """Node values (N m + 1, d) that meet the fixed ends and keep within bounds."""
    d, nodes = problem.dimension, len(calculus.node_times)
    resting = _resting(*problem.position_bounds)
    values = np.tile(resting, (nodes, 1)) if guess is None else guess_values(guess, calculus, d).T
    ends = np.array([[np.nan if v is None else v for v in end] for end in (problem.start, problem.end)])
    bent = np.clip(meeting_ends(values, calculus.node_parts, ends), *problem.position_bounds)
    bent[[0, -1]] = np.where(np.isnan(ends), bent[[0, -1]], ends)
    return np.asarray(bent)


def _earlier_controls(guess: ControlTrajectory, numbering: ControlNumbering, fractions: np.ndarray) -> np.ndarray:
    """Controls (N r, n) of an earlier answer at the same fractions of its duration."""
    if len(guess.control.values) != numbering.controls:
        raise ValueError(f"the guess must have {numbering.controls} control(s), got {len(guess.control.values)}")
    old = guess.control.mesh
    return guess.control(np.clip(old[0] + fractions * (old[-1] - old[0]), old[0], old[-1])).T


def check_finite(
    problem: ControlProblem, numbering: ControlNumbering, values: dict[str, np.ndarray], z: np.ndarray
) -> None:
    """Raise a ValueError that names the first callable, and the time, that is not finite at the guess.

    Parameters
    ----------
    z : (rows, N r), what is known at the quadrature points
    """
    d, n = numbering.dimension, numbering.controls
    times = values["begin"] + values["duration"] * z[-2]
    state = [times[None, :], z[:d], z[d : 2 * d] / (values["duration"] * z[-1])]
    given = [np.tile(values["parameters"][:, None], (1, numbering.points))] if numbering.parameters else []
    inputs = [*state, z[2 * d : 2 * d + n], *given]
    callables = {"running_cost": problem.running_cost, "force": problem.force}
    if problem.path_constraint is not None:
        callables["path_constraint"] = problem.path_constraint[0]
    for name, function in callables.items():
        _report(name, np.array(function.map(numbering.points)(*inputs)), times)
    _report("lagrangian", np.array(problem.lagrangian.map(numbering.points)(*state, *given)), times)
    if problem.terminal_cost is not None:
        end = (times[-1:], values["path"][-1], values["end_velocity"], *([values["parameters"]] if given else []))
        _report("terminal_cost", np.array(problem.terminal_cost(*end)), values["begin"] + values["duration"])


def _report(name: str, values: np.ndarray, times: np.ndarray) -> None:
    wrong = ~np.isfinite(values).all(axis=0)
    if np.any(wrong):
        k = int(np.argmax(wrong))
        raise ValueError(
            f"{name} is not finite at the guess: {values[:, k]} at t = {times[k]:.6g}. Give a guess that avoids it"
        )
