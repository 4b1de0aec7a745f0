"""A robot that was carried is named with time and place; what only looks like it is not."""

from dataclasses import replace

import numpy as np
import pytest

from gridslam.doctor import Doctor, Severity
from gridslam.doctor.view_breaks import DriveNumbering, ViewBreaks, split_where_carried
from gridslam.doctor.views import View, find_similar
from gridslam.geometry.se2 import between, compose
from gridslam.io.measurement import Measurement
from gridslam.scan import LaserScan, ScanGeometry
from gridslam.sim import LidarConfig, OdometryNoise, PeopleConfig, RobotConfig, make_world, simulate
from gridslam.types import Odometry
from support.interrupted import carry
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


@pytest.mark.parametrize("turn_rad", [0.3, -0.3])
def test_a_turn_alone_changes_no_view(turn_rad):
    """Most ranges are others, beam by beam; each way that both scans look they are the same."""
    bearings = np.linspace(-2, 2, 361)
    scans = [
        LaserScan.from_ranges(0, 4 + 2 * np.sin(3 * (bearings + turn)), ScanGeometry(bearings))
        for turn in (0.0, turn_rad)
    ]
    before = View(np.zeros(3), scans[0])
    assert not View(np.array([0.0, 0.0, turn_rad]), scans[1]).is_changed_from(before)
    assert View(np.zeros(3), scans[1]).is_changed_from(before), "the odometry does not know of the turn"


def test_the_rest_of_a_drive_and_an_odometry_that_knows_are_no_break():
    assert breaks(log(scans=300)[0]) == []
    assert breaks(carried(odometry_knows=True)) == []


@pytest.mark.parametrize(("world", "least"), [("rooms", 13), ("random", 12), ("demo", 13), ("hall", 8)])
def test_of_places_a_metre_or_more_apart_most_are_told_apart(world, least):
    """Of 15 each; in an open hall many look alike. In some all is farther than before, or all is nearer."""
    rng = np.random.default_rng(1)
    lidar = LidarConfig(beams=360, field_of_view_rad=2 * np.pi, range_max_m=12.0)
    drive = simulate(make_world(world, rng), RobotConfig(), OdometryNoise(), lidar, rng)
    measurements, places = drive.measurements[:500], drive.truth.poses[:, :2]
    pairs = [
        pair for pair in rng.integers(8, len(measurements) - 14, (60, 2)) if np.ptp(places[pair], axis=0).max() > 1
    ]
    found = [breaks(carry(measurements[a - 6 : a], measurements[b : b + 13])) for a, b in pairs[:15]]
    assert sum(map(bool, found)) >= least
    assert breaks(measurements) == []


def test_scans_compared_in_blocks_make_the_same_drives_as_one_by_one():
    """Among them are a covered laser, scans without odometry, scans of other beams, and a second laser."""
    measurements = carried()
    similar = find_similar([scan for _, scan in measurements])
    assert 0.8 * len(similar) < sum(scan is not None for scan in similar) < len(similar) - 1
    covered = LaserScan.from_ranges(0, np.full(len(measurements[0].scan), 0.1), measurements[0].scan.geometry)
    few = LaserScan.from_ranges(0, np.ones(1), ScanGeometry([0.0]))
    for k, scan in ((30, covered), (31, covered), (70, few), (140, covered)):
        measurements[k] = measurements[k]._replace(scan=replace(scan, sensor=measurements[k].scan.sensor))
    measurements[40] = measurements[40]._replace(odometry=None)
    for k in (50, 51, 53, 150, 152):
        measurements[k] = measurements[k]._replace(scan=replace(measurements[k].scan, sensor="rear"))
    found, expected = [], []
    numbering = DriveNumbering(expected.append)
    numbers = [pair for one in measurements for pair in numbering.take(one, one)] + numbering.end()
    drives = [list(drive) for drive in split_where_carried(measurements, found.append)]
    assert [(number, one) for number, drive in enumerate(drives) for one in drive] == numbers
    assert [each.message for each in found] == [each.message for each in expected]
    assert len(drives) == 2


def test_the_scan_of_another_laser_does_not_stand_for_the_one_before():
    """The first scan after the robot was carried is of a second laser, and the next one resembles it."""
    measurements = carried()
    begin = LOST.start
    measurements[begin] = measurements[begin]._replace(scan=replace(measurements[begin].scan, sensor="rear"))
    assert find_similar([scan for _, scan in measurements])[begin + 1] is measurements[begin].scan
    first, second = (len(list(drive)) for drive in split_where_carried(measurements))
    assert (first, second) == (begin + 1, len(measurements) - begin - 1)


def test_a_covered_laser_is_not_similar_though_few_of_its_ranges_change():
    """It sees three of five beams, and then four of five of these are covered."""
    geometry = ScanGeometry(np.linspace(-1.5, 1.5, 100))
    ranges = np.where(np.arange(100) < 60, 5.0, np.inf)
    seen = LaserScan.from_ranges(0, ranges, geometry)
    covered = LaserScan.from_ranges(1, np.where(np.arange(100) < 48, 0.1, ranges), geometry)
    assert find_similar([seen, seen, covered, covered]) == [None, seen, None, covered]


def test_people_who_pass_are_no_break():
    rng = np.random.default_rng(2)
    lidar = LidarConfig(beams=180, range_max_m=12.0, rate_hz=10)
    drive = simulate(
        make_world("rooms", rng), RobotConfig(), OdometryNoise(), lidar, rng, people=PeopleConfig(count=15)
    )
    assert breaks(drive.measurements[:600]) == []


@pytest.mark.parametrize(("world", "seed", "late"), [("random", 1, 1), ("random", 3, 2), ("demo", 2, 1)])
def test_odometry_that_comes_late_is_no_break(world, seed, late):
    """A turn is seen one or two scans of a quarter of a second before the odometry knows of it, among people."""
    rng = np.random.default_rng(seed)
    lidar = LidarConfig(beams=180, range_max_m=12.0, rate_hz=4)
    people = PeopleConfig(count=15)
    drive = simulate(make_world(world, rng), RobotConfig(), OdometryNoise(), lidar, rng, people=people)
    scans = [scan for _, scan in drive.measurements[:800]]
    poses = [odometry.pose for odometry, _ in drive.measurements[:800]]
    delayed = [poses[0]] * late + poses[:-late]
    pairs = zip(delayed, scans, strict=True)
    assert breaks(Measurement(Odometry.at(scan.stamp_ns, pose), scan) for pose, scan in pairs) == []


def test_a_laser_beside_a_much_faster_one_is_numbered_though_what_was_held_back_has_gone():
    """After its view has changed the tenth scan decides, when over a hundred of the other one have come."""
    measurements = carried()
    slow = [one._replace(scan=replace(one.scan, sensor="slow")) for one in measurements[80:115]]
    numbering = DriveNumbering[int]()
    count, numbers = 0, []
    for k, one in enumerate(slow):
        for own in [measurements[0]] * (11 + k % 2) + [one]:
            numbers += numbering.take(count, own)
            count += 1
    numbers += numbering.end()
    assert [item for _, item in numbers] == list(range(count))
    assert {number for number, _ in numbers} == {0, 1}
