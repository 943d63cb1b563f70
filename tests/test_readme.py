"""The README's code runs, and prints the numbers that it states."""

import re

import pytest
from paths import ROOT


@pytest.fixture(autouse=True)
def figures_closed():
    """Matplotlib keeps those of every run, and warns from the twentieth on."""
    yield
    import matplotlib.pyplot as plt

    plt.close("all")


def code_blocks():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def test_readme_has_code():
    assert code_blocks()


@pytest.mark.parametrize("number", range(len(code_blocks())))
def test_readme_code_runs(number, monkeypatch, tmp_path):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.chdir(tmp_path)  # pictures that the code saves go there
    shared = {}
    for block in code_blocks()[: number + 1]:  # a block may use the names of the ones before it
        exec(compile(block, "README.md", "exec"), shared)


def test_numbers_that_the_readme_states_are_those_that_its_code_prints(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.chdir(tmp_path)
    shared, number = {}, r"-?\d+\.\d+(?:e[+-]?\d+)?"
    for block in code_blocks():
        exec(compile(block, "README.md", "exec"), shared)
    printed = [float(text) for text in re.findall(number, capsys.readouterr().out)]
    comments = re.findall(r"^print\(.*#(.*)$", "".join(code_blocks()), re.MULTILINE)
    stated = [text for comment in comments for text in re.findall(r"(?<!\()" + number, comment)]  # no arguments
    assert len(stated) >= 4
    for text in stated:
        digits = len(re.sub(r"e.*|\D", "", text).lstrip("0"))
        assert float(text) in [float(f"{value:.{digits}g}") for value in printed]
