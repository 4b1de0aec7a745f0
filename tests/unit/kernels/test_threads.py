"""The number of threads never changes a byte."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.grid import Evidence, TileMaps
from gridslam.matching import GaussNewton
from gridslam.types import LaserScan, ScanGeometry

PARTICLES = 23


def run(threads):
    """Bytes of all maps and of all that was read from them, after scans at scattered poses and resampling."""
    rng = np.random.default_rng(11)
    evidence = Evidence(2.4, -0.4, -3, 6, 2.0)
    maps = TileMaps(PARTICLES, resolution_m=0.05, reach_cells=10.5, evidence=evidence, threads=threads)
    geometry = ScanGeometry(np.linspace(-np.pi, np.pi, 120))
    rows, read = np.arange(PARTICLES, dtype=np.int32), []
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
