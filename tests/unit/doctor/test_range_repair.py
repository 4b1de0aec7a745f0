"""Beams that hit nothing but are told as hits are taken out; walls are left alone."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from gridslam.doctor.range_limits import RangeCounts
from gridslam.doctor.repair import RepairedLog
from gridslam.io.csv import write_csv_log
from gridslam.io.log import open_log
from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, RobotConfig, make_world, simulate
from gridslam.types import BeamStatus, LaserScan
from support.laser_drives import FAIR

REACH_M, STATED_M = 8.18, 100.0
MARGIN_M = 0.05
"""Readings of "no return" jitter: from so much below them on hits count as none."""


@functools.cache
def drive(lost: float = 0.1) -> tuple[Measurement, ...]:
    """90 s through rooms and corridors, seen by a laser that reaches 8.18 m and loses a share of its beams."""
    rng = np.random.default_rng(3)
    lidar = LidarConfig(range_max_m=REACH_M, no_return="inf", no_return_probability=lost)
    return simulate(make_world("demo", rng), RobotConfig(), FAIR, lidar, rng).measurements[:450]


def told(value_m: float, lost: float = 0.1, jitter_m: float = 0.0, sensor: str = "laser") -> list[Measurement]:
    """The drive, as a driver tells it that says `value_m` where there was no return."""
    rng = np.random.default_rng(4)
    log = []
    for odometry, scan in drive(lost):
        said = value_m + jitter_m * rng.uniform(-1, 1, len(scan))
        ranges = np.where(scan.status == BeamStatus.NO_RETURN, said, scan.ranges)
        scan = LaserScan.from_ranges(scan.stamp_ns, ranges, scan.geometry, range_max_m=STATED_M, sensor=sensor)
        log.append(Measurement(odometry, scan))
    return log


def mended(folder, measurements):
    """What a repaired log reads, and its repair."""
    write_csv_log(folder / "log.csv", measurements)
    log = RepairedLog(open_log(folder / "log.csv"))
    return list(log), log.repair


def counted(measurements) -> RangeCounts:
    counts = RangeCounts()
    for _, scan in measurements:
        counts.take(scan)
    return counts


@pytest.mark.parametrize("jitter_m", [0.0, 0.004])
def test_beams_that_hit_nothing_are_no_hits_once_the_log_is_repaired(tmp_path, jitter_m):
    """All of them, and no other but what lies within the margin; ranges and stamps stay as they are."""
    faulty = told(REACH_M, jitter_m=jitter_m)
    found, repair = mended(tmp_path, faulty)
    assert repair.range_max_m == pytest.approx(REACH_M - MARGIN_M, abs=0.01)
    assert [line for line in repair.describe() if "8.13 m" in line and "no-return beams" in line]
    lost = 0
    for one, wrong, true in zip(found, faulty, drive(), strict=True):
        assert one.scan.stamp_ns == wrong.scan.stamp_ns
        false = true.scan.status == BeamStatus.NO_RETURN
        assert (wrong.scan.status[false] == BeamStatus.HIT).all()
        assert (one.scan.status[false] == BeamStatus.NO_RETURN).all()
        near = ~false & (true.scan.ranges >= REACH_M - MARGIN_M - 0.01)
        others = ~false & ~near
        np.testing.assert_array_equal(one.scan.status[others], wrong.scan.status[others])
        np.testing.assert_array_equal(one.scan.ranges[others], wrong.scan.ranges[others])
        lost += int(near.sum())
    assert lost < 0.005 * sum(len(scan) for _, scan in faulty)


def test_a_log_that_tells_no_return_truly_keeps_its_ranges(tmp_path):
    clean = drive()
    found, repair = mended(tmp_path, clean)
    assert repair.range_max_m is None
    for one, other in zip(found, clean, strict=True):
        np.testing.assert_array_equal(one.scan.status, other.scan.status)


@pytest.mark.parametrize(("value_m", "is_false"), [(8.18, True), (29.9, True), (30.0, False), (50.0, False)])
def test_false_hits_are_those_that_would_be_used(value_m, is_false):
    found = counted(told(value_m)).false_hits_m()
    assert (found is not None) is is_false
    if found is not None:
        assert found == pytest.approx(value_m - MARGIN_M, abs=0.01)
