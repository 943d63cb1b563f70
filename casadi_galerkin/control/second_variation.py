"""The second variation of the cost at an optimum, on the tangent space of its active constraints.

The active constraints are the equations, and the bounds and inequalities that are met with equality; A are their
gradients.  By Sylvester's law, for small δ, ∇²f̄ + AᵀA/δ has as many negative eigenvalues as ∇²f̄ has on the directions z
with A z = 0.  A bound that is nearly met, as beside a switch, adds the stiffness |μ|/d of its multiplier over its
distance to ∇²f̄: the first-order cost of a way towards it has no other part in the second variation.  The effect of
rounding is smallest with slopes as unknowns in place of node values, and rows of A of length one.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.roundoff import or_one
from casadi_galerkin.control.chain import Chain
from casadi_galerkin.control.graph import LEAST_COST, ControlGraph
from casadi_galerkin.control.optimizer import NEGLIGIBLE_MOMENTUM, Optimum
from casadi_galerkin.control.solver_error import distances, estimate_remaining_error
from casadi_galerkin.functional.mapping import one_by_one
from casadi_galerkin.problems.bounds import AT_BOUND
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.solution.control_trajectory import RemainingError
from casadi_galerkin.solvers.linear_solver import factors_of, negative_pivots

FLAT = 1e-6  # relative change of the cost that counts as none, as along a singular arc
PENALTIES = 1e-7, 1e-9  # values of δ; where their counts differ, the counts depend on δ or on rounding


@dataclass(frozen=True)
class CostVariation:
    """Second variation of the cost at an optimum; pickled without the graph, which is built again when needed.

    Attributes
    ----------
    problem, method, mesh : as they were solved
    optimum : the point where the solver stopped
    cost : cost of the optimum
    graph : ControlGraph, or None before it is built again
    """

    problem: ControlProblem
    method: Galerkin
    mesh: np.ndarray
    optimum: Optimum
    cost: float
    graph: ControlGraph | None

    def _graph(self) -> ControlGraph:
        return self.graph or ControlGraph(self.problem, Chain(self.problem, self.method, self.mesh), one_by_one)

    def negative(self) -> int | None:
        """Number of independent directions in which the cost decreases to second order; None where rounding hides it.

        A relative decrease of at most `FLAT`, for changes as large as the path, is not counted.
        """
        graph, at = self._graph(), self.optimum
        chain = graph.chain
        values, gradients = graph.jacobian(at.unknowns, at.data)
        sizes, rows = _sizes(chain, at.unknowns), np.array(values).ravel()
        slope = np.abs(np.array(graph.gradient(at.unknowns, at.data)[1]).ravel())
        terms = np.array(ca.mtimes(ca.fabs(gradients), sizes)).ravel()
        costs = slope @ sizes > NEGLIGIBLE_MOMENTUM * (np.abs(at.multipliers) @ terms)
        multipliers = at.multipliers if costs else 0 * at.multipliers  # these are then errors of the solver
        hessian = graph.whole_hessian(at.unknowns, at.data, 1.0, multipliers)[1]
        free = np.flatnonzero(~_active(at.unknowns, at.bounds.unknowns, sizes)).tolist()
        held = np.flatnonzero(_active(rows, at.bounds.equations, np.abs(rows))).tolist()
        units, flat = (ca.diag(ca.DM(a)) for a in (_units(chain, at, sizes), np.where(sizes > 0, FLAT, 0.0)))
        curved = ca.mtimes(units, ca.mtimes(hessian, units))
        largest = float(ca.norm_inf(curved))
        if largest == 0:
            return 0  # the cost does not vary
        if costs:
            stiff = _stiffness(at.unknowns, at.bound_multipliers, at.bounds.unknowns)
            limits = _stiffness(rows, multipliers, at.bounds.equations)
            stiff += ca.mtimes(gradients.T, ca.mtimes(limits, gradients))
            curved += ca.mtimes(units, ca.mtimes(stiff, units))
        measured = abs(self.cost) > LEAST_COST * largest  # else its terms cancel, or it is zero
        relative = curved / (abs(self.cost) if measured else largest) + flat
        change = _slopes(chain, self.mesh)[free, free]
        hessian = ca.mtimes(change.T, ca.mtimes(relative[free, free], change))
        gradients = _normed(ca.mtimes(ca.mtimes(gradients, units)[held, free], change))
        matrices = [hessian + ca.mtimes(gradients.T, gradients) / softened for softened in PENALTIES]
        counts = {negative_pivots(matrix, factors_of(matrix.sparsity())) for matrix in matrices}
        return counts.pop() if len(counts) == 1 else None

    def remaining_error(self) -> RemainingError:
        """Errors of path, durations and cost that the solver has left; see `estimate_remaining_error`."""
        return estimate_remaining_error(self._graph(), self.optimum)

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "graph": None}


def _sizes(chain: Chain, unknowns: np.ndarray) -> np.ndarray:
    """Largest size of positions, of controls and of each free constant, for their entries; zero for other unknowns."""
    sizes = np.zeros(chain.unknowns)
    for names in (["x", "nodes"], ["controls"], *([name] for name in chain.free)):
        entries = np.concatenate([chain.fields[name].ravel() for name in names])
        sizes[entries] = np.max(np.abs(unknowns[entries]), initial=0.0)
    return sizes


def _units(chain: Chain, at: Optimum, sizes: np.ndarray) -> np.ndarray:
    """Units of the unknowns: their sizes, those of the largest component for momenta and velocities; one for a zero.

    A component that is zero all along the path has no size, but its momentum is compared with those of others.
    """
    units, fields = sizes.copy(), chain.fields
    velocities = np.concatenate([fields[name].ravel() for name in ("start_velocity", "end_velocity", "velocity")])
    units[velocities] = np.max(np.abs(at.unknowns[velocities]), initial=0.0)
    if chain.mechanical:
        measures = np.append(at.unknowns, at.data)[fields["sizes"]]  # in which momenta are stored
        units[fields["momentum"]] = np.max(np.abs(at.unknowns[fields["momentum"]] * measures)) / measures
    return or_one(units)


def _slopes(chain: Chain, mesh: np.ndarray) -> ca.DM:
    """The matrix from slopes on the intervals, instead of node values, to the unknowns; all others stay the same.

    On an interval that is a part ε of the duration, the equations compare node values that differ by the order of ε,
    and AᵀA would contain them only with a factor ε².
    """
    nodes, units = chain.fields["nodes"], np.ones(chain.unknowns)
    units[nodes] = (np.diff(mesh) / np.ptp(mesh))[:, None, None]
    states = np.broadcast_to(chain.fields["x"][:-1, None], nodes.shape)
    where = nodes.ravel().tolist(), states.ravel().tolist()
    return ca.diag(ca.DM(units)) + ca.DM.triplet(*where, ca.DM.ones(nodes.size), *[chain.unknowns] * 2)


def _active(values: np.ndarray, bounds: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Which values meet a bound."""
    inside = np.minimum(values - bounds[0], bounds[1] - values)
    return inside <= AT_BOUND * sizes


def _stiffness(values: np.ndarray, multipliers: np.ndarray, bounds: np.ndarray) -> ca.DM:
    """Diagonal matrix of |μ|/d of inequalities at distances d from the bounds on which their multipliers μ act."""
    to_bounds = distances(values, multipliers, *bounds)
    stiffness = np.divide(np.abs(multipliers), to_bounds, out=np.zeros_like(to_bounds), where=to_bounds > 0)
    return ca.sparsify(ca.diag(ca.DM(stiffness)))


def _normed(rows: ca.DM) -> ca.DM:
    """Rows of length one, or zero."""
    lengths = ca.sqrt(ca.sum2(rows**2))
    return ca.mtimes(ca.diag(1 / ca.if_else(lengths > 0, lengths, 1.0)), rows)
