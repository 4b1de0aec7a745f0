"""Scans from the fields of a ROS message: one constructor for readers, nodes and users."""

import math

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.types import BeamStatus, LaserScan
from support.se3 import from_planar

HIT, NO_RETURN, INVALID = (np.uint8(status) for status in BeamStatus)
RANGES = np.array([1.0, 0.05, 30.0, np.inf, np.nan, -1.0, 0.0, 29.9], np.float32)
FIELDS = {"angle_min": -1.5, "angle_increment": 0.25, "range_min": 0.1, "range_max": 30.0}


def test_the_fields_of_a_message_become_a_scan():
    mounting = from_planar(np.array([0.2, -0.1, 0.5]))
    names = {"sensor": "/s", "frame": "f"}
    scan = LaserScan.from_ros(7, RANGES, **FIELDS, time_increment=1e-3, base_from_laser=mounting, **names)
    assert (scan.stamp_ns, scan.sensor, scan.frame, scan.range_min_m, scan.range_max_m) == (7, "/s", "f", 0.1, 30.0)
    assert scan.status.tolist() == [HIT, INVALID, NO_RETURN, NO_RETURN, INVALID, INVALID, INVALID, HIT]
    assert np.array_equal(scan.geometry.bearings, -1.5 + 0.25 * np.arange(8))
    assert np.array_equal(scan.geometry.base_from_laser, mounting)
    assert np.array_equal(scan.beam_times_s, np.arange(8) * 1e-3)
    assert np.array_equal(scan.ranges, RANGES.astype(np.float64), equal_nan=True)


@pytest.mark.parametrize(
    ("told", "meant"),
    [
        ((0.0, 0.0), (0.0, math.inf)),
        ((-1.0, 5.0), (0.0, 5.0)),
        ((math.nan, math.nan), (0.0, math.inf)),
        ((1.0, 0.5), (1.0, math.inf)),
        ((0.5, math.inf), (0.5, math.inf)),
        ((math.inf, math.inf), (0.0, math.inf)),
    ],
)
def test_limits_that_mean_nothing_are_none(told, meant):
    scan = LaserScan.from_ros(0, [2.0], angle_min=0.0, angle_increment=0.1, range_min=told[0], range_max=told[1])
    assert (scan.range_min_m, scan.range_max_m) == meant


@pytest.mark.parametrize(
    ("change", "argument"),
    [
        ({"angle_min": math.nan}, "angle_min"),
        ({"angle_increment": math.inf}, "angle_min, angle_increment"),
        ({"base_from_laser": np.zeros((4, 4))}, "base_from_laser"),
    ],
)
def test_fields_that_are_none_are_refused(change, argument):
    with pytest.raises(ArgumentError, match=argument):
        LaserScan.from_ros(0, RANGES, **FIELDS | change)
    with pytest.raises(ArgumentError, match="ranges"):
        LaserScan.from_ros(0, [[1.0]], **FIELDS)
