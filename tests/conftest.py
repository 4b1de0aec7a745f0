"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


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
