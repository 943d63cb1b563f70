"""The linear algebra of Newton's method: linear solves, the sizes of unknowns, and the roundoff floors of equations.

These Functions depend on the sparsity of the Hessian alone, and are kept for all Lagrangians with that sparsity.
Nothing in them is written by a solve.
"""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Any

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.roundoff import EPS, TINY, ZERO
from casadi_galerkin.functional.embedding import hessian_pattern
from casadi_galerkin.functional.functional import Functional, Parts
from casadi_galerkin.functional.numbering import CACHE_SIZE, Numbering
from casadi_galerkin.problems.linear_equations import NO_CUTOFF, Solve, scaled_solve

DEFECT_TOLERANCE = 1e-3  # accepted defect of a solution, over its right-hand side, and its refinement, over itself
METHODS = "ldl", "qr"  # LDLᵀ without pivoting, measured 4 to 20 times faster than QR, which is for where it fails
# factor on the regularization of a condition, see `_regularized`; 1e-6 and 1e-8 left larger errors
REGULARIZATION = 1e-7
HALF_DIGITS = EPS**0.5  # least size of a component over that at which it would matter, and shift of a zero pivot


class LinearSolver:
    """Functions of ∇²S, ∇S and u = (ξ, start, end).

    Parameters
    ----------
    numbering : Numbering
    sparsity : Sparsity of ∇²S
    """

    def __init__(self, numbering: Numbering, sparsity: ca.Sparsity) -> None:
        self.numbering, self.sparsity = numbering, sparsity
        self._generic_rhs = ca.DM(np.cos(1.0 + np.arange(numbering.free)))  # has no symmetry
        self._kept: dict[Any, ca.Function] = {}

    def symbols(self, *names: str) -> dict[str, ca.MX]:
        """Symbols by name: the matrix ∇²S, u, a damping, or a vector of one number per unknown."""
        shapes = {"matrix": (self.sparsity,), "u": (self.numbering.size,), "damping": (1,)}
        return {name: ca.MX.sym(name, *shapes.get(name, (self.numbering.free,))) for name in names}

    def _function(self, name: str, inputs: dict[str, ca.MX], outputs: dict[str, ca.MX]) -> ca.Function:
        return ca.Function(name, list(inputs.values()), list(outputs.values()), list(inputs), list(outputs))

    def _regularized(self, matrix: ca.MX) -> ca.MX:
        """∇²S with small negative numbers on the diagonal of the multipliers, where it has zeros.

        LDLᵀ without pivoting needs this regularization.  For a condition G δx = 0 it is a small part of
        G diag(|∇²S|)⁻¹ Gᵀ, which follows the units, and adds one negative eigenvalue.
        """
        positions, count = self.numbering.positions, self.numbering.multipliers
        if not count:
            return matrix
        conditions = matrix[positions : positions + count, :positions]
        shift = REGULARIZATION * ca.mtimes(conditions**2, 1 / ca.fabs(ca.diag(matrix)[:positions]))
        return matrix - ca.diag(ca.vertcat(ca.DM(positions, 1), shift, ca.DM(self.numbering.free_duration, 1)))

    @cached_property
    def _ldl(self) -> ca.Linsol:
        """LDLᵀ without pivoting, whose symbolic part is done once."""
        return ca.Linsol("ldl", "ldl", self._regularized(self.symbols("matrix")["matrix"]).sparsity())

    def _solution(self, method: str, matrix: ca.MX, rhs: ca.MX) -> ca.MX:
        """Solution of ∇²S Y = -B, refined once but where LDLᵀ has nothing to regularize.

        QR mixes small rows with large ones, and a refinement makes small components of Y as accurate as large ones.
        Where it is no small part of Y, ∇²S is singular up to rounding, and it is not taken.
        """
        if method == "ldl":
            solve: Solve = partial(self._ldl.solve, self._regularized(matrix))
        elif self.numbering.everywhere.start < self.numbering.free:
            solve = self._bordered(matrix, method)
        else:
            solve = scaled_solve(matrix, range(self.numbering.positions), method)
        y = -solve(rhs)
        if method == "ldl" and not self.numbering.multipliers:
            return y
        step = -solve(ca.mac(matrix, y, rhs))
        return y + ca.if_else(ca.norm_inf(ca.vec(step)) <= DEFECT_TOLERANCE * ca.norm_inf(ca.vec(y)), step, 0)

    def _bordered(self, matrix: ca.MX, method: str) -> Solve:
        """Solve by elimination of unknowns that enter everywhere: their rows would fill QR's factors.

        One refinement makes it accurate even where the rest of the matrix is singular up to rounding, as for modes (W.
        Govaerts and J. D. Pryce, "Block elimination with one refinement solves bordered linear systems accurately",
        BIT 30, 1990).
        """
        n, positions = self.numbering.everywhere.start, range(self.numbering.positions)
        inner, row = scaled_solve(matrix[:n, :n], positions, method), matrix[n:, :n]
        response = inner(ca.densify(matrix[:n, n:]))
        rest = ca.densify(matrix[n:, n:] - ca.mtimes(row, response))

        def solve(rhs: ca.MX) -> ca.MX:
            y = inner(ca.densify(rhs[:n, :]))
            last = ca.solve(rest, rhs[n:, :] - ca.mtimes(row, y), "qr", NO_CUTOFF)
            return ca.vertcat(y - ca.mtimes(response, last), last)

        return solve

    def _defect(self, matrix: ca.MX, y: ca.MX, rhs: ca.MX) -> ca.MX:
        """‖∇²S y + b‖₁ - DEFECT_TOLERANCE ‖b‖₁: the linear system is solved where this is at most zero."""
        return ca.norm_1(ca.vec(ca.mac(matrix, y, rhs))) - DEFECT_TOLERANCE * ca.norm_1(ca.vec(rhs))  # sums keep a NaN

    def solving(self, name: str, method: str, **options: Any) -> ca.Function:
        """One of the following Functions by a method, built when it is first used."""
        key = name, method, *options.values()
        if key not in self._kept:
            inputs, outputs = getattr(self, f"_{name}")(method, **options)
            self._kept[key] = self._function(name, inputs, outputs)
        return self._kept[key]

    def _solutions(self, method: str, columns: int, transposed: bool) -> Parts:
        """(matrix, rhs) -> (y, (defect,)): solutions of ∇²S y = -b, or (∇²S)ᵀ y = -b, for several b at once."""
        inputs = self.symbols("matrix") | {"rhs": ca.MX.sym("rhs", self.numbering.free, columns)}
        matrix, rhs = inputs.values()
        matrix = matrix.T if transposed else matrix
        y = self._solution(method, matrix, rhs)
        return inputs, {"solutions": y, "measures": self._defect(matrix, y, rhs)}

    def _newton_step(self, method: str) -> Parts:
        """(matrix, gradient, u) -> (step, direction, sizes, (norm, path_length, step_length, defect)).

        The Newton step; the solution for a generic right-hand side, which is near the direction of smallest curvature;
        the sizes that the unknowns are measured by; the largest entry of the step relative to these; and the lengths of
        path and step, max_d √K_d |x_d|, where a step that changes a free duration by a factor e is as long as the path.
        """
        inputs = self.symbols("matrix", "gradient", "u")
        matrix, gradient, u = inputs.values()
        scale = self.largest(u)
        scaled_rhs = self._generic_rhs / self._measure(scale)
        step, direction = ca.horzsplit(self._solution(method, matrix, ca.horzcat(gradient, scaled_rhs)))
        whole = ca.vertcat(step, ca.MX.zeros(self.numbering.size - self.numbering.free))
        moved, stiffness = self.largest(whole), self._stiffness(matrix)
        reached = ca.fmax(scale, moved)
        sizes = self._measure(ca.fmax(reached, HALF_DIGITS * _mattering(stiffness, reached)))
        length, step_length = (ca.norm_inf(stiffness * a) for a in (scale, moved))
        if self.numbering.free_duration:
            step_length = ca.fmax(step_length, length * ca.fabs(step[-1]))
        defect = self._defect(matrix, step, gradient)
        measures = ca.vertcat(ca.norm_inf(step / sizes), length, step_length, defect)
        return inputs, {"step": step, "direction": direction, "sizes": sizes, "measures": measures}

    def _simplified_step(self, method: str) -> Parts:
        """(matrix, gradient, step, sizes, damping) -> (simplified, (length, nonlinearity, defect)).

        The step from a trial point with the Hessian of the last iterate; its largest entry relative to `sizes`; and its
        distance from (1 - damping) times the Newton step, to which it would be equal on a linear problem.
        """
        inputs = self.symbols("matrix", "gradient", "step", "sizes", "damping")
        matrix, gradient, step, sizes, damping = inputs.values()
        y = self._solution(method, matrix, gradient)
        nonlinearity = ca.norm_inf((y - (1 - damping) * step) / sizes)
        measures = ca.vertcat(ca.norm_inf(y / sizes), nonlinearity, self._defect(matrix, y, gradient))
        return inputs, {"simplified": y, "measures": measures}

    @cached_property
    def largest(self) -> ca.Function:
        """Largest size of each component along a path, from its vector u; (d,)."""
        inputs = self.symbols("u")
        of_nodes = self.numbering.of_nodes[: self.numbering.distinct]
        values = ca.reshape(inputs["u"].get_nz(False, of_nodes.T.ravel().tolist()), of_nodes.shape)
        return self._function("largest", inputs, {"scale": ca.vertcat(*map(ca.norm_inf, ca.horzsplit(values)))})

    @cached_property
    def without_multipliers(self) -> np.ndarray:
        """Numbers of the nonzeros of ∇²S in neither a row nor a column of a multiplier."""
        first, last = self.numbering.positions, self.numbering.positions + self.numbering.multipliers
        row, column = (np.array(index, dtype=int) for index in self.sparsity.get_triplet())
        return np.flatnonzero(((row < first) | (row >= last)) & ((column < first) | (column >= last)))

    @cached_property
    def diagonal(self) -> list[np.ndarray]:
        """Numbers of the nonzeros of ∇²S on its diagonal, for each component of the path."""
        row, column = (np.array(index, dtype=int) for index in self.sparsity.get_triplet())
        numbers = np.flatnonzero((row == column) & (row < self.numbering.positions))
        of = self.numbering.component[row[numbers]]
        return [numbers[of == c] for c in range(self.numbering.dimension)]

    def _stiffness(self, matrix: ca.MX) -> ca.MX:
        """Square root of the largest entry on the diagonal of ∇²S, for each component of the path; (d,)."""
        entries = [matrix.nz[numbers.tolist()] for numbers in self.diagonal]
        return ca.vertcat(*(ca.sqrt(ca.norm_inf(entry)) if entry.numel() else 0 for entry in entries))

    def _expanded(self, scale: ca.MX, further: ca.MX) -> ca.MX:
        """One value per unknown, from one per component of the path and those of the further unknowns."""
        along = scale.get_nz(False, self.numbering.component[: self.numbering.positions].tolist())
        return ca.vertcat(ca.vec(along), further) if further.numel() else ca.vec(along)

    def _measure(self, scale: ca.MX) -> ca.MX:
        """What each unknown is measured by: the size of its component, or one where that is zero.

        The size of a multiplier is infinite: the equations are linear in it, so that it is right where the path is.
        """
        further = ca.DM([np.inf] * self.numbering.multipliers + [1.0] * self.numbering.free_duration)
        return self._expanded(ca.if_else(scale < ZERO, 1.0, scale), ca.MX(further))

    @cached_property
    def sizes(self) -> ca.Function:
        """Measure the unknowns: u -> (sizes, scaled_rhs), the latter a right-hand side without symmetry."""
        inputs = self.symbols("u")
        sizes = self._measure(self.largest(inputs["u"]))
        return self._function("sizes", inputs, {"sizes": sizes, "scaled_rhs": self._generic_rhs / sizes})

    @cached_property
    def floor(self) -> ca.Function:
        """(matrix, u, terms) -> (floor, scale, product, importance): the roundoff floor of every entry of ∇S.

        It is eps times the sizes of the terms that ∇S sums, and times |∇²S||ξ|, because the rounding of ξ itself
        counts.  |ξ| stands for the size at which each unknown's component would matter.  A path that counts as zero is
        measured by `ZERO`: relative to its own size, its residual would never come down to roundoff.  A multiplier is
        at least as large as the terms it balances.  The importance of a component is its size over that at which it
        would matter; (d,).
        """
        inputs = self.symbols("matrix", "u", "terms")
        matrix, u, terms = inputs.values()
        positions, last = self.numbering.positions, self.numbering.positions + self.numbering.multipliers
        own = self.largest(u)
        mattering = _mattering(self._stiffness(matrix), own)
        scale = ca.fmax(self._expanded(mattering, ca.fabs(u[positions : self.numbering.free])), ZERO)
        sizes = ca.fabs(matrix)
        if self.numbering.multipliers:
            acting, stiffness = sizes[:positions, positions:last], ca.fmax(ca.diag(sizes)[:positions], ZERO)
            balanced = terms[:positions] + ca.mtimes(sizes[:positions, :positions], scale[:positions])
            largest = ca.mtimes(acting.T, balanced / stiffness) / (ca.mtimes((acting**2).T, 1 / stiffness) + TINY)
            scale[positions:last] = ca.fmax(scale[positions:last], largest)
        product = ca.mtimes(sizes, scale)
        outputs = {"floor": EPS * (terms + product) + TINY, "scale": scale, "product": product}
        outputs["importance"] = own / ca.fmax(mattering, ZERO)
        return self._function("floor", inputs, outputs)

    @cached_property
    def verification(self) -> ca.Function:
        """(gradient, matrix, u, terms, direction) -> (residual, regularity, importance).

        The largest entry of ∇S over its roundoff floor, and yᵀ∇²S y for y = `direction` over a
        bound of |y|ᵀ|∇²S||y|.  A regularity of zero or NaN tells nothing: where a component has a single unknown, its
        one term in the Hessian has nothing to be compared with.
        """
        inputs = self.symbols("gradient", "matrix", "u", "terms", "direction")
        gradient, matrix, u, terms, y = inputs.values()
        floor, scale, product, importance = self.floor(matrix, u, terms)
        ratios = gradient / floor
        residual = ca.if_else(all_finite(ratios), ca.norm_inf(ratios), np.nan)
        path = scale[: self.numbering.positions, :]
        y = y / ca.norm_inf(y[: self.numbering.positions, :] / path)
        if self.numbering.free > self.numbering.positions:  # further unknowns are linear, or may be zero
            scale = ca.vertcat(path, ca.fabs(y[self.numbering.positions :]))
            product = ca.mtimes(ca.fabs(matrix), scale)
        quotient = ca.fabs(ca.bilin(matrix, y, y)) / ca.dot(scale, product)
        comparable = ca.mmin(path) > ZERO if self.numbering.positions > self.numbering.dimension else ca.MX(0)
        outputs = {"residual": residual, "regularity": ca.if_else(comparable, quotient, 0), "importance": importance}
        return self._function("verification", inputs, outputs)

    @cached_property
    def regularized(self) -> ca.Function:
        """∇²S with regularized conditions and its whole diagonal, for the inertia of LDLᵀ."""
        inputs = self.symbols("matrix")
        regularized = self._regularized(inputs["matrix"])
        whole = regularized.sparsity() + ca.Sparsity.diag(self.numbering.free)
        return self._function("regularized", inputs, {"regularized": ca.project(regularized, whole)})


