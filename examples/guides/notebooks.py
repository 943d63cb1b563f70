"""Write guides as notebooks, beside their Markdown: ``python examples/guides/notebooks.py``, or some by name."""

import json
import re
import sys
from pathlib import Path

HERE = Path(__file__).parent
CHOSEN = "first_boundary_problem", "for_users_of_scipy_and_opti", "several_paths", "trajectory_optimization"


def cells(text):
    """Text and Python code of a guide, in turn, as cells."""
    for i, part in enumerate(re.split(r"^```python\n(.*?)^```\n", text, flags=re.MULTILINE | re.DOTALL)):
        if part.strip():
            kind = {"cell_type": "code", "execution_count": None, "outputs": []} if i % 2 else {"cell_type": "markdown"}
            yield {**kind, "id": f"cell{i}", "metadata": {}, "source": part.strip().splitlines(keepends=True)}


def write(name, folder=HERE):
    """Write the notebook of a guide into a folder; returns its path."""
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    guide = (HERE / f"{name}.md").read_text(encoding="utf-8")
    book = {"nbformat": 4, "nbformat_minor": 5, "metadata": {"kernelspec": kernel}, "cells": list(cells(guide))}
    target = Path(folder) / f"{name}.ipynb"
    target.write_text(json.dumps(book, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return target


if __name__ == "__main__":
    for guide in sys.argv[1:] or CHOSEN:
        print(write(guide))
