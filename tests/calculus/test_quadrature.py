"""Quadrature rules: exactness from both sides, nodes against mpmath, user-given rules, every error."""

import mpmath
import numpy as np
import pytest
from numpy.polynomial import legendre
from rules import FAMILIES, polynomial

import casadi_galerkin as cg

SIZES = [1, 2, 3, 4, 5, 7, 10, 20, 40, 60, 99, 100]
CASES = [(name, n) for name, (_, least, _) in FAMILIES.items() for n in SIZES if n >= least]
MOMENT = 2e-14  # roundoff of a sum of n products; measured 1e-14 (radau(60), whose end weights are the worst)
NODE = 2e-15  # ten units in the last place of numbers in [0, 1]; measured 3e-16
WEIGHT = 1e-11  # relative; a last-digit change of a point next to an end changes P² there by this, measured 8e-12


def moments(rule: cg.Quadrature, degree: int) -> np.ndarray:
    """Integrals of the shifted Legendre polynomials P_1 ... P_degree, all zero exactly."""
    return legendre.legvander(2 * np.array(rule.points) - 1, degree).T[1:] @ np.array(rule.weights)


@pytest.mark.parametrize(("name", "n"), CASES)
def test_rule_is_exact_below_its_order_and_not_at_it(name, n):
    build, _, last = FAMILIES[name]
    rule, order = build(n), 2 * n + last
    values = moments(rule, order)
    assert np.all(np.abs(values[: order - 1]) < MOMENT)
    assert abs(values[order - 1]) > 1e-3
    assert (rule.order, len(rule)) == (order, n)


@pytest.mark.parametrize(("name", "n"), CASES)
def test_rule_is_symmetric_or_ends_right_and_has_positive_weights(name, n):
    rule = FAMILIES[name][0](n)
    q, w = np.array(rule.points), np.array(rule.weights)
    assert np.all(w > 0)
    assert w.sum() == pytest.approx(1, abs=MOMENT)
    if name == "radau":
        assert q[-1] == 1
    else:
        np.testing.assert_allclose(q + q[::-1], 1, rtol=0, atol=NODE)
        np.testing.assert_allclose(w, w[::-1], rtol=1e-13)
    if name == "lobatto":
        assert (q[0], q[-1]) == (0, 1)


@pytest.mark.parametrize("n", [20, 60])
@pytest.mark.parametrize("name", list(FAMILIES))
def test_points_and_weights_agree_with_forty_digits(name, n):
    rule = FAMILIES[name][0](n)
    function, weight = polynomial(name, n)
    with mpmath.workdps(40):
        step = mpmath.mpf(10) ** -16
        for q, w in zip(rule.points, rule.weights, strict=True):
            if q in (0, 1):
                continue
            x = 2 * mpmath.mpf(q) - 1
            value, beside = function(x), function(x + step)
            root = x - value * step / (beside - value)  # one secant step from x, whose error is squared
            assert abs((1 + root) / 2 - mpmath.mpf(q)) < NODE
            assert abs(weight(root) / mpmath.mpf(w) - 1) < WEIGHT


def test_named_rules_are_members_of_the_families():
    assert cg.trapezoid() == cg.lobatto(2) == cg.Quadrature([0, 1], [0.5, 0.5])
    assert cg.midpoint() == cg.gauss(1) == cg.Quadrature([0.5], [1])
    assert cg.left_rectangle() == cg.Quadrature([0], [1])
    assert cg.radau(1) == cg.Quadrature([1], [1])
    assert [rule.order for rule in (cg.left_rectangle(), cg.radau(1), cg.midpoint(), cg.trapezoid())] == [1, 1, 2, 2]


def test_simpson_is_lobatto_of_three_points():
    simpson = cg.lobatto(3)
    np.testing.assert_allclose(simpson.points, [0, 0.5, 1], rtol=0, atol=NODE)
    np.testing.assert_allclose(simpson.weights, [1 / 6, 2 / 3, 1 / 6], rtol=NODE)


