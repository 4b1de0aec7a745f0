"""Logs of real robots: what is jitter, codes and habit there is no fault, and a laser that tilts is one."""

from dataclasses import replace
from itertools import islice

import pytest

from gridslam.doctor import Doctor, diagnose
from gridslam.doctor.reader import reader_findings
from gridslam.doctor.view_breaks import ViewBreaks
from gridslam.io.log import open_log
from gridslam.scan import ScanGeometry
from support.implausible_ranges import VARIANTS, check, found_early, real_logs

pytestmark = pytest.mark.filterwarnings("ignore:ranges have a median")

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
    assert found_early(log) == []


def test_clutter_seen_by_few_beams_is_no_carried_robot(data_dir):
    """Among beds two views in a row differ wholly, and most beams that would show the walls are left out."""
    log, breaks = open_log(data_dir / "large/hospital.clf.bz2"), ViewBreaks()
    for measurement in islice(log, 3700, 3950):
        scan = measurement.scan
        few = ScanGeometry(scan.geometry.bearings[::3], scan.geometry.base_from_laser)
        thin = replace(scan, ranges=scan.ranges[::3], status=scan.status[::3], geometry=few)
        assert not breaks.take(measurement._replace(scan=thin))


@pytest.mark.parametrize("late", [2, 3])
def test_odometry_that_comes_late_is_no_carried_robot(data_dir, late):
    """By 0.4 or 0.6 s, while the robot turns by up to 0.35 rad from scan to scan."""
    measurements, breaks = list(open_log(data_dir / "aces.clf.bz2")), ViewBreaks()
    for now, before in zip(measurements[late:], measurements, strict=False):
        assert not breaks.take(now._replace(odometry=before.odometry))


def test_a_laser_that_tilts_is_told(data_dir):
    diagnosis = diagnose(open_log(data_dir / "bags/tilt_laser.bag"))
    assert [finding.code for finding in diagnosis.faults if finding.severity is diagnosis.worst] == ["tilting_laser"]
    assert diagnosis.findings[0].size > 0.5


def test_a_log_without_odometry_and_transforms_is_doubtful(data_dir):
    diagnosis = diagnose(open_log(data_dir / "bags/handheld_broken_index.bag"))
    assert {finding.code for finding in diagnosis.faults} == {"no_odometry", "missing_transform"}


@pytest.mark.parametrize(
    ("name", "due"),
    [("ranges_in_mm", "range_units"), ("frozen_scan", "laser_frozen"), ("uniform_random_ranges", "random_ranges")],
)
def test_ranges_of_which_no_map_can_be_built_are_named(data_dir, name, due):
    log = open_log(data_dir / f"hostile/{name}.csv.gz")
    assert check(log) == (due,)
    assert [finding.code for finding in diagnose(log).faults] == [due]


def test_ranges_in_feet_are_named_by_the_motion(data_dir):
    (found,) = diagnose(open_log(data_dir / "hostile/ranges_in_feet.csv.gz")).faults
    assert found.code == "odometry_scale"
    assert "the ranges are in feet" in found.message


def test_no_ranges_of_good_logs_are_implausible(data_dir):
    logs = dict(real_logs(data_dir))
    assert len(logs) > 15
    assert {name: check(log) for name, log in logs.items()} == dict.fromkeys(logs, ())


@pytest.mark.parametrize("name", ["intel.clf.bz2", "mit-csail.clf.bz2", "loops/wean2.clf.gz", "sparse/seattle.clf.gz"])
def test_good_logs_in_other_units_are_named(data_dir, name):
    for variant in ("in centimetres", "in millimetres", "in millimetres, limit in m"):
        assert check(VARIANTS[variant][1](open_log(data_dir / name))) == ("range_units",), variant
