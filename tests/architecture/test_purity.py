"""Below the runner nothing prints, exits, reads files, looks at the clock or owns a random generator."""

from __future__ import annotations

import ast

import pytest
from house import IMPURE_FROM, RANKS, Source, sources

PURE = [source for source in sources() if RANKS.get(source.unit, IMPURE_FROM) < IMPURE_FROM]

MODULES = {
    "argparse", "asyncio", "atexit", "builtins", "datetime", "fileinput", "glob", "io", "logging", "multiprocessing",
    "os", "pathlib", "pickle", "random", "secrets", "shutil", "signal", "socket", "subprocess", "sys", "tempfile",
    "threading", "time", "uuid",
}  # fmt: skip
"""Modules of the standard library that are the way to the outside."""

CALLS = {"print", "input", "open", "exit", "quit", "breakpoint", "exec", "eval", "compile"}

NUMPY = {
    "fromfile", "genfromtxt", "load", "loadtxt", "memmap", "save", "savetxt", "savez", "savez_compressed", "tofile",
}  # fmt: skip
"""NumPy's own ways to files."""

ALLOWED = {
    ("errors.py", "pathlib"): "the type of the path that an error names",
    ("slam/loop_closure.py", "threading"): "imports aside what the first closure needs; nothing is computed by it",
    ("kernels/__init__.py", "os"): "an environment variable chooses the NumPy twins, before anything is computed",
}


def impurities(source: Source) -> list[str]:
    imported = ((line, name.partition(".")[0]) for line, name in source.imports())
    found = [(line, top) for line, top in imported if top in MODULES]
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


@pytest.mark.parametrize("source", PURE, ids=lambda source: source.path)
def test_pure(source):
    assert impurities(source) == []


def test_exceptions_are_still_needed():
    used = {(source.path, name.partition(".")[0]) for source in PURE for _, name in source.imports()}
    assert set(ALLOWED) <= used


@pytest.mark.parametrize(
    "text",
    [
        "print(1)", "open('a')", "import sys", "from time import perf_counter", "from os import environ", "exit()",
        "import numpy as np\nrng = np.random.default_rng(0)", "import numpy as np\nx = np.random.normal()",
        "import numpy as np\nnp.load('a')", "import random", "rng = np.random.Generator(bits)",
    ],
)  # fmt: skip
def test_an_impurity_is_seen(text):
    assert len(impurities(Source.of("grid/a.py", text))) == 1


def test_a_generator_may_be_an_argument():
    assert impurities(Source.of("grid/a.py", "def f(rng: np.random.Generator): return rng.random()")) == []
