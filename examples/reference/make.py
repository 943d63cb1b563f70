"""Write the reference: one page for each folder of the package, out of the docstrings of its public names.

``python examples/reference/make.py``; a test says when it has to be run again.
"""

import importlib
import inspect
import re
from pathlib import Path

import casadi_galerkin as cg

HERE = Path(__file__).parent
SECTION = re.compile(r"^(\w[\w ]*)\n-+$", re.MULTILINE)  # as in NumPy's docstrings
WIDTH = 120  # of a line of code
SPECIAL = ("__call__", "__len__", "__getitem__", "__iter__")


def text(docstring, level):
    """A docstring as Markdown: sections are headings, examples are code, lists of names are lists."""
    first, *rest = SECTION.split(docstring)
    parts = [prose(first)]
    for name, body in zip(rest[::2], rest[1::2], strict=True):
        parts.append(f"{'#' * level} {name}")
        parts.append(f"```python\n{body.strip()}\n```" if name == "Examples" else entries(body))
    return "\n\n".join(part for part in parts if part)


def prose(body):
    """Paragraphs; indented lines, which are formulas, become code."""
    paragraphs = re.split(r"\n\s*\n", body.strip("\n"))
    return "\n\n".join(f"```text\n{p}\n```" if p.startswith("    ") else p.strip() for p in paragraphs if p.strip())


def entries(body):
    """Lists of names, of which each starts a line, and what is indented belongs to it; and the paragraphs between."""
    return "\n\n".join(map(listed, re.split(r"\n\s*\n", body.strip("\n"))))


def listed(part):
    """A list, if anything of it is indented or has a name before a colon; else it is a paragraph."""
    if not re.search(r"^ |^\w[\w, ]* : ", part, re.MULTILINE):
        return part
    named = re.sub(r"^(\w[\w, ]*?)( : |$)", r"`\1`\2", part, flags=re.MULTILINE)
    return "\n".join(f"- {line}" for line in re.sub(r"\n +", " ", named).splitlines())


def signature(thing):
    """Its parameters without their types, which the text states."""
    try:
        given = inspect.signature(thing).parameters.values()
    except ValueError:
        return ""
    plain = [p.replace(annotation=inspect.Parameter.empty) for p in given if p.name != "self" and p.name[0] != "_"]
    return re.sub(r"<.*? at \w+>", "...", str(inspect.Signature(plain)))


def members(thing):
    """Public methods and properties that the class defines, and those of answers that no public base of it has."""
    bases = [base for base in thing.__mro__[1:] if getattr(cg, base.__name__, None) is base]
    for name in dir(thing):
        owner = next((base for base in thing.__mro__ if name in vars(base)), object)
        of_answers = owner.__module__.startswith("casadi_galerkin.solution.")
        told = owner is thing or (of_answers and not any(issubclass(base, owner) for base in bases))
        if told and (name[0] != "_" or name in SPECIAL):
            member = inspect.getattr_static(thing, name)
            if inspect.getdoc(member) and (callable(member) or hasattr(member, "__get__")):
                yield name, member


def entry(name):
    """The Markdown of one public name."""
    thing = getattr(cg, name)
    if isinstance(thing, cg.Solver):
        return f"## {name}\n\nA [`Solver`](#solver), which says what it does."
    words, parts = inspect.getdoc(thing), [f"## {name}"]
    if "Parameters\n---" in words:  # not of what only the package makes
        call = f"{name}{signature(thing)}"
        if len(call) > WIDTH:  # a parameter a line, as formatters of code want it
            call = call.replace("(", "(\n    ", 1).replace(", ", ",\n    ").removesuffix(")") + ",\n)"
        parts.append(f"```python\n{call}\n```")
    parts.append(text(words, 3))
    for member, found in members(thing) if inspect.isclass(thing) else ():
        call = signature(found) if callable(found) else ""
        parts += [f"### {name}.{member}{call}", text(inspect.getdoc(found), 4)]
    return "\n\n".join(parts)


def anchor(name, names):
    """What the heading of a name is linked by: a second one that differs in capitals only has a number."""
    before = [other.lower() for other in names[: names.index(name)]].count(name.lower())
    return name.lower() + (f"-{before}" if before else "")


def source(name):
    """The module that a public name is imported from, as `__init__.py` says."""
    return re.search(rf"^from (\S+) import {name} as {name}$", inspect.getsource(cg), re.MULTILINE)[1]


def pages():
    """The reference by the name of its files."""
    folders = {}
    for name in dir(cg):
        folders.setdefault(source(name).split(".")[1], []).append(name)
    written = {}
    for folder, names in folders.items():
        module = importlib.import_module(f"casadi_galerkin.{folder}")
        links = ", ".join(f"[`{name}`](#{anchor(name, names)})" for name in names)
        title = "solve and transcribe" if folder == "_solve" else folder
        head = f"# {title}\n\n{prose(inspect.getdoc(module))}\n\n{links}"
        written[f"{title.replace(' ', '_')}.md"] = "\n\n".join([head, *(entry(name) for name in names)]) + "\n"
    index = [f"- [{file.removesuffix('.md')}]({file}): {page.splitlines()[2]}" for file, page in written.items()]
    return {"README.md": "# Reference\n\n" + "\n".join(sorted(index)) + "\n", **written}


if __name__ == "__main__":
    for file, page in pages().items():
        (HERE / file).write_text(page, encoding="utf-8")
