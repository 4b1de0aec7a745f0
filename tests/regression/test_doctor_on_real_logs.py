"""Logs of real robots: what is jitter, codes and habit there is no fault, and a laser that tilts is one."""

from __future__ import annotations

import pytest

from gridslam.doctor import Doctor, diagnose, quick_check
from gridslam.doctor.reader import reader_findings
from gridslam.io.log import open_log

CLEAN = [
    "intel.clf.bz2",
    "aces.clf.bz2",
    "mit-csail.clf.bz2",
    "bags/p3dx_trace0.bag",
    "bags/p3dx_sim_truth.bag",
    "bags/turtlebot4_floor",
]


@pytest.mark.parametrize("name", CLEAN)
def test_stamps_beams_ranges_and_mountings_of_good_logs_are_no_fault(data_dir, name):
    log, doctor = open_log(data_dir / name), Doctor(matching=False)
    for measurement in log:
        doctor.take(measurement)
    faults = [finding for finding in (*doctor.findings(), *reader_findings(log.statistics)) if finding.is_fault]
    assert faults == []
    assert quick_check(log) == ()


def test_a_laser_that_tilts_is_told(data_dir):
    diagnosis = diagnose(open_log(data_dir / "bags/tilt_laser.bag"))
    assert [finding.code for finding in diagnosis.faults if finding.severity is diagnosis.worst] == ["tilting_laser"]
    assert diagnosis.findings[0].size > 0.5


def test_a_log_without_odometry_and_transforms_is_doubtful(data_dir):
    diagnosis = diagnose(open_log(data_dir / "bags/handheld_broken_index.bag"))
    assert {finding.code for finding in diagnosis.faults} == {"no_odometry", "missing_transform"}
