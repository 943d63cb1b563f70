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
