"""What the solver leaves of an optimum: Newton steps from where it stopped, without its barrier and its tolerances.

With A the derivatives of the equations G, and d the distances to the bounds that multipliers are of, a step (δ, δλ) to
where the equations hold, all slopes vanish, and every multiplier or its distance is zero, solves

    (∇²f̄ + Σ) δ + Aᵀδλ = -∇f̄,        A δ - D δλ = -G,        Σ = |μ| / d,        D = d / |λ|,

with the slopes ∇f̄ of the Lagrangian but for the multipliers μ of bounds, and d in place of -G, and D, for inequalities
only.  Where the cost hardly knows the path, steps are long at slopes far below any tolerance.  The second step tells
how far to trust the first: both are summed as a geometric series.  Along a fourth power each leaves two thirds.  Where
nothing determines the path all slopes may vanish; what rounding of the equations does to it then tells.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.roundoff import EPS, TINY
from casadi_galerkin.control.chain import largest_of
from casadi_galerkin.control.graph import ControlGraph
from casadi_galerkin.control.optimizer import Optimum
from casadi_galerkin.control.program_bounds import ProgramBounds, distances
from casadi_galerkin.problems.linear_equations import NO_CUTOFF

SLOWEST = 0.9  # largest ratio of two steps that their series is summed with


def what_is_left(
    graph: ControlGraph, bounds: ProgramBounds, optimum: Optimum, data: np.ndarray
) -> tuple[np.ndarray, float]:
    """How far the solver may have left each component of the path, (d,), and free durations, relative to these.

    It is no less than what rounding does to them, and infinite where the steps are not finite.
    """
    chain, kinds = graph.chain, graph.chain.unknown_kinds
    sizes = largest_of(np.abs(optimum.unknowns), kinds)
    at = optimum.unknowns, optimum.multipliers, optimum.bound_multipliers
    first, blur, *after = newton_step(graph, bounds, data, sizes[kinds], *at)
    second = newton_step(graph, bounds, data, sizes[kinds], *after)[0]
    steps = (largest_of(np.where(np.isfinite(a), np.abs(a), np.inf), kinds) for a in (first, second, blur))
    lengths, then, rounding = steps
    with np.errstate(invalid="ignore"):  # of two that are infinite
        ratio = np.fmin(SLOWEST, then / np.where(lengths > 0, lengths, 1.0))
    left = np.fmax(np.fmax(lengths, then) / (1 - ratio), rounding)
    durations = kinds[chain.fields["durations"][-1]] if chain.is_free("durations") else kinds[:0]
    return left[: chain.dimension], float(np.max(left[durations] / sizes[durations], initial=0.0))


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
    report, gradients = graph.report(unknowns, data, of_equations), graph.jacobian(unknowns, data)[1]
    hessian, rows = ca.triu2symm(graph.hessian(unknowns, data, 1.0, of_equations)), report.equations
    to_bounds, to_limits = distances(unknowns, of_bounds, low, high), distances(rows, of_equations, least, most)
    free, held = np.flatnonzero((low < high) & (to_bounds > 0)), np.flatnonzero(np.isfinite(to_limits))
    stiffness = np.abs(of_bounds[free]) / to_bounds[free]
    softness = to_limits[held] / np.maximum(np.abs(of_equations[held]), TINY)
    moved, kept = free.tolist(), held.tolist()
    curved, across = hessian[moved, moved], gradients[kept, moved]
    matrix = ca.blockcat([[curved, across.T], [across, ca.DM(len(held), len(held))]])
    missed = np.where(least == most, most - rows, np.copysign(to_limits, of_equations))
    rhs = np.concatenate((-report.slope[free], missed[held]))
    pushes = largest_of(np.abs(of_equations), graph.chain.kinds)[graph.chain.kinds]
    terms = ca.mtimes(ca.fabs(matrix), ca.DM(np.concatenate((sizes[free], pushes[held])))).full().ravel()
    rounding = np.random.default_rng(len(rhs)).choice((-EPS, EPS), len(rhs)) * terms
    matrix += ca.diag(ca.DM(np.concatenate((stiffness, -softness))))
    found = _solutions(matrix, np.stack((rhs, rounding), axis=1))
    step, blur, after = np.zeros(len(unknowns)), np.zeros(len(unknowns)), of_bounds.copy()
    step[free], blur[free] = found[: len(free)].T
    multipliers = of_equations.copy()
    multipliers[held] += found[len(free) :, 0]
    with np.errstate(invalid="ignore"):  # where the step is infinite
        after[free] = stiffness * step[free]
    return step, blur, unknowns + step, multipliers, after


def _solutions(matrix: ca.DM, rhs: np.ndarray) -> np.ndarray:
    """Solutions of symmetric equations in any units, for right-hand sides (n, K): rows and columns are divided alike.

    A part of `EPS` on the diagonal keeps apart what nothing determines, such as which of two controls does the work.
    """
    largest = np.zeros(len(rhs))
    np.maximum.at(largest, np.array(matrix.sparsity().row(), dtype=int), np.abs(matrix.nonzeros()))
    scale = 1 / np.sqrt(np.where(largest > 0, largest, 1.0))[:, None]
    scaling = ca.diag(ca.DM(scale))
    scaled = ca.mtimes(ca.mtimes(scaling, matrix), scaling) + EPS * ca.DM.eye(len(rhs))
    return np.asarray(scale * ca.solve(scaled, ca.DM(scale * rhs), "qr", NO_CUTOFF).full())
