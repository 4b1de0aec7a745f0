"""Measure what the default tests catch: python tests/mutation.py [--count 60] [--seed 40] [--only NUMBER ...].

Changes for the worse are drawn with a fixed seed over five folders of the package: a comparison or an operator is
exchanged, a number or a truth value changed, a condition negated, a statement dropped. One run of the default tests
first notes which test files run the changed statements (--reached FILE keeps it). Each change is then applied to a copy
of the package, and the files that reach it are run until a test fails, those named like the module first. A change that
no test reaches, or that all of them pass, survives. Further arguments (-n auto) are for pytest.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from gridslam.kernels import backend

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("slam", "tracking", "grid", "localization", "io")
PYTEST = (sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--tb=no", "-rfE")
TIMEOUT_S = 1200

EXCHANGED = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.LShift: ast.RShift, ast.RShift: ast.LShift,
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
    ast.USub: ast.UAdd,
}  # fmt: skip

# Runs in each process before gridslam is imported: the copy takes the place of an editable install, and `reached` notes
# the test file that is running.
SITE = """
import builtins, os, sys
sys.meta_path[:] = [finder for finder in sys.meta_path if "Redirecting" not in type(finder).__name__]
seen = set()
def reached(number):
    found = number, os.environ.get("PYTEST_CURRENT_TEST", "").split("::")[0]
    if found not in seen:
        seen.add(found)
        with open(os.environ["MUTATION_REACHED"], "a") as file:
            print(*found, file=file)
builtins.reached = reached
"""


class Change(NamedTuple):
    """A change for the worse: the file, the line, what is done there, and the node by its place in `ast.walk`."""

    path: str
    line: int
    kind: str
    place: int


def changes(path: Path) -> Iterator[Change]:
    """Every change of a module that is not one of annotations, messages or documentation."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes = list(ast.walk(tree))
    ignored: set[ast.AST] = set()
    for node in nodes:
        skip = [getattr(node, "annotation", None), getattr(node, "returns", None)]
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.MatchValue | ast.Import | ast.ImportFrom):
            skip.append(node)
        ignored.update(inner for part in skip if part for inner in ast.walk(part))
    for place, node in enumerate(nodes):
        kind = None if node in ignored else what(node)
        if kind:
            yield Change(path.relative_to(ROOT).as_posix(), node.lineno, kind, place)


