"""Ranges in millimetres and bearings in degrees are warned of where a scan is made of raw ranges."""

import warnings

import numpy as np
import pytest

from gridslam.types import LaserScan, ScanGeometry


@pytest.mark.parametrize(("far", "is_warned"), [(0, False), (2, False), (3, True), (5, True)])
def test_ranges_of_which_most_are_farther_than_any_lidar_sees_are_warned_of(far, is_warned):
    ranges = np.array([5000.0] * far + [2.0] * (5 - far))
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        LaserScan.from_ranges(0, ranges, ScanGeometry(np.linspace(-1, 1, 5)))
    assert ["in millimetres?" in str(one.message) for one in found] == [True] * is_warned


def test_bearings_in_degrees_are_warned_of():
    with pytest.warns(UserWarning, match="are they in degrees"):
        LaserScan.from_ranges(0, np.full(5, 2.0), ScanGeometry(np.linspace(-90, 90, 5)))
