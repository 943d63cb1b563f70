"""A guess in any form, or none, as the starting point of an optimization: values of all its unknowns."""

from __future__ import annotations

import numpy as np

from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus
from casadi_galerkin.calculus.numbers import counted, real_array
from casadi_galerkin.calculus.piecewise_polynomial import times_at
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.control.control_numbering import Chain
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.problem import map_times, section_times
from casadi_galerkin.solution.control_path import ControlPath
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.guess import Guess, Values, check_finite_values, guess_values, meeting_ends, sampled

SAME_FRACTION = np.sqrt(EPS)  # distance over the duration at which joints are equal


def first_values(
    problem: ControlProblem,
    chain: Chain,
    calculus: DiscreteCalculus,
    guess: Guess | None,
    near: ControlTrajectory | None,
    longer: float = 1.0,
) -> dict[str, np.ndarray]:
    """Values of the fields at a guess, within the bounds and with the given values; for `near` see `near_answer`.

    Without a guess the path is the straight line between the ends.  Controls, and positions that no end fixes, are
    zero, or in the middle of their bounds unless zero lies inside of these: from zero on a bound, as of a thruster, a
    quadrotor took ten times as many iterations, or found nothing.  Where all components follow rates, controls are as
    near to zero as their bounds allow: from the middle, the infected of epidemics grew without bounds on coarse meshes.
    Momenta and impulses are left out, and the units of momenta are one.  Free durations are `longer` times those of the
    mesh, within their bounds, or those of an earlier solution.
    """
    path_guess, control_guess = guess if isinstance(guess, tuple) and len(guess) == 2 else (guess, None)
    mesh, times, n, dm = calculus.mesh, calculus.node_times, chain.intervals, chain.mechanical
    everywhere, degree = np.array(section_times(problem)), chain.method.degree
    of_phases = everywhere if "durations" in chain.free else everywhere[[0, -1]]
    if isinstance(guess, ControlTrajectory):
        path_guess, control_guess = _of_answer(guess, near, chain, calculus, everywhere)
    path, before = _path(problem, calculus, path_guess), degree * chain.crossed
    slopes, parameters = np.diff(path, axis=0) / np.diff(times)[:, None], np.array(problem.parameters or ())
    arrived, arriving, at_ends = path[before], slopes[before - 1, :dm], slopes[[0, -1]]
    durations = longer * np.diff(of_phases)
    if isinstance(guess, ControlTrajectory):
        at_ends = np.array((guess.start_velocity, guess.end_velocity))
        if len(before):
            at = map_times(times[before], everywhere, section_times(guess.problem))
            arrived = np.clip(arrived + (guess.before(at) - guess(at)).T, *problem.position_bounds)
            arriving = guess.arrival_velocity if guess.arrival_velocity.shape == arriving.shape else arriving
        durations = np.diff(map_times(of_phases, of_phases, section_times(guess.problem)))
        found = np.array(guess.parameters or ())
        if problem.parameter_bounds is not None and len(found) == chain.parameters:
            parameters = np.clip(found, *problem.parameter_bounds)
    nodes = path[1:].reshape(n, degree, -1).copy()
    nodes[chain.crossed - 1, -1] = arrived
    given = np.array([problem.start_velocity, problem.end_velocity], dtype=float)  # NaN for None
    velocities = np.where(np.isnan(given), at_ends, given)[:, :dm]
    bounds = problem.duration_bounds
    lasting = np.diff(of_phases)[chain.phases]
    return {
        "x": path[::degree],
        "nodes": nodes,
        "controls": _controls(problem, chain, calculus, control_guess),
        "start_velocity": velocities[0],
        "end_velocity": velocities[1],
        "velocity": arriving,
        "durations": np.diff(of_phases) if bounds is None else np.clip(durations, *bounds),
        "parameters": parameters,
        "begin": mesh[:1],
        "left": (mesh[:-1] - of_phases[chain.phases]) / lasting,
        "part": np.diff(mesh) / lasting,
        "sizes": np.ones(dm),
    }


