"""Single faults are named with their size, and nothing else is; what no motion tells is not said."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gridslam.doctor.calibration import calibrate
from gridslam.doctor.finding import Severity
from gridslam.doctor.laser_motion import laser_motion
from gridslam.doctor.motion_findings import MotionExaminer, motion_findings, wheel_slips
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import compose, exp
from support.faults import FAULTS, with_fault
from support.laser_drives import log, perfect


def faults(motion):
    return {finding.code: finding for finding in motion_findings(motion) if finding.is_fault}


def test_a_clean_log_has_no_fault():
    assert faults(laser_motion(log()[0])) == {}


@pytest.mark.parametrize(
    "name", ["yaw_offset", "odometry_scale", "odometry_rotation_bias", "odometry_drift", "wheel_slip"]
)
def test_a_fault_is_named_with_its_size(name):
    found = faults(laser_motion(with_fault(log()[0], name, np.random.default_rng(0))))
    assert list(found) == [name]
    apart = found[name].size - FAULTS[name].size
    assert abs(wrap(apart) if name == "yaw_offset" else apart) < 0.2 * FAULTS[name].size
    assert found[name].sensor == "laser"
    assert found[name].remedy


@pytest.mark.parametrize(
    ("skew_s", "severity"), [(0.03, Severity.INFO), (-0.2, Severity.INFO), (0.5, Severity.WARNING)]
)
def test_a_skew_is_told_with_its_size_and_is_a_fault_where_matching_does_not_make_up_for_it(skew_s, severity):
    motion = laser_motion(with_fault(log()[0], "clock_skew", np.random.default_rng(0), skew_s))
    (found,) = (finding for finding in motion_findings(motion) if finding.code == "clock_skew")
    assert found.severity is severity
    assert found.size == pytest.approx(skew_s, rel=0.2)
    assert bool(found.remedy) == (severity is Severity.WARNING)


def test_a_reflected_laser_is_named():
    found = faults(laser_motion(with_fault(log()[0], "reflected_laser", np.random.default_rng(0))))
    assert list(found) == ["reflected_laser"]
    assert found["reflected_laser"].severity is Severity.ERROR


def test_a_laser_declared_and_mounted_upside_down_is_none():
    """Beams of an upside-down laser run clockwise in the base frame; the log says so, and all agrees."""
    measurements = with_fault(log()[0], "reflected_laser", np.random.default_rng(0))
    upside = np.diag([1.0, -1.0, -1.0, 1.0])
    geometries = {}

    def declared(scan):
        if scan.geometry not in geometries:
            mounting = scan.geometry.base_from_laser @ upside
            geometries[scan.geometry] = type(scan.geometry)(scan.geometry.bearings, mounting)
        return replace(scan, geometry=geometries[scan.geometry])

    motion = laser_motion(m._replace(scan=declared(m.scan)) for m in measurements)
    assert motion.upside_down
    assert faults(motion) == {}


def test_odometry_of_another_robot_is_unrelated():
    motion = perfect(120.0)
    other = np.cumsum(np.random.default_rng(0).normal(0, [0.02, 0.0, 0.05], motion.odometry.shape), axis=0)
    found = motion_findings(replace(motion, odometry=other))
    assert [finding.code for finding in found] == ["odometry_unrelated"]
    assert found[0].severity is Severity.ERROR


def slipped(motion, at, metres, radians=0.0, scans=10):
    """Odometry tells more over `scans` scans from `at` on."""
    odometry = motion.odometry.copy()
    for k in range(at, at + scans):
        before, rest = odometry[k].copy(), odometry[k:].copy()
        moved = compose(before, exp([metres / scans, 0.0, radians / scans]))
        odometry[k:] = compose(moved, compose(_inverse(before), rest))
    odometry[:, 2] = np.unwrap(odometry[:, 2])
    return replace(motion, odometry=odometry)


def _inverse(pose):
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.array([-c * pose[0] - s * pose[1], s * pose[0] - c * pose[1], -pose[2]])


def test_slips_are_found_where_they_are():
    rng = np.random.default_rng(0)
    motion = slipped(slipped(perfect(90.0, noise=(0.004, 0.001), rng=rng), 300, 0.4), 700, 0.25)
    first, second = wheel_slips(motion, calibrate(motion))
    assert first.metres == pytest.approx(0.4, abs=0.05)
    assert second.metres == pytest.approx(0.25, abs=0.05)
    assert first.stamp_ns * 1e-9 == pytest.approx(30.0, abs=1.2)
    assert second.stamp_ns * 1e-9 == pytest.approx(70.0, abs=1.2)
    assert 0.5 < first.duration_s < 3.0


@pytest.mark.parametrize("both", [True, False])
def test_wheels_slip_where_all_lasers_see_it_and_are_told_once(both):
    clean = log("rooms")[0]
    slipping = list(with_fault(clean, "wheel_slip", np.random.default_rng(0)))
    examiner = MotionExaminer()
    for front, rear in zip(slipping, slipping if both else clean, strict=True):
        examiner.take(front)
        examiner.take(rear._replace(scan=replace(rear.scan, sensor="rear")))
    codes = [finding.code for finding in examiner.findings()]
    assert codes.count("wheel_slip") == both
