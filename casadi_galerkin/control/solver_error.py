"""The error that a solver leaves, estimated by Newton steps from its last point, without its barrier and tolerances.

Let A be the derivatives of the equations G, and d the distances of values to the bounds on which their multipliers act.
At the optimum the equations hold, the slopes vanish, and every multiplier or its distance is zero.  The Newton step
(δ, δλ) to this solves

    (∇²f̄ + Σ) δ + Aᵀδλ = -∇f̄,        A δ - D δλ = -G,        Σ = |μ| / d,        D = d / |λ|,

where ∇f̄ are the slopes of the Lagrangian without the multipliers μ of bounds.  For inequalities alone, D is not zero,
and the right-hand side is ±d, with the sign of the multiplier, in place of -G.  Where the cost hardly depends on the
path, steps are long even if all slopes are far below any tolerance.  After the first step, the next two are
extrapolated as a geometric series: where the cost is like a fourth power, each step leaves two thirds of the distance.
Their ratio r is uncertain where it is not small, and the series is multiplied by 1 + √r: without that, errors were seen
to be 2 to 3 times their estimates.  Where the path is not determined at all, all slopes may vanish, and the effect of
rounding of the equations shows this.

`EPS` on the diagonal regularizes undetermined unknowns, such as the shares of two redundant controls.  It is not added
for states, which follow from the other unknowns: there it would outweigh the curvature of a cost that hardly depends on
the path.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeAlias

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.roundoff import EPS, TINY, largest_of, or_one
from casadi_galerkin.control.embedding import sparse
from casadi_galerkin.control.graph import ControlGraph
from casadi_galerkin.control.optimizer import Optimum
from casadi_galerkin.functional.linear_equations import NO_CUTOFF
from casadi_galerkin.solution.control_trajectory import RemainingError

Entries: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]  # rows, columns and values
Pair: TypeAlias = tuple[np.ndarray, np.ndarray]  # of the unknowns and of the multipliers

LARGEST_RATIO = 0.9  # largest ratio of two steps with which their geometric series is summed


def estimate_remaining_error(graph: ControlGraph, optimum: Optimum) -> RemainingError:
    """Estimate the errors of path, durations and cost that the solver has left.

    They are at least the effect of rounding, and infinite where the Newton steps are not finite.
    """
    chain, kinds = graph.chain, graph.chain.unknown_kinds
    sizes = largest_of(np.abs(optimum.unknowns), kinds)
    at, steps, change = optimum, list[np.ndarray](), 0.0
    for _ in range(3):
        slope = graph.gradient(at.unknowns, at.data)[1]
        step, rounding_effect, at = newton_step(graph, sizes[kinds], at)
        change += abs(float(ca.dot(slope, step)))
        steps += [step, rounding_effect]
    largest = [largest_of(np.where(np.isfinite(a), np.abs(a), np.inf), kinds) for a in steps]
    first, rounding, second, _, third, _ = largest
    with np.errstate(invalid="ignore"):  # where both steps are infinite
        ratio = np.fmin(LARGEST_RATIO, third / or_one(second))
    errors = np.fmax(first + second * (1 + np.sqrt(ratio)) / (1 - ratio), rounding)
    durations = kinds[chain.fields["durations"][-1]] if "durations" in chain.free else kinds[:0]
    of_durations = float(np.max(errors[durations] / sizes[durations], initial=0.0))
    return RemainingError(errors[: chain.dimension], of_durations, change if np.isfinite(change) else np.inf)


def newton_step(graph: ControlGraph, sizes: np.ndarray, at: Optimum) -> tuple[np.ndarray, np.ndarray, Optimum]:
    """The step δ from a point, the effect of rounding of its equations on it, and the point after it.

    `sizes` are those of the unknowns.  The rounding is that of the terms of the equations, with random signs.
    """
    unknowns, of_equations, of_bounds = at.unknowns, at.multipliers, at.bound_multipliers
    report, kinds, alike = graph.report(unknowns, at.data, of_equations), graph.chain.kinds, graph.chain.unknown_kinds
    to_bounds = distances(unknowns, of_bounds, *at.bounds.unknowns)
    to_limits = distances(report.equations, of_equations, *at.bounds.equations)
    free, active = np.less(*at.bounds.unknowns) & (to_bounds > 0), np.isfinite(to_limits)
    stiffness = np.abs(of_bounds[free]) / to_bounds[free]
    states = np.concatenate([graph.chain.fields[name].ravel() for name in ("x", "nodes", "momentum")])
    low, high = at.bounds.equations
    gaps = np.where(low == high, high - report.equations, np.copysign(to_limits, of_equations))
    multiplier_sizes = largest_of(np.abs(of_equations), kinds)[kinds]
    row, column, slopes = _entries(graph.jacobian(unknowns, at.data)[1], active, free)
    quantities = kinds[active][row] * (alike.max() + 1) + alike[free][column]
    rounded = np.abs(slopes) <= EPS * largest_of(np.abs(slopes), quantities)[quantities]  # as of a control switched off
    moved, blurred, changed = _kkt_solution(
        _entries(graph.hessian(unknowns, at.data, 1.0, of_equations), free, free),
        (row, column, np.where(rounded, 0.0, slopes)),
        (stiffness, to_limits[active] / np.maximum(np.abs(of_equations[active]), TINY)),
        (-report.slope[free], gaps[active]),
        (sizes[free], multiplier_sizes[active]),
        ~np.isin(np.flatnonzero(free), states),
    )
    step, rounding_effect = np.zeros((2, len(unknowns)))
    step[free], rounding_effect[free] = moved, blurred
    equations_after, bounds_after = of_equations.copy(), of_bounds.copy()
    equations_after[active] += changed
    with np.errstate(invalid="ignore"):  # where the step is infinite
        bounds_after[free] = stiffness * moved
    after = replace(at, unknowns=unknowns + step, multipliers=equations_after, bound_multipliers=bounds_after)
    return step, rounding_effect, after


def _kkt_solution(
    curved: Entries, across: Entries, diagonals: Pair, sides: Pair, sizes: Pair, chosen: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve the symmetric equations (H + Σ) δ + Aᵀδλ = a, A δ - D δλ = b.

    They are scaled so that the largest entry of every column of A, of every row of A, and of H and a is one.

    Parameters
    ----------
    curved, across : entries of the upper half of H, and of A
    diagonals, sides : Σ and D; a and b
    sizes : those of the unknowns and of the multipliers λ, which determine the rounding of the terms
    chosen : whether an unknown is none of the states, which follow from the others

    Returns
    -------
    δ, the effect on it of rounding of the terms, and δλ
    """
    (i, j, h), (k, column, slopes), (a, b), n = curved, across, sides, len(sides[0])
    scale = 1 / _largest(column, slopes, n)
    slopes, h = slopes * scale[column], scale[i] * h * scale[j]
    row, unit = 1 / _largest(k, slopes, len(b)), np.max(np.abs(np.append(h, scale * a)), initial=0.0) or 1.0
    units, off_diagonal = np.append(scale, unit * row), i != j
    rows = np.concatenate((i[off_diagonal], j[off_diagonal], n + k, column))
    columns = np.concatenate((j[off_diagonal], i[off_diagonal], column, n + k))
    values = np.concatenate((np.tile(h[off_diagonal] / unit, 2), np.tile(row[k] * slopes, 2)))
    diagonal, amounts = np.zeros(len(units)), np.append(*sizes) / units
    diagonal[i[~off_diagonal]] = h[~off_diagonal] / unit
    terms = np.abs(diagonal) * amounts
    np.add.at(terms, rows, np.abs(values) * amounts[columns])
    rounding = np.random.default_rng(len(terms)).choice((-EPS, EPS), len(terms)) * terms
    stiffness, softness = scale**2 * diagonals[0] / unit, unit * row**2 * diagonals[1]
    diagonal += np.append(stiffness + EPS * chosen, -softness - EPS)
    rhs = np.stack((np.append(scale * a / unit, row * b), rounding), axis=1)
    solutions = units[:, None] * _solutions((rows, columns, values), diagonal, rhs)
    return solutions[:n, 0], solutions[:n, 1], solutions[n:, 0]


