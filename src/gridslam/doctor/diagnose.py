"""The doctor: reads a log once and says what is in it and what is wrong with it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import final

from gridslam.doctor.beams import BeamExaminer
from gridslam.doctor.cost import expected_cost
from gridslam.doctor.diagnosis import Diagnosis, LaserFacts
from gridslam.doctor.examiner import Examiner
from gridslam.doctor.finding import Finding, Severity
from gridslam.doctor.lasers import LaserExaminer
from gridslam.doctor.odometry import OdometryExaminer
from gridslam.doctor.range_limits import RangeExaminer
from gridslam.doctor.reader import reader_findings
from gridslam.doctor.stamps import StampExaminer
from gridslam.errors import InputError
from gridslam.io.log import Log, LogOptions, LogSource, opened_log
from gridslam.io.measurement import Measurement

__all__ = ["Doctor", "diagnose"]

@final
class Doctor:
    """Sees every measurement of a log, in its order, and tells at any time what was found.

    The memory does not grow with the log; with matching (see `LaserWitness`) by 100 bytes for each scan that is
    matched, which are ever fewer.

    Parameters
    ----------
    matching : bool
        Whether scans are matched, to check odometry and mountings by the motion that the scans tell. It takes most of
        the time.
    """

    def __init__(self, *, matching: bool = True) -> None:
        """Begin with nothing seen."""
        self._stamps, self._beams, self._ranges = StampExaminer(), BeamExaminer(), RangeExaminer()
        self._lasers, self._odometry = LaserExaminer(), OdometryExaminer()
        self._examiners: list[Examiner] = [self._stamps, self._beams, self._ranges, self._lasers, self._odometry]
        self._matched: Examiner | None = None
        if matching:
            from gridslam.doctor.motion_examiner import MotionExaminer  # who does not match need not pay for it

            self._matched = MotionExaminer()

    def take(self, measurement: Measurement) -> None:
        """Look at the next measurement."""
        for examiner in self._examiners:
            examiner.take(measurement)
        if self._matched is not None:
            self._matched.take(measurement)

    def findings(self) -> Iterator[Finding]:
        """Tell what was found so far; a laser that tilts is no witness of the motion."""
        tilting = set()
        for examiner in self._examiners:
            for finding in examiner.findings():
                tilting |= {finding.sensor} if finding.code == "tilting_laser" else set()
                yield finding
        if self._matched is not None:
            yield from (finding for finding in self._matched.findings() if finding.sensor not in tilting)

    def cost(self) -> Finding:
        """Tell what mapping so many scans costs; without odometry as if each stepped the particles."""
        odometry = self._odometry
        return expected_cost(odometry.scans, odometry.key_scans + odometry.without)

    def diagnosis(self, log: Log, findings: Iterable[Finding]) -> Diagnosis:
        """Put findings and facts together."""
        lasers = {
            sensor: LaserFacts.of(
                clock, self._beams.sweeps[sensor], self._ranges.ranges[sensor], self._lasers.lasers[sensor]
            )
            for sensor, clock in self._stamps.clocks.items()
        }
        odometry = self._odometry
        return Diagnosis.of(log.path, list(findings), lasers, log.statistics, odometry.metres, odometry.radians)


def diagnose(
    log: LogSource, *, options: LogOptions | None = None, tick: Callable[[], None] = lambda: None
) -> Diagnosis:
    """Read a log once and say what is in it and what is wrong with it.

    Parameters
    ----------
    log : str, Path or Log
        The log, of any format that `open_log` knows.
    options : LogOptions, optional
        What to read of the log at a path.
    tick : callable
        Called after each scan, to show how far the reading is.

    Raises
    ------
    ArgumentError
        There are `options` for a log that is open already.
    InputError
        The log has no scan that can be read. One that cannot be read to its end is diagnosed as far as it goes, and
        that is a finding.
    """
    source, doctor, broken, scans = opened_log(log, options), Doctor(), None, 0
    try:
        for measurement in source:
            doctor.take(measurement)
            scans += 1
            tick()
    except InputError as error:
        if not scans:
            raise
        broken = _unreadable(error, scans)
    found = [*doctor.findings(), *reader_findings(source.statistics), doctor.cost()]
    return doctor.diagnosis(source, found if broken is None else [broken, *found])


def _unreadable(error: InputError, scans: int) -> Finding:
    return Finding(
        "unreadable", Severity.SPOILS, f"The log cannot be read to its end: {error}", scans, "scans",
        "Record it again or repair it; a log that is cut off is mapped as far as it goes with --keep-truncated.",
    )  # fmt: skip
