"""Each long calculation has a bar in a terminal, and none where nobody sees it or it would flash; see test_notebook."""

import io
import sys

import pytest
from control_problems import double_integrator
from scenes import bratu_problem

import casadi_galerkin as cg
from casadi_galerkin.solution import progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


LONG = {
    "refinement": lambda: cg.solve(bratu_problem(), tol=1e-6),
    "sweep": lambda: cg.sweep(bratu_problem(), [{"parameters": [2.0]}], cg.Galerkin(3), 4),
    "trade": lambda: cg.trade(bratu_problem(), [cg.Galerkin(3)], [4]),
    "paths": lambda: cg.paths(bratu_problem(), cg.Galerkin(8), 10, count=2),
    "continuation": lambda: cg.continuation(bratu_problem(), [2.0], cg.Galerkin(5), 4),
    "starts": lambda: cg.solve(double_integrator(), cg.Galerkin(3), 4, starts=2),
}


@pytest.mark.parametrize("name", LONG)
def test_a_long_calculation_has_a_bar_in_a_terminal(name, monkeypatch):
    monkeypatch.setattr(progress, "PATIENT", 0.0)
    monkeypatch.setattr(sys, "stderr", Terminal())
    LONG[name]()
    assert name in sys.stderr.getvalue()


@pytest.mark.parametrize("terminal", [Terminal(), io.StringIO(), None], ids=["short", "elsewhere", "nowhere"])
@pytest.mark.slow
def test_no_bar_is_shown_where_nobody_sees_it_or_it_would_flash(terminal, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal)
    for run in LONG.values():
        run()
    assert terminal is None or terminal.getvalue() == ""


def test_a_worker_shows_none_beside_that_of_its_parent(monkeypatch):
    monkeypatch.setattr(progress, "PATIENT", 0.0)
    monkeypatch.setattr(progress, "parent_process", lambda: "that of a worker")
    monkeypatch.setattr(sys, "stderr", Terminal())
    LONG["refinement"]()
    assert sys.stderr.getvalue() == ""
