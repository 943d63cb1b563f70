"""The public `BoundaryProblem`: a Lagrangian and what is given at two ends, checked before anything is solved.

stationary    ∫ L(t, x, v) dt + φ(x_0, x_N)
subject to    g(t, x) = 0,     ψ(x_0, x_N) = 0,     ∫ G(t, x, v) dt = c,
              ends, velocities, momenta or an energy that are given,

with a force F, if there is one, that adds its virtual work ∫ F·δx dt.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.numbers import components, counted, finite
from casadi_galerkin.calculus.roundoff import EPS, TINY, component_sizes
from casadi_galerkin.problems import statements
from casadi_galerkin.problems.callables import depends_on_time, is_given, pattern, too_many, with_multipliers
from casadi_galerkin.problems.constrained_motion import constraint_at_ends, impossible_constraint
from casadi_galerkin.problems.legendre_transform import generic_places, legendre_transform, singular_mass
from casadi_galerkin.problems.problem import END_MOTIONS, ENDS, Problem, with_values
from casadi_galerkin.problems.statements import Statement, optional, plain

Given = tuple[float | None, ...]


def _end(name: str, value: Any, problem: BoundaryProblem) -> Given:
    """As `start`, but left out where the path is periodic, and only there."""
    if value is None and not problem.periodic:
        raise ValueError(
            f"end must have {counted(problem.dimension, 'component')}, got None; None is for a periodic path"
        )
    return statements.vector(name, value, problem)


def _ends(problem: BoundaryProblem) -> Iterator[str]:
    """Statements on the ends contradict one another, or are too many."""
    if problem.periodic and is_given(problem.end):
        yield (
            f"a periodic path ends where it starts: leave out end, got {list(problem.end)}; a path that ends whole "
            "turns later has end_conditions in place of periodic"
        )
    stated = [name for name in (*END_MOTIONS, "end_action", "end_conditions") if is_given(getattr(problem, name))]
    if problem.periodic and stated:
        yield f"a periodic path has no ends: leave out {', '.join(stated)}"
    given = [name for name in END_MOTIONS[:2] if is_given(getattr(problem, name))]
    if problem.constraint is not None and given:
        yield f"a constraint leaves only tangent velocities: instead of {given[0]} give the momentum there"


def _given_at_ends(problem: BoundaryProblem) -> list[dict[str, float]]:
    """What is given of every component at the start, and then at the end, by name."""
    given = [{name: values for name, values in problem.given.items() if name.startswith(side)} for side in ENDS]
    components = range(problem.dimension)
    return [{name: v for name, x in some.items() if (v := x[i]) is not None} for some in given for i in components]


def _twice_given(problem: BoundaryProblem) -> Iterator[str]:
    """More than one of position, velocity and momentum is given of a component."""
    for k, given in enumerate(_given_at_ends(problem)):
        if len(given) > 1:
            words = " and ".join(f"{name}[{k % problem.dimension}] = {value}" for name, value in given.items())
            yield f"only one of position, velocity and momentum may be given at an end, got {words}"


def _coupled_velocities(problem: BoundaryProblem) -> Iterator[str]:
    """The momentum of a given velocity depends on one that is not given."""
    for end in ENDS:
        given = np.array([value is not None for value in getattr(problem, f"{end}_velocity")])
        if given.any():
            coupled = pattern(legendre_transform(problem.with_multipliers().lagrangian), 2)[given].any(axis=0)
            if (coupled & ~given).any():
                yield (
                    f"{end}_velocity[{np.argmax(given)}] is given, and by the mass matrix its momentum depends on that "
                    f"of component {np.argmax(coupled & ~given)}, which is not: give both, or {end}_momentum, or state "
                    "a ControlProblem, whose ends take any of these"
                )


def _functions_of_ends(problem: BoundaryProblem) -> Iterator[str]:
    """An end action or end conditions that no free component can follow."""
    d, given = problem.dimension, _given_at_ends(problem)
    free = np.array([not values for values in given])
    for name in ("end_action", "end_conditions"):
        function = getattr(problem, name)
        if function is None:
            continue
        uses = np.hstack([pattern(function, k) for k in range(2)])
        used = uses.any(axis=0)
        for i in np.flatnonzero(used).tolist():
            if given[i] and ENDS[i // d] not in given[i]:
                where = f"{ENDS[i // d]} component {i % d}"
                yield f"{name} depends on {where}, where {min(given[i])} is given: leave out one"
        if not np.any(used & free):
            yield f"{name} depends on no component that is free at the ends, so it changes nothing"
        if name == "end_conditions":
            yield from too_many(name, uses, free)


def _energy(problem: BoundaryProblem) -> Iterator[str]:
    """A given energy is not conserved, or the problem says more than it leaves free."""
    if problem.energy is None:
        return
    if problem.force is not None:
        yield "a force changes the energy: give force or energy, got both"
    if not problem.autonomous:
        yield "a given energy needs a lagrangian and a constraint that do not depend on t"
    if problem.breakpoints:
        yield f"a given energy frees the duration, so that breakpoints have no place, got {problem.breakpoints}"


def _integrals(problem: BoundaryProblem) -> Iterator[str]:
    """Some integrals are the same for all paths between the ends, or follow from others.

    Their variations are ∫ (∂g/∂x - d/dt ∂g/∂v)·δx dt, and ∂g/∂v·δx at free ends: these are evaluated at random places.
    """
    conditions = problem.numeric.integral_conditions
    if conditions is None:
        return
    integrands, values = conditions
    symbols, d, count = integrands.sx_in(), problem.dimension, len(values)
    acceleration, g = ca.SX.sym("acceleration", d), integrands(*symbols)
    pull, slope = (ca.densify(ca.jacobian(g, symbol)) for symbol in symbols[1:])
    rate = ca.jtimes(ca.vec(slope), ca.vertcat(*symbols), ca.vertcat(1, symbols[2], acceleration))
    free = np.isnan(problem.given_positions).any(axis=0).astype(float)
    changes = ca.horzcat(pull - ca.reshape(rate, count, d), slope @ ca.diag(ca.DM(free)))
    terms, rank = ca.fabs(pull) + ca.fabs(ca.reshape(rate, count, d)) + ca.fabs(slope), -1
    variation = ca.Function("variation", [*symbols, acceleration], [changes, terms]).map(2 * count)
    size = component_sizes(np.nan_to_num(problem.given_positions).T)
    for unit in 10.0 ** np.arange(-8, 9):  # nothing tells the size of what is zero at the ends
        t, *places = generic_places(problem, 2 * count, unit)
        found, largest = (np.array(m).reshape(count, 2 * count, -1) for m in variation(t[None, :], *places))
        found, largest = found * np.tile(size, 2), largest * size
        finite = np.isfinite(found).all(axis=(0, 2)) & np.isfinite(largest).all(axis=(0, 2))
        if finite.any():
            scale = np.maximum(largest[:, finite].max(axis=(1, 2)), TINY)[:, None]
            rank = max(rank, int(np.linalg.matrix_rank(found[:, finite].reshape(count, -1) / scale, tol=EPS**0.5)))
    if 0 <= rank < count:
        yield (
            f"integral_conditions are {count}, but only {rank} of the integrals can be given one by one: the "
            "others are the same for all paths between these ends, or follow from them. Leave them out"
        )


RULES = _ends, _twice_given, _functions_of_ends, impossible_constraint, _energy, _integrals


@dataclass(frozen=True, repr=False)
class BoundaryProblem(Problem):
    """A path between two configurations that makes the action ∫ L(t, x, dx/dt) dt stationary.

    Parameters
    ----------
    lagrangian : callable (t, x, v) or, with parameters, (t, x, v, p) -> scalar
        t scalar, x and v CasADi vectors of shape (d,), p of shape (len(parameters),); written with CasADi functions
    t_span : (t_0, t_N), in the unit of time of the Lagrangian; with `energy`, t_N is a guess
    start, end : d numbers each, in the units of x; here and below a number is enough where d = 1.  None leaves the
        component free, with zero momentum there (natural boundary condition) unless one of the following says otherwise
    parameters : numbers passed to all callables as p, their last argument; default none
    periodic : whether x(t_N) = x(t_0) with equal momenta; `end` is left out.  `start` may fix components of that point,
        whose momenta may then differ; if one component is fixed and the energy given, they do not, and the orbit must
        cross the value of that component, not lie in it
    force : callable (t, x, v) -> d generalized forces, that do the virtual work F·δx (Lagrange-d'Alembert)
    constraint : callable (t, x) -> k < d values that are zero all along the path (holonomic)
    start_velocity, end_velocity, start_momentum, end_momentum : d numbers each, None where nothing is given.  They
        replace the natural condition of a component whose position is None.  Under a constraint only the tangent part
        of a momentum counts, and velocities cannot be given; nor can,
        elsewhere, a velocity whose momentum depends on one that is not given
    end_action : callable (x_0, x_N) -> scalar φ, added to the action, so that p_0 = ∂φ/∂x_0 and p_N = -∂φ/∂x_N where
        the position is free: springs, costs of the end
    end_conditions : callable (x_0, x_N) -> values that are zero: an end on a curve, an end that is the start rotated.
        The momenta that go with them, across the curve, follow (transversality)
    integral_conditions : (g, values), a callable (t, x, v) -> k integrands and what their integrals ∫ g dt are (one
        number alone, where there is one).  Each has a multiplier, `Trajectory.integral_multipliers`, and the path is
        one of L + μ·g, of which also its momenta, its energy and its Morse index among paths of these integrals are
    energy : a number, the energy p·v - L of the path; it frees the duration, and L must not depend on time.  A periodic
        path of given energy could begin anywhere on its orbit: it begins in the plane through the start of the guess
        and across its velocity there
    breakpoints : increasing times inside of `t_span` where L or a force is not smooth, such as the knots of tabulated
        data.  Every mesh has them as joints, so that the order holds between them.  Where L jumps in time, take a rule
        without points at the ends of an interval, such as Gauss: a function of time has one value there

    Raises
    ------
    TypeError, ValueError
        naming what came and what was expected

    Examples
    --------
    >>> BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), start=0.0, end=1.0).dimension
    1
    """

    lagrangian: statements.Lagrangian = Statement(statements.lagrangian)
    t_span: statements.Span = Statement(statements.read_span)
    start: statements.Components = Statement(plain(components))
    end: statements.Components = Statement(_end, None)
    _: KW_ONLY
    parameters: statements.NumbersOrNone = Statement(statements.read_parameters, None)
    periodic: Statement[bool, bool] = Statement(statements.read_switch, False)
    force: statements.FunctionOrNone = statements.function("t x v", "dimension")
    constraint: statements.FunctionOrNone = statements.function("t x", "any")
    start_velocity: statements.Components = Statement(statements.vector, None)
    end_velocity: statements.Components = Statement(statements.vector, None)
    start_momentum: statements.Components = Statement(statements.vector, None)
    end_momentum: statements.Components = Statement(statements.vector, None)
    end_action: statements.FunctionOrNone = statements.function("x0 x1", "scalar")
    end_conditions: statements.FunctionOrNone = statements.function("x0 x1", "any")
    integral_conditions: statements.Integrals = Statement(optional(statements.integrals), None)
    energy: Statement[float | None, float | None] = Statement(optional(plain(finite)), None)
    breakpoints: statements.Times = Statement(statements.times, ())
    rules, rules_of_values, rules_of_masses = RULES, (constraint_at_ends,), (singular_mass, _coupled_velocities)

    @property
    def given_positions(self) -> np.ndarray:
        """Positions given at start and end, NaN where none is; those of a periodic path hold at both; (2, d)."""
        return np.array([self.start, self.start if self.periodic else self.end], dtype=float)

    @property
    def free_phase(self) -> bool:
        """Whether a periodic path of given energy may begin anywhere on its orbit, until a guess fixes that."""
        return self.energy is not None and self.periodic and not is_given(self.start)

    @property
    def autonomous(self) -> bool:
        """Whether the energy is conserved: no force acts, and neither Lagrangian nor constraint depends on time."""
        return self.force is None and not depends_on_time(self.with_multipliers().lagrangian, self.constraint)

    @property
    def integral_values(self) -> tuple[float, ...] | None:
        """What the integrals of `integral_conditions` are; None where there are none."""
        return None if self.integral_conditions is None else self.integral_conditions[1]

    def with_multipliers(self, multipliers: Sequence[float] | None = None) -> BoundaryProblem:
        """The problem of L + μ·g in place of integral conditions; μ, by default any numbers, end its parameters."""
        if self.integral_conditions is None:
            return self
        integrands, values = self.integral_conditions
        mu = np.cos(1.0 + np.arange(len(values))) if multipliers is None else multipliers
        own, count = self.parameters or (), len(values)
        functions = {
            name: with_multipliers(function, len(own), count, integrands if name == "lagrangian" else None)
            for name, function in vars(self).items()
            if isinstance(function, ca.Function)
        }
        return with_values(self, **functions, parameters=(*own, *map(float, mu)), integral_conditions=None)
