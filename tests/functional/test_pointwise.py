import casadi as ca
import numpy as np
import pytest

from casadi_galerkin.functional import pointwise

x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
INSIDE = ca.Function("inside", [x], [ca.sin(x[0]) * x[1]], {"never_inline": True})


def function(called=False):
    """Unary and binary operations, a branch, constants, zeros and what does not depend on the point."""
    values = ca.vertcat(ca.exp(-x[0]) * p, ca.if_else(x[1] > 0.5, ca.log(x[1]), ca.atan2(x[0], 2.0)))
    constant = ca.vertcat(0.0, 3.0, p**2, x[0])
    return ca.Function("f", [x, p], [values, constant, INSIDE(x) if called else x[0]], ["x", "p"], ["a", "b", "c"])


@pytest.mark.parametrize("called", [False, True])
@pytest.mark.parametrize("shared", [(), (1,)])
@pytest.mark.parametrize("count", [1, 3, 8, 13, 14])  # 13 points are three rows of four and one point
def test_rows_give_what_the_points_give(count, shared, called, monkeypatch):
    monkeypatch.setattr(pointwise, "POINTS_IN_A_ROW", 5)
    f, random = function(called), np.random.default_rng(count)
    at = random.uniform(size=(2, count)), np.array([[1.7]]) if shared else random.uniform(size=(1, count))
    rows, points = pointwise.by_rows(f, count, shared), pointwise.one_by_one(f, count, shared)
    assert rows.name_in() == ["x", "p"]
    assert rows.name_out() == ["a", "b", "c"]
    for row, point in zip(rows.call(at), points.call(at), strict=True):
        np.testing.assert_array_equal(np.array(row), np.array(point))


def test_rows_can_be_differentiated(monkeypatch):
    monkeypatch.setattr(pointwise, "POINTS_IN_A_ROW", 5)
    f, count, at = function(), 13, np.random.default_rng(1).uniform(size=(2, 13))
    jacobians = []
    for over in (pointwise.by_rows, pointwise.one_by_one):
        values, parameter = ca.MX.sym("x", 2, count), ca.MX.sym("p")
        jacobian = ca.jacobian(ca.sum2(over(f, count, (1,))(values, parameter)[0]), ca.veccat(values, parameter))
        jacobians.append(np.array(ca.Function("j", [values, parameter], [jacobian])(at, 1.7)))
    np.testing.assert_allclose(*jacobians, rtol=1e-15)
