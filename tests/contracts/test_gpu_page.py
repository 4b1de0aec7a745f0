"""The page on a backend for a GPU names kernels that there are."""

from __future__ import annotations

import re
from pathlib import Path

from gridslam.kernels import backend, reference

_PAGE = Path(__file__).resolve().parents[2] / "docs" / "gpu.md"


def test_the_kernels_of_the_table_exist():
    rows = [line.split("|") for line in _PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    named = {name for row in rows if len(row) == 5 for name in re.findall(r"`(\w+)`", row[2])}
    functions = named - {"poses"}
    assert "sum_at_ends" in functions
    assert functions <= set(reference.__all__)
    assert all(callable(getattr(backend, name)) for name in functions)