def _mattering(stiffness: ca.MX, scale: ca.MX) -> ca.MX:
    """Size at which each component would matter as much as the one that matters most, from their sizes; (d,).

    With stiffnesses K on the diagonal, of which the square roots are given, it is max_d √K_d |x_d| / √K_c: by Cauchy
    and Schwarz, the terms of all components in an equation of component c are at most K_c times that, and so is their
    rounding over eps.
    """
    return ca.if_else(stiffness > 0, ca.norm_inf(stiffness * scale) / stiffness, scale)


def all_finite(*values: ca.MX) -> ca.MX:
    """Whether all values are finite: a maximum may lose a NaN, a sum does not."""
    return ca.norm_1(ca.vertcat(*values)) < np.inf


def factors_of(sparsity: ca.Sparsity, method: str = "ldl") -> ca.Linsol:
    """Workspace of LDLᵀ without pivoting, for symmetric matrices of a sparsity with its whole diagonal, or of "qr"."""
    return ca.Linsol("factors", method, sparsity, NO_CUTOFF if method == "qr" else {})


def negative_pivots(matrix: ca.DM, factors: ca.Linsol) -> int:
    """Number of negative eigenvalues of a symmetric matrix, by Sylvester's law of inertia.

    Where a pivot is exactly zero, those of a matrix with a slightly shifted diagonal are counted.
    """
    factors.nfact(matrix)
    if factors.rank(matrix) < matrix.size1():
        factors.nfact(matrix + HALF_DIGITS * ca.diag(ca.sum2(ca.fabs(matrix))))
    return factors.neig(matrix)


@lru_cache(CACHE_SIZE)
def of_pattern(numbering: Numbering, colind: tuple[int, ...], row: tuple[int, ...], symmetric: bool) -> LinearSolver:
    """The linear algebra of a sparsity without further terms, cached; arguments as for `hessian_pattern`."""
    return LinearSolver(numbering, hessian_pattern(numbering, colind, row, symmetric).sparsity)


def linear_solver(functional: Functional) -> LinearSolver:
    """The linear algebra of a functional; the same for all that have no further terms and the same sparsity."""
    plain = not functional.terms and functional.numbering.everywhere.start == functional.numbering.free
    return of_pattern(*functional.pattern_key) if plain else LinearSolver(functional.numbering, functional.sparsity)
