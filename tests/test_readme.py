"""The code of the README and of every guide runs and prints the numbers beside it; their links lead somewhere."""

import re
import shutil
import subprocess

import pytest
from paths import EXAMPLES, ROOT
from slow import slow

README = ROOT / "README.md"
GUIDES = sorted((EXAMPLES / "guides").glob("*.md"))
DOCUMENTS = [README, EXAMPLES / "gallery.md", *GUIDES]
NUMBER = r"-?\d+(?:\.\d+(?:e[+-]?\d+)?|e[+-]?\d+)"
SHORTEST, LONGEST = 60, 150  # lines of a guide


@pytest.fixture(autouse=True)
def figures_closed():
    """Matplotlib keeps those of every run, and warns from the twentieth on."""
    yield
    import matplotlib.pyplot as plt

    plt.close("all")


def name(document):
    return document.name


def read(document):
    return document.read_text(encoding="utf-8")


def code_blocks(document):
    """Code with as many empty lines before it as there are lines above it, so that a traceback names the right one."""
    text = read(document)
    for match in re.finditer(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        yield "\n" * text.count("\n", 0, match.start(1)) + match[1]


def comments(code):
    """Those behind what is printed."""
    return re.findall(r"^ *print\(.*#(.*)$", code, re.MULTILINE)


def stated_numbers(code):
    """Numbers in the comments behind what is printed; those after a bracket are arguments, such as 0.5 in x(0.5)."""
    return [text for comment in comments(code) for text in re.findall(r"(?<!\()" + NUMBER, comment)]


def truths(text):
    return re.findall(r"\b(?:True|False)\b", text)


def run(code, document, shared):
    exec(compile(code, str(document), "exec"), shared)


@pytest.mark.parametrize("document", [README, *slow(*GUIDES)], ids=name)
def test_code_runs_in_order_and_prints_the_numbers_beside_it(document, monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.chdir(tmp_path)  # pictures that the code saves go there
    shared = {"__name__": "__main__"}  # as in a script; a block may use the names of the ones before it
    for code in code_blocks(document):
        run(code, document, shared)
        output, stated = capsys.readouterr().out, truths("\n".join(comments(code)))
        assert not stated or stated == truths(output)
        printed = [float(text) for text in re.findall(NUMBER, output)]
        for text in stated_numbers(code):
            digits = len(re.sub(r"e.*|\D", "", text).lstrip("0")) or 1
            assert float(text) in [float(f"{value:.{digits}g}") for value in printed], text


def test_a_stated_number_that_is_not_printed_is_found():
    assert stated_numbers("print(x(0.5))  # x(0.5) is 1.25 and -2.5e-3") == ["1.25", "-2.5e-3"]


@pytest.mark.parametrize("document", [README, *(guide for guide in GUIDES if "```python" in read(guide))], ids=name)
def test_documents_with_code_state_numbers_that_are_checked(document):
    assert any(stated_numbers(code) for code in code_blocks(document))


def test_git_ignores_what_the_code_of_the_first_page_writes(tmp_path):
    written = sorted({match for match in re.findall(r"(?<![\w/])\w+\.(?:csv|png|gif)\b", read(README))})
    assert {"lambert.csv", "lambert.png", "pendulum.csv", "swings.png"} <= set(written)
    shutil.copy(ROOT / ".gitignore", tmp_path)
    subprocess.run(["git", "init", "--quiet", tmp_path], check=True)
    ignored = subprocess.run(["git", "-C", tmp_path, "check-ignore", *written], capture_output=True, text=True)
    assert ignored.stdout.split() == written


def prose(document):
    return re.sub(r"^```.*?^```", "", read(document), flags=re.MULTILINE | re.DOTALL)


def anchors(document):
    """What the headings of a document are linked by."""
    headings = re.findall(r"^#+ (.*)$", prose(document), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", DOCUMENTS, ids=name)
def test_links_lead_to_files_and_headings(document):
    for link in re.findall(r"\]\(([^)]+)\)", prose(document)):
        file, _, anchor = link.partition("#")
        target = (document.parent / file).resolve() if file else document
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_the_first_screen_has_picture_code_and_what_comes_next_the_commands():
    text = read(README)
    assert text.index("![") < text.index("```python") < text.index("<!-- test command -->")
    assert text.count("![") <= 4


def test_modules_that_the_contributing_guide_names_exist():
    named = set(re.findall(r"`(\w+/\w+\.py)`", read(EXAMPLES / "guides" / "contributing.md")))
    gone = {name for name in named if not any((folder / name).exists() for folder in (ROOT, ROOT / "casadi_galerkin"))}
    assert len(named) > 5
    assert gone == set()


def test_readme_links_every_guide():
    assert sorted(set(re.findall(r"\]\(examples/guides/(\w+\.md)\)", read(README)))) == [guide.name for guide in GUIDES]


@pytest.mark.parametrize("guide", GUIDES, ids=name)
def test_guides_are_as_long_as_one_sitting(guide):
    assert SHORTEST <= len(read(guide).splitlines()) <= LONGEST


def test_readme_is_as_long_as_three_minutes():
    assert len(read(README).splitlines()) <= 150
