"""The discrete functional S = ∫ L(t, x̄, dx̄/dt) Δ_w t, its gradient and its Hessian, as CasADi graphs.

The paper's sentence is the code: embed, evaluate pointwise, integrate.  With E the constant matrix that takes
the node values to (x, x') at the quadrature points, and L̂ the Lagrangian pulled back to the reference interval,
L̂(t, h, x, x') = h L(t, x, x'/h),

    S    = Σ w_k L̂(E X̄)_k
    ∇S   = Eᵀ [ w_k ∇L̂ ]                      discrete Euler-Lagrange equations, (euler1) and (euler2) of the paper
    ∇²S  = Eᵀ blockdiag( w_k ∇²L̂ ) E.

L̂, ∇L̂ and ∇²L̂ are SX Functions of one point (`Pointwise`), mapped over all points; nothing is differentiated
through the graph.  E, Eᵀ and Eᵀ blockdiag(·) E are three Functions of the `Layout` alone (`embedding`,
`integration`, `assembly`), kept for the next Lagrangian.  They use E as its two factors, a selection of each
interval's node values and the dense matrices of the reference `Element`.  Because the step is an input of L̂,
nothing in them depends on the mesh.

Velocities are taken from differences to the interval's first value, and its gradient from the sum of the others
(the columns of l_j' sum to zero): roundoff then stays near 1e-14 at 1e5 intervals instead of growing with 1/h.

Local node values are arranged as a matrix of shape (d N, m + 1): column a is node a of all intervals, component
fastest.  Points are numbered the same way: quadrature point slowest, then interval, then component.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

from casadi_galerkin.calculus import Galerkin

BLAS = "classic" if ca.has_blas("classic") else "reference"  # measured: 3 to 5 times faster than the reference
BATCH, BATCH_INSTRUCTIONS = 16, 2000  # points that one call evaluates, and instructions that it may have
LAYOUTS_KEPT = 8  # a graph of 1e5 intervals holds some 100 MB


@dataclass(frozen=True)
class Layout:
    """Which entry of the vector u stands for which value of the path: X̄ = P ξ + c as a numbering.

    u holds the free values ξ in the order of time, then the fixed components of the start, then those of the end.

    Parameters
    ----------
    method : Galerkin
    intervals : int, N
    dimension : int, d
    fixed_start, fixed_end : indices of the components that are given at the ends
    periodic : bool, whether the last joint is the first one; `fixed_start` then holds for both
    """

    method: Galerkin
    intervals: int
    dimension: int
    fixed_start: tuple[int, ...] = ()
    fixed_end: tuple[int, ...] = ()
    periodic: bool = False

    @cached_property
    def numbering(self) -> np.ndarray:
        """Entry of u at every node in the order of time; (N m + 1, d)."""
        nodes = np.zeros((self.intervals * self.method.degree + 1, self.dimension), dtype=np.int64)
        given = np.zeros(nodes.shape, dtype=bool)
        given[0, list(self.fixed_start)] = True
        if self.periodic:
            given[-1] = True  # numbered with the first joint, below
        else:
            given[-1, list(self.fixed_end)] = True
        nodes[~given] = np.arange(np.count_nonzero(~given))
        starts = self.free + np.arange(len(self.fixed_start))
        nodes[0, list(self.fixed_start)] = starts
        if self.periodic:
            nodes[-1] = nodes[0]
        else:
            nodes[-1, list(self.fixed_end)] = self.free + len(starts) + np.arange(len(self.fixed_end))
        return nodes

    @property
    def free(self) -> int:
        """Number of unknowns, the length of ξ."""
        joints = self.intervals * self.method.degree + (0 if self.periodic else 1)
        return joints * self.dimension - len(self.fixed_start) - len(self.fixed_end)

    @property
    def size(self) -> int:
        """Length of u."""
        return self.free + len(self.fixed_start) + len(self.fixed_end)

    @property
    def local(self) -> np.ndarray:
        """Entry of u at every local node; (m + 1, N, d)."""
        m = self.method.degree
        return np.asarray(self.numbering[m * np.arange(self.intervals)[None, :] + np.arange(m + 1)[:, None]])

    @property
    def points(self) -> int:
        """Number of quadrature points, N r."""
        return self.intervals * len(self.method.quadrature)


def _times(left: ca.MX, right: np.ndarray | ca.DM) -> ca.MX:
    """Dense product with a constant."""
    return ca.mtimes(left, ca.MX(ca.DM(right)), BLAS)


def _contributions(target: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Split a sum by target into rounds of distinct targets: (positions, sorted targets) of each round."""
    order = np.argsort(target, kind="stable")
    ordered = target[order]
    group = np.flatnonzero(np.append(True, ordered[1:] != ordered[:-1]))
    rank = np.arange(len(target)) - np.repeat(group, np.diff(np.append(group, len(target))))
    for turn in range(int(rank.max(initial=0)) + 1):
        yield order[rank == turn], ordered[rank == turn]


