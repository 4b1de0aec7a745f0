"""The package's sources, read but not imported."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "gridslam"


RANKS = {
    "errors": -2,
    "arguments": -1,
    "checked": 0,
    "parameters": 1,
    "serialization": 1,
    "geometry": 1,
    "scan": 2,
    "types": 3,
    "kernels": 1,
    "grid": 4,
    "particles": 4,
    "models": 5,
    "matching": 5,
    "mapping": 6,
    "tracking": 7,
    "localization": 8,
    "slam": 8,
    "evaluation": 8,
    "config": 9,
    "messages": 9,
    "observers": 9,
    "pipeline": 9,
    "transforms": 9,
    "io": 10,
    "doctor": 11,
    "sim": 11,
    "viz": 12,
    "api": 13,
    "live": 13,
    "plan": 14,
    "ros": 14,
    "batch": 14,
    "tuning": 15,
    "cli": 16,
    "__main__": 17,
}
"""Rank of each folder and of each single module of the package: it imports lower ranks and itself, nothing else."""

INNER_RANKS = {
    "slam": {
        "pose_graph": 0,
        "loop_closure": 1,
        "landmarks": 1,
        "grid_fastslam": 2,
        "full_slam": 3,
    },
    "io": {
        "limits": -1,
        "read_ahead": -1,
        "measurement": 0,
        "output": 0,
        "text": 0,
        "database": 0,
        "images": 1,
        "turned_maps": 1,
        "yaml": 0,
        "datasets": 1,
        "log_statistics": 1,
        "geojson": 0,
        "edits": 1,
        "even_beams": 0,
        "maps": 2,
        "edited_maps": 3,
        "sessions": 2,
        "ros_parameters": 1,
        "tables": 1,
        "carmen": 2,
        "csv": 3,
        "foreign_scans": 2,
        "g2o": 2,
        "landmark_logs": 2,
        "landmarks": 2,
        "selection": 2,
        "trajectories": 2,
        "bags": 3,
        "log": 4,
    },
    "ros": {
        "node": 0,
        "ros1": 1,
        "ros2": 1,
    },
}
"""The same inside a folder that holds folders; its own `__init__` may import them all."""

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
    def name(self) -> str:
        """Dotted name of the module; that of its folder if it is an `__init__`."""
        return ".".join(["gridslam", *self.path.removesuffix(".py").split("/")]).removesuffix(".__init__")

    @property
    def unit(self) -> str:
        """The folder or the single module directly below the package that this belongs to."""
        return self.path.partition("/")[0].removesuffix(".py")

    @property
    def inner_unit(self) -> str:
        """The same directly below that folder; empty for the folder's `__init__` and for a single module."""
        return "".join(self.name.split(".")[2:3])

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


def find_cycle(modules: list[Source]) -> list[str]:
    """Names of modules that import each other in a circle, lazily or for types included; none if there is none."""
    names = {module.name for module in modules}
    graph = {}
    for module in modules:
        found = {name if name in names else name.rpartition(".")[0] for _, name in module.imports()}
        graph[module.name] = found & names - {module.name}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        circle: list[str] = error.args[1]
        return circle
    return []
