"""The number of threads never changes a byte."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import gridslam
from gridslam.grid import Evidence, TileMaps
from gridslam.grid.arena import TileArena
from gridslam.matching import GaussNewton
from gridslam.types import LaserScan, ScanGeometry

PARTICLES = 23
ROWS = np.arange(PARTICLES, dtype=np.int32)


def empty(threads):
    evidence = Evidence(2.4, -0.4, -3, 6, 2.0)
    return TileMaps(PARTICLES, resolution_m=0.05, reach_cells=10.5, evidence=evidence, threads=threads)


def run(threads):
    """Bytes of all maps and of all that was read from them, after scans at scattered poses and resampling."""
    rng = np.random.default_rng(11)
    maps = empty(threads)
    geometry = ScanGeometry(np.linspace(-np.pi, np.pi, 120))
    rows, read = ROWS, []
    priors = np.repeat(np.diag([1.0, 1.0, 10.0])[None], PARTICLES, axis=0)
    for step in range(5):
        poses = rng.normal(scale=[0.3, 0.3, 0.2], size=(PARTICLES, 3))
        beams = LaserScan.from_ranges(step, rng.uniform(1, 6, 120), geometry).beams(0.05, 30.0)
        match = GaussNewton()(maps, rows, poses, priors, beams)
        maps.update(rows, poses, beams)
        rays = maps.cast_rays(rows, poses, beams.origin, geometry.directions, 8.0)
        read += [match.poses, match.information, match.score, maps.distances(rows, poses, beams.ends), rays]
        maps.select(np.sort(rng.integers(0, PARTICLES, PARTICLES)))
    return b"".join(array.tobytes() for array in [*maps.to_arrays().values(), *read])


@pytest.fixture(scope="module")
def alone():
    return run(1)


@pytest.mark.parametrize("threads", [2, 3, 7])
def test_same_bytes_for_any_number_of_threads(threads, alone):
    assert run(threads) == alone


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks")
def test_a_forked_process_has_threads_of_its_own(alone):
    """Those of its parent, which were at work, are not there to wait for."""
    assert run(2) == alone
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        os.write(writer, b"1" if run(3) == alone else b"0")
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        assert pipe.read() == b"1"
    assert os.waitpid(child, 0)[1] == 0
    assert run(2) == alone


def test_an_interpreter_ends_while_threads_wait():
    """At once, and without a word."""
    code = "import test_threads; test_threads.run(4)"
    environment = {**os.environ, "PYTHONPATH": str(Path(gridslam.__file__).parents[1])}  # this package, not another
    command = [sys.executable, "-c", code]
    found = subprocess.run(
        command, cwd=Path(__file__).parent, env=environment, capture_output=True, timeout=60, check=False
    )
    assert (found.returncode, found.stderr) == (0, b"")


def poses_and_beams(step):
    """A scan of a room at scattered poses."""
    rng = np.random.default_rng(step)
    scan = LaserScan.from_ranges(step, rng.uniform(4, 5, 120), ScanGeometry(np.linspace(-np.pi, np.pi, 120)))
    return rng.normal(scale=[0.3, 0.3, 0.2], size=(PARTICLES, 3)), scan.beams(0.05, 30.0)


def few_ids(refs):
    return np.arange(len(refs) + 2, len(refs) - 1, -1, dtype=np.int32), len(refs) + 3


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_ids_may_be_scarce(threads, monkeypatch):
    plenty, scarce = empty(1), empty(threads)
    monkeypatch.setattr(TileArena, "_extend_ids", staticmethod(few_ids))
    for step in range(4):
        scarce.update(ROWS, *poses_and_beams(step))
        scarce.select(ROWS // 2)
    monkeypatch.undo()
    for step in range(4):
        plenty.update(ROWS, *poses_and_beams(step))
        plenty.select(ROWS // 2)
    for name, array in plenty.to_arrays().items():
        np.testing.assert_array_equal(scarce.to_arrays()[name], array)
    assert scarce.tiles_used == plenty.tiles_used
