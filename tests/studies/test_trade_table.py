"""The table of a trade: front, cheapest row, plot."""

from dataclasses import replace

import numpy as np
import pytest

import casadi_galerkin as cg
from casadi_galerkin.studies.trade_table import Row

SOLVER = cg.newton.with_options(max_iter=9, linear_solver="qr")


def row(seconds, error, **changes):
    return replace(Row(cg.Galerkin(2), 5, solve_seconds=seconds, error=error), **changes)


def test_front_holds_exactly_the_rows_no_other_beats():
    best, worse, fine, slow = row(1.0, 1e-3), row(2.0, 1e-2), row(3.0, 1e-6), row(4.0, 1e-6)
    failed = Row(cg.Galerkin(2), 5, failure="no path")
    assert cg.Trade((slow, failed, worse, fine, best), "given").front() == [best, fine]


def test_order_is_that_of_fixed_meshes_solved_at_once():
    rows = [row(1.0, 1.0 / count**3, intervals=count) for count in (4, 8, 16)]
    others = [row(1.0, 1.0, intervals=32, tol=1e-6, mesh=(0.0, 1.0)), row(1.0, 1.0, intervals=16, shooting=True)]
    assert cg.Trade((*rows, *others), "given").order(cg.Galerkin(2)) == pytest.approx(3, rel=1e-12)


def test_errors_within_the_floor_are_equal_on_the_front():
    fast, slow = row(1.0, 1e-6 + 1e-15), row(2.0, 1e-6)
    assert cg.Trade((fast, slow), "given").front() == [fast]
    finer = row(2.0, 1e-6 - 2e-14)
    assert cg.Trade((fast, finer), "given").front() == [fast, finer]
    assert cg.Trade((fast, finer), "solved", 1e-13).front() == [fast]


@pytest.mark.usefixtures("headless")
def test_a_quantity_that_is_named_has_a_column_and_the_axis():
    rows = (row(1.0, 1e-3, path_error=1e-5),)
    named, path = cg.Trade(rows, "given", quantity="reach"), cg.Trade(rows, "given")
    assert str(named).splitlines()[1].split()[-3:] == ["1.0e-05", "nan", "1.0e-03"]
    assert "error: of reach" in str(named)
    assert "1.0e-03" not in str(path)
    axes = named.plot()
    assert axes.get_ylabel() == "relative error of reach"


def test_cheapest_is_the_fastest_row_within_the_tolerance():
    rows = row(1.0, 1e-3), row(2.0, 1e-5), row(3.0, 1e-6)
    assert cg.Trade(rows, "given").cheapest(1e-4) is rows[1]
    assert cg.Trade(rows, "solved", 5e-6).cheapest(1e-5) is rows[2]  # the reference's own error counts


def test_cheapest_refuses_what_no_row_reaches():
    with pytest.raises(ValueError, match=r"at most 1e-09: the least is 1\.0e-03.* finer `reference`"):
        cg.Trade((row(1.0, 1e-3),), "given").cheapest(1e-9)


def test_table_holds_every_row_and_the_reference(measured):
    text = str(measured)
    assert len(text.splitlines()) == 3 + len(measured.rows)
    assert f"own error {measured.reference_error:.1e}" in text
    table = measured.to_dict()
    assert table["error"] == [row.error for row in measured.rows]
    assert table["degree"] == [row.method.degree for row in measured.rows]


@pytest.mark.parametrize("tol", [np.nan, "1e-3"])
def test_cheapest_refuses_what_is_no_number(tol):
    with pytest.raises(ValueError, match="tol must be a finite number, got"):
        cg.Trade((row(1.0, 1e-3),), "given").cheapest(tol)


@pytest.mark.parametrize(
    ("given", "way"),
    [
        ({}, "steps"),
        ({"solver": cg.newton}, "newton"),
        ({"solver": cg.ipopt.with_options(max_iter=50)}, "ipopt.with_options(max_iter=50)"),
        ({"shooting": True}, "shooting"),
        ({"solver": cg.newton, "tol": 1e-6}, "newton, tol 1e-06"),
        ({"solver": cg.newton, "tol": 1e-6, "mesh": (0.0, 1.0)}, "newton, mesh of 1e-06"),
    ],
)
def test_a_row_names_its_way(given, way):
    assert Row(cg.Galerkin(2), 5, **given).way == way


def test_a_row_says_in_one_line_what_it_is():
    row = Row(cg.Galerkin(2), 5, cg.newton, first_seconds=0.0025, solve_seconds=1e-4, error=1e-7)
    assert repr(row).startswith("Row of newton: degree 2,")
    assert repr(row).endswith("on 5 intervals: error 1.0e-07, 2.5 ms the first time, 0.1 ms again")
    assert repr(Row(solver=cg.newton, tol=1e-3, failure="no path")) == "Row of newton, tol 0.001: no path"


@pytest.mark.usefixtures("headless")
@pytest.mark.slow
def test_a_legend_names_what_is_drawn_and_nothing_else():
    rows = [
        row(1.0, 1e-3, solver=cg.newton),
        row(2.0, 1e-3, method=cg.Galerkin(4), solver=cg.newton),
        row(3.0, 1e-3, method=cg.Galerkin(4, quadrature=cg.lobatto(5)), shooting=True),
        row(4.0, 1e-9, solver=SOLVER, tol=1e-6),
        row(5.0, 1e-9, solver=SOLVER, tol=1e-6, mesh=(0.0, 1.0)),
        Row(cg.Galerkin(8), 5, cg.ipopt, failure="no path"),
    ]
    axes = cg.Trade(tuple(rows), "given").plot()
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == [
        *("the front", "rounding, or the reference's error", "degree 2, newton", "degree 4, newton"),
        *(
            "degree 4, shooting",
            f"to a tolerance, {SOLVER!r}".replace("cg.", ""),
            f"on its mesh, {SOLVER!r}".replace("cg.", ""),
        ),
    ]


@pytest.mark.usefixtures("headless")
def test_lines_of_one_name_are_all_drawn():
    """Rules of the same ends and order differ within."""
    rules = [cg.Quadrature([0.0, 0.5 - s, 0.5 + s, 1.0], [0.25, 0.25, 0.25, 0.25]) for s in (0.1, 0.2)]
    rows = tuple(row(1.0, 1e-3, method=cg.Galerkin(2, quadrature=rule)) for rule in rules)
    axes = cg.Trade(rows, "given").plot()
    assert len(axes.lines) == 1 + 2  # and the front


@pytest.mark.usefixtures("headless")
@pytest.mark.slow
def test_plot_shows_the_floor_on_logarithmic_axes_and_a_low_legend(measured):
    axes = measured.plot()
    axes.figure.draw_without_rendering()
    assert axes.get_legend().get_window_extent().height < axes.figure.bbox.height / 4
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert axes.get_ylabel() == "relative error of the path"
