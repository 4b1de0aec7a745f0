"""Odometry, turning and mountings: each finding in a log that has it, and in none that has not."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gridslam.doctor import Severity
from gridslam.doctor.diagnose import EarlyCheck
from gridslam.io.measurement import Measurement
from gridslam.types import ScanGeometry
from support.hand_logs import BEARINGS, drive, findings, seen


@pytest.mark.parametrize(
    ("share", "severity"), [(1.0, Severity.WARNING), (0.1, Severity.WARNING), (0.01, Severity.INFO)]
)
def test_scans_without_odometry(share, severity):
    log = [Measurement(None if k < 200 * share else m.odometry, m.scan) for k, m in enumerate(drive())]
    found = findings(log)["no_odometry"]
    assert (found.severity, found.size) == (severity, pytest.approx(share))
    assert ("--no-odometry" in found.remedy) == (share == 1.0)


@pytest.mark.parametrize(("seconds", "severity"), [(40, Severity.ERROR), (4, Severity.WARNING), (2, None)])
def test_frozen_odometry(seconds, severity):
    def log():
        for k, m in enumerate(drive(60.0)):
            frozen = 10.0 <= k / 5 <= 10.0 + seconds
            yield seen(k / 5, m.scan.ranges, (3.0, 0.0, 0.0) if frozen else tuple(m.odometry.pose))

    found = findings(log()).get("odometry_frozen")
    assert (found and found.severity) == severity
    if found:
        assert found.size == pytest.approx(seconds, abs=1.5)  # it is looked at once a second


@pytest.mark.parametrize(
    ("metres", "radians", "told"), [(3.0, 0.0, 3.0), (0.0, 2.5, 2.5), (1e8, 1.0, 1e8), (0.9, 0.9, None)]
)
def test_odometry_that_jumps(metres, radians, told):
    """No robot with wheels drives 3 m, or turns by 2.5 rad, in a fifth of a second."""

    def log():
        for m in drive(60.0):
            x, y, theta = m.odometry.pose
            after = x > 10
            yield seen(m.scan.stamp_ns * 1e-9, m.scan.ranges, (x + metres * after, y, theta + radians * after))

    found = findings(log()).get("odometry_jumps")
    assert (found and found.severity) == (Severity.WARNING if told else None)
    if found:
        assert found.size == pytest.approx(told, rel=0.1)
        assert "once" in found.message


def pitched(tilt_rad, height_m=0.3, roll=False):
    """Geometry of a laser whose nose, or side, is down by `tilt_rad`."""
    c, s = math.cos(tilt_rad), math.sin(tilt_rad)
    mounting = np.eye(4)
    mounting[:3, :3] = [[1, 0, 0], [0, c, -s], [0, s, c]] if roll else [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    mounting[2, 3] = height_m
    return ScanGeometry(BEARINGS, mounting)


def tilted(geometry_at):
    return [Measurement(m.odometry, replace(m.scan, geometry=geometry_at(k))) for k, m in enumerate(drive())]


@pytest.mark.parametrize("roll", [False, True])
def test_a_laser_that_tilts_spoils(roll):
    found = findings(tilted(lambda k: pitched(0.3 * math.sin(k / 5), roll=roll)))["tilting_laser"]
    assert (found.severity, found.unit) == (Severity.ERROR, "rad")
    assert found.size == pytest.approx(0.3, abs=0.005)


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds")])
def test_stamps_in_another_unit_are_named_by_the_speed(factor, unit):
    slow = [seen(k / 5 * factor, m.scan.ranges, tuple(m.odometry.pose)) for k, m in enumerate(drive())]
    found = findings(slow)
    assert found["stamp_units"].size == pytest.approx(0.3 / factor, rel=0.05, abs=1e-6)
    assert f"look like {unit}" in found["stamp_units"].message
    check = EarlyCheck()
    told = [finding.code for m in slow for finding in check.take(m)]
    assert told == ["stamp_units"], "although the first minute has one scan alone"
    assert "stamp_units" not in findings(drive(v=0.01))


@pytest.mark.parametrize(("away_m", "told"), [(4.0, None), (10.0, Severity.ERROR)])
def test_a_laser_farther_from_the_base_than_any_robot_is_long(away_m, told):
    mounting = np.eye(4)
    mounting[1, 3] = away_m
    found = findings(
        seen(k / 5, m.scan.ranges, (0.06 * k, 0, 0), ScanGeometry(BEARINGS, mounting)) for k, m in enumerate(drive())
    )
    assert (found.get("laser_far_away") and found["laser_far_away"].severity) == told


def test_scans_in_the_optical_frame_of_a_camera_are_told():
    """x to the right, y down, z ahead: the beams, in the plane of x and y, would all be in one vertical plane."""
    optical = np.array([[0.0, 0.0, 1.0, 0.1], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    found = findings(
        seen(k / 5, m.scan.ranges, (0.06 * k, 0, 0), ScanGeometry(BEARINGS, optical)) for k, m in enumerate(drive())
    )
    assert found["tilting_laser"].severity is Severity.ERROR
    assert found["tilting_laser"].size == pytest.approx(math.pi / 2)
    assert "optical frame" in found["tilting_laser"].message
