"""Bars of long calculations: each has one in a terminal, and none where nobody sees it or it would flash."""

import io
import sys

import casadi as ca
import pytest

import casadi_galerkin as cg
from casadi_galerkin.solution import progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def bratu(**given):
    return cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * ca.exp(x[0]), (0, 1), [0.0], [0.0], parameters=[1.0], **given
    )


def cart():
    return cg.ControlProblem(
        lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0], [0.0], [0.0],
        force=lambda t, x, v, u: u, running_cost=lambda t, x, v, u: u[0] ** 2, controls=1,
    )  # fmt: skip


LONG = {
    "refinement": lambda: cg.solve(bratu(), tol=1e-6),
    "sweep": lambda: cg.sweep(bratu(), [{"parameters": [2.0]}], cg.Galerkin(3), 4),
    "trade": lambda: cg.trade(bratu(), [cg.Galerkin(3)], [4]),
    "paths": lambda: cg.paths(bratu(), cg.Galerkin(8), 10, count=2),
    "continuation": lambda: cg.continuation(bratu(), [2.0], cg.Galerkin(3), 4),
    "starts": lambda: cg.solve(cart(), cg.Galerkin(3), 4, starts=2),
}


@pytest.mark.parametrize("name", LONG)
def test_a_long_calculation_has_a_bar_in_a_terminal(name, monkeypatch):
    monkeypatch.setattr(progress, "PATIENT", 0.0)
    monkeypatch.setattr(sys, "stderr", Terminal())
    LONG[name]()
    assert name in sys.stderr.getvalue()


@pytest.mark.parametrize("terminal", [Terminal(), io.StringIO(), None], ids=["short", "elsewhere", "nowhere"])
def test_no_bar_is_shown_where_nobody_sees_it_or_it_would_flash(terminal, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal)
    for run in LONG.values():
        run()
    assert terminal is None or terminal.getvalue() == ""
