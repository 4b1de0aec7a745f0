"""A log that is read as it should have been recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal, final

from gridslam.doctor.calibration import calibrate
from gridslam.doctor.laser_motion import laser_motion
from gridslam.doctor.range_limits import RangeCounts
from gridslam.doctor.repair import Repair, calibrate_early, find_full_repair, find_needed_repair, repair_measurements
from gridslam.errors import ArgumentError
from gridslam.io.log import Log, LogOptions, LogSource, open_if_path
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement

__all__ = ["RepairedLog", "open_repaired"]


@final
class RepairedLog:
    """A log from which the faults of the laser's mounting, of the clocks and of the odometry are taken out.

    Parameters
    ----------
    log : Log
        What is read. What is wrong with its first laser is found out before the first iteration, from a reading of its
        own.
    kind : "needed" or "all"
        Only faults that make any map unusable, estimated from the begin of the log (see `find_needed_repair`), or all
        faults that are certain, estimated from the whole log (see `find_full_repair`).
    tell : callable
        Gets the repair, if there is any, before the first measurement.

    Attributes
    ----------
    repair : Repair or None
        What is taken out; None before the first iteration.
    """

    def __init__(
        self, log: Log, kind: Literal["needed", "all"] = "needed", tell: Callable[[Repair], None] = lambda repair: None
    ) -> None:
        """Nothing is read before the iteration."""
        self._log, self._kind, self._tell = log, kind, tell
        self.repair: Repair | None = None

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
        if self.repair is None:
            self.repair = self._find_repair()
            if self.repair:
                self._tell(self.repair)
        return repair_measurements(self._log, self.repair) if self.repair else iter(self._log)

    def _find_repair(self) -> Repair:
        counts = RangeCounts()
        if self._kind == "all":
            full = calibrate(laser_motion(_counted(self._log, counts)))
            return find_full_repair(full, counts.false_hits_m())
        early = calibrate_early(_counted(self._log, counts))
        return find_needed_repair(early, counts.false_hits_m())


def _counted(log: Log, counts: RangeCounts) -> Iterator[Measurement]:
    """Count the ranges of the first laser on their way."""
    sensor = None
    for measurement in log:
        sensor = measurement.scan.sensor if sensor is None else sensor
        if measurement.scan.sensor == sensor:
            counts.take(measurement.scan)
        yield measurement


def open_repaired(log: LogSource, options: LogOptions | None, kind: Literal["needed", "all", "none"]) -> Log:
    """Open a log as `open_if_path` does, with the corrections of `RepairedLog`, or none.

    Raises ArgumentError for another `kind`, too.
    """
    if kind not in ("needed", "all", "none"):
        raise ArgumentError("repair", "needed, all or none", kind)
    read = open_if_path(log, options)
    return read if kind == "none" else RepairedLog(read, kind)
