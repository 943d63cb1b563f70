"""The method: its order, its control points and their warnings, what it refuses."""

import warnings

import casadi as ca
import numpy as np
import pytest
from scenes import oscillator_problem

import casadi_galerkin as cg

COMPOSITE = cg.Quadrature([0, 1 / 2, 1], [1 / 4, 1 / 2, 1 / 4])  # two trapezoids
NEGATIVE = cg.Quadrature([0.0, 0.1], [-4.0, 5.0])


@pytest.mark.parametrize("degree", range(2, 11))
def test_equispaced_control_points_up_to_ten_pass_without_a_word(degree):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cg.Galerkin(degree, control_points=cg.equispaced_points(degree))


@pytest.mark.parametrize("degree", [11, 12, 20])
def test_equispaced_control_points_above_ten_warn(degree):
    with pytest.warns(RuntimeWarning, match=rf"magnify roundoff .* lobatto_points\({degree}\)") as caught:
        cg.Galerkin(degree, control_points=cg.equispaced_points(degree))
    assert caught[0].filename == __file__  # the caller's line


@pytest.mark.parametrize("points", [cg.lobatto_points, cg.chebyshev_points])
def test_the_other_families_do_not_warn_at_degree_one_hundred(points):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cg.Galerkin(100, control_points=points(100))


@pytest.mark.parametrize(
    ("method", "order"),
    [
        (cg.Galerkin(3), 6),
        (cg.Galerkin(3, quadrature=cg.gauss(4)), 6),
        (cg.Galerkin(3, quadrature=cg.lobatto(3)), 4),
        (cg.Galerkin(3, quadrature=cg.radau(3)), 5),
        (cg.Galerkin(1, quadrature=cg.left_rectangle()), 1),
    ],
)
def test_order_is_the_smaller_of_twice_the_degree_and_the_rules(method, order):
    assert method.order == order
    assert str(order if len(method.quadrature) == method.degree else 8) in str(method)


@pytest.mark.parametrize(
    ("method", "words"),
    [
        (cg.Galerkin(4), "degree 4, 4 quadrature points of order 8"),
        (cg.Galerkin(1), "degree 1, 1 quadrature point of order 2"),
        (cg.Galerkin(2, [0.4]), "degree 2, control points of its own, 2 quadrature points of order 4"),
        (cg.Galerkin(1, quadrature=cg.radau(1)), "degree 1, 1 quadrature point of order 1"),
        (cg.Galerkin(2, quadrature=cg.lobatto(3)), "degree 2, 3 quadrature points of order 4"),
    ],
)
def test_a_method_says_what_is_unusual_about_it(method, words):
    assert str(method) == words


def test_methods_are_values():
    assert cg.Galerkin(3) == cg.Galerkin(3, control_points=cg.lobatto_points(3), quadrature=cg.gauss(3))
    assert hash(cg.Galerkin(3)) == hash(cg.Galerkin(3, quadrature=cg.gauss(3)))
    assert cg.Galerkin(3) != cg.Galerkin(3, quadrature=cg.gauss(4))


@pytest.mark.parametrize(
    ("arguments", "kind", "message"),
    [
        ({"degree": 0}, ValueError, "degree must be at least 1, got 0"),
        ({"degree": -2}, ValueError, "degree must be at least 1, got -2"),
        ({"degree": 2.0}, TypeError, "degree must be a whole number, got 2.0"),
        ({"degree": True}, TypeError, "degree must be a whole number, got True"),
        ({"degree": "4"}, TypeError, "degree must be a whole number, got '4'"),
        ({"degree": 3, "control_points": [0.5]}, ValueError, r"degree 3 takes 2 control points, got .* \(1,\)"),
        ({"degree": 3, "control_points": [0.0, 0.5]}, ValueError, r"increase within \]0, 1\[, got \[0.  0.5\]"),
        ({"degree": 3, "control_points": [0.5, 1.0]}, ValueError, r"must increase within \]0, 1\["),
        ({"degree": 3, "control_points": [0.7, 0.3]}, ValueError, r"must increase within \]0, 1\["),
        ({"degree": 3, "control_points": [0.5, 0.5]}, ValueError, r"must increase within \]0, 1\["),
        ({"degree": 3, "control_points": [0.5, np.nan]}, ValueError, r"must increase within \]0, 1\["),
        ({"degree": 3, "control_points": "ab"}, TypeError, "control points must be real numbers, got 'ab'"),
        ({"degree": 3, "control_points": [[0.2, 0.5]]}, ValueError, r"takes 2 control points, got .* \(1, 2\)"),
        ({"degree": 3, "control_points": [0.2, 0.5j]}, TypeError, "control points must be real numbers"),
        ({"degree": 3, "quadrature": 4}, TypeError, "quadrature must be a Quadrature such as gauss.3., got 4"),
        ({"degree": 3, "quadrature": cg.gauss}, TypeError, "quadrature must be a Quadrature"),
        (
            {"degree": 3, "quadrature": cg.gauss(2)},
            ValueError,
            "degree 3 needs at least 3 quadrature points and .*, got 2",
        ),
        (
            {"degree": 3, "quadrature": COMPOSITE},
            ValueError,
            "degree 3 needs at least .* and order 3, got .* and order 2",
        ),
        (
            {"degree": 2, "quadrature": NEGATIVE},
            ValueError,
            "squares of polynomials of degree 1 positive, got one of -0.8",
        ),
    ],
)
def test_a_method_that_does_not_fit_is_refused(arguments, kind, message):
    with pytest.raises(kind, match=message):
        cg.Galerkin(**arguments)


def with_rule(degree, rule):
    """A method with its check passed by."""
    method = cg.Galerkin(degree)
    object.__setattr__(method, "quadrature", rule)
    return method


def test_with_an_order_below_the_degree_uniform_motion_would_be_no_solution():
    """Why it is refused: the error stays, however many intervals there are."""
    free = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0])
    for intervals in (1, 10, 100):
        path = cg.solve(free, with_rule(3, COMPOSITE), intervals)
        assert np.max(np.abs(path.momentum - 1)) > 0.01


def test_weights_that_are_too_negative_would_make_minima_saddles():
    """Why they are refused: the path of a free particle is a minimum, and has no negative eigenvalue."""
    free = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0])
    for n in (2, 4):
        tr = cg.transcribe(free, with_rule(2, NEGATIVE), n)
        hessian = np.array(ca.DM(tr.hessian(np.zeros(2 * n - 1), 0.0, 1.0, tr.mesh)))
        assert np.count_nonzero(np.linalg.eigvalsh(hessian) < 0) == n
        assert tr.solve().morse_index == 0  # that of the action itself, which has no such weights
    mild = cg.Quadrature([0.3, 0.5, 0.6], [25 / 18, -57 / 18, 50 / 18])
    assert cg.solve(free, cg.Galerkin(2, quadrature=mild), 4).morse_index == 0


def test_fewer_points_than_the_degree_would_be_silently_wrong():
    """Why they are refused: with the check passed by, the equations have a solution far from the path."""
    tr = cg.transcribe(oscillator_problem(), with_rule(3, cg.gauss(2)), 4)
    hessian = np.array(ca.DM(tr.hessian(np.zeros(tr.gradient.size1_in(0)), [0.0], [1.0], tr.mesh)))
    assert np.count_nonzero(np.linalg.eigvalsh(hessian) < 0) == 4  # one spurious direction an interval
