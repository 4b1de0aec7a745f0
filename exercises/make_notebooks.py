"""Write the notebooks of all exercises from `sources`: ``python exercises/make_notebooks.py``.

A source is a Python file in cells: ``# %% [markdown]`` begins a text, ``# %%`` code, and ``# %% [task]`` the functions
to write. The solution has them as they are, the exercise without their bodies.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
SOURCES = sorted((HERE / "sources").glob("*.py"))
FORM = {
    "metadata": {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    },
    "nbformat": 4,
    "nbformat_minor": 4,
}


class Cell(NamedTuple):
    """A cell of a source: its kind, "", "markdown" or "task", and its text."""

    kind: str
    text: str


def cells_of(source: str) -> Iterator[Cell]:
    """Cells of a source; what stands before the first one, its docstring, is the heading."""
    heading, *parts = re.split(r"^# %%(.*)$", source, flags=re.MULTILINE)
    title, _, about = str(ast.literal_eval(heading.strip())).partition("\n")
    yield Cell("markdown", f"# {title}\n\n{about.strip()}".strip())
    for mark, text in zip(parts[::2], parts[1::2], strict=True):
        kind = mark.strip().strip("[]")
        body = text.strip()
        if kind == "markdown":
            body = "\n".join(line.removeprefix("#").removeprefix(" ") for line in body.split("\n"))
        yield Cell(kind, body)


def without_bodies(code: str) -> str:
    """Functions of a cell with signature and docstring only; they raise NotImplementedError."""
    lines = code.split("\n")
    for node in reversed(ast.parse(code).body):
        if isinstance(node, ast.FunctionDef):
            lines[node.body[0].end_lineno : node.end_lineno] = ["    raise NotImplementedError"]
    return "\n".join(lines)


def notebook(source: str, *, solved: bool) -> str:
    """Return the notebook of a source, format 4.4, without outputs."""
    cells = []
    for kind, text in cells_of(source):
        if kind == "markdown":
            cells.append({"cell_type": "markdown", "metadata": {}, "source": text.splitlines(keepends=True)})
            continue
        shown = without_bodies(text) if kind == "task" and not solved else text
        lines = shown.splitlines(keepends=True)
        cells.append({"cell_type": "code", "execution_count": None, "metadata": {}, "outputs": [], "source": lines})
    return json.dumps({"cells": cells, **FORM}, indent=1, ensure_ascii=False) + "\n"


def notebooks() -> dict[Path, str]:
    """All notebooks by their paths."""
    made = {}
    for path in SOURCES:
        source = path.read_text(encoding="utf-8")
        made[HERE / f"{path.stem}.ipynb"] = notebook(source, solved=False)
        made[HERE / f"{path.stem}_solution.ipynb"] = notebook(source, solved=True)
    return made


if __name__ == "__main__":
    for path, text in notebooks().items():
        path.write_text(text, encoding="utf-8")
