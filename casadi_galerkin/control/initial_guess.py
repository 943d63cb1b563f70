"""A guess in any form, or none, as the starting point of an optimization: values of all its unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus
from casadi_galerkin.calculus.numbers import counted, real_array
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, times_at
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.control.control_numbering import Chain, Numbering
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.phases import Phases
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
    near: bool,
    longer: float = 1.0,
) -> dict[str, np.ndarray]:
    """Values of the fields of a phase at a guess, within the bounds and with the given values.

    Without a guess the path is the straight line between the ends.  Controls, and positions that no end fixes, are
    zero, or in the middle of their bounds unless zero lies inside of these: from zero on a bound, as of a thruster, a
    quadrotor took ten times as many iterations, or found nothing.  Where all components follow rates, controls are as
    near to zero as their bounds allow: from the middle, the infected of epidemics grew without bounds on coarse meshes.
    Momenta and impulses are left out, and the units of momenta are one.  A free duration is `longer` times that of the
    mesh, within its bounds, or that of an earlier solution.

    Parameters
    ----------
    near : whether the guess is an earlier solution on the same fractions of the phase, see `near_answer`
    """
    path_guess, control_guess = guess if isinstance(guess, tuple) and len(guess) == 2 else (guess, None)
    mesh, times, n, dm = calculus.mesh, calculus.node_times, chain.intervals, chain.mechanical
    lasts, degree = mesh[-1] - mesh[0], chain.method.degree
    if isinstance(guess, ControlTrajectory):
        path_guess, control_guess = _of_answer(guess, near, problem, chain, calculus)
    path = _path(problem, calculus, path_guess)
    slopes, parameters = np.diff(path[[0, 1, -2, -1]], axis=0)[::2], np.array(problem.parameters or ())
    at_ends, begin, duration = slopes / np.diff(times[[0, 1, -2, -1]])[::2, None], mesh[0], longer * lasts
    if isinstance(guess, ControlTrajectory):
        at_ends, duration = np.array((guess.start_velocity, guess.end_velocity)), guess.t[-1] - guess.t[0]
        begin = guess.t[0] if "begin" in chain.free else begin
        found = np.array(guess.parameters or ())
        if problem.parameter_bounds is not None and len(found) == chain.parameters:
            parameters = np.clip(found, *problem.parameter_bounds)
    given = np.array([problem.start_velocity, problem.end_velocity], dtype=float)  # NaN for None
    velocities = np.where(np.isnan(given), at_ends, given)[:, :dm]
    bounds = problem.duration_bounds
    return {
        "x": path[::degree],
        "nodes": path[1:].reshape(n, degree, -1),
        "controls": _controls(problem, chain, calculus, control_guess),
        "start_velocity": velocities[0],
        "end_velocity": velocities[1],
        "begin": begin,
        "duration": lasts if bounds is None else np.clip(duration, *bounds),
        "parameters": parameters,
        "left": (mesh[:-1] - mesh[0]) / lasts,
        "part": np.diff(mesh) / lasts,
        "sizes": np.ones(dm),
    }


def guesses_of_phases(
    problem: ControlProblem | Phases,
    first: Chain,
    whole: DiscreteCalculus,
    calculi: Sequence[DiscreteCalculus],
    guess: Any,
) -> list[Any]:
    """A guess of every phase.

    Several problems take a list with a guess for each, or one for all of them.  Without any, see `_lines`.  A guess of
    one problem is cut where it is parted.

    Parameters
    ----------
    first : Chain of the first phase
    whole, calculi : of the whole, and of the phases
    guess : of the whole
    """
    count = len(calculi)
    if count == 1:
        return [guess]
    earlier = getattr(guess, "phases", ())
    if len(earlier) == count:
        return list(earlier)
    if isinstance(problem, Phases):
        if earlier or (isinstance(guess, list) and len(guess) != count):
            raise ValueError(f"the guess must be a list of {count}, one for every phase, got {guess!r}")
        if guess is None:
            return _lines(problem)
        return guess if isinstance(guess, list) else [guess] * count
    mesh, times = whole.mesh, times_at(whole.mesh, first.control_times)
    path_guess, controls = guess if isinstance(guess, tuple) and len(guess) == 2 else (guess, None)
    if isinstance(guess, ControlTrajectory):
        path_guess, controls = _of_answer(guess, False, problem, first, whole)
    path = PiecewisePolynomial(mesh, whole.method.element.nodes, _path(problem, whole, path_guess).T)
    cuts = np.cumsum([0, *(len(one.mesh) - 1 for one in calculi)])
    parts = (
        [None] * count
        if controls is None
        else np.split(
            _values_of_controls(problem, mesh, controls, times), cuts[1:-1] * (len(times) // (len(mesh) - 1)), axis=1
        )
    )
    return [(path.between(*ends), part) for ends, part in zip(pairwise(cuts.tolist()), parts, strict=True)]


def _lines(problem: Phases) -> list[Any]:
    """Straight lines, from where the phase before leads, towards the next positions that are given.

    These are looked for in phases with as many components; without any, the path stays where it is.
    """
    lines, phases = list[Any](), problem.phases
    reached = np.zeros(0)
    for k, phase in enumerate(phases):
        first, low_or_middle = phase.given_positions[0], _zero_or_middle(*phase.position_bounds)
        law, known = problem.links[k - 1] if k else None, reached if k else low_or_middle
        if isinstance(law, ca.Function):
            p = [np.array(phases[k - 1].parameters)] * (law.n_in() - 2)
            known = law(reached, np.zeros(len(reached)), *p)[0].full().ravel()
        first = np.where(np.isnan(first), low_or_middle if len(known) != len(first) else known, first)
        target, when = np.full(phase.dimension, np.nan), np.full(phase.dimension, np.inf)
        for later in phases[k:]:
            if later.dimension != phase.dimension:
                break
            for place, t in zip(later.given_positions, later.t_span, strict=True):
                new = np.isnan(target) & np.isfinite(place) & (t > phase.t_span[0])
                target[new], when[new] = place[new], t
        begin, end = phase.t_span
        reached = first + np.nan_to_num((target - first) * (end - begin) / (when - begin))
        lines.append((((begin, end), np.stack((first, reached), axis=1)), None))
    return lines


def _of_answer(
    answer: ControlTrajectory, near: bool, problem: ControlProblem, chain: Chain, calculus: DiscreteCalculus
) -> tuple[np.ndarray, np.ndarray]:
    """Node values and controls of an earlier solution, at the same fractions of the phases of a problem."""
    if len(answer.x) != chain.dimension:
        raise ValueError(f"the guess must be a path of {counted(chain.dimension, 'component')}, got {len(answer.x)}")
    controls = len(answer.control.values)
    if controls != chain.controls:
        raise ValueError(f"the guess must have {counted(chain.controls, 'control')}, got {controls}")
    if near:
        return answer.polynomial.values, answer.control.values
    now, then = (np.array(section_times(one)) for one in (problem, answer.problem))
    times = calculus.node_times, times_at(calculus.mesh, chain.control_times)
    nodes, points = (map_times(t, now, then) for t in times)
    return answer(nodes), answer.control(points)


def near_answer(guess: Any, numbering: Numbering, calculi: Sequence[DiscreteCalculus]) -> bool:
    """Whether the guess is a solution with the same unknowns, equations and fractions of the mesh, for a warm start."""
    phases = getattr(guess, "phases", ())
    if len(phases) != len(calculi) or [a.shape for a in guess.duals] != [(numbering.equations,), (numbering.unknowns,)]:
        return False
    for one, chain, calculus in zip(phases, numbering.chains, calculi, strict=True):
        mesh, shape = calculus.mesh, (chain.dimension, len(calculus.node_times))
        if one.method != calculus.method or one.polynomial.values.shape != shape:
            return False
        joints = map_times(one.t, section_times(one.problem), mesh[[0, *chain.breaks, -1]].tolist())
        if np.max(np.abs(joints - mesh)) > SAME_FRACTION * (mesh[-1] - mesh[0]):
            return False
    return True


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
    values = _values_of_controls(problem, calculus.mesh, guess, times_at(calculus.mesh, chain.control_times))
    return np.clip(values.T, *problem.control_bounds).reshape(chain.fields["controls"].shape)


def _values_of_controls(problem: ControlProblem, mesh: np.ndarray, guess: Values, times: np.ndarray) -> np.ndarray:
    """Values (n, points) of a guess of the controls at these times."""
    name, shape = "the guess of the controls", (problem.controls, len(times))
    if isinstance(guess, ControlPath):  # stretched as a path is
        values = guess(np.interp(times, mesh[[0, -1]], guess.mesh[[0, -1]]))
    else:
        values = sampled(name, guess, times, shape[0]) if callable(guess) else real_array(name, guess)
    if values.shape != shape:
        where = "in the intervals" if problem.hold else "at the quadrature points"
        raise ValueError(f"{name} must have the shape {shape} for values {where}, got {values.shape}")
    check_finite_values(name, values, times)
    return values
