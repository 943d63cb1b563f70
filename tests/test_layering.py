"""A module imports only from those of a lower rank; Matplotlib is loaded only when a plot is asked for."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import casadi_galerkin

RANKS = {
    "optimizer": 0,
    "plotting": 0,
    "precision": 0,
    "quadrature": 0,
    "threads": 0,
    "tracing": 0,
    "control_problem": 1,
    "legendre": 1,
    "nodes": 1,  # Lobatto control points are the points of a Lobatto rule
    "problems": 1,
    "polynomial": 2,
    "calculus": 3,
    "control_path": 3,
    "adaptivity": 4,
    "control_layout": 4,
    "interval": 4,
    "layout": 4,
    "trajectory": 4,
    "control_place": 5,
    "control_report": 5,
    "control_trajectory": 5,
    "guesses": 5,
    "mapping": 5,
    "operators": 5,
    "control_adaptivity": 6,
    "control_graph": 6,
    "control_guess": 6,
    "functional": 6,
    "stages": 6,
    "algebra": 7,
    "control": 7,
    "kernel": 7,
    "iteration": 8,
    "system": 8,
    "action_graph": 9,
    "newton": 9,
    "stepping": 9,
    "diagnosis": 10,
    "engines": 10,
    "geometry": 10,
    "initial": 10,
    "boundary": 11,
    "shooting": 11,
    "continuation": 12,
    "relaxation": 12,
    "sensitivity": 12,
    "refinement": 13,
    "control_refinement": 14,
    "solve": 15,
    "accuracy": 16,
    "comparison": 16,
    "sweep": 16,
    "trade_table": 17,
    "trade": 18,
}
PACKAGE = Path(casadi_galerkin.__file__).parent
MODULES = sorted(path.stem for path in PACKAGE.glob("*.py") if path.stem != "__init__")


def imported(source: str) -> set[str]:
    """Modules of the package that a source imports, anywhere in it, by any form of import."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = f"casadi_galerkin.{base}".rstrip(".")
            names = [f"{base}.{alias.name}" for alias in node.names] if base == "casadi_galerkin" else [base]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        found |= {name.split(".")[1] for name in names if name.startswith("casadi_galerkin.")}
        assert "casadi_galerkin" not in names, "a module must not import the package itself"
    return found


def upward(module: str, source: str) -> list[str]:
    return sorted(name for name in imported(source) if RANKS[name] >= RANKS[module])


@pytest.mark.parametrize("module", MODULES)
def test_module_imports_only_from_lower_ranks(module):
    assert module in RANKS, f"give {module} a rank"
    assert upward(module, (PACKAGE / f"{module}.py").read_text(encoding="utf-8")) == []


def test_the_manual_lists_every_module_below_what_it_imports():
    manual = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    table = manual.split("| module |")[1].split("\n\n")[0]
    listed = [name for row in table.splitlines()[2:] for name in re.findall(r"`(\w+)`", row.split("|")[1])]
    assert sorted(listed) == MODULES
    for position, module in enumerate(listed):
        known = imported((PACKAGE / f"{module}.py").read_text(encoding="utf-8"))
        assert known <= set(listed[:position]), module


@pytest.mark.parametrize(
    "source",
    [
        "from casadi_galerkin.solve import solve",
        "import casadi_galerkin.boundary",
        "from .boundary import transcribe",
        "from . import boundary",
        "from casadi_galerkin import boundary",
        "def f():\n    from casadi_galerkin.calculus import Galerkin",
    ],
)
def test_an_upward_import_is_found_in_every_form(source):
    assert len(upward("nodes", source)) == 1


@pytest.mark.parametrize("module", ["quadrature", "nodes", "calculus", "plotting"])
def test_numpy_modules_know_nothing_of_casadi(module):
    tree = ast.parse((PACKAGE / f"{module}.py").read_text(encoding="utf-8"))
    names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert "casadi" not in names


def test_only_engines_and_the_optimizer_call_solvers():
    for module in MODULES:
        text = (PACKAGE / f"{module}.py").read_text(encoding="utf-8")
        calls = {node.attr for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Attribute)}
        assert module in ("engines", "optimizer") or not calls & {"nlpsol", "rootfinder"}, module
        assert module == "algebra" or "Linsol" not in calls, module


def test_importing_the_package_loads_no_matplotlib():
    code = "import sys, casadi_galerkin; print([name for name in sys.modules if name.startswith('matplotlib')])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_public_names_are_reexported_explicitly():
    """``from .x import y as y``, nothing else but the docstring."""
    tree = ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    assert all(isinstance(node, ast.ImportFrom) for node in tree.body[1:])
    assert all(alias.asname == alias.name for node in tree.body[1:] for alias in node.names)
