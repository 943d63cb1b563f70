"""Evaluate pointwise: the Lagrangian at one point of the reference interval, its derivatives, and maps over points.

On the reference interval, with the slope x' = h v, the Lagrangian is L̂(t, h, x, x') = h L(t, x, x'/h).  It contains the
step h, so that the sum over an interval needs no factor h, and the linear parts of the graph do not depend on the mesh.

A force adds its virtual work h F·δx (Lagrange-d'Alembert), so that the coefficients of the variation (δx, δx') are
(∂L̂/∂x + h F(t, x, x'/h), ∂L̂/∂x').  With a force they are not the gradient of a function, and their Jacobian J is not
symmetric; without a force J = ∇²L̂.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.functional.buffers import Evaluator
from casadi_galerkin.functional.numbering import CACHE_SIZE
from casadi_galerkin.problems.callables import calls_functions, replayed

PointMap: TypeAlias = Callable[[ca.Function, int, tuple[int, ...]], ca.Function]

# points in a row; rows are 1.5 to 4 times faster from 24 points on, and these values still fit in the cache
POINTS_IN_A_ROW = 400


def pulled_back(lagrangian: ca.Function, t: ca.SX, h: ca.SX, x: ca.SX, slope: ca.SX, *parameters: ca.SX) -> ca.SX:
    """L̂(t, h, x, x'[, p]) = h L(t, x, x'/h[, p])."""
    return h * lagrangian(t, x, slope / h, *parameters)


class Pointwise:
    """L̂(t, h, x, x'[, p]) at one point, the coefficients of (δx, δx') in its variation, and their Jacobian J.

    Parameters
    ----------
    lagrangian : Function (t, x, v[, p]) -> scalar
    force : Function (t, x, v[, p]) -> (d,), or None

    Attributes
    ----------
    symmetric : whether J is symmetric, which it is without a force
    pattern : Sparsity (d, d), symmetric, that contains the patterns of all blocks of J
    blocks : which of (0, 0), (0, 1), (1, 0) are not structurally zero, and then (1, 1); 0 stands for x and 1 for x'
    kinetic : whether no ∂²L̂/∂x'_i² is structurally zero
    linear : whether J is structurally zero
    """

    def __init__(self, lagrangian: ca.Function, force: ca.Function | None) -> None:
        t, h = ca.SX.sym("t"), ca.SX.sym("h")
        d = lagrangian.size1_in(1)
        both, of_x, of_slope = ca.SX.sym("both", 2 * d), slice(d), slice(d, 2 * d)
        x, slope = both[of_x], both[of_slope]
        parameters = [ca.SX.sym("p", lagrangian.size1_in(3))] if lagrangian.n_in() == 4 else []
        self._inputs = {"t": t, "h": h, "x": x, "slope": slope} | ({"p": parameters[0]} if parameters else {})
        self._value = pulled_back(lagrangian, t, h, x, slope, *parameters)
        self._jacobian, gradient = ca.hessian(self._value, both)
        self.symmetric = force is None
        if force is not None:
            self._work = h * force(t, x, slope / h, *parameters)
            gradient = gradient + ca.vertcat(self._work, ca.SX(d, 1))
            self._jacobian += ca.vertcat(ca.jacobian(self._work, both), ca.SX(d, 2 * d))
        gradient, rows = ca.densify(gradient), tuple(enumerate((of_x, of_slope)))
        self._coefficients = {"fx": gradient[of_x], "fv": gradient[of_slope]}
        self._cells = {(i, j): self._jacobian[row, column] for i, row in rows for j, column in rows}
        self.blocks = tuple(key for key, cell in self._cells.items() if cell.nnz() or key == (1, 1))
        self.linear = not self._jacobian.nnz()
        self.pattern = ca.Sparsity.diag(d)  # ∇²S must have a diagonal even where L does not depend on a component
        for key in self.blocks:
            sparsity = self._cells[key].sparsity()
            self.pattern = self.pattern + sparsity + sparsity.T
        kinetic = self._cells[1, 1].sparsity()
        self.kinetic = all(kinetic.has_nz(i, i) for i in range(d))

    @cached_property
    def first(self) -> ca.Function:
        """L̂, and the coefficients of δx and δx': ∂L̂/∂x + h F and ∂L̂/∂x'."""
        return self._function("first", {"f": self._value, **self._coefficients})

    @cached_property
    def derivatives(self) -> ca.Function:
        """The outputs of `first`, and J in the order of `blocks`, each of them a column of the entries of `pattern`.

        They are one Function, because a call costs as much as evaluating a small Lagrangian.
        """
        return self._function("derivatives", self._all)

    @cached_property
    def without_repetition(self) -> ca.Function:
        """The outputs of `derivatives`, without common subexpressions, a tenth to a quarter of all instructions.

        To find them takes longer than one solve saves.
        """
        return self._function("derivatives", self._all, cse=True)

    @cached_property
    def _all(self) -> dict[str, ca.SX]:
        columns = {f"block{i}{j}": ca.project(self._cells[i, j], self.pattern).nz[:] for i, j in self.blocks}
        return {"f": self._value, **self._coefficients, **columns}

    def matrices(self, entries: np.ndarray) -> np.ndarray:
        """One of `blocks` at K points, (K, d, d), from its entries (K, entries of `pattern`)."""
        matrices = np.zeros((len(entries), *self.pattern.shape))
        rows, columns = (np.array(index, dtype=int) for index in self.pattern.get_triplet())
        matrices[:, rows, columns] = entries
        return matrices

    @cached_property
    def supplied(self) -> ca.Function | None:
        """The decrease of energy, ∂L̂/∂t - h F·v, and its derivatives by x and x'; None where it is conserved."""
        if self.symmetric and not self.derivatives.jac_sparsity(0, 0).nnz():  # L̂ by t; `depends_on` is far slower
            return None
        falls = ca.gradient(self._value, self._inputs["t"])
        if not self.symmetric:
            falls -= ca.dot(self._work, self._inputs["slope"] / self._inputs["h"])
        by_both = ca.gradient(falls, ca.vertcat(self._inputs["x"], self._inputs["slope"]))
        return self._function("supplied", {"ft": ca.densify(falls), "by_both": ca.densify(by_both)})

    @cached_property
    def curvature(self) -> ca.Function:
        """With z and y, of the size of (x, x'), as further inputs, zᵀJ y and |z|ᵀ|J||y|."""
        z, y = (ca.SX.sym(name, self._jacobian.shape[0]) for name in ("z", "y"))
        terms = [ca.bilin(self._jacobian, z, y), ca.bilin(ca.fabs(self._jacobian), ca.fabs(z), ca.fabs(y))]
        return ca.Function("curvature", [*self._inputs.values(), z, y], terms)

    def _function(self, name: str, outputs: dict[str, ca.SX], **options: bool) -> ca.Function:
        return ca.Function(name, self._inputs | outputs, list(self._inputs), list(outputs), options)