def what(node: ast.AST) -> str | None:
    """Return what can be changed for the worse at a node, if anything can."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in EXCHANGED:
        return "comparison"
    if isinstance(node, ast.BinOp | ast.BoolOp | ast.UnaryOp | ast.AugAssign) and type(node.op) in EXCHANGED:
        return "operator"
    if isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
        return "constant"
    if isinstance(node, ast.If | ast.IfExp | ast.While):
        return "condition"
    dropped = isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Attribute | ast.Subscript)
    if dropped or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)):
        return "statement"
    return None


def statement_of(tree: ast.Module, node: ast.AST) -> tuple[list[ast.stmt], int]:
    """Return the innermost statement that holds a node, as a list of statements and an index."""
    bodies = (getattr(outer, name, None) for outer in ast.walk(tree) for name in ("body", "orelse", "finalbody"))
    lists = [body for body in bodies if isinstance(body, list)]
    return [(body, k) for body in lists for k, part in enumerate(body) if node in ast.walk(part)][-1]


def make_worse(tree: ast.Module, change: Change) -> None:
    """Apply a change to the tree of its module."""
    node = list(ast.walk(tree))[change.place]
    if isinstance(node, ast.Compare):
        node.ops[0] = EXCHANGED[type(node.ops[0])]()
    elif isinstance(node, ast.BinOp | ast.BoolOp | ast.UnaryOp | ast.AugAssign):
        node.op = EXCHANGED[type(node.op)]()
    elif isinstance(node, ast.Constant):
        node.value = not node.value if isinstance(node.value, bool) else node.value * 2 + 1
    elif isinstance(node, ast.If | ast.IfExp | ast.While):
        node.test = ast.UnaryOp(ast.Not(), node.test)
    else:
        body, k = statement_of(tree, node)
        body[k] = ast.Pass()


def write(copy: Path, path: str, tree: ast.Module) -> None:
    """Write a module into the copy of the package."""
    text = ast.unparse(ast.fix_missing_locations(tree))
    (copy / Path(path).relative_to("src")).write_text(text, encoding="utf-8")


def run_tests(copy: Path, notes: Path, arguments: list[str]) -> tuple[int, str]:
    """Run pytest on the copy: the exit status (1 where it takes too long) and the tests that fail."""
    environment = {"PYTHONPATH": str(copy), "MUTATION_REACHED": str(notes), "PYTHONDONTWRITEBYTECODE": "1"}
    environment["HYPOTHESIS_STORAGE_DIRECTORY"] = str(copy / "hypothesis")
    command = [*PYTEST, *arguments]
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=os.environ | environment, capture_output=True, text=True, timeout=TIMEOUT_S
        )
    except subprocess.TimeoutExpired:
        return 1, "no end"
    failed = [
        line.split(" - ")[0].split()[1] for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))
    ]
    return done.returncode, " ".join(failed) or done.stdout[-200:] * (done.returncode != 0)


def note_reached(copy: Path, drawn: list[Change], notes: Path, options: list[str]) -> None:
    """Note which test files run the statements of the changes, by one run of the default tests."""
    for path in {change.path for change in drawn}:
        tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
        nodes = list(ast.walk(tree))
        for number, change in enumerate(drawn):
            if change.path == path:
                body, k = statement_of(tree, nodes[change.place])
                body.insert(k, ast.parse(f"reached({number})").body[0])
        write(copy, path, tree)
    status, failed = run_tests(copy, notes, options)
    if status:
        sys.exit(f"the tests fail without a change: {failed}")
    for path in {change.path for change in drawn}:
        shutil.copyfile(ROOT / path, copy / Path(path).relative_to("src"))


def nearest_first(files: set[str], path: str) -> list[str]:
    """Sort test files: those named like the module, those of its folder, the unit tests, all others."""
    module = Path(path)
    return sorted(
        files, key=lambda file: (module.stem not in file, module.parts[2] not in file, "unit" not in file, file)
    )


def main() -> None:
    """Draw the changes, and print for each of them the test that catches it, or that it survives."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=40)
    parser.add_argument("--only", type=int, nargs="*", help="of these numbers alone")
    parser.add_argument("--reached", type=Path, help="a file that keeps which test files reach which change")
    arguments, options = parser.parse_known_args()  # what is left is for pytest
    modules = (path for folder in FOLDERS for path in (ROOT / "src" / "gridslam" / folder).rglob("*.py"))
    drawn = random.Random(arguments.seed).sample(
        [c for path in sorted(modules) for c in changes(path)], arguments.count
    )
    with tempfile.TemporaryDirectory() as folder:
        copy, notes = Path(folder), arguments.reached or Path(folder) / "reached"
        shutil.copytree(ROOT / "src" / "gridslam", copy / "gridslam")
        shutil.copy(backend.__file__, copy / "gridslam" / "kernels")
        (copy / "sitecustomize.py").write_text(SITE)
        if not notes.exists():
            note_reached(copy, drawn, notes, options)
        reached = [line.split() for line in notes.read_text().splitlines()]
        caught = 0
        numbers = range(len(drawn)) if arguments.only is None else arguments.only
        for number in numbers:
            change = drawn[number]
            files = {line[1] if line[1:] else "" for line in reached if line[0] == str(number)}
            files = {file for file in files if (ROOT / file).exists()}
            tree = ast.parse((ROOT / change.path).read_text(encoding="utf-8"))
            make_worse(tree, change)
            write(copy, change.path, tree)
            # What runs at import is reached by all tests.
            chosen = [] if "" in files else nearest_first(files, change.path)
            status, by = run_tests(copy, notes, [*options, "-x", *chosen]) if files else (0, "no test reaches it")
            shutil.copyfile(ROOT / change.path, copy / Path(change.path).relative_to("src"))
            caught += status != 0
            print(number, f"{change.path}:{change.line}", change.kind, by or "survives", flush=True)
        print(f"{caught} of {len(numbers)} caught")


if __name__ == "__main__":
    main()
