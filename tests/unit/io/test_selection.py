"""Which part of a log is given, though its stamps jitter and go astray."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.errors import InputError
from gridslam.io.log import LogOptions
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement
from gridslam.io.selection import select
from gridslam.types import LaserScan, Odometry, ScanGeometry

GEOMETRY = ScanGeometry([0.0, 0.1])


@dataclass
class Listed:
    """A log in memory: stamps in s, each with the name of its sensor."""

    stamps_s: list[float]
    sensors: list[str] = field(default_factory=list)
    path: Path = Path("listed.log")
    statistics: LogStatistics = field(default_factory=LogStatistics)
    given: int = 0

    def __iter__(self):
        self.statistics, self.given = LogStatistics(total_bytes=1000), 0
        for place, stamp_s in enumerate(self.stamps_s):
            stamp_ns = round(stamp_s * 1e9)
            sensor = self.sensors[place] if self.sensors else "front"
            scan = LaserScan.from_ranges(stamp_ns, [1, np.nan], GEOMETRY, sensor=sensor)
            measurement = Measurement(Odometry.at(stamp_ns, [place, 0, 0]), scan)
            self.statistics.count(measurement)
            self.given += 1
            yield measurement


def places(log, **options) -> list[int]:
    return [int(m.odometry.pose[0]) for m in select(log, LogOptions(**options))]


@given(st.floats(0, 12), st.floats(0.1, 12), st.integers(1, 4))
def test_of_an_orderly_log_it_is_the_scans_of_that_time(start_s, duration_s, every):
    stamps = np.arange(100, 110, 0.5)
    start_ns, end_ns = round(start_s * 1e9), round(start_s * 1e9) + round(duration_s * 1e9)
    within = [k for k in range(20) if start_ns <= k * 500_000_000 < end_ns]
    log = Listed(stamps.tolist())
    if within:
        assert places(log, start_s=start_s, duration_s=duration_s, every=every) == within[::every]
        assert log.given <= within[-1] + 3  # no farther than is needed
    else:
        with pytest.raises(InputError, match=r"listed\.log: expected scans"):
            places(log, start_s=start_s, duration_s=duration_s)


@given(st.lists(st.floats(-0.9, 0.9), min_size=40, max_size=40), st.floats(0, 30), st.floats(1, 30))
def test_stamps_that_go_back_leave_no_hole(jitter, start_s, duration_s):
    """Whatever the stamps are: what is given stands together, and each end is where the jitter lets it be."""
    stamps = np.arange(40) + np.array(jitter)
    stamps[0] = 0
    try:
        got = places(Listed(stamps.tolist()), start_s=start_s, duration_s=duration_s)
    except InputError:
        assert start_s > 37 or duration_s < 2.8  # a scan period, and what jitter moves both its ends by
        return
    assert got == list(range(got[0], got[-1] + 1))
    assert abs(got[0] - start_s) <= 2  # a scan period, and what jitter moves
    assert got[-1] == 39 or abs(got[-1] + 1 - (start_s + duration_s)) <= 2


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"start_s": 100}, "expected scans 100 s or more after the first: the log lasts 9.0 s"),
        ({"start_s": 20, "duration_s": 5}, "expected scans 20 s or more and less than 25 s after the first"),
        ({"scan_topics": ("left",)}, "expected scans of left, got scans of front alone"),
        ({"scan_topics": ("front", "left")}, "expected scans of left, got scans of front alone"),
    ],
)
def test_where_nothing_is_there_it_is_told(options, problem):
    with pytest.raises(InputError, match=problem):
        places(Listed([*range(10)]), **options)
