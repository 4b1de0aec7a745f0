"""The rules that hold file by file, as a linter: python tests/house_rules.py.

A module imports only lower ranks or its own folder, inside slam, io and ros by the ranks of their folders, never in a
circle, and of others' work only what the project declares, where it belongs.
Below the runner nothing prints, exits, reads files, looks at the clock or owns a random generator.
"""

from __future__ import annotations

import ast
import sys

from support.house import IMPURE_FROM, INNER_RANKS, RANKS, Source, find_cycle, sources

ONLY_IN = {
    "click": {"cli"},
    "rich": {"cli"},
    "PIL": {"io", "viz", "plan"},
    "tomli": {"config"},
    "tomli_w": {"config"},
    "pydantic": set(RANKS),
    "pydantic_core": {"parameters", "config"},
    "numpy": set(RANKS),
    "scipy": {"slam", "localization", "evaluation", "tuning", "plan"},
    "optuna": {"tuning"},
    "qdldl": {"slam"},
    "rosbags": {"io"},
    "lz4": {"io"},
    "ruamel": {"io"},
    "starlette": {"live"},
    "uvicorn": {"live"},
    "websockets": set(),
    "contourpy": {"plan"},
    "shapely": {"plan"},
}
"""Who may import which dependency: help must not pay for drawing, nor the filter for a terminal."""

OUTSIDE = {
    "argparse",
    "asyncio",
    "atexit",
    "builtins",
    "datetime",
    "fileinput",
    "glob",
    "io",
    "logging",
    "multiprocessing",
    "os",
    "pathlib",
    "pickle",
    "random",
    "secrets",
    "shutil",
    "signal",
    "socket",
    "subprocess",
    "sys",
    "tempfile",
    "threading",
    "time",
    "uuid",
}
"""Modules of the standard library that are the way to the outside."""

CALLS = {"print", "input", "open", "exit", "quit", "breakpoint", "exec", "eval", "compile"}

NUMPY = {
    "fromfile",
    "genfromtxt",
    "load",
    "loadtxt",
    "memmap",
    "save",
    "savetxt",
    "savez",
    "savez_compressed",
    "tofile",
}
"""NumPy's own ways to files."""

ALLOWED = {
    ("errors.py", "pathlib"): "the type of the path that an error names",
    ("kernels/__init__.py", "os"): "an environment variable chooses the NumPy twins, before anything is computed",
}


def upward(source: Source) -> list[str]:
    """Imports of a module that do not go down."""
    found = []
    for line, name in source.imports():
        top, _, rest = name.partition(".")
        if top != "gridslam" or rest == "__version__":
            continue
        unit, _, inner = rest.partition(".")
        if unit != source.unit:
            found += _ascent(source, line, name, RANKS, (source.unit, unit))
        elif unit in INNER_RANKS and source.inner_unit:
            found += _ascent(source, line, name, INNER_RANKS[unit], (source.inner_unit, inner.partition(".")[0]))
    return found


def _ascent(source: Source, line: int, name: str, ranks: dict[str, int], units: tuple[str, str]) -> list[str]:
    """What is wrong with an import of the second unit by the first."""
    own, other = units
    lacking = [unit for unit in units if unit not in ranks]
    if lacking:
        return [f"{source.path}:{line}: {name}: {lacking[0] or source.unit} has no rank"]
    if own != other and ranks[other] >= ranks[own]:
        return [f"{source.path}:{line}: {own} ({ranks[own]}) imports {other} ({ranks[other]})"]
    return []


def misplaced(source: Source) -> list[str]:
    """Imports of others' work where it does not belong."""
    found = []
    for line, name in source.imports():
        top = name.partition(".")[0]
        known = top in sys.stdlib_module_names or top == "gridslam" or (source.unit, top) == ("config", "tomllib")
        if not known and source.unit not in ONLY_IN.get(top, set()):
            found.append(f"{source.path}:{line}: {source.unit} imports {top}")
    return found


def impurities(source: Source) -> list[str]:
    """What a module does that reaches outside."""
    imported = ((line, name.partition(".")[0]) for line, name in source.imports())
    found = [(line, top) for line, top in imported if top in OUTSIDE]
    for node in ast.walk(source.tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in CALLS:
            found.append((node.lineno, node.func.id))
        elif isinstance(node, ast.Attribute) and node.attr in NUMPY:
            found.append((node.lineno, node.attr))
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute) and node.value.attr == "random":
            if node.attr != "Generator":  # the type of an argument, never made here
                found.append((node.lineno, f"random.{node.attr}"))
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "Generator":
            found.append((node.lineno, "Generator()"))
    return [f"{source.path}:{line}: {what}" for line, what in found if (source.path, what) not in ALLOWED]


def is_pure(source: Source) -> bool:
    """Whether a module is of a rank that must not reach outside."""
    return RANKS.get(source.unit, IMPURE_FROM) < IMPURE_FROM


def violations(source: Source) -> list[str]:
    """All that is wrong with a module."""
    if source.path == "__init__.py":  # names alone, each loaded when it is used
        return []
    if source.unit not in RANKS:
        return [f"{source.path}: {source.unit} has no rank"]
    return [*upward(source), *misplaced(source), *(impurities(source) if is_pure(source) else [])]


def main() -> int:
    """Print what is wrong; gives the exit status."""
    modules = sources()
    found = [violation for source in modules for violation in violations(source)]
    cycle = find_cycle(modules)
    if cycle:
        found.append(f"a circle of imports: {' -> '.join(cycle)}")
    print("\n".join(found) if found else "the house's rules hold")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
