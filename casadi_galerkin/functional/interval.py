"""The discrete Euler-Lagrange equations of one interval, with given position and momentum at its start.

Discrete Hamilton's principle on one interval is S'(δ) = p_1·δ(1) - p_0·δ(0) for every polynomial δ of degree m.  The
global equations (euler1), (euler2) of the paper state the same between one joint and the next.  The unknowns are the
slopes s_i of the path at the m Gauss points: these are increments, and their roundoff is that of x_1 - x_0.  With l_i
the Lagrange polynomials of these points, ψ_i their integrals from 0, b_i = ψ_i(1), and (f, g)_k the weighted
derivatives w_k ∂L̂/∂(x, x') of the pulled-back Lagrangian at the quadrature points q_k,

    x̄(q) = x_0 + Σ ψ_i(q) s_i,     x̄'(q) = Σ l_i(q) s_i,     x_1 = x_0 + Σ b_i s_i
    p_1 = p_0 + Σ f_k                                                       δ = 1
    R_j = b_j p_1 - Σ ( ψ_j(q_k) f_k + l_j(q_k) g_k ) = 0                   δ = ψ_j.

The path and the equations contain the same rounded ψ, l and b.  So an affine symmetry of L conserves its momentum map
up to the rounding of single operations, which accumulates like a random walk.  A force adds its virtual work
h w_k F_k·δ(q_k) (Lagrange-d'Alembert), that is, h w_k F_k to f_k.  The equations do not depend on the control points.

A holonomic constraint c(t, x) = 0 is imposed at the nodes n_1 ... n_m, by impulses Λ_a at the nodes n_0 ... n_{m-1}.
With G = ∂c/∂x, these add the virtual work Σ G_aᵀΛ_a·δ(n_a); that of an impulse at the last node would cancel in R.  A
further impulse μ at the end makes the velocity v_1 there tangent to the constraint:

    c(n_a) = 0,     p_1 = ∂L/∂v(t_1, x_1, v_1) = p_0 + Σ f_k + Σ G_aᵀΛ_a + G_mᵀμ,     G_m v_1 + ∂c/∂t = 0.

Where the duration is free, all steps are stretched, h = λ h̄.  The stretch λ is then one more component of x, constant
along the path, and its momentum accumulates ∂S/∂λ from interval to interval: p_λ,1 = p_λ,0 + ∂S/∂λ.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.nodes import lagrange_values
from casadi_galerkin.calculus.quadrature import gauss
from casadi_galerkin.calculus.roundoff import EPS, TINY
from casadi_galerkin.functional.pointwise import pointwise
from casadi_galerkin.problems.legendre_transform import momentum_at
from casadi_galerkin.problems.linear_equations import NO_CUTOFF, scaled_solve

# doublings of the number of Newton iterations: at least as many as double the digits from the first to the last, which
# is 8; more led through collisions
ITERATION_DOUBLINGS = int(np.ceil(np.log2(np.log2(-np.log2(EPS)))))
# estimated relative Newton step that is no longer taken; the estimate was measured up to 60 times too small
SMALLEST_STEP = 0.01 * EPS
# The last step that Newton's method takes is at most this part of the largest component.  QR spreads the rounding of
# this step, EPS times its size, to all components, also to those at rest.
LARGEST_LAST_STEP = float(np.cbrt(SMALLEST_STEP))


class SlopeBasis:
    """Polynomials of degree m - 1 by their values at the m Gauss points, and their integrals from 0.

    Attributes
    ----------
    points : (m,), Gauss points on [0, 1]
    weights : (m,), b_i, the integrals over [0, 1]
    """

    def __init__(self, degree: int) -> None:
        rule = gauss(degree)
        self.points, self.weights = np.array(rule.points), np.array(rule.weights)

    def slopes(self, c: np.ndarray) -> np.ndarray:
        """l_i(c); (len(c), m)."""
        return lagrange_values(self.points, c)

    def values(self, c: np.ndarray) -> np.ndarray:
        """ψ_i(c), the integral of l_i from 0 to c; (len(c), m)."""
        m = len(self.points)
        scaled = lagrange_values(self.points, np.outer(c, self.points).ravel()).reshape(len(c), m, m)
        return c[:, None] * np.einsum("l,cli->ci", self.weights, scaled)


def _points(lagrangian: ca.Function, force: ca.Function | None) -> ca.Function:
    """(t, h, x, x', terms) -> L̂, its derivatives with h F added (2d,), their Jacobian, and sizes of their terms (2d,).

    `terms` (2d,) are the sizes of the terms that were summed to (x, x'), which may cancel.  The roundoff of the
    derivatives is EPS times the sizes returned.
    """
    d = lagrangian.size1_in(1)
    t, h, x, slope = ca.SX.sym("t"), ca.SX.sym("h"), ca.SX.sym("x", d), ca.SX.sym("slope", d)
    at, terms = ca.vertcat(x, slope), ca.SX.sym("terms", 2 * d)
    action, *coefficients = pointwise(lagrangian, force).first(t, h, x, slope)
    values = ca.vertcat(*coefficients)
    jacobian = ca.jacobian(values, at)
    sizes = ca.densify(ca.fabs(values) + ca.mtimes(ca.fabs(jacobian), terms))
    return ca.Function("points", [t, h, x, slope, terms], [action, values, jacobian, sizes], {"cse": True})


@dataclass(frozen=True)
class Interval:
    """The equations of one interval: Functions of (s, x, p, t, h).

    s (d, m) are the slopes.  With k constraints s is (d + k, m + 1): the last k rows hold the impulses Λ, and the last
    column holds (h v_1, μ).

    Attributes
    ----------
    system : -> R, ∂R/∂s
    check : -> |R| over its roundoff floor, action of the interval, sizes of the terms of p_1 (d,)
    end : -> x_1, p_1, velocity at the end
    denoised : -> s, with zeros in place of slopes that are roundoff only; without constraints s itself
    """

    system: ca.Function
    check: ca.Function
    end: ca.Function
    denoised: ca.Function

    def jacobian(self) -> ca.Function:
        """∂(x_1, p_1)/∂(x_0, p_0) of the step, (2d, 2d), by the implicit function theorem on R = 0."""
        shape, d, positions = self.system.size_in(0), self.system.size1_in(1), self.end.size1_out(2)
        count = shape[0] * shape[1]
        column, x, p, t, h = symbols = [
            ca.SX.sym(name, size) for name, size in zip("sxpth", (count, d, d, 1, 1), strict=True)
        ]
        inputs, start = [ca.reshape(column, *shape), x, p, t, h], ca.vertcat(x, p)
        (residual, by_s), ends = self.system(*inputs), ca.vertcat(*self.end(*inputs)[:2])
        parts = [by_s, ca.jacobian(residual, start), ca.jacobian(ends, start), ca.jacobian(ends, column)]
        partial = ca.Function("partial", symbols, [ca.densify(part) for part in parts])
        at = self.system.mx_in()
        by_s, by_start, direct, along = partial(ca.vec(at[0]), *at[1:])
        return ca.Function("step_jacobian", at, [direct - ca.mtimes(along, _solved(by_s, by_start, shape, positions))])

    def with_free_duration(self) -> Interval:
        """The same equations with the stretch λ as last component of x, which has no slopes; see the module."""
        s, t, h, d = self.system.sx_in(0), ca.SX.sym("t"), ca.SX.sym("h"), self.system.size1_in(1)
        x, p = ca.SX.sym("x", d + 1), ca.SX.sym("p", d + 1)
        inputs, stretch = [s, x[:d], p[:d], t, x[d] * h], x[d]
        system, (ratio, action, summed), (end, momentum, velocity) = (
            part(*inputs) for part in (self.system, self.check, self.end)
        )
        gained = ca.gradient(action, stretch)
        return _interval_of(
            [s, x, p, t, h],
            system=system,
            check=(ratio, action, ca.vertcat(summed, ca.fabs(p[d]) + ca.fabs(gained))),
            end=(ca.vertcat(end, stretch), ca.vertcat(momentum, p[d] + gained), velocity * stretch),
            denoised=(self.denoised(*inputs),),
        )


def _interval_of(symbols: list[ca.SX], **outputs: tuple[ca.SX, ...]) -> Interval:
    """The Functions of an interval, from expressions in (s, x, p, t, h)."""
    dense = {name: [ca.densify(output) for output in given] for name, given in outputs.items()}
    return Interval(**{name: ca.Function(name, symbols, given) for name, given in dense.items()})


def interval(
    lagrangian: ca.Function, force: ca.Function | None, constraint: ca.Function | None, method: Galerkin
) -> Interval:
    """Build the equations of one interval (see the module) as SX Functions."""
    d, m, element, basis = lagrangian.size1_in(1), method.degree, method.element, SlopeBasis(method.degree)
    q, w, b = element.points, element.weights[:, None], basis.weights
    values, slopes = basis.values(q), basis.slopes(q)
    k = 0 if constraint is None else constraint.size1_out(0)
    unknowns, x, p = ca.SX.sym("s", d + k, m + (k > 0)), ca.SX.sym("x", d), ca.SX.sym("p", d)
    s, t, h = unknowns[:d, :m], ca.SX.sym("t"), ca.SX.sym("h")
    at = [t + h * ca.DM(q).T, ca.repmat(h, 1, len(q)), x + s @ ca.DM(values).T, s @ ca.DM(slopes).T]
    size = ca.fabs(s)
    summed = ca.vertcat(ca.repmat(ca.fabs(x), 1, len(q)) + size @ ca.DM(abs(values)).T, size @ ca.DM(abs(slopes)).T)
    action, gradient, jacobian, sizes = _points(lagrangian, force).map(len(q)).call([*at, summed])
    f, g = ca.vertsplit(gradient * ca.repmat(ca.DM(w).T, 2 * d, 1), d)
    end = p + ca.sum2(f)
    residual = ca.vec(end @ ca.DM(b).T - f @ ca.DM(values) - g @ ca.DM(slopes))
    points = ca.diagcat(*ca.horzsplit(jacobian, 2 * d))
    by_s = _spread(w * (b - values), -w * slopes, d).T @ points @ _spread(values, slopes, d)
    f_size, g_size = ca.vertsplit(sizes * ca.repmat(ca.DM(abs(w)).T, 2 * d, 1), d)
    end_terms = ca.fabs(p) + ca.sum2(f_size)
    terms = end_terms @ ca.DM(b).T + f_size @ ca.DM(abs(values)) + g_size @ ca.DM(abs(slopes))
    terms, denoised = ca.vec(terms), unknowns
    if constraint is not None:
        added, added_terms, end, end_terms, denoised = _constrained_equations(
            lagrangian, constraint, method, unknowns, x, end, t, h
        )
        selection = ca.jacobian(ca.vec(s), ca.vec(unknowns))
        residual = selection.T @ residual + added
        by_s = selection.T @ by_s @ selection + ca.jacobian(added, ca.vec(unknowns))
        largest = ca.mmax(ca.fabs(ca.horzcat(x, unknowns[:d, :])))
        noise = LARGEST_LAST_STEP * largest * ca.sum2(ca.fabs(by_s)[:, _path_unknowns(unknowns.shape, d)])
        terms = selection.T @ terms + added_terms + noise
    terms = _shared(terms, by_s, unknowns.shape, d)
    return _interval_of(
        [unknowns, x, p, t, h],
        system=(residual, by_s),
        check=(ca.fabs(residual) / (EPS * terms + TINY), action @ ca.DM(w), end_terms),
        end=(x + s @ ca.DM(b), end, s @ ca.DM(basis.slopes(np.ones(1))).T / h),
        denoised=(denoised,),
    )


def _constrained_equations(
    lagrangian: ca.Function,
    constraint: ca.Function,
    method: Galerkin,
    unknowns: ca.SX,
    x: ca.SX,
    free_momentum: ca.SX,
    t: ca.SX,
    h: ca.SX,
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
    """The terms and equations that a constraint adds to those of one interval.

    The equations have the shape of s.  Each column but the last holds R_j and the constraint at a node; the last one
    holds the equations of p_1 and of the tangent velocity at the end.  In this order QR mixes no components that do not
    depend on each other.  `free_momentum` is p_1 without the impulses of the constraint.

    Returns
    -------
    the work of the impulses, to be added to R, and the new equations, column by column, ((d + k) (m + 1),)
    the sizes of the terms of these
    p_1, and the sizes of its terms; (d,) each
    the unknowns, with zeros in place of slopes that are roundoff only: those whose contributions to all momenta are
        below EPS times `LARGEST_LAST_STEP` of the terms there.  So a component at rest stays at rest
    """
    d, m, nodes = x.numel(), method.degree, method.element.nodes
    basis = SlopeBasis(m)
    values, b = basis.values(nodes), basis.weights
    s, impulses, last, mu = unknowns[:d, :m], unknowns[d:, :m], unknowns[:d, m], unknowns[d:, m]
    when, where, v = ca.SX.sym("t"), ca.SX.sym("x", d), last / h
    g = constraint(when, where)
    at = ca.Function("g", [when, where], [g, ca.densify(ca.jacobian(g, where)), ca.densify(ca.jacobian(g, when))])
    x_at = ca.repmat(x, 1, m + 1) + s @ ca.DM(values).T
    evaluated = [at(t + h * c, x_at[:, a]) for a, c in enumerate(nodes)]
    slopes = [slope for _, slope, _ in evaluated]
    pushes = ca.horzcat(*(slopes[a].T @ impulses[:, a] for a in range(m)))
    pushed = ca.horzcat(*(ca.fabs(slopes[a]).T @ ca.fabs(impulses[:, a]) for a in range(m)))
    by_node = ca.repmat(ca.DM(b).T, m, 1) - ca.DM(values[:m])  # ψ_j at the end minus ψ_j at the node
    before = free_momentum + ca.sum2(pushes)
    momentum = momentum_at(lagrangian, t + h, x_at[:, m], v)
    fastest = ca.vertcat(*(ca.mmax(ca.fabs(unknowns[i, :])) for i in range(d)))  # h v_1 alone may pass through zero
    masses = ca.fabs(ca.jacobian(momentum, last))
    largest_momenta = masses @ fastest
    normal = slopes[m].T @ mu
    sizes = ca.repmat(ca.fabs(x), 1, m + 1) + ca.fabs(s) @ ca.DM(abs(values)).T  # terms of x, which may cancel
    at_nodes = ca.horzcat(*(value for value, _, _ in evaluated[1:]))
    at_end = ca.vertcat(momentum - before - normal, slopes[m] @ v + evaluated[m][2])
    work_terms = pushed @ ca.fabs(by_node)
    node_terms = ca.horzcat(*(ca.fabs(slope) @ sizes[:, a] for a, slope in enumerate(slopes) if a))
    momentum_terms = largest_momenta + ca.fabs(momentum) + ca.fabs(free_momentum) + ca.sum2(pushed)
    momentum_terms += ca.fabs(slopes[m]).T @ ca.fabs(mu)
    parts = masses / ca.repmat(EPS * LARGEST_LAST_STEP * momentum_terms + TINY, 1, d)
    largest = ca.vertcat(*(ca.mmax(parts_of_one) for parts_of_one in ca.horzsplit(parts)))
    significant = ca.fabs(unknowns[:d, :]) * ca.repmat(largest, 1, m + 1) > 1
    end_terms = ca.vertcat(momentum_terms, ca.fabs(slopes[m]) @ fastest / h + ca.fabs(evaluated[m][2]))
    return (
        ca.vec(ca.horzcat(ca.vertcat(pushes @ by_node, at_nodes), at_end)),
        ca.vec(ca.horzcat(ca.vertcat(work_terms, node_terms), end_terms)),
        momentum,
        momentum_terms,
        ca.vertcat(unknowns[:d, :] * significant, unknowns[d:, :]),
    )


def _shared(terms: ca.SX, by_s: ca.SX, shape: tuple[int, int], d: int) -> ca.SX:
    """Sizes of the terms of all equations, those of motion at least as large as the other components' in the column.

    Terms that cancel within the derivatives of L do not tell their sizes.  By Cauchy and Schwarz, those of two
    components compare like the square roots of their stiffnesses, the entries on the diagonal of ∂R/∂s.
    """
    sizes, stiffness = ca.reshape(terms, *shape), ca.reshape(ca.fabs(ca.diag(by_s)), *shape)
    roots = ca.sqrt(ca.vertcat(*(ca.mmax(stiffness[i, :]) for i in range(d))))
    for j in range(shape[1]):
        largest = ca.mmax(ca.if_else(roots > 0, sizes[:d, j] / roots, 0))
        sizes[:d, j] = ca.fmax(sizes[:d, j], roots * largest)
    return ca.vec(sizes)


def _spread(by_x: np.ndarray, by_slope: np.ndarray, d: int) -> ca.DM:
    """Coefficients of (x, x') at the quadrature points, the same for all components; (2 d r, d columns), sparse."""
    pairs = np.stack((by_x, by_slope), axis=1).reshape(2 * len(by_x), -1)
    return ca.sparsify(ca.DM(np.kron(pairs, np.eye(d))))


def _solved(matrix: ca.MX, rhs: ca.MX, shape: tuple[int, int], dimension: int) -> ca.MX:
    """Solution of the linear equations of an interval; those of a single component need no scaling."""
    if shape[0] == 1:
        return ca.solve(matrix, rhs, "qr", NO_CUTOFF)
    return scaled_solve(matrix, _path_unknowns(shape, dimension))(rhs)


def _path_unknowns(shape: tuple[int, int], dimension: int) -> list[int]:
    """Numbers of the unknowns that are slopes or velocities, not impulses, counted column by column."""
    rows, columns = shape
    return [rows * j + i for j in range(columns) for i in range(dimension)]


def newton_iteration(system: ca.Function, positions: int) -> ca.Function:
    """Newton's method for R = 0, as a Function (s, x, p, t, h) -> s, number of iterations.

    Steps are measured relative to the sizes of the components; under a constraint, to the sizes of their slopes, to
    which the tangent velocity has to be accurate.  Where steps converge quadratically, |ds| = c |ds_before|², the next
    one will be |ds| (|ds| / |ds_before|)².  The iteration ends when this estimate is below `SMALLEST_STEP`.  The first
    so many components of x are `positions`; a stretch is none.  Each doubling runs the iterations of the one before,
    and runs them again if they did not end, so that only few conditionals are evaluated.
    """
    inputs = system.mx_in()
    (rows, m), d = inputs[0].shape, positions
    s, ds, x, before = ca.SX.sym("s", rows, m), ca.SX.sym("ds", rows, m), ca.SX.sym("x", d), ca.SX.sym("before")
    largest = ca.mmax(ca.fabs(ca.horzcat(x, s[:d, :])))
    least = ca.fabs(x) if rows == d else ca.repmat(LARGEST_LAST_STEP * largest, d, 1)
    size = [least[i] + ca.mmax(ca.fabs(s[i, :])) + ca.mmax(ca.fabs(ds[i, :])) + TINY for i in range(d)]
    relative = ca.mmax(ca.fabs(ds[:d, :]) / ca.repmat(ca.vertcat(*size), 1, m))  # without the impulses
    unfinished = relative * ca.fmin(1, relative / before) ** 2 > SMALLEST_STEP  # false if it is not a number
    update = ca.Function("update", [s, ds, x, before], [s + ds, relative, unfinished, 1])
    residual, by_s = system(*inputs)
    last, step = ca.MX.sym("last"), ca.reshape(-_solved(by_s, residual, (rows, m), d), rows, m)
    state = [inputs[0], last, *inputs[1:]]
    newton = ca.Function("newton", state, update.call([inputs[0], step, inputs[1][:d], last]))
    done = ca.Function("done", state, [*state[:2], 0, 0])
    for _ in range(ITERATION_DOUBLINGS):
        *values, more, count = newton.call(state)
        *values, more, further = ca.Function.if_else("again", newton, done).call([more, *values, *inputs[1:]])
        newton = ca.Function("newton", state, [*values, more, count + further])
    values, _, _, count = newton.call([inputs[0], ca.MX(0), *inputs[1:]])
    return ca.Function("newton", inputs, [values, count])
