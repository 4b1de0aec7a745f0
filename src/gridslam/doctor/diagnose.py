"""The doctor: reads a log once, or its first minute while it is mapped, and reports its content and its faults."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, final

from gridslam.checked import checked
from gridslam.doctor.finding import Finding, Severity
from gridslam.doctor.lasers import BeamStatistics, Mounting, field_of_view_rad, mounting_findings, planar_mounting
from gridslam.doctor.motion_findings import MotionExaminer
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

_ONLY_WHOLE = ("standing_still", "robot_carried")
_OF_READER_AT_ONCE = ("missing_files", "missing_transform", "clock_skew")
_REPORTED_ELSEWHERE = ("unreadable",)
_MISMOUNTED = ("tilting_laser", "laser_far_away")
_OF_TWO_CLOCKS = ("odometry_unrelated", "no_odometry")
_OF_ODOMETRY = ("odometry_scale", "odometry_rotation_bias", "odometry_drift", "odometry_unrelated")
_CONSEQUENCES = {
    ("random_ranges", Severity.ERROR): ("odometry_frozen",),  # they change while the robot stands
    ("range_limits", Severity.ERROR): _OF_ODOMETRY,  # false walls move with the robot, and hold the laser's motion back
    ("odometry_frozen", Severity.ERROR): _OF_ODOMETRY,
    ("odometry_units", Severity.WARNING): (*_OF_ODOMETRY, "odometry_jumps", "fast_turning"),
}
"""Consequences of a fault of this severity, which are not reported beside it; of a laser's those of another are."""


def _follows(finding: Finding, cause: Finding) -> bool:
    """Return whether a finding is a consequence: of the odometry, or of the same laser."""
    is_of_all = cause.code.startswith("odometry_") or not finding.sensor
    is_named = finding.code in _CONSEQUENCES[cause.code, cause.severity]
    return is_named and (is_of_all or finding.sensor == cause.sensor)


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

    def _repr_html_(self) -> str:
        """Show the findings in a notebook."""
        rows = "".join(f"<li>{each.severity.value}: {escape(each.message)}</li>" for each in self.findings)
        return f"<p>{escape(self.path.name)}: {self.worst.value}</p><ul>{rows}</ul>"

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
        self._motion = MotionExaminer() if matching else None

    def take(self, measurement: Measurement) -> None:
        """Look at the next measurement."""
        self._lasers[measurement.scan.sensor].take(measurement)
        self._odometry.take(measurement)
        if self._motion is not None:
            self._motion.take(measurement)

    def findings(self) -> Iterator[Finding]:
        """Yield the findings so far, without those that follow from others."""
        found = list(self._examine())
        causes = [finding for finding in found if (finding.code, finding.severity) in _CONSEQUENCES]
        yield from (finding for finding in found if not any(_follows(finding, cause) for cause in causes))

    def _examine(self) -> Iterator[Finding]:
        """Yield the findings of each check; a laser that tilts, sees a person or has wrong ranges is no reference."""
        for sensor, laser in self._lasers.items():
            yield from laser.stamps.findings(sensor)
        of_beams = [found for sensor, laser in self._lasers.items() for found in laser.beams.findings(sensor)]
        yield from of_beams
        implausible = [found for sensor, laser in self._lasers.items() for found in laser.examiner.findings(sensor)]
        yield from implausible
        of_limits = [found for sensor, laser in self._lasers.items() for found in laser.ranges.findings(sensor)]
        yield from of_limits
        mounted = list(mounting_findings({sensor: laser.mounting for sensor, laser in self._lasers.items()}))
        yield from mounted
        yield from self._odometry.findings()
        no_reference = {finding.sensor for finding in mounted if finding.code in _MISMOUNTED}
        no_reference |= {finding.sensor for finding in of_beams if finding.code == "single_object"}
        no_reference |= {finding.sensor for finding in implausible}
        held_back = {finding.sensor for finding in of_limits if finding.severity is Severity.ERROR}
        for sensor in set(self._lasers) - no_reference:
            yield from self._lasers[sensor].breaks.findings(sensor)
        matched = [] if self._motion is None else list(self._motion.findings(no_reference | held_back))
        yield from (finding for finding in matched if finding.sensor not in no_reference)

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
class BreakCheck:
    """Checks the scans of all lasers, one after the other, for where the robot was carried (see `ViewBreaks`)."""

    def __init__(self) -> None:
        """Begin with nothing seen."""
        self._breaks: defaultdict[str, ViewBreaks] = defaultdict(ViewBreaks)

    def take(self, measurement: Measurement) -> tuple[Finding, ...]:
        """Look at the next measurement; return the finding that is certain from here on, with all before."""
        sensor = measurement.scan.sensor
        return tuple(self._breaks[sensor].findings(sensor)) if self._breaks[sensor].take(measurement) else ()


@final
@checked
class CheckedLog:
    """A log that is checked while it is read: its begin by `EarlyCheck`, and where the robot was carried to its end.

    What its reader met is reported, too.

    Parameters
    ----------
    log : Log
        What is read.
    on_findings : callable
        Gets findings that are more than information, as soon as they are certain; each once, however often the log is
        read.
    has_breaks : bool
        Whether it is looked where the robot was carried, too; `map_log` does that itself.
    """

    def __init__(
        self, log: Log, on_findings: Callable[[tuple[Finding, ...]], None], *, has_breaks: bool = True
    ) -> None:
        """Nothing is read before the iteration."""
        self._log = log
        self._on_findings = on_findings
        self._check = EarlyCheck()
        self._breaks = BreakCheck() if has_breaks else None
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
            if count > self._checked and not (self._breaks is None and self._check.is_complete):
                self._checked = count
                self._report(partial(self._take, measurement))
            yield measurement
        self._report(self._check.end)
        self._report(self._of_reader)

    def _take(self, measurement: Measurement) -> tuple[Finding, ...]:
        was_over = self._check.is_complete
        found = list(self._check.take(measurement))
        if self._check.is_complete and not was_over:
            found += (finding for finding in self._of_reader() if finding.code in _OF_READER_AT_ONCE)
        return (*found, *(() if self._breaks is None else self._breaks.take(measurement)))

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
            self._faults |= {f"{f.code} ({f.sensor})" if f.sensor else f.code: f.message for f in found}
            self._on_findings(found)
