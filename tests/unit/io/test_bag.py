"""A bag as a log: odometry at the scans' stamps, mountings in space, statuses, and what is counted."""

import math

import numpy as np
import pytest

from gridslam.doctor.diagnose import CheckedLog
from gridslam.io.bags.bag import BagLog
from gridslam.io.log import Log, LogOptions
from gridslam.types import LaserScan
from support import ros_bags, se3
from support.ros_bags import KINDS, drive, ns, odometry, scan, transform, yawed

FOUR = [1.0, 2.0, 3.0, 4.0]


def log_of(folder, said, kind="ros1", **options):
    return BagLog(ros_bags.write(folder, kind, said), LogOptions(**options))


@pytest.mark.parametrize("kind", KINDS)
def test_odometry_is_interpolated_at_the_stamps_of_the_scans(tmp_path, kind):
    log = log_of(tmp_path, drive(), kind)
    assert isinstance(log, Log)
    measurements = list(log)
    assert len(measurements) == 20
    for step, (odo, laser) in enumerate(measurements[:-1]):
        at_s = 0.06 + 0.1 * step
        assert laser.stamp_ns == odo.stamp_ns == ns(at_s)
        np.testing.assert_allclose(odo.pose, [at_s, 0.0, 0.1 * at_s], atol=1e-9)
        np.testing.assert_allclose(laser.ranges, [1.0 + at_s - 0.01, 2.0, 3.0, 4.0], rtol=1e-7)
        assert (laser.sensor, laser.frame) == ("/scan", "laser")
    statistics = log.statistics
    assert statistics.scans == {"/scan": 20}
    assert statistics.odometry_source == "/odom"
    assert statistics.without_odometry == 0
    assert statistics.bytes_read == statistics.total_bytes
    assert statistics.odometry_length_m == pytest.approx(1.9)
    assert not statistics.truncated
    assert [m.scan.stamp_ns for m in log] == [m.scan.stamp_ns for m in measurements]  # read anew


@pytest.mark.parametrize("ahead_s", [1000.0, -3.0, 2.0])
@pytest.mark.parametrize("on_tf", [False, True])
def test_two_clocks_are_named_with_their_offset(tmp_path, ahead_s, on_tf):
    """Recorded at the same time, stamped by clocks that differ; recorded by their stamps, one after the other."""
    said = [transform(0.0, "base_link", "laser", (0.1, 0, 0))]
    for k in range(100):
        if on_tf:
            said.append(transform(k / 10, "odom", "base_link", topic="/tf", stamp_s=100 + k / 10 + ahead_s))
        else:
            said.append(odometry("/odom", k / 10, (0, 0, 0), stamp_s=100 + k / 10 + ahead_s))
        said.append(scan("/scan", k / 10, FOUR, stamp_s=100 + k / 10))
    log = log_of(tmp_path, said)
    assert log.statistics.clock_offset_s == 0
    list(log)
    assert log.statistics.clock_offset_s == pytest.approx(ahead_s, abs=0.11)
    checked = CheckedLog(log, lambda found: None)
    list(checked)
    assert {fault for fault in checked.statistics.faults if "odometry" in fault or "transform" in fault} == set()
    assert "clock_skew" in checked.statistics.faults


RANGES = [math.nan, math.inf, -math.inf, -1.0, 0.0, 0.1, 0.3, 0.5, 2.0, 29.9, 30.0, 31.0, 1e-40, -0.0]


@pytest.mark.parametrize("limits", [(0.3, 30.0), (0.0, math.inf), (0.0, 30.0), (2.0, 29.5)])
def test_status_is_decided_as_everywhere(tmp_path, limits):
    said = [scan("/scan", 1.0, RANGES, limits=limits), scan("/scan", 1.1, RANGES, limits=limits)]
    log = log_of(tmp_path, said)
    for _, ours in log:
        told = np.array(RANGES, dtype=np.float32), ours.geometry
        low, high = (float(np.float32(limit)) for limit in limits)
        expected = LaserScan.from_ranges(0, *told, range_min_m=low, range_max_m=high)
        np.testing.assert_array_equal(ours.ranges, expected.ranges)
        np.testing.assert_array_equal(ours.status, expected.status)
    assert log.statistics.invalid_beams == 2 * np.count_nonzero(expected.status == 2)
    assert log.statistics.no_return_beams == 2 * np.count_nonzero(expected.status == 1)


