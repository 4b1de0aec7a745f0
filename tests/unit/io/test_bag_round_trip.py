"""A log that was written as a bag is read as it was, by the reader of bags."""

import math

import numpy as np
import pytest

from gridslam.io.bags.bag import BagLog
from gridslam.io.bags.writer import write_bag
from gridslam.io.measurement import Measurement
from gridslam.types import LaserScan, Odometry, ScanGeometry
from support import se3

S = 1_000_000_000
START = 1_700_000_000 * S
TILTED = se3.from_quaternion([0.1, 0.02, 0.3], [math.cos(0.1), 0, math.sin(0.1), 0])


def log(count=50, **told):
    """A laser upside down and pitched by 0.2 rad, with hits, invalid beams and beams without return."""
    rng = np.random.default_rng(0)
    geometry = ScanGeometry(-math.pi + math.tau / 360 * np.arange(360), TILTED)
    for k in range(count):
        ranges = rng.uniform(0.2, 29, 360)
        ranges[rng.integers(360, size=20)] = math.nan
        ranges[rng.integers(360, size=20)] = math.inf
        stamp_ns = START + k * S // 10
        odometry = Odometry.at(stamp_ns, [0.1 * k, -0.05 * k, math.remainder(0.2 * k, math.tau)])
        yield Measurement(odometry, LaserScan.from_ranges(stamp_ns, ranges, geometry, range_max_m=30.0, **told))


@pytest.mark.parametrize("name", ["log.bag", "log.mcap", "log.db3", "log"])
@pytest.mark.parametrize("times", [None, 1e-4 * np.arange(360)])
def test_a_log_comes_back(tmp_path, name, times):
    written = list(log(beam_times_s=times))
    write_bag(tmp_path / name, written)
    read = list(BagLog(tmp_path / name))
    assert len(read) == len(written)
    for (odometry, scan), (odometry_back, back) in zip(written, read, strict=True):
        assert (back.stamp_ns, back.sensor, back.frame) == (scan.stamp_ns, "/scan", "laser")
        np.testing.assert_array_equal(back.status, scan.status)
        hit = scan.status == 0
        np.testing.assert_array_equal(back.ranges[hit], scan.ranges[hit].astype(np.float32))
        np.testing.assert_allclose(back.geometry.base_from_laser, TILTED, rtol=0, atol=1e-12)
        # 2^-24 of the first angle and of the field of view.
        np.testing.assert_allclose(back.geometry.bearings, scan.geometry.bearings, rtol=0, atol=1e-6)
        assert odometry_back.stamp_ns == odometry.stamp_ns
        np.testing.assert_allclose(odometry_back.pose, odometry.pose, rtol=0, atol=1e-12)
        if times is None:
            assert back.beam_times_s is None
        else:
            np.testing.assert_allclose(back.beam_times_s, times, rtol=1e-7)
        assert (back.range_min_m, back.range_max_m) == (0, 30)


def test_what_came_from_a_bag_goes_back_as_it_was(tmp_path):
    write_bag(tmp_path / "once.bag", log(5))
    once = list(BagLog(tmp_path / "once.bag"))
    write_bag(tmp_path / "twice.mcap", once)
    twice = list(BagLog(tmp_path / "twice.mcap"))
    for (odometry, scan), (odometry_back, back) in zip(once, twice, strict=True):
        assert (back.stamp_ns, back.sensor) == (scan.stamp_ns, scan.sensor)
        np.testing.assert_array_equal(back.ranges, scan.ranges)
        np.testing.assert_array_equal(back.geometry.bearings, scan.geometry.bearings)
        np.testing.assert_allclose(odometry_back.pose, odometry.pose, rtol=0, atol=1e-15)


def test_a_log_without_odometry_comes_back_without(tmp_path):
    write_bag(tmp_path / "log.bag", (Measurement(None, scan) for _, scan in log(5)))
    read = list(BagLog(tmp_path / "log.bag"))
    assert [measurement.odometry for measurement in read] == [None] * 5
    np.testing.assert_allclose(read[0].scan.geometry.base_from_laser, TILTED, rtol=0, atol=1e-12)


def test_two_lasers_come_back_in_turn(tmp_path):
    rear = ScanGeometry(np.linspace(-1, 1, 100), se3.from_planar([-0.3, 0, math.pi]))
    written = []
    for odometry, scan in log(5):
        behind = LaserScan.from_ranges(scan.stamp_ns + S // 20, np.full(100, 3.0), rear, sensor="rear")
        written += [Measurement(odometry, scan), Measurement(None, behind)]
    write_bag(tmp_path / "log.bag", written)
    read = list(BagLog(tmp_path / "log.bag"))
    assert [(m.scan.stamp_ns, m.scan.sensor) for m in read] == [
        (m.scan.stamp_ns, {"laser": "/scan", "rear": "/scan_rear"}[m.scan.sensor]) for m in written
    ]
    np.testing.assert_allclose(read[1].scan.geometry.base_from_laser, rear.base_from_laser, rtol=0, atol=1e-12)
