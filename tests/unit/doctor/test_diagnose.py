"""The whole diagnosis: what is healthy, what only matching tells, what breaks off, and the report of it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.doctor import CheckedLog, Doctor, Finding, Severity, diagnose
from gridslam.doctor.report import document, markdown, text, verdict
from gridslam.errors import InputError
from gridslam.io.log import Log
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate, simulate_stream
from gridslam.types import ScanGeometry
from gridslam.viz.chart import draw_chart
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
    assert (laser.scans, laser.beams, laser.clockwise, laser.upside_down) == (len(rooms), 180, False, False)
    assert laser.rate_hz == pytest.approx(5.0)
    assert laser.mounting == pytest.approx([0.1, 0, 0])


@pytest.mark.parametrize(
    "fault",
    [
        "beam_count_varies",
        "invalid_beams",
        "range_limits",
        "tilting_laser",
        "gaps",
        "backward_stamps",
        "standing_still",
    ],
)
def test_each_fault_that_needs_no_matching_is_named_with_its_size(rooms, fault):
    found = findings(with_fault(rooms.measurements, fault, np.random.default_rng(1)))
    assert found[fault].size == pytest.approx(FAULTS[fault].size, rel=0.2)
    assert [other.code for other in found.values() if other.is_fault and other.code != fault] == []


SPINNING = {"beams": 120, "field_of_view_rad": math.tau, "rate_hz": 10.0, "range_max_m": 12.0, "scan_time_s": 0.1}


def skewed(backward=False, **lidar):
    rng = np.random.default_rng(4)
    robot, laser = RobotConfig(omega_max_rad_s=2.5), LidarConfig(**(SPINNING | lidar))
    log = simulate_stream(make_world("demo", rng), robot, OdometryNoise(), laser, rng)
    measurements = [
        m._replace(scan=replace(m.scan, beam_times_s=m.scan.beam_times_s[::-1])) if backward else m
        for m in islice(log.measurements, 900)
    ]
    return {finding.code: finding for finding in diagnose(Memory(measurements)).findings}


def test_scans_that_take_time_and_do_not_tell_it_are_named():
    found = skewed(reports_beam_times=False)
    smear = found["skewed_while_turning"]
    assert smear.severity is Severity.WARNING
    assert smear.size == pytest.approx(2.5 * 0.1, rel=0.2)
    assert "time_increment" in smear.remedy
    assert "clock_skew" not in found, "that a scan looks half of its sweep early is the same fault"


def test_a_log_that_breaks_off_is_diagnosed_as_far_as_it_goes():
    diagnosis = diagnose(Memory(drive(), breaks_off=True))
    assert (diagnosis.findings[0].code, diagnosis.findings[0].size) == ("unreadable", 200)
    assert "memory.log: cut off" in diagnosis.findings[0].message
    assert diagnosis.worst is Severity.ERROR
    with pytest.raises(InputError):
        diagnose(Memory([], breaks_off=True))


@pytest.mark.parametrize("count", [50, 1000])
def test_a_checked_log_gives_all_and_tells_early(count):
    told, given = [], []
    source = Memory(Measurement(None, m.scan) for m in drive(count / 5))
    log = CheckedLog(source, lambda found: told.append((given[-1], found)))
    for k, _ in enumerate(log):
        given.append(k)
    assert given == list(range(count))
    ((at, (finding,)),) = told
    assert finding.code == "no_odometry"
    assert at <= 299
    assert isinstance(log, Log)
    assert log.statistics.scan_count == count


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


FINDINGS = (
    Finding("topics", Severity.INFO, "It holds things.", 3, "topics"),
    Finding("gaps", Severity.WARNING, "A gap.", np.float64(2.5), "s", "Mend it.", "front"),
    Finding("few_hits", Severity.ERROR, "Nothing seen.", math.inf, "share"),
)


def diagnosis_of(*found):
    log = SimpleNamespace(path=Path("a.log"), statistics=LogStatistics())
    return Doctor(matching=False).diagnosis(log, found)


def test_the_report_tells_the_worst_first_and_fits_into_json():
    told = json.loads(json.dumps(document(diagnosis_of(*FINDINGS)), allow_nan=False))
    assert [finding["code"] for finding in told["findings"]] == ["few_hits", "gaps", "topics"]
    assert [finding["size"] for finding in told["findings"]] == [None, 2.5, 3.0]
    assert told["counts"] == {"info": 1, "warning": 1, "error": 1}
    lines = "\n".join(text(diagnosis_of(*FINDINGS)))
    assert "Faults that make the map unusable:\n  few_hits: Nothing seen." in lines
    assert "gaps (front): A gap.\n    -> Mend it." in lines
    assert "## Warnings" in markdown(diagnosis_of(*FINDINGS))


@pytest.mark.parametrize(
    ("chosen", "words"),
    [
        ((0,), "This log is healthy"),
        ((0, 1), "No fault makes the map unusable; 1 warning."),
        ((2,), "The map would be unusable: 1 fault."),
        ((1, 2), "The map would be unusable: 1 fault; 1 warning."),
    ],
)
def test_the_verdict(chosen, words):
    assert words in verdict(diagnosis_of(*(FINDINGS[k] for k in chosen)))


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
    assert markdown(diagnosis)
    for finding in diagnosis.findings:
        if finding.figure is not None:
            draw_chart(finding.figure)
