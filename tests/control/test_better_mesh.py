"""The next mesh, from a path of two degrees."""

from control_problems import double_integrator

import casadi_galerkin as cg
from casadi_galerkin.control.better_mesh import better_mesh
from casadi_galerkin.control.error_estimate import HigherDegree


def test_intervals_that_are_not_needed_are_merged():
    path, higher = (cg.solve(double_integrator(), cg.Galerkin(degree), 20) for degree in (5, 7))
    found = HigherDegree(path, higher)
    assert len(better_mesh(found, tol=1e-3, cost_tol=1e-3)) < 10
