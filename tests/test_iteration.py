"""The compiled iteration against the stages, the graph and NumPy."""

import shutil
from functools import lru_cache

import casadi as ca
import numpy as np
import pytest

import casadi_galerkin as cg
from casadi_galerkin.functional import pointwise
from casadi_galerkin.iteration import CompiledIteration, suits
from casadi_galerkin.stages import Call
from casadi_galerkin.system import joined

compiler = pytest.mark.skipif(not (shutil.which("gcc") or shutil.which("cc")), reason="there is no C compiler")
EPS = np.finfo(float).eps
FLOORS = 3.0  # difference of two gradients over the roundoff floor of one; measured 0.4 at most
# Defect of a solution over |H||y| + |b|, in the largest norm.  Without pivoting roundoff grows where H is indefinite:
# measured 1.6 eps with given ends, 26 with free ones, where CasADi's LDL has 5.
BACKWARD = 100 * EPS
FORWARD = 20 * EPS  # difference of two solutions over the condition of H; measured 2.8 eps at most
MISSED = 1e-3  # part of a right-hand side that a solution may miss


def one(t, x, v):
    return (1 + x[0] ** 2) * v[0] ** 2 / 2 + ca.sin(t) * ca.cos(x[0])


def two(t, x, v, p):
    return p[0] * ca.dot(v, v) / 2 + p[1] / ca.norm_2(x) + t * x[0] * v[1]


def three(t, x, v):
    """Uses operations of all kinds."""
    smooth = ca.tanh(x[0]) * ca.exp(-x[1]) + ca.atan2(x[1], 3 + x[2]) + ca.log(3 + x[2]) * ca.sqrt(2 + t) + x[0] ** 3
    kinked = ca.if_else(x[0] < 0.3, x[0] ** 2, 1 / (1 + x[0])) + ca.fmax(x[1], 0.2) ** 2 + ca.fabs(x[2]) ** 2.5
    return v[0] ** 2 + ca.dot(v, v) / 2 + v[0] * v[1] * ca.cos(x[0] - x[2]) / 3 + v[2] * x[0] + smooth + kinked


def six(t, x, v):
    stretch = x - ca.vertcat(0, x[:-1])
    return ca.dot(v, v) / 2 - ca.sum1(stretch**2 / 2 + stretch**4 / 4)


LAGRANGIANS = {1: one, 2: two, 3: three, 6: six}
PARAMETERS = [1.3, 0.8]
METHODS = [
    *((1, m, cg.gauss(m)) for m in (1, 2, 8)),
    (1, 3, cg.lobatto(4)),
    (2, 1, cg.trapezoid()),
    (2, 4, cg.gauss(4)),
    (2, 5, cg.lobatto(6)),
    (3, 2, cg.lobatto(3)),
    (3, 6, cg.gauss(6)),
    (6, 2, cg.gauss(2)),
    (6, 7, cg.gauss(8)),
]
INTERVALS = [1, 3, 8, 11]  # 8 or 4 go through the kernel at once


@lru_cache(len(LAGRANGIANS))
def integrand(d):
    """One Function for all tests, so that it is compiled once for each method."""
    t, x, v = ca.SX.sym("t"), ca.SX.sym("x", d), ca.SX.sym("v", d)
    arguments = [t, x, v, *([ca.SX.sym("p", len(PARAMETERS))] if d == 2 else [])]
    return ca.Function("lagrangian", arguments, [LAGRANGIANS[d](*arguments)])


def transcription(d, method, intervals, ends="fixed"):
    start, end = np.linspace(0.3, 1.0, d).tolist(), np.linspace(1.2, 0.4, d).tolist()
    if ends == "mixed" and d > 1:
        start[0] = end[-1] = None
    elif ends == "mixed":
        end[0] = None
    elif ends == "free":
        start = end = [None] * d
    parameters = PARAMETERS if d == 2 else None
    problem = cg.BoundaryProblem(LAGRANGIANS[d], (0.5, 1.5), start, end, parameters)
    joints = np.cumsum(np.random.default_rng(intervals).uniform(1, 2, intervals + 1))
    mesh = 0.5 + (joints - joints[0]) / (joints[-1] - joints[0])
    mesh[-1] = 1.5
    return cg.transcribe(problem, method, mesh=mesh)


def away(tr, seed=5):
    """Unknowns away from any path, data, the Hessian there."""
    rng, data = np.random.default_rng(seed), tr.data(tr.mesh)
    nodes = np.linspace(0.3, 1.1, tr.layout.intervals * tr.method.degree + 1)[:, None]
    unknowns = tr.unknowns(nodes + 0.05 * rng.standard_normal((len(nodes), tr.layout.dimension)))
    return unknowns, data, np.array(tr.hessian(unknowns, *data))


def put(iteration, unknowns, data):
    arrays = iteration.arrays
    arrays["u"][:], arrays["mesh"][:], arrays["p"][:] = joined(unknowns, data), data[2], [*data[3:], ()][0]
    arrays["probe"][:] = np.cos(1.0 + np.arange(len(unknowns)))


