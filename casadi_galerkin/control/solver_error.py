"""What the solver leaves of an optimum: Newton steps from where it stopped, without its barrier and its tolerances.

With A the derivatives of the equations G, and d the distances to the bounds that multipliers are of, a step (δ, δλ) to
where the equations hold, all slopes vanish, and every multiplier or its distance is zero, solves

    (∇²f̄ + Σ) δ + Aᵀδλ = -∇f̄,        A δ - D δλ = -G,        Σ = |μ| / d,        D = d / |λ|,

with the slopes ∇f̄ of the Lagrangian but for the multipliers μ of bounds, and d in place of -G, and D, for inequalities
only.  Where the cost hardly knows the path, steps are long at slopes far below any tolerance.  The second step tells
how far to trust the first: both are summed as a geometric series.  Along a fourth power each leaves two thirds.
"""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.roundoff import EPS, TINY
from casadi_galerkin.control.chain import Chain, largest_of
from casadi_galerkin.control.graph import ControlGraph
from casadi_galerkin.control.optimizer import Optimum
from casadi_galerkin.control.program_bounds import ProgramBounds, distances
from casadi_galerkin.problems.linear_equations import NO_CUTOFF

SLOWEST = 0.9  # largest ratio of two steps that their series is summed with


def solver_error(graph: ControlGraph, bounds: ProgramBounds, optimum: Optimum, data: np.ndarray) -> float:
    """How far the solver may have left the path, and free durations, from where they should be.

    Relative to their sizes; infinity where the steps are not finite.
    """
    at, lengths = (optimum.unknowns, optimum.multipliers, optimum.bound_multipliers), list[float]()
    for _ in range(2):
        after = newton_step(graph, bounds, data, *at)
        if not np.isfinite(np.concatenate(after)).all():
            return math.inf
        lengths.append(_length(graph.chain, at[0], after[0]))
        at = after
    first, second = lengths
    return max(first, second) / (1 - min(SLOWEST, second / first)) if first > 0 else 0.0


def newton_step(
    graph: ControlGraph,
    bounds: ProgramBounds,
    data: np.ndarray,
    unknowns: np.ndarray,
    of_equations: np.ndarray,
    of_bounds: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unknowns, and multipliers of the equations and of the bounds, after one step; not finite where there is none."""
    low, high, least, most = bounds.sides
    report, gradients = graph.report(unknowns, data, of_equations), graph.jacobian(unknowns, data)[1]
    hessian, rows = ca.triu2symm(graph.hessian(unknowns, data, 1.0, of_equations)), report.equations
    to_bounds, to_limits = distances(unknowns, of_bounds, low, high), distances(rows, of_equations, least, most)
    free, held = np.flatnonzero((low < high) & (to_bounds > 0)), np.flatnonzero(np.isfinite(to_limits))
    stiffness = np.abs(of_bounds[free]) / to_bounds[free]
    softness = to_limits[held] / np.maximum(np.abs(of_equations[held]), TINY)
    moved, kept = free.tolist(), held.tolist()
    curved, across = hessian[moved, moved] + ca.diag(ca.DM(stiffness)), gradients[kept, moved]
    matrix = ca.blockcat([[curved, across.T], [across, -ca.diag(ca.DM(softness))]])
    missed = np.where(least == most, most - rows, np.copysign(to_limits, of_equations))
    rhs = np.concatenate((-report.slope[free], missed[held]))
    step, of_held = np.split(_solution(matrix, rhs), [len(free)])
    after = unknowns.copy(), of_equations.copy(), of_bounds.copy()
    after[0][free] += step
    after[1][held] += of_held
    with np.errstate(invalid="ignore"):  # where the step is infinite
        after[2][free] = stiffness * step
    return after


def _solution(matrix: ca.DM, rhs: np.ndarray) -> np.ndarray:
    """Solution of symmetric equations in any units: rows and columns are first divided alike.

    A part of `EPS` on the diagonal keeps apart what nothing determines, such as which of two controls does the work.
    """
    rows, count = np.array(matrix.sparsity().row(), dtype=int), len(rhs)
    largest = np.zeros(count)
    np.maximum.at(largest, rows, np.abs(matrix.nonzeros()))
    scale = 1 / np.sqrt(np.where(largest > 0, largest, 1.0))
    scaling = ca.diag(ca.DM(scale))
    scaled = ca.mtimes(ca.mtimes(scaling, matrix), scaling) + EPS * ca.DM.eye(count)
    return np.asarray(scale * ca.solve(scaled, ca.DM(scale * rhs), "qr", NO_CUTOFF).full().ravel())


def _length(chain: Chain, before: np.ndarray, after: np.ndarray) -> float:
    """Largest part of its size by which a step changes a component or a duration."""
    kinds, f = chain.unknown_kinds, chain.fields
    sizes = largest_of(np.abs(before), kinds)
    durations = f["durations"][-1] if chain.is_free("durations") else []
    moved = np.concatenate((f["x"].ravel(), f["nodes"].ravel(), durations)).astype(int)
    change = np.abs(after - before) / np.where(sizes > 0, sizes, 1.0)[kinds]
    return float(np.max(change[moved]))
