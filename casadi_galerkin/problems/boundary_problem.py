"""What a boundary problem states, checked before anything is solved; no solve calls back into Python.

stationary    ∫ L(t, x, v) dt + φ(x_0, x_N)
subject to    g(t, x) = 0,     ψ(x_0, x_N) = 0,     ends, velocities, momenta or an energy that are given,

with a force F, if there is one, that adds its virtual work ∫ F·δx dt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from reprlib import repr as shown
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.numbers import components, counted, finite, flag, numbers, time_span, times_inside
from casadi_galerkin.problems.callables import Traceable, arguments, depends_on_time, trace_if, trace_lagrangian
from casadi_galerkin.problems.constrained_motion import check_constraint
from casadi_galerkin.problems.legendre_transform import legendre_transform
from casadi_galerkin.problems.problem import END_MOTIONS, ENDS, with_changes

Given = tuple[float | None, ...]
SAME_ENERGY = 1e-9  # relative difference of two energies below which rounding may be the cause


@dataclass(frozen=True, repr=False)
class BoundaryProblem:
    """A path between two configurations that makes the action ∫ L(t, x, dx/dt) dt stationary.

    Parameters
    ----------
    lagrangian : callable (t, x, v) or, with parameters, (t, x, v, p) -> scalar
        t scalar, x and v CasADi vectors of shape (d,), p of shape (len(parameters),); written with CasADi functions
    t_span : (t_0, t_N), in the unit of time of the Lagrangian; with `energy`, t_N is a guess
    start, end : d numbers each, in the units of x; None leaves the component free, with zero momentum there
        (natural boundary condition) unless one of the following says otherwise
    parameters : numbers passed to all callables as p, their last argument; default none
    periodic : whether x(t_N) = x(t_0) with equal momenta; `end` is left out.  `start` may fix components of that point,
        whose momenta may then differ; if one component is fixed and the energy given, they do not, and the orbit must
        cross the value of that component, not lie in it
    force : callable (t, x, v) -> d generalized forces, that do the virtual work F·δx (Lagrange-d'Alembert)
    constraint : callable (t, x) -> k < d values that are zero all along the path (holonomic)
    start_velocity, end_velocity, start_momentum, end_momentum : d numbers each, None where nothing is given.  They
        replace the natural condition of a component whose position is None.  Under a constraint only the tangent part
        of a momentum counts, and velocities cannot be given
    end_action : callable (x_0, x_N) -> scalar φ, added to the action, so that p_0 = ∂φ/∂x_0 and p_N = -∂φ/∂x_N where
        the position is free: springs, costs of the end
    end_conditions : callable (x_0, x_N) -> values that are zero: an end on a curve, an end that is the start rotated.
        The momenta that go with them, across the curve, follow (transversality)
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
    >>> BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2, (0, 1), start=[0.0], end=[1.0]).dimension
    1
    """

    lagrangian: ca.Function
    t_span: tuple[float, float]
    start: Given
    end: Given
    parameters: tuple[float, ...] | None
    periodic: bool
    force: ca.Function | None
    constraint: ca.Function | None
    start_velocity: Given
    end_velocity: Given
    start_momentum: Given
    end_momentum: Given
    end_action: ca.Function | None
    end_conditions: ca.Function | None
    energy: float | None
    breakpoints: tuple[float, ...]

    def __init__(
        self,
        lagrangian: Traceable,
        t_span: Sequence[float],
        start: Sequence[float | None],
        end: Sequence[float | None] | None = None,
        *,
        parameters: Sequence[float] | None = None,
        periodic: bool = False,
        force: Traceable | None = None,
        constraint: Traceable | None = None,
        start_velocity: Sequence[float | None] | None = None,
        end_velocity: Sequence[float | None] | None = None,
        start_momentum: Sequence[float | None] | None = None,
        end_momentum: Sequence[float | None] | None = None,
        end_action: Traceable | None = None,
        end_conditions: Traceable | None = None,
        energy: float | None = None,
        breakpoints: Sequence[float] = (),
    ) -> None:
        closed = flag("periodic", periodic)
        checked_start = components("start", start)
        dimension = len(checked_start)
        checked_end = (None,) * dimension if end is None else components("end", end, dimension)
        if periodic and any(value is not None for value in checked_end):
            raise ValueError(
                f"a periodic path ends where it starts: leave out end, got {end!r}; a path that ends whole turns later "
                "has end_conditions in place of periodic"
            )
        if end is None and not periodic:
            raise ValueError(f"end must have {counted(dimension, 'component')}, got None; None is for a periodic path")
        checked = None if parameters is None else numbers("parameters", parameters)
        given = dict(zip(END_MOTIONS, (start_velocity, end_velocity, start_momentum, end_momentum), strict=True))
        along = arguments(checked, t=1, x=dimension, v=dimension)
        at_ends = arguments(checked, x0=dimension, x1=dimension)
        span = time_span(t_span)
        values = {
            "lagrangian": trace_lagrangian(lagrangian, along),
            "t_span": span,
            "breakpoints": times_inside("breakpoints", breakpoints, span),
            "start": checked_start,
            "end": checked_end,
            "parameters": checked,
            "periodic": closed,
            "force": trace_if("force", force, along, dimension),
            "constraint": trace_if("constraint", constraint, arguments(checked, t=1, x=dimension), "any"),
            **{name: (None,) * dimension if a is None else components(name, a, dimension) for name, a in given.items()},
            "end_action": trace_if("end_action", end_action, at_ends, "scalar"),
            "end_conditions": trace_if("end_conditions", end_conditions, at_ends, "any"),
            "energy": None if energy is None else finite("energy", energy),
        }
        self.__dict__.update(values)  # the class is frozen
        _check_ends(self)
        check_constraint(self)
        _check_energy(self)

    def __repr__(self) -> str:
        """State the problem without its Lagrangian."""
        said = [f"start {shown(self.start)}", "periodic" if self.periodic else f"end {shown(self.end)}"]
        said += [f"parameters {shown(self.parameters)}"]
        said += [f"energy {self.energy:g}"] if self.energy is not None else []
        said += [name for name in ("force", "constraint", "end_action", "end_conditions") if getattr(self, name)]
        said += [f"{name} {shown(getattr(self, name))}" for name in END_MOTIONS if is_given(getattr(self, name))]
        return f"BoundaryProblem of {counted(self.dimension, 'component')} on {self.t_span}: {', '.join(said)}"

    @property
    def dimension(self) -> int:
        """Number d of coordinates."""
        return len(self.start)

    @property
    def given_positions(self) -> np.ndarray:
        """Positions given at start and end, NaN where none is; those of a periodic path hold at both; (2, d)."""
        return np.array([self.start, self.start if self.periodic else self.end], dtype=float)

    @property
    def autonomous(self) -> bool:
        """Whether the energy is conserved: no force acts, and neither Lagrangian nor constraint depends on time."""
        return self.force is None and not depends_on_time(self.lagrangian, self.constraint)

    def varied(self, changes: Mapping[str, Any], t_span: Sequence[float] | None = None) -> BoundaryProblem:
        """Copy with other given values.

        Parameters
        ----------
        changes : new values by name, such as start, end or parameters: with None exactly where the problem has None;
            None as a whole changes nothing
        t_span : (t_0, t_N) with the breakpoints inside; default the same
        """
        other = with_changes(self, changes, t_span)
        check_constraint(other)
        return other


def _check_ends(problem: BoundaryProblem) -> None:
    """Refuse statements on the ends that contradict one another, or are too many."""
    stated = [name for name in (*END_MOTIONS, "end_action", "end_conditions") if is_given(getattr(problem, name))]
    if problem.periodic and stated:
        raise ValueError(f"a periodic path has no ends: leave out {', '.join(stated)}")
    given = [name for name in END_MOTIONS[:2] if is_given(getattr(problem, name))]
    if problem.constraint is not None and given:
        raise ValueError(f"a constraint leaves only tangent velocities: instead of {given[0]} give the momentum there")
    taken = []
    for side in ENDS:
        position, *motions = (getattr(problem, name) for name in (side, f"{side}_velocity", f"{side}_momentum"))
        for i, (x, velocity, momentum) in enumerate(zip(position, *motions, strict=True)):
            named = {side: x, f"{side}_velocity": velocity, f"{side}_momentum": momentum}
            named = {name: value for name, value in named.items() if value is not None}
            if len(named) > 1:
                words = " and ".join(f"{name}[{i}] = {value}" for name, value in named.items())
                raise ValueError(f"only one of position, velocity and momentum may be given at an end, got {words}")
            taken.append(list(named))
    for name in ("end_action", "end_conditions"):
        function = getattr(problem, name)
        if function is not None:
            _check_end_function(name, function, taken)


def is_given(value: object) -> bool:
    """Whether anything is given: not None, nor components that are all None."""
    return any(a is not None for a in value) if isinstance(value, tuple) else value is not None


def _check_end_function(name: str, function: ca.Function, taken: list[list[str]]) -> None:
    """Refuse a function of the ends that no free component can follow; `taken` lists what is given of each."""
    d = len(taken) // 2
    pattern = ca.horzcat(function.sparsity_jac(0, 0), function.sparsity_jac(1, 0))
    depends = [i in pattern.get_col() for i in range(2 * d)]
    for i, (given, used) in enumerate(zip(taken, depends, strict=True)):
        if used and given and given[0] not in ENDS:
            raise ValueError(
                f"{name} depends on {ENDS[i // d]} component {i % d}, where {given[0]} is given: leave out one"
            )
    free = [i for i, given in enumerate(taken) if not given]
    if not any(depends[i] for i in free):
        raise ValueError(f"{name} depends on no component that is free at the ends, so it changes nothing")
    count = function.size1_out(0)
    if name == "end_conditions":
        rank = ca.sprank(ca.DM(pattern, 1.0)[:, free])
        if rank < count:
            raise ValueError(
                f"end_conditions are {count}, but only {rank} can be met by the {counted(len(free), 'component')} free "
                "at the ends: leave out some, or free more components with None"
            )


def _check_energy(problem: BoundaryProblem) -> None:
    if problem.energy is None:
        return
    if problem.force is not None:
        raise ValueError("a force changes the energy: give force or energy, got both")
    if not problem.autonomous:
        raise ValueError("a given energy needs a lagrangian and a constraint that do not depend on t")
    if problem.breakpoints:
        raise ValueError(
            f"a given energy frees the duration, so that breakpoints have no place, got {problem.breakpoints}"
        )
    _check_rest(problem, problem.energy)


def _check_rest(problem: BoundaryProblem, energy: float) -> None:
    """Refuse an energy below that of rest at a given end, which is the least one where kinetic energies are positive.

    It is checked where ∂²L/∂v² does not depend on v: otherwise the energy need not be least at rest.
    """
    transform = legendre_transform(problem.lagrangian)
    if transform.sparsity_jac(2, 1).nnz():
        return
    given = [] if problem.parameters is None else [problem.parameters]
    for name in ENDS:
        place = getattr(problem, name)
        if None in place:
            continue
        at = (problem.t_span[0], place, [0.0] * problem.dimension, *given)
        rest, mass = -float(problem.lagrangian(*at)), transform(*at)[1].full()
        lower = rest - energy > SAME_ENERGY * max(abs(rest), abs(energy))
        if lower and np.isfinite(mass).all() and np.all(np.linalg.eigvalsh(mass) > 0):
            raise ValueError(
                f"no path of the energy {energy:g} goes through the {name} {list(place)}, where rest has {rest:g}"
            )
