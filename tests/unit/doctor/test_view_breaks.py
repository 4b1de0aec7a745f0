"""A robot that was carried is named with time and place; what only looks like it is not."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain

import numpy as np
import pytest

from gridslam.doctor import CheckedLog, Doctor, Severity, quick_check
from gridslam.doctor.view_breaks import ViewBreaks, split_where_carried
from gridslam.geometry.se2 import between, compose
from gridslam.types import LaserScan, Odometry
from support.hand_logs import MadeLog
from support.laser_drives import log

LOST = slice(100, 180)  # of the scans: while it is carried nothing is recorded


def carried(odometry_knows=False):
    """A drive from which a part is left out, of which the odometry does not know."""
    measurements = log(scans=300)[0]
    before, after = measurements[: LOST.start], measurements[LOST.stop :]
    if odometry_knows:
        return [*before, *after]
    last, first = before[-1].odometry.pose, after[0].odometry.pose
    late_ns = after[0].scan.stamp_ns - before[-1].scan.stamp_ns - 200_000_000
    moved = []
    for odometry, scan in after:
        pose = compose(last, between(first, odometry.pose))
        stamp_ns = scan.stamp_ns - late_ns
        moved.append(after[0]._replace(odometry=Odometry.at(stamp_ns, pose), scan=replace(scan, stamp_ns=stamp_ns)))
    return [*before, *moved]


def breaks(measurements):
    found = ViewBreaks()
    for measurement in measurements:
        found.take(measurement)
    return found.found


def test_a_carried_robot_is_named_with_time_and_place():
    measurements = carried()
    ((at_s, place),) = breaks(measurements)
    assert at_s == pytest.approx(20.0, abs=0.01)
    start = measurements[0].odometry.pose
    np.testing.assert_allclose(place, between(start, measurements[LOST.start].odometry.pose))
    doctor = Doctor(matching=False)
    for measurement in measurements:
        doctor.take(measurement)
    (finding,) = (found for found in doctor.findings() if found.is_fault)
    assert (finding.code, finding.severity) == ("robot_carried", Severity.ERROR)
    assert f"after 20.0 s at x {place[0]:.2f} m, y {place[1]:.2f} m" in finding.message
    assert "begins a new piece" in finding.remedy


def test_the_rest_of_a_drive_and_an_odometry_that_knows_are_no_break():
    assert breaks(log(scans=300)[0]) == []
    assert breaks(carried(odometry_knows=True)) == []


@pytest.mark.parametrize("seen_m", [0.0, 0.15, np.nan, np.inf])
def test_a_laser_that_is_covered_while_it_is_carried(seen_m):
    before, after = carried()[: LOST.start], carried()[LOST.start :]
    last = before[-1]

    def wait(measurements, seconds):
        late = round(seconds * 1e9)
        return [m._replace(scan=replace(m.scan, stamp_ns=m.scan.stamp_ns + late)) for m in measurements]

    ranges = np.full(len(last.scan), seen_m)
    scan = LaserScan.from_ranges(last.scan.stamp_ns, ranges, last.scan.geometry, sensor=last.scan.sensor)
    covered = [own for k in range(1, 9) for own in wait([last._replace(scan=scan)], 0.2 * k)]
    ((at_s, _),) = breaks([*before, *covered, *wait(after, 1.6)])
    assert at_s == pytest.approx(21.6, abs=0.01)
    assert breaks([*before, *covered, *wait(log(scans=300)[0][LOST.start :], 1.6)]) == []


def test_who_passes_closely_is_none():
    """Most of the view is covered for a second: the view from before comes back."""
    measurements = list(log(scans=100)[0])
    for k in range(40, 45):
        scan = measurements[k].scan
        ranges = np.where(np.arange(len(scan)) < 0.7 * len(scan), 0.5, scan.ranges)
        measurements[k] = measurements[k]._replace(scan=replace(scan, ranges=ranges))
    assert breaks(measurements) == []


def test_who_sees_farther_in_all_directions_has_passed_a_door():
    measurements = [
        m._replace(scan=replace(m.scan, ranges=2 * m.scan.ranges)) if k > 40 else m
        for k, m in enumerate(log(scans=100)[0])
    ]
    assert breaks(measurements) == []


def test_a_laser_that_fails_is_none():
    """From a scan on each one is of another place."""
    rng = np.random.default_rng(0)
    measurements = list(log(scans=300)[0])
    other = rng.permutation(len(measurements))
    failed = [m._replace(scan=measurements[other[k]].scan) if k > 100 else m for k, m in enumerate(measurements)]
    assert breaks(failed) == []


def test_it_is_reported_while_the_log_is_read_long_after_the_first_minute():
    """Once, ten scans later, whatever the reader has read before."""
    standing = [carried()[0]] * 400
    measurements = [*standing, *carried()]
    told, given = [], []
    checked = CheckedLog(MadeLog(measurements), lambda found: told.extend((len(given), f.code) for f in found))
    for measurement in checked:
        given.append(measurement)
    assert [entry for entry in told if entry[1] == "robot_carried"] == [(400 + LOST.start + 9, "robot_carried")]
    assert "view is another one" in checked.statistics.faults["robot_carried (laser)"]
    assert "robot_carried" not in {finding.code for finding in quick_check(MadeLog(carried()))}


def of_sensor(measurements, sensor):
    return [m._replace(scan=replace(m.scan, sensor=sensor)) for m in measurements]


def split(measurements, passed=0):
    return [list(drive) for drive in split_where_carried(measurements, passed)]


def test_each_drive_has_its_own_scans_in_their_order():
    measurements = carried()
    drives = split(measurements)
    assert [len(drive) for drive in drives] == [LOST.start, len(measurements) - LOST.start]
    assert all(one is other for one, other in zip(chain.from_iterable(drives), measurements, strict=True))
    healthy = log(scans=300)[0]
    assert split(healthy) == [list(healthy)]
    assert split([]) == []


def test_scans_are_held_back_only_where_the_view_changes():
    """Of the scans before none waits, of those after each comes once ten were seen."""
    given = []

    def reading():
        for measurement in carried():
            given.append(measurement)
            yield measurement

    ahead = [
        [len(given) - number for number, _ in enumerate(drive, first)]
        for drive, first in zip(split_where_carried(reading()), (1, LOST.start + 1), strict=True)
    ]
    assert set(ahead[0]) == {0}
    assert ahead[1] == [9, 8, 7, 6, 5, 4, 3, 2, 1, 0] + [0] * (len(ahead[1]) - 10)


@pytest.mark.parametrize("passed", [0, 1, 50, LOST.start - 1, LOST.start, LOST.start + 1, LOST.start + 30])
def test_a_run_that_goes_on_gets_the_rest_and_knows_whether_a_drive_begins(passed):
    measurements = carried()
    drives = split(measurements, passed)
    assert all(one is other for one, other in zip(chain.from_iterable(drives), measurements[passed:], strict=True))
    assert len(drives) == (2 if passed <= LOST.start else 1)
    assert len(drives[0]) == (LOST.start if passed <= LOST.start else len(measurements)) - passed


def test_two_lasers_of_a_carried_robot_are_one_break():
    both = [m for pair in zip(carried(), of_sensor(carried(), "rear"), strict=True) for m in pair]
    drives = split(both)
    assert [len(drive) for drive in drives] == [2 * LOST.start, len(both) - 2 * LOST.start]


def test_a_laser_that_falls_silent_holds_no_others_back_for_ever():
    measurements = carried()
    healthy = of_sensor(log(scans=300)[0], "rear")
    both = [m for pair in zip(measurements[: LOST.start + 3], healthy, strict=False) for m in pair]
    given = []

    def reading():
        for measurement in [*both, *healthy[LOST.start + 3 :]]:
            given.append(measurement)
            yield measurement

    drives = [[len(given) - number for number, _ in enumerate(drive, 1)] for drive in split_where_carried(reading())]
    assert [len(drive) for drive in drives] == [len(given)]
    assert 5 < max(drives[0]) <= 100
    assert drives[0][-1] == 0
