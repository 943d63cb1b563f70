"""The terms of an optimisation at one quadrature point, and at the two ends, as SX Functions with their derivatives.

At a quadrature point, with L̂(t, h, x, x') = h L(t, x, x'/h), the cost and the rows of the equations are

    c = h ℓ(t, x, v, u),        e = [ ∂L̂/∂x + h F,  ∂L̂/∂x',  g ];

at the ends c = τ, the terminal cost, and e = [p_0, p_N] with p = ∂L/∂v(t, x, v).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.lazy import lazy
from casadi_galerkin.control.numbering import ControlNumbering
from casadi_galerkin.problems.control_problem import ControlProblem


@dataclass(frozen=True)
class PointwiseTerms:
    """The pointwise Functions at one kind of place, and how many such places there are.

    Parameters
    ----------
    name : of the place
    count : number of places
    z : SX, what is known at the place
    active : rows of z that are differentiated by
    cost, action, rows : SX expressions in z
    """

    name: str
    count: int
    z: ca.SX
    active: np.ndarray
    cost: ca.SX
    action: ca.SX
    rows: ca.SX

    @property
    def _by(self) -> ca.SX:
        return self.z[self.active.tolist()]

    def _function(self, inputs: list[ca.SX], output: ca.SX) -> ca.Function:
        function = ca.Function(self.name, inputs, [ca.densify(output)])
        return function.map(self.count) if self.count > 1 else function

    @lazy
    def value(self) -> ca.Function:
        """(z, weight) -> weighted cost, one per place."""
        weight = ca.SX.sym("weight")
        return self._function([self.z, weight], weight * self.cost)

    @lazy
    def weighted_action(self) -> ca.Function:
        """(z, weight) -> weighted action, one per place."""
        weight = ca.SX.sym("weight")
        return self._function([self.z, weight], weight * self.action)

    @lazy
    def gradient(self) -> ca.Function:
        """(z, weight) -> weighted gradient of the cost."""
        weight = ca.SX.sym("weight")
        return self._function([self.z, weight], weight * ca.gradient(self.cost, self._by))

    @lazy
    def equations(self) -> ca.Function:
        """Rows of (z)."""
        return self._function([self.z], self.rows)

    @lazy
    def _jacobian(self) -> ca.SX:
        return ca.jacobian(self.rows, self._by)

    @property
    def jacobian_pattern(self) -> ca.Sparsity:
        """Pattern of the derivatives of the rows at one place."""
        return self._jacobian.sparsity()

    @lazy
    def jacobian(self) -> ca.Function:
        """Nonzeros of the derivatives of the rows, of (z)."""
        return self._function([self.z], ca.vertcat(*self._jacobian.nonzeros()))

    @lazy
    def _lagrangian(self) -> tuple[list[ca.SX], ca.SX]:
        """Inputs (z, weight, multipliers), and the weighted cost with the multiplied rows."""
        weight, multipliers = ca.SX.sym("weight"), ca.SX.sym("multipliers", self.rows.numel())
        return [self.z, weight, multipliers], weight * self.cost + ca.dot(multipliers, self.rows)

    @lazy
    def _hessian(self) -> ca.SX:
        return ca.hessian(self._lagrangian[1], self._by)[0]

    @property
    def hessian_pattern(self) -> ca.Sparsity:
        """Pattern of the second derivatives at one place."""
        return self._hessian.sparsity()

    @lazy
    def hessian(self) -> ca.Function:
        """(z, weight, multipliers) -> nonzeros of the second derivatives of the Lagrangian."""
        return self._function(self._lagrangian[0], ca.vertcat(*self._hessian.nonzeros()))

    def derivative(self, row: int) -> ca.Function:
        """(z, weight, multipliers) -> derivative of the Lagrangian by one row of z."""
        inputs, value = self._lagrangian
        return self._function(inputs, ca.jacobian(value, self.z[row]))


def places(problem: ControlProblem, numbering: ControlNumbering) -> tuple[PointwiseTerms, PointwiseTerms]:
    """Quadrature points and ends of a problem."""
    d, n = numbering.dimension, numbering.parameters
    sizes = [d, d, numbering.controls, 1, n, 1, 1, 1]
    z = ca.SX.sym("z", numbering.point_rows)
    x, slope, u, duration, p, begin, share, part = ca.vertsplit(z, np.cumsum([0, *sizes]).tolist())
    t, h, given = begin + duration * share, duration * part, [p] if n else []
    pulled = h * problem.lagrangian(t, x, slope / h, *given)
    at = (t, x, slope / h, u, *given)
    rows = [ca.gradient(pulled, x) + h * problem.force(*at), ca.gradient(pulled, slope)]
    if problem.path_constraint is not None:
        rows.append(problem.path_constraint[0](*at))
    point = PointwiseTerms(
        "point",
        numbering.points,
        z,
        numbering.active(2 * d + numbering.controls),
        h * problem.running_cost(*at),
        pulled,
        ca.vertcat(*rows),
    )
    z = ca.SX.sym("z", numbering.end_rows)
    sizes = [d, d, d, d, 1, n, 1, 1, 1]
    *states, duration, p, begin, first, last = ca.vertsplit(z, np.cumsum([0, *sizes]).tolist())
    given = [p] if n else []
    start, end = ((begin + duration * s, *states[2 * k : 2 * k + 2]) for k, s in ((0, first), (1, last)))
    momenta = [ca.gradient(problem.lagrangian(*at, *given), at[2]) for at in (start, end)]
    terminal = ca.SX(1, 1) if problem.terminal_cost is None else problem.terminal_cost(*end, *given)
    ends = PointwiseTerms("ends", 1, z, numbering.active(4 * d), terminal, ca.SX(1, 1), ca.vertcat(*momenta))
    return point, ends
