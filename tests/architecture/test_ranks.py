"""A module imports only lower ranks or its own folder, and of others' work only what the project declares."""

from __future__ import annotations

import re
import sys

import pytest
from house import RANKS, ROOT, Source, sources

MODULES = [source for source in sources() if source.path != "__init__.py"]

ONLY_IN = {
    "click": {"cli"},
    "rich": {"cli"},
    "PIL": {"io", "viz"},
    "tomli": {"config"},
    "tomli_w": {"config"},
    "pydantic": set(RANKS),
    "numpy": set(RANKS),
    "scipy": {"slam"},
    "qdldl": {"slam"},
    "rosbags": {"io"},
    "lz4": {"io"},
    "pooch": {"io"},
    "starlette": {"live"},
    "uvicorn": {"live"},
    "websockets": set(),
    "pandas": {"api"},
}
"""Who may import which dependency: help must not pay for drawing, nor the filter for a terminal."""


EXTRAS = {"pooch", "pandas"}
"""Of these, what is installed on demand."""

UNSEEN = {"backports"}
"""Declared, and imported by a name that depends on Python's version."""


def violations(source: Source) -> list[str]:
    found = []
    for line, name in source.imports():
        top, _, rest = name.partition(".")
        if top != "gridslam" or rest == "__version__":
            continue
        unit = rest.partition(".")[0]
        if unit not in RANKS:
            found.append(f"{source.path}:{line}: {name} has no rank")
        elif unit != source.unit and RANKS[unit] >= RANKS[source.unit]:
            found.append(f"{source.path}:{line}: {source.unit} ({RANKS[source.unit]}) imports {unit} ({RANKS[unit]})")
    return found


def test_every_folder_and_module_has_a_rank():
    assert {source.unit for source in MODULES} <= set(RANKS)


@pytest.mark.parametrize("source", MODULES, ids=lambda source: source.path)
def test_imports_go_down(source):
    assert violations(source) == []


def test_the_package_itself_imports_nothing_but_names():
    (root,) = (source for source in sources() if source.path == "__init__.py")
    at_once = [name for line, name in root.imports() if not re.match(r"\s", root.text.splitlines()[line - 1])]
    assert set(at_once) <= {"__future__.annotations", "importlib.import_module", "typing.TYPE_CHECKING"}


@pytest.mark.parametrize("source", MODULES, ids=lambda source: source.path)
def test_dependencies_are_imported_where_they_belong(source):
    for line, name in source.imports():
        top = name.partition(".")[0]
        if top not in sys.stdlib_module_names and top != "gridslam" and (source.unit, top) != ("config", "tomllib"):
            assert source.unit in ONLY_IN.get(top, set()), f"{source.path}:{line}: {source.unit} imports {top}"


def test_dependencies_are_declared():
    declared = re.search(r"^dependencies = \[(.*?)^\]", (ROOT / "pyproject.toml").read_text(), re.DOTALL | re.MULTILINE)
    names = {name.lower().replace("-", "_") for name in re.findall(r'"([A-Za-z0-9_-]+)', declared[1])}
    assert {{"PIL": "pillow"}.get(name, name) for name in ONLY_IN.keys() - EXTRAS} == names - UNSEEN


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("grid/a.py", "from gridslam.slam import tracker"),
        ("grid/a.py", "def f():\n    import gridslam.particles.weights"),
        ("grid/a.py", "from gridslam import models"),
        ("slam/a.py", "from gridslam.evaluation import map"),
        ("io/a.py", "from gridslam.utils import anything"),
    ],
)
def test_a_violation_is_seen(path, text):
    assert len(violations(Source.of(path, text))) == 1