@lru_cache(LAYOUTS_KEPT)
def embedding(layout: Layout) -> ca.Function:
    """E: (u, mesh) -> t (1, N r), h (1, N r), x (d, N r), x' (d, N r) at the quadrature points."""
    element, n, d = layout.method.element, layout.intervals, layout.dimension
    r, nodes = len(element.points), layout.method.degree + 1
    u, mesh = ca.MX.sym("u", layout.size), ca.MX.sym("mesh", n + 1)
    local = ca.reshape(u.get_nz(False, layout.local.ravel().tolist()), d * n, nodes)
    first = local[:, 0]
    differences = local[:, 1:] - ca.repmat(first, 1, nodes - 1)
    x = ca.repmat(first, 1, r) + _times(differences, element.values[:, 1:].T)
    slope = _times(differences, element.slopes[:, 1:].T)
    steps = mesh[1:] - mesh[:-1]
    t = ca.repmat(mesh[:-1], 1, r) + _times(steps, element.points[None, :])
    outputs = [ca.reshape(t, 1, n * r), ca.repmat(steps.T, 1, r), *(ca.reshape(a, d, n * r) for a in (x, slope))]
    return ca.Function("embedding", [u, mesh], outputs, ["u", "mesh"], ["t", "h", "x", "slope"])


@lru_cache(2 * LAYOUTS_KEPT)
def integration(layout: Layout, absolute: bool = False) -> ca.Function:
    """Eᵀ: values fx, fv (d, N r) that multiply x and x' -> local sums (d N, m + 1), and their sum by entry of u.

    With `absolute`, every constant is taken positive: applied to sizes it bounds the terms that were summed.
    """
    element, n, d = layout.method.element, layout.intervals, layout.dimension
    fx, fv = ca.MX.sym("fx", d, layout.points), ca.MX.sym("fv", d, layout.points)
    x, v = (ca.reshape(a, d * n, -1) for a in (fx, fv))
    weights = element.weights[:, None]
    values, slopes = weights * element.values, weights * element.slopes
    if absolute:
        local = _times(x, np.abs(values)) + _times(v, np.abs(slopes))
    else:
        others = _times(x, values[:, 1:]) + _times(v, slopes[:, 1:])
        local = ca.horzcat(_times(x, weights) - ca.sum2(others), others)
    entries, total = ca.vec(local), 0
    for positions, targets in _contributions(layout.local.ravel()):
        sparsity = ca.Sparsity(layout.size, 1, [0, len(targets)], targets.tolist())
        total = total + ca.MX(sparsity, entries.get_nz(False, positions.tolist()))
    return ca.Function("integration", [fx, fv], [local, total], ["fx", "fv"], ["local", "total"])


@lru_cache(LAYOUTS_KEPT)
def summation(layout: Layout) -> ca.Function:
    """∫ f Δ_w t on the reference interval, summed: values (1, N r), step included -> scalar."""
    f = ca.MX.sym("f", 1, layout.points)
    total = ca.sum1(_times(ca.reshape(f, layout.intervals, -1), layout.method.element.weights[:, None]))
    return ca.Function("summation", [f], [total], ["f"], ["integral"])


@lru_cache(LAYOUTS_KEPT)
def assembly(
    layout: Layout, colind: tuple[int, ...], row: tuple[int, ...], blocks: tuple[tuple[int, int], ...]
) -> ca.Function:
    """Eᵀ blockdiag(·) E: second derivatives at the points -> sparse symmetric matrix over the unknowns ξ.

    Inputs are one matrix a block, (entries of the (d, d) pattern, N r).  Each interval contributes a dense
    (m + 1) by (m + 1) grid of cells with that pattern, and neighbours overlap in the joint between them:

        ■ ■ ■ · ·
        ■ ■ ■ · ·
        ■ ■ ■ ■ ■
        · · ■ ■ ■
        · · ■ ■ ■

    Only cells of node pairs (a, b) with a >= b are computed; the others are their transposes.
    """
    element, n = layout.method.element, layout.intervals
    a, b = (index.tolist() for index in np.tril_indices(layout.method.degree + 1))
    basis = [ca.DM(element.values), ca.DM(element.slopes)]
    weights = ca.repmat(ca.DM(element.weights), 1, len(a))
    products = ca.vertcat(*(weights * basis[i][:, a] * basis[j][:, b] for i, j in blocks))
    inputs = [ca.MX.sym(f"block{i}{j}", len(row), layout.points) for i, j in blocks]
    stacked = ca.horzcat(*(ca.reshape(values, len(row) * n, -1) for values in inputs))
    entries = ca.vec(_times(stacked, products))  # node pair slowest, then interval, then entry of the pattern
    position, target = _hessian_entries(layout, np.array(colind), np.array(row))
    (first, targets), *others = _contributions(target)
    columns, rows = np.divmod(targets, layout.free)
    starts = np.searchsorted(columns, np.arange(layout.free + 1))
    sparsity = ca.Sparsity(layout.free, layout.free, starts.tolist(), rows.tolist())
    values = entries.get_nz(False, position[first].tolist())
    for chosen, repeated in others:  # in the joints; added in place, where sums of matrices would copy all of them
        places = np.searchsorted(targets, repeated).tolist()
        values.nz[places] = values.nz[places] + entries.nz[position[chosen].tolist()]
    matrix = ca.MX(sparsity, values)
    return ca.Function("assembly", inputs, [matrix], [f"block{i}{j}" for i, j in blocks], ["hessian"])


