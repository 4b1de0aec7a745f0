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
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from gridslam.kernels import backend

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("slam", "tracking", "grid", "localization", "io")
TIMEOUT_S = 1200

_PAIRS = [
    (ast.Add, ast.Sub), (ast.BitAnd, ast.BitOr), (ast.LShift, ast.RShift), (ast.Lt, ast.LtE), (ast.Gt, ast.GtE),
    (ast.Eq, ast.NotEq), (ast.Is, ast.IsNot), (ast.In, ast.NotIn), (ast.And, ast.Or), (ast.Mult, ast.Div),
]  # fmt: skip
EXCHANGED = {ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.USub: ast.UAdd, **dict(_PAIRS)}
EXCHANGED |= {second: first for first, second in _PAIRS}

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

    def worse(self) -> str:
        """The module's text with the change."""
        tree = ast.parse((ROOT / self.path).read_text(encoding="utf-8"))
        node = list(ast.walk(tree))[self.place]
        if self.kind == "comparison":
            node.ops[0] = EXCHANGED[type(node.ops[0])]()
        elif self.kind == "operator":
            node.op = EXCHANGED[type(node.op)]()
        elif self.kind == "constant":
            node.value = not node.value if isinstance(node.value, bool) else node.value * 2 + 1
        elif self.kind == "condition":
            node.test = ast.UnaryOp(ast.Not(), node.test)
        else:
            body, k = find_statement(tree, node)
            body[k] = ast.Pass()
        return ast.unparse(ast.fix_missing_locations(tree))


def find_statement(tree: ast.Module, node: ast.AST) -> tuple[list[ast.stmt], int]:
    """Return the innermost statement that holds a node, as a list of statements and an index."""
    bodies = (getattr(outer, name, None) for outer in ast.walk(tree) for name in ("body", "orelse", "finalbody"))
    lists = [body for body in bodies if isinstance(body, list)]
    return [(body, k) for body in lists for k, part in enumerate(body) if node in ast.walk(part)][-1]


def find_changes(path: Path) -> Iterator[Change]:
    """Yield every change of a module but those of annotations, messages and imports."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    ignored: set[ast.AST] = set()
    for node in nodes:
        parts = [getattr(node, "annotation", None), getattr(node, "returns", None)]
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.MatchValue | ast.Import | ast.ImportFrom):
            parts.append(node)
        ignored.update(inner for part in parts if part for inner in ast.walk(part))
    for place, node in enumerate(nodes):
        kind = None if node in ignored else classify(node)
        if kind:
            yield Change(path.relative_to(ROOT).as_posix(), node.lineno, kind, place)


def classify(node: ast.AST) -> str | None:
    """Return what can be changed for the worse at a node, if anything can."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in EXCHANGED:
        return "comparison"
    if isinstance(node, ast.BinOp | ast.BoolOp | ast.UnaryOp | ast.AugAssign) and type(node.op) in EXCHANGED:
        return "operator"
    if isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
        return "constant"
    if isinstance(node, ast.If | ast.IfExp | ast.While):
        return "condition"
    is_kept = isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Attribute | ast.Subscript)
    return "statement" if is_kept or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)) else None


def note_reached(drawn: Sequence[Change], path: str) -> str:
    """The text of a module that notes each of the changed statements where it runs."""
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    nodes = list(ast.walk(tree))
    for number, change in enumerate(drawn):
        if change.path == path:
            body, k = find_statement(tree, nodes[change.place])
            body.insert(k, ast.parse(f"reached({number})").body[0])
    return ast.unparse(ast.fix_missing_locations(tree))


def run_tests(copy: Path, reached: Path, texts: dict[str, str], arguments: Sequence[str]) -> str:
    """Run pytest on the copy with other texts of some modules, and return what has failed, or an empty text."""
    environment = {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1", "MUTATION_REACHED": str(reached)}
    environment["HYPOTHESIS_STORAGE_DIRECTORY"] = f"{copy}/examples"
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--tb=no", "-rfE", *arguments]
    for path, text in texts.items():
        (copy / Path(path).relative_to("src")).write_text(text, encoding="utf-8")
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=os.environ | environment, capture_output=True, text=True, timeout=TIMEOUT_S
        )
    except subprocess.TimeoutExpired:
        return "no end"
    finally:
        for path in texts:
            shutil.copy(ROOT / path, copy / Path(path).relative_to("src"))
    lines = [line.split() for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return " ".join(line[1] for line in lines) or (done.stdout[-200:] if done.returncode else "")


def main() -> None:
    """Draw the changes, and print for each of them the test that catches it, or that it survives."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=40)
    parser.add_argument("--only", type=int, nargs="*", help="numbers of the changes to apply")
    parser.add_argument("--reached", type=Path, help="file that keeps which test files reach which change")
    arguments, options = parser.parse_known_args()
    modules = (path for folder in FOLDERS for path in (ROOT / "src" / "gridslam" / folder).rglob("*.py"))
    found = [change for path in sorted(modules) for change in find_changes(path)]
    drawn = random.Random(arguments.seed).sample(found, arguments.count)
    numbers = range(len(drawn)) if arguments.only is None else arguments.only
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        shutil.copytree(ROOT / "src" / "gridslam", copy / "gridslam")
        shutil.copy(backend.__file__, copy / "gridslam" / "kernels")
        (copy / "sitecustomize.py").write_text(SITE, encoding="utf-8")
        reached = (arguments.reached or copy / "reached").resolve()
        texts = {change.path: note_reached(drawn, change.path) for change in drawn}
        if not reached.exists() and (failed := run_tests(copy, reached, texts, options)):
            sys.exit(f"the tests fail without a change: {failed}")
        lines = [line.partition(" ") for line in reached.read_text(encoding="utf-8").splitlines()]
        caught = 0
        for number in numbers:
            path = drawn[number].path
            files = {file for own, _, file in lines if int(own) == number and (ROOT / file).exists()}
            near = lambda file: (Path(path).stem not in file, path.split("/")[2] not in file, "unit" not in file, file)  # noqa: B023, E731
            chosen = [] if "" in files else sorted(files, key=near)  # reached at import: all tests
            failed = files and run_tests(copy, reached, {path: drawn[number].worse()}, ["-x", *options, *chosen])
            caught += bool(failed)
            print(number, f"{path}:{drawn[number].line}", drawn[number].kind, failed or "survives", flush=True)
        print(f"{caught} of {len(numbers)} caught")


if __name__ == "__main__":
    main()
