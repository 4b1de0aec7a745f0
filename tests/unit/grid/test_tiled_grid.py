"""A map told a few rows at a time: the same cells, and never the whole rectangle in memory."""

from dataclasses import replace

import numpy as np
import pytest

from gridslam.grid import Evidence, TileMaps
from gridslam.types import LaserScan, ScanGeometry

CELL = 0.1


def maps_that_saw(*hits):
    maps = TileMaps(1, resolution_m=CELL, reach_cells=4.0, evidence=Evidence(2.0, -0.4, -9.0, 9.0, 1.0))
    ends = np.array(hits, dtype=np.float64)
    beams = LaserScan.from_ranges(0, np.hypot(*ends.T), ScanGeometry(np.zeros(len(ends)))).beams(0.0, np.inf)
    beams = replace(beams, indices=np.arange(len(ends)), ends=ends)
    maps.update(np.zeros(1, np.int32), np.zeros((1, 3)), beams)
    return maps, beams


@pytest.mark.parametrize(("first", "last"), [(0, 1), (5, 40), (31, 33), (64, 64), (0, 96), (90, 128)])
def test_rows_are_those_of_the_whole_map(first, last):
    maps, _ = maps_that_saw((5.05, 3.35), (-2.55, -5.15))
    tiled, whole = maps.tiled(0), maps.occupancy(0)
    assert tiled.shape == whole.shape == whole.known.shape
    assert tiled.origin == whole.origin
    assert whole.known.any()
    assert not whole.known.all()
    for rows in (tiled.rows(first, last), whole.rows(first, last)):
        np.testing.assert_array_equal(rows.log_odds, whole.log_odds[first:last])
        np.testing.assert_array_equal(rows.known, whole.known[first:last])
        assert rows.origin == pytest.approx((whole.origin[0], whole.origin[1] + first * CELL))
