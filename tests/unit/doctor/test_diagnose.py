"""The whole diagnosis: what is healthy, what only matching tells, what breaks off, and the report of it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.doctor import CheckedLog, Doctor, Severity, diagnose
from gridslam.doctor.report import document, text, verdict
from gridslam.errors import InputError
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between
from gridslam.io.log_statistics import LogStatistics
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.types import ScanGeometry
from support.faults import FAULTS, with_fault
from support.hand_logs import drive, findings, seen


class Memory:
    """A log that is in memory, and may break off."""

    def __init__(self, measurements, breaks_off=False):
        self.path, self.statistics = Path("memory.log"), LogStatistics()
        self._measurements, self._breaks_off = tuple(measurements), breaks_off

    def __iter__(self):
        self.statistics = LogStatistics()
        for measurement in self._measurements:
            self.statistics.count(measurement)
            yield measurement
        if self._breaks_off:
            raise InputError(self.path, "cut off")


@pytest.fixture(scope="module")
def rooms():
    rng = np.random.default_rng(0)
    return simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(), rng)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda poses: [*poses[:150], *between(poses[150], poses[150:])], "odometry_jumps"),
        (lambda poses: poses * [1000, 1000, 1], "odometry_scale"),
        (lambda poses: np.column_stack([poses[:, :2], wrap(np.degrees(poses[:, 2]))]), "odometry_units"),
        (lambda poses: np.tile(poses[0], (len(poses), 1)), "odometry_frozen"),
    ],
    ids=["reset", "millimetres", "degrees", "frozen"],
)
def test_what_follows_from_a_fault_is_no_fault_of_its_own(rooms, change, code):
    """A jump is an outlier where motions are compared; of another unit, or of a frozen one, nothing else is told."""
    measurements = rooms.measurements[:450]
    poses = change(np.array([m.odometry.pose for m in measurements]))
    odometry = (replace(m.odometry, pose=pose) for m, pose in zip(measurements, poses, strict=True))
    diagnosis = diagnose(Memory(m._replace(odometry=o) for m, o in zip(measurements, odometry, strict=True)))
    assert [finding.code for finding in diagnosis.faults] == [code]


def test_a_fault_of_one_laser_hides_nothing_of_another(rooms):
    measurements = rooms.measurements[:450]
    scaled = [m._replace(odometry=replace(m.odometry, pose=m.odometry.pose * [1.2, 1.2, 1])) for m in measurements]
    wrong = [m._replace(scan=replace(m.scan, ranges=np.minimum(m.scan.ranges, 6.0))) for m in scaled]
    alone = {finding.code: finding for finding in diagnose(Memory(wrong)).faults}
    assert alone["range_limits"].severity is Severity.ERROR
    assert "odometry_scale" not in alone
    healthy = [m._replace(scan=replace(m.scan, sensor="rear")) for m in scaled]
    both = diagnose(Memory(m for pair in zip(wrong, healthy, strict=True) for m in pair)).faults
    assert [finding.sensor for finding in both if finding.code == "odometry_scale"] == ["rear"]


def test_a_healthy_log_is_said_to_be_healthy(rooms):
    ticks = []
    diagnosis = diagnose(Memory(rooms.measurements), on_progress=lambda: ticks.append(0))
    assert len(ticks) == len(rooms)
    assert diagnosis.faults == ()
    assert diagnosis.worst is Severity.INFO
    assert "healthy" in verdict(diagnosis)
    length = np.hypot(*np.diff(rooms.odometry.poses[:, :2], axis=0).T).sum()
    assert diagnosis.metres == pytest.approx(length)
    (laser,) = diagnosis.lasers.values()
    assert (laser["scans"], laser["beams"], laser["direction"]) == (len(rooms), 180, "counter-clockwise")
    assert laser["rate_hz"] == pytest.approx(5.0)
    assert laser["mounting"] == {
        "x_m": pytest.approx(0.1),
        "y_m": 0.0,
        "yaw_rad": 0.0,
        "tilt_rad": 0.0,
        "upside_down": False,
    }


@pytest.mark.parametrize(
    "fault",
    [
        "beam_count_varies",
        "invalid_beams",
        "range_limits",
        "tilting_laser",
        "gaps",
        "backward_stamps",
    ],
)
def test_each_fault_that_needs_no_matching_is_named_with_its_size(rooms, fault):
    found = findings(with_fault(rooms.measurements, fault, np.random.default_rng(1)))
    assert found[fault].size == pytest.approx(FAULTS[fault].size, rel=0.2)
    assert [other.code for other in found.values() if other.is_fault and other.code != fault] == []


def test_a_log_that_breaks_off_is_diagnosed_as_far_as_it_goes():
    diagnosis = diagnose(Memory(drive(), breaks_off=True))
    assert (diagnosis.findings[0].code, diagnosis.findings[0].size) == ("unreadable", 200)
    assert "memory.log: cut off" in diagnosis.findings[0].message
    assert diagnosis.worst is Severity.ERROR
    with pytest.raises(InputError):
        diagnose(Memory([], breaks_off=True))


def test_a_check_that_fails_ends_no_map(monkeypatch):
    def fail(self, measurement):
        raise RuntimeError("injected")

    monkeypatch.setattr(Doctor, "take", fail)
    reported = []
    log = CheckedLog(Memory(drive(10)), reported.append)
    assert len(list(log)) == 50
    ((finding,),) = reported
    assert finding.code == "checks_failed"
    assert "RuntimeError: injected" in finding.message


@pytest.mark.filterwarnings("ignore:ranges have a median")
@settings(max_examples=40, deadline=None)
@given(st.data())
def test_whatever_a_reader_gives_is_diagnosed(data):
    """Any number of beams, stamps in any order, ranges of any kind, odometry that comes and goes, lasers anywhere."""
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    counts = data.draw(st.lists(st.integers(0, 60), min_size=1, max_size=3))
    clumsy, timed = data.draw(st.sampled_from([1.0, 1e3, 1e9])), data.draw(st.booleans())
    geometries = [ScanGeometry.planar(np.sort(rng.uniform(-3, 3, n)), rng.uniform(-1, 1, 3)) for n in counts]

    def one(k):
        geometry = geometries[rng.integers(len(geometries))]
        ranges = rng.choice([np.nan, np.inf, 0.0, -1.0, 1e-3, 3.0, 5.0, 1e6], len(geometry.bearings))
        pose = None if rng.random() < 0.2 else tuple(clumsy * rng.standard_normal(3))
        sensor, times = "ab"[rng.integers(2)], rng.normal() * np.arange(len(ranges)) if timed else None
        stamp_s = clumsy * rng.choice([0.0, 0.1 * k, rng.normal()])
        return seen(stamp_s, ranges, pose, geometry, sensor=sensor, beam_times_s=times)

    diagnosis = diagnose(Memory(one(k) for k in range(data.draw(st.sampled_from([1, 2, 40])))))
    json.dumps(document(diagnosis), allow_nan=False)
    assert text(diagnosis)
