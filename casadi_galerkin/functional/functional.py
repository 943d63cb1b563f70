"""The one graph: the discrete functional S = ∫ L(t, x̄, dx̄/dt) Δ_w t, its gradient and its Hessian.

As in the paper: embed, evaluate pointwise, integrate.  With E the constant matrix that takes the node values to (x, x')
at the quadrature points, and L̂ the Lagrangian pulled back to the reference interval,

    S    = Σ w_k L̂(E X̄)_k
    ∇S   = Eᵀ [ w_k ∇L̂ ]                      discrete Euler-Lagrange equations, (euler1) and (euler2) of the paper
    ∇²S  = Eᵀ blockdiag( w_k ∇²L̂ ) E.

L̂, ∇L̂ and ∇²L̂ are SX Functions of one point (`pointwise`), mapped over all points; the graph of S
is not differentiated for ∇S and ∇²S.  E, Eᵀ and Eᵀ blockdiag(·) E depend on the numbering alone (`embedding`).

Whatever else a problem states beside L is a further term of the same sum:

    S̄  =  S  +  φ(x_0, x_N)  +  μ·ψ(x_0, x_N)  +  Σ Λ_a·g(t_a, x_a)  +  ν·(∫ G dt - c)  +  ε T
                end action      end conditions    holonomic constraints   given integrals      given energy ε

The first three of them are sums over single places (`LocalTerm`).  The last two have unknowns that enter at all
points: the multipliers ν, as parameters of the Lagrangian L + ν·G, and the duration T.  A force is not a term of S̄, but
adds its virtual work to the equations (`pointwise`).  Below, ∇S are all equations of the unknowns, and ∇²S is their
Jacobian.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.functional.embedding import (
    Embedded,
    Summation,
    assembly,
    embedded,
    embedding,
    gathered,
    integrated,
    summed,
    variation,
)
from casadi_galerkin.functional.numbering import Data, Numbering, kept
from casadi_galerkin.functional.pointwise import POINTS_IN_A_ROW, PointMap, by_rows, one_by_one, pointwise
from casadi_galerkin.problems.callables import sizes_of_terms

Parts: TypeAlias = tuple[dict[str, ca.MX], dict[str, ca.MX]]  # inputs beside the symbols, and outputs, by name


@dataclass(frozen=True)
class LocalTerm:
    """A term of the functional at single places: at the ends, or at every node whose position is not given.

    It is a small SX Function of a few entries y of the vector u, the same Function at K places.  Its `rows` are added
    to the stationarity conditions of these entries, and its `jacobian` is the derivative of the rows by y.  End
    actions, end conditions and holonomic constraints are such terms; with a multiplier μ among y, the rows of μ·g(x)
    are (μ·∂g/∂x, g).

    Attributes
    ----------
    function : Function (y (n), t (q), parameters, given) -> added, rows (n,), jacobian (n, n), sparse.  `added` are the
        end action and, if there is a second entry, the work of given momenta, which `Trajectory.action` leaves out
    entries : (n, K), entries of u that are y at every place
    times : (q K, N + 1), matrix from the joints to the times of every place
    symmetric : whether the jacobian is symmetric, that is, whether the rows are the gradient of a function
    """

    function: ca.Function
    entries: np.ndarray
    times: ca.DM
    symmetric: bool

    def evaluated(self, numbering: Numbering, *at: ca.MX) -> tuple[ca.MX, ca.MX, ca.MX]:
        """`added` (1 or 2, K), rows summed for every unknown, and the part of ∇²S; at u, joints, parameters, given."""
        added, rows, jacobian = self._at_places(self.function, *at)
        pattern = (np.array(index, dtype=int) for index in self.function.sparsity_out(2).get_triplet())
        row, column = (self.entries[index].ravel(order="F") for index in pattern)
        summation = Summation(numbering.free, row, column, np.arange(len(row)))
        return added, self._gathered(numbering, rows), summation.matrix(ca.MX(jacobian.nz[:]))

    def sizes(self, numbering: Numbering, *at: ca.MX) -> ca.MX:
        """Sizes of all terms that the rows are made of, summed for every unknown."""
        symbols = self.function.sx_in()
        function = ca.Function("sizes", symbols, [sizes_of_terms(self.function(*symbols)[1], symbols)])
        return self._gathered(numbering, *self._at_places(function, *at))

    def _at_places(
        self, function: ca.Function, u: ca.MX, joints: ca.MX, parameters: ca.MX, given: ca.MX
    ) -> list[ca.MX]:
        """A Function of the same arguments as `function` at all places."""
        size, count = self.entries.shape
        y = ca.reshape(u.get_nz(False, self.entries.ravel(order="F").tolist()), size, count)
        t = ca.reshape(ca.mtimes(ca.MX(self.times), joints), self.function.size1_in(1), count)
        return one_by_one(function, count, (2, 3)).call([y, t, parameters, given])

    def _gathered(self, numbering: Numbering, rows: ca.MX) -> ca.MX:
        return gathered(numbering, self.entries.ravel(order="F"), rows)


class Functional:
    """The discrete functional of a Lagrangian: its expressions, and the Functions made of them.

    Every Function takes (unknowns, start, end, mesh[, parameters][, given]), some of them one input more; `start` and
    `end` hold the fixed components only.  Each Function is built when it is first used, and cached.

    Parameters
    ----------
    lagrangian : Function (t, x, v[, p]) -> scalar; the last of p are the multipliers of given integrals
    numbering : Numbering
    mapping : `one_by_one`, which is fast to build, or `by_rows`, which is fast to evaluate and always used for many
        points
    force : Function of the same arguments -> (d,), or None
    terms : LocalTerms that are added
    given : number of values that the terms take beside the parameters; the last are those of the integrals, and, with a
        free duration, the energy

    Attributes
    ----------
    pointwise : Pointwise, L̂ and its derivatives at one point
    symmetric : whether ∇²S is symmetric
    pattern_key : arguments of `hessian_pattern`, which determine the sparsity of ∇²S without the further terms
    build_seconds : float, spent on building so far
    """

    def __init__(
        self,
        lagrangian: ca.Function,
        numbering: Numbering,
        mapping: PointMap,
        force: ca.Function | None,
        terms: tuple[LocalTerm, ...],
        given: int,
    ) -> None:
        began = time.perf_counter()
        self.pointwise, self.numbering, self.terms = pointwise(lagrangian, force), kept(numbering), terms
        if self.pointwise.linear:
            raise ValueError("the Lagrangian is linear in x and v: no path makes its action stationary, or all do")
        self.symmetric = self.pointwise.symmetric and all(term.symmetric for term in terms)
        self._mapping = by_rows if numbering.points >= 2 * POINTS_IN_A_ROW else mapping
        self._shared = (4,) if lagrangian.n_in() == 4 else ()  # after t, h, x and x' the parameters
        parameters = lagrangian.size1_in(3) - numbering.integrals if self._shared else 0
        self._parameters = [ca.MX.sym("parameters", parameters)] if parameters else []
        self._given = [ca.MX.sym("given", given)] if given else []
        pattern = self.pointwise.pattern
        self.pattern_key = (self.numbering, tuple(pattern.colind()), tuple(pattern.row()), self.pointwise.symmetric)
        self._functions: dict[str, ca.Function] = {}
        self.build_seconds = time.perf_counter() - began

    @cached_property
    def _embedded(self) -> Embedded:
        """The embedded symbols, kept here because all Functions must share them, even when the cache drops them."""
        return embedded(self.numbering)

    @cached_property
    def symbols(self) -> dict[str, ca.MX]:
        """Unknowns ξ, start, end, mesh and, if there are some, parameters and given values of the terms, by name."""
        further = (*self._parameters, *self._given)
        return self._embedded.symbols | {symbol.name(): symbol for symbol in further}

    def parameters_at(self, unknowns: np.ndarray, data: Data) -> Data:
        """The parameters of L, if there are some, with the multipliers of integrals."""
        own, multipliers = data[3 : 3 + len(self._parameters)], unknowns[self.numbering.everywhere]
        return (np.concatenate((*own, multipliers[: self.numbering.integrals])),) if self._shared else ()

    @property
    def sparsity(self) -> ca.Sparsity:
        """Sparsity of ∇²S."""
        return self.function("derivatives").sparsity_out("matrix")

    @cached_property
    def u(self) -> ca.MX:
        """The vector u = (ξ, start, end) of the numbering."""
        return self._embedded.u

    @property
    def _multipliers(self) -> ca.MX:
        """The multipliers of given integrals."""
        return self.symbols["unknowns"][self.numbering.everywhere][: self.numbering.integrals]

    @cached_property
    def _at(self) -> list[ca.MX]:
        further = [*self._parameters, self._multipliers] if self.numbering.integrals else self._parameters
        return [*self._embedded.points, *([ca.vertcat(*further)] if further else [])]

    def _at_points(self, function: ca.Function) -> list[ca.MX]:
        return self._mapping(function, self.numbering.points, self._shared).call(self._at)

    @cached_property
    def _second(self) -> list[ca.MX]:
        """L̂, its first and its second derivatives at all points."""
        pointwise, brief = self.pointwise, self._mapping is one_by_one
        return self._at_points(pointwise.derivatives if brief else pointwise.without_repetition)

    @cached_property
    def _first(self) -> list[ca.MX]:
        """L̂ and its first derivatives at all points.

        With `one_by_one` there are few solves, and separate expressions would cost more to build than they save.
        """
        return self._second[:3] if self._mapping is one_by_one else self._at_points(self.pointwise.first)

    @property
    def _arguments_of_terms(self) -> tuple[Numbering, ca.MX, ca.MX, ca.MX, ca.MX]:
        """What the local terms depend on."""
        return self.numbering, self.u, self._embedded.joints, ca.vertcat(*self._at[4:]), ca.vertcat(*self._given)

    @cached_property
    def _terms(self) -> list[tuple[ca.MX, ca.MX, ca.MX]]:
        """The local terms evaluated at all of their places."""
        return [term.evaluated(*self._arguments_of_terms) for term in self.terms]

    def _with_terms(self, total: ca.MX) -> ca.MX:
        """All equations, from those of the integral."""
        return self._with_last(sum((rows for _, rows, _ in self._terms), total), lambda: self._everywhere[0])

    @cached_property
    def _everywhere(self) -> tuple[ca.MX, ca.MX]:
        """Equations of the unknowns that enter at all points, and derivatives of all equations by these unknowns.

        They are ∫ G dt - c of the multipliers, and ∂S/∂τ + E T of τ = log T.
        """
        unknowns, places = self.symbols["unknowns"], self.numbering.everywhere
        by = ca.MX(ca.DM.eye(self.numbering.free)[:, places])
        row = ca.jtimes(summed(self.numbering, self._first[0]), unknowns, by).T + self._given_everywhere
        rows = integrated(self.numbering, *self._first[1:])[: places.start, :]
        return row, ca.densify(ca.jtimes(ca.vertcat(rows, row), unknowns, by))

    @cached_property
    def _given_everywhere(self) -> ca.MX:
        """The given terms of these equations: -c and E T."""
        factors = [ca.MX(-1.0)] * self.numbering.integrals + [self._embedded.duration] * self.numbering.free_duration
        return ca.vertcat(*factors) * self._given[0][-len(factors) :]

    @cached_property
    def _sizes_everywhere(self) -> ca.MX:
        """Sums of the sizes of their terms, which are of a duration -L̂, ∂L̂/∂x'_i x'_i and E T."""
        (lagrangian, _, momenta), size, first = self._first[:3], self.numbering.free, self.numbering.everywhere.start
        directions = [ca.MX(ca.Sparsity.unit(size, first + i)) for i in range(self.numbering.integrals)]
        points = [ca.fabs(ca.jtimes(lagrangian, self.symbols["unknowns"], direction)) for direction in directions]
        if self.numbering.free_duration:
            points.append(ca.fabs(lagrangian) + ca.sum1(ca.fabs(momenta * self._embedded.points[-1])))
        sums = ca.vertcat(*(summed(self.numbering, at_points) for at_points in points))
        return sums + ca.fabs(self._given_everywhere)

    def _with_last(self, total: ca.MX, last: Callable[[], ca.MX]) -> ca.MX:
        """Values of all equations, with those of the unknowns that enter at all points in their place."""
        places = self.numbering.everywhere
        return total if places.start == places.stop else ca.vertcat(total[: places.start, :], last())

    def _without_integrals(self, total: ca.MX) -> ca.MX:
        """∫ L dt from ∫ (L + ν·G) dt."""
        count = self.numbering.integrals
        integrals = (self._everywhere[0] - self._given_everywhere)[:count] if count else ca.MX()
        return total - ca.dot(self._multipliers, integrals) if count else total

    @cached_property
    def action(self) -> ca.MX:
        """S̄ without the terms of multipliers and of the energy; scalar."""
        action = self._without_integrals(summed(self.numbering, self._first[0]))
        return sum((ca.sum1(ca.sum2(added)) for added, _, _ in self._terms), action)

    @cached_property
    def gradient(self) -> ca.MX:
        """∇S with respect to the free values ξ."""
        return self._with_terms(integrated(self.numbering, *self._first[1:]))

    @cached_property
    def first_variation(self) -> dict[str, ca.MX]:
        """The action with the end action, momenta at the joints, ∇S by the unknowns ξ, and the sizes of its terms."""
        action, momenta, gradient, sizes = variation(self.numbering).call(self._first)
        action = sum((ca.sum2(added[0, :]) for added, _, _ in self._terms), self._without_integrals(action))
        sizes = sum((term.sizes(*self._arguments_of_terms) for term in self.terms), sizes)
        sizes = self._with_last(sizes, lambda: self._sizes_everywhere)
        return {"action": action, "momentum": momenta, "gradient": self._with_terms(gradient), "terms": sizes}

    @cached_property
    def derivatives(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        """∇²S, sparse with both halves stored, ∇S with respect to the free values ξ, and ∂²L̂/∂x'², in one pass."""
        matrix, gradient = assembly(*self.pattern_key, self.pointwise.blocks).call(self._second[1:])
        matrix = matrix if self._further is None else matrix + self._further
        return matrix, self._with_terms(gradient), self._second[-1]

    @cached_property
    def _further(self) -> ca.MX | None:
        """The part of ∇²S of the further terms and of the unknowns that enter at all points; None without any."""
        added = [matrix for _, _, matrix in self._terms]
        first, size = self.numbering.everywhere.start, self.numbering.free
        if first < size:
            columns, by = self._everywhere[1], ca.MX(ca.DM.eye(size)[:, first:])
            row = ca.horzcat(columns[:first, :].T, ca.MX(size - first, size - first))
            if self.terms and self.numbering.integrals:  # the momentum of a given velocity may depend on multipliers
                rows = sum((rows for _, rows, _ in self._terms[1:]), self._terms[0][1])
                columns += ca.jtimes(rows, self.symbols["unknowns"], by)
            added += [ca.horzcat(ca.MX(size, first), columns), ca.vertcat(ca.MX(first, size), row)]
        return sum(added[1:], added[0]) if added else None

    def function(self, name: str) -> ca.Function:
        """One of the functional's own Functions.

        - action : -> S, with the end action and the work of given momenta
        - gradient : -> ∇S
        - hessian : -> ∇²S, sparse
        - derivatives : -> matrix ∇²S, gradient ∇S, mass: ∂²L̂/∂x'² at all points, the last of `Pointwise.blocks`
        - summary : -> action S, with the end action; momentum (d, N + 1), -∂S/∂x_0 and then ∂S_k/∂x_{k+1} of every
          interval; gradient ∇S; terms, the sums of the sizes of the gradient's terms
        - curvature : with left z and right y -> signed zᵀ∇²S y, positive sum of the sizes of its terms
        - by_data : with a direction of every input but the unknowns -> change of ∇S along them
        - product : with direction of the unknowns -> change of ∇S along it, ∇²S times the direction, summed over the
          points, so that it has no rounding of the entries of ∇²S
        """
        builders: dict[str, Callable[[], Parts]] = {
            "action": lambda: ({}, {"action": self.action}),
            "gradient": lambda: ({}, {"gradient": self.gradient}),
            "hessian": lambda: ({}, {"hessian": self.derivatives[0]}),
            "derivatives": lambda: ({}, dict(zip(("matrix", "gradient", "mass"), self.derivatives, strict=True))),
            "summary": lambda: ({}, self.first_variation),
            "curvature": self._curvature,
            "by_data": lambda: self._change_by(*list(self.symbols)[1:]),
            "product": lambda: self._change_by("unknowns"),
        }
        return self.keep(name, builders[name])

    def _curvature(self) -> Parts:
        directions = {name: ca.MX.sym(name, self.numbering.free) for name in ("left", "right")}
        fixed, embed = ca.MX.zeros(self.numbering.size - self.numbering.free, 1), embedding(self.numbering)
        changes = [ca.vertcat(*embed.call([ca.vertcat(direction, fixed)])) for direction in directions.values()]
        mapped = one_by_one(self.pointwise.curvature, self.numbering.points, self._shared)
        signed, positive = (summed(self.numbering, values) for values in mapped.call([*self._at, *changes]))
        if self._further is not None:
            signed += ca.bilin(self._further, *directions.values())
            positive += ca.bilin(ca.fabs(self._further), *map(ca.fabs, directions.values()))
        return directions, {"signed": signed, "positive": positive}

    def _change_by(self, *names: str) -> Parts:
        """The change of ∇S along a direction of each of these symbols."""
        symbols = {f"{name}_direction": self.symbols[name] for name in names}
        directions = {name: ca.MX.sym(name, symbol.numel()) for name, symbol in symbols.items()}
        changes = [ca.jtimes(self.gradient, symbols[name], direction) for name, direction in directions.items()]
        return directions, {"change": ca.densify(sum(changes[1:], changes[0]))}  # few rows may depend on data

    def keep(self, name: str, build: Callable[[], Parts]) -> ca.Function:
        """A Function of the graph, built when it is first used."""
        if name not in self._functions:
            began = time.perf_counter()
            further, outputs = build()
            inputs = self.symbols | further  # all are passed faster by name than in lists
            self._functions[name] = ca.Function(name, inputs | outputs, list(inputs), list(outputs))
            self.build_seconds += time.perf_counter() - began
        return self._functions[name]
