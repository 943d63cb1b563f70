import shutil

import casadi as ca
import numpy as np
import pytest

import casadi_galerkin as cg

compiler = pytest.mark.skipif(not (shutil.which("gcc") or shutil.which("cc")), reason="there is no C compiler")
ROUNDOFF = 1e-13  # compilers may contract products and sums


def problem(parameters=None):
    return cg.BoundaryProblem(
        lambda t, x, v, *p: ca.dot(v, v) / 2 + (p[0] if p else 1) / ca.norm_2(x),
        (0.0, 1.0),
        [1.0, 0.0],
        [0.5, 0.8],
        parameters=parameters,
    )


def swing(t, x, v):
    return v[0] ** 2 / 2 + ca.cos(x[0])


def pendulum(end, duration=8.0, lagrangian=swing):
    return cg.BoundaryProblem(lagrangian, (0.0, duration), [0.0], [end])


@compiler
@pytest.mark.parametrize("end", [1.0, 2.0, 3.0, 9.0])
def test_long_swings_take_the_same_damped_steps(end, monkeypatch):
    """Several steps are damped or given up, so the line search works with the factors of the right iterate."""
    from casadi_galerkin.system import System

    searched, search = [], System.search
    monkeypatch.setattr(System, "search", lambda *given: searched.append(given[-1]) or search(*given))
    paths, dampings = [], []
    for jit in (False, True):
        paths.append(cg.transcribe(pendulum(end), cg.Galerkin(4), 16, jit=jit).solve())
        dampings.append(np.array(searched))
        searched.clear()
    assert len(dampings[0]) > 0
    np.testing.assert_allclose(*dampings, rtol=1e-6)
    np.testing.assert_allclose(paths[1].path.values, paths[0].path.values, rtol=0, atol=100 * ROUNDOFF)
    assert paths[1].iterations == paths[0].iterations
    assert paths[1].morse_index == paths[0].morse_index


@compiler
def test_compiled_transcriptions_take_turns():
    """They share the arrays of their layout, but not their factors."""
    ends, problems = (0.4, 1.1), [pendulum(1.0, 2.0, each) for each in (swing, lambda t, x, v: v[0] ** 2 + x[0] ** 4)]
    fast, plain = ([cg.transcribe(each, cg.Galerkin(3), 10, jit=jit) for each in problems] for jit in (True, False))
    for end in ends:
        for ours, theirs in zip(fast, plain, strict=True):
            values = ours.solve(end=[end]).path.values
            np.testing.assert_allclose(values, theirs.solve(end=[end]).path.values, rtol=0, atol=100 * ROUNDOFF)


@compiler
def test_compiled_conjugate_points_are_found():
    oscillator = pendulum(0.0, np.pi, lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2)
    with pytest.raises(cg.ConjugatePointError):
        cg.transcribe(oscillator, cg.Galerkin(12), 8, jit=True).solve()


@compiler
def test_what_does_not_suit_the_compiled_iteration_is_compiled_at_the_points():
    orbit = cg.BoundaryProblem(
        lambda t, x, v: ca.dot(v, v) / 2 - ca.dot(x, x) + x[0] + x[1] * ca.sin(t),
        (0.0, 2 * np.pi),
        [None] * 2,
        periodic=True,
    )
    plain, fast = (cg.transcribe(orbit, cg.Galerkin(4), 9, jit=jit).solve() for jit in (False, True))
    np.testing.assert_allclose(fast.path.values, plain.path.values, rtol=0, atol=ROUNDOFF)


@compiler
def test_operations_that_c_does_not_know_are_not_compiled():
    odd = pendulum(1.0, 2.0, lambda t, x, v: v[0] ** 2 + ca.erfinv(x[0] / 20))
    plain, fast = (cg.transcribe(odd, cg.Galerkin(2), 6, jit=jit).solve() for jit in (False, True))
    np.testing.assert_array_equal(fast.path.values, plain.path.values)


@compiler
@pytest.mark.parametrize("parameters", [None, [1.3]])
def test_compiled_points_give_the_same_path(parameters):
    plain, fast = (cg.transcribe(problem(parameters), cg.Galerkin(4), 6, jit=jit).solve() for jit in (False, True))
    np.testing.assert_allclose(fast.path.values, plain.path.values, rtol=0, atol=ROUNDOFF)
    np.testing.assert_allclose(fast.momentum, plain.momentum, rtol=0, atol=ROUNDOFF)
    assert fast.iterations == plain.iterations


def test_jit_without_a_compiler_is_refused(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(ValueError, match="needs a C compiler"):
        cg.transcribe(problem(), cg.Galerkin(3), 5, jit=True)
