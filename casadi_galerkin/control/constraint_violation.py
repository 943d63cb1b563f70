"""The check of the point where the solver stopped: how far each constraint is violated, and what the cost may hide."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.control.chain import Chain, largest_of
from casadi_galerkin.control.graph import Report
from casadi_galerkin.control.optimizer import Optimum, ProgramBounds
from casadi_galerkin.problems.bounds import beyond
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.crossings import is_limited

NOTHING = 1e-20  # terms that are what rounding leaves of a component that is zero; the solvers' tolerances are absolute
FEASIBLE = 1e-8  # accepted violation relative to the terms compared; IPOPT's optima were measured below 1e-10
VANISHED = 1e-13  # part of its terms along the guess below which a component's are taken for their roundoff


def limits_of(problem: ControlProblem, chain: Chain, implied: bool = False) -> ProgramBounds:
    """Bounds of the unknowns and of the equations; what is given is a bound on both sides.

    Durations and parameters are bounded at the end, and their continuity holds the others.  Equations that the given
    ends meet are left out, unless `implied` ones are to be checked as well.
    """
    fields, arriving = chain.fields, chain.fields["nodes"][chain.crossed - 1, -1]
    sides = np.full((2, chain.size), [[-np.inf], [np.inf]])
    for index in (fields["x"], fields["nodes"][:, :-1], arriving):
        _limit(sides, index, problem.position_bounds)
    _limit(sides, fields["controls"], problem.control_bounds)
    for name, bounds in (("durations", problem.duration_bounds), ("parameters", problem.parameter_bounds)):
        if bounds is not None:
            _limit(sides, fields[name][-1], bounds)
    for given, index in (
        (problem.start, fields["x"][0]),
        (problem.end, fields["x"][-1]),
        (problem.start_velocity[: chain.mechanical], fields["start_velocity"]),
        (problem.end_velocity[: chain.mechanical], fields["end_velocity"]),
    ):
        values = np.array(given, dtype=float)  # NaN for None
        _limit(sides, index, np.where(np.isnan(values), sides[:, index], values))
    for t, place in problem.waypoints:
        if not is_limited(place):
            joint = chain.breaks[problem.breakpoints.index(t)]
            index = fields["nodes"][joint - 1, -1] if joint in chain.crossed else fields["x"][joint]
            low, high = np.transpose(place)
            _limit(sides, index, (np.maximum(sides[0, index], low), np.minimum(sides[1, index], high)))
    equations = np.zeros((2, chain.equations))
    there = [(f"waypoint {i}", crossing.condition) for i, crossing in enumerate(problem.crossings)]
    for name, stated in (("path", problem.path_constraint), ("ends", problem.end_conditions), *there):
        if stated is not None:
            _limit(equations, chain.rows[name], stated[1:])
    for rows in () if implied else _implied(problem, chain):
        _limit(equations, rows, ([-np.inf], [np.inf]))
    return ProgramBounds(*sides[:, : chain.unknowns], *equations)


def _limit(sides: np.ndarray, index: np.ndarray, bounds: ArrayLike) -> None:
    """Set lower and upper bounds, (2, count), of the entries (..., count) of two long vectors."""
    for side, bound in zip(sides, np.asarray(bounds), strict=True):
        side[index] = bound


def _implied(problem: ControlProblem, chain: Chain) -> list[np.ndarray]:
    """Equations of a holonomic constraint that what is given at the ends meets already."""
    stated = [
        (problem.start, chain.rows["start_held"]),
        (problem.end, chain.rows["held"][-1, -1]),
        (problem.start_velocity, chain.rows["start_tangent"]),
        (problem.end_velocity, chain.rows["end_tangent"]),
    ]
    return [rows for given, rows in stated if None not in given]


def measures(chain: Chain, limits: ProgramBounds, report: Report, before: np.ndarray) -> np.ndarray:
    """Sizes that the equations are measured by.

    Those of a component by the largest sum of terms that one of them has along the path, or along the guess
    (`before`, by kind) where it has vanished and its terms are what rounding left of those; a path constraint or a
    condition on the ends by the sizes of what its value is made of, |∇g||z|, or its finite bound.
    """
    now = chain.largest(report.terms)
    sizes = np.where(now <= VANISHED * before, before, now)
    names = "path", "ends", *(f"waypoint {k}" for k in range(len(chain.crossed)))
    bounded = np.concatenate([chain.rows[name].ravel() for name in names])
    for side in (limits.equations_lower, limits.equations_upper):
        finite = np.where(np.isfinite(side), np.abs(side), 0.0)[bounded]
        np.fmax.at(sizes, chain.kinds[bounded], finite)
    return np.asarray(np.where(sizes > NOTHING, sizes, 1.0)[chain.kinds])


def violations(
    chain: Chain, limits: ProgramBounds, unknowns: np.ndarray, report: Report, before: np.ndarray
) -> np.ndarray:
    """Violation of every equation, then of every unknown's bounds, relative to what is compared; a bound to itself."""
    excess = _excess(report.equations, limits.equations_lower, limits.equations_upper)
    outside = _excess(unknowns, limits.lower, limits.upper)
    return np.concatenate((excess / measures(chain, limits, report, before), outside / _or_one(np.abs(unknowns))))


def cost_change(chain: Chain, limits: ProgramBounds, optimum: Optimum, report: Report) -> float:
    """How much the cost may still change by, to first order.

    These are the derivatives that are left by unknowns that are not given, times the largest sizes of such unknowns,
    and multipliers of bounds that are not met, times the distance to these.
    """
    x, bounds, kinds = optimum.unknowns, optimum.bound_multipliers, chain.unknown_kinds
    low, high, least, most = limits.sides
    left = np.abs(report.slope + bounds) * largest_of(np.abs(x), kinds)[kinds] + _gap(x, bounds, low, high)
    rows = _gap(report.equations, optimum.multipliers, least, most)
    return float(np.sum(rows[least < most]) + np.sum(left[low < high]))


def _gap(values: np.ndarray, multipliers: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Multipliers times the distance to the bounds that they are of."""
    distance = np.where(multipliers > 0, high - values, values - low)
    return np.asarray(np.abs(multipliers * np.where(np.isfinite(distance), distance, 0.0)))


def _excess(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """By how much values leave their bounds; infinite where they are not numbers."""
    return np.asarray(np.where(np.isfinite(values), beyond(values, low, high), np.inf))


def _or_one(sizes: np.ndarray) -> np.ndarray:
    """Sizes, and 1 for zero."""
    return np.asarray(np.where(sizes > 0, sizes, 1.0))
