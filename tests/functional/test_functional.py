"""S, ∇S, ∇²S: the paper's equations written out, CasADi's own derivatives, the sparsity, the m = 1 functionals."""

from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from rules import lagrange

import casadi_galerkin as cg
from casadi_galerkin.functional.numbering import CACHE_SIZE

METHOD = cg.Galerkin(2)


def test_a_lagrangian_without_second_derivatives_is_refused():
    """Without a constraint, its mass matrix is refused before."""
    linear = cg.BoundaryProblem(
        lambda t, x, v: v[0] + v[1] - x[1], (0, 1), [1.0, 0.0], [0.0, 1.0], constraint=lambda t, x: ca.dot(x, x) - 1
    )
    with pytest.raises(ValueError, match="linear in x and v"):
        cg.solve(linear, METHOD, 6)


ROUNDOFF = 1e-12  # relative to the largest entry; entries of ∇²S reach m²/h ~ 1e3 and sum 1e2 terms
GRADED = np.array([0.0, 0.3, 0.4, 1.1, 1.5])


def one(t, x, v):
    return (1 + x[0] ** 2) * v[0] ** 2 / 2 - x[0] ** 4 / 4 + ca.sin(t) * x[0]


def two(t, x, v):
    return ca.dot(v, v) / 2 + v[0] * v[1] * ca.cos(x[0] - x[1]) / 2 + x[0] * v[1] - ca.exp(x[0] * t)


def three(t, x, v, p):
    return p[0] * ca.dot(v, v) / 2 + v[0] ** 4 / 12 + p[1] / ca.sqrt(1 + ca.dot(x, x)) + t * x[2] * v[1]


CASES = {
    "d = 1, time": (one, [0.1], [0.7], None, False),
    "d = 2, velocity-dependent": (two, [0.1, -0.4], [0.7, 0.2], None, False),
    "d = 3, parameters": (three, [0.1, -0.4, 0.3], [0.7, 0.2, 0.0], [2.0, 3.0], False),
    "natural ends": (two, [0.1, None], [None, 0.2], None, False),
    "all ends free": (one, [None], [None], None, False),
    "periodic": (two, [None, None], None, None, True),
    "periodic, a component fixed": (two, [None, 0.2], None, None, True),
}
METHODS = [
    cg.Galerkin(1, quadrature=cg.trapezoid()),
    cg.Galerkin(2),
    cg.Galerkin(3, control_points=[0.2, 0.7], quadrature=cg.radau(4)),
    cg.Galerkin(5, quadrature=cg.lobatto(6)),
]


def transcription(case, method, mesh=GRADED):
    lagrangian, start, end, parameters, periodic = CASES[case]
    problem = cg.BoundaryProblem(lagrangian, (mesh[0], mesh[-1]), start, end, parameters=parameters, periodic=periodic)
    return cg.transcribe(problem, method, mesh=mesh)


def data(problem, mesh, rng):
    """Inputs of the Functions besides the unknowns, in their order; the fixed ends as the problem has them."""
    ends = [[value for value in end if value is not None] for end in (problem.start, problem.end)]
    return [*ends, mesh] + ([] if problem.parameters is None else [problem.parameters])


def wanted_layout(problem, method, n):
    """Node values (N m + 1, d) as a function of the unknowns, by the documented order: time, then component."""
    d, last = problem.dimension, n * method.degree
    fixed = {(0, i): value for i, value in enumerate(problem.start) if value is not None}
    if not problem.periodic:
        fixed |= {(last, i): value for i, value in enumerate(problem.end) if value is not None}

    def nodes(unknowns):
        rest, values = iter(np.asarray(unknowns).ravel()), np.empty((last + 1, d))
        for k in range(last if problem.periodic else last + 1):
            for i in range(d):
                values[k, i] = fixed[k, i] if (k, i) in fixed else next(rest)
        if problem.periodic:
            values[last] = values[0]
        assert next(rest, None) is None
        return values

    free = [(k, i) for k in range(last if problem.periodic else last + 1) for i in range(d) if (k, i) not in fixed]
    return nodes, free


