"""What all tests share: the real logs, and what a run of the tests insists on."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

pytest.register_assert_rewrite("support.real_logs")

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # processes of tests that share the cores wait for each other else

settings.register_profile("tests", max_examples=40, deadline=None)  # other ones at each run; no test is timed
settings.load_profile("tests")

TESTS = Path(__file__).parent

TIERS = {
    "dev": (
        "contracts/test_docs.py::test_the_pages_build",
        "reference/test_graph_oracles.py",
    ),
    "browser": ("contracts/page/",),
    "ros": ("contracts/test_ros1_node.py",),
    "ros2": ("contracts/ros2/",),
    "long": ("long/", "fuzz/test_thousands_of_files.py"),
}
"""Tests of another tier than the default, by where they are."""

FIXTURES = {"data_dir": "real_logs", "mirror": "dev"}
"""The same by what they take: real logs, and a server of logs."""


IGNORED: dict[int, Any] = {signal.SIGINT: signal.default_int_handler}
"""Signals that a shell or nohup ignores for what runs in the background, and so for programs that the tests stop."""
if sys.platform != "win32":
    IGNORED[signal.SIGHUP] = signal.SIG_DFL


def pytest_configure(config: pytest.Config) -> None:
    """End at once where GRIDSLAM_REQUIRE_COMPILED=1 and the package runs on the NumPy twins."""
    for number, handler in IGNORED.items():
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, handler)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of missing kernels: told once, and tested elsewhere
        from gridslam.kernels import backend, compiled
    if os.environ.get("GRIDSLAM_REQUIRE_COMPILED") == "1" and not compiled:
        raise pytest.UsageError(f"expected the compiled kernels, got {backend.__file__}")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Give each process tests in the order of the files, so that what a file's tests share is made once."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log) if config.getoption("dist") == "load" else None


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out the files that have no test of the tier asked for: to collect them all takes each process 10 s."""
    tier = config.option.markexpr
    if collection_path.suffix != ".py" or tier not in (*TIERS, *FIXTURES.values()):
        return None
    path = collection_path.relative_to(TESTS).as_posix()
    by_path = any(path.startswith(own.partition("::")[0]) for own in TIERS.get(tier, ()))
    text = collection_path.read_text(encoding="utf-8")
    return None if by_path or any(of == tier and name in text for name, of in FIXTURES.items()) else True


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give every test the marker of its tier, unless it has the default's."""
    for item in items:
        path = f"{item.path.relative_to(TESTS).as_posix()}::{item.name}"
        for tier, paths in TIERS.items():
            if path.startswith(paths):
                item.add_marker(tier)
        for fixture in FIXTURES.keys() & set(getattr(item, "fixturenames", ())):
            item.add_marker(FIXTURES[fixture])


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real logs beside the project; absent ones skip, or fail where GRIDSLAM_REQUIRE_DATA=1."""
    path = Path(os.environ.get("GRIDSLAM_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
    if not path.is_dir():
        reason = f"real logs are not at {path} (set GRIDSLAM_DATA)"
        if os.environ.get("GRIDSLAM_REQUIRE_DATA") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    return path
