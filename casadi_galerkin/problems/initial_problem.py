"""The public `InitialProblem`: a path from a position and a momentum, or velocity, at the start."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from functools import partial

import numpy as np

from casadi_galerkin.calculus.numbers import numbers
from casadi_galerkin.problems import statements
from casadi_galerkin.problems.constrained_motion import constraint_at_ends, impossible_constraint, tangent_momenta
from casadi_galerkin.problems.legendre_transform import legendre_transform, singular, velocities
from casadi_galerkin.problems.problem import Problem
from casadi_galerkin.problems.statements import Statement, check, optional, plain


def _stateless(problem: InitialProblem) -> tuple[()]:
    """A start that has no velocity or no mass, which is refused where its state is found."""
    momentum, velocity = (None if given is None else [*given] for given in (problem.momentum, problem.velocity))
    if (momentum is None) == (velocity is None):
        raise ValueError(f"give either momentum or velocity, got momentum={momentum} and velocity={velocity}")
    _ = problem.start_state
    return ()


@dataclass(frozen=True, repr=False)
class InitialProblem(Problem):
    """A path from a position and a momentum, or velocity, at the start.

    Parameters
    ----------
    lagrangian : callable (t, x, v) or, with parameters, (t, x, v, p) -> scalar, as for `BoundaryProblem`
    t_span : (t_0, t_N), in the unit of time of the Lagrangian
    start : d numbers, x(t_0); here and below a number is enough for one component
    momentum : d numbers, p(t_0) = ∂L/∂v; or
    velocity : d numbers, v(t_0)
    parameters : numbers passed to the callables as p; default none
    force : callable of the same arguments -> d generalized forces, that do the virtual work F·δx
        (Lagrange-d'Alembert); default none
    constraint : callable (t, x) -> k < d values that are zero all along the path (holonomic); default none.  `start`
        fulfils it, and `velocity` is tangent to it; of `momentum` the tangent part counts

    Raises
    ------
    TypeError, ValueError
        naming what came and what was expected

    Examples
    --------
    >>> InitialProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), start=1.0, velocity=0.0).dimension
    1
    """

    lagrangian: statements.Lagrangian = Statement(statements.lagrangian)
    t_span: statements.Span = Statement(statements.read_span)
    start: statements.Numbers = Statement(plain(numbers))
    _: KW_ONLY
    momentum: statements.NumbersOrNone = Statement(optional(statements.whole_vector), None)
    velocity: statements.NumbersOrNone = Statement(optional(statements.whole_vector), None)
    parameters: statements.NumbersOrNone = Statement(statements.read_parameters, None)
    force: statements.FunctionOrNone = statements.function("t x v", "dimension")
    constraint: statements.FunctionOrNone = statements.function("t x", "any")
    breakpoints = ()  # which other problems have
    rules, rules_of_values = (impossible_constraint,), (constraint_at_ends, _stateless)

    @property
    def start_state(self) -> tuple[np.ndarray, np.ndarray]:
        """Momentum and velocity (d,) at the start, one from the other through p = ∂L/∂v."""
        lagrangian = self.numeric.lagrangian
        legendre = legendre_transform(lagrangian)
        x, start = np.array(self.start), self.t_span[0]
        v, given = np.array(self.velocity or np.zeros(len(x))), self.momentum
        if given is not None:
            at = np.array([start]), x[:, None]
            p = tangent_momenta(self, *at, np.array(given)[:, None], v[:, None])
            v = velocities(legendre, *at, p, v[:, None])[:, 0]
        tried = np.where(np.isfinite(v), v, 0.0)
        momentum, mass = (np.array(a) for a in legendre(start, x, tried))
        check(mass, [partial(singular, where=f"at the start, x = {x}, v = {tried}")])
        if not np.all(np.isfinite(v)):
            raise ValueError(
                f"no velocity was found that has the momentum {given} at the start, x = {x}; give the velocity"
            )
        if np.isnan(float(lagrangian(start, x, v))):
            raise ValueError(f"the lagrangian is not a number at the start, x = {self.start}, v = {v.tolist()}")
        return (momentum if given is None else p).ravel(), v
