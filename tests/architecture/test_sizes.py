"""Files, functions and the trunk stay small enough to be read at once."""

from __future__ import annotations

import ast

import pytest
from house import PACKAGE, ROOT, Source, sources

FILE_LINES, FUNCTION_LINES, TRUNK_LINES = 300, 40, 25

FILES = sorted(path for kind in ("*.py", "*.cpp", "*.hpp") for path in PACKAGE.rglob(kind))
FILES += sorted((ROOT / "benchmarks").rglob("*.py"))


def functions(source: Source) -> list[tuple[str, int]]:
    """Name and length of each function, from its signature to its end, without its docstring and decorators."""
    found = []
    for node in ast.walk(source.tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0]
            told = ast.get_docstring(node) is not None
            docstring = first.end_lineno - first.lineno + 1 if told else 0
            found.append((f"{source.path}:{node.lineno} {node.name}", node.end_lineno - node.lineno + 1 - docstring))
    return found


def body_lines(source: Source, name: str) -> int:
    """Lines of a function's body, without its docstring."""
    (node,) = (n for n in ast.walk(source.tree) if isinstance(n, ast.FunctionDef) and n.name == name)
    start = node.body[1] if ast.get_docstring(node) is not None else node.body[0]
    return node.end_lineno - start.lineno + 1


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_files(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= FILE_LINES


@pytest.mark.parametrize("source", sources(), ids=lambda source: source.path)
def test_functions(source):
    assert [found for found in functions(source) if found[1] > FUNCTION_LINES] == []


def test_the_trunk():
    (trunk,) = (source for source in sources() if source.path == "slam/grid_fastslam.py")
    assert body_lines(trunk, "step") <= TRUNK_LINES


def test_lengths_are_counted_without_the_docstring():
    source = Source.of("a.py", 'def f():\n    """One.\n\n    Two.\n    """\n    x = 1\n    return x\n')
    assert functions(source) == [("a.py:1 f", 3)]
    assert body_lines(source, "f") == 2
