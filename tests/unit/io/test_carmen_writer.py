"""What the writer writes the reader reads."""

import math

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.io.carmen.reader import CarmenLog
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.measurement import Measurement
from gridslam.types import LaserScan, Odometry, ScanGeometry


def measurement(stamp_ns=1_000_000, n=181, fov=math.pi, ranges=None, seed=0, mounting=(0, 0, 0), **scan):
    rng = np.random.default_rng(seed)
    bearings = -fov / 2 + fov / (n - n % 2) * np.arange(n)
    geometry = ScanGeometry.planar(bearings, mounting)
    values = rng.uniform(0.1, 29, n) if ranges is None else ranges
    odometry = Odometry.at(stamp_ns, [*rng.uniform(-50, 50, 2), rng.uniform(-3, 3)])
    return Measurement(odometry, LaserScan.from_ranges(stamp_ns, values, geometry, **scan))


@pytest.mark.parametrize("suffix", [".log", ".clf.gz", ".log.bz2"])
@pytest.mark.parametrize(("n", "fov"), [(180, math.pi), (181, math.pi), (360, 2 * math.pi), (541, 1.5 * math.pi)])
def test_round_trip(tmp_path, suffix, n, fov):
    path = tmp_path / f"sim{suffix}"
    stamps = [976052857337530000, 976052857337531891, 976052857337529000]
    written = [
        measurement(t, n, fov, seed=i, mounting=(0.12, -0.03, 0.2), range_max_m=30.0) for i, t in enumerate(stamps)
    ]
    write_carmen(path, iter(written))
    log = CarmenLog(path)
    read = list(log)
    assert [m.scan.stamp_ns for m in read] == [m.odometry.stamp_ns for m in read] == stamps
    for (odometry, scan), (odometry_back, back) in zip(written, read, strict=True):
        np.testing.assert_allclose(back.ranges, scan.ranges, rtol=0, atol=0.5001e-3)
        np.testing.assert_array_equal(back.status, scan.status)
        np.testing.assert_allclose(odometry_back.pose, odometry.pose, rtol=0, atol=0.5001e-6)
        np.testing.assert_allclose(back.geometry.directions, scan.geometry.directions, rtol=0, atol=1e-12)
        np.testing.assert_allclose(back.geometry.origin, scan.geometry.origin, rtol=0, atol=1e-12)
        assert back.range_max_m == 30.0
    assert log.statistics.odometry_lines == 3


def test_rear_laser(tmp_path):
    path = tmp_path / "sim.log"
    write_carmen(path, [measurement(mounting=(-0.2, 0, math.pi), sensor="rear")])
    (read,) = CarmenLog(path)
    assert read.scan.sensor == "rear"
    np.testing.assert_allclose(read.scan.geometry.directions[90], [-1, 0], atol=1e-12)


def test_what_cannot_be_said_is_refused(tmp_path):
    good = measurement()
    late = Odometry.at(good.scan.stamp_ns + 1, good.odometry.pose)
    uneven = LaserScan.from_ranges(0, [1.0, 1.0, 1.0], ScanGeometry([-0.3, 0.0, 0.4]))
    aside = LaserScan.from_ranges(0, [1.0, 1.0, 1.0], ScanGeometry([0.0, 0.1, 0.2]))
    at_zero = Odometry.at(0, [0, 0, 0])
    too_far = measurement(n=3, ranges=[1.0, 90.0, 1.0])
    bare = good._replace(odometry=None)
    bad = [[good, bare], [bare, good, bare], [good._replace(odometry=late)], [Measurement(at_zero, uneven)]]
    for wrong in (*bad, [Measurement(at_zero, aside)], [too_far]):
        with pytest.raises(ArgumentError):
            write_carmen(tmp_path / "sim.log", wrong)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("sensor", ["front", "rear"])
def test_a_log_that_begins_without_odometry(tmp_path, sensor):
    path = tmp_path / "sim.log"
    scans = [measurement(k, mounting=(0.1, 0, 0.3), sensor=sensor).scan for k in range(4)]
    first, last = Odometry.at(1, [1, 2, 0.5]), Odometry.at(3, [2, 2, 0.5])
    write_carmen(path, map(Measurement, [None, first, first, last], scans))
    log = CarmenLog(path)
    read = list(log)
    assert [m.odometry and (m.odometry.stamp_ns, *m.odometry.pose) for m in read] == [
        None, (1, 1, 2, 0.5), (1, 1, 2, 0.5), (3, 2, 2, 0.5),
    ]  # fmt: skip
    assert log.statistics.odometry_lines == 2
    np.testing.assert_allclose(read[0].scan.geometry.base_from_laser, scans[0].geometry.base_from_laser, atol=1e-12)
