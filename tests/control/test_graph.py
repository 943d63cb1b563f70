"""The graph of a trajectory optimisation: derivatives are CasADi's own, and no nonzero more."""

import casadi as ca
import numpy as np
import pytest
from control_problems import cart_pole, everything, minimum_time

import casadi_galerkin as cg

ROUNDOFF = 1e-12  # of sums of a few hundred terms of order 1 to 100
METHODS = [
    cg.Galerkin(1),
    cg.Galerkin(3),
    cg.Galerkin(3, quadrature=cg.gauss(4)),
    cg.Galerkin(2, quadrature=cg.lobatto(3)),
]


@pytest.fixture(params=METHODS, ids=str)
def method(request):
    return request.param


@pytest.fixture(params=[everything, cart_pole, minimum_time])
def graph(request, method):
    return cg.transcribe(request.param(), method, 4).graph


@pytest.fixture
def somewhere(graph):
    rng = np.random.default_rng(1)
    sizes = (graph.unknowns.numel(), graph.data.numel(), graph.equations.numel())
    unknowns, data, multipliers = (0.5 + 0.3 * rng.standard_normal(size) for size in sizes)
    data[-5:] = np.linspace(0, 1, 5)  # the mesh, as fractions of the duration
    return unknowns, np.where(data == 0, 0.1, data), multipliers


def largest(matrix):
    return float(ca.norm_inf(ca.vec(ca.densify(matrix))))


def test_gradient_is_casadis_own(graph, somewhere):
    unknowns, data, _ = somewhere
    own = ca.Function("own", [graph.unknowns, graph.data], [ca.gradient(graph.cost, graph.unknowns)])(unknowns, data)
    assert largest(graph.gradient(unknowns, data)[1] - own) <= ROUNDOFF * (1 + largest(own))


def test_jacobian_is_casadis_own_with_no_nonzero_more(graph, somewhere):
    unknowns, data, _ = somewhere
    jacobian = ca.jacobian(graph.equations, graph.unknowns)
    own = ca.Function("own", [graph.unknowns, graph.data], [jacobian])(unknowns, data)
    ours = graph.jacobian(unknowns, data)[1]
    assert ours.sparsity() == own.sparsity()
    assert largest(ours - own) <= ROUNDOFF * (1 + largest(own))


def test_hessian_is_casadis_own_with_no_nonzero_more(graph, somewhere):
    unknowns, data, multipliers = somewhere
    factor, lam = ca.MX.sym("factor"), ca.MX.sym("lam", len(multipliers))
    lagrangian = factor * graph.cost + ca.dot(lam, graph.equations)
    upper = ca.triu(ca.hessian(lagrangian, graph.unknowns)[0])
    own = ca.Function("own", [graph.unknowns, graph.data, factor, lam], [upper])(unknowns, data, 0.7, multipliers)
    ours = graph.hessian(unknowns, data, 0.7, multipliers)
    assert ours.sparsity() == own.sparsity()
    assert largest(ours - own) <= ROUNDOFF * (1 + largest(own))


@pytest.mark.parametrize(("degree", "intervals"), [(1, 9), (4, 20), (7, 5)])
def test_derivatives_are_block_sparse(degree, intervals):
    graph = cg.transcribe(cart_pole(), cg.Galerkin(degree), intervals).graph
    nodes, d = degree + 1, 2
    path = intervals * (nodes * d) ** 2 - (intervals - 1) * d**2 - 2 * d * nodes * d  # less the ends, which are given
    controls = intervals * degree * nodes  # the control pushes the cart only
    assert graph.jacobian.nnz_out(1) == path + controls
    # L is quadratic in the cart's velocity and ignores its position: no second derivative there
    pole, mixed, ends = nodes * (nodes + 1) // 2, nodes**2, 3 * nodes - 1
    path = intervals * (pole + mixed) - (intervals - 1) * 2 - 2 * ends
    assert graph.hessian.nnz_out(0) == path + intervals * degree
