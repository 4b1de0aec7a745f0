"""The doctor: reads a log once, or its first minute while it is mapped, and reports its content and its faults."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, final

from gridslam.checked import checked
from gridslam.doctor.calibration import calibrate
from gridslam.doctor.finding import Finding, Severity
from gridslam.doctor.laser_motion import LaserMotionEstimator
from gridslam.doctor.lasers import BeamStatistics, Mounting, field_of_view_rad, planar_mounting
from gridslam.doctor.motion_findings import motion_findings
from gridslam.doctor.odometry import OdometryExaminer
from gridslam.doctor.range_checks import RangeExaminer
from gridslam.doctor.range_limits import RangeCounts
from gridslam.doctor.reader import reader_findings
from gridslam.doctor.stamps import StampStatistics
from gridslam.doctor.view_breaks import ViewBreaks
from gridslam.errors import InputError
from gridslam.io.log import Log, LogOptions, LogSource, open_if_path
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement
from gridslam.pipeline import describe_error

_QUICK_S = 60.0
_QUICK_SCANS = 300
"""How much `EarlyCheck` looks at: 0.1 ms a scan and 30 ms in all, where the shortest map takes a second."""
_FEWEST_SCANS = 30  # that it looks at: of stamps in ms there is hardly one in a minute

_WHEELS = {"odometry_scale", "odometry_rotation_bias", "odometry_drift"}
_ONLY_WHOLE = ("standing_still", "robot_carried")
_OF_READER_AT_ONCE = ("missing_files", "missing_transform", "clock_skew")
_REPORTED_ELSEWHERE = ("unreadable",)
_NO_REFERENCE = (
    "tilting_laser", "laser_far_away", "single_object", "range_units", "laser_frozen", "random_ranges"
)  # fmt: skip
_OF_TWO_CLOCKS = ("odometry_unrelated", "no_odometry")
_OF_ODOMETRY = (*_WHEELS, "odometry_unrelated", "odometry_frozen")
_OTHER_UNIT = 9.0  # of a scale that is off: inches, centimetres or millimetres
_CONSEQUENCES = {
    "odometry_frozen": ("standing_still",),
    "odometry_units": ("odometry_jumps",),
    "random_ranges": ("odometry_frozen",),  # they change while the robot stands
}


@final
@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """All findings of a log, and its facts.

    Attributes
    ----------
    path : Path
    findings : tuple of Finding
        The worst first, else as they came.
    lasers : mapping of str to dict
        Facts about each laser by its sensor, as in the report: scans, rate_hz (scans a second, pauses included), beams,
        field_of_view_rad, direction, range_min_m, range_max_m, invalid_share, no_return_share (of all beams), mounting.
    statistics : LogStatistics
        What the reader met.
    metres, radians : float
        Path length and rotation of the odometry.
    """

    path: Path
    findings: tuple[Finding, ...]
    lasers: Mapping[str, dict[str, Any]]
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
    def scans(self) -> int:
        """Scans of all lasers."""
        return sum(facts["scans"] for facts in self.lasers.values())

    @property
    def worst(self) -> Severity:
        """How bad the worst finding is."""
        return self.findings[0].severity if self.findings else Severity.INFO


@final
@dataclass(slots=True)
class _Laser:
    """The checks of each laser."""

    stamps: StampStatistics = field(default_factory=StampStatistics)
    beams: BeamStatistics = field(default_factory=BeamStatistics)
    ranges: RangeCounts = field(default_factory=RangeCounts)
    examiner: RangeExaminer = field(default_factory=RangeExaminer)
    mounting: Mounting = field(default_factory=Mounting)
    breaks: ViewBreaks = field(default_factory=ViewBreaks)

    def take(self, measurement: Measurement) -> None:
        scan = measurement.scan
        self.stamps.take(measurement)
        self.beams.take(scan)
        self.ranges.take(scan)
        self.examiner.take(measurement)
        self.mounting.take(scan.geometry)
        self.breaks.take(measurement)

    def findings(self, sensor: str) -> Iterator[Finding]:
        """Yield the findings of all checks but for where the robot was carried."""
        for check in (self.stamps, self.beams, self.examiner, self.ranges, self.mounting):
            yield from check.findings(sensor)

    def facts(self) -> dict[str, Any]:
        """Return facts about the laser as JSON values; unknown or unlimited values are None."""
        beams = max(self.beams.beams, 1)
        geometry = self.mounting.geometry
        bearings = geometry.bearings
        x, y, yaw = planar_mounting(geometry).tolist()
        return {
            "scans": self.beams.scans,
            "rate_hz": _finite(self.stamps.rate_hz),
            "beams": self.beams.usual_count,
            "field_of_view_rad": field_of_view_rad(bearings),
            "direction": "clockwise" if len(bearings) > 1 and bearings[0] > bearings[-1] else "counter-clockwise",
            "range_min_m": self.ranges.range_min_m,
            "range_max_m": _finite(self.ranges.range_max_m),
            "invalid_share": self.beams.invalid / beams,
            "no_return_share": self.beams.no_return / beams,
            "mounting": {
                "x_m": x,
                "y_m": y,
                "yaw_rad": yaw,
                "tilt_rad": self.mounting.tilt_rad,
                "upside_down": bool(geometry.base_from_laser[2, 2] < 0),
            },
        }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


@final
@checked
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
        self._matching = matching
        self._motion: defaultdict[str, LaserMotionEstimator] = defaultdict(LaserMotionEstimator)

    def take(self, measurement: Measurement) -> None:
        """Look at the next measurement."""
        self._lasers[measurement.scan.sensor].take(measurement)
        self._odometry.take(measurement)
        if self._matching:
            self._motion[measurement.scan.sensor].add(measurement)

    def findings(self) -> Iterator[Finding]:
        """Yield the findings so far; a laser that tilts, sees a person or has wrong ranges is no reference."""
        found = [finding for sensor, laser in self._lasers.items() for finding in laser.findings(sensor)]
        yield from found
        no_reference = {finding.sensor for finding in found if finding.code in _NO_REFERENCE}
        held_back = {f.sensor for f in found if (f.code, f.severity) == ("range_limits", Severity.ERROR)}
        for sensor, laser in self._lasers.items():
            yield from laser.breaks.findings(sensor) if sensor not in no_reference else ()
        moved = list(self._compare_motion(no_reference, held_back))
        follows = {of for finding in (*found, *moved) for of in _CONSEQUENCES.get(finding.code, ())}
        if any(finding.code == "odometry_scale" and (finding.size or 0) > _OTHER_UNIT for finding in moved):
            follows.add("odometry_jumps")
        driven = [finding for finding in self._odometry.findings() if finding.code not in follows]
        if any(finding.code == "odometry_frozen" for finding in driven):
            moved = [finding for finding in moved if finding.code not in _OF_ODOMETRY]
        yield from (*moved, *driven)

    def _compare_motion(self, no_reference: Set[str], held_back: Set[str]) -> Iterator[Finding]:
        """Compare the motion of each laser with odometry and mounting.

        Faults of the wheels are reported once, if all lasers agree: one that leaves a bare corridor backward may see
        the robot stand still. False walls, which move with the robot, hold the motion of a laser back.
        """
        reported, agreeing = [], []
        for sensor in [sensor for sensor in self._motion if sensor not in no_reference]:
            calibration = calibrate(self._motion[sensor].motion)
            found = motion_findings(calibration)
            if sensor in held_back:
                reported += [finding for finding in found if finding.code not in _OF_ODOMETRY]
            elif found or calibration.scale.determined:
                reported += found
                agreeing.append({finding.code for finding in found})
        agreed = _WHEELS.intersection(*agreeing) if agreeing else set()
        for finding in reported:
            if finding.code in agreed or finding.code not in _WHEELS:
                yield finding
                agreed.discard(finding.code)

    def diagnosis(self, log: Log, findings: Iterable[Finding]) -> Diagnosis:
        """Put findings and facts together."""
        ordered = sorted(findings, key=lambda finding: -finding.severity.rank)
        lasers = {sensor: laser.facts() for sensor, laser in self._lasers.items()}
        return Diagnosis(
            log.path, tuple(ordered), lasers, log.statistics, self._odometry.metres, self._odometry.radians
        )


@checked
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
    seen = list(doctor.findings())
    if source.statistics.clock_offset_s:  # which is the cause: the scans have the odometry of another time
        seen = [finding for finding in seen if finding.code not in _OF_TWO_CLOCKS]
    return doctor.diagnosis(source, [*found, *seen, *reader_findings(source.statistics)])


@final
@checked
class EarlyCheck:
    """Checks the beginning of a log while it is read: a minute, though at least 30 scans and at most 300.

    No scan is matched, and findings that need the whole log, such as that the robot never moves, are left out.

    Attributes
    ----------
    is_complete : bool
        Whether there is nothing more to look at.
    """

    def __init__(self) -> None:
        """Begin with nothing seen."""
        self._doctor = Doctor(matching=False)
        self._scans = 0
        self._first_ns = 0
        self.is_complete = False

    def take(self, measurement: Measurement) -> tuple[Finding, ...]:
        """Look at the next measurement; return the warnings and errors of the beginning where it ends."""
        if self.is_complete:
            return ()
        stamp_ns = measurement.scan.stamp_ns
        self._scans += 1
        if self._scans == 1:
            self._first_ns = stamp_ns
        self._doctor.take(measurement)
        is_late = self._scans > _FEWEST_SCANS and stamp_ns - self._first_ns > _QUICK_S * 1e9
        return self.end() if self._scans >= _QUICK_SCANS or is_late else ()

    def end(self) -> tuple[Finding, ...]:
        """Return the warnings and errors of a log that ends here, unless `take` has returned them."""
        if self.is_complete:
            return ()
        self.is_complete = True
        found = tuple(f for f in self._doctor.findings() if f.is_fault and f.code not in _ONLY_WHOLE)
        self._doctor = Doctor(matching=False)  # the memory of what was seen is not needed any more
        return found


@final
@checked
class CheckedLog:
    """Log with a check of its beginning, by `EarlyCheck`, and a report of its reader's findings.

    Parameters
    ----------
    log : Log
        What is read.
    on_findings : callable
        Gets findings that are more than information, as soon as they are certain; each once, however often the log is
        read.
    """

    def __init__(self, log: Log, on_findings: Callable[[tuple[Finding, ...]], None]) -> None:
        """Nothing is read before the iteration."""
        self._log = log
        self._on_findings = on_findings
        self._check = EarlyCheck()
        self._checked = 0
        self._has_failed = False
        self._faults: dict[str, str] = {}

    @property
    def path(self) -> Path:
        """The file or folder."""
        return self._log.path

    @property
    def statistics(self) -> LogStatistics:
        """Statistics of the latest iteration so far, with all faults found."""
        statistics = self._log.statistics
        statistics.faults.update(self._faults)
        return statistics

    def __iter__(self) -> Iterator[Measurement]:
        """Read the log from its start."""
        for count, measurement in enumerate(self._log, 1):
            if count > self._checked and not self._check.is_complete:
                self._checked = count
                self._report(partial(self._take, measurement))
            yield measurement
        self._report(self._check.end)
        self._report(self._of_reader)

    def _take(self, measurement: Measurement) -> tuple[Finding, ...]:
        found = self._check.take(measurement)
        if not self._check.is_complete:
            return found
        return (*found, *(finding for finding in self._of_reader() if finding.code in _OF_READER_AT_ONCE))

    def _of_reader(self) -> tuple[Finding, ...]:
        """Warnings of the reader that were not reported."""
        found = (finding for finding in reader_findings(self._log.statistics) if finding.is_fault)
        return tuple(f for f in found if f.code not in self._faults and f.code not in _REPORTED_ELSEWHERE)

    def _report(self, check: Callable[[], tuple[Finding, ...]]) -> None:
        if self._has_failed:
            return
        try:
            found = check()
        except Exception as error:  # a check must not end the map
            self._has_failed = True
            found = (Finding("checks_failed", Severity.WARNING, describe_error(error)),)
        if self._log.statistics.clock_offset_s:
            found = tuple(finding for finding in found if finding.code not in _OF_TWO_CLOCKS)
        if found:
            self._faults |= {finding.title: finding.message for finding in found}
            self._on_findings(found)
