"""Giving memory back: what is left goes on as before, in as many tiles as it uses."""

from dataclasses import replace

import numpy as np

from gridslam.grid import Evidence, TileMaps
from gridslam.types import LaserScan, ScanGeometry

ROWS = np.arange(4, dtype=np.int32)


def seen(rng):
    ends = rng.uniform(-15, 15, (40, 2))
    beams = LaserScan.from_ranges(0, np.hypot(*ends.T), ScanGeometry(np.zeros(len(ends)))).beams(0.0, np.inf)
    return replace(beams, indices=np.arange(len(ends)), ends=ends)


def diverged(rng):
    """Four maps that have some tiles in common and most not."""
    maps = TileMaps(4, resolution_m=0.1, reach_cells=4.0, evidence=Evidence(2.0, -0.4, -9.0, 9.0, 1.0))
    for _ in range(4):
        maps.update(ROWS, rng.uniform(-20, 20, (4, 3)), seen(rng))
        maps.select(np.array([0, 0, 2, 3]))
    maps.update(ROWS[:3], rng.uniform(-20, 20, (3, 3)), seen(rng))
    return maps


def test_the_others_memory_is_given_back():
    maps = diverged(np.random.default_rng(0))
    before, tiles, cells = maps.nbytes, maps.tiles_of(np.array([2])), maps.occupancy(2)
    maps.select(np.array([2]))
    assert maps.nbytes > 0.9 * before  # what is free stays with the maps
    maps.compact()
    assert maps.tiles_used == tiles
    assert maps.nbytes < 0.5 * before
    np.testing.assert_array_equal(maps.occupancy(0).log_odds, cells.log_odds)
