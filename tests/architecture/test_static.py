"""The linter and the strict type checker find nothing."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from house import ROOT


def check(*tool: str) -> None:
    done = subprocess.run([sys.executable, "-m", *tool], cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr


def test_linter():
    check("ruff", "check", "--no-cache", ".")


@pytest.mark.skipif(
    tuple(int(part) for part in np.__version__.split(".")[:2]) < (2, 4),
    reason="the types that NumPy declares for its own functions changed until 2.4",
)
def test_type_checker():
    check("mypy")
