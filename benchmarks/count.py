"""Count the package's code: statements by the syntax tree, modules, physical lines of src; today and at other commits.

python benchmarks/count.py [COMMIT ...]
"""

from __future__ import annotations

import argparse
import ast
import io
import subprocess
import tarfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from report import table

_ROOT = Path(__file__).resolve().parent.parent
_COMPILED = ".cpp", ".hpp"


class Count(NamedTuple):
    """Size of some source files."""

    modules: int
    """Files of Python."""
    statements: int
    """Nodes of the syntax tree that are statements; docstrings and `...` are none, and `a, b = x, y` is two."""
    packed: float
    """Ratio of assignments that are packed as `a, b = x, y`, percent."""
    lines: int
    """Physical lines of Python, with blank ones and comments."""
    compiled_lines: int
    """Physical lines of C++."""


def count(files: Iterable[tuple[str, str]]) -> Count:
    """Count files, each a name and a text; what is neither Python nor C++ does not count."""
    modules = statements = assignments = packed = lines = compiled_lines = 0
    for name, text in files:
        length = len(text.splitlines())
        if name.endswith(".py"):
            modules += 1
            lines += length
            for node in ast.walk(ast.parse(text)):
                statements += _is_statement(node)
                assignments += isinstance(node, ast.Assign | ast.AnnAssign)
                more = _packed(node)
                statements += more
                packed += more > 0
        elif name.endswith(_COMPILED):
            compiled_lines += length
    return Count(modules, statements, round(100 * packed / max(1, assignments), 1), lines, compiled_lines)


def main(arguments: Sequence[str] | None = None) -> str:
    """Print and return a table of the working tree and of the commits that are asked for."""
    parser = argparse.ArgumentParser(description="Statements, modules and physical lines of src.")
    parser.add_argument("commits", nargs="*", metavar="COMMIT", help="count these, too")
    commits = parser.parse_args(arguments).commits
    rows = [[commit, *count(_at(commit))] for commit in commits]
    rows.append(["working tree", *count(_here())])
    text = table(["", "modules", "statements", "packed assignments, %", "lines of Python", "lines of C++"], rows)
    print(text)
    return text


def _is_statement(node: ast.AST) -> bool:
    constant = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return isinstance(node, ast.stmt) and not constant


def _packed(node: ast.AST) -> int:
    """Count the assignments that a node holds beyond its first: of one value to each name, none used by another."""
    match node:
        case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)) if len(targets) == len(values):
            assigned = {ast.unparse(target) for target in targets}
            used = {ast.unparse(part) for value in values for part in ast.walk(value) if isinstance(part, ast.expr)}
            return 0 if assigned & used else len(targets) - 1
    return 0


def _here() -> Iterator[tuple[str, str]]:
    for path in sorted((_ROOT / "src").rglob("*")):
        if path.suffix in (".py", *_COMPILED):
            yield path.name, path.read_text(encoding="utf-8")


def _at(commit: str) -> Iterator[tuple[str, str]]:
    archive = subprocess.run(["git", "archive", commit, "src"], cwd=_ROOT, capture_output=True, check=True).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as tree:
        for member in tree.getmembers():
            content = tree.extractfile(member) if member.name.endswith((".py", *_COMPILED)) else None
            if content is not None:
                yield member.name, content.read().decode()


if __name__ == "__main__":
    main()
