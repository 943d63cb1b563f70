"""The error that a solver leaves: Newton steps from where it stopped, without its barrier and its tolerances.

With A the derivatives of the equations G, and d the distances to the bounds that multipliers are of, a step (δ, δλ) to
where the equations hold, all slopes vanish, and every multiplier or its distance is zero, solves

    (∇²f̄ + Σ) δ + Aᵀδλ = -∇f̄,        A δ - D δλ = -G,        Σ = |μ| / d,        D = d / |λ|,

with the slopes ∇f̄ of the Lagrangian but for the multipliers μ of bounds, and d in place of -G, and D, for inequalities
only.  Where the cost hardly depends on the path, steps are long even if all slopes are far below any tolerance.  The
ratio of the second step to the first is that of a geometric series, by which their sum is extrapolated: where the cost
is like a fourth power each step leaves two thirds.  Where nothing determines the path all slopes may vanish, and the
effect of rounding of the equations shows it.  `EPS` on the diagonal regularizes what nothing determines, such as which
of two controls does the work.  States, which follow from what is chosen, have none: it would outweigh the curvature of
a cost that hardly depends on the path.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.roundoff import EPS, TINY
from casadi_galerkin.control.chain import largest_of
from casadi_galerkin.control.embedding import sparse
from casadi_galerkin.control.graph import ControlGraph
from casadi_galerkin.control.optimizer import Optimum
from casadi_galerkin.control.program_bounds import ProgramBounds
from casadi_galerkin.problems.linear_equations import NO_CUTOFF
from casadi_galerkin.solution.cost_variation import RemainingError

Entries: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]  # rows, columns and values

SLOWEST = 0.9  # largest ratio of two steps that their series is summed with


def estimate_remaining_error(
    graph: ControlGraph, bounds: ProgramBounds, optimum: Optimum, data: np.ndarray
) -> RemainingError:
    """Estimate the errors of path, durations and cost that the solver has left.

    They are no less than what rounding does, and infinite where the Newton steps are not finite.
    """
    chain, kinds = graph.chain, graph.chain.unknown_kinds
    sizes = largest_of(np.abs(optimum.unknowns), kinds)
    at, steps, change = (optimum.unknowns, optimum.multipliers, optimum.bound_multipliers), list[np.ndarray](), 0.0
    for _ in range(2):
        step, blur, *after = newton_step(graph, bounds, data, sizes[kinds], *at)
        slope = graph.gradient(at[0], data)[1]
        change += abs(float(ca.dot(slope, step)))
        steps += [step, blur]
        at = after[0], after[1], after[2]
    first, rounding, second, _ = (largest_of(np.where(np.isfinite(a), np.abs(a), np.inf), kinds) for a in steps)
    with np.errstate(invalid="ignore"):  # of two that are infinite
        ratio = np.fmin(SLOWEST, second / np.where(first > 0, first, 1.0))
    left = np.fmax(np.fmax(first, second) / (1 - ratio), rounding)
    durations = kinds[chain.fields["durations"][-1]] if chain.is_free("durations") else kinds[:0]
    longer = float(np.max(left[durations] / sizes[durations], initial=0.0))
    return RemainingError(left[: chain.dimension], longer, change if np.isfinite(change) else np.inf)


def newton_step(
    graph: ControlGraph,
    bounds: ProgramBounds,
    data: np.ndarray,
    sizes: np.ndarray,
    unknowns: np.ndarray,
    of_equations: np.ndarray,
    of_bounds: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The step δ, what rounding of its equations does to it, and unknowns and multipliers after the step.

    `sizes` are those of the unknowns.  The rounding is that of the terms that the equations sum, with random signs.
    """
    low, high, least, most = bounds.sides
    report, kinds = graph.report(unknowns, data, of_equations), graph.chain.kinds
    to_bounds = _distances(unknowns, of_bounds, low, high)
    to_limits = _distances(report.equations, of_equations, least, most)
    free, held = (low < high) & (to_bounds > 0), np.isfinite(to_limits)
    stiffness = np.abs(of_bounds[free]) / to_bounds[free]
    states = np.concatenate([graph.chain.fields[name].ravel() for name in ("x", "nodes", "momentum")])
    linear = _KKTSystem(
        _entries(graph.hessian(unknowns, data, 1.0, of_equations), free, free),
        _entries(graph.jacobian(unknowns, data)[1], held, free),
        stiffness,
        ~np.isin(np.flatnonzero(free), states),
        to_limits[held] / np.maximum(np.abs(of_equations[held]), TINY),
    )
    missed = np.where(least == most, most - report.equations, np.copysign(to_limits, of_equations))
    pushes = largest_of(np.abs(of_equations), kinds)[kinds]
    moved, blurred, changed = linear.solved(-report.slope[free], missed[held], sizes[free], pushes[held])
    step, blur = np.zeros((2, len(unknowns)))
    step[free], blur[free] = moved, blurred
    equations_after, bounds_after = of_equations.copy(), of_bounds.copy()
    equations_after[held] += changed
    with np.errstate(invalid="ignore"):  # where the step is infinite
        bounds_after[free] = stiffness * moved
    return step, blur, unknowns + step, equations_after, bounds_after


