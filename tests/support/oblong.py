"""An empty rectangle whose walls lie in the middle of a row of cells, seen from within and mapped."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.grid import TileMaps
from gridslam.mapping import OccupancyGridMapping
from gridslam.types import Beams, LaserScan, ScanGeometry

HALF = np.array([3.02, 2.02])
GEOMETRY = ScanGeometry(np.deg2rad(np.arange(360) - 179.5))
PLACES = ((0.0, 0.0, 0.0), (0.4, -0.3, 0.5), (-0.5, 0.6, 2.0))


def scan_at(pose: np.ndarray, geometry: ScanGeometry = GEOMETRY) -> Beams:
    """What a laser at `pose` sees."""
    angles = geometry.bearings + pose[2]
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    ranges = ((HALF * np.sign(directions) - pose[:2]) / directions).min(axis=1)
    return LaserScan.from_ranges(0, ranges, geometry).beams(0.05, 30.0)


def map_room(
    particles: int = 1, places: Sequence[tuple[float, float, float]] = PLACES, geometry: ScanGeometry = GEOMETRY
) -> TileMaps:
    """Map it from some places, once for each particle."""
    maps = OccupancyGridMapping().empty(particles)
    for place in places:
        OccupancyGridMapping()(maps, np.tile(place, (particles, 1)), scan_at(np.array(place), geometry))
    return maps