def _hessian_entries(layout: Layout, colind: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For every entry of every local Hessian: its position among the computed ones, its place column-major."""
    nodes, count = layout.method.degree + 1, len(row)
    column = np.repeat(np.arange(len(colind) - 1), np.diff(colind))
    mirrored = np.lexsort((column, row))  # entry (j, i) for each entry (i, j) of the symmetric pattern
    b, a, entry = (index.ravel() for index in np.indices((nodes, nodes, count)))
    order = np.lexsort((row[entry], a, column[entry], b))  # column-major, so that the final sort has little to do
    a, b, entry = a[order], b[order], entry[order]
    low, high = np.minimum(a, b), np.maximum(a, b)
    pair = high * (high + 1) // 2 + low
    stored = np.where(a >= b, entry, mirrored[entry])
    interval = np.arange(layout.intervals)[:, None]
    position = (pair * layout.intervals + interval) * count + stored
    local = layout.local
    rows, columns = local[a, interval, row[entry]], local[b, interval, column[entry]]
    kept = (rows < layout.free) & (columns < layout.free)
    return position[kept], columns[kept] * layout.free + rows[kept]


@dataclass(frozen=True)
class Pointwise:
    """The pulled-back integrand L̂(t, h, x, x'[, p]) at one point, with its derivatives, as SX Functions.

    Attributes
    ----------
    value : L̂
    gradient : ∂L̂/∂x and ∂L̂/∂x'
    derivatives : the gradient, and second derivatives in the order of `blocks`, each the column of its entries in
        `pattern`; together, because a call costs as much as evaluating a small Lagrangian
    curvature : with z = (y, y') as a further input, zᵀ∇²L̂ z and |z|ᵀ|∇²L̂||z|
    pattern : Sparsity (d, d), symmetric, that holds every second-derivative block
    blocks : which of (0, 0), (0, 1), (1, 0), (1, 1) are not structurally zero; 0 stands for x and 1 for x'
    kinetic : whether no ∂²L̂/∂x'_i² is structurally zero
    """

    value: ca.Function
    gradient: ca.Function
    derivatives: ca.Function
    curvature: ca.Function
    pattern: ca.Sparsity
    blocks: tuple[tuple[int, int], ...]
    kinetic: bool


@lru_cache(LAYOUTS_KEPT)
def pointwise(integrand: ca.Function) -> Pointwise:
    """Derive the pointwise Functions of an integrand f(t, x, v[, p]) -> scalar; the last ones are kept."""
    t, h = ca.SX.sym("t"), ca.SX.sym("h")
    d = integrand.size1_in(1)
    x, slope, z = ca.SX.sym("x", d), ca.SX.sym("slope", d), ca.SX.sym("z", 2 * d)
    parameters = [ca.SX.sym("p", integrand.size1_in(3))] if integrand.n_in() == 4 else []
    value = h * integrand(t, x, slope / h, *parameters)
    hessian, gradient = ca.hessian(value, ca.vertcat(x, slope))
    part = (slice(0, d), slice(d, 2 * d))
    cells = {(i, j): hessian[part[i], part[j]] for i in (0, 1) for j in (0, 1)}
    blocks = tuple(key for key, cell in cells.items() if cell.nnz())
    pattern = ca.Sparsity.diag(d)  # the diagonal of the matrix must exist even where L ignores a component
    for cell in cells.values():
        pattern = pattern + cell.sparsity() + cell.sparsity().T
    columns = [ca.vertcat(*ca.project(cells[key], pattern).nonzeros()) for key in blocks]
    size = ca.fabs(z)
    inputs, parts = [t, h, x, slope, *parameters], [ca.densify(gradient[part[i]]) for i in (0, 1)]
    return Pointwise(
        ca.Function("value", inputs, [value]),
        ca.Function("gradient", inputs, parts),
        # common subexpressions cost more to find than they save, but for the Hessian: a tenth of its instructions
        ca.Function("derivatives", inputs, [*parts, *columns], {"cse": True}),
        ca.Function("curvature", [*inputs, z], [ca.bilin(hessian, z, z), ca.bilin(ca.fabs(hessian), size, size)]),
        pattern,
        blocks,
        all(cells[1, 1].sparsity().has_nz(i, i) for i in range(d)),
    )


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


@lru_cache(LAYOUTS_KEPT)
def compiled(f: ca.Function, count: int, shared: tuple[int, ...]) -> ca.Function:
    """Map a pointwise Function over `count` points and compile the loop in C: 0.3 s, then 2 to 6 times faster."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise ValueError("jit=True needs a C compiler, gcc or cc, on the path; none was found")
    inputs = [ca.MX.sym(f.name_in(i), f.size1_in(i), 1 if i in shared else count) for i in range(f.n_in())]
    mapped = f.map(f.name(), "serial", count, list(shared), []) if shared else f.map(count)
    flags = {"compiler": compiler, "flags": ["-O3", "-march=native"], "directory": tempfile.gettempdir() + os.sep}
    return ca.Function(f.name(), inputs, mapped.call(inputs), {"jit": True, "compiler": "shell", "jit_options": flags})


class Functional:
    """The discrete functional of an integrand, as expressions in u, the joints of the mesh and parameters.

    Parameters
    ----------
    integrand : Function (t, x, v[, p]) -> scalar
    layout : Layout
    jit : whether gradient and Hessian are compiled in C
    """

    def __init__(self, integrand: ca.Function, layout: Layout, jit: bool = False) -> None:
        self.pointwise, self.layout, self.jit = pointwise(integrand), layout, jit
        pattern = self.pointwise.pattern
        self._points: tuple[ca.MX, ca.MX, list[ca.MX]] | None = None
        self.assembly_key = (layout, tuple(pattern.colind()), tuple(pattern.row()), self.pointwise.blocks)

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
        if batch and self.jit:
            return list(compiled(f, self.layout.points, shared).call([*at, *given]))
        f, size = batched(f, self.layout.points, shared) if batch else (f, 1)
        calls = self.layout.points // size
        mapped = f.map(f.name(), "serial", calls, list(shared), []) if shared else f.map(calls)
        return list(mapped.call([*at, *given, *extra]))

    def action(self, u: ca.MX, mesh: ca.MX, parameters: ca.MX | None) -> ca.MX:
        """S: scalar."""
        at = self._embedded(u, mesh)
        return summation(self.layout)(*self._map(self.pointwise.value, at, parameters))

    def gradient(self, u: ca.MX, mesh: ca.MX, parameters: ca.MX | None) -> tuple[ca.MX, ca.MX]:
        """∇S: of each interval's action by its own node values (d N, m + 1), and of S by u."""
        at = self._embedded(u, mesh)
        local, total = integration(self.layout).call(self._map(self.pointwise.gradient, at, parameters, batch=True))
        return local, total

    def gradient_terms(self, u: ca.MX, mesh: ca.MX, parameters: ca.MX | None) -> ca.MX:
        """Sum of the sizes of the terms of ∇S; their roundoff is a few eps of this."""
        at = self._embedded(u, mesh)
        sizes = [ca.fabs(values) for values in self._map(self.pointwise.gradient, at, parameters)]
        return integration(self.layout, absolute=True).call(sizes)[1]

    def derivatives(self, u: ca.MX, mesh: ca.MX, parameters: ca.MX | None) -> tuple[ca.MX, ca.MX]:
        """∇²S and ∇S with respect to the free values ξ, in one go through the points."""
        at = self._embedded(u, mesh)
        by_x, by_slope, *values = self._map(self.pointwise.derivatives, at, parameters, batch=True)
        total = integration(self.layout).call([by_x, by_slope])[1]
        return assembly(*self.assembly_key)(*values), total[: self.layout.free]

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
        return assembly(*self.assembly_key)(*values)

    def curvature(self, u: ca.MX, mesh: ca.MX, parameters: ca.MX | None, direction: ca.MX) -> tuple[ca.MX, ca.MX]:
        """Second variation yᵀ∇²S y along y = `direction`, and the same with every term taken positive."""
        at = self._embedded(u, mesh)
        y, slope = embedding(self.layout).call([direction, mesh])[2:]
        signed, positive = self._map(self.pointwise.curvature, at, parameters, ca.vertcat(y, slope))
        return summation(self.layout)(signed), summation(self.layout)(positive)
