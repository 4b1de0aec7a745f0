"""What any robot measures, as CARMEN can say it: the same beams, and what is lost is counted."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.errors import ArgumentError
from gridslam.io.carmen.reader import CarmenLog
from gridslam.io.carmen.writer import to_carmen_form, write_carmen
from gridslam.io.csv import rotation_of_angles
from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus, LaserScan, Odometry, ScanGeometry

ZERO = Odometry.at(0, [0, 0, 0])


def mounted(bearings, roll=0.0, pitch=0.0, yaw=0.0, place=(0.0, 0.0, 0.0)) -> ScanGeometry:
    mounting = np.eye(4)
    mounting[:3, :3] = rotation_of_angles(roll, pitch, yaw)
    mounting[:3, 3] = place
    return ScanGeometry(bearings, mounting)


def taken(*measurements):
    lost: Counter[str] = Counter()
    return list(to_carmen_form(measurements, lost)), {what: count for what, count in lost.items() if count}


@settings(deadline=None, max_examples=80)
@given(
    st.integers(1, 40),
    st.floats(-3, 3),
    st.floats(0.01, 0.15),
    st.booleans(),
    st.booleans(),
    st.floats(-3.1, 3.1),
    st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(0, 1)),
)
def test_the_very_same_beams_come_back(tmp_path_factory, beams, first, step, clockwise, upside_down, yaw, place):
    bearings = first + (-step if clockwise else step) * np.arange(beams)
    geometry = mounted(bearings, math.pi if upside_down else 0.0, 0.0, yaw, place)
    ranges = np.round(np.linspace(1, 9, beams), 3)
    ranges[beams // 2] = np.inf
    scan = LaserScan.from_ranges(0, ranges, geometry, range_max_m=20.0)
    path = tmp_path_factory.mktemp("form") / "log.clf"
    (formed,), lost = taken(Measurement(ZERO, scan))
    write_carmen(path, [formed])
    ((_, back),) = CarmenLog(path)
    assert lost == {"the name of the laser (laser is front now)": 1}

    def ends(scan):
        beams = scan.beams(0, 100)
        return beams.ends[np.lexsort(beams.ends.T.round(6))]

    np.testing.assert_allclose(ends(back), ends(scan), rtol=0, atol=1e-9)
    np.testing.assert_allclose(back.geometry.origin, geometry.origin)
    assert np.count_nonzero(back.status == BeamStatus.NO_RETURN) == 1


def test_losses_are_counted_in_scans():
    geometry = ScanGeometry([-0.1, 0.0, 0.1])
    late = Odometry.at(7, [1.23456789, 0, 0])
    timed = LaserScan.from_ranges(0, [1.0001, 90.0, 2], geometry, sensor="/scan", beam_times_s=[0, 1, 2])
    plain = LaserScan.from_ranges(9, [1, 2, 3], geometry, sensor="/scan")
    formed, lost = taken(Measurement(late, timed), Measurement(None, plain), Measurement(Odometry(9, ZERO.pose), plain))
    assert lost == {
        "more than 6 decimals of poses": 1,
        "the odometry's own stamps": 1,
        "the name of the laser (/scan is front now)": 2,
        "times of beams": 1,
        "ranges from 81.83 m on": 1,
        "more than 3 decimals of ranges": 1,
        "scans without odometry": 1,
    }
    assert [m.odometry.stamp_ns for m in formed] == [0, 9]
    assert formed[0].scan.status.tolist() == [BeamStatus.HIT, BeamStatus.NO_RETURN, BeamStatus.HIT]


def test_two_lasers_are_front_and_rear():
    geometry = ScanGeometry([-0.1, 0.0, 0.1])
    scans = [LaserScan.from_ranges(0, [1, 2, 3], geometry, sensor=name) for name in ("/a", "front", "/a", "/b")]
    formed, _ = taken(*(Measurement(ZERO, scan) for scan in scans[:3]))
    assert [m.scan.sensor for m in formed] == ["front", "rear", "front"]
    with pytest.raises(ArgumentError, match="two lasers at most"):
        taken(*(Measurement(ZERO, scan) for scan in scans))


def test_a_tilted_laser_is_refused():
    scan = LaserScan.from_ranges(0, [1, 2, 3], mounted([-0.1, 0.0, 0.1], pitch=0.1))
    with pytest.raises(ArgumentError, match="mounted level, upright or upside down, got one tilted by"):
        taken(Measurement(ZERO, scan))