def _entries(matrix: ca.DM, rows: np.ndarray, columns: np.ndarray) -> Entries:
    """Entries in chosen rows and columns, which are numbered among the chosen ones."""
    row, column = (np.array(index, dtype=int) for index in matrix.sparsity().get_triplet())
    chosen, first, second = rows[row] & columns[column], np.cumsum(rows) - 1, np.cumsum(columns) - 1
    return first[row[chosen]], second[column[chosen]], np.array(matrix.nonzeros())[chosen]


def _largest(index: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Largest size of the values of every index, or one where all are zero; (count,)."""
    return or_one(largest_of(np.abs(values), index, count))


def distances(values: np.ndarray, multipliers: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Distances of values to the bounds on which their multipliers act; infinite where a multiplier is zero."""
    to_bound = np.where(multipliers > 0, high - values, values - low)
    return np.where(low == high, 0.0, np.where(multipliers == 0, np.inf, np.maximum(to_bound, 0.0)))


def _solutions(beside: Entries, diagonal: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Solutions of symmetric equations, for right-hand sides (n, K), with symmetric scaling of rows and columns."""
    index = np.arange(len(diagonal))
    rows, columns, values = (np.append(*pair) for pair in zip(beside, (index, index, diagonal), strict=True))
    scale = 1 / np.sqrt(_largest(rows, values, len(index)))
    matrix = sparse([(rows, columns, scale[rows] * values * scale[columns])], (len(index), len(index)))
    return scale[:, None] * ca.solve(matrix, ca.DM(scale[:, None] * rhs), "qr", NO_CUTOFF).full()