MOUNTINGS = {
    "upside down": ((0.2, 0.1, 0.3), (1.0, 0.0, 0.0, 0.0)),
    "yawed": ((0.0, -0.3, 0.0), yawed(2.0)),
    "tilted": ((0.1, 0.0, 0.5), (0.0, math.sin(0.1), 0.0, math.cos(0.1))),
}


@pytest.mark.parametrize("name", MOUNTINGS)
@pytest.mark.parametrize("topic", ["/tf", "/tf_static"])
@pytest.mark.parametrize("slash", ["", "/"])
def test_mountings_in_space_over_a_chain(tmp_path, name, topic, slash):
    place, turn = MOUNTINGS[name]
    links = [
        transform(0.4, f"{slash}base_link", "/mast", (0.0, 0.0, 1.0), topic=topic),
        transform(0.4, "mast", f"{slash}laser", place, turn, topic=topic),
    ]
    said = [scan("/scan", 0.1, FOUR, frame=f"{slash}laser"), *links, *drive(mounting=False)]
    first, *_ = log_of(tmp_path, said)
    expected = se3.from_quaternion((0, 0, 1), (0, 0, 0, 1)) @ se3.from_quaternion(place, turn)
    np.testing.assert_allclose(first.scan.geometry.base_from_laser, expected, atol=1e-12)


@pytest.mark.parametrize("topic", ["/tf", "/tf_static"])
def test_scans_of_two_lasers_on_one_topic_have_their_own_mountings(tmp_path, topic):
    links = [transform(0.0, "base_link", "rear", (-0.2, 0.0, 0.0), yawed(3.0), topic=topic)]
    said = [*links, *drive(), scan("/scan", 1.105, FOUR, frame="rear")]
    log = log_of(tmp_path, sorted(said, key=lambda each: each.time_ns))
    places = {laser.frame: tuple(laser.geometry.origin) for _, laser in log}
    assert places == {"laser": (0.2, 0.0), "rear": (-0.2, 0.0)}
    assert not log.statistics.missing_transforms


@pytest.mark.parametrize("away_m", [150.0, 1e200, -1e308])
def test_a_laser_that_no_robot_reaches_is_told(tmp_path, away_m):
    said = [*drive(mounting=False), transform(0.0, "base_link", "laser", (away_m, 0.0, 0.0))]
    log = log_of(tmp_path, sorted(said, key=lambda each: each.time_ns))
    assert {tuple(laser.geometry.origin) for _, laser in log} == {(0.0, 0.0)}
    (missing,) = log.statistics.missing_transforms
    assert ("out of reach" in missing) == (abs(away_m) < 1e9)  # the others are no pose, and left out


