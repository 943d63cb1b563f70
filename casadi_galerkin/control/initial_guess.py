"""A guess in any form, or none, as the starting point of an optimization: values of all its unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus
from casadi_galerkin.calculus.numbers import counted, real_array
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial, times_at
from casadi_galerkin.calculus.roundoff import EPS, or_one
from casadi_galerkin.control.control_graph import ControlGraph, meshes_of
from casadi_galerkin.control.control_numbering import Chain, Numbering
from casadi_galerkin.control.failed_optimization import refuse_not_finite
from casadi_galerkin.control.optimizer import TOLERANCE
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.phases import Phases, parted
from casadi_galerkin.problems.problem import map_times, section_times
from casadi_galerkin.solution.control_path import ControlPath
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.guess import Guess, Values, check_finite_values, guess_values, meeting_ends, sampled
from casadi_galerkin.solution.optimal_path import OptimalPath
from casadi_galerkin.solution.path import Path

LARGEST_TERMS_RATIO = 10.0  # largest ratio of terms along a guess to those on the straight line; only noise has more
LEAST_TERMS = np.sqrt(EPS)  # part of the largest terms on the straight line below which those of a component are none
SAME_FRACTION = np.sqrt(EPS)  # distance over the duration at which joints are equal


@dataclass(frozen=True)
class StartingPoint:
    """The starting point of a solve.

    Attributes
    ----------
    values : one array for every field of the `Chain` of every phase but impulses, which begin at zero
    duals : multipliers of the bounds and of the equations for a warm start, or an empty tuple
    sizes : sizes of the terms of every kind of equation
    """

    values: list[dict[str, np.ndarray]]
    duals: tuple[np.ndarray, ...]
    sizes: np.ndarray


def starting_point(
    graph: ControlGraph, problem: ControlProblem | Phases, calculus: DiscreteCalculus, guess: Any, longer: float = 1.0
) -> StartingPoint:
    """The starting point of a solve from a guess, with free durations that are `longer` by this factor.

    From an answer with the same unknowns, equations and fractions of the mesh it is warm: that answer, with the numbers
    that are given now.

    The equations of motion are scaled by the sizes of their terms along the guess, so that the absolute tolerance of
    the solver does not depend on units.  These sizes are limited to ten times those on the straight line between the
    ends, because the terms of a noisy guess are far too large.  Where a component hardly changes on the line, as
    between ends that differ by rounding, its terms there are far too small and set no limit.  The momenta of a guess
    are minus the residuals of the equations of the joints with momenta of zero.
    """
    numbers, phases = graph.numbering, parted(problem).phases
    calculi = [calculus]
    if len(phases) > 1:
        calculi = [DiscreteCalculus(calculus.method, mesh) for mesh in meshes_of(phases, calculus.mesh)]
    each = list(zip(phases, numbers.chains, calculi, strict=True))
    warm = _kept_values(guess, numbers, each)
    if warm:
        at, before = guess.variations.optimum, numbers.units(warm)
        sizes = _in_units_of(guess.variations.sizes, numbers, warm)
        return StartingPoint(warm, (at.bound_multipliers, at.multipliers * numbers.units(warm) / before), sizes)

    def values_at(some: Any, factor: float) -> list[dict[str, np.ndarray]]:
        guesses = guesses_of_phases(problem, numbers.chains[0], calculus, calculi, some)
        return [first_values(*one, at, factor) for one, at in zip(each, guesses, strict=True)]

    values = values_at(guess, longer)
    report = graph.report(*numbers.pack(values))
    if not np.isfinite(report.cost + np.sum(report.actions) + np.sum(report.equations)):
        refuse_not_finite(phases, graph, *numbers.pack(values))
    largest = report.sizes
    if guess is not None:  # it may be noisy
        line = graph.report(*numbers.pack(values_at(None, 1.0))).sizes
        for chain in numbers.chains:
            line[chain.motions] = _significant(line[chain.motions], LEAST_TERMS)
        limited = (line > TOLERANCE) & np.isfinite(line)
        largest = np.where(limited, np.fmin(LARGEST_TERMS_RATIO * line, largest), largest)
    for chain, found in zip(numbers.chains, values, strict=True):
        momentum = -report.equations[chain.departures]
        found["momentum"] = np.where(np.isfinite(momentum), momentum, 0.0)
    return StartingPoint(values, (), _in_units_of(largest, numbers, values))


def _in_units_of(sizes: np.ndarray, numbers: Numbering, values: list[dict[str, np.ndarray]]) -> np.ndarray:
    """Sizes of the terms of equations, with those of motion in units of themselves, as momenta then are."""
    scaled = sizes.copy()
    for chain, found in zip(numbers.chains, values, strict=True):
        units = or_one(_significant(sizes[chain.motions], TOLERANCE))
        scaled[chain.motions] /= units
        found["momentum"], found["sizes"] = found["momentum"] / units, found["sizes"] * units
    return scaled


def _significant(sizes: np.ndarray, part: float) -> np.ndarray:
    """The sizes of terms of all components; zero for those not finite, or at most this part of the largest."""
    finite = np.where(np.isfinite(sizes), sizes, 0.0)
    return np.where(finite > part * np.max(finite, initial=0.0), finite, 0.0)


def _given_values(problem: ControlProblem, mesh: np.ndarray) -> dict[str, Any]:
    """Times and parameters of a phase, and units of momenta of one: values of the data, where these are not free."""
    lasts = mesh[-1] - mesh[0]
    parts = {"left": (mesh[:-1] - mesh[0]) / lasts, "part": np.diff(mesh) / lasts, "sizes": np.ones(problem.mechanical)}
    return {"begin": mesh[0], "duration": lasts, "parameters": np.array(problem.parameters or ()), **parts}


def _kept_values(
    guess: Any, numbers: Numbering, each: Sequence[tuple[ControlProblem, Chain, DiscreteCalculus]]
) -> list[dict[str, np.ndarray]]:
    """The values of an earlier answer, bent to the given ends and with the data given; none unless all numbers fit."""
    at = guess.variations.optimum if isinstance(guess, OptimalPath) and guess.variations is not None else None
    counts = numbers.unknowns, numbers.equations, numbers.size - numbers.unknowns
    if at is None or guess.method != numbers.chains[0].method:
        return []
    if (len(at.unknowns), len(at.multipliers), len(at.data)) != counts:
        return []
    values = numbers.unpack(at.unknowns, at.data)
    for (problem, chain, calculus), found in zip(each, values, strict=True):
        now = _given_values(problem, calculus.mesh)
        if np.max(np.abs(found["left"] - now["left"])) > SAME_FRACTION:
            return []
        found |= {name: value for name, value in now.items() if name not in (*chain.free, "sizes")}
        found |= _at_nodes(chain, _path(problem, calculus, chain.path(found, calculus.mesh).values))
    return values


def first_values(
    problem: ControlProblem, chain: Chain, calculus: DiscreteCalculus, guess: Guess | None, longer: float = 1.0
) -> dict[str, np.ndarray]:
    """Values of the fields of a phase at a guess, within the bounds and with the given values.

    Without a guess the path is the straight line between the ends.  Controls, and positions that no end fixes, are
    zero, or in the middle of their bounds unless zero lies inside of these: from zero on a bound, as of a thruster, a
    quadrotor took ten times as many iterations, or found nothing.  Where all components follow rates, controls are as
    near to zero as their bounds allow: from the middle, the infected of epidemics grew without bounds on coarse meshes.
    Momenta and impulses are left out.  A free duration is `longer` times that of the mesh, within its bounds, or that
    of an earlier solution.
    """
    path_guess, control_guess = guess if isinstance(guess, tuple) and len(guess) == 2 else (guess, None)
    mesh, times = calculus.mesh, calculus.node_times
    values, duration = _given_values(problem, mesh), longer * (mesh[-1] - mesh[0])
    if isinstance(guess, ControlTrajectory):
        path_guess, control_guess = _of_answer(guess, problem, chain, calculus)
        duration = guess.t[-1] - guess.t[0]
        if "begin" in chain.free:
            values["begin"] = guess.t[0]
        found = np.array(guess.parameters or ())
        if problem.parameter_bounds is not None and len(found) == chain.parameters:
            values["parameters"] = np.clip(found, *problem.parameter_bounds)
    if problem.duration_bounds is not None:
        values["duration"] = np.clip(duration, *problem.duration_bounds)
    path = _path(problem, calculus, path_guess)
    at_ends = np.diff(path[[0, 1, -2, -1]], axis=0)[::2] / np.diff(times[[0, 1, -2, -1]])[::2, None]
    if isinstance(guess, ControlTrajectory):
        at_ends = np.array((guess.start_velocity, guess.end_velocity))
    given = np.array([problem.start_velocity, problem.end_velocity], dtype=float)  # NaN for None
    velocities = np.where(np.isnan(given), at_ends, given)[:, : chain.mechanical]
    motion = {"start_velocity": velocities[0], "end_velocity": velocities[1]}
    return values | _at_nodes(chain, path) | motion | {"controls": _controls(problem, chain, calculus, control_guess)}


def _at_nodes(chain: Chain, path: np.ndarray) -> dict[str, np.ndarray]:
    """Values of the fields that have those of a path (N m + 1, d)."""
    degree = chain.method.degree
    return {"x": path[::degree], "nodes": path[1:].reshape(chain.intervals, degree, -1)}


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
        return guess if isinstance(guess, list) else [_of_whole(guess, problem.t_span)] * count
    mesh, times = whole.mesh, times_at(whole.mesh, first.control_times)
    path_guess, controls = guess if isinstance(guess, tuple) and len(guess) == 2 else (guess, None)
    if isinstance(guess, ControlTrajectory):
        path_guess, controls = _of_answer(guess, problem, first, whole)
    nodes, m, r = _path(problem, whole, path_guess).T, whole.method.degree, len(first.control_times)
    if controls is not None:
        controls = _values_of_controls(problem, mesh, controls, times)
    cuts = pairwise(np.cumsum([0, *(len(one.mesh) - 1 for one in calculi)]).tolist())
    return [
        (nodes[:, a * m : b * m + 1], controls if controls is None else controls[:, a * r : b * r]) for a, b in cuts
    ]


def _of_whole(guess: Any, span: tuple[float, float]) -> Any:
    """A guess of all phases as one of any of them: paths and controls are read at its own times within the whole."""
    if isinstance(guess, tuple):
        return tuple(_of_whole(part, span) for part in guess)
    known = guess.polynomial if isinstance(guess, Path) else guess
    if not isinstance(known, (PiecewisePolynomial, ControlPath)):
        return guess
    return lambda t: known(np.interp(t, span, known.mesh[[0, -1]]))


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
    answer: ControlTrajectory, problem: ControlProblem, chain: Chain, calculus: DiscreteCalculus
) -> tuple[np.ndarray, np.ndarray]:
    """Node values and controls of an earlier solution, at the same fractions of the phases of a problem."""
    given = len(answer.x), len(answer.control.values)
    if given[0] != chain.dimension:
        raise ValueError(f"the guess must be a path of {counted(chain.dimension, 'component')}, got {given[0]}")
    if given[1] != chain.controls:
        raise ValueError(f"the guess must have {counted(chain.controls, 'control')}, got {given[1]}")
    now, then = (np.array(section_times(one)) for one in (problem, answer.problem))
    times = calculus.node_times, times_at(calculus.mesh, chain.control_times)
    nodes, points = (map_times(t, now, then) for t in times)
    return answer(nodes), answer.control(points)


@np.errstate(invalid="ignore")  # no bounds have no middle
def _zero_or_middle(*bounds: tuple[float, ...]) -> np.ndarray:
    """Zero where it is inside of the bounds; else their middle, or the finite one."""
    low, high = np.array(bounds)
    middle = (low + high) / 2
    finite = np.where(np.isfinite(middle), middle, np.where(np.isfinite(low), low, high))
    return np.where((low < 0) & (high > 0), 0.0, finite)


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
