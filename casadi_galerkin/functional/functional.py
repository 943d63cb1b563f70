"""The one graph: the discrete functional S = ∫ L(t, x̄, dx̄/dt) Δ_w t, its gradient and its Hessian.

The paper's sentence is the code: embed, evaluate pointwise, integrate.  With E the constant matrix that takes
the node values to (x, x') at the quadrature points, and L̂ the Lagrangian pulled back to the reference interval,

    S    = Σ w_k L̂(E X̄)_k
    ∇S   = Eᵀ [ w_k ∇L̂ ]                      discrete Euler-Lagrange equations, (euler1) and (euler2) of the paper
    ∇²S  = Eᵀ blockdiag( w_k ∇²L̂ ) E.

L̂, ∇L̂ and ∇²L̂ are SX Functions of one point (`pointwise`), mapped over all points; nothing is differentiated
through the graph.  E, Eᵀ and Eᵀ blockdiag(·) E depend on the numbering alone (`embedding`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeAlias

import casadi as ca

from casadi_galerkin.calculus.lazy import lazy
from casadi_galerkin.functional.embedding import (
    Embedded,
    assembly,
    boundary_terms,
    embedded,
    embedding,
    integration,
    joint_time_derivatives,
    summation,
)
from casadi_galerkin.functional.mapping import Mapping, by_rows, one_by_one
from casadi_galerkin.functional.numbering import Numbering, kept
from casadi_galerkin.functional.pointwise import pointwise

Parts: TypeAlias = tuple[dict[str, ca.MX], list[str], list[ca.MX]]  # inputs beside the symbols; names; outputs

MANY = 1000  # points from which rows pay within one solve: they take some 25 us an instruction to build


class Functional:
    """The discrete functional of a Lagrangian: its expressions, and the Functions made of them.

    Every Function takes (unknowns, start, end, mesh[, parameters]), some of them one input more; `start` and `end` hold
    the fixed components only.  A Function is built when it is first asked for, and kept.

    Parameters
    ----------
    lagrangian : Function (t, x, v[, p]) -> scalar
    numbering : Numbering
    mapping : `one_by_one`, which is quick to build, or `by_rows`, which is quick to evaluate; many points always go
        by rows

    Attributes
    ----------
    pointwise : Pointwise, L̂ and its derivatives at one point
    build_seconds : float, spent on building so far
    """

    def __init__(self, lagrangian: ca.Function, numbering: Numbering, mapping: Mapping = by_rows) -> None:
        began = time.perf_counter()
        self.pointwise, self.numbering = pointwise(lagrangian), kept(numbering)
        self._mapping = by_rows if numbering.points >= MANY else mapping
        self._shared = (4,) if lagrangian.n_in() == 4 else ()  # after t, h, x and x' the parameters
        self._parameters = [ca.MX.sym("parameters", lagrangian.size1_in(3))] if self._shared else []
        stored = self.pointwise.stored
        self.pattern_key = (self.numbering, tuple(stored.colind()), tuple(stored.row()))
        self._functions: dict[str, ca.Function] = {}
        self.build_seconds = time.perf_counter() - began

    @lazy
    def _embedded(self) -> Embedded:
        """The embedded symbols, kept: all Functions must have the same, even where the cache has dropped them."""
        return embedded(self.numbering)

    @lazy
    def symbols(self) -> dict[str, ca.MX]:
        """Unknowns ξ, start, end, mesh and, if the Lagrangian has some, parameters, by name."""
        return self._embedded.symbols | {symbol.name(): symbol for symbol in self._parameters}

    @lazy
    def u(self) -> ca.MX:
        """The vector u = (ξ, start, end) of the numbering."""
        return self._embedded.u

    @lazy
    def _at(self) -> list[ca.MX]:
        return [*self._embedded.points, *self._parameters]

    def _at_points(self, function: ca.Function) -> list[ca.MX]:
        return list(self._mapping(function, self.numbering.points, self._shared).call(self._at))

    @lazy
    def _second(self) -> list[ca.MX]:
        """L̂, its first and its second derivatives at all points."""
        return self._at_points(self.pointwise.derivatives)

    @lazy
    def _first(self) -> list[ca.MX]:
        """L̂ and its first derivatives at all points.

        One by one, so little is solved that building them apart would cost more than it saves.
        """
        return self._second[:3] if self._mapping is one_by_one else self._at_points(self.pointwise.first)

    @lazy
    def _gradient(self) -> ca.MX:
        return integration(self.numbering)(*self._first[1:])

    @lazy
    def _derivatives(self) -> tuple[ca.MX, ca.MX]:
        same = self._mapping is one_by_one
        return self.hessian(), self._gradient if same else integration(self.numbering)(*self._second[1:3])

    def action(self) -> ca.MX:
        """S: scalar."""
        return summation(self.numbering)(self._first[0])

    def gradient(self) -> ca.MX:
        """∇S with respect to the free values ξ."""
        return self._gradient

    def first_variation(self) -> list[ca.MX]:
        """S, momenta at the joints, ∇S with respect to the free values ξ, and sizes of the terms that it sums."""
        momenta, terms = boundary_terms(self.numbering)(*self._first[1:])
        return [self.action(), momenta, self._gradient, terms]

    def derivatives(self) -> tuple[ca.MX, ca.MX]:
        """∇²S and ∇S with respect to the free values ξ, in one pass over the points."""
        return self._derivatives

    def hessian(self, inertia: ca.MX | float = 1.0) -> ca.MX:
        """∇²S with respect to the free values ξ: sparse, symmetric, both halves stored; ∂²L/∂v² times `inertia`."""
        values = zip(self.pointwise.blocks, self._second[3:], strict=True)
        weighted = [inertia * value if block == (1, 1) else value for block, value in values]
        return assembly(*self.pattern_key, self.pointwise.blocks).call(weighted)[0]

    def joint_time_derivatives(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        """∂S/∂t_i, ∂²S/∂t_i² and ∂²S/∂t_i∂t_{i+1} by the joints, at fixed node values; the first are energy jumps."""
        at_points = one_by_one(self.pointwise.time_derivatives, self.numbering.points, self._shared).call(self._at)
        return joint_time_derivatives(self.numbering, *at_points)

    def curvature(self, direction: ca.MX) -> tuple[ca.MX, ca.MX]:
        """Second variation yᵀ∇²S y along y = `direction`, and the same with every term taken positive."""
        fixed = ca.MX.zeros(self.numbering.size - self.numbering.free, 1)
        y, slope = embedding(self.numbering).call([ca.vertcat(direction, fixed)])
        at_points = one_by_one(self.pointwise.curvature, self.numbering.points, self._shared)
        signed, positive = at_points.call([*self._at, ca.vertcat(y, slope)])
        return summation(self.numbering)(signed), summation(self.numbering)(positive)

    def function(self, name: str) -> ca.Function:
        """One of the functional's own Functions.

        - action : -> S
        - gradient : -> ∇S
        - hessian : -> ∇²S, sparse
        - derivatives : -> matrix ∇²S, gradient ∇S
        - summary : -> action S; momentum (d, N + 1), -∂S/∂x_0 and then ∂S_k/∂x_{k+1} of every interval; gradient ∇S;
          terms, the sizes of what the gradient sums
        - joint_time_derivatives : -> by_joint, twice_by_joint, by_neighbours
        - heavier : with inertia -> matrix ∇²S with ∂²L/∂v² times that
        - curvature : with direction y -> signed yᵀ∇²S y, positive sum of the sizes of its terms
        - sensitivity : with direction of the parameters -> change of ∇S along it
        """
        if name in self._functions:
            return self._functions[name]
        inertia, parameters = ca.MX.sym("inertia"), ca.vertcat(*self._parameters)
        along, change = (ca.MX.sym("direction", size) for size in (self.numbering.free, parameters.numel()))
        builders: dict[str, Callable[[], Parts]] = {
            "action": lambda: ({}, ["action"], [self.action()]),
            "gradient": lambda: ({}, ["gradient"], [self.gradient()]),
            "hessian": lambda: ({}, ["hessian"], [self.hessian()]),
            "derivatives": lambda: ({}, ["matrix", "gradient"], list(self.derivatives())),
            "summary": lambda: ({}, ["action", "momentum", "gradient", "terms"], self.first_variation()),
            "joint_time_derivatives": lambda: (
                {},
                ["by_joint", "twice_by_joint", "by_neighbours"],
                list(self.joint_time_derivatives()),
            ),
            "heavier": lambda: ({"inertia": inertia}, ["matrix"], [self.hessian(inertia)]),
            "curvature": lambda: ({"direction": along}, ["signed", "positive"], list(self.curvature(along))),
            "sensitivity": lambda: (
                {"direction": change},
                ["change"],
                [ca.jtimes(self.gradient(), parameters, change)],
            ),
        }
        return self.keep(name, builders[name])

    def keep(self, name: str, build: Callable[[], Parts]) -> ca.Function:
        """Build a Function of the graph when it is first asked for."""
        if name not in self._functions:
            began = time.perf_counter()
            further, names, outputs = build()
            symbols = self.symbols | further
            self._functions[name] = ca.Function(
                name.split()[0], list(symbols.values()), list(outputs), list(symbols), names
            )
            self.build_seconds += time.perf_counter() - began
        return self._functions[name]
