"""The whole diagnosis: what is healthy, what only matching tells, what breaks off, and the report of it."""

from __future__ import annotations

import json
import math
import tracemalloc
from dataclasses import replace
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.doctor import CheckedLog, Doctor, Finding, Severity, diagnose, quick_check
from gridslam.doctor.report import document, markdown, picture_name, text, verdict
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


def test_a_laser_that_tilts_is_no_witness_of_the_motion(rooms):
    diagnosis = diagnose(Memory(with_fault(rooms.measurements, "tilting_laser", np.random.default_rng(1))))
    assert [finding.code for finding in diagnosis.faults] == ["tilting_laser"]


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


def test_clockwise_scans_too():
    assert skewed(reports_beam_times=False, clockwise=True)["skewed_while_turning"].severity is Severity.WARNING


@pytest.mark.parametrize("backward", [False, True])
def test_times_that_are_told_are_gone_by_unless_they_are_told_backward(backward):
    found = skewed(backward)["skewed_while_turning"]
    assert found.severity is Severity.INFO
    assert ("reverse order" in found.message) == backward


def test_scans_taken_in_an_instant_are_not():
    assert "skewed_while_turning" not in skewed(scan_time_s=0.0)


def test_a_log_that_breaks_off_is_diagnosed_as_far_as_it_goes():
    diagnosis = diagnose(Memory(drive(), breaks_off=True))
    assert (diagnosis.findings[0].code, diagnosis.findings[0].size) == ("unreadable", 200)
    assert "memory.log: cut off" in diagnosis.findings[0].message
    assert diagnosis.worst is Severity.ERROR
    with pytest.raises(InputError):
        diagnose(Memory([], breaks_off=True))


def test_memory_does_not_grow_with_the_log():
    def peak(seconds):
        doctor = Doctor(matching=False)
        tracemalloc.start()
        for measurement in drive(seconds):
            doctor.take(measurement)
        found = list(doctor.findings())
        memory = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert not found
        return memory

    short, long = peak(100), peak(300)  # 500 and 1500 scans of 1.5 kB: 1.5 MB more, were they kept
    assert long < short + 0.5e6


def test_the_quick_check_looks_at_the_first_minute_only():
    late = [m if k < 400 else Measurement(None, m.scan) for k, m in enumerate(drive(200))]
    early = [Measurement(None, m.scan) if k < 20 else m for k, m in enumerate(drive(200))]
    assert quick_check(Memory(late)) == ()
    assert [finding.code for finding in quick_check(Memory(early))] == ["no_odometry"]
    standing = (seen(k / 5, m.scan.ranges, (0.0, 0.0, 0.0)) for k, m in enumerate([next(drive())] * 99))
    assert quick_check(Memory(standing)) == ()


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


def test_pictures_are_named_by_number_and_code():
    (gap,) = (f for f in findings([m for m in drive() if not 9 < m.scan.stamp_ns * 1e-9 < 15]).values())
    assert picture_name(3, gap) == "03_gaps.png"
    assert picture_name(3, replace(gap, figure=None)) is None


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


def test_what_the_reader_misses_is_reported_at_once_and_kept():
    """An unknown mounting and a missing file by the first minute's end, other warnings at the end; each once."""
    source, told = Memory(drive(100)), []
    log = CheckedLog(source, lambda found: told.extend((source.statistics.scan_count, f.code) for f in found))
    for k, _ in enumerate(log):
        statistics = source.statistics
        statistics.missing_transforms["mounting: no transform names laser: taken to be at the robot's base"] = k + 1
        statistics.missing_files = ("split_1.db3",)
        statistics.clock_offset_s = 2.5 if k == 499 else 0.0
    assert told == [(300, "missing_files"), (300, "missing_transform"), (500, "clock_skew")]
    assert set(log.statistics.faults) == {"missing_files", "missing_transform", "clock_skew"}
    assert "split_1.db3" in log.statistics.faults["missing_files"]
    assert "odometry are 2.5 s ahead" in log.statistics.faults["clock_skew"]


def test_two_clocks_are_the_cause_and_not_that_there_is_no_odometry():
    source = Memory(measurement._replace(odometry=None) for measurement in drive(10))

    class Late(Memory):
        def __iter__(self):
            yield from super().__iter__()
            self.statistics.clock_offset_s = 1e5

    late = Late(source._measurements)
    assert [finding.code for finding in diagnose(source).faults] == ["no_odometry"]
    assert [finding.code for finding in diagnose(late).faults] == ["clock_skew"]
