"""The package's sources, read but not imported."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "gridslam"


RANKS = {
    "errors": 0,
    "arguments": 1,
    "serialization": 1,
    "geometry": 1,
    "scan": 2,
    "types": 3,
    "kernels": 3,
    "grid": 4,
    "particles": 4,
    "models": 5,
    "matching": 5,
    "mapping": 6,
    "localization": 7,
    "slam": 7,
    "evaluation": 7,
    "config": 8,
    "observers": 8,
    "pipeline": 8,
    "io": 9,
    "transforms": 8,
    "doctor": 10,
    "sim": 10,
    "viz": 11,
    "api": 12,
    "live": 12,
    "ros": 13,
    "cli": 14,
}
"""Rank of each folder and of each single module of the package: it imports lower ranks and itself, nothing else."""

IMPURE_FROM = RANKS["config"]
"""From this rank on modules may print, exit, read files, look at the clock and own a random generator."""


@dataclass(frozen=True)
class Source:
    """A module: its path below the package, as posix text, and its syntax tree."""

    path: str
    text: str
    tree: ast.Module

    @classmethod
    def of(cls, path: str, text: str) -> Source:
        """Read a module's text."""
        return cls(path, text, ast.parse(text))

    @property
    def unit(self) -> str:
        """The folder or the single module directly below the package that this belongs to."""
        return self.path.partition("/")[0].removesuffix(".py")

    def imports(self) -> list[tuple[int, str]]:
        """Line and dotted name of everything imported anywhere in the module, each imported name by itself."""
        found = []
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                found += [(node.lineno, alias.name) for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{self.path}:{node.lineno}: relative import"
                found += [(node.lineno, f"{node.module}.{alias.name}") for alias in node.names]
        return found


def sources() -> list[Source]:
    """All modules of the package."""
    paths = sorted(PACKAGE.rglob("*.py"))
    texts = [(path.relative_to(PACKAGE).as_posix(), path.read_text(encoding="utf-8")) for path in paths]
    return [Source.of(path, text) for path, text in texts]
