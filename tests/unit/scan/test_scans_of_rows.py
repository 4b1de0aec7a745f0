"""Many scans and readings built at once are those that are built one by one, and refused where one is."""

from dataclasses import fields

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.types import LaserScan, ScanGeometry

GEOMETRY = ScanGeometry(np.linspace(-1, 1, 5))
RANGES = np.random.default_rng(2).uniform(0.1, 9.0, (3, 5))
STATUS = np.random.default_rng(3).integers(0, 3, (3, 5)).astype(np.uint8)
STAMPS = [5, 3, 8]


def test_scans_of_rows_are_those_of_the_constructor():
    limits = {"range_min_m": 0.1, "range_max_m": 8.0, "sensor": "front", "frame": "front_laser"}
    scans = LaserScan.from_rows(STAMPS, RANGES, STATUS, GEOMETRY, **limits)
    assert len(scans) == 3
    for scan, stamp_ns, ranges, status in zip(scans, STAMPS, RANGES, STATUS, strict=True):
        one = LaserScan(stamp_ns, ranges, status, GEOMETRY, **limits)
        for field in fields(LaserScan):
            assert np.array_equal(getattr(scan, field.name), getattr(one, field.name)), field.name
        assert scan.geometry is GEOMETRY
        with pytest.raises(AttributeError):
            scan.sensor = "rear"
    assert LaserScan.from_rows([], RANGES[:0], STATUS[:0], GEOMETRY) == []


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"ranges": RANGES[:, :4]}, "ranges"),
        ({"ranges": RANGES.astype(np.float32)}, "ranges"),
        ({"ranges": RANGES[:2]}, "ranges"),
        ({"status": STATUS + np.uint8(3) * (np.arange(3, dtype=np.uint8) == 2)[:, None]}, "status"),
        ({"status": STATUS.astype(np.int64)}, "status"),
        ({"geometry": None}, "geometry"),
        ({"range_min_m": -1.0}, "range_min_m"),
        ({"range_max_m": 0.0}, "range_max_m"),
    ],
)
def test_rows_that_are_no_scans_are_refused(change, name):
    with pytest.raises(ArgumentError, match=f"^{name}"):
        LaserScan.from_rows(
            **({"stamps_ns": STAMPS, "ranges": RANGES, "status": STATUS, "geometry": GEOMETRY} | change)
        )