def assert_solves(hessian, solution, rhs, expected):
    largest = [np.max(np.abs(a), initial=0.0) for a in (solution, rhs)]
    defect = np.max(np.abs(hessian @ solution + rhs), initial=0.0)
    assert defect <= BACKWARD * (np.max(np.abs(hessian).sum(axis=1), initial=0.0) * largest[0] + largest[1])
    condition = np.linalg.cond(hessian) if hessian.size else 1.0
    np.testing.assert_allclose(solution, expected, rtol=0, atol=FORWARD * condition * largest[0])


def assert_agrees(tr, iteration):
    unknowns, data, hessian = away(tr)
    put(iteration, unknowns, data)
    iteration.run()
    arrays = iteration.arrays
    step = tr.system.iterate(unknowns, data).step
    gradient = tr.system.algebra.gradient.copy()
    (soft,) = tr.system.solve(arrays["probe"])
    floor = tr.system.evaluate("judged", unknowns, data)[-1]
    assert np.max(np.abs(arrays["gradient"] - gradient) / floor, initial=0.0) <= FLOORS
    assert_solves(hessian, arrays["step"], gradient, step)
    assert_solves(hessian, arrays["soft"], arrays["probe"], soft)
    assert arrays["excess"][0] <= 0
    rhs = arrays["rhs"][:] = np.sin(3.0 * np.arange(len(unknowns)))
    iteration.resolve()
    assert_solves(hessian, arrays["solution"], rhs, tr.system.solve(rhs)[0])
    assert arrays["excess"][0] <= 0


@compiler
@pytest.mark.parametrize("intervals", INTERVALS)
@pytest.mark.parametrize("ends", ["fixed", "mixed", "free"])
@pytest.mark.parametrize(("d", "m", "rule"), METHODS, ids=str)
def test_gradient_step_and_solutions_are_those_of_the_stages(d, m, rule, ends, intervals, kept):
    tr = transcription(d, cg.Galerkin(m, quadrature=rule), intervals, ends)
    assert_agrees(tr, kept(d, tr))


@pytest.fixture
def kept():
    return lambda d, tr: CompiledIteration(pointwise(integrand(d)), tr.layout)


@compiler
def test_excess_is_the_defect_of_whatever_the_factors_gave(kept):
    tr = transcription(2, cg.Galerkin(4), 11, "mixed")
    iteration, (unknowns, data, hessian) = kept(2, tr), away(tr)
    put(iteration, unknowns, data)
    iteration.run()
    rhs = iteration.arrays["rhs"][:] = 1.0 + np.arange(len(unknowns)) % 3
    for name in ("joints", "factors"):
        iteration._kept[name] *= 1.1
        iteration.resolve()
        defect = np.abs(hessian @ iteration.arrays["solution"] + rhs).sum()
        assert defect > 1e-2 * rhs.sum()
        assert iteration.arrays["excess"][0] == pytest.approx(defect - MISSED * rhs.sum(), rel=1e-9)


def of_lagrangian(lagrangian, d, method, intervals, length, free=False):
    ends = [None] * d if free else [0.3] * d, [None] * d if free else [0.9] * d
    tr = cg.transcribe(cg.BoundaryProblem(lagrangian, (0.0, length), *ends), method, intervals)
    iteration = CompiledIteration(tr.functional.pointwise, tr.layout)
    return tr, iteration


@compiler
def test_an_indefinite_hessian_is_solved_with():
    tr, iteration = of_lagrangian(lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), 1, cg.Galerkin(4), 60, 40.0)
    assert np.count_nonzero(np.linalg.eigvalsh(away(tr)[2]) < 0) > 5
    assert_agrees(tr, iteration)


@compiler
@pytest.mark.parametrize("intervals", [1, 13])
def test_no_step_with_a_singular_hessian_is_called_right(intervals):
    """A free path under a constant force: moving all of it changes nothing but the action."""
    lagrangian = lambda t, x, v: v[0] ** 2 / 2 - x[0]  # noqa: E731
    tr, iteration = of_lagrangian(lagrangian, 1, cg.Galerkin(3), intervals, 2.0, free=True)
    unknowns, data, _ = away(tr)
    put(iteration, unknowns, data)
    iteration.run()
    assert not iteration.arrays["excess"][0] <= 0
    iteration.arrays["rhs"][:] = 1.0
    iteration.resolve()
    assert not iteration.arrays["excess"][0] <= 0


@compiler
def test_a_factorisation_that_needs_pivots_is_found_out():
    lagrangian = lambda t, x, v: v[0] * v[1] + 1e-18 * ca.dot(v, v) + x[0] * x[1] / 2  # noqa: E731
    tr, iteration = of_lagrangian(lagrangian, 2, cg.Galerkin(3), 9, 2.0)
    unknowns, data, hessian = away(tr)
    assert np.linalg.cond(hessian) < 1e6
    put(iteration, unknowns, data)
    iteration.run()
    assert not iteration.arrays["excess"][0] <= 0


