"""Where an optimisation starts: from a guess to a value for every field of the `ControlNumbering`, and a look at it."""

from __future__ import annotations

import numpy as np

from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus
from casadi_galerkin.calculus.numbers import real_array
from casadi_galerkin.control.numbering import ControlNumbering
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.guess import Guess, Values, guess_values, meeting_ends, sampled

SAME_FRACTION = 1e-12  # of the duration: rounding of joints that were stretched


def first_values(
    problem: ControlProblem, numbering: ControlNumbering, calculus: DiscreteCalculus, guess: Guess | None
) -> dict[str, np.ndarray]:
    """Values of all fields at a guess, within the bounds and with what is fixed as it is fixed.

    Without a guess the path is the straight line between the ends, and controls are zero, or the middle of their
    bounds where these exclude zero.
    """
    path_guess, control_guess = guess if isinstance(guess, tuple) and len(guess) == 2 else (guess, None)
    near = near_answer(guess, numbering, calculus)
    path = _path(problem, calculus, near.polynomial.values if near else path_guess)
    mesh, times = calculus.mesh, calculus.node_times
    velocities = [(path[1] - path[0]) / (times[1] - times[0]), (path[-1] - path[-2]) / (times[-1] - times[-2])]
    duration, parameters = mesh[-1] - mesh[0], np.array(problem.parameters or ())
    if isinstance(guess, ControlTrajectory):
        controls = near.control.values.T if near else _earlier_controls(guess, numbering, calculus)
        velocities = [guess.start_velocity.copy(), guess.end_velocity.copy()]
        if numbering.free_duration:
            duration = np.clip(guess.t[-1] - guess.t[0], *(problem.duration_bounds or ()))
        if numbering.free_parameters and guess.parameters is not None and len(guess.parameters) == numbering.parameters:
            parameters = np.clip(guess.parameters, *(problem.parameter_bounds or ()))
    elif control_guess is None:
        controls = np.tile(_resting(*problem.control_bounds), (numbering.points, 1))
    else:
        controls = _given_controls(control_guess, numbering, calculus)
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
        "begin": mesh[:1],
        "fractions": _fractions(mesh),
    }


def _fractions(mesh: np.ndarray) -> np.ndarray:
    return np.asarray((mesh - mesh[0]) / (mesh[-1] - mesh[0]))


def near_answer(
    guess: Guess | None, numbering: ControlNumbering, calculus: DiscreteCalculus
) -> ControlTrajectory | None:
    """The guess, if it has the same unknowns and equations at the same fractions of its duration, to start warm."""
    if not (isinstance(guess, ControlTrajectory) and guess.method == calculus.method):
        return None
    n, duals = numbering, guess.duals
    shapes = [guess.polynomial.values.shape, guess.control.values.shape, duals[0].shape, duals[1].shape]
    if shapes != [(n.dimension, n.nodes), (n.controls, n.points), (n.equations,), (n.unknowns,)]:
        return None
    return guess if np.max(np.abs(_fractions(guess.t) - _fractions(calculus.mesh))) <= SAME_FRACTION else None


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
    if guess is None:
        values = np.tile(_resting(*problem.position_bounds), (len(calculus.node_times), 1))
    else:
        values = guess_values(guess, calculus, problem.dimension).T
    ends = np.array([problem.start, problem.end], dtype=float)  # NaN for None
    bent = np.clip(meeting_ends(values, calculus.node_parts, ends), *problem.position_bounds)
    bent[[0, -1]] = np.where(np.isnan(ends), bent[[0, -1]], ends)
    return np.asarray(bent)


def _earlier_controls(guess: ControlTrajectory, numbering: ControlNumbering, calculus: DiscreteCalculus) -> np.ndarray:
    """Controls (N r, n) of an earlier answer at the same fractions of its duration."""
    if len(guess.control.values) != numbering.controls:
        raise ValueError(f"the guess must have {numbering.controls} control(s), got {len(guess.control.values)}")
    old, new = guess.control.mesh, calculus.mesh
    fractions = (calculus.quadrature_times - new[0]) / (new[-1] - new[0])
    return guess.control(np.clip(old[0] + fractions * (old[-1] - old[0]), old[0], old[-1])).T


def _given_controls(guess: Values, numbering: ControlNumbering, calculus: DiscreteCalculus) -> np.ndarray:
    """Controls (N r, n) from a callable of time or an array at the quadrature points."""
    name, times, shape = "the guess of the controls", calculus.quadrature_times, (numbering.controls, numbering.points)
    values = sampled(name, guess, times, shape[0]) if callable(guess) else real_array(name, guess)
    if values.shape != shape:
        raise ValueError(f"{name} must have the shape {shape} for values at the quadrature points, got {values.shape}")
    wrong = ~np.isfinite(values).all(axis=0)
    if np.any(wrong):
        i = int(np.argmax(wrong))
        raise ValueError(f"{name} must be finite, got {values[:, i]} at t = {times[i]:.6g}")
    return values.T


def check_finite(problem: ControlProblem, numbering: ControlNumbering, values: dict[str, np.ndarray]) -> None:
    """Raise a ValueError that names the first callable, and the time, that is not finite at the guess."""
    d, n = numbering.dimension, numbering.controls
    everything = numbering.matrix @ np.concatenate(numbering.pack(values))
    z = everything.full()[: numbering.points * numbering.point_rows].reshape(numbering.points, -1).T
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
