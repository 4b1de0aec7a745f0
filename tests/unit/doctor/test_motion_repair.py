"""A repaired log is the log without its fault, and what needs no repair is left alone."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from gridslam.api.mapping import map_log
from gridslam.config import Configuration
from gridslam.doctor import Doctor
from gridslam.doctor.calibration import are_degrees, calibrate
from gridslam.doctor.motion_findings import motion_findings
from gridslam.doctor.repair import (
    Repair,
    RepairedLog,
    calibrate_early,
    describe_disagreement,
    find_needed_repair,
    repair_measurements,
)
from gridslam.evaluation import absolute_errors
from gridslam.geometry.angles import wrap
from gridslam.io.csv import write_csv_log
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.slam.grid_fastslam.grid_fastslam import GridFastSlam
from gridslam.types import Trajectory
from support.faults import with_fault
from support.hand_logs import MadeLog
from support.laser_drives import laser_motion, log

FILTER_ALONE = Configuration(particles=2, loop_closure=None)


def test_an_offset_of_the_yaw_and_its_repair_leave_the_log_as_it_was():
    measurements = log(scans=120)[0]
    faulty = with_fault(measurements, "yaw_offset", np.random.default_rng(0), 0.3)
    mended = list(repair_measurements(faulty, Repair(yaw_rad=0.3)))
    for one, other in zip(mended[::30], measurements[::30], strict=True):
        assert one.scan.stamp_ns == other.scan.stamp_ns
        np.testing.assert_array_equal(one.odometry.pose, other.odometry.pose)
        np.testing.assert_allclose(one.scan.beams(0.1, 20).ends, other.scan.beams(0.1, 20).ends, atol=1e-9)


def test_a_reflected_laser_sees_the_world_again():
    """Ranges in reverse order at bearings of the other sign: the same ends in reverse, one beam's step aside."""
    measurements = log(scans=10)[0]
    mended = repair_measurements(
        with_fault(measurements, "reflected_laser", np.random.default_rng(0)), Repair(reflected=True)
    )
    for one, other in zip(mended, measurements, strict=True):
        ends, true = one.scan.beams(0.1, 20).ends[::-1], other.scan.beams(0.1, 20).ends
        assert np.hypot(*(ends - true).T).max() < 20 * np.pi / 180 * 1.01


def test_the_map_of_a_reflected_log_is_right_once_it_is_repaired():
    measurements, truth = log(scans=300)
    faulty = tuple(with_fault(measurements, "reflected_laser", np.random.default_rng(0)))
    repair = find_needed_repair(calibrate_early(faulty))
    clean, spoiled, mended = (error_m(m, truth) for m in (measurements, faulty, repair_measurements(faulty, repair)))
    assert spoiled > 10 * clean
    assert mended < clean + 0.03


def error_m(measurements, truth):
    recorder = TrajectoryRecorder()
    run(measurements, GridFastSlam(particles=4), rng=np.random.default_rng(0), observers=[recorder])
    online = recorder.online_trajectory()
    return absolute_errors(online, Trajectory(online.stamps_ns, truth)).trans_rmse_m


def test_a_repaired_log_is_what_map_log_maps_and_tells(tmp_path):
    """A mirrored log, mapped as it is and repaired: one map is the mirror image of the building, one is right."""
    measurements, truth = log(scans=400)
    faulty = list(with_fault(measurements, "reflected_laser", np.random.default_rng(0)))
    write_csv_log(tmp_path / "mirrored.csv", faulty)
    errors = {}
    for repair in ("needed", "none"):
        result = map_log(tmp_path / "mirrored.csv", configuration=FILTER_ALONE, repair=repair)
        assert result.repair == (Repair(reflected=True) if repair == "needed" else Repair())
        true = Trajectory(result.trajectory.stamps_ns, truth)
        errors[repair] = absolute_errors(result.trajectory, true).trans_rmse_m
    assert errors["needed"] < 0.1 < errors["none"]


