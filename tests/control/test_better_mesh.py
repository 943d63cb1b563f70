"""The next mesh, from a path of two degrees."""

import numpy as np
from control_problems import double_integrator

import casadi_galerkin as cg
from casadi_galerkin.control.better_mesh import better_mesh
from casadi_galerkin.control.error_estimate import HigherDegree


def test_intervals_that_are_not_needed_are_merged_unless_the_mesh_is_to_be_finer():
    path, higher = (cg.solve(double_integrator(), cg.Galerkin(degree), 20) for degree in (5, 7))
    found = HigherDegree(path, higher)
    coarse, fine = (better_mesh(found, tol=1e-3, cost_tol=1e-3, finer=finer) for finer in (False, True))
    assert len(coarse) < 10
    np.testing.assert_allclose(fine, path.t, atol=1e-12)
