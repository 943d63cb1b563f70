"""Every public callable shows how it is called, and every example in a docstring of the package runs."""

import doctest
import importlib
import inspect
import pkgutil

import pytest

import casadi_galerkin as cg

MODULES = [importlib.import_module(info.name) for info in pkgutil.walk_packages(cg.__path__, "casadi_galerkin.")]
EXAMPLES = [test for module in MODULES for test in doctest.DocTestFinder().find(module) if test.examples]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name.removeprefix("casadi_galerkin."))
def test_example_prints_what_it_says(example):
    assert doctest.DocTestRunner().run(example).failed == 0


@pytest.mark.parametrize("name", [name for name in dir(cg) if callable(getattr(cg, name))])
def test_public_callable_has_an_example(name):
    assert ">>> " in (inspect.getdoc(getattr(cg, name)) or "")
