"""Derivatives of answers by the data of their problems; solves as CasADi Functions, NaN where nothing is verified."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.numbers import counted
from casadi_galerkin.calculus.roundoff import EPS, largest_of, or_one
from casadi_galerkin.solvers.linear_solver import factors_of


@dataclass(frozen=True, repr=False, eq=False)
class Sensitivity:
    """Derivatives of a path by the data of its problem.

    Each attribute but `t` has one array for every datum, by name: "start", "end" and "parameters", with an entry in the
    last axis for each value that the problem gives, and of a boundary problem "integral_values".  Of an optimum also
    "start_velocity" and "end_velocity"; and "position_bounds", "control_bounds", "duration_bounds", "parameter_bounds",
    "path_constraint" and "end_conditions", with the last two axes (2, count) of lower and upper bounds.  What the
    problem does not have, or leaves free, is left out.  By bounds that do not act they are zero.

    Those of momenta are derivatives of the Function that `solution_function` makes.  The duration of a boundary problem
    is no datum, but with its length T as a parameter and L(t T, x, v / T) T in place of L, the time span is always from
    0 to 1.

    Attributes
    ----------
    t : (N + 1,), joints
    x : (d, N + 1, ...), of the positions at the joints, in units of x over units of the datum; where durations are
        free, at the same fractions of phases
    control : (n, N r, ...), of the controls of an optimum at the quadrature points
    durations : (phases, ...), of the durations of its phases
    parameters : (count, ...), of its free parameters
    cost : (...), of its cost, by the multipliers alone

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> line = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), start=[0.0], end=[1.0])
    >>> by = cg.sensitivity(cg.solve(line, cg.Galerkin(degree=2), intervals=4))
    >>> by.x["start"][0, :, 0].round(9).tolist(), list(by.x)
    ([1.0, 0.75, 0.5, 0.25, 0.0], ['start', 'end'])
    >>> move = cg.ControlProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0], [0.0], [0.0],
    ...     force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u**2 / 2, controls=1)
    >>> by = cg.sensitivity(cg.solve(move, cg.Galerkin(degree=3), intervals=4))  # the cost is 6 (end - start)²
    >>> by.cost["end"].round(6).tolist(), by.x["end"][0, 1:, 0].round(6).tolist()
    ([12.0], [0.15625, 0.5, 0.84375, 1.0])
    """

    t: np.ndarray
    x: Mapping[str, np.ndarray]
    control: Mapping[str, np.ndarray] = field(default_factory=dict)
    durations: Mapping[str, np.ndarray] = field(default_factory=dict)
    parameters: Mapping[str, np.ndarray] = field(default_factory=dict)
    cost: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Say what was differentiated by what, and the derivatives of a cost."""
        lines = [f"Sensitivity at {counted(len(self.t), 'joint')}"]
        for name, by in self.x.items():
            of_cost = f"of the cost {self.cost[name].tolist()}, " if name in self.cost else ""
            lines.append(f"  by {name}: {of_cost}of x up to {np.max(np.abs(by), initial=0.0):.3g}")
        return "\n".join(lines)


def solved(matrix: ca.DM, rhs: np.ndarray, added: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Solutions of linear equations, refined once, and the effect on these of rounding of their terms, at random.

    Rows and columns are scaled so that their largest entries are near one; what is `added` is on the diagonal then.
    Source: D. Ruiz, Report RAL-TR-2001-034 (2001).
    """
    if not len(rhs):
        return rhs, rhs
    count, sparsity, values = len(rhs), matrix.sparsity(), np.array(matrix.nonzeros())
    row, column = (np.array(index, dtype=int) for index in sparsity.get_triplet())
    left = right = np.ones(count)
    for _ in range(3):
        sizes = np.abs(left[row] * values * right[column])
        left, right = (
            side / np.sqrt(or_one(largest_of(sizes, index, count))) for side, index in ((left, row), (right, column))
        )
    scaled = ca.DM(sparsity, left[row] * values * right[column]) + ca.diag(ca.DM(added * np.ones(count)))
    factors, given = factors_of(scaled.sparsity(), "qr"), ca.DM(left[:, None] * rhs)
    factors.nfact(scaled)
    solution = factors.solve(scaled, given)
    solution += factors.solve(scaled, given - ca.mtimes(scaled, solution))
    signs = np.random.default_rng(count).choice((-1.0, 1.0), rhs.shape)
    rounding = factors.solve(scaled, EPS * signs * ca.mtimes(ca.fabs(scaled), ca.fabs(solution)))
    return right[:, None] * solution.full(), right[:, None] * rounding.full()


def verified_function(
    inputs: Mapping[str, ca.MX],
    outputs: Mapping[str, ca.MX],
    verified: ca.MX,
    guesses: Collection[str],
    derivatives: bool = True,
) -> ca.Function:
    """The Function from inputs to outputs, by name; where it is not verified, the answer and its derivatives are NaN.

    An input that a call leaves out is NaN, too, which no check passes; but a guess is then zero.  Without
    `derivatives` CasADi refuses to differentiate it.
    """
    factor = ca.if_else(verified, 1.0, np.nan)  # the branches of if_else itself would have derivatives of zero
    checked = [factor * value for value in outputs.values()]
    left_out = [0.0 if name in guesses else np.nan for name in inputs]
    enabled = dict.fromkeys(("enable_forward", "enable_reverse", "enable_jacobian"), derivatives)
    options = {"default_in": left_out, **enabled}
    return ca.Function("solution", list(inputs.values()), checked, list(inputs), list(outputs), options)
