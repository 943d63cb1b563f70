"""A folder imports only from those above it in the README's table; Matplotlib is loaded only for a plot."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from types import ModuleType

import pytest
from paths import ROOT

import casadi_galerkin

LAYERS = (
    ("calculus",),
    ("problems",),
    ("functional",),
    ("solution",),
    ("solvers",),
    ("boundary", "stepping", "control"),  # side by side
    ("_solve",),
    ("studies", "__main__"),
)
RANKS = {folder: rank for rank, folders in enumerate(LAYERS) for folder in folders}
NAME = "casadi_galerkin"
PACKAGE = Path(casadi_galerkin.__file__).parent
FOLDERS = sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))


def dotted(path: Path) -> str:
    """Name by which a file of the package is imported."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


SOURCES = {dotted(path): path.read_text(encoding="utf-8") for path in sorted(PACKAGE.rglob("*.py"))}
MODULES = [module for module in SOURCES if module != NAME]


def imports(package: str, tree: ast.Module) -> Iterator[str]:
    """Dotted names that a module of a package imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in ("import_module", "__import__"):
                name = str(node.args[0].value)
                yield f"{NAME}{name}" if name.startswith(".") else name


@cache
def words(module: str, source: str) -> tuple[set[str], set[str]]:
    """Dotted names that a source imports, anywhere in it, by any form of import, and the attributes that it takes."""
    package = (
        module if (PACKAGE.parent / Path(*module.split(".")) / "__init__.py").exists() else module.rpartition(".")[0]
    )
    tree = ast.parse(source)
    return set(imports(package, tree)), {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}


def imported(module: str, source: str) -> set[str]:
    """Modules and folders of the package that a source imports, by their dotted names."""
    found = set()
    for name in words(module, source)[0]:
        if name.split(".")[0] == NAME:
            while name not in SOURCES:  # what is imported from a module is part of it
                name = name.rpartition(".")[0]
            found.add(name)
    return found


def folder_of(module: str) -> str:
    return module.split(".")[1]


def upward(module: str, source: str) -> list[str]:
    """What a module must not import: the package itself, what is above its folder, or beside it."""
    own = folder_of(module)
    return sorted(
        name
        for name in imported(module, source)
        if name == NAME or (folder_of(name) != own and RANKS[folder_of(name)] >= RANKS[own])
    )


def test_every_folder_has_its_place():
    assert sorted([*FOLDERS, "_solve", "__main__"]) == sorted(RANKS)
    assert {folder_of(module) for module in MODULES} == set(RANKS)


@pytest.mark.parametrize("module", MODULES)
def test_module_imports_only_from_lower_folders(module):
    assert upward(module, SOURCES[module]) == []


def test_modules_import_each_other_without_a_circle():
    graph = {module: imported(module, source) - {module} for module, source in SOURCES.items()}
    assert len(list(TopologicalSorter(graph).static_order())) == len(SOURCES)


@pytest.mark.parametrize(
    "source",
    [
        "from casadi_galerkin._solve import solve",
        "from casadi_galerkin import solve",
        "import casadi_galerkin",
        "import casadi_galerkin.boundary",
        "import casadi_galerkin.boundary.transcription as b",
        "from casadi_galerkin.boundary.transcription import Transcription",
        "from casadi_galerkin.boundary import transcription",
        "from casadi_galerkin import boundary",
        "from ..boundary.transcription import Transcription",
        "from ..boundary import transcription",
        "from .. import boundary",
        "from ..solution.path import Path",
        "def f():\n    from casadi_galerkin.functional.functional import Functional",
        "if TYPE_CHECKING:\n    from casadi_galerkin.problems.problem import Problem",
        "import importlib\nimportlib.import_module('casadi_galerkin.studies.trade')",
        "__import__('casadi_galerkin.control')",
    ],
)
def test_an_upward_import_is_found_in_every_form(source):
    assert len(upward(f"{NAME}.calculus.nodes", source)) == 1


@pytest.mark.parametrize("folder", ["boundary", "stepping", "control"])
@pytest.mark.parametrize("other", ["boundary", "stepping", "control"])
def test_folders_side_by_side_do_not_import_one_another(folder, other):
    source = f"from {NAME}.{other} import refinement"
    assert bool(upward(f"{NAME}.{folder}.anything", source)) == (folder != other)


@pytest.mark.parametrize("source", ["from .quadrature import gauss", "from . import quadrature", "import numpy as np"])
def test_what_is_beside_a_module_in_its_folder_may_be_imported(source):
    assert upward(f"{NAME}.calculus.nodes", source) == []


def test_the_manual_lists_every_folder_below_what_it_imports():
    manual = (ROOT / "README.md").read_text(encoding="utf-8")
    table = manual.split("| folder |")[1].split("\n\n")[0]
    listed = [name for row in table.splitlines()[2:] for name in re.findall(r"`(\w+)`", row.split("|")[1])]
    assert sorted(listed) == FOLDERS
    for position, folder in enumerate(listed):
        modules = [module for module in MODULES if folder_of(module) == folder]
        known = {folder_of(name) for module in modules for name in imported(module, SOURCES[module])}
        assert known & set(FOLDERS) <= set(listed[: position + 1]), folder


@pytest.mark.parametrize(
    "module", [*(module for module in MODULES if folder_of(module) == "calculus"), f"{NAME}.solution.plotting"]
)
def test_numpy_modules_know_nothing_of_casadi(module):
    assert not [name for name in words(module, SOURCES[module])[0] if name.split(".")[0] == "casadi"]


@pytest.mark.parametrize("module", SOURCES)
def test_only_solvers_and_control_call_casadis_solvers(module):
    names, attributes = words(module, SOURCES[module])
    called = attributes | {name.rpartition(".")[2] for name in names if name.startswith("casadi.")}
    folder = folder_of(module) if module != NAME else ""
    assert folder in ("solvers", "control") or not called & {"nlpsol", "rootfinder"}
    assert module == f"{NAME}.solvers.linear_solver" or "Linsol" not in called


def test_importing_the_package_loads_no_matplotlib():
    code = "import sys, casadi_galerkin; print([name for name in sys.modules if name.startswith('matplotlib')])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_public_names_are_reexported_explicitly():
    """``from .x import y as y``, then what ``dir`` shows; nothing else but the docstring."""
    body = ast.parse(SOURCES[NAME]).body[1:]
    imports = [node for node in body if isinstance(node, ast.ImportFrom)]
    assert body[: len(imports)] == imports
    assert all(alias.asname == alias.name for node in imports for alias in node.names)
    rest = [getattr(node, "name", None) or node.targets[0].id for node in body[len(imports) :]]
    assert [name for name in rest if not name.startswith("_")] == []
    assert dir(casadi_galerkin) == sorted(alias.name for node in imports for alias in node.names)


def test_dir_shows_public_names_only():
    for name in dir(casadi_galerkin):
        assert not name.startswith("_"), name
        assert not isinstance(getattr(casadi_galerkin, name), ModuleType), name


@pytest.mark.parametrize("folder", FOLDERS)
def test_a_folder_says_what_it_is_and_does_nothing(folder):
    tree = ast.parse(SOURCES[f"{NAME}.{folder}"])
    words = ast.get_docstring(tree) or ""
    assert len(tree.body) == 1
    assert len(re.findall(r"\w[^.!?]*[.!?](?=\s|$)", words)) >= 2
    assert "TODO" not in words
