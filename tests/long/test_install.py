"""The package installs without a compiler: it runs on the NumPy twins, and says so once."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
WITHOUT_COMPILER = {"CC": "/nonexistent", "CXX": "/nonexistent"}


def run(*command: str | Path, cwd: Path | None = None, **environment: str) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "GRIDSLAM_KERNELS")}
    done = subprocess.run(
        command, cwd=cwd, env=kept | environment, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of programs of a fresh virtual environment that has the package, installed without a compiler."""
    folder = tmp_path_factory.mktemp("without_compiler") / "venv"
    run(sys.executable, "-m", "venv", folder)
    run(folder / "bin" / "pip", "install", "--no-cache-dir", ROOT, **WITHOUT_COMPILER)
    return folder / "bin"


def test_it_installs(installed):
    assert run(installed / "gridslam", "--version").stdout.startswith("gridslam ")


def test_the_twins_map_a_log_and_say_once_that_they_are_slow(installed, tmp_path):
    log, out = tmp_path / "log.clf", tmp_path / "out"
    run(installed / "gridslam", "simulate", "rooms", "-o", log, "--duration", "4", "--beams", "60")
    done = run(installed / "gridslam", "map", log, "-o", out, "--particles", "2")
    assert done.stderr.count("without its compiled kernels") == 1
    assert '"kernels": "reference"' in (out / "run.json").read_text()
    assert len((out / "trajectory.tum").read_text().splitlines()) == 21  # 4 s at 5 Hz, both ends included


@pytest.fixture(scope="module")
def sdist(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source distribution."""
    folder = tmp_path_factory.mktemp("sdist")
    run(installed / "pip", "install", "scikit-build-core")
    build = "import sys; from scikit_build_core.build import build_sdist; build_sdist(sys.argv[1])"
    run(installed / "python", "-c", build, folder, cwd=ROOT)
    return next(folder.glob("*.tar.gz"))


def test_the_source_distribution_holds_the_kernels(sdist):
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"CMakeLists.txt", "LICENSE", "README.md", "pyproject.toml", "src/gridslam/kernels/update.cpp"} <= names
    assert not [name for name in names if name.startswith(("build", "reports", ".venv"))]


def test_the_wheel_holds_types_and_the_kernels_but_not_their_sources(installed, sdist, tmp_path):
    run(installed / "pip", "wheel", "--no-deps", "--no-cache-dir", "--wheel-dir", tmp_path, sdist)
    names = zipfile.ZipFile(next(tmp_path.glob("*.whl"))).namelist()
    assert "gridslam/py.typed" in names
    assert [name for name in names if name.startswith("gridslam/kernels/_compiled")]
    assert not [name for name in names if name.endswith((".cpp", ".hpp"))]