@dataclass(frozen=True)
class _KKTSystem:
    """The symmetric equations (H + Σ) δ + Aᵀδλ = a, A δ - D δλ = b.

    Attributes
    ----------
    curved, across : entries of the upper half of H, and of A
    stiffness, softness : diagonals Σ and D
    chosen : whether an unknown is chosen; states follow from what is
    """

    curved: Entries
    across: Entries
    stiffness: np.ndarray
    chosen: np.ndarray
    softness: np.ndarray

    def solved(
        self, a: np.ndarray, b: np.ndarray, sizes: np.ndarray, pushes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """δ, what rounding of terms with δ and λ of some sizes does to it, and δλ.

        Units are those in which one is the largest entry of every unknown in A, of every row of A, and of H.
        """
        (i, j, curved), (k, column, across), n = self.curved, self.across, len(a)
        own = 1 / _largest(column, across, n)
        across, curved = across * own[column], own[i] * curved * own[j]
        row, unit = 1 / _largest(k, across, len(b)), np.max(np.abs(curved), initial=0.0) or 1.0
        units, apart = np.append(own, unit * row), i != j
        rows = np.concatenate((i[apart], j[apart], n + k, column))
        columns = np.concatenate((j[apart], i[apart], column, n + k))
        values = np.concatenate((np.tile(curved[apart] / unit, 2), np.tile(row[k] * across, 2)))
        diagonal, amounts = np.zeros(len(units)), np.append(sizes, pushes) / units
        diagonal[i[~apart]] = curved[~apart] / unit
        terms = np.abs(diagonal) * amounts
        np.add.at(terms, rows, np.abs(values) * amounts[columns])
        rounding = np.random.default_rng(len(terms)).choice((-EPS, EPS), len(terms)) * terms
        diagonal += np.append(own**2 * self.stiffness / unit + EPS * self.chosen, -unit * row**2 * self.softness - EPS)
        rhs = np.stack((np.append(own * a / unit, row * b), rounding), axis=1)
        found = units[:, None] * _solutions((rows, columns, values), diagonal, rhs)
        return found[:n, 0], found[:n, 1], found[n:, 0]


def _entries(matrix: ca.DM, rows: np.ndarray, columns: np.ndarray) -> Entries:
    """Entries in chosen rows and columns, numbered among these."""
    row, column = (np.array(index, dtype=int) for index in matrix.sparsity().get_triplet())
    chosen, first, second = rows[row] & columns[column], np.cumsum(rows) - 1, np.cumsum(columns) - 1
    return first[row[chosen]], second[column[chosen]], np.array(matrix.nonzeros())[chosen]


def _largest(index: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Largest size of the values of every index, or one where all are zero; (count,)."""
    largest = np.zeros(count)
    np.maximum.at(largest, index, np.abs(values))
    return np.where(largest > 0, largest, 1.0)


def _distances(values: np.ndarray, multipliers: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Distances of values to the bounds that their multipliers are of; infinite where these are of none."""
    to_bound = np.where(multipliers > 0, high - values, values - low)
    return np.where(low == high, 0.0, np.where(multipliers == 0, np.inf, np.maximum(to_bound, 0.0)))


def _solutions(beside: Entries, diagonal: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Solutions of symmetric equations, for right-hand sides (n, K): rows and columns are first divided alike."""
    own = np.arange(len(diagonal))
    rows, columns, values = (np.append(*pair) for pair in zip(beside, (own, own, diagonal), strict=True))
    scale = 1 / np.sqrt(_largest(rows, values, len(own)))
    matrix = sparse([(rows, columns, scale[rows] * values * scale[columns])], (len(own), len(own)))
    return np.asarray(scale[:, None] * ca.solve(matrix, ca.DM(scale[:, None] * rhs), "qr", NO_CUTOFF).full())