def _of_answer(
    answer: ControlTrajectory, near: ControlTrajectory | None, chain: Chain, calculus: DiscreteCalculus, now: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Node values and controls of an earlier solution, at the same fractions of the phases between the times `now`."""
    if len(answer.x) != chain.dimension:
        raise ValueError(f"the guess must be a path of {counted(chain.dimension, 'component')}, got {len(answer.x)}")
    controls = len(answer.control.values)
    if controls != chain.controls:
        raise ValueError(f"the guess must have {counted(chain.controls, 'control')}, got {controls}")
    if near is not None:
        return near.polynomial.values, near.control.values
    times = calculus.node_times, times_at(calculus.mesh, chain.control_times)
    nodes, points = (map_times(t, now, section_times(answer.problem)) for t in times)
    return answer(nodes), answer.control(points)


def near_answer(guess: Guess | None, chain: Chain, calculus: DiscreteCalculus) -> ControlTrajectory | None:
    """The guess, if it is a solution with the same unknowns, equations and fractions of the mesh, for a warm start."""
    if not (isinstance(guess, ControlTrajectory) and guess.method == calculus.method):
        return None
    shapes = [guess.polynomial.values.shape, guess.duals[0].shape, guess.duals[1].shape]
    if shapes != [(chain.dimension, len(calculus.node_times)), (chain.equations,), (chain.unknowns,)]:
        return None
    now = calculus.mesh[[0, *chain.breaks, -1]].tolist()
    joints = map_times(guess.t, section_times(guess.problem), now)
    same = SAME_FRACTION * (calculus.mesh[-1] - calculus.mesh[0])
    return guess if np.max(np.abs(joints - calculus.mesh)) <= same else None


def _zero_or_middle(low: tuple[float, ...], high: tuple[float, ...]) -> np.ndarray:
    """Zero where it is inside of the bounds; else their middle, or the finite one."""
    return np.array(
        [
            0.0 if a < 0 < b else (a + b) / 2 if np.isfinite(b - a) else a if np.isfinite(a) else b
            for a, b in zip(low, high, strict=True)
        ]
    )


def _path(problem: ControlProblem, calculus: DiscreteCalculus, guess: Guess | None) -> np.ndarray:
    """Node values (N m + 1, d) that meet the fixed ends and are within bounds."""
    if guess is None:
        values = np.full((len(calculus.node_times), problem.dimension), _zero_or_middle(*problem.position_bounds))
    else:
        values = guess_values(guess, calculus, problem.dimension).T
    ends = problem.given_positions
    bent = np.clip(meeting_ends(values, calculus.node_parts, ends), *problem.position_bounds)
    bent[[0, -1]] = np.where(np.isnan(ends), bent[[0, -1]], ends)
    return bent


def _controls(problem: ControlProblem, chain: Chain, calculus: DiscreteCalculus, guess: Values | None) -> np.ndarray:
    """Controls (N, points, n) within bounds, from a callable of time or an array of values at these points."""
    if guess is None:
        bounds = problem.control_bounds
        first = _zero_or_middle(*bounds) if problem.mechanical else np.clip(0.0, *bounds)
        return np.full((chain.intervals, len(chain.control_times), chain.controls), first)
    name, times = "the guess of the controls", times_at(calculus.mesh, chain.control_times)
    shape = (chain.controls, len(times))
    if isinstance(guess, ControlPath):  # stretched as a path is
        values = guess(np.interp(times, calculus.mesh[[0, -1]], guess.mesh[[0, -1]]))
    else:
        values = sampled(name, guess, times, shape[0]) if callable(guess) else real_array(name, guess)
    if values.shape != shape:
        where = "in the intervals" if problem.hold else "at the quadrature points"
        raise ValueError(f"{name} must have the shape {shape} for values {where}, got {values.shape}")
    check_finite_values(name, values, times)
    return np.clip(values.T, *problem.control_bounds).reshape(chain.fields["controls"].shape)