def written_out(problem, method, mesh, values):
    """Left-hand sides of (euler1) at every joint and (euler2) at every control point: ∂S/∂X̄, (N m + 1, d), and S."""
    d, m = problem.dimension, method.degree
    t, x, v = ca.SX.sym("t"), ca.SX.sym("x", d), ca.SX.sym("v", d)
    given = [] if problem.parameters is None else [list(problem.parameters)]
    value = problem.lagrangian(t, x, v, *given)
    parts = ca.Function("parts", [t, x, v], [value, ca.gradient(value, x), ca.gradient(value, v)])
    gradient, action = np.zeros_like(values), 0.0
    for i, h in enumerate(np.diff(mesh)):
        nodes = mesh[i] + h * np.concatenate(([0.0], method.control_points, [1.0]))
        local = values[i * m : i * m + m + 1]
        for q, w in zip(method.quadrature.points, method.quadrature.weights, strict=True):
            time = mesh[i] + h * q
            basis = [lagrange(nodes, j, time) for j in range(m + 1)]
            position = sum(basis[j][0] * local[j] for j in range(m + 1))
            velocity = sum(basis[j][1] * local[j] for j in range(m + 1))
            L, Lx, Lv = (np.array(part).ravel() for part in parts(time, position, velocity))
            action += h * w * L[0]
            for j in range(m + 1):  # j = m of interval i - 1 and j = 0 of interval i meet in the joint: (euler1)
                gradient[i * m + j] += h * w * (Lx * basis[j][0] + Lv * basis[j][1])
    return gradient, action


@pytest.fixture
def rng():
    return np.random.default_rng(11)


@pytest.mark.parametrize("method", METHODS, ids=str)
@pytest.mark.parametrize("case", list(CASES))
def test_gradient_is_the_papers_equations_written_out(case, method, rng):
    tr = transcription(case, method)
    nodes, free = wanted_layout(tr.problem, method, 4)
    unknowns = 0.5 * rng.normal(size=len(free))
    expected, action = written_out(tr.problem, method, GRADED, nodes(unknowns))
    if tr.problem.periodic:  # the last joint is the first: their equations are one
        expected[0] += expected[-1]
    given = data(tr.problem, GRADED, rng)
    got = np.array(tr.gradient(unknowns, *given)).ravel()
    wanted = np.array([expected[k, i] for k, i in free])
    np.testing.assert_allclose(got, wanted, rtol=ROUNDOFF, atol=ROUNDOFF * np.max(np.abs(wanted)))
    assert float(tr.action(unknowns, *given)) == pytest.approx(action, rel=ROUNDOFF)


