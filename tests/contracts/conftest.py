"""A short simulated log, shared by the tests of what users see."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from gridslam.cli.main import main
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.trajectories import write_tum
from gridslam.models.landmark import RelativePosition
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate
from gridslam.types import Trajectory
from support.landmark_world import MOTION, drive, ring
from support.loops import loop_drive

SCANS = 120


@pytest.fixture
def call(capsys, monkeypatch):
    """Run the command line: exit status, standard output and standard error.

    Lines of progress, which a busy machine adds after seconds, are not printed: standard error has warnings alone.
    """
    monkeypatch.setattr("gridslam.cli.output._LINE_EVERY_S", math.inf)

    def run(*arguments):
        status = main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return status, out, err

    return run


@pytest.fixture(scope="session")
def simulated() -> SimulatedLog:
    rng = np.random.default_rng(5)
    return simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(), rng)


@pytest.fixture(scope="session")
def log(simulated: SimulatedLog, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first 120 scans (24 s, some 12 m); the truth lies beside it as truth.tum."""
    path = tmp_path_factory.mktemp("log") / "rooms.clf.bz2"
    write_carmen(path, simulated.measurements[:SCANS])
    truth = Trajectory(simulated.truth.stamps_ns[:SCANS], simulated.truth.poses[:SCANS])
    write_tum(path.with_name("truth.tum"), truth)
    return path


@pytest.fixture(scope="session")
def loop_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive that comes back to where it was."""
    path = tmp_path_factory.mktemp("loop") / "loop.clf.gz"
    write_carmen(path, loop_drive().measurements)
    return path


@pytest.fixture(scope="session")
def park(tmp_path_factory):
    """A log in Victoria Park's form: once around a ring of 10 landmarks, seen with 5 cm of noise."""
    path, sensor = tmp_path_factory.mktemp("park") / "ring.txt", RelativePosition(sigma_x_m=0.05, sigma_y_m=0.05)
    steps, truth = drive(ring(10), 140, np.random.default_rng(1), sensor)
    covariance = MOTION(steps[0].increment).moments(np.zeros((1, 3)))[1][0]
    spread = " ".join(f"{v:.9g}" for v in covariance[np.triu_indices(3)])
    lines = []
    for k, step in enumerate(steps):
        x, y, theta = step.increment
        lines.append(f"ODOMETRY {k} {k + 1} {x} {y} {theta} {spread}")
        for name, (a, b) in zip(step.observations.landmarks.tolist(), step.observations.values.tolist(), strict=True):
            lines.append(f"LANDMARK {k + 1} {name + 1000} {a:.6f} {b:.6f} 0.0025 0 0.0025")
    path.write_text("\n".join(lines) + "\n")
    return path, truth


class Site(NamedTuple):
    """The pages as HTML, and what their build says is wrong."""

    html: Path
    errors: str


@pytest.fixture(scope="session")
def site(tmp_path_factory) -> Site:
    """The pages, built once for all processes of a run of the tests."""
    for needed in ("sphinx", "furo", "myst_parser", "numpydoc"):
        pytest.importorskip(needed, reason="the extra docs is not installed")
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "site"
    errors = folder / "errors"
    try:
        folder.mkdir()
    except FileExistsError:  # another process builds it
        end = time.monotonic() + 300
        while not errors.exists() and time.monotonic() < end:
            time.sleep(0.2)
    else:
        command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-n", "-E", "-q", "-d", folder / "trees"]
        docs = Path(__file__).parents[2] / "docs"
        done = subprocess.run([*command, docs, folder / "html"], capture_output=True, text=True, timeout=300)
        errors.with_suffix(".new").write_text((done.stderr or "failed") if done.returncode else "", encoding="utf-8")
        errors.with_suffix(".new").replace(errors)
    return Site(folder / "html", errors.read_text(encoding="utf-8"))
