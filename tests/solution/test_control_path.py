"""Controls over time: polynomials within the intervals that jump at joints."""

import numpy as np
import pytest
from control_problems import minimum_time

import casadi_galerkin as cg
from casadi_galerkin.solution.control_path import ControlPath


def test_control_is_a_polynomial_of_its_points_and_jumps_at_joints():
    path = cg.solve(minimum_time(), cg.Galerkin(3), intervals=4)
    np.testing.assert_allclose(path.control(path.control.times), path.control.values, rtol=0, atol=1e-12)
    assert path.control(path.t[2])[0] == pytest.approx(-1, abs=1e-6)
    assert path.control(np.nextafter(path.t[2], 0))[0] == pytest.approx(1, abs=1e-6)
    assert path.control(np.zeros((2, 3))).shape == (1, 2, 3)
    with pytest.raises(ValueError, match="times must lie within"):
        path.control(3.0)


@pytest.mark.parametrize(("rule", "at_joint"), [(cg.lobatto(2), 5.0), (cg.radau(2), 1.0)])
def test_the_value_at_a_joint_is_the_later_one_unless_the_rule_has_only_the_earlier(rule, at_joint):
    points = np.array(rule.points)
    control = ControlPath(np.array([0.0, 1.0, 2.0]), points, np.array([[1.0, 1.0, 5.0, 5.0]]), points)
    assert control(1.0).tolist() == [at_joint]
