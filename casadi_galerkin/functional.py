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

import os
import shutil
import tempfile
from functools import cached_property, lru_cache
from typing import Literal

import casadi as ca

from casadi_galerkin.operators import LAYOUTS_KEPT, Layout, assembly, embedding, integration, summation

BATCH, BATCH_INSTRUCTIONS = 16, 2000  # points that one call evaluates, and instructions that it may have
MANY = 2000  # points from which batches pay within one solve: to join points takes 0.8 ms, a call 0.2 us

Evaluation = Literal["single", "batched", "compiled"]


class Pointwise:
    """The pulled-back integrand L̂(t, h, x, x'[, p]) at one point, with its derivatives, as SX Functions.

    Parameters
    ----------
    integrand : Function (t, x, v[, p]) -> scalar

    Attributes
    ----------
    pattern : Sparsity (d, d), symmetric, that holds every second-derivative block
    blocks : which of (0, 0), (0, 1), (1, 0), (1, 1) are not structurally zero; 0 stands for x and 1 for x'
    kinetic : whether no ∂²L̂/∂x'_i² is structurally zero
    """

    def __init__(self, integrand: ca.Function) -> None:
        t, h = ca.SX.sym("t"), ca.SX.sym("h")
        d = integrand.size1_in(1)
        x, slope = ca.SX.sym("x", d), ca.SX.sym("slope", d)
        parameters = [ca.SX.sym("p", integrand.size1_in(3))] if integrand.n_in() == 4 else []
        self._inputs = [t, h, x, slope, *parameters]
        self._value = h * integrand(t, x, slope / h, *parameters)
        self._hessian, gradient = ca.hessian(self._value, ca.vertcat(x, slope))
        part = (slice(0, d), slice(d, 2 * d))
        self._gradient = [ca.densify(gradient[rows]) for rows in part]
        self._cells = {(i, j): self._hessian[part[i], part[j]] for i in (0, 1) for j in (0, 1)}
        self.blocks = tuple(key for key, cell in self._cells.items() if cell.nnz())
        self.pattern = ca.Sparsity.diag(d)  # the matrix must have a diagonal even where L ignores a component
        for key in self.blocks:
            sparsity = self._cells[key].sparsity()
            self.pattern = self.pattern + sparsity + sparsity.T
        kinetic = self._cells[1, 1].sparsity()
        self.kinetic = all(kinetic.has_nz(i, i) for i in range(d))

    @cached_property
    def first(self) -> ca.Function:
        """L̂, ∂L̂/∂x and ∂L̂/∂x'."""
        return ca.Function("first", self._inputs, [self._value, *self._gradient])

    @cached_property
    def derivatives(self) -> ca.Function:
        """The gradient, and second derivatives in the order of `blocks`, each the column of its entries in `pattern`.

        Together, because a call costs as much as evaluating a small Lagrangian.
        """
        columns = [ca.vertcat(*ca.project(self._cells[key], self.pattern).nonzeros()) for key in self.blocks]
        # common subexpressions cost more to find than they save, but for the Hessian: a tenth of its instructions
        return ca.Function("derivatives", self._inputs, [*self._gradient, *columns], {"cse": True})

    @cached_property
    def curvature(self) -> ca.Function:
        """With z = (y, y') as a further input, zᵀ∇²L̂ z and |z|ᵀ|∇²L̂||z|."""
        z = ca.SX.sym("z", self._hessian.shape[0])
        size = ca.fabs(z)
        terms = [ca.bilin(self._hessian, z, z), ca.bilin(ca.fabs(self._hessian), size, size)]
        return ca.Function("curvature", [*self._inputs, z], terms)


@lru_cache(LAYOUTS_KEPT)
def pointwise(integrand: ca.Function) -> Pointwise:
    """Derive the pointwise Functions of an integrand; the last ones are kept."""
    return Pointwise(integrand)


