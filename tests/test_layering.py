"""A folder imports only from those above it in the manual's table; Matplotlib is loaded only for a plot."""

import ast
import re
import subprocess
import sys
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
    ("studies",),
)
RANKS = {folder: rank for rank, folders in enumerate(LAYERS) for folder in folders}
NAME = "casadi_galerkin"
PACKAGE = Path(casadi_galerkin.__file__).parent
FOLDERS = sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))


def dotted(path: Path) -> str:
    """Name by which a file of the package is imported."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


TREES = {dotted(path): ast.parse(path.read_text(encoding="utf-8")) for path in sorted(PACKAGE.rglob("*.py"))}
MODULES = [module for module in TREES if module not in (NAME, f"{NAME}.__main__")]  # those stand above all


@cache
def imports(module: str) -> set[str]:
    """Dotted names that a module imports, anywhere in it; those of relative imports begin with a dot."""
    found = set()
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{'.' * node.level}{node.module or ''}.{alias.name}" for alias in node.names}
    return found


def imported(module: str) -> set[str]:
    """Modules and folders of the package that a module imports, by their dotted names."""
    found = set()
    for name in imports(module):
        if name.split(".")[0] == NAME:
            while name not in TREES:  # what is imported from a module is part of it
                name = name.rpartition(".")[0]
            found.add(name)
    return found


def folder_of(module: str) -> str:
    return module.split(".")[1]


def test_every_folder_has_its_place():
    assert sorted([*FOLDERS, "_solve"]) == sorted(RANKS)
    assert {folder_of(module) for module in MODULES} == set(RANKS)


def test_modules_import_only_from_lower_folders_and_their_own():
    assert [module for module in MODULES if NAME in imported(module)] == []
    pairs = {(folder_of(module), folder_of(name)) for module in MODULES for name in imported(module)}
    assert {(folder, other) for folder, other in pairs if folder != other and RANKS[other] >= RANKS[folder]} == set()


def test_imports_are_absolute():
    assert [module for module in TREES if any(name.startswith(".") for name in imports(module))] == []


def test_modules_import_each_other_without_a_circle():
    graph = {module: imported(module) - {module} for module in TREES}
    assert len(list(TopologicalSorter(graph).static_order())) == len(TREES)


def test_the_manual_lists_every_folder_below_what_it_imports():
    manual = (ROOT / "examples" / "guides" / "contributing.md").read_text(encoding="utf-8")
    table = manual.split("| folder |")[1].split("\n\n")[0]
    listed = [name for row in table.splitlines()[2:] for name in re.findall(r"`(\w+)`", row.split("|")[1])]
    assert sorted(listed) == FOLDERS
    for position, folder in enumerate(listed):
        modules = [module for module in MODULES if folder_of(module) == folder]
        known = {folder_of(name) for module in modules for name in imported(module)}
        assert known & set(FOLDERS) <= set(listed[: position + 1]), folder


def test_numpy_modules_know_nothing_of_casadi():
    modules = [*(module for module in MODULES if folder_of(module) == "calculus"), f"{NAME}.solution.plotting"]
    assert [module for module in modules if any(name.split(".")[0] == "casadi" for name in imports(module))] == []


FACTORIZING = "problems.linear_equations", "solvers.linear_solver"


def called(module: str) -> set[str]:
    """Names of attributes in a module, and of what it imports of CasADi."""
    names = {node.attr for node in ast.walk(TREES[module]) if isinstance(node, ast.Attribute)}
    return names | {name.rpartition(".")[2] for name in imports(module) if name.startswith("casadi.")}


def test_only_solvers_and_control_call_casadis_solvers():
    solving = {folder_of(module) for module in MODULES if called(module) & {"nlpsol", "rootfinder"}}
    assert solving <= {"solvers", "control"}
    assert {module for module in MODULES if "Linsol" in called(module)} <= {f"{NAME}.{of}" for of in FACTORIZING}


def test_importing_the_package_loads_no_matplotlib():
    code = "import sys, casadi_galerkin; print([name for name in sys.modules if name.startswith('matplotlib')])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_public_names_are_reexported_explicitly():
    """``from .x import y as y``, then what ``dir`` shows; nothing else but the docstring."""
    body = TREES[NAME].body[1:]
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
    tree = TREES[f"{NAME}.{folder}"]
    words = ast.get_docstring(tree) or ""
    assert len(tree.body) == 1
    assert len(re.findall(r"\w[^.!?]*[.!?](?=\s|$)", words)) >= 2
    assert "TODO" not in words
