"""Which constraint an infeasible problem violates most."""

import pytest
from control_problems import double_integrator

import casadi_galerkin as cg


def test_infeasible_problem_names_the_worst_violated_constraint():
    with pytest.raises(cg.ConvergenceError, match=r"Infeasible.* equation of motion of x\[0\] at t = ") as caught:
        cg.solve(double_integrator(control_bounds=(-1, 1)), cg.Galerkin(3), intervals=10)
    assert caught.value.path.t[-1] == 1
    assert 0 < caught.value.iterations <= 500
