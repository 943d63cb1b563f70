"""What a notebook shows, in a kernel of its own: every figure, the bars of long calculations, and guides."""

import runpy
from pathlib import Path

import pytest
from paths import EXAMPLES

import casadi_galerkin as cg

pytestmark = pytest.mark.slow  # a kernel starts in seconds, and needs what `pip install '.[notebook]'` brings

SOLVED = """
import matplotlib.pyplot as plt
import casadi_galerkin as cg
path = cg.solve(cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0]), cg.Galerkin(2), 4)
"""


@pytest.fixture
def shown(monkeypatch, tmp_path):
    """Run cells in a fresh kernel; returns what each one shows: types of content, and names of streams."""
    import nbformat
    from nbclient import NotebookClient

    monkeypatch.delenv("MPLBACKEND", raising=False)  # a kernel chooses its own
    monkeypatch.setenv("PYTHONPATH", str(Path(cg.__file__).parents[1]))

    def run(*cells):
        notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
        NotebookClient(notebook, resources={"metadata": {"path": str(tmp_path)}}).execute()
        return [
            [kind for output in cell.outputs for kind in output.get("data", {output.get("name"): None})]
            for cell in notebook.cells
        ]

    return run


OWN, FIGURE, BAR = "text/html", "image/png", "application/vnd.jupyter.widget-view+json"
SHORT = "cg.solve(path.problem, tol=1e-6);"
LONG = "from casadi_galerkin.solution import progress; progress.PATIENT = 0.0; " + SHORT


@pytest.mark.parametrize("first", ["path", "path.plot();"])
def test_every_figure_is_shown_once_and_a_bar_where_a_calculation_lasts(shown, first):
    cells = {
        first: [OWN] if first == "path" else [FIGURE],
        "cg.panels(2);": [FIGURE],
        "plt.plot([1, 2]);": [FIGURE],
        "path.plot_phase(); path": [OWN, FIGURE],
        "plt.figure(); plt.plot([1, 2]);": [FIGURE],
        SHORT: [],
        LONG: [BAR],
        "plt.ioff(); path.plot();": [],
    }
    _, *outputs = shown(SOLVED, *cells)
    seen = [[kind for kind in output if kind != "text/plain"] for output in outputs]
    assert dict(zip(cells, seen, strict=True)) == cells


WRITTEN = runpy.run_path(str(EXAMPLES / "guides" / "notebooks.py"))


def test_guides_run_as_notebooks_that_show_their_figures(shown, tmp_path):
    """Two of them, one after the other in one kernel, which starts slowly."""
    import nbformat

    books = [nbformat.read(WRITTEN["write"](guide, tmp_path), as_version=4) for guide in WRITTEN["CHOSEN"]]
    for guide, book in zip(WRITTEN["CHOSEN"], books, strict=True):
        nbformat.validate(book)
        text = (EXAMPLES / "guides" / f"{guide}.md").read_text(encoding="utf-8")
        assert sum(cell.cell_type == "code" for cell in book.cells) == text.count("```python\n")
        assert book.cells[0].source.startswith("# ")
    codes = [cell.source for book in (books[0], books[-1]) for cell in book.cells if cell.cell_type == "code"]
    outputs = shown(*codes)
    assert not any("stderr" in output for output in outputs)
    drawn = [code for code in codes if "savefig" in code]
    assert sum("image/png" in output for output in outputs) >= len(drawn) > 2


def test_pandas_reads_what_is_written(tmp_path):
    import numpy as np
    import pandas as pd

    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2, (0, 1), [0.0], [1.0])
    path, swept = cg.solve(problem, tol=1e-6), cg.sweep(problem, [{}, {"guess": [[np.nan] * 3]}], cg.Galerkin(2), 2)
    for kept in (path, swept):
        kept.to_csv(tmp_path / "kept.csv")
        frame, table = pd.read_csv(tmp_path / "kept.csv"), pd.DataFrame(kept.to_dict())
        assert list(frame) == list(table)
        pd.testing.assert_frame_equal(frame.select_dtypes("number"), table.select_dtypes("number"), rtol=1e-14)
    assert frame["failure"].isna().tolist() == [True, False]
    assert pd.DataFrame(path.to_dict(times=[0.0, 0.5])).shape == (2, 5)
