"""Whether an optimum is a minimum: the second variation of the cost among the directions that keep what holds it.

What holds it are the equations, and the bounds and inequalities that are met; A are their gradients.  By Sylvester's
law ∇²f̄ + AᵀA/δ has, for small δ, as many negative eigenvalues as ∇²f̄ has among the directions z with A z = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.control.chain import Chain
from casadi_galerkin.control.graph import ControlGraph
from casadi_galerkin.control.program_bounds import limits_of
from casadi_galerkin.functional.mapping import one_by_one
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.solvers.linear_solver import factors_of, negative_pivots

MET = 1e-6  # of the size of an unknown: distance from a bound up to which it is met
FLAT = 1e-6  # part of the cost; along a singular arc it hardly changes, and less than this tells nothing
ROUNDS = 5  # of scaling, after which the largest entries of all rows are nearly equal
SOFTENED = 1e-7, 1e-9  # values of δ; what one of them counts alone is made by it, or by rounding


@dataclass(frozen=True)
class CostVariation:
    """How the cost varies about an optimum, on a graph that is built when this is asked for.

    Attributes
    ----------
    problem, method, mesh : what was solved
    unknowns, data : ξ
    multipliers, bound_multipliers : of the equations and of the bounds on the unknowns
    cost : its value
    """

    problem: ControlProblem
    method: Galerkin
    mesh: np.ndarray
    unknowns: np.ndarray
    data: np.ndarray
    multipliers: np.ndarray
    bound_multipliers: np.ndarray
    cost: float

    def negative(self) -> int | None:
        """Number of independent directions that lower the cost; None where rounding hides it.

        By more than `FLAT` of it, for moves as large as the path.
        """
        chain = Chain(self.problem, self.method, self.mesh)
        graph, limits = ControlGraph(self.problem, chain, one_by_one), limits_of(self.problem, chain)
        hessian = graph.whole_hessian(self.unknowns, self.data, 1.0, self.multipliers)[1]
        values, gradients = graph.jacobian(self.unknowns, self.data)
        sizes, rows = _sizes(chain, self.unknowns), np.array(values).ravel()
        low, high, least, most = limits.sides
        free = np.flatnonzero(~_met(self.unknowns, low, high, self.bound_multipliers, sizes)).tolist()
        held = np.flatnonzero(_met(rows, least, most, self.multipliers, np.abs(rows))).tolist()
        if not free:
            return 0
        units, flat = (ca.diag(ca.DM(a)) for a in (np.where(sizes > 0, sizes, 1.0), np.where(sizes > 0, FLAT, 0.0)))
        curved = ca.mtimes(units, ca.mtimes(hessian, units))
        relative = curved / (abs(self.cost) or float(ca.norm_inf(curved)) or 1.0) + flat
        hessian, gradients = _scaled(relative[free, free], ca.mtimes(gradients, units)[held, free])
        matrices = [hessian + ca.mtimes(gradients.T, gradients) / softened for softened in SOFTENED]
        counts = {negative_pivots(matrix, factors_of(matrix.sparsity())) for matrix in matrices}
        return counts.pop() if len(counts) == 1 else None

    def smallest(self) -> None:
        """Nothing: curvatures of a cost have no common scale."""


def _sizes(chain: Chain, unknowns: np.ndarray) -> np.ndarray:
    """Largest of all positions, and of all controls; zero of what these determine."""
    sizes = np.zeros(chain.unknowns)
    for names in (("x", "nodes"), ("controls",)):
        entries = np.concatenate([chain.fields[name].ravel() for name in names])
        sizes[entries] = np.max(np.abs(unknowns[entries]), initial=0.0)
    return sizes


def _met(
    values: np.ndarray, low: np.ndarray, high: np.ndarray, multipliers: np.ndarray, sizes: np.ndarray
) -> np.ndarray:
    """Which values are at a bound: as near as its multiplier is large, or very near."""
    return np.asarray(np.minimum(values - low, high - values) <= np.maximum(np.abs(multipliers), MET * sizes))


def _scaled(hessian: ca.DM, gradients: ca.DM) -> tuple[ca.DM, ca.DM]:
    """Both in units in which every row of [[∇²f̄, Aᵀ], [A, 0]] has a largest entry near one (D. Ruiz, 2001)."""
    n, m = hessian.size1(), gradients.size1()
    matrix = ca.blockcat([[hessian, gradients.T], [gradients, ca.DM(m, m)]])
    rows = np.array(matrix.sparsity().row(), dtype=int)
    for _ in range(ROUNDS):
        largest = np.zeros(n + m)
        np.maximum.at(largest, rows, np.abs(matrix.nonzeros()))
        units = ca.diag(ca.DM(1 / np.sqrt(np.where(largest > 0, largest, 1.0))))
        matrix = ca.mtimes(units, ca.mtimes(matrix, units))
    return matrix[:n, :n], matrix[n:, :n]
