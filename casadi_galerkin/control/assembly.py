"""The linear parts of the graph of an optimization, which depend on the `Chain` only, as CasADi Functions.

With A, Ê, Θ and Λ of the `ChainEmbedding`, they map ξ to A ξ, the multipliers λ to Θᵀλ, and the outputs of the
pointwise functions to f, G, ∇f, ∇G and ∇²f̄, see `graph`.  The inputs, or the outputs, at all places of one kind are one
matrix with a column for every place.  These Functions are the large part of the graph, and they are cached for problems
with the same chain.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TypeAlias

import casadi as ca

from casadi_galerkin.control.chain import Chain
from casadi_galerkin.control.embedding import ChainEmbedding, PlaceLayout
from casadi_galerkin.functional.numbering import CACHE_SIZE

Pattern: TypeAlias = tuple[int, int, tuple[int, ...], tuple[int, ...]]  # arguments of a ca.Sparsity, hashable


def pattern_of(matrix: ca.SX) -> Pattern:
    """Pattern of a matrix."""
    sparsity = matrix.sparsity()
    return *sparsity.shape, tuple(sparsity.colind()), tuple(sparsity.row())


@lru_cache(CACHE_SIZE)
def matrices(chain: Chain) -> ChainEmbedding:
    """A, Ê, Θ and Λ of a chain."""
    return ChainEmbedding(chain)


def symbols(chain: Chain) -> tuple[ca.MX, ca.MX]:
    """Symbols of unknowns and data."""
    return ca.MX.sym("unknowns", chain.unknowns), ca.MX.sym("data", chain.size - chain.unknowns)


def _at_places(name: str, chain: Chain, rows: Sequence[int]) -> list[ca.MX]:
    """Symbols of one matrix for each kind of place; `rows` are their numbers of rows."""
    return [ca.MX.sym(name, r, place.count) for r, place in zip(rows, matrices(chain).inputs, strict=True)]


def _returned(name: str, chain: Chain) -> list[ca.MX]:
    """Symbols with the shapes of the outputs of the pointwise functions."""
    return _at_places(name, chain, [place.width for place in matrices(chain).outputs])


def _gradients(chain: Chain) -> list[ca.MX]:
    """Symbols of gradients at all kinds of places."""
    return _at_places("gradients", chain, [len(active) for active in matrices(chain).active])


def _gradients_of_costs(chain: Chain) -> tuple[list[ca.MX], ca.MX]:
    """Symbols of ∇c_k at the kinds of places with costs, and the vector [w_k ∇c_k] of all places."""
    gradients, given = _gradients(chain), matrices(chain).with_costs
    of_all = [a if k in given else ca.MX.zeros(*a.shape) for k, a in enumerate(gradients)]
    of_all[0] *= ca.repmat(_weights(chain), gradients[0].size1(), 1)
    return [gradients[k] for k in given], ca.veccat(*of_all)


def _weights(chain: Chain) -> ca.MX:
    """The quadrature weights w_k at the points; at other places the weights are one."""
    return ca.MX(ca.repmat(ca.DM(chain.method.element.weights).T, 1, chain.intervals))


def _blocks(chain: Chain, patterns: tuple[Pattern, ...]) -> tuple[list[ca.MX], ca.MX]:
    """Symbols of the nonzeros of one matrix per place, for all kinds of places, and their blockdiag(·)."""
    entries = _at_places("entries", chain, [len(row) for *_, row in patterns])
    kinds = zip(patterns, matrices(chain).inputs, strict=True)
    blocks = [block for pattern, place in kinds for block in [ca.Sparsity(*pattern)] * place.count]
    return entries, ca.MX(ca.diagcat(*blocks), ca.veccat(*entries))


def _split(stacked: ca.MX, places: Sequence[PlaceLayout]) -> list[ca.MX]:
    """Cut a long vector into one matrix for each kind of place."""
    parts = ca.vertsplit(stacked, [0, *(place.last for place in places)])
    return [ca.reshape(part, place.width, place.count) for part, place in zip(parts, places, strict=True)]


@lru_cache(CACHE_SIZE)
def embedding(chain: Chain) -> ca.Function:
    """(unknowns, data) -> A ξ, the inputs at all kinds of places."""
    given, made = symbols(chain), matrices(chain)
    return ca.Function("embedding", [*given], _split(ca.mtimes(made.matrix, ca.vertcat(*given)), made.inputs))


@lru_cache(CACHE_SIZE)
def summation(chain: Chain) -> ca.Function:
    """c_k at the kinds of places with costs -> f."""
    made = matrices(chain)
    costs = [ca.MX.sym("costs", 1, made.inputs[k].count) for k in made.with_costs]
    return ca.Function("summation", costs, [ca.sum2(ca.horzcat(_weights(chain) * costs[0], *costs[1:]))])


@lru_cache(CACHE_SIZE)
def gradient(chain: Chain) -> ca.Function:
    """∇c_k at the kinds of places with costs -> ∇f."""
    gradients, weighted = _gradients_of_costs(chain)
    return ca.Function("gradient", gradients, [ca.densify(ca.mtimes(matrices(chain).derivative.T, weighted))])


@lru_cache(CACHE_SIZE)
def equations(chain: Chain) -> ca.Function:
    """Unknowns, and e_k at all kinds of places -> G."""
    made, unknowns, rows = matrices(chain), symbols(chain)[0], _returned("rows", chain)
    summed = ca.mtimes(made.test.T, ca.veccat(*rows)) + ca.mtimes(made.linear, unknowns)
    return ca.Function("equations", [unknowns, *rows], [ca.densify(summed)])


@lru_cache(CACHE_SIZE)
def jacobian(chain: Chain, patterns: tuple[Pattern, ...]) -> ca.Function:
    """Nonzeros of ∇e_k at all kinds of places -> ∇G."""
    made, (entries, blocks) = matrices(chain), _blocks(chain, patterns)
    matrix = ca.mtimes(made.test.T, ca.mtimes(blocks, made.derivative)) + made.linear
    return ca.Function("jacobian", entries, [matrix])


@lru_cache(CACHE_SIZE)
def multiplication(chain: Chain) -> ca.Function:
    """(φ, λ) -> φ w_k, then (Θᵀλ)_k, at all kinds of places, and Λᵀλ."""
    made, factor, multipliers = matrices(chain), ca.MX.sym("factor"), ca.MX.sym("multipliers", chain.equations)
    weights = [factor * _weights(chain), *[factor] * (len(made.inputs) - 1)]
    local_multipliers = _split(ca.mtimes(made.test, multipliers), made.outputs)
    linear = ca.mtimes(made.linear.T, multipliers)
    return ca.Function("multiplication", [factor, multipliers], [*weights, *local_multipliers, linear])


@lru_cache(CACHE_SIZE)
def slope(chain: Chain) -> ca.Function:
    """Gradients of the terms of f̄ at all kinds of places, and Λᵀλ -> ∇f̄."""
    gradients, linear = _gradients(chain), ca.MX.sym("linear", chain.unknowns)
    summed = ca.mtimes(matrices(chain).derivative.T, ca.veccat(*gradients)) + linear
    return ca.Function("slope", [*gradients, linear], [ca.densify(summed)])


@lru_cache(CACHE_SIZE)
def hessian(chain: Chain, patterns: tuple[Pattern, ...]) -> ca.Function:
    """Nonzeros of the second derivatives of the terms of f̄ at all kinds of places -> upper half of ∇²f̄."""
    made, (entries, blocks) = matrices(chain), _blocks(chain, patterns)
    left, right = ca.MX(made.derivative.T), ca.mtimes(blocks, made.derivative)
    pattern = ca.triu(ca.mtimes(left.sparsity(), right.sparsity()))
    return ca.Function("hessian", entries, [ca.mac(left, right, ca.MX.zeros(pattern))])


@lru_cache(CACHE_SIZE)
def verification(chain: Chain, patterns: tuple[Pattern, ...]) -> ca.Function:
    """The rest of a `Report` but f and G: the action, two sizes of every equation, ∇f̄, and the Hamiltonian.

    The first size of an equation is the sum of the sizes of its terms.  The second is the sum of the sizes of the terms
    of these, Σ |∂e/∂z| |z|, which may cancel.  The Hamiltonian has one value per interval.  The inputs are unknowns and
    data; the inputs at the quadrature points, the action there, and the derivative of f̄ by the step; ∇c_k at the kinds
    of places with costs; at all kinds of places e_k, the nonzeros of ∇e_k, and (Θᵀλ)_k; and Λᵀλ.
    """
    made, (unknowns, data) = matrices(chain), symbols(chain)
    points = made.points
    z, actions, by_step = (ca.MX.sym("points", r, points.count) for r in (points.width, 1, 1))
    (gradients, weighted), (entries, derivatives) = _gradients_of_costs(chain), _blocks(chain, patterns)
    rows, local_multipliers = _returned("rows", chain), _returned("multipliers", chain)
    linear, everything = ca.MX.sym("linear", chain.unknowns), ca.fabs(ca.vertcat(unknowns, data))
    test, others = ca.fabs(made.test.T), ca.mtimes(ca.fabs(made.linear), everything[: chain.unknowns])
    canceled = ca.mtimes(ca.fabs(derivatives), ca.mtimes(ca.fabs(made.differentiated), everything))
    slopes = weighted + ca.mtimes(derivatives.T, ca.veccat(*local_multipliers))
    durations = z[int(points.row("duration")[0, 0]), :]
    outputs = [
        ca.sum2(_weights(chain) * actions),
        ca.mtimes(test, ca.fabs(ca.veccat(*rows))) + others,
        ca.mtimes(test, canceled) + others,
        ca.mtimes(made.derivative.T, slopes) + linear,
        ca.sum1(ca.reshape(by_step / durations, -1, chain.intervals)),
    ]
    inputs = [unknowns, data, z, actions, by_step, *gradients, *rows, *entries, *local_multipliers, linear]
    return ca.Function("verification", inputs, [*map(ca.densify, outputs)])
