"""Logs made by hand, scan by scan, for what a simulation would take too long to show."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from gridslam.doctor import Doctor, Finding
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement
from gridslam.types import LaserScan, Odometry, ScanGeometry

BEARINGS = np.linspace(-math.pi / 2, math.pi / 2, 181)
GEOMETRY = ScanGeometry(BEARINGS)


def view(x: float) -> np.ndarray:
    """Ranges (181,) of 2.6 to 3.4 m, others at each place x, and hardly two alike."""
    return 3.0 + 0.4 * np.sin(7 * BEARINGS + 2.0 * x) * np.cos(3 * x + BEARINGS)


def seen(
    stamp_s: float,
    ranges: np.ndarray,
    pose: tuple[float, float, float] | None,
    geometry: ScanGeometry = GEOMETRY,
    **limits: object,
) -> Measurement:
    """One measurement; `limits` go to `LaserScan.from_ranges`."""
    stamp_ns = round(stamp_s * 1e9)
    scan = LaserScan.from_ranges(stamp_ns, ranges, geometry, **limits)
    return Measurement(None if pose is None else Odometry.at(stamp_ns, pose), scan)


def drive(seconds: float = 40.0, rate_hz: float = 5.0, v: float = 0.3) -> Iterator[Measurement]:
    """Drive ahead at v m/s with nothing wrong."""
    for k in range(round(seconds * rate_hz)):
        x = v * k / rate_hz
        yield seen(k / rate_hz, view(x), (x, 0.0, 0.0))


def findings(measurements: Iterable[Measurement]) -> dict[str, Finding]:
    """What the doctor finds without matching, by code; each code once."""
    doctor = Doctor(matching=False)
    for measurement in measurements:
        doctor.take(measurement)
    found = list(doctor.findings())
    assert len({finding.code for finding in found}) == len(found)
    return {finding.code: finding for finding in found}


class MadeLog:
    """Measurements in memory, read as a log is."""

    def __init__(self, measurements: Sequence[Measurement]) -> None:
        """Nothing is counted before the iteration."""
        self.path = Path("simulated")
        self.statistics = LogStatistics()
        self._measurements = measurements

    def __iter__(self) -> Iterator[Measurement]:
        """Read and count."""
        self.statistics = LogStatistics()
        for measurement in self._measurements:
            self.statistics.count(measurement)
            yield measurement
