"""The reference has every public name on the page of its folder, as the docstrings are now."""

import runpy

import pytest
from paths import EXAMPLES, ROOT

import casadi_galerkin as cg

HERE = EXAMPLES / "reference"
MAKE = runpy.run_path(str(HERE / "make.py"))
PAGES = MAKE["pages"]()


@pytest.mark.parametrize("file", PAGES)
def test_page_is_current(file):
    assert (HERE / file).read_text(encoding="utf-8") == PAGES[file], "run examples/reference/make.py"


def test_pages_are_those_and_no_others():
    assert {file.name for file in HERE.glob("*.md")} == set(PAGES)


def test_every_public_name_has_one_entry():
    headings = [line.removeprefix("## ") for page in PAGES.values() for line in page.splitlines() if line[:3] == "## "]
    assert sorted(headings) == dir(cg)


def test_the_first_page_links_the_reference():
    assert "(examples/reference/README.md)" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_a_docstring_becomes_headings_lists_and_code():
    docstring = (
        "Do it.\n\n    x = y\n\nParameters\n----------\na, b : (d,), long\n    text\n\nExamples\n--------\n>>> 1\n1"
    )
    wanted = "Do it.\n\n```text\n    x = y\n```\n\n### Parameters\n\n- `a, b` : (d,), long text"
    assert MAKE["text"](docstring, 3) == wanted + "\n\n### Examples\n\n```python\n>>> 1\n1\n```"