@pytest.mark.parametrize("intervals", [1, 2, 3])
@pytest.mark.parametrize("case", list(CASES))
def test_derivatives_are_those_of_the_action(case, intervals, rng):
    """∇S and ∇²S against CasADi's differentiation of the whole graph of S; few intervals are the delicate ones."""
    method = METHODS[2]
    mesh = GRADED[: intervals + 1]
    tr = transcription(case, method, mesh)
    given = data(tr.problem, mesh, rng)
    x = ca.MX.sym("x", tr.action.size1_in(0))
    hessian, gradient = ca.hessian(tr.action(x, *given), x)
    unknowns = 0.5 * rng.normal(size=x.shape[0])
    for got, wanted in ((tr.gradient, gradient), (tr.hessian, hessian)):
        a, b = np.array(got(unknowns, *given)), np.array(ca.Function("f", [x], [wanted])(unknowns))
        np.testing.assert_allclose(a, b, rtol=ROUNDOFF, atol=ROUNDOFF * np.max(np.abs(b)))
    direction = rng.normal(size=len(unknowns))
    image = np.array(tr.functional.function("product")(unknowns, *given, direction)).ravel()
    np.testing.assert_allclose(image, a @ direction, rtol=ROUNDOFF, atol=ROUNDOFF * np.max(np.abs(a)))


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("intervals", [1, 2])
def test_periodic_paths_of_one_and_two_intervals(degree, intervals, rng):
    """Where first and last joint of one interval coincide, four cells of the Hessian fall on one."""
    mesh = np.linspace(0, 1, intervals + 1)
    tr = transcription("periodic", cg.Galerkin(degree), mesh)
    assert tr.gradient.size1_in(0) == 2 * intervals * degree
    x = ca.MX.sym("x", 2 * intervals * degree)
    hessian, gradient = ca.hessian(tr.action(x, [], [], mesh), x)
    both = ca.Function("both", [x], [hessian, gradient])
    unknowns = rng.normal(size=x.shape[0])
    wanted, slope = (np.array(a) for a in both(unknowns))
    size = np.max(np.abs(wanted)) + 1
    np.testing.assert_allclose(np.array(tr.hessian(unknowns, [], [], mesh)), wanted, rtol=0, atol=ROUNDOFF * size)
    np.testing.assert_allclose(np.array(tr.gradient(unknowns, [], [], mesh)), slope, rtol=0, atol=ROUNDOFF * size)


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_hessian_is_symmetric(method, rng):
    tr = transcription("d = 2, velocity-dependent", method)
    hessian = np.array(tr.hessian(rng.normal(size=tr.gradient.size1_in(0)), *data(tr.problem, GRADED, rng)))
    np.testing.assert_allclose(hessian, hessian.T, rtol=0, atol=1e-15 * np.max(np.abs(hessian)))


@pytest.mark.parametrize("degree", [1, 5])
@pytest.mark.parametrize("intervals", [2, 7])
@pytest.mark.parametrize("d", [1, 3])
@pytest.mark.parametrize("ends", ["fixed", "free", "periodic"])
def test_hessian_has_the_nonzeros_of_one_full_block_an_interval(degree, intervals, d, ends):
    """((m + 1)² N - (N - 1)) d² for free ends; fixed ones take away a row and a column each."""
    dense = lambda t, x, v: ca.sumsqr(v) * (1 + ca.sum1(x)) + ca.sum1(v) ** 2 * ca.cos(ca.sum1(x))  # noqa: E731
    end = [None] * d if ends != "fixed" else [0.0] * d
    problem = cg.BoundaryProblem(dense, (0, 1), end, None if ends == "periodic" else end, periodic=ends == "periodic")
    tr = cg.transcribe(problem, cg.Galerkin(degree), intervals)
    m, n = degree, intervals
    count = (m + 1) ** 2 * n - (n - 1)
    if ends == "fixed":
        count -= 2 * (2 * m + 1)  # the first and the last joint have m neighbors each
    elif ends == "periodic":
        count -= 1  # the diagonal of the joint that the ends share is counted twice
        if n == 2:
            count -= 2  # the joints of two intervals are coupled by both of them
    assert tr.hessian.nnz_out(0) == count * d**2


@pytest.mark.slow
def test_hessian_of_a_long_spring_chain_is_sparse_within_its_blocks():
    """50 masses: every cell couples a mass with its two neighbors, 3 d - 2 entries of d²."""
    d, n, m = 50, 3, 3

    def chain(t, x, v):
        return ca.sumsqr(v) / 2 - ca.sumsqr(x[1:] - x[:-1]) / 2 - ca.sum1(x**4) / 4

    tr = cg.transcribe(cg.BoundaryProblem(chain, (0, 1), [0.0] * d, [1.0] * d), cg.Galerkin(m), n)
    cells = (m + 1) ** 2 * n - (n - 1) - 2 * (2 * m + 1)
    assert tr.hessian.nnz_out(0) == cells * (3 * d - 2)
    path = tr.solve()
    assert path.morse_index == 0
    np.testing.assert_allclose(path.x, path.x[::-1], rtol=1e-12)  # the chain is the same from both of its ends