@pytest.mark.parametrize(
    ("points", "weights", "order"),
    [
        ([0.0, 0.25, 0.5, 0.75, 1.0], np.array([7, 32, 12, 32, 7]) / 90, 6),  # Boole
        ([0.0, 1 / 3, 2 / 3, 1.0], np.array([1, 3, 3, 1]) / 8, 4),  # three-eighths
        ([0.25, 0.5, 0.75], np.array([2, -1, 2]) / 3, 4),  # open Newton-Cotes, Milne: a negative weight
        ([0.1, 0.9], [0.5, 0.5], 2),
        ([0.3], [1.0], 1),
        ([0.21132486540519, 0.78867513459481], [0.5, 0.5], 4),  # Gauss from a table with 14 digits
    ],
)
def test_the_order_of_a_users_rule_is_found(points, weights, order):
    assert cg.Quadrature(points, weights).order == order


def test_points_of_weight_zero_are_dropped():
    """The paper's Q holds 0 and 1; a Gauss rule is then the one with weights 0 there."""
    inner = cg.gauss(3)
    padded = cg.Quadrature([0.0, *inner.points, 1.0], [0.0, *inner.weights, 0.0])
    assert padded == inner
    assert len(padded) == 3


def test_rules_are_values():
    rule = cg.gauss(4)
    same = cg.Quadrature(rule.points, rule.weights)  # gauss would return the very rule that it has kept
    assert same is not rule
    assert same == rule
    assert hash(same) == hash(rule)
    assert rule != cg.gauss(5)


@pytest.mark.parametrize(
    ("points", "weights", "message"),
    [
        ([0.5, 0.6], [1.0], r"as many numbers, at least one, got \(2,\) and \(1,\)"),
        ([], [], r"as many numbers, at least one, got \(0,\)"),
        ([[0.5]], [[1.0]], r"as many numbers, at least one, got \(1, 1\)"),
        (0.5, 1.0, r"as many numbers, at least one, got \(\)"),
        ([np.nan], [1.0], r"must increase within \[0, 1\], .* got \[nan\]"),
        ([0.5], [np.inf], "weights sum to 1, got .* a sum of inf"),
        ([0.6, 0.4], [0.5, 0.5], r"must increase within \[0, 1\], .* got \[0.6 0.4\]"),
        ([0.5, 0.5], [0.5, 0.5], "must increase within"),
        ([-0.1, 0.5], [0.5, 0.5], "must increase within"),
        ([0.5, 1.1], [0.5, 0.5], "must increase within"),
        ([0.2, 0.8], [0.5, 0.6], r"weights sum to 1, got .* a sum of 1\.1"),
        ([0.2, 0.8], [1.0, 1.0], r"got .* a sum of 2\.0"),
    ],
)
def test_a_rule_that_is_none_is_refused(points, weights, message):
    with pytest.raises(ValueError, match=message):
        cg.Quadrature(points, weights)


@pytest.mark.parametrize("values", ["ab", [1 + 1j], [None], [True], [[0.1], [0.2, 0.3]], object()])
def test_a_rule_not_made_of_numbers_is_refused(values):
    with pytest.raises(TypeError, match="points must be real numbers, got"):
        cg.Quadrature(values, [1.0])


@pytest.mark.parametrize(("name", "n"), [("gauss", 0), ("lobatto", 1), ("radau", 0), ("gauss", -3)])
def test_too_few_points_are_refused(name, n):
    with pytest.raises(ValueError, match=rf"the number of points of {name} must be at least \d, got {n}"):
        FAMILIES[name][0](n)


@pytest.mark.parametrize("n", [2.0, "2", None, True, np.float64(3), np.True_])
@pytest.mark.parametrize("name", list(FAMILIES))
def test_a_number_of_points_that_is_not_whole_is_refused(name, n):
    with pytest.raises(TypeError, match=f"the number of points of {name} must be a whole number, got"):
        FAMILIES[name][0](n)


@pytest.mark.parametrize("digits", [12, 13])
@pytest.mark.parametrize("size", [1, 2, 3, 5, 8])
def test_a_rule_from_a_table_is_of_the_order_of_the_rule(size, digits):
    rule = cg.gauss(size)
    weights = np.round(rule.weights, digits)
    weights[size // 2] += 1 - weights.sum()  # a table is refused whose weights do not sum to 1
    assert cg.Quadrature(np.round(rule.points, digits), weights).order == rule.order == 2 * size


@pytest.mark.parametrize("family", [cg.lobatto, cg.radau])
def test_points_are_real_where_numpy_gives_complex_roots(family, monkeypatch):
    real = legendre.legroots
    monkeypatch.setattr(legendre, "legroots", lambda series: real(series).astype(complex))  # as NumPy 2.5 does
    assert family.__wrapped__(5) == family(5)
