"""Single faults are named with their size, and nothing else is; what no motion tells is not said."""

from dataclasses import replace

import numpy as np
import pytest

from gridslam.doctor import Doctor
from gridslam.doctor.calibration import calibrate
from gridslam.doctor.finding import Severity
from gridslam.doctor.motion_findings import motion_findings
from gridslam.geometry.angles import wrap
from support.faults import FAULTS, with_fault
from support.laser_drives import laser_motion, log, perfect


def faults(motion):
    return {finding.code: finding for finding in motion_findings(calibrate(motion)) if finding.is_fault}


def test_a_clean_log_has_no_fault():
    assert faults(laser_motion(log()[0])) == {}


@pytest.mark.parametrize("name", ["yaw_offset", "odometry_scale", "odometry_rotation_bias", "odometry_drift"])
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
    (found,) = (finding for finding in motion_findings(calibrate(motion)) if finding.code == "clock_skew")
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
    found = motion_findings(calibrate(replace(motion, odometry=other)))
    assert [finding.code for finding in found] == ["odometry_unrelated"]
    assert found[0].severity is Severity.ERROR


@pytest.mark.parametrize("both", [True, False])
def test_wheels_are_at_fault_where_all_lasers_see_it_and_are_told_once(both):
    clean = log("rooms")[0]
    faulty = list(with_fault(clean, "odometry_scale", np.random.default_rng(0)))
    doctor = Doctor()
    for front, rear in zip(faulty, faulty if both else clean, strict=True):
        doctor.take(front)
        doctor.take(rear._replace(scan=replace(rear.scan, sensor="rear")))
    codes = [finding.code for finding in doctor.findings()]
    assert codes.count("odometry_scale") == both
