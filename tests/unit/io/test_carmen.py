"""Reading CARMEN logs: each form of line, mountings, beams, statuses, stamps, statistics."""

import bz2
import gzip
import math

import numpy as np
import pytest

from gridslam.errors import InputError
from gridslam.io.carmen.reader import CarmenLog


def flaser(ranges, laser=(0, 0, 0), robot=(0, 0, 0), stamp="1.5", tag="FLASER"):
    numbers = " ".join(map(str, (*ranges, *laser, *robot)))
    return f"{tag} {len(ranges)} {numbers} {stamp} host 0.1"


@pytest.fixture
def read(tmp_path):
    def reader(*lines):
        path = tmp_path / "some.log"
        path.write_text("\n".join(lines) + "\n")
        log = CarmenLog(path)
        return list(log), log.statistics

    return reader


def moving(n, laser_of, tag="FLASER"):
    """Lines of a robot that drives 0.5 m and turns 0.3 rad from scan to scan; `laser_of(pose)` is the laser's pose."""
    poses = [(0.5 * i, 0.1 * i, 0.3 * i) for i in range(n)]
    return [flaser([1.0, 2.0], laser_of(*pose), pose, f"{i}.0", tag) for i, pose in enumerate(poses)]


def mounted(dx, dy, dtheta):
    def laser_of(x, y, theta):
        c, s = math.cos(theta), math.sin(theta)
        return x + c * dx - s * dy, y + s * dx + c * dy, theta + dtheta

    return laser_of


@pytest.mark.parametrize(
    ("name", "scans", "beams", "backward", "odometry", "length"),
    [
        ("intel", 13631, 180, 631, 26915, 508),
        ("aces", 7374, 180, 0, 7375, 325),
        ("mit-csail", 1988, 361, 0, 0, 374),
    ],
)
def test_real_logs_hold_what_their_readme_says(data_dir, name, scans, beams, backward, odometry, length):
    log = CarmenLog(data_dir / f"{name}.clf.bz2")
    read = sum(1 for _ in log)
    statistics = log.statistics
    assert read == statistics.scan_count == statistics.scans["front"] == scans
    assert statistics.beam_counts == {beams: scans}
    assert statistics.backward_stamps == backward
    assert statistics.odometry_lines == odometry
    assert statistics.odometry_length_m == pytest.approx(length, abs=0.6)  # given to the metre
    assert statistics.bytes_read == statistics.total_bytes == (data_dir / f"{name}.clf.bz2").stat().st_size
    assert statistics.invalid_beams == 0
    assert not statistics.truncated


@pytest.mark.parametrize("compress", [lambda data: data, gzip.compress, bz2.compress])
def test_compression_is_told_by_content_not_by_name(tmp_path, compress):
    path = tmp_path / "log.txt"
    path.write_bytes(compress((flaser([1.0, 2.0]) + "\n").encode()))
    assert [m.scan.ranges.tolist() for m in CarmenLog(path)] == [[1.0, 2.0]]


@pytest.mark.parametrize(("n", "step"), [(180, 1.0), (181, 1.0), (360, 0.5), (361, 0.5), (2, 90.0), (90, 2.0)])
def test_bearings_cover_180_degrees(read, n, step):
    (measurement,), _ = read(flaser([1.0] * n))
    expected = np.radians(-90 + step * np.arange(n))
    np.testing.assert_allclose(measurement.scan.geometry.bearings, expected, atol=1e-12)


@pytest.mark.parametrize(("stated", "limit"), [("50", 50.0), ("89", 81.83), ("0", 81.83)])
def test_stated_maximum_range(read, stated, limit):
    (measurement,), _ = read(f"PARAM robot_front_laser_max {stated} h 0", flaser([49.9, 50.0]))
    assert measurement.scan.range_max_m == limit
    assert measurement.scan.status.tolist() == [0, int(limit == 50.0)]


def test_lines_without_pose_take_the_last_odometry_before(read):
    odom = "ODOM {} 2.0 4.0 0 0 0 {} host 0"
    old = "REMISSIONFLASER 2 1.0 100 2.0 200 {} host 0"
    measurements, statistics = read(
        old.format("1.0"), odom.format(1.0, "1.1"), odom.format(3.0, "1.2"), old.format("1.3")
    )
    assert measurements[0].odometry is None
    assert measurements[1].odometry.pose == pytest.approx([3.0, 2.0, 4.0 - 2 * math.pi])
    assert measurements[1].odometry.stamp_ns == 1_200_000_000
    assert measurements[1].scan.ranges.tolist() == [1.0, 2.0]
    assert (statistics.without_odometry, statistics.odometry_lines) == (1, 2)


def test_front_and_rear_keep_file_order_and_one_path(read):
    lines = [flaser([1.0, 2.0], (i, 0, 0), (i, 0, 0), f"{i}.0", tag) for i, tag in enumerate(["FLASER", "RLASER"] * 3)]
    measurements, statistics = read(*lines)
    assert [m.scan.sensor for m in measurements] == ["front", "rear"] * 3
    assert statistics.odometry_length_m == pytest.approx(5.0)


def test_a_constant_offset_in_the_lines_is_the_mounting(read):
    measurements, statistics = read(*moving(8, mounted(0.2, -0.05, 0.0)))
    assert statistics.mountings["front"].source == "line"
    np.testing.assert_allclose(measurements[0].scan.geometry.origin, [0.2, -0.05], atol=1e-9)


@pytest.mark.parametrize("yaw_in_line", [0.0, math.pi])
def test_rear_offset_in_the_lines(read, yaw_in_line):
    measurements, statistics = read(*moving(8, mounted(-0.25, 0.0, yaw_in_line), tag="RLASER"))
    assert statistics.mountings["rear"].source == "line"
    geometry = measurements[0].scan.geometry
    np.testing.assert_allclose(geometry.origin, [-0.25, 0], atol=1e-9)
    np.testing.assert_allclose(geometry.directions[1], [-1, 0], atol=1e-9)  # its second beam looks ahead of it


@pytest.mark.parametrize(
    ("start", "step", "problem"),
    [
        ("1e300", "1.5", "look like degrees"),
        ("-90", "1.5", "look like degrees"),
        ("0", "1e308", "expected finite angles"),
        ("0", "0.75", "which end at 1.5 rad, not at angle_max 3"),
        ("nan", "1.5", "expected finite angles"),
        ("0", "0", "expected a positive angular resolution"),
        ("0", "-1", "expected a positive angular resolution"),
    ],
)
def test_angles_that_no_laser_has_name_file_and_line(tmp_path, start, step, problem):
    good = "ROBOTLASER1 0 -1.5 3 1.5 80 0.01 0 3 1 1 1 0 0 0 0 0 0 0 0 0 0 0 0 {} a {}\n"
    bad = good.replace("0 -1.5 3 1.5", f"0 {start} 3 {step}")
    (tmp_path / "log.clf").write_text(good.format(1, 1) + bad.format(2, 2))
    with pytest.raises(InputError, match=rf"log\.clf, line 2: .*{problem}"):
        list(CarmenLog(tmp_path / "log.clf"))
