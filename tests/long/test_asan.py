"""The kernels touch no memory but their own: their tests once more, under AddressSanitizer and UBSan."""

import importlib.util
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "asan.sh"


@pytest.mark.skipif(platform.system() != "Linux", reason="the sanitizer is preloaded the way Linux does it")
@pytest.mark.skipif(importlib.util.find_spec("nanobind") is None, reason="nanobind, a tool of the build, is missing")
@pytest.mark.skipif(
    shutil.which("cmake", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}") is None,
    reason="cmake, a tool of the build, is missing",
)
def test_kernels_under_sanitizers():
    done = subprocess.run(
        [str(SCRIPT)], env={**os.environ, "PYTHON": sys.executable}, capture_output=True, text=True, timeout=1200
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert " passed" in done.stdout