def mirrored(measurements, sign):
    """The log with the signs of its odometry (x, y, theta) changed."""
    return [m._replace(odometry=replace(m.odometry, pose=m.odometry.pose * sign)) for m in measurements]


@pytest.mark.parametrize(("sign", "what"), [((1, 1, -1), "heading"), ((1, -1, 1), "path")])
def test_an_odometry_that_contradicts_itself_is_mirrored_and_not_the_laser(sign, what):
    measurements, truth = log(scans=300)
    faulty = mirrored(measurements, np.array(sign))
    repair = find_needed_repair(calibrate_early(faulty))
    assert repair == Repair(mirrored=what)
    (finding,) = (f for f in motion_findings(calibrate(laser_motion(faulty))) if f.is_fault)
    assert finding.code == "odometry_mirrored"
    clean, mended = (error_m(m, truth) for m in (measurements, repair_measurements(faulty, repair)))
    assert mended < clean + 0.03


def test_a_mirrored_odometry_is_no_robot_that_was_carried():
    """Although its headings predict other views than those that come."""
    rng = np.random.default_rng(2)
    drive = simulate(make_world("random", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=360), rng)
    faulty = mirrored(drive.measurements[:400], np.array([1, 1, -1]))
    doctor = Doctor()
    for measurement in faulty:
        doctor.take(measurement)
    assert {finding.code for finding in doctor.findings() if finding.is_fault} == {"odometry_mirrored"}


def changed(measurements, change):
    """The log with other poses of the odometry."""
    return [m._replace(odometry=replace(m.odometry, pose=change(m.odometry.pose))) for m in measurements]


def read_as_degrees(pose):
    """A heading in degrees that is taken for rad."""
    return np.array([*pose[:2], wrap(math.degrees(pose[2]))])


@pytest.mark.parametrize(
    ("change", "problem", "code"),
    [
        (read_as_degrees, "headings of the odometry look like degrees", "odometry_units"),
        (
            lambda pose: pose * [1 / 0.3048, 1 / 0.3048, 1],
            "more distance than the laser measures, over .* m: it is in feet",
            "odometry_scale",
        ),
        (
            lambda pose: pose * [1 / 0.0254, 1 / 0.0254, 1],
            "more distance than the laser measures, over .* m: it is in inches",
            "odometry_scale",
        ),
        (lambda pose: pose * [2, 2, 1], "more distance than the laser measures", "odometry_scale"),
        (lambda pose: pose * 0, "Odometry stands still while the laser moves", "odometry_frozen"),
        (lambda pose: pose * [1, 1, 0], "Odometry turns .* less than the laser measures", "odometry_rotation_bias"),
    ],
)
def test_a_laser_and_an_odometry_that_cannot_both_be_right_are_told_of_while_mapping(change, problem, code):
    measurements = log(scans=400)[0]
    faulty = changed(measurements, change)
    calibration = calibrate_early(faulty)
    assert re.search(problem, describe_disagreement(calibration))
    assert not find_needed_repair(calibration).reflected
    assert code in {finding.code for finding in motion_findings(calibrate(laser_motion(faulty)))}
    repaired = RepairedLog(MadeLog(faulty))
    list(repaired)
    assert any(re.search(problem, remark) for remark in repaired.statistics.remarks)


def test_a_laser_and_an_odometry_that_are_right_are_not_told_of():
    healthy = RepairedLog(MadeLog(log(scans=400)[0]))
    list(healthy)
    assert not healthy.disagreement
    assert not healthy.statistics.remarks


def test_degrees_are_told_by_turns_that_are_no_rad():
    """Turns of 6.39 degrees, from scan to scan, are alike as both."""
    laser = np.full(200, math.tau / (math.degrees(1.0) - 1))
    assert not are_degrees(laser, laser)
    assert not are_degrees(laser[:5] * 50, laser[:5])
    slower = np.random.default_rng(0).normal(0.05, 0.03, 200)
    assert are_degrees(wrap(np.degrees(slower)), slower)
    assert not are_degrees(slower, slower)
