"""``python -m casadi_galerkin`` says what is there and whether it works."""

from importlib.metadata import PackageNotFoundError, version

import casadi as ca
import pytest

import casadi_galerkin as cg
from casadi_galerkin import __main__ as command


def test_versions_solvers_and_a_test_of_each_are_printed(capsys):
    assert command.main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"casadi_galerkin {cg.__version__}, Python ")
    assert lines[1].startswith(f"CasADi {ca.__version__}, NumPy ")
    assert lines[3].split()[:2] == ["nlpsol:", "ipopt,"]
    assert lines[3].endswith("fatrop")
    passed = [line.partition(":")[0] for line in lines if ": " in line and " passed, relative error " in line]
    assert passed[:4] == ["newton", "rootfinder", "ipopt", "minimizer"]
    assert passed[4:] == ["to a tolerance", "step by step", "optimal control"]


def test_a_wrong_answer_fails(monkeypatch, capsys):
    monkeypatch.setattr(command, "errors", lambda: {"newton": 1e-3, "ipopt": 0.0})
    assert command.main([]) == 1
    assert "FAILED, relative error 1e-03" in capsys.readouterr().out


def test_help_says_what_it_prints_and_solves_nothing(monkeypatch, capsys):
    monkeypatch.setattr(command, "errors", None)
    with pytest.raises(SystemExit) as left:
        command.main(["--help"])
    assert left.value.code == 0
    assert "Print versions" in capsys.readouterr().out


def test_an_argument_that_is_not_known_is_refused(capsys):
    with pytest.raises(SystemExit) as left:
        command.main(["--speed"])
    assert left.value.code == 2
    assert "unrecognized arguments: --speed" in capsys.readouterr().err


def test_the_version_is_the_one_that_is_installed():
    try:
        installed = version("casadi_galerkin")
    except PackageNotFoundError:
        pytest.skip("the package is imported from its folder")
    assert cg.__version__ == installed
