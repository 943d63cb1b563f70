"""The functional of a boundary problem: its Lagrangian and force, and the terms of its ends and constraints.

The terms are

    φ(x_0, x_N) + p_0·x_0 - p_N·x_N + μ·ψ(x_0, x_N)      end action, given momenta p_0 and p_N, end conditions
    Λ_a·g(t_a, x_a)                                      a constraint, at every node, but not where all that it
                                                         depends on is given

with multipliers μ and Λ_a.  Λ_a is an impulse, the multiplier λ of the continuous problem times a part of the step.
The phase of a periodic path of given energy is fixed by the end condition n·(x_0 - c) = 0, that x_0 is in the plane
through c with normal n.

A given velocity gives the momentum ∂L/∂v of its component at that end, which depends on given velocities only.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.functional.functional import Functional, LocalTerm
from casadi_galerkin.functional.numbering import Numbering
from casadi_galerkin.functional.pointwise import PointMap
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.callables import is_given, rows_that_depend
from casadi_galerkin.problems.constrained_motion import check_points
from casadi_galerkin.problems.legendre_transform import momentum_at
from casadi_galerkin.problems.problem import END_MOTIONS


def functional_of(problem: BoundaryProblem, method: Galerkin, intervals: int, mapping: PointMap) -> Functional:
    """Build the functional of a problem on a number of intervals."""
    check_points(problem.constraint, method)
    statement, total = _Statement(problem), problem.with_multipliers()
    numbering, given = statement.numbering(method, intervals), len(given_values(problem))
    return Functional(total.lagrangian, numbering, mapping, total.force, statement.terms(numbering), given)


def given_values(problem: BoundaryProblem, plane: np.ndarray | None = None) -> np.ndarray:
    """Given values that are inputs of the graph: end motions, the plane (n, c), integrals, the energy."""
    values = [value for name in END_MOTIONS for value in getattr(problem, name) if value is not None]
    if problem.free_phase:
        values += [0.0] * (2 * problem.dimension) if plane is None else plane.tolist()
    values += problem.integral_values or ()
    return np.array(values + ([] if problem.energy is None else [problem.energy]))


def rows_of_ends(problem: BoundaryProblem, plane: np.ndarray | None) -> ca.Function:
    """(x_0, x_N, η) -> derivatives (2d + k,) of the terms of the ends by these, with η the multipliers."""
    d, at_ends, given = problem.dimension, _Statement(problem).at_ends, given_values(problem, plane)
    x = [ca.SX.sym("x0", d), ca.SX.sym("x1", d)]
    if at_ends is None:
        return ca.Function("rows", [*x, ca.SX(0, 1)], [ca.SX.zeros(2 * d)])
    eta = ca.SX.sym("eta", at_ends[0].size1_in(0) - 2 * d)
    rows = at_ends[0](ca.vertcat(*x, eta), problem.t_span, problem.parameters or [], given)[1]
    return ca.Function("rows", [*x, eta], [rows])


class _Statement:
    """The terms of a problem, on any mesh.

    Attributes
    ----------
    fixed : components of the start and of the end whose positions are given
    at_ends : Function of the term of the ends, and whether its jacobian is symmetric; None where there is no such term
    """

    def __init__(self, problem: BoundaryProblem) -> None:
        self.problem, self.total = problem, problem.with_multipliers()
        self.fixed = [
            tuple(i for i, value in enumerate(side) if value is not None) for side in (problem.start, problem.end)
        ]
        self.at_ends = self._ends()

    @cached_property
    def parameters(self) -> ca.SX:
        """Symbols of the parameters, and of the multipliers of given integrals."""
        return ca.SX.sym("p", len(self.total.parameters or ()))

    @cached_property
    def given(self) -> ca.SX:
        """Symbols of `given_values`."""
        return ca.SX.sym("given", len(given_values(self.problem)))

    def numbering(self, method: Galerkin, intervals: int) -> Numbering:
        """The numbering of the unknowns on a number of intervals, with the multipliers of all terms."""
        d, free_duration = self.problem.dimension, self.problem.energy is not None
        constrained = self._constrained(intervals * method.degree).items()
        multipliers = sum(len(rows) * len(nodes) for rows, nodes in constrained)
        multipliers += 0 if self.at_ends is None else self.at_ends[0].size1_in(0) - 2 * d
        integrals = len(self.problem.integral_values or ())
        counts = multipliers + integrals, integrals
        return Numbering(
            method, intervals, d, self.fixed[0], self.fixed[1], self.problem.periodic, *counts, free_duration
        )

    def _constrained(self, last: int) -> dict[tuple[int, ...], list[int]]:
        """Constraints, and the numbers of the nodes, up to the last one, at which they are imposed, in groups.

        An end has those that depend on a component that is not given there.
        """
        if self.problem.constraint is None:
            return {}
        every = tuple(range(self.problem.constraint.size1_out(0)))
        if self.problem.periodic:
            return {every: list(range(last))}
        groups = {every: list(range(1, last))}
        for node, fixed in zip((0, last), self.fixed, strict=True):
            free = ~np.isin(np.arange(self.problem.dimension), fixed)
            depend = np.flatnonzero(rows_that_depend(self.problem.constraint, "x", free))
            groups.setdefault(tuple(depend.tolist()), []).append(node)
        return {rows: nodes for rows, nodes in groups.items() if rows and nodes}

    def terms(self, numbering: Numbering) -> tuple[LocalTerm, ...]:
        """All terms; their multipliers are numbered in the same order."""
        terms, last = list[LocalTerm](), numbering.intervals * numbering.method.degree
        multipliers = np.arange(numbering.positions, numbering.everywhere.start)
        for rows, nodes in self._constrained(last).items():
            count, at = len(rows) * len(nodes), np.array(nodes)
            of_constraints, multipliers = multipliers[:count].reshape(-1, len(rows)), multipliers[count:]
            entries = np.concatenate((numbering.of_nodes[at], of_constraints), axis=1).T
            terms.append(LocalTerm(self._constraint(rows), entries, _node_times(numbering, at), True))
        if self.at_ends is not None:
            function, symmetric = self.at_ends
            entries = np.concatenate((*numbering.of_nodes[[0, -1]], multipliers))[:, None]
            terms.append(LocalTerm(function, entries, _node_times(numbering, np.array([0, last])), symmetric))
        return tuple(terms)

    def _function(self, name: str, y: ca.SX, t: ca.SX, added: ca.SX, rows: ca.SX) -> ca.Function:
        """The Function of a term, see `LocalTerm`; LDLᵀ needs a symmetric pattern, which an if_else need not have."""
        jacobian = ca.jacobian(rows, y)
        pattern = jacobian.sparsity() + jacobian.sparsity().T
        outputs = [ca.densify(added), ca.densify(rows), ca.project(jacobian, pattern)]
        return ca.Function(name, [y, t, self.parameters, self.given], outputs)

    def _called(self, function: Callable[..., ca.SX], *arguments: ca.SX) -> ca.SX:
        """A callable of the problem at these arguments and, where there are some, the parameters."""
        own = self.problem.parameters
        return function(*arguments, *([] if own is None else [self.parameters[: len(own)]]))

    def _constraint(self, chosen: tuple[int, ...]) -> ca.Function:
        t, x, impulse = ca.SX.sym("t"), ca.SX.sym("x", self.problem.dimension), ca.SX.sym("impulse", len(chosen))
        assert self.problem.constraint is not None
        residual = self._called(self.problem.constraint, t, x)[list(chosen)]
        rows = ca.vertcat(ca.jtimes(residual, x, impulse, True), residual)
        return self._function("constraint", ca.vertcat(x, impulse), t, ca.SX(0), rows)

    def _ends(self) -> tuple[ca.Function, bool] | None:
        """The Function of the ends, and whether its jacobian is symmetric; None where no term states anything of them.

        Its y are x_0 and x_N and the multipliers μ of the end conditions.
        """
        problem, d = self.problem, self.problem.dimension
        names = (*END_MOTIONS, "end_action", "end_conditions")
        if not (problem.free_phase or any(is_given(getattr(problem, name)) for name in names)):
            return None
        x, t, stated = [ca.SX.sym("x0", d), ca.SX.sym("x1", d)], ca.SX.sym("t", 2), self._stated_motions()
        positions, conditions, symmetric = ca.vertcat(*x), ca.SX(0, 1), True
        action = ca.SX(0) if problem.end_action is None else self._called(problem.end_action, *x)
        work = ca.dot(stated["start_momentum"], x[0]) - ca.dot(stated["end_momentum"], x[1])
        if problem.end_conditions is not None:
            conditions = self._called(problem.end_conditions, *x)
        elif problem.free_phase:
            conditions = ca.dot(self.given[:d], x[0] - self.given[d : 2 * d])
        multipliers = ca.SX.sym("multipliers", conditions.numel())
        rows = ca.densify(ca.gradient(action + work + ca.dot(multipliers, conditions), positions))
        for k, name in enumerate(END_MOTIONS[:2]):
            given = [i for i, value in enumerate(getattr(problem, name)) if value is not None]
            at = [t[k], x[k], stated[name], self.parameters][: self.total.lagrangian.n_in()]
            momentum = (-1) ** k * momentum_at(self.total.lagrangian, *at)
            for i in given:
                rows[k * d + i] = momentum[i]
            of_integrals = self.parameters[len(problem.parameters or ()) :]
            if ca.jacobian(momentum[given], ca.vertcat(positions, of_integrals)).nnz():
                symmetric = False
            else:
                work += sum(momentum[i] * x[k][i] for i in given)
        y = ca.vertcat(positions, multipliers)
        return self._function("ends", y, t, ca.vertcat(action, work), ca.vertcat(rows, conditions)), symmetric

    def _stated_motions(self) -> dict[str, ca.SX]:
        """The velocities and momenta given at the ends by name, (d,) each; zero where none is given."""
        given, zero = iter(ca.vertsplit(self.given)), ca.SX(0.0)
        return {
            name: ca.vertcat(*(zero if value is None else next(given) for value in getattr(self.problem, name)))
            for name in END_MOTIONS
        }


def _node_times(numbering: Numbering, nodes: np.ndarray) -> ca.DM:
    """Matrix from the joints to the times of some nodes."""
    m, count = numbering.method.degree, len(nodes)
    interval = np.minimum(nodes // m, numbering.intervals - 1)
    part = numbering.method.element.nodes[nodes - m * interval]
    index = [*range(count)] * 2, np.append(interval, interval + 1).tolist()
    return ca.sparsify(ca.DM.triplet(*index, ca.DM(np.append(1 - part, part)), count, numbering.intervals + 1))