@lru_cache(CACHE_SIZE)
def pointwise(lagrangian: ca.Function, force: ca.Function | None) -> Pointwise:
    """Derive the pointwise Functions of a Lagrangian and a force; the last ones are kept."""
    return Pointwise(lagrangian, force)


@lru_cache(4 * CACHE_SIZE)
def one_by_one(f: ca.Function, count: int, shared: tuple[int, ...]) -> ca.Function:
    """Map a Function over `count` points; inputs in `shared` are the same at all of them."""
    return f.map(f.name(), "serial", count, list(shared), [])


@lru_cache(4 * CACHE_SIZE)
def by_rows(f: ca.Function, count: int, shared: tuple[int, ...]) -> ca.Function:
    """Map an SX Function over points by evaluating each of its instructions for a row of points at once.

    Dispatching an instruction takes CasADi 3 ns, computing it less than one.  The points that do not fill a row, fewer
    than there are rows, are evaluated one by one.
    """
    if calls_functions(f):
        return one_by_one(f, count, shared)
    rows = -(-count // POINTS_IN_A_ROW)
    size = count // rows
    whole = one_by_one(_row(f, size, shared), rows, shared) if rows > 1 else _row(f, size, shared)
    rest = count - rows * size
    if rest == 0:
        return whole
    inputs = _inputs(f, count, shared)
    parts = [[a] * 2 if i in shared else ca.horzsplit(a, [0, count - rest, count]) for i, a in enumerate(inputs)]
    first, last = zip(*parts, strict=True)
    results = zip(whole.call(first), one_by_one(f, rest, shared).call(last), strict=True)
    return ca.Function(f.name(), inputs, [ca.horzcat(*pair) for pair in results], f.name_in(), f.name_out())


def _inputs(f: ca.Function, count: int, shared: tuple[int, ...]) -> list[ca.MX]:
    return [ca.MX.sym(f.name_in(i), f.size1_in(i), 1 if i in shared else count) for i in range(f.n_in())]


def _row(f: ca.Function, count: int, shared: tuple[int, ...]) -> ca.Function:
    """All points of an SX Function at once: its instructions, applied to rows instead of numbers."""
    inputs = _inputs(f, count, shared)
    results = replayed(f, ca.MX, [ca.vertsplit(a) for a in inputs])
    rows = [[a if a.size2() == count else ca.repmat(a, 1, count) for a in entries] for entries in results]
    return ca.Function(f.name(), inputs, [ca.vertcat(*entries) for entries in rows], f.name_in(), f.name_out())


def at_places(f: ca.Function, *given: np.ndarray, shared: Sequence[ArrayLike] = ()) -> list[np.ndarray]:
    """Outputs of a Function, dense columns, at K places, (rows, K) each; the last of its inputs are `shared` by all.

    The other inputs are (rows, K), or (K,) of a scalar.  A call on CasADi's own arrays takes two to four times as long
    at hundreds of places.
    """
    count, last = given[0].shape[-1], tuple(range(len(given), len(given) + len(shared)))
    values = Evaluator(one_by_one(f, count, last))(*(a.ravel(order="F") for a in given), *shared)
    return [value.reshape(count, -1).T for value in values]
