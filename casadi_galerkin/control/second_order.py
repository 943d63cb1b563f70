"""Second-order conditions at an optimum: the remaining error of the solver, and whether it is a minimum or a saddle.

Let A be the derivatives of the equations G, and d the distances of values to the bounds on which their multipliers act.
At the optimum the equations hold, the slopes vanish, and every multiplier or its distance is zero.  The Newton step
(δ, δλ) to this, without the solver's barrier and tolerances, solves

    (∇²f̄ + Σ) δ + Aᵀδλ = -∇f̄,        A δ - D δλ = -G,        Σ = |μ| / d,        D = d / |λ|,

where ∇f̄ are the slopes of the Lagrangian without the multipliers μ of bounds.  For inequalities alone, D is not zero,
and the right-hand side is ±d, with the sign of the multiplier, in place of -G.  The error is `STEPS_LEFT` such steps.
Where the path is not determined at all, all slopes may vanish, and the effect of rounding of the equations shows this.

The active constraints are the equations, and the bounds and inequalities that are met with equality; let A now be their
gradients.  By Sylvester's law, for small δ, ∇²f̄ + AᵀA/δ has as many negative eigenvalues as ∇²f̄ has on the directions
z with A z = 0.  A bound that is nearly met, as beside a switch, adds its stiffness Σ: the first-order cost of a way
towards it has no other part in the second variation.  The effect of rounding is smallest with slopes as unknowns in
place of node values, and rows of A of length one.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.roundoff import EPS, TINY, largest_of, or_one
from casadi_galerkin.control.control_graph import LEAST_COST, ControlGraph
from casadi_galerkin.control.control_numbering import Numbering
from casadi_galerkin.control.control_sensitivity import sensitivity_of
from casadi_galerkin.control.optimizer import ACCEPTABLE, Optimum
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.phases import Phases
from casadi_galerkin.problems.statements import AT_BOUND
from casadi_galerkin.solution.control_trajectory import NEGLIGIBLE, ControlTrajectory, RemainingError
from casadi_galerkin.solvers.derivatives import Sensitivity, solved
from casadi_galerkin.solvers.linear_solver import factors_of, negative_pivots

# errors over Newton steps: where the cost is like a fourth power, a step leaves two thirds of the distance
STEPS_LEFT = 3.0
CONSTRAINT_PENALTY = np.sqrt(EPS)  # δ


@dataclass(frozen=True)
class SecondOrder:
    """Second derivatives of the cost at an optimum; pickled without the graph, which is built again when needed.

    Attributes
    ----------
    problem, method, mesh : as they were solved
    optimum : the point where the solver stopped
    cost : cost of the optimum
    sizes : sizes of the terms of every kind of equation there
    graph : ControlGraph, or None before it is built again
    """

    problem: ControlProblem | Phases
    method: Galerkin
    mesh: np.ndarray
    optimum: Optimum
    cost: float
    sizes: np.ndarray
    graph: ControlGraph | None

    @property
    def known_graph(self) -> ControlGraph:
        """The graph, built again where it was left behind."""
        return self.graph or ControlGraph(self.problem, self.method, self.mesh)

    def remaining_error(self, phase: int | None = None) -> RemainingError:
        """Errors of path, durations and cost that the solver has left, in one phase or the largest of alike ones."""
        chosen = self._remaining_errors if phase is None else [self._remaining_errors[phase]]
        components = np.max([error.components for error in chosen], axis=0)
        return RemainingError(components, max(error.durations for error in chosen), chosen[0].cost)

    @cached_property
    def _remaining_errors(self) -> list[RemainingError]:
        """The same for every phase.

        They are at least the effect of rounding, and infinite where the Newton step is not finite.
        """
        graph, at = self.known_graph, self.optimum
        kinds = graph.numbering.unknown_kinds
        steps = _newton_step(graph, at)
        change = STEPS_LEFT * abs(float(ca.dot(graph.gradient(at.unknowns, at.data)[1], steps[0])))
        sizes = largest_of(np.abs(at.unknowns), kinds)
        first, rounding = (largest_of(np.where(np.isfinite(a), np.abs(a), np.inf), kinds) for a in steps)
        errors = np.fmax(STEPS_LEFT * first, rounding)
        found = list[RemainingError]()
        for chain in graph.numbering.chains:
            lasts = kinds[chain.fields["duration"][-1]] if "duration" in chain.free else kinds[:0]
            of_duration = float(np.max(errors[lasts] / sizes[lasts], initial=0.0))
            components = errors[kinds[chain.fields["x"][0]]]
            found.append(RemainingError(components, of_duration, change if np.isfinite(change) else np.inf))
        return found

    def sensitivity(self, path: ControlTrajectory) -> Sensitivity:
        """Derivatives of the path by the data of its problem."""
        assert isinstance(self.problem, ControlProblem), "a path of Phases has none"
        return sensitivity_of(self.problem, self.known_graph, self.optimum, path)

    def negative(self) -> int:
        """Number of independent directions in which the cost decreases to second order.

        A relative decrease of at most `NEGLIGIBLE`, for changes as large as the path, is not counted.
        """
        matrix, _ = self._second_variation()
        return negative_pivots(matrix, factors_of(matrix.sparsity()))

    def smallest(self) -> None:
        """No relative size of the second variation: see `Trajectory.regularity`."""

    def rounding(self) -> float:
        """Relative roundoff error of the path, whose values are unknowns."""
        return EPS

    def downwards(self) -> np.ndarray:
        """Unknowns that are moved from a saddle to where the cost is less, by the size of the path, within bounds.

        From A = LDLᵀ, the solution of Lᵀ z = e_k has zᵀA z = D_k: of these, the one along which the cost falls most
        steeply, with the sign of less Lagrangian.
        """
        (matrix, to_unknowns), at, graph = self._second_variation(), self.optimum, self.known_graph
        pivots, upper, order = ca.ldl(matrix)
        pivots = np.array(pivots).ravel()
        below = np.flatnonzero(pivots < 0)
        ends = np.zeros((len(pivots), len(below)))
        ends[below, np.arange(len(below))] = 1.0
        ways = np.zeros_like(ends)
        ways[order] = ca.solve(ca.DM.eye(len(pivots)) + upper, ca.DM(ends)).full()
        steepest = np.argmin(pivots[below] / np.sum(ways**2, axis=0))
        way = ways[:, [steepest]]
        step = 1 / np.max(np.abs(way)) * np.array(to_unknowns @ way).ravel()
        moved = [np.clip(at.unknowns + sign * step, *at.bounds.unknowns) for sign in (1.0, -1.0)]

        def lagrangian(unknowns: np.ndarray) -> float:
            cost, _ = graph.gradient(unknowns, at.data)
            equations, _ = graph.jacobian(unknowns, at.data)
            return float(cost + ca.dot(equations, at.multipliers))

        return min(moved, key=lagrangian)

    def _second_variation(self) -> tuple[ca.DM, ca.DM]:
        """The second variation with the active constraints as penalties, and the matrix to unknowns from its own."""
        graph, at = self.known_graph, self.optimum
        numbers = graph.numbering
        values, gradients = graph.jacobian(at.unknowns, at.data)
        sizes, rows = _sizes(numbers, at.unknowns), np.array(values).ravel()
        slope = np.abs(np.array(graph.gradient(at.unknowns, at.data)[1]).ravel())
        terms = np.array(ca.mtimes(ca.fabs(gradients), sizes)).ravel()
        costs = slope @ sizes > ACCEPTABLE * (np.abs(at.multipliers) @ terms)
        multipliers = at.multipliers if costs else 0 * at.multipliers  # these are then errors of the solver
        hessian = graph.whole_hessian(at.unknowns, at.data, 1.0, multipliers)[1]
        free = np.flatnonzero(~_active(at.unknowns, at.bounds.unknowns, sizes)).tolist()
        held = np.flatnonzero(_active(rows, at.bounds.equations, np.abs(rows))).tolist()
        units, flat = (ca.diag(ca.DM(a)) for a in (_units(numbers, at, sizes), np.where(sizes > 0, NEGLIGIBLE, 0.0)))
        curved = ca.mtimes(units, ca.mtimes(hessian, units))
        largest = float(ca.norm_inf(curved))
        if largest == 0:
            return ca.DM.eye(1), ca.DM(numbers.unknowns, 1)  # the cost does not vary
        if costs:
            inequalities = (
                (at.unknowns, at.bound_multipliers, at.bounds.unknowns),
                (rows, multipliers, at.bounds.equations),
            )
            stiff, limits = (ca.sparsify(ca.diag(ca.DM(_stiffness(of[1], _distances(*of))))) for of in inequalities)
            stiff += ca.mtimes(gradients.T, ca.mtimes(limits, gradients))
            curved += ca.mtimes(units, ca.mtimes(stiff, units))
        measured = abs(self.cost) > LEAST_COST * largest  # else its terms cancel, or it is zero
        relative = curved / (abs(self.cost) if measured else largest) + flat
        change = _slopes(numbers, at)[free, free]
        hessian = ca.mtimes(change.T, ca.mtimes(relative[free, free], change))
        gradients = ca.mtimes(ca.mtimes(gradients, units)[held, free], change)
        lengths = ca.sqrt(ca.sum2(gradients**2))
        gradients = ca.mtimes(ca.diag(1 / ca.if_else(lengths > 0, lengths, 1.0)), gradients)
        matrix = hessian + ca.mtimes(gradients.T, gradients) / CONSTRAINT_PENALTY
        return matrix, ca.mtimes(units[:, free], change)

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "graph": None}


def _newton_step(graph: ControlGraph, at: Optimum) -> np.ndarray:
    """The step δ, and the effect on it of rounding of the terms of its equations, with random signs; (2, unknowns).

    `EPS` on the diagonal regularizes undetermined unknowns, such as two redundant controls.  It is not
    added for states, which follow from the others: there it would outweigh the curvature of a cost that hardly depends
    on the path.
    """
    numbers, report = graph.numbering, graph.report(at.unknowns, at.data, at.multipliers)
    (low, high), kinds, alike = at.bounds.equations, numbers.kinds, numbers.unknown_kinds
    to_bounds = _distances(at.unknowns, at.bound_multipliers, at.bounds.unknowns)
    to_limits = _distances(report.equations, at.multipliers, at.bounds.equations)
    free = np.less(*at.bounds.unknowns) & (to_bounds > 0)
    entries, rows = (np.flatnonzero(chosen).tolist() for chosen in (free, np.isfinite(to_limits)))
    states = numbers.entries("x", "nodes", "momentum")
    added = EPS * np.append(np.where(np.isin(entries, states), 0.0, 1.0), -np.ones(len(rows)))
    hessian = graph.whole_hessian(at.unknowns, at.data, 1.0, at.multipliers)[1][entries, entries]
    across = graph.jacobian(at.unknowns, at.data)[1][rows, entries]
    compliance = to_limits[rows] / np.maximum(np.abs(at.multipliers[rows]), TINY)
    diagonal = np.append(_stiffness(at.bound_multipliers, to_bounds)[entries], -compliance)
    matrix = ca.blockcat([[hessian, across.T], [across, ca.DM(len(rows), len(rows))]]) + ca.diag(ca.DM(diagonal))
    gaps = np.where(low == high, high - report.equations, np.copysign(to_limits, at.multipliers))
    sizes = [largest_of(np.abs(a), kind)[kind] for a, kind in ((at.unknowns, alike), (at.multipliers, kinds))]
    terms = np.array(ca.mtimes(ca.fabs(matrix), np.append(sizes[0][entries], sizes[1][rows]))).ravel()
    rounding = EPS * terms * np.random.default_rng(len(terms)).choice((-1.0, 1.0), len(terms))
    rhs = np.stack((np.append(-report.slope[entries], gaps[rows]), rounding), axis=1)
    steps = np.zeros((2, len(free)))
    steps[:, free] = solved(matrix, rhs, added)[0][: len(entries)].T
    return steps


def _distances(values: np.ndarray, multipliers: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """Distances of values to the bounds on which their multipliers act; infinite where a multiplier is zero."""
    low, high = bounds
    to_bound = np.where(multipliers > 0, high - values, values - low)
    return np.where(low == high, 0.0, np.where(multipliers == 0, np.inf, np.maximum(to_bound, 0.0)))


def _stiffness(multipliers: np.ndarray, distances: np.ndarray) -> np.ndarray:
    """|μ|/d of inequalities at distances d from the bounds on which their multipliers μ act; zero at the bounds."""
    return np.divide(np.abs(multipliers), distances, out=np.zeros_like(distances), where=distances > 0)


def _sizes(numbers: Numbering, unknowns: np.ndarray) -> np.ndarray:
    """Largest size of positions, of controls and of each free constant, for their entries; zero for other unknowns."""
    sizes = np.zeros(numbers.unknowns)
    for names in (["x", "nodes"], ["controls"], ["begin"], ["duration"], ["parameters"]):
        entries = numbers.entries(*names)
        sizes[entries] = np.max(np.abs(unknowns[entries]), initial=0.0)
    return sizes


def _units(numbers: Numbering, at: Optimum, sizes: np.ndarray) -> np.ndarray:
    """Units of the unknowns: their sizes, those of the largest component for momenta and velocities; one for a zero.

    A component that is zero all along the path has no size, but its momentum is compared with those of others.
    """
    units, velocities, momenta = sizes.copy(), numbers.entries("start_velocity", "end_velocity"), list[np.ndarray]()
    units[velocities] = np.max(np.abs(at.unknowns[velocities]), initial=0.0)
    for chain, values in zip(numbers.chains, numbers.unpack(at.unknowns, at.data), strict=True):
        momenta.append((values["momentum"] * values["sizes"]).ravel())
        units[chain.fields["momentum"]] = 1 / values["sizes"]  # in which momenta are stored
    units[numbers.entries("momentum")] *= np.max(np.abs(np.concatenate(momenta)), initial=0.0)
    return or_one(units)


def _slopes(numbers: Numbering, at: Optimum) -> ca.DM:
    """The matrix from slopes on the intervals, instead of node values, to the unknowns; all others stay the same.

    On an interval that is a part ε of the duration, the equations compare node values that differ by the order of ε,
    and AᵀA would contain them only with a factor ε².
    """
    units, phases = np.ones(numbers.unknowns), numbers.unpack(at.unknowns, at.data)
    whole, where = sum(values["duration"].item() for values in phases), list[np.ndarray]()
    for chain, values in zip(numbers.chains, phases, strict=True):
        nodes = chain.fields["nodes"]
        units[nodes] = (values["part"] * values["duration"] / whole)[:, None, None]
        states = np.broadcast_to(chain.fields["x"][:-1, None], nodes.shape)
        where.append(np.stack((nodes.ravel(), states.ravel())))
    rows, columns = np.hstack(where)
    ones = ca.DM.ones(len(rows))
    return ca.diag(ca.DM(units)) + ca.DM.triplet(rows.tolist(), columns.tolist(), ones, *[numbers.unknowns] * 2)


def _active(values: np.ndarray, bounds: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Which values meet a bound."""
    inside = np.minimum(values - bounds[0], bounds[1] - values)
    return inside <= AT_BOUND * sizes
