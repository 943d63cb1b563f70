"""The table of a trade: front, cheapest row, CSV, plot."""

import csv
from dataclasses import replace

import pytest

import casadi_galerkin as cg
from casadi_galerkin.studies.trade_table import Row


def row(seconds, error, **changes):
    return replace(Row(cg.Galerkin(2), 5, solve_seconds=seconds, error=error), **changes)


def test_front_holds_exactly_the_rows_no_other_beats():
    best, worse, fine, slow = row(1.0, 1e-3), row(2.0, 1e-2), row(3.0, 1e-6), row(4.0, 1e-6)
    failed = Row(cg.Galerkin(2), 5, failure="no path")
    assert cg.Trade((slow, failed, worse, fine, best), "given", 0.0).front() == [best, fine]


def test_cheapest_is_the_fastest_row_within_the_tolerance():
    rows = row(1.0, 1e-3), row(2.0, 1e-5), row(3.0, 1e-6)
    assert cg.Trade(rows, "given", 0.0).cheapest(1e-4) is rows[1]
    assert cg.Trade(rows, "solved", 5e-6).cheapest(1e-5) is rows[2]  # the reference's own error counts


def test_cheapest_refuses_what_no_row_reaches():
    with pytest.raises(ValueError, match=r"at most 1e-09: the least is 1\.0e-03"):
        cg.Trade((row(1.0, 1e-3),), "given", 0.0).cheapest(1e-9)


def test_table_holds_every_row_and_the_reference(measured):
    text = str(measured)
    assert len(text.splitlines()) == 3 + len(measured.rows)
    assert f"own error {measured.reference_error:.1e}" in text


def test_csv_holds_every_row(measured, tmp_path):
    measured.to_csv(tmp_path / "trade.csv")
    with (tmp_path / "trade.csv").open(encoding="utf-8", newline="") as file:
        read = list(csv.DictReader(file))
    assert [float(line["error"]) for line in read] == [row.error for row in measured.rows]
    assert [int(line["degree"]) for line in read] == [row.method.degree for row in measured.rows]


def test_every_method_has_its_own_line_and_name(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    methods = [
        cg.Galerkin(4),
        cg.Galerkin(4, cg.chebyshev_points(4)),
        cg.Galerkin(4, quadrature=cg.lobatto(5)),
        cg.Galerkin(1, quadrature=cg.left_rectangle()),
        cg.Galerkin(1, quadrature=cg.radau(1)),
    ]
    trade = cg.Trade(tuple(row(1.0, 1e-3, method=method) for method in methods), "given", 0.0)
    axes = trade.plot()
    labels = [line.get_label() for line in axes.lines]
    assert labels == [str(method) for method in methods]
    assert len(set(labels)) == len(methods)
    assert all(label in str(trade) for label in labels)
    import matplotlib.pyplot as plt

    plt.close(axes.figure)


def test_lines_of_one_name_are_all_drawn(monkeypatch):
    """Rules of the same ends and order differ within."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    rules = [cg.Quadrature([0.0, 0.5 - s, 0.5 + s, 1.0], [0.25, 0.25, 0.25, 0.25]) for s in (0.1, 0.2)]
    rows = tuple(row(1.0, 1e-3, method=cg.Galerkin(2, quadrature=rule)) for rule in rules)
    axes = cg.Trade(rows, "given", 0.0).plot()
    assert len(axes.lines) == 2
    import matplotlib.pyplot as plt

    plt.close(axes.figure)


def test_plot_shows_orders_and_the_floor(measured, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    axes = measured.plot()
    labels = [line.get_label() for line in axes.lines]
    assert any("degree 2" in label and "N^-" in label for label in labels)
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert "reference" in axes.texts[0].get_text()
    import matplotlib.pyplot as plt

    plt.close(axes.figure)
