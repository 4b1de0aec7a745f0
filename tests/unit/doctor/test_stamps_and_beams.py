"""Stamps, beams and ranges: each finding in a log that has it, and in none that has not."""

from dataclasses import replace

import numpy as np
import pytest

from gridslam.doctor import Severity
from gridslam.io.measurement import Measurement
from support.hand_logs import drive, findings, seen


def restamped(stamps_s):
    """The drive, stamped otherwise."""
    for stamp_s, (odometry, scan) in zip(stamps_s, drive(), strict=False):
        stamp_ns = round(stamp_s * 1e9)
        yield Measurement(replace(odometry, stamp_ns=stamp_ns), replace(scan, stamp_ns=stamp_ns))


def test_a_drive_with_nothing_wrong_has_no_finding():
    assert findings(drive()) == {}


def test_a_gap_in_which_the_robot_moved_is_doubtful():
    log = [m for m in drive() if not 10 < m.scan.stamp_ns * 1e-9 < 15]
    gap = findings(log)["gaps"]
    assert (gap.severity, gap.size, gap.unit) == (Severity.WARNING, pytest.approx(5.0), "s")
    assert "1 gap " in gap.message
    assert "1.50 m" in gap.message
    assert "10.0 s" in gap.remedy


@pytest.mark.parametrize(("missing_s", "severity"), [(0.9, Severity.INFO), (3.0, Severity.WARNING)])
def test_without_odometry_a_gap_is_doubtful_by_its_length(missing_s, severity):
    log = [Measurement(None, m.scan) for m in drive(rate_hz=10) if not 10 < m.scan.stamp_ns * 1e-9 < 10 + missing_s]
    assert findings(log)["gaps"].severity is severity


def test_stamps_in_no_order_are_doubtful():
    stamps = np.arange(200) * 0.2
    stamps[::4] -= 0.3
    assert findings(restamped(stamps))["backward_stamps"].severity is Severity.WARNING


def test_two_recordings_in_one_spoil():
    stamps = np.arange(200) * 0.2
    stamps[100:] -= 20.0
    found = findings(restamped(stamps))["backward_stamps"]
    assert (found.severity, found.size) == (Severity.ERROR, pytest.approx(19.8))
    assert "--start" in found.remedy


@pytest.mark.parametrize(("every", "severity"), [(50, Severity.INFO), (5, Severity.WARNING)])
def test_repeated_stamps(every, severity):
    stamps = np.arange(200) * 0.2
    stamps[every::every] = stamps[every - 1 : -1 : every]
    found = findings(restamped(stamps))["duplicate_stamps"]
    assert found.severity is severity
    assert found.size == pytest.approx(len(stamps[every::every]) / 200)


@pytest.mark.parametrize("value", [np.nan, 0.0, -1.0])
@pytest.mark.parametrize(("share", "severity"), [(0.03, Severity.INFO), (0.2, Severity.WARNING)])
def test_invalid_beams(share, severity, value):
    rng = np.random.default_rng(0)
    log = [
        seen(m.scan.stamp_ns * 1e-9, np.where(rng.random(181) < share, value, m.scan.ranges), tuple(m.odometry.pose))
        for m in drive()
    ]
    found = findings(log)["invalid_beams"]
    # 200 scans x 181 beams: the share's standard deviation is sqrt(0.2 x 0.8 / 36200) = 0.002
    assert found.size == pytest.approx(share, abs=0.01)
    assert found.severity is severity


@pytest.mark.parametrize(("hits", "severity"), [(10, Severity.ERROR), (60, None)])
def test_scans_that_hit_nothing(hits, severity):
    log = [
        seen(m.scan.stamp_ns * 1e-9, np.where(np.arange(181) < hits, m.scan.ranges, np.inf), tuple(m.odometry.pose))
        for m in drive()
    ]
    found = findings(log).get("few_hits")
    assert (found and found.severity) == severity


def with_pile(value_m, share, range_max_m, rng):
    for m in drive():
        lost = rng.random(181) < share
        ranges = np.where(lost, value_m, m.scan.ranges)
        yield seen(m.scan.stamp_ns * 1e-9, ranges, tuple(m.odometry.pose), range_max_m=range_max_m)


@pytest.mark.parametrize(
    ("value_m", "share", "severity"),
    [(8.0, 0.02, Severity.WARNING), (8.0, 0.2, Severity.ERROR), (50.0, 0.2, Severity.INFO), (8.0, 3e-4, None)],
)
def test_no_return_that_is_told_as_a_range(value_m, share, severity):
    found = findings(with_pile(value_m, share, 2 * value_m, np.random.default_rng(0))).get("range_limits")
    assert (found and found.severity) == severity
    if found:
        assert found.size == pytest.approx(2.0, abs=0.01)  # the stated limit over the true one
