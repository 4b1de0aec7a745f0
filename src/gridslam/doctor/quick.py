"""The cheap part of the diagnosis: what the begin of a log shows without matching, while it is mapped."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import final

from gridslam.doctor.diagnose import Doctor
from gridslam.doctor.finding import Finding
from gridslam.io.log import Log, LogSource, open_if_path
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement

__all__ = ["CheckedLog", "quick_check"]

_SECONDS, _SCANS = 60.0, 300
"""How much is looked at: 0.1 ms a scan and 30 ms in all, where the shortest map takes a second."""

_ONLY_WHOLE = ("standing_still",)


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
        self._log, self._tell = log, on_findings

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
        yield from _check_first_minute(measurements, self._tell)
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
    doctor, first_ns = Doctor(matching=False), None
    for count, measurement in enumerate(measurements, 1):
        stamp_ns = measurement.scan.stamp_ns
        first_ns = stamp_ns if first_ns is None else first_ns
        doctor.take(measurement)
        if count >= _SCANS or stamp_ns - first_ns > _SECONDS * 1e9:
            _report_faults(doctor, on_findings)
            yield measurement
            return
        yield measurement
    _report_faults(doctor, on_findings)


def _report_faults(doctor: Doctor, on_findings: Callable[[tuple[Finding, ...]], None]) -> None:
    found = tuple(f for f in doctor.findings() if f.is_fault and f.code not in _ONLY_WHOLE)
    if found:
        on_findings(found)
