"""The graph of a trajectory optimization: derivatives are CasADi's own, and no nonzero more."""

import casadi as ca
import numpy as np
import pytest
from control_problems import cart_pole, cartesian_pendulum, everything, minimum_time, staged, two_phases
from slow import slow

import casadi_galerkin as cg

ROUNDOFF = 1e-12  # of sums of a few hundred terms of order 1 to 100
METHODS = [cg.Galerkin(1), cg.Galerkin(3, quadrature=cg.gauss(4)), cg.Galerkin(2, quadrature=cg.lobatto(3))]


@pytest.fixture(params=METHODS, ids=str, scope="module")
def method(request):
    return request.param


@pytest.fixture(params=[everything, cart_pole, minimum_time, cartesian_pendulum, two_phases, staged], scope="module")
def graph(request, method):
    return cg.transcribe(request.param(), method, 4).graph


@pytest.fixture
def somewhere(graph):
    rng, numbers = np.random.default_rng(1), graph.numbering
    everything = 0.5 + 0.3 * rng.standard_normal(numbers.size)
    for chain in numbers.chains:
        everything[chain.fields["left"]] = np.arange(chain.intervals) / chain.intervals
        everything[chain.fields["part"]] = 1 / chain.intervals
    unknowns, data = np.split(everything, [numbers.unknowns])
    return unknowns, data, 0.5 + 0.3 * rng.standard_normal(numbers.equations)


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
    inputs = [graph.unknowns, graph.data, factor, lam]
    own, slope = ca.Function("own", inputs, [upper, ca.gradient(lagrangian, graph.unknowns)])(
        unknowns, data, 0.7, multipliers
    )
    ours = graph.hessian(unknowns, data, 0.7, multipliers)
    assert ours.sparsity() == own.sparsity()
    assert largest(ours - own) <= ROUNDOFF * (1 + largest(own))
    ours, whole = graph.whole_hessian(unknowns, data, 0.7, multipliers)
    assert largest(ours - slope) <= ROUNDOFF * (1 + largest(slope))
    assert largest(whole - ca.triu2symm(own)) <= ROUNDOFF * (1 + largest(own))


@pytest.mark.parametrize(("degree", "intervals"), [(1, 9), (4, 20), *slow((7, 5))])
def test_derivatives_are_block_sparse(degree, intervals):
    graph = cg.transcribe(cart_pole(), cg.Galerkin(degree), intervals).graph
    nodes, d = degree + 1, 2
    path = (nodes * d) ** 2 + nodes * degree  # the control pushes the cart only
    tied = 2 * d + 2 * d  # x_{i+1} - X_m, and the momenta at both ends
    velocities = d + (d**2 + 1)  # p and ∂L/∂v(x, v), which the angle and both velocities enter
    assert graph.jacobian.nnz_out(1) == intervals * (path + tied) + 2 * (velocities + 1)
    # L is quadratic in the cart's velocity and ignores its position: no second derivative there
    pole, mixed = nodes * (nodes + 1) // 2, nodes**2
    ends = d + (1 + d)  # by an angle and the velocities; that of the last joint is in no interval
    assert graph.hessian.nnz_out(0) == intervals * (pole + mixed + degree) + ends
