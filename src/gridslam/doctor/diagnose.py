"""The doctor: reads a log once, or its first minute while it is mapped, and reports its content and its faults."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import final

from gridslam.doctor.finding import Finding, Severity
from gridslam.doctor.lasers import BeamStatistics, Mounting, field_of_view_rad, mounting_findings, planar_mounting
from gridslam.doctor.motion_findings import MotionExaminer
from gridslam.doctor.odometry import OdometryExaminer
from gridslam.doctor.range_limits import RangeCounts
from gridslam.doctor.reader import estimate_cost, reader_findings
from gridslam.doctor.stamps import StampStatistics
from gridslam.errors import InputError
from gridslam.io.log import Log, LogOptions, LogSource, open_if_path
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement
from gridslam.types import FloatArray

__all__ = ["CheckedLog", "Diagnosis", "Doctor", "LaserFacts", "diagnose", "quick_check"]

_QUICK_S = 60.0
_QUICK_SCANS = 300
"""How much `quick_check` looks at: 0.1 ms a scan and 30 ms in all, where the shortest map takes a second."""

_ONLY_WHOLE = ("standing_still",)


@final
@dataclass(frozen=True, slots=True, eq=False)
class LaserFacts:
    """What is known of one laser.

    Attributes
    ----------
    scans : int
    rate_hz : float or None
        Scans a second, pauses included.
    beams : int
        That most of its scans have.
    field_of_view_rad : float
    clockwise : bool
        Whether its bearings fall from the first beam to the last.
    range_min_m, range_max_m : float
        Limits as stated; the greatest may be infinite.
    invalid_share, no_return_share : float
        Of all beams.
    mounting : (3,) float64
        As stated: [x m, y m, yaw rad] in the base frame.
    tilt_rad : float
        From level.
    upside_down : bool
    """

    scans: int
    rate_hz: float | None
    beams: int
    field_of_view_rad: float
    clockwise: bool
    range_min_m: float
    range_max_m: float
    invalid_share: float
    no_return_share: float
    mounting: FloatArray
    tilt_rad: float
    upside_down: bool


@final
@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """All findings of a log, and its facts.

    Attributes
    ----------
    path : Path
    findings : tuple of Finding
        The worst first, else as they came.
    lasers : mapping of str to LaserFacts
        By sensor.
    statistics : LogStatistics
        What the reader met.
    metres, radians : float
        Path length and rotation of the odometry.
    """

    path: Path
    findings: tuple[Finding, ...]
    lasers: Mapping[str, LaserFacts]
    statistics: LogStatistics
    metres: float
    radians: float

    def __repr__(self) -> str:
        """Return one line."""
        codes = ", ".join(finding.code for finding in self.faults[:5]) + ", ..." * (len(self.faults) > 5)
        return f"Diagnosis({self.path.name}: {self.worst.value}; {len(self.faults)} faults{': ' * bool(codes)}{codes})"

    @property
    def faults(self) -> tuple[Finding, ...]:
        """The findings that are more than information."""
        return tuple(finding for finding in self.findings if finding.is_fault)

    @property
    def worst(self) -> Severity:
        """How bad the worst finding is."""
        return self.findings[0].severity if self.findings else Severity.INFO


@final
@dataclass(slots=True)
class _Laser:
    """What is looked at of each laser."""

    stamps: StampStatistics = field(default_factory=StampStatistics)
    beams: BeamStatistics = field(default_factory=BeamStatistics)
    ranges: RangeCounts = field(default_factory=RangeCounts)
    mounting: Mounting = field(default_factory=Mounting)

    def take(self, measurement: Measurement) -> None:
        scan = measurement.scan
        self.stamps.take(measurement)
        self.beams.take(scan)
        self.ranges.take(scan)
        self.mounting.take(scan.geometry)

    def facts(self) -> LaserFacts:
        beams = max(self.beams.beams, 1)
        geometry = self.mounting.geometry
        bearings = geometry.bearings
        rate_hz = self.stamps.rate_hz
        return LaserFacts(
            self.beams.scans,
            rate_hz if math.isfinite(rate_hz) else None,
            self.beams.usual_count,
            field_of_view_rad(bearings),
            len(bearings) > 1 and bool(bearings[0] > bearings[-1]),
            self.ranges.range_min_m,
            self.ranges.range_max_m,
            self.beams.invalid / beams,
            self.beams.no_return / beams,
            planar_mounting(geometry),
            self.mounting.tilt_rad,
            bool(geometry.base_from_laser[2, 2] < 0),
        )


@final
class Doctor:
    """Processes the measurements of a log in order, and reports the findings at any time.

    The memory does not grow with the log; with matching (see `LaserMotionEstimator`) by 100 bytes for each scan that is
    matched, which are ever fewer.

    Parameters
    ----------
    matching : bool
        Whether scans are matched, to check odometry and mountings by laser odometry. It takes most of the time.
    """

    def __init__(self, *, matching: bool = True) -> None:
        """Begin with nothing seen."""
        self._lasers: defaultdict[str, _Laser] = defaultdict(_Laser)
        self._odometry = OdometryExaminer()
        self._motion = MotionExaminer() if matching else None

    def take(self, measurement: Measurement) -> None:
        """Look at the next measurement."""
        self._lasers[measurement.scan.sensor].take(measurement)
        self._odometry.take(measurement)
        if self._motion is not None:
            self._motion.take(measurement)

    def findings(self) -> Iterator[Finding]:
        """Yield the findings so far; a tilting laser is not used as a reference of the motion."""
        for sensor, laser in self._lasers.items():
            yield from laser.stamps.findings(sensor)
        for sensor, laser in self._lasers.items():
            yield from laser.beams.findings(sensor)
        for sensor, laser in self._lasers.items():
            yield from laser.ranges.findings(sensor)
        mounted = list(mounting_findings({sensor: laser.mounting for sensor, laser in self._lasers.items()}))
        yield from mounted
        yield from self._odometry.findings()
        if self._motion is not None:
            tilting = {finding.sensor for finding in mounted if finding.code == "tilting_laser"}
            yield from (finding for finding in self._motion.findings() if finding.sensor not in tilting)

    def cost(self) -> Finding:
        """Estimate the cost of mapping these scans; without odometry as if each updated the particles."""
        odometry = self._odometry
        return estimate_cost(odometry.scans, odometry.key_scans + odometry.without)

    def diagnosis(self, log: Log, findings: Iterable[Finding]) -> Diagnosis:
        """Put findings and facts together."""
        ordered = sorted(findings, key=lambda finding: -finding.severity.rank)
        lasers = {sensor: laser.facts() for sensor, laser in self._lasers.items()}
        return Diagnosis(
            log.path, tuple(ordered), lasers, log.statistics, self._odometry.metres, self._odometry.radians
        )


def diagnose(
    log: LogSource, *, options: LogOptions | None = None, on_progress: Callable[[], None] = lambda: None
) -> Diagnosis:
    """Read a log once and report its content and its faults.

    Parameters
    ----------
    log : str, Path or Log
        The log, of any format that `open_log` knows.
    options : LogOptions, optional
        What to read of the log at a path.
    on_progress : callable
        Called after each scan, to show how far the reading is.

    Raises
    ------
    ArgumentError
        There are `options` for a log that is open already.
    InputError
        The log has no scan that can be read. One that cannot be read to its end is diagnosed as far as it goes, and
        that is a finding.
    """
    source = open_if_path(log, options)
    doctor = Doctor()
    found: list[Finding] = []
    scans = 0
    try:
        for measurement in source:
            doctor.take(measurement)
            scans += 1
            on_progress()
    except InputError as error:
        if not scans:
            raise
        found.append(
            Finding(
                "unreadable",
                Severity.ERROR,
                f"The log cannot be read to its end: {error}",
                scans,
                "scans",
                "Record it again or repair it; "
                "a log that is cut off is mapped as far as it goes with --keep-truncated.",
            )
        )
    return doctor.diagnosis(source, [*found, *doctor.findings(), *reader_findings(source.statistics), doctor.cost()])


@final
class CheckedLog:
    """A log that is checked over its first minute (at most 300 scans) while it is read.

    Parameters
    ----------
    log : Log
        What is read.
    on_findings : callable
        Gets the findings, if there are any that are more than information, once in each iteration: as soon as the
        first minute is over, or the log.
    """

    def __init__(self, log: Log, on_findings: Callable[[tuple[Finding, ...]], None]) -> None:
        """Nothing is read before the iteration."""
        self._log = log
        self._on_findings = on_findings

    @property
    def path(self) -> Path:
        """The file or folder."""
        return self._log.path

    @property
    def statistics(self) -> LogStatistics:
        """What the latest iteration has met so far."""
        return self._log.statistics

    def __iter__(self) -> Iterator[Measurement]:
        """Read the log from its start."""
        measurements = iter(self._log)
        yield from _check_first_minute(measurements, self._on_findings)
        yield from measurements


def quick_check(log: LogSource) -> tuple[Finding, ...]:
    """Yield the warnings and errors of the first minute of a log (300 scans at most).

    No scan is matched, and findings that need the whole log, such as that the robot never moves, are left out.
    """
    found: list[Finding] = []
    for _ in _check_first_minute(iter(open_if_path(log)), found.extend):
        pass
    return tuple(found)


def _check_first_minute(
    measurements: Iterator[Measurement], on_findings: Callable[[tuple[Finding, ...]], None]
) -> Iterator[Measurement]:
    """The measurements of the first minute; its findings are reported before the last of them is yielded."""
    doctor = Doctor(matching=False)
    first_ns: int | None = None
    for count, measurement in enumerate(measurements, 1):
        stamp_ns = measurement.scan.stamp_ns
        first_ns = stamp_ns if first_ns is None else first_ns
        doctor.take(measurement)
        if count >= _QUICK_SCANS or stamp_ns - first_ns > _QUICK_S * 1e9:
            _report_faults(doctor, on_findings)
            yield measurement
            return
        yield measurement
    _report_faults(doctor, on_findings)


def _report_faults(doctor: Doctor, on_findings: Callable[[tuple[Finding, ...]], None]) -> None:
    found = tuple(f for f in doctor.findings() if f.is_fault and f.code not in _ONLY_WHOLE)
    if found:
        on_findings(found)
