"""The greatest memory of a process, told by each system in its own way."""

import sys
from pathlib import Path

import numpy as np
import pytest

from gridslam.api.peak_memory import find_peak_memory_bytes

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="it is not measured there")


def test_it_grows_with_what_is_held():
    before = find_peak_memory_bytes()
    assert before > 10_000_000  # Python with NumPy
    held = np.ones(before // 8 + 10_000_000)
    assert find_peak_memory_bytes() >= held.nbytes


def test_without_proc_the_resources_tell_it(monkeypatch):
    def absent(self, encoding):
        raise FileNotFoundError(self)

    monkeypatch.setattr(Path, "read_text", absent)
    assert find_peak_memory_bytes() > 10_000_000
