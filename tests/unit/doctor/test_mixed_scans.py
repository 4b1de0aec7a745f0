"""Scans of two lasers by one name are named; lasers with their own mountings, doors and bad scans are not."""

from dataclasses import replace

import numpy as np
import pytest

from gridslam.doctor import Doctor, Severity
from gridslam.types import ScanGeometry
from support.laser_drives import log


def faults(measurements):
    doctor = Doctor(matching=False)
    for measurement in measurements:
        doctor.take(measurement)
    return {finding.code: finding for finding in doctor.findings() if finding.is_fault}


def turned(measurement, *, declared):
    """A scan of the same laser, mounted the other way round; it says so, or not."""
    scan = measurement.scan
    half = len(scan) // 2
    bearings = np.roll(scan.geometry.bearings, half) if declared else scan.geometry.bearings
    geometry = ScanGeometry(bearings, scan.geometry.base_from_laser)
    ranges, status = (np.roll(values, half) for values in (scan.ranges, scan.status))
    return measurement._replace(scan=replace(scan, ranges=ranges, status=status, geometry=geometry))


@pytest.mark.parametrize("every", [2, 3])
@pytest.mark.parametrize("has_odometry", [True, False])
def test_two_lasers_by_one_name_are_named(every, has_odometry):
    measurements = [m if has_odometry else m._replace(odometry=None) for m in log(scans=200)[0]]
    mixed = [turned(m, declared=False) if k % every == 0 else m for k, m in enumerate(measurements)]
    found = faults(mixed)["mixed_scans"]
    assert found.severity is Severity.ERROR
    assert found.size > 0.8 / every
    assert "robot_carried" not in faults(mixed)


def test_two_lasers_with_their_mountings_and_a_few_bad_scans_are_none():
    measurements = log(scans=200)[0]
    assert "mixed_scans" not in faults(measurements)
    assert "mixed_scans" not in faults([turned(m, declared=True) if k % 2 else m for k, m in enumerate(measurements)])
    bad = [turned(m, declared=False) if k % 25 == 0 else m for k, m in enumerate(measurements)]
    assert "mixed_scans" not in faults(bad)


def half(measurement, beams):
    """Some of the beams, as of a laser that sees no more."""
    scan = measurement.scan
    geometry = ScanGeometry(scan.geometry.bearings[beams], scan.geometry.base_from_laser)
    return measurement._replace(
        scan=replace(scan, ranges=scan.ranges[beams], status=scan.status[beams], geometry=geometry)
    )


def test_views_that_have_nothing_in_common_and_views_that_do_not_come_back_are_none():
    measurements = log(scans=300)[0]
    middle = len(measurements[0].scan) // 2
    sides = slice(None, middle), slice(middle, None)
    assert "mixed_scans" not in faults([half(m, sides[k % 2]) for k, m in enumerate(measurements)])
    apart = [measurements[7 * k % 300]._replace(odometry=None) for k in range(40)]
    assert "mixed_scans" not in faults(apart)
