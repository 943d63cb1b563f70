"""Numbers of every kind are read alike, by position; what is none is named."""

from collections import UserDict
from decimal import Decimal

import casadi as ca
import numpy as np
import pytest
from given import Arraylike, Quantity, Series

from casadi_galerkin.calculus.numbers import components, number, numbers, real_array, spanned, times_inside, whole


@pytest.mark.parametrize(
    "given",
    [
        [1.0, 2.0],
        (1, 2.0),
        [np.float32(1), np.array(2)],
        [Decimal(1), Quantity(2.0)],
        [ca.DM(1), 2.0],
        np.array([1, 2], dtype=np.uint8),
        np.array([1, 2.0], dtype=object),
        np.ma.array([1, 2], mask=[0, 0]),
        ca.DM([1, 2]),
        Series({1: 1.0, 0: 2.0}),
        Arraylike({1: 1.0, 0: 2.0}),
    ],
    ids=lambda given: f"{type(given).__name__} of {type(given[0]).__name__}",
)
def test_numbers_are_read_by_their_position(given):
    assert numbers("x", given) == (1.0, 2.0)
    read = real_array("x", given)
    assert read.dtype == float
    np.testing.assert_array_equal(read, [1, 2])


@pytest.mark.parametrize("given", [np.zeros(2), [0.0, 0.0], ca.DM([0, 0])])
def test_an_array_read_is_a_copy(given):
    real_array("x", given)[0] = 1.0
    assert given[0] == 0


@pytest.mark.parametrize(
    ("given", "got"),
    [
        ([1.0, True], r"True at \[1\]"),
        ([[1.0], [np.True_]], r"True_? at \[1, 0\]"),
        ([1.0, 1j], r"1j at \[1\]"),
        (np.array([1.0, 1j]), r"\(1\+0j\) at \[0\]"),
        ([1.0, "2"], r"'2' at \[1\]"),
        ([1.0, None], r"None at \[1\]"),
        (np.array([1.0, None]), r"None at \[1\]"),
        ([1.0, Quantity(2.0, "meter")], r"2.0 meter at \[1\]"),
        ([1.0, ca.SX.sym("a")], r"SX\(a\) at \[1\]"),
        ([1.0, ca.MX.sym("a")], r"MX\(a\) at \[1\]"),
        ([[1.0], [1.0, 2.0]], r"\[1.0\] at \[0\]"),
        (np.array([3, 4], "m8[s]"), r"timedelta64\(3,'s'\) at \[0\]"),
        (ca.SX.sym("a", 2), r"SX\("),
        (ca.MX.sym("a", 2), r"MX\("),
        ({1.0, 2.0}, "{1.0, 2.0}"),
        ({0: 1.0}, "{0: 1.0}"),
        (UserDict({0: 1.0}), "{0: 1.0}"),
        ((x for x in (1.0, 2.0)), "<generator"),
        ("12", "'12'"),
        (None, "None"),
        (True, "True"),
        (1j, "1j"),
        (ca.DM, "<class"),
    ],
)
def test_what_is_no_number_is_named_with_its_place(given, got):
    with pytest.raises(TypeError, match=f"^x must be real numbers, got .*{got}"):
        real_array("x", given)


@pytest.mark.parametrize(
    ("given", "place"),
    [
        (np.ma.array([1.0, 2.0], mask=[0, 1]), r"\[1\]"),
        (np.ma.array([[1, 2], [3, 4]], mask=[[0, 0], [1, 0]]), r"\[1, 0\]"),
        ([1.0, np.ma.masked], r"\[1\]"),
        ([np.ma.array([1.0, 2.0], mask=[0, 1])], r"\[0, 1\]"),
        (np.ma.masked, "$"),
    ],
)
def test_a_masked_value_is_refused_with_its_place(given, place):
    with pytest.raises(ValueError, match=f"x must have no masked values, got one.*{place}"):
        real_array("x", given)


def test_none_stands_for_a_free_component_only():
    assert components("x", [None, 1]) == components("x", np.array([None, 1])) == (None, 1.0)
    with pytest.raises(ValueError, match=r"x must be all numbers, got \[None, 1\]"):
        numbers("x", [None, 1])
    with pytest.raises(TypeError, match=r"x\[1\] must be a number, got True"):
        components("x", [None, True])


@pytest.mark.parametrize("sign", [1, -1])
def test_an_integer_beyond_all_floats_is_infinite(sign):
    assert number(sign * 10**400) == sign * np.inf
    with pytest.raises(ValueError, match=r"x\[0\] must be finite, got -?inf"):
        components("x", [sign * 10**400])


@pytest.mark.parametrize(
    "value", [2, 2.0, np.float32(2), np.int8(2), np.array(2.0), Decimal(2), Quantity(2.0), ca.DM(2)]
)
def test_a_single_number_of_any_kind_is_read(value):
    assert number(value) == 2.0


@pytest.mark.parametrize(
    "value", [True, np.True_, 2j, np.complex64(2), "2", None, [2.0], np.array([2.0]), ca.SX.sym("a")]
)
def test_what_is_no_single_number_is_none(value):
    assert number(value) is None


def test_whole_numbers_are_told_from_others():
    assert [whole(value) for value in (4, np.int8(4), np.array(4))] == [4, 4, 4]
    assert {whole(value) for value in (4.0, np.float64(4), True, np.True_, "4", None)} == {None}
    assert whole([4]) is None


def test_times_inside_of_a_span_increase():
    assert times_inside("breakpoints", [], (0.0, 1.0)) == ()
    assert times_inside("breakpoints", np.array([0.25, 0.5]), (0.0, 1.0)) == (0.25, 0.5)
    for times in ([0.0], [0.5, 0.5], [0.5, 0.25], [1.0]):
        with pytest.raises(ValueError, match=r"breakpoints must increase inside of \(0.0, 1.0\)"):
            times_inside("breakpoints", times, (0.0, 1.0))


@pytest.mark.parametrize(
    ("times", "words"),
    [
        ((0.0, 10.0), "[0, 10]"),
        ((-1 / 3, 1 / 3), "[-0.333333, 0.333333]"),
        ((2460000.5, 2460100.5), "[2460000.5, 2460100.5]"),
        ((1e9, 1e9 + 1e-3), "[1000000000, 1000000000.001]"),
    ],
)
def test_a_time_span_is_told_with_as_many_digits_as_it_takes(times, words):
    assert spanned(np.array(times)) == words
