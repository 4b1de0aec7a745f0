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
from gridslam.io.log import Log
from gridslam.io.measurement import Measurement

__all__ = ["Doctor", "diagnose", "quick_check"]

_QUICK_S, _QUICK_SCANS = 60.0, 300
"""How much of a log is looked at before it is mapped: 30 ms of work, less than 3 % of mapping as much."""


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
        if matching:
            from gridslam.doctor.motion_examiner import MotionExaminer

            self._examiners.append(MotionExaminer())

    def take(self, measurement: Measurement) -> None:
        """Look at the next measurement."""
        for examiner in self._examiners:
            examiner.take(measurement)

    def findings(self) -> Iterator[Finding]:
        """Tell what was found so far."""
        for examiner in self._examiners:
            yield from examiner.findings()

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


def diagnose(log: Log, *, quick: bool = False, tick: Callable[[], None] = lambda: None) -> Diagnosis:
    """Read a log once and say what is in it and what is wrong with it.

    Parameters
    ----------
    log : Log
    quick : bool
        Look at the first minute only (300 scans at the most), and match no scan.
    tick : callable
        Called after each scan, to show how far the reading is.

    Raises
    ------
    InputError
        The log has no scan that can be read. One that cannot be read to its end is diagnosed as far as it goes, and
        that is a finding.
    """
    doctor, broken, scans, first_ns = Doctor(matching=not quick), None, 0, 0
    try:
        for measurement in log:
            stamp_ns = measurement.scan.stamp_ns
            first_ns = first_ns if scans else stamp_ns
            if quick and (scans >= _QUICK_SCANS or stamp_ns - first_ns > _QUICK_S * 1e9):
                break
            doctor.take(measurement)
            scans += 1
            tick()
    except InputError as error:
        if not scans:
            raise
        broken = _unreadable(error, scans)
    findings = [*doctor.findings()] if broken is None else [broken, *doctor.findings()]
    if not quick:
        findings += [*reader_findings(log.statistics), doctor.cost()]
    return doctor.diagnosis(log, findings)


def quick_check(log: Log) -> tuple[Finding, ...]:
    """Tell what the first minute of a log shows that is doubtful or spoils the map, without matching any scan.

    What only a whole log can tell, such as that the robot never moves, is left out, and so is what the reader will
    raise by itself.
    """
    found = diagnose(log, quick=True).faults
    return tuple(finding for finding in found if finding.code not in _ONLY_WHOLE)


_ONLY_WHOLE = ("standing_still", "unreadable")


def _unreadable(error: InputError, scans: int) -> Finding:
    return Finding(
        "unreadable", Severity.SPOILS, f"The log cannot be read to its end: {error}", scans, "scans",
        "Record it again or repair it; a log that is cut off is mapped as far as it goes with --keep-truncated.",
    )  # fmt: skip
