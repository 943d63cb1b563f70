"""Which constraint an infeasible problem violates most."""

import casadi as ca
import numpy as np
import pytest
from control_problems import double_integrator

import casadi_galerkin as cg


def test_infeasible_problem_names_the_worst_violated_constraint():
    with pytest.raises(cg.ConvergenceError, match=r"Infeasible.* equation of motion of x\[0\] at t = ") as caught:
        cg.solve(double_integrator(control_bounds=(-1, 1)), cg.Galerkin(3), intervals=10)
    assert caught.value.path.t[-1] == 1
    assert 0 < caught.value.iterations <= 500


@pytest.mark.parametrize(("degree", "intervals"), [(3, 8), (4, 6)])
def test_a_constraint_is_measured_by_what_it_compares_whatever_its_bound(degree, intervals):
    """On the unit circle, stated with the bounds 1 and 0: the second was refused, violated by all of its terms."""

    def on_circle(level):
        return cg.solve(
            cg.ControlProblem(
                lambda t, x, v: ca.dot(v, v) / 2,
                (0, 1),
                [1.0, 0.0],
                [0.0, 1.0],
                [0.0, None],
                [None, 0.0],
                force=lambda t, x, v, u: u,
                running_cost=lambda t, x, v, u: ca.dot(u, u) / 2,
                controls=2,
                path_constraint=(lambda t, x, v, u: ca.dot(x, x) - 1 + level, level, level),
            ),
            cg.Galerkin(degree),
            intervals,
            guess=lambda t: [np.cos(np.pi * t / 2), np.sin(np.pi * t / 2)],
        )

    one, zero = on_circle(1.0), on_circle(0.0)
    np.testing.assert_allclose(zero.cost, one.cost, rtol=1e-10)
    assert max(one.violation, zero.violation) < 1e-12