@compiler
def test_a_gradient_that_is_not_a_number_is_found_out():
    tr, iteration = of_lagrangian(lambda t, x, v: v[0] ** 2 / 2 + ca.sqrt(x[0]), 1, cg.Galerkin(2), 20, 1.0)
    unknowns, data, _ = away(tr)
    unknowns[17] = -5.0
    put(iteration, unknowns, data)
    iteration.run()
    assert np.isnan(iteration.arrays["excess"][0])


@compiler
def test_rounding_does_not_grow_with_many_intervals():
    """A step from a path that is right to the last digits is of their size, at 2e4 intervals as at 20."""
    steps = []
    for intervals in (20, 20_000):
        tr = cg.transcribe(cg.BoundaryProblem(LAGRANGIANS[1], (0.5, 1.5), [0.3], [1.2]), cg.Galerkin(2), intervals)
        point = tr.critical_point()
        iteration = CompiledIteration(pointwise(integrand(1)), tr.layout)
        put(iteration, point.solution.unknowns, point.data)
        iteration.run()
        assert iteration.arrays["excess"][0] <= 0
        floor = tr.system.evaluate("judged", point.solution.unknowns, point.data)[-1]
        assert np.max(np.abs(iteration.arrays["gradient"]) / floor) <= FLOORS
        steps.append(np.max(np.abs(iteration.arrays["step"])))
    assert max(steps) < 1e-14


@compiler
def test_arrays_are_bound_not_copied(kept):
    tr = transcription(1, cg.Galerkin(2), 5)
    own = {"u": np.full(tr.layout.size, 0.4), "gradient": np.zeros(tr.layout.free)}
    iteration = CompiledIteration(pointwise(integrand(1)), tr.layout, own)
    iteration.arrays["mesh"][:] = tr.mesh
    iteration.run()
    expected = np.array(tr.gradient(own["u"][: tr.layout.free], [0.4], [0.4], tr.mesh)).ravel()
    np.testing.assert_allclose(own["gradient"], expected, rtol=0, atol=1e-14)
    with pytest.raises(ValueError, match=r"u must be 11 contiguous doubles, got float64 of \(3,\)"):
        CompiledIteration(pointwise(integrand(1)), tr.layout, {"u": np.zeros(3)})


def test_what_cannot_be_compiled_is_refused():
    closed = cg.BoundaryProblem(one, (0.0, 1.0), [None], periodic=True)
    crossed = cg.BoundaryProblem(lambda t, x, v: v[0] * v[1], (0.0, 1.0), [0.0, 0.0], [1.0, 1.0])
    for problem in (closed, crossed):
        tr = cg.transcribe(problem, cg.Galerkin(2), 4)
        assert not suits(tr.functional.pointwise, tr.layout)
        with pytest.raises(ValueError, match="needs ends that are not joined"):
            CompiledIteration(tr.functional.pointwise, tr.layout)


@pytest.mark.parametrize(("masses", "intervals", "expected"), [(6, 4, True), (6, 3, False), (30, 4, False)])
def test_few_intervals_and_wide_sparse_lagrangians_are_left_to_the_stages(masses, intervals, expected):
    chain = cg.BoundaryProblem(six, (0.0, 1.0), [0.0] * masses, [1.0] * masses)
    tr = cg.transcribe(chain, cg.Galerkin(2), intervals)
    assert suits(tr.functional.pointwise, tr.layout) is expected


def test_a_missing_compiler_is_reported(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda _: None)
    tr = cg.transcribe(cg.BoundaryProblem(one, (0.0, 1.0), [0.0], [1.0]), cg.Galerkin(2), 4)
    with pytest.raises(ValueError, match="needs a C compiler"):
        CompiledIteration(tr.functional.pointwise, tr.layout)


@compiler
def test_a_compiled_iterate_that_fails_is_repeated_with_its_own_hessian():
    """It leaves no Hessian behind: what is in the memory of all problems of the layout is that of another one."""

    def oscillator(rate, jit):
        problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - rate * x[0] ** 2 / 2, (0.0, 1.0), [0.0], [1.0])
        return cg.transcribe(problem, cg.Galerkin(3), 8, jit=jit)

    tr, other = oscillator(1.0, True), oscillator(5.0, False)
    arrays, iterate, runs = tr.system.algebra.workspace.arrays, tr.system.compiled["iterate"], []

    def fails_the_second_time():
        iterate.run()
        runs.append(arrays["excess"].item())
        if len(runs) == 2:
            arrays["excess"][:] = 1.0

    tr.system.compiled = {**tr.system.compiled, "iterate": Call(fails_the_second_time, iterate.inputs)}
    data, unknowns = tr.data(tr.mesh), np.zeros(tr.layout.free)
    tr.system.iterate(unknowns, data)
    other.solve()
    step = tr.system.iterate(unknowns, data, again=True).step
    assert len(runs) == 2
    gradient, hessian = (np.array(f(unknowns, *data)) for f in (tr.gradient, tr.hessian))
    np.testing.assert_allclose(step, -np.linalg.solve(hessian, gradient).ravel(), rtol=0, atol=1e-13)
