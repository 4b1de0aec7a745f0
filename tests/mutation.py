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
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from gridslam.kernels import backend

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("slam", "tracking", "grid", "localization", "io")
PYTEST = (sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--tb=no", "-rfE")
TIMEOUT_S = 1200

EXCHANGED = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.LShift: ast.RShift, ast.RShift: ast.LShift, ast.USub: ast.UAdd,
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
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


def make_worse(tree: ast.Module, change: Change) -> None:
    """Apply a change to the tree of its module."""
    node = list(ast.walk(tree))[change.place]
    if change.kind == "comparison":
        node.ops[0] = EXCHANGED[type(node.ops[0])]()
    elif change.kind == "operator":
        node.op = EXCHANGED[type(node.op)]()
    elif change.kind == "constant":
        node.value = not node.value if isinstance(node.value, bool) else node.value * 2 + 1
    elif change.kind == "condition":
        node.test = ast.UnaryOp(ast.Not(), node.test)
    else:
        body, k = statement_of(tree, node)
        body[k] = ast.Pass()


def statement_of(tree: ast.Module, node: ast.AST) -> tuple[list[ast.stmt], int]:
    """Return the innermost statement that holds a node, as a list of statements and an index."""
    bodies = (getattr(outer, name, None) for outer in ast.walk(tree) for name in ("body", "orelse", "finalbody"))
    lists = [body for body in bodies if isinstance(body, list)]
    return [(body, k) for body in lists for k, part in enumerate(body) if node in ast.walk(part)][-1]


class Copy:
    """A copy of the package, in which modules are changed and on which tests run."""

    def __init__(self, folder: Path, reached: Path, options: Sequence[str]) -> None:
        self.folder, self.reached, self.options = folder, reached, options
        shutil.copytree(ROOT / "src" / "gridslam", folder / "gridslam")
        shutil.copy(backend.__file__, folder / "gridslam" / "kernels")
        (folder / "sitecustomize.py").write_text(SITE, encoding="utf-8")

    def write(self, path: str, tree: ast.Module | None = None) -> None:
        """Write a module from its tree, or as it was."""
        text = ast.unparse(ast.fix_missing_locations(tree)) if tree else (ROOT / path).read_text(encoding="utf-8")
        (self.folder / Path(path).relative_to("src")).write_text(text, encoding="utf-8")

    def run_tests(self, *arguments: str) -> str:
        """Run pytest on the copy and return what has failed, or an empty text."""
        environment = {"PYTHONPATH": str(self.folder), "PYTHONDONTWRITEBYTECODE": "1"}
        environment |= {
            "MUTATION_REACHED": str(self.reached),
            "HYPOTHESIS_STORAGE_DIRECTORY": f"{self.folder}/examples",
        }
        command = [*PYTEST, *self.options, *arguments]
        environment = os.environ | environment
        try:
            done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S)
        except subprocess.TimeoutExpired:
            return "no end"
        lines = [line.split() for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
        return " ".join(line[1] for line in lines) or (done.stdout[-200:] if done.returncode else "")

    def note_reached(self, drawn: Sequence[Change]) -> None:
        """Note which test files run the statements of the changes, by one run of the default tests."""
        for path in {change.path for change in drawn}:
            tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
            nodes = list(ast.walk(tree))
            for number, change in enumerate(drawn):
                if change.path == path:
                    body, k = statement_of(tree, nodes[change.place])
                    body.insert(k, ast.parse(f"reached({number})").body[0])
            self.write(path, tree)
        if failed := self.run_tests():
            sys.exit(f"the tests fail without a change: {failed}")
        for path in {change.path for change in drawn}:
            self.write(path)

    def find_failing(self, change: Change, files: set[str]) -> str:
        """Return the test that catches a change, among the files that reach it (all for "", at import)."""
        if not files:
            return ""
        tree = ast.parse((ROOT / change.path).read_text(encoding="utf-8"))
        make_worse(tree, change)
        self.write(change.path, tree)
        failed = self.run_tests("-x", *([] if "" in files else nearest_first(files, Path(change.path))))
        self.write(change.path)
        return failed


def nearest_first(files: set[str], module: Path) -> list[str]:
    """Sort test files: those named like the module, those of its folder, the unit tests, all others."""
    return sorted(
        files, key=lambda file: (module.stem not in file, module.parts[2] not in file, "unit" not in file, file)
    )


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
        copy = Copy(Path(folder), (arguments.reached or Path(folder) / "reached").resolve(), options)
        if not copy.reached.exists():
            copy.note_reached(drawn)
        files = defaultdict(set)
        for line in copy.reached.read_text(encoding="utf-8").splitlines():
            number, _, file = line.partition(" ")
            if (ROOT / file).exists():
                files[int(number)].add(file)
        caught = 0
        for number in numbers:
            change = drawn[number]
            failed = copy.find_failing(change, files[number])
            caught += bool(failed)
            print(number, f"{change.path}:{change.line}", change.kind, failed or "survives", flush=True)
        print(f"{caught} of {len(numbers)} caught")


if __name__ == "__main__":
    main()