def test_a_scan_before_and_after_all_odometry_goes_without_it(tmp_path):
    said = [scan("/scan", -3.0, FOUR), scan("/scan", -0.5, FOUR), *drive(), scan("/scan", 2.5, FOUR)]
    log = log_of(tmp_path, said)
    measurements = list(log)
    assert [measurement.odometry is None for measurement in measurements] == [True, True, *[False] * 20, True]
    reasons = log.statistics.missing_transforms
    assert sum(reasons.values()) == log.statistics.without_odometry == 3
    assert reasons["odometry: no reading at or before the scan's stamp"] == 1  # this one waited for the first
    assert sorted(reasons) == [
        "odometry: no reading at or after the scan's stamp comes within 1 s of the log",
        "odometry: no reading at or before the scan's stamp",
        "odometry: no reading comes before the scan or within 1 s of the log after it",
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_stamps_are_those_of_the_headers(tmp_path, kind):
    said = [odometry("/odom", 100 + step, (step, 0, 0), stamp_s=float(step)) for step in range(5)]
    said += [scan("/scan", 102.5, FOUR, stamp_s=1.25)]
    ((odo, laser),) = log_of(tmp_path, sorted(said, key=lambda each: each.time_ns), kind)
    assert laser.stamp_ns == ns(1.25)
    np.testing.assert_allclose(odo.pose, [1.25, 0, 0], atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_odometry_from_transforms(tmp_path, kind):
    said = [transform(0.0, "base_link", "laser", (0.2, 0.0, 0.0))]
    for step in range(41):
        pose = (step / 20, 0.0, 0.0), yawed(step / 200)
        said.append(transform(step / 20, "odom", "base_footprint", *pose, topic="/tf"))
        said.append(transform(step / 20, "base_footprint", "base_link", (0.0, 0.0, 0.1), topic="/tf"))
    said += [scan("/scan", 0.06 + 0.1 * step, FOUR) for step in range(19)]
    log = log_of(tmp_path, sorted(said, key=lambda each: each.time_ns), kind)
    for odo, laser in log:
        at_s = (laser.stamp_ns - ns(0)) / 1e9
        np.testing.assert_allclose(odo.pose, [at_s, 0.0, at_s / 10], atol=1e-6)
        assert laser.geometry.base_from_laser[2, 3] == 0.1
    assert log.statistics.odometry_source == "odom to base_footprint on /tf"
    assert log.statistics.without_odometry == 0


@pytest.mark.parametrize("moves", [False, True])
def test_the_base_may_be_above_the_frame_of_the_odometry(tmp_path, moves):
    said = drive()
    for step in range(41):
        height = (0.0, 0.1 + 0.2 * moves * (step > 20), 0.0)
        said.append(transform(step / 20, "base_footprint", "base_link", height, topic="/tf"))
    said = sorted(said, key=lambda each: each.time_ns)
    log = log_of(tmp_path, said, base_frame="base_footprint")
    for odo, laser in list(log)[:-1]:
        at_s = (laser.stamp_ns - ns(0)) / 1e9
        if not 1.0 <= at_s <= 1.1:
            aside = 0.1 + 0.2 * moves * (at_s > 1)
            np.testing.assert_allclose(
                odo.pose[:2], [at_s, 0] - aside * np.array([-math.sin(at_s / 10), math.cos(at_s / 10)]), atol=1e-9
            )


def test_readings_that_are_no_pose_are_left_out_and_told(tmp_path):
    said = [*drive(), odometry("/odom", 1.001, (math.nan, 0, 0)), transform(1.002, "base_link", "x", xyzw=(0, 0, 0, 0))]
    log = log_of(tmp_path, sorted(said, key=lambda each: each.time_ns))
    assert sum(1 for odo, _ in log if odo is not None) == 20
    assert any("/odom" in remark and "no pose" in remark for remark in log.statistics.remarks)


def test_lasers_of_one_robot_are_merged_by_their_stamps(tmp_path):
    said = [*drive(scans=False), transform(0.0, "base_link", "rear", (-0.2, 0.0, 0.0), yawed(math.pi))]
    for step in range(19):
        at_s = 0.05 + step / 10
        said.append(scan("/front_scan", at_s, FOUR))
        said.append(scan("/rear_scan", at_s + 0.13, FOUR, frame="rear", stamp_s=at_s + 0.05))  # recorded late
    log = log_of(tmp_path, sorted(said, key=lambda each: each.time_ns))
    stamps = [laser.stamp_ns for _, laser in log]
    assert stamps == sorted(stamps)
    assert log.statistics.scans == {"/front_scan": 19, "/rear_scan": 19}
    assert log.statistics.mountings["/rear_scan"].pose[2] == pytest.approx(-math.pi)
    alone = BagLog(log.path, LogOptions(scan_topics=("rear_scan",)))
    assert {laser.sensor for _, laser in alone} == {"/rear_scan"}


@pytest.mark.parametrize("form", KINDS)
def test_messages_of_unknown_types_do_not_disturb(tmp_path, form):
    kind = "own_msgs/msg/Custom"
    custom = [ros_bags.Said("/own", ns(at_s), kind, lambda maker: maker.types[kind](1.0, "a")) for at_s in (0.1, 0.5)]
    log = log_of(tmp_path, sorted([*drive(), *custom], key=lambda each: each.time_ns), form)
    assert len(list(log)) == 20
    assert log.statistics.topics["/own"].messages == 2
