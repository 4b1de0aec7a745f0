"""The linter of the house sees what breaks its rules; what it checks file by file, `house_rules.py` itself runs."""

import re

import pytest

from house_rules import ALLOWED, ONLY_IN, impurities, is_pure, misplaced, upward, violations
from support.house import PACKAGE, ROOT, Source, find_cycle, sources

EXTRAS = {"contourpy", "optuna", "shapely"}
"""Of the dependencies, what is installed on demand."""

UNSEEN = {"backports"}
"""Declared, and imported by a name that depends on Python's version."""


def test_the_package_itself_imports_nothing_but_names():
    root = Source.of("__init__.py", (PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    at_once = [name for line, name in root.imports() if not re.match(r"\s", root.text.splitlines()[line - 1])]
    assert set(at_once) <= {"__future__.annotations", "importlib.import_module", "typing.TYPE_CHECKING"}


def test_dependencies_are_declared():
    declared = re.search(r"^dependencies = \[(.*?)^\]", (ROOT / "pyproject.toml").read_text(), re.DOTALL | re.MULTILINE)
    names = {name.lower().replace("-", "_") for name in re.findall(r'"([A-Za-z0-9_-]+)', declared[1])}
    assert {
        {"PIL": "pillow", "pydantic_core": "pydantic"}.get(name, name) for name in ONLY_IN.keys() - EXTRAS
    } == names - UNSEEN


def test_exceptions_are_still_needed():
    pure = [source for source in sources() if is_pure(source)]
    used = {(source.path, name.partition(".")[0]) for source in pure for _, name in source.imports()}
    assert set(ALLOWED) <= used


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("grid/a.py", "from gridslam.slam import tracker"),
        ("grid/a.py", "def f():\n    import gridslam.particles.resampling"),
        ("grid/a.py", "from gridslam import models"),
        ("slam/a.py", "from gridslam.evaluation import maps"),
        ("io/a.py", "from gridslam.utils import anything"),
        ("slam/pose_graph/a.py", "from gridslam.slam.loop_closure.loop_closure import LoopClosure"),
        ("slam/loop_closure/a.py", "def f():\n    from gridslam.slam.full_slam import full_slam"),
        ("slam/utils/a.py", "from gridslam.slam.pose_graph.robust import solve"),
        ("slam/pose_graph/a.py", "from gridslam.slam import GridFastSlam"),
    ],
)
def test_an_import_that_does_not_go_down_is_seen(path, text):
    assert len(upward(Source.of(path, text))) == 1


def test_an_import_that_goes_down_or_stays_is_not():
    text = "from gridslam.slam.pose_graph import a\nfrom gridslam.slam.full_slam.a import b\nimport gridslam.grid.tiles"
    assert upward(Source.of("slam/full_slam/c.py", text)) == []


def test_a_circle_of_imports_is_seen():
    modules = [
        Source.of("slam/a.py", "from gridslam.slam.b import f"),
        Source.of("slam/b.py", "def f():\n    from gridslam.slam import c"),
        Source.of("slam/c.py", "if TYPE_CHECKING:\n    from gridslam.slam.a import A"),
        Source.of("slam/d.py", "import gridslam.slam.a"),
    ]
    circle = find_cycle(modules)
    assert circle[0] == circle[-1]
    assert set(circle) == {"gridslam.slam.a", "gridslam.slam.b", "gridslam.slam.c"}
    assert find_cycle(modules[1:]) == []


def test_a_dependency_where_it_does_not_belong_is_seen():
    assert len(misplaced(Source.of("grid/a.py", "import rich\nimport numpy\nimport math"))) == 1


def test_a_folder_without_a_rank_is_seen():
    assert violations(Source.of("utils/a.py", "")) == ["utils/a.py: utils has no rank"]


@pytest.mark.parametrize(
    "text",
    [
        "print(1)",
        "open('a')",
        "import sys",
        "from time import perf_counter",
        "from os import environ",
        "exit()",
        "import numpy as np\nrng = np.random.default_rng(0)",
        "import numpy as np\nx = np.random.normal()",
        "import numpy as np\nnp.load('a')",
        "import random",
        "rng = np.random.Generator(bits)",
    ],
)
def test_an_impurity_is_seen(text):
    assert len(impurities(Source.of("grid/a.py", text))) == 1


def test_a_generator_may_be_an_argument():
    assert impurities(Source.of("grid/a.py", "def f(rng: np.random.Generator): return rng.random()")) == []