@lru_cache(4 * LAYOUTS_KEPT)
def batched(f: ca.Function, count: int, shared: tuple[int, ...]) -> tuple[ca.Function, int]:
    """Join a pointwise Function with itself at several points, for at most `count` points that these divide.

    A call costs 0.2 us, as much as a small Lagrangian: at 16 points a call, evaluating a pendulum's derivatives was
    measured 3 times faster, those of 6 coupled masses 1.3 times.  Inputs in `shared` are the same at all points.
    """
    most = min(BATCH, max(1, BATCH_INSTRUCTIONS // f.n_instructions()))
    size = max(k for k in range(1, most + 1) if count % k == 0)
    if size == 1:
        return f, 1
    joined = f.map(f.name(), "unroll", size, list(shared), []) if shared else f.map(size, "unroll")
    return joined.expand(), size


def compiler() -> str:
    """Path of the C compiler."""
    path = shutil.which("gcc") or shutil.which("cc")
    if path is None:
        raise ValueError("jit=True needs a C compiler, gcc or cc, on the path; none was found")
    return path


@lru_cache(LAYOUTS_KEPT)
def compiled(f: ca.Function, count: int, shared: tuple[int, ...]) -> ca.Function:
    """Map a pointwise Function over `count` points and compile the loop in C: 0.3 s, then 2 to 6 times faster."""
    inputs = [ca.MX.sym(f.name_in(i), f.size1_in(i), 1 if i in shared else count) for i in range(f.n_in())]
    mapped = f.map(f.name(), "serial", count, list(shared), []) if shared else f.map(count)
    flags = {"compiler": compiler(), "flags": ["-O3", "-march=native"], "directory": tempfile.gettempdir() + os.sep}
    return ca.Function(f.name(), inputs, mapped.call(inputs), {"jit": True, "compiler": "shell", "jit_options": flags})


class Functional:
    """The discrete functional of an integrand, as expressions in u, the joints of the mesh and parameters.

    Parameters
    ----------
    integrand : Function (t, x, v[, p]) -> scalar
    layout : Layout
    evaluation : how gradient and Hessian are evaluated at the points: "single", quick to build; "batched", several
        in a call; or "compiled" in C
    """

    def __init__(self, integrand: ca.Function, layout: Layout, evaluation: Evaluation = "batched") -> None:
        if evaluation == "compiled":
            compiler()  # a missing one is reported before anything is built
        elif layout.points >= MANY:
            evaluation = "batched"
        self.pointwise, self.layout, self.evaluation = pointwise(integrand), layout, evaluation
        pattern = self.pointwise.pattern
        self._points: tuple[ca.MX, ca.MX, list[ca.MX]] | None = None
        self.pattern_key = (layout, tuple(pattern.colind()), tuple(pattern.row()))

    def _embedded(self, u: ca.MX, mesh: ca.MX) -> list[ca.MX]:
        """Points for u and mesh, the same expressions when asked again for the same ones."""
        if self._points is None or self._points[0] is not u or self._points[1] is not mesh:
            self._points = u, mesh, list(embedding(self.layout).call([u, mesh]))
        return self._points[2]

    def _map(
        self, f: ca.Function, at: list[ca.MX], parameters: ca.MX | None, *extra: ca.MX, batch: bool = False
    ) -> list[ca.MX]:
        """Evaluate a pointwise Function at all quadrature points; outputs (n, N r)."""
        shared, given = ((), []) if parameters is None else ((len(at),), [parameters])
        if batch and self.evaluation == "compiled":
            return list(compiled(f, self.layout.points, shared).call([*at, *given]))
        f, size = batched(f, self.layout.points, shared) if batch and self.evaluation == "batched" else (f, 1)
        calls = self.layout.points // size
        mapped = f.map(f.name(), "serial", calls, list(shared), []) if shared else f.map(calls)
        return list(mapped.call([*at, *given, *extra]))

    def first(self, u: ca.MX, mesh: ca.MX, parameters: ca.MX | None) -> tuple[ca.MX, ca.MX, ca.MX, ca.MX]:
        """S; ∇S of each interval's action by its own node values (d N, m + 1), and of S by u; sizes of its terms.

        The roundoff of a sum is a few eps of the sum of the sizes of its terms.
        """
        at = self._embedded(u, mesh)
        values, *slopes = self._map(self.pointwise.first, at, parameters, batch=True)
        local, total = integration(self.layout).call(slopes)
        terms = integration(self.layout, absolute=True).call([ca.fabs(slope) for slope in slopes])[1]
        return summation(self.layout).call([values])[0], local, total, terms

    def derivatives(self, u: ca.MX, mesh: ca.MX, parameters: ca.MX | None) -> tuple[ca.MX, ca.MX]:
        """∇²S and ∇S with respect to the free values ξ, in one go through the points."""
        at = self._embedded(u, mesh)
        by_x, by_slope, *values = self._map(self.pointwise.derivatives, at, parameters, batch=True)
        total = integration(self.layout).call([by_x, by_slope])[1]
        return assembly(*self.pattern_key, self.pointwise.blocks).call(values)[0], total[: self.layout.free]

    def hessian(self, u: ca.MX, mesh: ca.MX, parameters: ca.MX | None, inertia: ca.MX | None = None) -> ca.MX:
        """∇²S with respect to the free values ξ: sparse, symmetric, both halves stored.

        With `inertia`, the block ∂²L/∂v² is multiplied by it: large values make the matrix positive definite where
        the kinetic energy is.
        """
        at = self._embedded(u, mesh)
        values = self._map(self.pointwise.derivatives, at, parameters, batch=True)[2:]
        if inertia is not None:
            blocks = self.pointwise.blocks
            values = [
                inertia * value if block == (1, 1) else value for block, value in zip(blocks, values, strict=True)
            ]
        return assembly(*self.pattern_key, self.pointwise.blocks).call(values)[0]

    def curvature(self, u: ca.MX, mesh: ca.MX, parameters: ca.MX | None, direction: ca.MX) -> tuple[ca.MX, ca.MX]:
        """Second variation yᵀ∇²S y along y = `direction`, and the same with every term taken positive."""
        at = self._embedded(u, mesh)
        y, slope = embedding(self.layout).call([direction, mesh])[2:]
        signed, positive = self._map(self.pointwise.curvature, at, parameters, ca.vertcat(y, slope))
        signed, positive = (summation(self.layout).call([values])[0] for values in (signed, positive))
        return signed, positive