def test_hessian_is_banded_in_the_order_of_time():
    m, n, d = 4, 6, 2
    tr = cg.transcribe(cg.BoundaryProblem(two, (0, 1), [0, 0], [1, 1]), cg.Galerkin(m), n)
    rows, columns = tr.hessian.sparsity_out(0).get_triplet()
    assert np.max(np.abs(np.array(rows) - columns)) < (m + 1) * d


def papers_functional(rule, L):
    """The m = 1 functionals as the paper displays them."""
    x, h = [0.1, 0.9, -0.3, 0.4], 0.5
    total = 0.0
    for a, b in pairwise(x):
        slope = (b - a) / h
        if rule == "left":
            total += h * L(a, slope)
        elif rule == "trapezoid":
            total += h * (L(a, slope) + L(b, slope)) / 2
        else:
            total += h * L((a + b) / 2, slope)
    return x, h, total


RULES = {"left": cg.left_rectangle(), "trapezoid": cg.trapezoid(), "midpoint": cg.midpoint()}


def action_of_degree_one(rule, lagrangian):
    x, h, _ = papers_functional(rule, lambda x, v: 0.0)
    problem = cg.BoundaryProblem(lagrangian, (0, 3 * h), [x[0]], [x[-1]])
    tr = cg.transcribe(problem, cg.Galerkin(1, quadrature=RULES[rule]), 3)
    return float(tr.action(x[1:-1], [x[0]], [x[-1]], h * np.arange(4)))


@pytest.mark.parametrize("rule", list(RULES))
def test_functionals_of_degree_one_are_the_papers(rule):
    expected = papers_functional(rule, lambda x, v: v**2 / 2 + np.cos(x))[2]
    got = action_of_degree_one(rule, lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]))
    assert got == pytest.approx(expected, rel=1e-14)


def test_trapezoid_and_midpoint_are_told_apart_but_agree_where_the_lagrangian_is_affine_in_x():
    affine = lambda t, x, v: v[0] ** 2 * (1 + x[0]) / 2 - 3 * x[0]  # noqa: E731
    assert action_of_degree_one("trapezoid", affine) == pytest.approx(
        action_of_degree_one("midpoint", affine), rel=1e-14
    )
    curved = lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2  # noqa: E731
    assert abs(action_of_degree_one("trapezoid", curved) - action_of_degree_one("midpoint", curved)) > 0.1


def test_functions_name_their_inputs_and_outputs():
    tr = transcription("d = 3, parameters", METHODS[1])
    for name in ("action", "gradient", "hessian"):
        function = getattr(tr, name)
        assert function.name() == name
        assert function.name_in() == ["unknowns", "start", "end", "mesh", "parameters"]
        assert function.name_out() == [name]


def test_mesh_is_an_input_nothing_is_rebuilt():
    tr = transcription("d = 1, time", METHODS[2])
    other = np.linspace(0, 1.5, 5)
    again = transcription("d = 1, time", METHODS[2], other)
    unknowns = np.linspace(0, 1, tr.gradient.size1_in(0))
    a, b = (np.array(k.gradient(unknowns, [0.1], [0.7], other)) for k in (tr, again))
    np.testing.assert_array_equal(a, b)
    assert np.max(np.abs(a - np.array(tr.gradient(unknowns, [0.1], [0.7], GRADED)))) > 1e-2


def test_a_graph_outlives_the_cache_of_its_symbols():
    """A descent builds more graphs than are kept; Newton's method on an earlier one then met foreign symbols."""
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), (0, 1), [0.0], [1.0])
    early = cg.transcribe(problem, cg.Galerkin(2), 5)
    early.gradient  # noqa: B018  its symbols are made
    for intervals in range(6, 6 + 2 * CACHE_SIZE):
        cg.transcribe(problem, cg.Galerkin(2), intervals).gradient  # noqa: B018
    np.testing.assert_array_equal(early.solve().x, cg.transcribe(problem, cg.Galerkin(2), 5).solve().x)
