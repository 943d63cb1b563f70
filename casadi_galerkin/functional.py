"""The discrete functional S = ∫ L(t, x̄, dx̄/dt) Δ_w t, its gradient and its Hessian, as CasADi graphs.

The paper's sentence is the code: embed, evaluate pointwise, integrate.  With E the constant matrix that takes
the node values to (x, x') at the quadrature points, and L̂ the Lagrangian pulled back to the reference interval,
L̂(t, h, x, x') = h L(t, x, x'/h),

    S    = Σ w_k L̂(E X̄)_k
    ∇S   = Eᵀ [ w_k ∇L̂ ]                      discrete Euler-Lagrange equations, (euler1) and (euler2) of the paper
    ∇²S  = Eᵀ blockdiag( w_k ∇²L̂ ) E.

L̂, ∇L̂ and ∇²L̂ are SX Functions of one point (`Pointwise`), mapped over all points; nothing is differentiated
through the graph.  E, Eᵀ and Eᵀ blockdiag(·) E are the `operators` of the layout.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import Literal

import casadi as ca

from casadi_galerkin.layout import LAYOUTS_KEPT, Layout, kept
from casadi_galerkin.mapping import compiled, compiler, mapped, vectorised
from casadi_galerkin.operators import assembly, boundary_terms, embedded, embedding, integration, summation, timing

CSE = {"cse": True}  # costs more to find than it saves, but for the Hessian: a tenth of its instructions
MANY = 1000  # points from which rows pay within one solve: they take some 25 us an instruction to build

Evaluation = Literal["single", "vectorised", "compiled"]
OVER: dict[Evaluation, Callable[[ca.Function, int, tuple[int, ...]], ca.Function]] = {
    "single": mapped,
    "vectorised": vectorised,
    "compiled": compiled,
}


class Pointwise:
    """The pulled-back integrand L̂(t, h, x, x'[, p]) at one point, with its derivatives, as SX Functions.

    Parameters
    ----------
    integrand : Function (t, x, v[, p]) -> scalar

    Attributes
    ----------
    pattern : Sparsity (d, d), symmetric, that holds every second-derivative block
    stored : the same, or its lower triangle where that tells all: without a block of x and x'
    blocks : which of (0, 0), (0, 1), (1, 0), (1, 1) are not structurally zero; 0 stands for x and 1 for x'
    kinetic : whether no ∂²L̂/∂x'_i² is structurally zero
    quadratic : whether second derivatives depend on neither x nor x', so that Newton's equations have but one matrix
    """

    def __init__(self, integrand: ca.Function) -> None:
        t, h = ca.SX.sym("t"), ca.SX.sym("h")
        d = integrand.size1_in(1)
        x, slope = ca.SX.sym("x", d), ca.SX.sym("slope", d)
        parameters = [ca.SX.sym("p", integrand.size1_in(3))] if integrand.n_in() == 4 else []
        self._inputs = {"t": t, "h": h, "x": x, "slope": slope} | ({"p": parameters[0]} if parameters else {})
        self._value = h * integrand(t, x, slope / h, *parameters)
        self._hessian, gradient = ca.hessian(self._value, ca.vertcat(x, slope))
        ends = [0, d, 2 * d]
        self._slopes = dict(zip(("fx", "fv"), ca.vertsplit(ca.densify(gradient), ends), strict=True))
        rows = ca.blocksplit(self._hessian, ends, ends)
        self._cells = {(i, j): cell for i, row in enumerate(rows) for j, cell in enumerate(row)}
        self.blocks = tuple(key for key, cell in self._cells.items() if cell.nnz())
        if not self.blocks:
            raise ValueError("the Lagrangian is linear in x and v: no path makes its action stationary, or all do")
        self.pattern = ca.Sparsity.diag(d)  # the matrix must have a diagonal even where L ignores a component
        for key in self.blocks:
            sparsity = self._cells[key].sparsity()
            self.pattern = self.pattern + sparsity + sparsity.T
        self.stored = self.pattern if (0, 1) in self.blocks else ca.tril(self.pattern)
        kinetic = self._cells[1, 1].sparsity()
        self.kinetic = all(kinetic.has_nz(i, i) for i in range(d))
        self.quadratic = not ca.depends_on(self._hessian, ca.vertcat(x, slope))

    @cached_property
    def first(self) -> ca.Function:
        """L̂, ∂L̂/∂x and ∂L̂/∂x'."""
        return self._function("first", {"f": self._value, **self._slopes})

    @cached_property
    def derivatives(self) -> ca.Function:
        """What `first` has, and second derivatives in the order of `blocks`, each the column of its `stored` entries.

        Together, because a call costs as much as evaluating a small Lagrangian.
        """
        columns = {f"block{i}{j}": ca.project(self._cells[i, j], self.stored).nz[:] for i, j in self.blocks}
        return self._function("derivatives", {"f": self._value, **self._slopes, **columns}, CSE)

    @cached_property
    def curvature(self) -> ca.Function:
        """With z = (y, y') as a further input, zᵀ∇²L̂ z and |z|ᵀ|∇²L̂||z|."""
        z = ca.SX.sym("z", self._hessian.shape[0])
        size = ca.fabs(z)
        terms = [ca.bilin(self._hessian, z, z), ca.bilin(ca.fabs(self._hessian), size, size)]
        return ca.Function("curvature", [*self._inputs.values(), z], terms)

    @cached_property
    def timing(self) -> ca.Function:
        """First and second derivatives of L̂ by t and h, at fixed x and x': by t, by h, by tt, th and hh."""
        hessian, gradient = ca.hessian(self._value, ca.vertcat(self._inputs["t"], self._inputs["h"]))
        entries = (gradient[0], gradient[1], hessian[0, 0], hessian[0, 1], hessian[1, 1])
        return ca.Function("timing", list(self._inputs.values()), [ca.densify(entry) for entry in entries])

    def _function(self, name: str, outputs: dict[str, ca.SX], options: dict[str, bool] | None = None) -> ca.Function:
        inputs = self._inputs
        return ca.Function(
            name, list(inputs.values()), list(outputs.values()), list(inputs), list(outputs), options or {}
        )


@lru_cache(LAYOUTS_KEPT)
def pointwise(integrand: ca.Function) -> Pointwise:
    """Derive the pointwise Functions of an integrand; the last ones are kept."""
    return Pointwise(integrand)


class Functional:
    """The discrete functional of an integrand, as expressions in the symbols of a layout and of parameters.

    Parameters
    ----------
    integrand : Function (t, x, v[, p]) -> scalar
    layout : Layout
    evaluation : how gradient and Hessian are evaluated at the points: "single", quick to build; "vectorised", by
        instruction; or "compiled" in C
    """

    def __init__(self, integrand: ca.Function, layout: Layout, evaluation: Evaluation = "vectorised") -> None:
        if evaluation == "compiled":
            compiler()  # a missing one is reported before anything is built
        elif layout.points >= MANY:
            evaluation = "vectorised"
        self.pointwise, self.layout, self.evaluation = pointwise(integrand), kept(layout), evaluation
        self._shared = (4,) if integrand.n_in() == 4 else ()  # after t, h, x and x' the parameters
        self._parameters = [ca.MX.sym("parameters", integrand.size1_in(3))] if self._shared else []
        stored = self.pointwise.stored
        self.pattern_key = (self.layout, tuple(stored.colind()), tuple(stored.row()))

    @property
    def symbols(self) -> dict[str, ca.MX]:
        """Unknowns ξ, start, end, mesh and, if the integrand has some, parameters, by name."""
        return embedded(self.layout).symbols | {symbol.name(): symbol for symbol in self._parameters}

    @property
    def u(self) -> ca.MX:
        """The layout's vector."""
        return embedded(self.layout).u

    @property
    def _at(self) -> list[ca.MX]:
        return [*embedded(self.layout).points, *self._parameters]

    def mapped(self, name: str) -> ca.Function:
        """A pointwise Function, "first" or "derivatives", over all quadrature points."""
        return OVER[self.evaluation](getattr(self.pointwise, name), self.layout.points, self._shared)

    def _at_points(self, name: str) -> list[ca.MX]:
        return list(self.mapped(name).call(self._at))

    def action(self) -> ca.MX:
        """S: scalar."""
        return summation(self.layout)(self._at_points("first")[0])

    def gradient(self) -> ca.MX:
        """∇S with respect to the free values ξ."""
        return integration(self.layout)(*self._at_points("first")[1:])

    def first(self) -> list[ca.MX]:
        """S, momenta at the joints, ∇S with respect to the free values ξ, and sizes of the terms that it sums."""
        f, by_x, by_slope = self._at_points("first")
        gradient = integration(self.layout)(by_x, by_slope)
        momenta, terms = boundary_terms(self.layout)(by_x, by_slope)
        return [summation(self.layout)(f), momenta, gradient, terms]

    def derivatives(self) -> tuple[ca.MX, ca.MX]:
        """∇²S and ∇S with respect to the free values ξ, in one go through the points."""
        _, by_x, by_slope, *values = self._at_points("derivatives")
        return self._assembled(values), integration(self.layout).call([by_x, by_slope])[0]

    def hessian(self) -> ca.MX:
        """∇²S with respect to the free values ξ: sparse, symmetric, both halves stored."""
        return self._assembled(self._at_points("derivatives")[3:])

    def _assembled(self, values: list[ca.MX]) -> ca.MX:
        return assembly(*self.pattern_key, self.pointwise.blocks).call(values)[0]

    def timing(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        """∂S/∂t_i, ∂²S/∂t_i² and ∂²S/∂t_i∂t_{i+1} by the joints, at fixed node values."""
        at_points = mapped(self.pointwise.timing, self.layout.points, self._shared).call(self._at)
        return timing(self.layout, *at_points)

    def curvature(self, direction: ca.MX) -> tuple[ca.MX, ca.MX]:
        """Second variation yᵀ∇²S y along y = `direction`, and the same with every term taken positive."""
        fixed = ca.MX.zeros(self.layout.size - self.layout.free, 1)
        y, slope = embedding(self.layout).call([ca.vertcat(direction, fixed)])
        at_points = mapped(self.pointwise.curvature, self.layout.points, self._shared)
        signed, positive = at_points.call([*self._at, ca.vertcat(y, slope)])
        return summation(self.layout)(signed), summation(self.layout)(positive)
